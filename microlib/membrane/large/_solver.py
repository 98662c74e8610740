"""Equilibrium of an axisymmetric membrane: collocation, and the result.

The membrane is a curve, its meridian, in one or several segments. Quantities are dimensionless.
Tensions are per radian around the axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_bvp

from microlib._common import Array, FlatResult
from microlib.membrane.large._laws import Law

#: Mesh, state and unknown parameters (None without any) from which a collocation starts.
Guess = tuple[Array, Array, Array | None]


class Segment(NamedTuple):
    """State of a part of the meridian at values of x in [0, 1]."""

    rho: Array  # undeformed radius ρ
    arc_rate: Array  # dS/dx of the undeformed arc length S
    r: Array
    z: Array
    tension: Array  # A = ρ N₁ = √(H² + V²), dimensionless
    cosine: Array  # H/A, the direction of the tension: outwards
    sine: Array  # V/A, upwards
    pressure: float


def segment(
    rho: Array,
    arc_rate: Array,
    r: Array,
    z: Array,
    horizontal: Array,
    force: float,
    pressure: float,
) -> Segment:
    """Return the segment with the horizontal tension H and V = p r²/2 − F/2π."""
    vertical = pressure * r**2 / 2 - force / (2 * np.pi)
    if not vertical.any():  # a level segment, in which a negative tension is a compression
        return Segment(rho, arc_rate, r, z, horizontal, np.ones_like(r), np.zeros_like(r), pressure)
    tension = np.hypot(horizontal, vertical)
    # The direction of a slack meridian is undetermined.
    size = np.maximum(tension, np.finfo(float).tiny)
    return Segment(rho, arc_rate, r, z, tension, horizontal / size, vertical / size, pressure)


def collocate(
    right_hand_side: Callable[..., Array],
    boundary_residual: Callable[..., Array],
    guess: Guess,
    *,
    tolerance: float,
    max_nodes: int,
) -> Any:
    """Return the solution of SciPy's `solve_bvp` over x in [0, 1], or None without convergence."""
    with np.errstate(all="ignore"):
        solution = solve_bvp(
            right_hand_side, boundary_residual, *guess, tol=tolerance, max_nodes=max_nodes
        )
    # NaN is above no tolerance, so that a solution of NaN has the status of a success.
    converged = solution.status == 0 and np.isfinite(solution.rms_residuals).all()
    return solution if converged else None


def stretch_and_hoop_stress(law: Law, part: Segment) -> tuple[Array, Array]:
    """Return the stretch of the meridian and the nominal hoop stress."""
    return law.invert_meridian_stress(part.tension / part.rho, part.r / part.rho)


def equilibrium(law: Law, part: Segment) -> tuple[Array, Array, Array]:
    """Return dr/dx, dz/dx and dH/dx: r' = λ₁H/A, z' = λ₁V/A, H' = N₂ − p r z'."""
    first, hoop = stretch_and_hoop_stress(law, part)
    r_rate, z_rate = first * part.cosine, first * part.sine
    horizontal_rate = hoop - part.pressure * part.r * z_rate
    return r_rate * part.arc_rate, z_rate * part.arc_rate, horizontal_rate * part.arc_rate


def meridian_curve(law: Law, part: Segment) -> Array:
    """Return r, z, both stretches and both stresses at the nodes of a segment, (6, n)."""
    first, hoop = stretch_and_hoop_stress(law, part)
    stretches, along = (first, part.r / part.rho), part.tension / part.rho
    return np.array([part.r, part.z, *stretches, along, hoop])


@dataclass(frozen=True, eq=False, repr=False)
class MembraneState(FlatResult):
    r"""A membrane in equilibrium under a probe, from `indent_disc` or `indent_capsule`.

    Attributes
    ----------
    depth : float
        Depth of the probe's edge below the rim, in µm.
    approach : float
        Distance that the probe has moved since it touched, in µm.
    rim_radius : float
        Radius a of the rim, in µm. The rim of a disc is its clamped edge. The rim of a capsule is
        the crest of its dimple, whose radius is also that of the contact on the plate. Depth,
        approach and rim radius of a capsule without a force are 0.
    r, z : ndarray, shape (N,)
        Meridian from the probe's edge to the rim of the disc or to the middle of the plate:
        distance from the axis, and height above the plane of the rim or above the plate, in µm.
    stretches : ndarray, shape (2, N)
        Stretches along the meridian and around the axis, relative to the stress-free membrane. A
        slack middle has one node, r = 0, with NaN.
    stresses : ndarray, shape (2, N)
        Nominal stresses in the same directions, force per undeformed section, in MPa. The hoop
        stress is zero where the membrane is wrinkled.
    pressure : float
        Pressure below the disc, or pressure inside the capsule above the outside pressure, in MPa.

    Notes
    -----
    The true stress of an incompressible membrane is :math:`\lambda_i` times the nominal stress.
    """

    _large = ("r", "z", "stretches", "stresses")

    depth: float
    approach: float
    rim_radius: float
    r: Array
    z: Array
    stretches: Array
    stresses: Array
    pressure: float


def dimensional_state(
    curve: Array,
    modulus: float,
    thickness: float,
    length: float,
    *,
    pressure: float,
    depth: float = 0.0,
    approach: float = 0.0,
    rim_radius: float = 0.0,
) -> MembraneState:
    """Return a state in units from the dimensionless curve of `meridian_curve` and sizes."""
    return MembraneState(
        depth=float(depth * length),
        approach=float(approach * length),
        rim_radius=float(rim_radius * length),
        pressure=float(pressure * modulus * thickness / length),
        r=curve[0] * length,
        z=curve[1] * length,
        stretches=curve[2:4],
        stresses=curve[4:] * modulus,
    )
