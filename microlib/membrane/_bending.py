r"""What bending adds to a membrane: a correction, from the shape that the membrane has.

A wall of thickness h resists bending with :math:`D = E h^3/(12(1-\nu^2))`. In a taut capsule that
is little, and first-order perturbation gives it. Without any tension it is all that a sphere has:
its dimple is a mirrored cap whose ridge is bent.
"""

from __future__ import annotations

import numpy as np

from microlib._common import Array, scalar
from microlib.membrane._capsule import indent_capsule
from microlib.membrane._state import MembraneState

__all__ = ["capsule_bending_force", "mirror_dimple_force"]

#: min ∫(φ′² + v²) dx with v′ = (1 − φ²)/2 over all x, φ(±∞) = ±1, v(±∞) = 0; solved numerically,
#: and again in the tests.
RIDGE_INTEGRAL = 2.2232202

# Half the relative step of the force between the two states whose energies are compared.
_STEP = 0.005


def mirror_dimple_force(
    depth: float, *, modulus: float, radius: float, thickness: float, poisson_ratio: float
) -> float:
    r"""
    Force that a spherical shell without pressure needs for a dimple, by bending alone.

    Parameters
    ----------
    depth : float
        Depth δ by which the top of the sphere is pressed in, in µm; many times `thickness`.
    modulus, radius, thickness : float
        E in MPa, R and h in µm.
    poisson_ratio : float
        ν, in (−1, 1).

    Returns
    -------
    float
        Force F, in µN.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if `depth` is not below `radius`.

    See Also
    --------
    capsule_bending_force : The correction for a capsule under tension.

    Notes
    -----
    The dimple is the mirror image of the cap that it replaces, with a ridge of radius
    :math:`a = \sqrt{R\delta}` and slopes :math:`\mp a/R`. The ridge bends and stretches around the
    axis on a width :math:`L = (D R^2/(E h))^{1/4}`, which gives the energy
    :math:`\pi J D a^3/(R^2 L)` and

    .. math:: F = \frac{3\pi}{2}\, J\, \frac{D}{L}\sqrt{\frac{\delta}{R}}, \qquad J = 2.22322

    The model is Pogorelov's, read in the abstract of S. Knoche, J. Kierfeld, *The secondary
    buckling transition: wrinkling of buckled spherical shells* (arXiv:1408.0946, 2014); the
    formula and J are derived here.

    Examples
    --------
    >>> force = mirror_dimple_force(
    ...     121.0, modulus=1.1, radius=600.0, thickness=3.0, poisson_ratio=0.5
    ... )
    >>> print(f"{force:.2f} µN")
    0.63 µN
    """
    delta, r0 = scalar("depth", depth, above=0), scalar("radius", radius, above=0)
    if delta >= r0:
        raise ValueError(f"depth must be below radius {r0:g}, got {delta:g}")
    h, stiffness = scalar("thickness", thickness, above=0), scalar("modulus", modulus, above=0)
    rigidity = _rigidity(stiffness, h, poisson_ratio)
    width = (rigidity * r0**2 / (stiffness * h)) ** 0.25
    return float(1.5 * np.pi * RIDGE_INTEGRAL * rigidity / width * np.sqrt(delta / r0))


def capsule_bending_force(
    force: float,
    *,
    modulus: float,
    radius: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float = 0.5,
    law: str = "neo-hooke",
    inflation: float = 1.0,
    support: str = "plate",
) -> float:
    r"""
    Force that bending adds to a capsule at the shape that `indent_capsule` finds.

    Parameters
    ----------
    force, modulus, radius, thickness, probe_half_width, poisson_ratio, law, inflation, support
        As for `indent_capsule`; the probe is bonded.

    Returns
    -------
    float
        The force beyond `force` that a wall with bending needs for the same approach, in µN: an
        estimate of the first order in the rigidity, in excess where it is not small.

    Raises
    ------
    ValueError
        As for `indent_capsule`.

    Notes
    -----
    To the first order in D the added energy is that of the membrane's own shape,
    :math:`U_b = \frac{D}{2}\int (k_1^2 + k_2^2 + 2\nu k_1 k_2)\,dA` over the undeformed area with
    the changes of curvature :math:`k_i = \lambda_i\kappa_i - \lambda/R`, and the added force is
    :math:`dU_b/d\delta`, taken between states at ± 0.5 % of the force. The curvatures follow from
    the membrane's balance, :math:`\kappa_1 T_1 + \kappa_2 T_2 = p`, without a derivative. At the
    edge of the bonded probe the membrane has a corner of angle θ; held level there, the wall turns
    it on the length :math:`\sqrt{D/T_1}` with the energy :math:`4\sqrt{D T_1}\,(1 -
    \cos\frac{\theta}{2})` per length (derived here).

    Examples
    --------
    >>> added = capsule_bending_force(
    ...     100.0, modulus=1.0, radius=600.0, thickness=3.0, probe_half_width=25.0, inflation=1.05
    ... )
    >>> print(f"{added:.1f} µN")
    0.7 µN
    """
    load = scalar("force", force, above=0)
    nu = scalar("poisson_ratio", poisson_ratio, within=(-1, 1))
    states = [
        indent_capsule(
            factor * load,
            modulus=modulus,
            radius=radius,
            thickness=thickness,
            probe_half_width=probe_half_width,
            poisson_ratio=poisson_ratio,
            law=law,
            inflation=inflation,
            support=support,
        )
        for factor in (1 - _STEP, 1 + _STEP)
    ]
    rigidity = _rigidity(modulus, thickness, nu)
    less, more = (
        _bending_energy(state, rigidity, nu, thickness, inflation / radius) for state in states
    )
    return float((more - less) / (states[1].approach - states[0].approach))


def _rigidity(modulus: float, thickness: float, poisson_ratio: float) -> float:
    nu = scalar("poisson_ratio", poisson_ratio, within=(-1, 1))
    return modulus * thickness**3 / (12 * (1 - nu**2))


def _bending_energy(
    state: MembraneState, rigidity: float, nu: float, thickness: float, natural: float
) -> float:
    """Return the energy of bending of a membrane's shape, `natural` its curvature at rest."""
    r, z = state.r, state.z
    first, second = np.nan_to_num(state.stretches, nan=1.0)
    along, across = thickness * state.stresses[0] / second, thickness * state.stresses[1] / first
    slope = _rise(state, along)
    on_plate = z == 0
    hoop = np.where(on_plate, 0.0, slope / np.maximum(r, 1e-300))
    with np.errstate(divide="ignore", invalid="ignore"):
        meridian = np.where(on_plate, 0.0, (state.pressure - hoop * across) / along)
    k1, k2 = first * meridian - natural, second * hoop - natural
    density = rigidity / 2 * (k1**2 + k2**2 + 2 * nu * k1 * k2)
    # Undeformed area between two points: 2πρ ds over both stretches.
    length = np.hypot(np.diff(r), np.diff(z))
    # A curvature that jumps, at the plate's edge, belongs to each side.
    ends = np.array([density[:-1], density[1:]])
    edge = np.flatnonzero(on_plate[1:] & ~on_plate[:-1])
    leaving = (state.pressure - 0.0) / along[edge + 1] * first[edge + 1] - natural
    ends[1, edge] = rigidity / 2 * (leaving**2 + natural**2 - 2 * nu * leaving * natural)
    weight = 2 * np.pi * r / (first * second)
    smooth = np.sum((ends[0] * weight[:-1] + ends[1] * weight[1:]) / 2 * length)
    angle = np.arcsin(np.clip(-slope[0], 0.0, 1.0))
    corner = 2 * np.pi * r[0] * 4 * np.sqrt(rigidity * along[0]) * (1 - np.cos(angle / 2))
    return float(smooth + corner)


def _rise(state: MembraneState, along: Array) -> Array:
    """Return the sine of the meridian's angle: V/(r T₁), V = p (r² − a²)/2."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = state.pressure * (state.r**2 - state.rim_radius**2) / (2 * state.r * along)
    return np.where(state.z == 0, 0.0, sine)
