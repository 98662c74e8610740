"""A closed, fluid-filled capsule pressed by a probe on a flat plate: force, modulus and shape.

The chorion of an embryo is a closed bag of a fluid that hardly leaks within seconds, so that its
volume is constant during a test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microlib._common import FlatResult, as_scalar, positive_scalars
from microlib.membrane._point_load import warn_if_implausible
from microlib.membrane.large._capsule_problem import (
    CapsuleProblem,
    PrescribedDimple,
    PrescribedForce,
    Zones,
)
from microlib.membrane.large._laws import constitutive_law
from microlib.membrane.large._solver import MembraneState, dimensional_state, meridian_curve


@dataclass(frozen=True, eq=False, repr=False)
class CapsuleModulus(FlatResult):
    """Modulus and inflation of an indented capsule, from `capsule_modulus`.

    Attributes
    ----------
    modulus : float
        Elastic modulus E at small strain, in MPa.
    inflation : float
        Stretch of the wall before the test.
    exponents : dict of str to float
        Relative change of the modulus per relative change of each length: of ``rim_radius``,
        ``depth``, ``probe_half_width`` and ``capsule_radius``. The modulus is proportional to the
        force and to the inverse of the thickness.
    state : MembraneState
        The capsule of the given shape.
    """

    modulus: float
    inflation: float
    exponents: dict[str, float]
    state: MembraneState


def indent_capsule(
    force: float,
    *,
    modulus: float,
    capsule_radius: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    law: str = "neo-hooke",
    inflation: float = 1.0,
) -> MembraneState:
    r"""Compute shape and stress of a fluid-filled capsule between a flat probe and a smooth plate.

    Parameters
    ----------
    force : float
        Force F of the probe, in µN. A force that is too small to flatten the wall on the whole face
        of the probe is rejected.
    modulus : float
        Elastic modulus E at small strain, in MPa.
    capsule_radius : float
        Radius R of the inflated capsule before the test, in µm.
    thickness : float
        Thickness h of the stress-free wall, before inflation, in µm.
    probe_half_width : float
        Radius c of the probe's flat end, in µm, below `capsule_radius`. The wall is
        bonded to it.
    poisson_ratio : float
        ν, in (−1, 0.5] for ``"hooke"``, and 0.5 for the incompressible laws.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Constitutive law, as for `indent_disc`.
    inflation : float, optional
        Stretch of the wall before the test, at least 1: R over the stress-free radius.

    Returns
    -------
    MembraneState
        `depth` of the probe's end below the dimple's crest (µm). `approach`, 2R minus the height of
        the probe's end above the plate (µm). `rim_radius` of the crest, which is also that of the
        contact on the plate (µm). Meridian `r`, `z` from the probe to the middle of the plate (µm).
        `stretches` and nominal `stresses` (MPa) along the meridian and around the axis, (2, N)
        each. `pressure` above the outside pressure (MPa).

    Raises
    ------
    ValueError
        If an argument is out of its range, the force is too small to flatten the wall on the whole
        face of the probe, the force has no equilibrium with a dimple above the plate, or the solver
        does not converge.

    See Also
    --------
    capsule_modulus : The inverse.

    Notes
    -----
    The model assumes an axisymmetric wall without bending stiffness, an incompressible fluid
    that does not leak, no friction on the plate and a wall bonded to the probe. A force below about
    :math:`\pi c^2 p` does not flatten the wall on the whole face of the probe, and is rejected.
    An uninflated capsule is solved only above about 1e-3 E h R; an inflation of 1.001 suffices for
    smaller forces.

    A point at the undeformed arc length S, counted from the middle of the plate, has the undeformed
    radius ρ = (R/λ) sin(λS/R) and moves to r(S), z(S). With the tensions per radian H and V of
    `indent_disc`,

    .. math::

        V &= \frac{p r^2}{2} - \frac{F}{2\pi},\\
        H' &= h N_2 - p\, r z',\\
        \sqrt{H^2 + V^2} &= h \rho N_1,\\
        (r', z') &= \lambda_1 (H, V)/\sqrt{H^2 + V^2},

    where primes are derivatives with respect to S (derived here). These equations hold off the
    plate; on the plate V = 0. The pressure p keeps the volume :math:`\frac43 \pi R^3`. V is also
    zero at the crest of the dimple. Crest and contact have therefore the radius :math:`a =
    \sqrt{F/(\pi p)}` for every law.

    The wall is wrinkled where its hoop stress would be negative (relaxed energy of tension-field
    theory). In the middle of the plate both stresses may vanish, and the wall is slack there.

    References
    ----------
    A. Patil, A. Nordmark, A. Eriksson, *Instabilities of wrinkled membranes with pressure
    loadings*, J. Mech. Phys. Solids, 2016, use the relaxed energy for axisymmetric membranes under
    fluid pressure (abstract).

    Examples
    --------
    >>> from microlib.membrane import indent_capsule
    >>> state = indent_capsule(
    ...     100.0, modulus=1.0, capsule_radius=600.0, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5, inflation=1.05,
    ... )
    >>> print(f"{state.depth:.2f} µm deep, rim at {state.rim_radius:.2f} µm")
    65.35 µm deep, rim at 184.90 µm
    """
    load, stiffness = positive_scalars(force=force, modulus=modulus)
    stretch = as_scalar("inflation", inflation, least=1)
    r0, h, c = _check_sizes(capsule_radius, thickness, probe_half_width)
    material = constitutive_law(law, poisson_ratio)
    unit = stiffness * h * r0
    try:
        problem, solution = CapsuleProblem(
            material, c / r0, PrescribedForce(load / unit, stretch)
        ).solve()
        u = problem.unpack(solution.p)
        if u.rim <= problem.probe:  # the rim of a dimple lies outside the probe
            least = np.pi * problem.probe**2 * u.pressure * unit
            raise ValueError(
                "the wall would not be flat on the whole face of the probe, which takes about "
                f"{least:.3g} µN"
            )
        return _state(problem, solution, stiffness, h, r0)
    except ValueError as reason:
        raise ValueError(
            f"force must be one that the capsule holds, got {load:g} µN: {reason}"
        ) from None


def capsule_modulus(
    force: float,
    rim_radius: float,
    depth: float,
    *,
    capsule_radius: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    law: str = "neo-hooke",
) -> CapsuleModulus:
    r"""Return the elastic modulus and the inflation of a capsule from its dimple and its radius.

    Parameters
    ----------
    force : float
        Force F, in µN.
    rim_radius : float
        Radius a of the dimple's crest, in µm.
    depth : float
        Depth w_d of the probe's end below the crest, in µm.
    capsule_radius, thickness, probe_half_width, poisson_ratio, law
        As for `indent_capsule`.

    Returns
    -------
    CapsuleModulus
        `modulus` (MPa), `inflation`, the `exponents` of the lengths in the modulus, and the `state`
        of the capsule, as from `indent_capsule`.

    Raises
    ------
    ValueError
        If an argument is out of its range, if no inflated capsule has this shape, if the depth does
        not determine the modulus, see Notes, or if the solver does not converge, as for some
        shallow dimples.

    Warns
    -----
    UserWarning
        As for `elastic_modulus`, if the modulus is outside the range of membranes.

    Notes
    -----
    The assumptions are those of `indent_capsule`. The rim radius determines the pressure,
    :math:`p = F/(\pi a^2)`. The shape depends on the inflation and on F/(E h R) alone, and a/R and
    w_d/R determine both. The modulus is sensitive to R: at the dimple of the thesis, E is 2.15 MPa
    for R = 500 µm and 0.84 MPa for 700 µm.

    With increasing inflation at the same rim, the depth increases to a maximum and decreases to
    that of a uniform tension. Near the maximum, two capsules of different moduli have the same
    dimple, and the depth hardly depends on the modulus. A dimple is therefore rejected if 1 % of
    its depth changes the modulus by more than 20 %, or if the modulus increases with the depth.
    Such dimples are shallow or under a wide probe.

    Examples
    --------
    >>> from microlib.membrane import capsule_modulus
    >>> egg = capsule_modulus(
    ...     197.24, 246.95, 121.22, capsule_radius=600.0, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5,
    ... )
    >>> print(f"{egg.modulus:.2f} MPa, inflated by {egg.inflation:.3f}")
    1.12 MPa, inflated by 1.042
    """
    load, a, deep = positive_scalars(force=force, rim_radius=rim_radius, depth=depth)
    r0, h, c = _check_sizes(capsule_radius, thickness, probe_half_width)
    material = constitutive_law(law, poisson_ratio)
    if not c < a < r0:
        raise ValueError(
            f"rim_radius must lie between probe_half_width {c:g} and capsule_radius {r0:g}, "
            f"got {a:g}"
        )
    try:
        problem, solution = CapsuleProblem(
            material, c / r0, PrescribedDimple(a / r0, deep / r0)
        ).solve()
        u = problem.unpack(solution.p)
        if u.inflation < 1 - 1e-6:  # the residual of the solution
            raise ValueError(f"an inflation of {u.inflation:.4f} would be needed")
        modulus = load / (u.force * h * r0)
        state = _state(problem, solution, modulus, h, r0)
        exponents = _exponents(problem, solution)
        if not -20 < (exponent := exponents["depth"]) < 0:
            raise ValueError(
                "the depth does not determine the modulus, because 1 % of the depth changes the "
                f"modulus of {modulus:.3g} MPa by {exponent:.0f} %"
            )
    except ValueError as reason:
        raise ValueError(
            f"depth must be one that a capsule of radius {r0:g} has at rim_radius {a:g}, "
            f"got {deep:g}: {reason}"
        ) from None
    warn_if_implausible(modulus)
    return CapsuleModulus(modulus, float(u.inflation), exponents, state)


def _exponents(problem: CapsuleProblem, solution: Any) -> dict[str, float]:
    """Return the exponents of the lengths in the modulus, from solutions for other lengths."""
    growth = 1.001
    given: Any = problem.given
    changed = {
        "rim_radius": replace(problem, given=replace(given, rim=growth * given.rim)),
        "depth": replace(problem, given=replace(given, depth=growth * given.depth)),
        "probe_half_width": replace(problem, probe=growth * problem.probe),
    }
    force, exponents = problem.unpack(solution.p).force, {}
    for name, other in changed.items():
        near = other.collocate((solution.x, solution.y, solution.p))
        if near is None:
            raise problem.failure
        ratio = force / other.unpack(near.p).force
        exponents[name] = float(np.log(ratio) / np.log(growth))
    # E h R/F depends on the ratios of the lengths alone.
    exponents["capsule_radius"] = -1 - sum(exponents.values())
    return exponents


def _check_sizes(
    capsule_radius: float, thickness: float, probe_half_width: float
) -> tuple[float, float, float]:
    r0, h = positive_scalars(capsule_radius=capsule_radius, thickness=thickness)
    return r0, h, as_scalar("probe_half_width", probe_half_width, above=0, below=r0)


def _state(
    problem: CapsuleProblem, solution: Any, modulus: float, thickness: float, radius: float
) -> MembraneState:
    """Return the state of a solution that does not intersect the plate, the probe or itself."""
    u, zones = problem.unpack(solution.p), Zones.unpack(solution.y)
    dimple = zones.dimple
    clear = dimple.horizontal[-1] < 0 and dimple.r.min() >= (1 - 1e-9) * problem.probe
    ordered = 0 < u.middle_arc < u.contact_arc < np.pi / 2 < u.crest_arc <= problem.probe_arc
    for possible, fault in (
        (dimple.z.min() > 0, "the probe would reach the plate"),
        (clear, "the wall would touch the probe's side"),
        (ordered, "the dimple would reach the contact on the plate"),
    ):
        if not possible:
            raise ValueError(fault)
    # The middle of the plate belongs to no zone.
    rho = np.sin(u.middle_arc) / u.inflation
    stretch, stress = np.nan, 0.0  # where it is slack, the stretch is undetermined
    if not problem.slack:
        stretch = zones.contact.r[0] / rho
        stress = problem.law.equibiaxial_stress(stretch)
    middle = np.array([0.0, 0.0, stretch, stretch, stress, stress])
    # From the probe's edge to the middle of the plate. Zones share their ends.
    segments = problem.segments(solution.x, solution.y, solution.p)
    parts = [meridian_curve(problem.law, part)[:, ::-1] for part in reversed(segments)]
    curve = np.column_stack([*parts, middle])
    repeated = np.flatnonzero(np.hypot(*np.diff(curve[:2])) < 1e-12) + 1
    sizes = {"depth": dimple.z[0] - dimple.z[-1], "approach": 2 - dimple.z[-1]}
    sizes |= {"rim_radius": u.rim, "pressure": u.pressure}
    curve = np.delete(curve, repeated, axis=1)
    return dimensional_state(curve, modulus, thickness, radius, **sizes)
