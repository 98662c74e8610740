r"""The point-load model without the small-slope approximations of (4.1) and (4.4).

The thesis replaces :math:`\sin\theta` by the slope in the force balance (4.1), and
:math:`1/\cos\theta - 1` by :math:`\theta^2/2` in the strain (4.4). Here both stay exact. All other
assumptions are those of the model, among them a stress that is the same at every radius and in both
directions. Such a stress cannot balance a dimple deeper than `steepest_depth`. A stress that varies
along the radius can (see `disc_modulus`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from microlib._common import as_poisson_ratio, as_scalar, positive_scalars
from microlib.membrane._point_load import GAUSS, check_bending


def steepest_depth(rim_radius: float, *, probe_half_width: float) -> float:
    r"""Return the depth at which a membrane under uniform stress is vertical at the probe.

    Parameters
    ----------
    rim_radius, probe_half_width : float
        a and c, in µm.

    Returns
    -------
    float
        Depth w_d, in µm. A deeper dimple needs a stress that varies along the radius.

    Raises
    ------
    ValueError
        If a length is not positive or `probe_half_width` is not below `rim_radius`.

    Notes
    -----
    The force balance (4.1) with the exact sine is :math:`\sin\theta = k(1/r - r/a^2)` with
    :math:`k = F/(2\pi\sigma_d h)`. The sine is largest at the probe, and it is 1 there for
    :math:`k = 1/(1/c - c/a^2)`. No larger k, and so no smaller uniform stress, has a solution.

    Examples
    --------
    >>> from microlib.membrane import steepest_depth
    >>> print(f"{steepest_depth(250.0, probe_half_width=25.0):.1f} µm")
    62.1 µm
    """
    a, c = _geometry(rim_radius, probe_half_width)
    return _depth(1.0, a, c)


def finite_slope_modulus(
    force: float,
    rim_radius: float,
    dimple_depth: float,
    *,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
) -> float:
    r"""Return the elastic modulus from one indentation for finite slopes under a uniform stress.

    Parameters
    ----------
    force, rim_radius, dimple_depth, thickness, probe_half_width, poisson_ratio : float
        As for `microlib.membrane.elastic_modulus`: µN, µm, and no unit for the last.

    Returns
    -------
    float
        Modulus E, in MPa.

    Raises
    ------
    ValueError
        If an argument is out of its range or is not a single number, or if `dimple_depth` is above
        `steepest_depth`, where no uniform stress balances the force, or below the thickness.

    Warns
    -----
    UserWarning
        If `dimple_depth` is below two thicknesses, where bending carries a part of the force.

    Notes
    -----
    The depth :math:`\int_c^a \tan\theta\,dr` with :math:`\sin\theta = k(1/r - r/a^2)` determines k.
    The stress is :math:`F/(2\pi k h)`. The strain is half the mean of :math:`1/\cos\theta - 1` over
    the annulus, as in (4.5).

    Examples
    --------
    >>> from microlib.membrane import finite_slope_modulus
    >>> modulus = finite_slope_modulus(
    ...     50.0, 250.0, 40.0, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{modulus:.2f} MPa")
    11.09 MPa
    """
    a, c = _geometry(rim_radius, probe_half_width)
    load, depth, h = positive_scalars(force=force, dimple_depth=dimple_depth, thickness=thickness)
    nu = as_poisson_ratio(poisson_ratio)
    check_bending("dimple_depth", depth, h)
    if depth > (steepest := _depth(1.0, a, c)):
        raise ValueError(
            f"dimple_depth must be at most {steepest:.4g} µm (steepest_depth), since no uniform "
            f"stress balances a deeper dimple, got {depth:.4g} µm"
        )
    # sin θ at the probe, in (0, 1], is proportional to k and takes its place as the unknown.
    sine_at_probe = brentq(
        lambda sine: _depth(sine, a, c) - depth, 0.0, 1.0, xtol=np.finfo(float).eps
    )
    stress = load * (1 / c - c / a**2) / (2 * np.pi * sine_at_probe * h)
    r, dr, sine = _profile(sine_at_probe, a, c)
    cosine = np.sqrt((1 - sine) * (1 + sine))
    # 1/cos − 1 without cancellation.
    stretch = sine**2 / (cosine * (1 + cosine))
    strain = np.sum(stretch * r * dr) / (a**2 - c**2)
    return float(stress * (1 - nu) / strain)


def _geometry(rim_radius: float, probe_half_width: float) -> tuple[float, float]:
    a = as_scalar("rim_radius", rim_radius, above=0)
    return a, as_scalar("probe_half_width", probe_half_width, above=0, below=a)


def _profile(sine_at_probe: float, a: float, c: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return radii, quadrature weights and sin θ."""
    # r = c + (a − c) t² removes the square-root singularity of a vertical membrane.
    nodes, weights = GAUSS
    t = (nodes + 1) / 2
    r = c + (a - c) * t**2
    sine = sine_at_probe * (1 / r - r / a**2) / (1 / c - c / a**2)
    return r, weights * (a - c) * t, sine


def _depth(sine_at_probe: float, a: float, c: float) -> float:
    """Return ∫ tan θ dr."""
    _, dr, sine = _profile(sine_at_probe, a, c)
    return float(np.sum(sine / np.sqrt((1 - sine) * (1 + sine)) * dr))
