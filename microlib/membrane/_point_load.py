r"""The point-load model of a biomembrane: force and shape of a dimple, and the elastic modulus.

A probe of half-width :math:`c` presses with the force :math:`F` on a membrane of thickness
:math:`h`. The dimple has the radius :math:`a`, measured at its rim, and the depth :math:`w_d`.
The liquid below the membrane carries part of the force, and the stretched membrane carries the
rest. The equations are (4.1)–(4.7) and (5.2) of the thesis. The model is that of Sun et al. (2003).

Lengths are in µm and forces in µN, so moduli and stresses are in µN/µm² = MPa.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import PHYSICAL_RANGES, Array, as_array, as_poisson_ratio, as_positive

#: Nodes and weights of the Gauss–Legendre quadrature over a profile. 400 nodes change strain and
#: modulus by 1e-13, and by 2e-11 where the membrane is nearly vertical (w_d/a ≤ 1, ζ ≥ 0.01).
GAUSS = np.polynomial.legendre.leggauss(200)


class SmallSlopeWarning(UserWarning):
    """The dimple is deeper than the small-slope model (4.1)–(4.7) allows.

    Attributes
    ----------
    limit : float
        Relative depth w_d/a above which the warning is given, 0.1.

    Notes
    -----
    At w_d/a = 0.1 the small-slope approximations in the force balance (4.1) and in the strain
    (4.4) make the modulus 5 % too low for c/a = 0.1, 4 % for 0.2 and 11 % for 0.04. At w_d/a = 0.2
    and c/a = 0.1 the modulus is 20 % too low. `finite_slope_modulus` removes both approximations
    and keeps the uniform stress, which causes a larger error at any depth: the modulus of a clamped
    disc is 0.4 to 1.0 of that of (5.2). `model_moduli` compares the models.
    """

    limit = 0.1  # there finite_slope_modulus is 1.05 times elastic_modulus at c/a = 0.1 (tests)


def elastic_modulus(
    force: ArrayLike,
    rim_radius: ArrayLike,
    dimple_depth: ArrayLike,
    *,
    thickness: ArrayLike,
    probe_half_width: ArrayLike,
    poisson_ratio: ArrayLike,
) -> Array:
    r"""Return the elastic modulus of a membrane from one indentation, equation (5.2).

    .. math:: E = \frac{F a^2 (1-\nu)}{2\pi h w_d^3} \frac{1}{S(c/a)}, \qquad
              S(\zeta) = \frac{3-4\zeta^2+\zeta^4+2\ln\zeta^2}
              {(1-\zeta^2)(1-\zeta^2+\ln\zeta^2)^3}

    Parameters
    ----------
    force : array_like
        Indentation force F, in µN.
    rim_radius : array_like
        Distance a from the dimple's axis to its rim, in µm.
    dimple_depth : array_like
        Depth w_d of the dimple below its rim, in µm.
    thickness : array_like
        Membrane thickness h, in µm.
    probe_half_width : array_like
        Half-width c of the probe, in µm; smaller than `rim_radius`.
    poisson_ratio : array_like
        Poisson ratio ν, in (−1, 0.5].

    Returns
    -------
    ndarray
        Modulus E, in MPa; the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        If a length or the force is not positive, `probe_half_width` is not below `rim_radius`,
        `poisson_ratio` is outside (−1, 0.5], a value is not finite, the shapes do not broadcast, or
        a dimple is less deep than the membrane is thick.

    Warns
    -----
    SmallSlopeWarning
        If a dimple has w_d/a above `SmallSlopeWarning.limit`.
    UserWarning
        If a dimple is less deep than two thicknesses, where bending carries a part of the force, or
        if a modulus is above that of steel, 2·10⁵ MPa, or below 10 Pa. Lengths in mm or m and
        forces in N lead to such values.

    See Also
    --------
    indentation_force : The inverse, equation (4.7).

    Notes
    -----
    By linear elasticity (4.6), the modulus is the stress (4.3) times 1 − ν, divided by the
    strain (4.5). Equation (4.7) is the same relation, solved for the force. The model assumes a
    uniform stress and small slopes. A clamped membrane does not have a uniform stress: in the limit
    of small slopes the modulus of a disc with pressure is 0.40 of this modulus, for c/a = 0.1 and
    ν = 0.5. `model_moduli` compares the models. Table 5.6 of the thesis prints c/a = 44.78, which
    no probe can have. The printed modulus follows from c = 25 µm, for which c/a = 0.1012.

    References
    ----------
    Y. Sun, K.-T. Wan, K. P. Roberts, J. C. Bischof, B. J. Nelson, *Mechanical property
    characterization of mouse zona pellucida*, IEEE Trans. NanoBioscience 2(4), 2003.

    Examples
    --------
    >>> from microlib.membrane import elastic_modulus
    >>> modulus = elastic_modulus(
    ...     1.0, 250.0, 20.0, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{modulus:.3f} MPa")
    1.551 MPa
    """
    values = check_inputs(
        rim_radius, dimple_depth, probe_half_width, thickness, poisson_ratio, force=force
    )
    _warn_if_steep(values["rim_radius"], values["dimple_depth"])
    check_bending("dimple_depth", values["dimple_depth"], values["thickness"])
    modulus = values["force"] / force_per_modulus(values)
    warn_if_implausible(modulus)
    return modulus


def indentation_force(
    modulus: ArrayLike,
    rim_radius: ArrayLike,
    dimple_depth: ArrayLike,
    *,
    thickness: ArrayLike,
    probe_half_width: ArrayLike,
    poisson_ratio: ArrayLike,
) -> Array:
    r"""Return the force that makes a dimple of given radius and depth, equation (4.7).

    .. math:: F = \frac{2\pi E h w_d^3}{a^2(1-\nu)} S(c/a)

    Parameters
    ----------
    modulus : array_like
        Elastic modulus E, in MPa.
    rim_radius, dimple_depth, thickness, probe_half_width, poisson_ratio : array_like
        As for `elastic_modulus`.

    Returns
    -------
    ndarray
        Force F, in µN; the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        As for `elastic_modulus`, except that a depth below the thickness is accepted.

    Warns
    -----
    SmallSlopeWarning
        If a dimple has w_d/a above `SmallSlopeWarning.limit`.

    Examples
    --------
    >>> from microlib.membrane import indentation_force
    >>> force = indentation_force(
    ...     1.3, 250.0, 20.0, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{force:.3f} µN")
    0.838 µN
    """
    values = check_inputs(
        rim_radius, dimple_depth, probe_half_width, thickness, poisson_ratio, modulus=modulus
    )
    _warn_if_steep(values["rim_radius"], values["dimple_depth"])
    return values["modulus"] * force_per_modulus(values)


def dimple_depth(
    force: ArrayLike,
    rim_radius: ArrayLike,
    *,
    modulus: ArrayLike,
    thickness: ArrayLike,
    probe_half_width: ArrayLike,
    poisson_ratio: ArrayLike,
) -> Array:
    r"""Return the depth to which a force presses a membrane, by equation (4.7).

    .. math:: w_d = \left(\frac{F a^2 (1-\nu)}{2\pi E h\, S(c/a)}\right)^{1/3}

    Parameters
    ----------
    force : array_like
        Indentation force F, in µN.
    rim_radius : array_like
        Distance a from the dimple's axis to its rim, in µm.
    modulus : array_like
        Elastic modulus E, in MPa.
    thickness, probe_half_width, poisson_ratio : array_like
        As for `elastic_modulus`.

    Returns
    -------
    ndarray
        Depth w_d, in µm; the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        As for `elastic_modulus`, except that a depth below the thickness is returned.

    Warns
    -----
    SmallSlopeWarning
        If a resulting dimple has w_d/a above `SmallSlopeWarning.limit`.

    Examples
    --------
    >>> from microlib.membrane import dimple_depth
    >>> depth = dimple_depth(
    ...     0.838, 250.0, modulus=1.3, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{depth:.2f} µm")
    20.00 µm
    """
    values = check_inputs(
        rim_radius, 1.0, probe_half_width, thickness, poisson_ratio, force=force, modulus=modulus
    )
    # The force grows with the cube of the depth, so the force at 1 µm gives the depth.
    at_one_micrometer = values["modulus"] * force_per_modulus(values)
    depth = np.cbrt(values["force"] / at_one_micrometer)
    _warn_if_steep(values["rim_radius"], depth)
    return depth


def dimple_profile(
    radius: ArrayLike,
    rim_radius: ArrayLike,
    dimple_depth: ArrayLike,
    *,
    probe_half_width: ArrayLike,
) -> Array:
    r"""Return the depth of the deformed membrane below the rim, equations (4.2) and (4.3).

    .. math:: w(r) = w_d \frac{1-(r/a)^2+\ln(r/a)^2}{1-\zeta^2+\ln\zeta^2}, \qquad c \le r \le a

    Parameters
    ----------
    radius : array_like
        Distance r from the axis, in µm, between `probe_half_width` and `rim_radius`.
    rim_radius, dimple_depth, probe_half_width : array_like
        Geometry a, w_d and c, in µm.

    Returns
    -------
    ndarray
        Depth w, in µm, 0 at the rim and w_d at the probe; the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        If a length is not positive, `probe_half_width` is not below `rim_radius`, or a `radius`
        is outside [c, a].

    Notes
    -----
    The factor :math:`F/(4\pi\sigma_d h)` of (4.2) is expressed by the depth through (4.3), because
    an image shows the depth. `membrane_stress` returns the stress.

    Examples
    --------
    >>> from microlib.membrane import dimple_profile
    >>> dimple_profile([25.0, 100.0, 250.0], 250.0, 40.0, probe_half_width=25.0).round(3).tolist()
    [40.0, 10.982, 0.0]
    """
    values = check_inputs(rim_radius, dimple_depth, probe_half_width, radius=radius)
    r, a, c = values["radius"], values["rim_radius"], values["probe_half_width"]
    if (outside := (r < c) | (r > a)).any():
        worst = np.broadcast_to(r, outside.shape)[outside].flat[0]
        raise ValueError(
            f"radius must lie between probe_half_width and rim_radius, got {worst:g} µm"
        )
    return values["dimple_depth"] * log_remainder(r / a, 2) / log_remainder(c / a, 2)


def membrane_stress(
    force: ArrayLike,
    rim_radius: ArrayLike,
    dimple_depth: ArrayLike,
    *,
    thickness: ArrayLike,
    probe_half_width: ArrayLike,
) -> Array:
    r"""Return the uniform stress of the dimple's membrane, (4.3) solved for the stress.

    With this stress the membrane and the pressure balance the force on every circle (4.1).

    .. math:: \sigma_d = -\frac{F}{4\pi h w_d}\left[1-\zeta^2+\ln\zeta^2\right]

    Parameters
    ----------
    force : array_like
        Indentation force F, in µN.
    rim_radius, dimple_depth, thickness, probe_half_width : array_like
        As for `elastic_modulus`.

    Returns
    -------
    ndarray
        Stress, in MPa; the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        As for `elastic_modulus`, except that a depth below the thickness is accepted.

    Examples
    --------
    >>> from microlib.membrane import membrane_stress
    >>> stress = membrane_stress(50.0, 250.0, 40.0, thickness=3.0, probe_half_width=25.0)
    >>> print(f"{stress:.4f} MPa")
    0.1199 MPa
    """
    values = check_inputs(rim_radius, dimple_depth, probe_half_width, thickness, force=force)
    zeta = values["probe_half_width"] / values["rim_radius"]
    scale = values["force"] / (4 * np.pi * values["thickness"] * values["dimple_depth"])
    return -scale * log_remainder(zeta, 2)


def mean_strain(
    rim_radius: ArrayLike,
    dimple_depth: ArrayLike,
    *,
    probe_half_width: ArrayLike,
    small_slopes: bool = True,
) -> Array:
    r"""Return the mean strain of the dimple, equations (4.4) and (4.5).

    .. math:: \bar\varepsilon_d = \frac12
              \frac{\int_c^a \frac12 (dw/dr)^2\, r\,dr}{\int_c^a r\,dr}
              = -\frac{w_d^2}{2a^2}
              \frac{3-4\zeta^2+\zeta^4+2\ln\zeta^2}{(1-\zeta^2)(1-\zeta^2+\ln\zeta^2)^2}

    Parameters
    ----------
    rim_radius, dimple_depth, probe_half_width : array_like
        Geometry a, w_d and c, in µm.
    small_slopes : bool
        Whether to use the small-slope strain :math:`\frac12(dw/dr)^2` of (4.4). If False, the
        exact :math:`\sqrt{1+(dw/dr)^2}-1` is used.

    Returns
    -------
    ndarray
        Strain, without unit; the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        If a length is not positive or `probe_half_width` is not below `rim_radius`.

    Notes
    -----
    A ring of width dr is stretched to dr/cos θ. Its strain is 1/cos θ − 1 = √(1 + tan²θ) − 1, of
    which (4.4) keeps the first term, (tan² θ)/2. The first factor ½ of (4.5) makes the mean over
    both directions: the hoop strain is zero if no point moves along the radius. Both strains use
    the profile (4.2). The ratio of the exact strain to that of (4.5) is therefore the factor by
    which the approximation (4.4) alone changes the modulus of (5.2). The exact strain is integrated
    numerically. Its error is that of rounding for w_d/a up to 1.

    Examples
    --------
    >>> from microlib.membrane import mean_strain
    >>> print(f"{mean_strain(250.0, 40.0, probe_half_width=25.0):.6f}")
    0.006183
    >>> geometry = {"rim_radius": 250.0, "dimple_depth": [2.5, 120.0], "probe_half_width": 25.0}
    >>> ratio = mean_strain(**geometry) / mean_strain(**geometry, small_slopes=False)
    >>> ratio.round(4).tolist()
    [1.0002, 1.2695]
    """
    values = check_inputs(rim_radius, dimple_depth, probe_half_width)
    zeta = values["probe_half_width"] / values["rim_radius"]
    steepness = values["dimple_depth"] / values["rim_radius"]
    if small_slopes:
        shape = log_remainder(zeta, 3) / (annulus(zeta) * log_remainder(zeta, 2) ** 2)
        return -(steepness**2) * shape
    # ρ = r/a runs over [ζ, 1] as ζ^t, t in [0, 1]; dρ = ln ζ · ρ dt.
    nodes, weights = GAUSS
    rho = zeta[..., np.newaxis] ** ((nodes + 1) / 2)
    slope = 2 * steepness[..., np.newaxis] * (1 / rho - rho)
    slope = slope / log_remainder(zeta, 2)[..., np.newaxis]
    # √(1+s²) − 1, written without cancellation.
    stretch = slope**2 / (np.sqrt(1 + slope**2) + 1)
    integral = np.sum(weights / 2 * stretch * rho**2, axis=-1) * -np.log(zeta)
    return integral / annulus(zeta)


def annulus(zeta: Array) -> Array:
    """Return 1 − ζ² without cancellation near ζ = 1."""
    return (1 - zeta) * (1 + zeta)


def log_remainder(zeta: Array, first: int) -> Array:
    """Return −Σ_{k ≥ first} xᵏ/k, x = 1 − ζ²: the Taylor remainder of ln ζ² = ln(1 − x)."""
    x = annulus(zeta)
    # The closed form loses about x⁻³ roundings to cancellation. S is right to 2e-12 for any limit
    # from 0.01 to 0.2 and for 12 terms or more, measured against 60 digits.
    small = x < 0.05
    order = np.arange(first, first + 16)
    # Where the series is not used, x = 0 keeps its powers from underflow.
    series = -np.sum(np.where(small, x, 0.0)[..., np.newaxis] ** order / order, axis=-1)
    closed = 2 * np.log(zeta) + sum(x**k / k for k in range(1, first))
    return np.where(small, series, closed)


def force_per_modulus(values: Mapping[str, Array]) -> Array:
    """Return F/E of (4.7), in µm²."""
    a, c = values["rim_radius"], values["probe_half_width"]
    numerator = 2 * np.pi * values["thickness"] * values["dimple_depth"] ** 3
    # S(ζ) of (4.7). With x = 1 − ζ² and R_n the Taylor remainder of ln(1 − x) from xⁿ on, its
    # numerator is 2 R₃ and the base of its cube R₂.
    shape = 2 * log_remainder(c / a, 3) / (annulus(c / a) * log_remainder(c / a, 2) ** 3)
    return numerator / (a**2 * (1 - values["poisson_ratio"])) * shape


def check_inputs(
    rim_radius: ArrayLike,
    dimple_depth: ArrayLike,
    probe_half_width: ArrayLike,
    thickness: ArrayLike = 1.0,
    poisson_ratio: ArrayLike = 0.0,
    **others: ArrayLike,
) -> dict[str, Array]:
    """Return the sizes of a dimple and `others` as arrays by name; all must be positive.

    Raises `ValueError` where the probe is not narrower than the dimple.
    """
    others |= {"rim_radius": rim_radius, "dimple_depth": dimple_depth}
    others |= {"probe_half_width": probe_half_width, "thickness": thickness}
    values = {name: as_positive(name, value) for name, value in others.items()}
    values["poisson_ratio"] = ratio = as_array("poisson_ratio", poisson_ratio)
    as_poisson_ratio(ratio.min())
    as_poisson_ratio(ratio.max())
    np.broadcast_shapes(*(array.shape for array in values.values()))  # raises a ValueError itself
    c, a = np.broadcast_arrays(values["probe_half_width"], values["rim_radius"])
    if (c >= a).any():
        worst = np.argmax(c / a)
        raise ValueError(
            "probe_half_width must be below rim_radius (0 < c/a < 1), "
            f"got {c.flat[worst]:g} and {a.flat[worst]:g} µm"
        )
    return values


def warn_if_implausible(modulus: ArrayLike) -> None:
    """Warn of a modulus outside the range of materials, as lengths in mm or forces in N give."""
    _, lowest, highest = PHYSICAL_RANGES["modulus"]
    outside = [
        value for value in (np.min(modulus), np.max(modulus)) if value < lowest or value > highest
    ]
    if outside:
        warnings.warn(
            f"a modulus of {outside[-1]:.3g} MPa is outside the range of membranes: lengths must "
            "be in µm and forces in µN",
            stacklevel=3,
        )


def check_bending(name: str, depth: ArrayLike, thickness: ArrayLike) -> None:
    """Raise for a dimple less deep than the membrane is thick, and warn up to twice the thickness.

    The force on a clamped plate that only bends is F = 16π D w_d/a² with D = E h³/(12(1 − ν²)). At
    w_d = h, c/a = 0.1 and ν = 0.5 it is 3.3 times the force of (4.7), and at 2h it is 0.8 times.
    """
    shallowest = float(np.min(np.divide(depth, thickness)))
    if shallowest < 1:
        raise ValueError(
            f"{name} must be at least the thickness, since a shallower membrane resists mainly by "
            f"bending, got {shallowest:.2g} times: is the unit right?"
        )
    if shallowest < 2:
        warnings.warn(
            f"{name} is {shallowest:.2g} times the thickness: below two thicknesses the modulus is "
            "too high, because the model omits bending",
            stacklevel=3,
        )


def _warn_if_steep(rim_radius: Array, depth: Array) -> None:
    steepest = float(np.max(depth / rim_radius))
    if steepest > SmallSlopeWarning.limit:
        warnings.warn(
            f"w_d/a = {steepest:.2f} > {SmallSlopeWarning.limit}: small slopes make the modulus of "
            "(5.2) too low, by 4 to 11 % at 0.1 and 20 % at 0.2; compare model_moduli",
            SmallSlopeWarning,
            stacklevel=3,
        )
