r"""A closed, fluid-filled capsule pressed by a probe on top, on a flat plate.

The chorion of an embryo is a closed bag of a fluid that hardly leaks within seconds: what the probe
takes at the top, the whole shell has to give. The capsule is solved as it stands, for any depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_bvp

from microlib._common import Array, Tidy, one_of, scalar
from microlib.membrane._laws import Law, law_of, relaxed_stress
from microlib.membrane._state import MembraneState, gauss_points, reintegration_error

__all__ = ["CapsuleModulus", "capsule_modulus", "indent_capsule", "indent_near"]

_NODES = 40
_MOST_NODES = 1500
# Relative residual of the collocation: the depth is then good to about 1e-8.
_TOLERANCE = 1e-6
# Enough to see whether the middle of the plate is slack; a guess that needs more nodes is no good.
_ROUGH = 1e-3
_ROUGH_NODES = 800
# What two independent checks of a solution may leave.
_ACCEPTED = 1e-5
# The flat zones begin at this fraction of their arc, the rest of which is stretched evenly: the
# error falls with the fourth power.
_CORE = 0.01
# Force from which every capsule was found to be solved without help, and the steps away from it.
_EASY_FORCE = 0.03
_LADDER = 2.0
_RUNGS = 14
# A guess has at least this strain: far more than rounding, and its pressure has a logarithm.
_LEAST_STRETCH = 1e-12
_SPHERE = 4 * np.pi / 3
# A search starts from another's solution if the inflations differ by less than this, the logarithms
# of the forces by ten times as much, and the nodes stay below their number: beyond, a start from
# the sphere is faster (timed on the fits of outlines).
_NEAR = 0.02
_NEAR_NODES = 400


class _Unknowns(NamedTuple):
    """What the solver finds beside the shape; arcs are angles on the undeformed sphere."""

    pressure: float
    inflation: float
    force: float
    rim: float
    core: float  # where the plate zone begins
    plate: float  # where the shell leaves the plate
    crest: float  # where it is highest
    edge: float  # where it meets the probe's edge
    face_core: float  # where the zone below the probe begins, from the top pole


#: Of a radius or a thickness, µm: beyond, products of sizes leave the range of numbers.
_LARGEST = 1e12
#: Of a probe or a flattened spot, in radii: π less the arc of its edge is rounded to 4e-16, a
#: hundred-thousandth of the least one, which is what the checks of a solution accept.
_LEAST_WIDTH = 4e-11


@dataclass(frozen=True)
class _Capsule:
    """The problem without units: lengths in inflated radii R, forces in E h R."""

    law: Law
    probe: float
    tension: float  # size of the tension
    bonded: bool
    inflation: float | None = None
    force: float | None = None
    rim: float | None = None
    depth: float | None = None
    slack: bool = False  # the middle of the plate zone carries nothing
    partial: bool = False  # the probe's face touches on part of its width, so there is no dimple
    unit: float = np.nan  # E h R in µN, for messages

    def unpack(self, k: Array) -> _Unknowns:
        """Return the unknowns of the parameter vector."""
        values = list(k)
        # Of NumPy, whose quotients by zero are infinite: a step may go anywhere.
        pressure, plate = np.exp(values.pop(0)), values.pop(0)
        if self.force is None or self.inflation is None:
            assert self.rim is not None
            rim, inflation = self.rim, values.pop(0)
            force = np.pi * pressure * rim**2
        else:
            force, inflation = self.force, self.inflation
            rim = np.sqrt(force / (np.pi * pressure))
        core = values.pop(0) if self.slack else _CORE * plate
        face = np.arcsin(self.probe) if self.bonded else values.pop(0)
        crest = np.pi - face if self.partial else values.pop(0)
        # Two plates are alike.
        face_core = core if self.partial and self.slack else _CORE * face
        return _Unknowns(
            pressure, inflation, force, rim, core, plate, crest, np.pi - face, face_core
        )

    def flat(self, arc: Array, y: Array, u: _Unknowns) -> tuple[Array, ...]:
        """Return undeformed and deformed radius, the tension a radian, stretch and hoop stress."""
        rho = np.sin(arc) / u.inflation
        size = y[1] * self.tension
        first, hoop = self.law.meridian(size / rho, y[0] / rho)
        return rho, y[0], size, first, hoop

    def free(self, arc: Array, y: Array, u: _Unknowns) -> tuple[Array, ...]:
        """Return ρ, r, H, V, the size of (H, V), stretch and hoop stress of a free part."""
        rho, r = np.sin(arc) / u.inflation, y[0]
        horizontal = y[2] * self.tension
        vertical = u.pressure * r**2 / 2 - u.force / (2 * np.pi)
        size = np.hypot(horizontal, vertical)
        first, hoop = self.law.meridian(size / rho, r / rho)
        return rho, r, horizontal, vertical, size, first, hoop

    def zones(self, x: Array, u: _Unknowns) -> list[tuple[str, slice, Array, Array]]:
        """Return each zone's kind, its rows of the state, its arcs and their rate over x."""
        graded = np.log(u.plate / u.core)
        arc = u.core * np.exp(graded * x)
        found = [("flat", slice(0, 2), arc, graded * arc)]
        side = u.crest - u.plate
        found.append(("free", slice(2, 6), u.plate + side * x, np.full_like(x, side)))
        row = 6
        if not self.partial:
            # Graded towards the probe as the logarithm of the dimple is.
            graded = np.log((np.pi - u.crest) / (np.pi - u.edge))
            rest = (np.pi - u.crest) * np.exp(-graded * x)
            found.append(("free", slice(6, 10), np.pi - rest, graded * rest))
            row = 10
        if not self.bonded:
            graded = np.log((np.pi - u.edge) / u.face_core)
            arc = u.face_core * np.exp(graded * x)
            found.append(("flat", slice(row, row + 2), arc, graded * arc))
        return found

    def slopes(self, x: Array, y: Array, k: Array) -> Array:
        """Right-hand side of the equilibrium over x, which runs from 0 to 1 in every zone."""
        u = self.unpack(k)
        parts: list[Array] = []
        for kind, rows, arc, rate in self.zones(x, u):
            scale = rate / u.inflation
            if kind == "flat":
                _, _, _, first, hoop = self.flat(arc, y[rows], u)
                parts += [first * scale, hoop * scale / self.tension]
                continue
            _, r, horizontal, vertical, size, first, hoop = self.free(arc, y[rows], u)
            rise = first * vertical / size
            parts += [
                first * horizontal / size * scale,
                rise * scale,
                (hoop - u.pressure * r * rise) * scale / self.tension,
                np.pi * r**2 * rise * scale,
            ]
        return np.array(parts)

    def edges(self, left: Array, right: Array, k: Array) -> Array:
        """Residual: the zones' ends meet, the probe's edge is held, the volume is kept."""
        u = self.unpack(k)
        found = self._start(left[:2], u.core, u)
        found += [right[0] - u.rim, left[2] - u.rim, right[1] - left[4], left[3], left[5]]
        top = 6 if self.partial else 10
        if not self.partial:
            found += [right[2] - u.rim, left[6] - u.rim, *(left[7:10] - right[3:6])]
        end = right[top - 4 : top]
        width = u.rim if self.partial else self.probe
        found += [end[0] - width, end[3] - _SPHERE]
        if self.depth is not None:
            found.append(left[7] - right[7] - self.depth)
        if not self.bonded:
            vertical = u.pressure * width**2 / 2 - u.force / (2 * np.pi)
            found += self._start(left[top : top + 2], u.face_core, u, shared=True)
            # Without friction the edge turns the tension and leaves its size.
            found += [
                right[top] - width,
                right[top + 1] - np.hypot(end[2], vertical / self.tension),
            ]
        return np.array(found)

    def _start(self, y: Array, arc: float, u: _Unknowns, shared: bool = False) -> list[float]:
        """Return the residual where a flat zone begins: evenly stretched, or free and slack."""
        rho = np.sin(arc) / u.inflation
        if self.slack and not (shared and not self.partial):
            # The slack arc of the second of two plates is the first's.
            return [y[1]] if shared else [(y[0] - rho) / arc, y[1]]
        stretch = np.array(y[0] / rho)
        even = float(self.law.stress(stretch, stretch)[0])
        return [y[1] / rho - even / self.tension]

    def guess(self) -> tuple[Array, Array, Array]:
        """Return mesh, state and unknowns of a sphere with a flat bottom and a hollow top."""
        inflation = self.inflation or 1.05
        if self.force is not None:
            # An unstretched shell gets its tension from the force; the power was fitted to states.
            inflation = max(inflation, 1 + max(0.3 * self.force**0.7, _LEAST_STRETCH))
        even = np.array(inflation)
        tension = float(self.law.stress(even, even)[0]) / inflation
        pressure = 2 * tension
        if self.force is None:
            assert self.rim is not None
            rim = self.rim
        else:
            rim = min(np.sqrt(self.force / (np.pi * pressure)), 0.7)
        if not rim > _LEAST_WIDTH:
            raise ValueError(
                "force must be zero or flatten a spot that rounding does not hide, got one that "
                f"flattens {rim:.2g} R{_said(self)}"
            )
        if not self.partial:
            rim = max(rim, 1.2 * self.probe)
        rim = min(rim, 0.95)
        plate = float(np.arcsin(rim))
        face = float(np.arcsin(self.probe)) if self.bonded else 0.7 * self.probe
        if self.partial:
            face = plate
        values = [np.log(pressure), plate]
        if self.depth is not None:
            values.append(inflation)
        if self.slack:
            values.append(0.1 * plate)
        if not self.bonded:
            values.append(face)
        if not self.partial:
            values.append(np.pi - plate)
        k = np.array(values)
        x = np.linspace(0.0, 1.0, _NODES)
        u = self.unpack(k)
        rows: list[Array] = []
        for index, (kind, _, arc, _) in enumerate(self.zones(x, u)):
            pull = tension / self.tension
            if kind == "flat":
                width = self.probe if index and not self.partial else rim
                r = width * arc / arc[-1]
                rows += [r, pull * r]
                continue
            r = np.sin(arc)
            z = np.cos(plate) - np.cos(arc)
            if index == 2:
                z = 2 * np.cos(plate) * np.ones_like(x)
                z -= 0.3 * rim * np.log(rim / r) / np.log(rim / self.probe)
            volume = _SPHERE * (x if index == 1 else np.ones_like(x))
            rows += [r, z, pull * r * np.cos(arc), volume]
        return x, np.array(rows), k

    def jacobian(self, x: Array, y: Array, k: Array) -> tuple[Array, Array]:
        """Return derivatives of `slopes` by differences, all zones' radii at once, then forces.

        The zones do not touch each other's slopes, and heights and volumes touch none.
        """
        here = self.slopes(x, y, k)
        by_state = np.zeros((y.shape[0], *y.shape))
        widths = [2, 4] if self.partial else [2, 4, 4]
        widths += [] if self.bonded else [2]
        starts = np.cumsum([0, *widths[:-1]])
        for of_free, of_flat in ((0, 0), (2, 1)):
            rows = starts + np.where(np.array(widths) == 4, of_free, of_flat)
            step = 1.5e-8 * (1 + np.abs(y[rows]))
            moved = y.copy()
            moved[rows] += step
            change = self.slopes(x, moved, k) - here
            for row, start, width, size in zip(rows, starts, widths, step, strict=True):
                zone = slice(start, start + width)
                by_state[zone, row] = change[zone] / size
        by_unknown = np.empty((y.shape[0], k.size, y.shape[1]))
        for index in range(k.size):
            moved = k.copy()
            moved[index] += 1.5e-8 * (1 + abs(k[index]))
            by_unknown[:, index] = (self.slopes(x, y, moved) - here) / (moved[index] - k[index])
        return by_state, by_unknown

    def solve(
        self,
        x: Array,
        y: Array,
        k: Array,
        *,
        tolerance: float = _TOLERANCE,
        most_nodes: int = _MOST_NODES,
    ) -> Any:
        """Return SciPy's solution from a guess."""
        with np.errstate(all="ignore"):
            return solve_bvp(
                self.slopes,
                self.edges,
                x,
                y,
                p=k,
                fun_jac=self.jacobian,
                tol=tolerance,
                max_nodes=most_nodes,
            )


#: A problem and SciPy's solution of it.
Solved = tuple[_Capsule, Any]


@dataclass(frozen=True, eq=False)
class CapsuleModulus(Tidy):
    """
    What an indented capsule's shape says of its wall, from `capsule_modulus`.

    Attributes
    ----------
    modulus : float
        Elastic modulus E at small strain, in MPa.
    inflation : float
        Stretch of the wall before the test.
    state : MembraneState
        The capsule that has the given shape.
    """

    modulus: float
    inflation: float
    state: MembraneState


def indent_capsule(
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
    punch: str = "bonded",
) -> MembraneState:
    r"""
    Shape and stress of a fluid-filled capsule under a flat-ended probe, on a plate.

    Parameters
    ----------
    force : float
        Force F of the probe, in µN; zero or positive.
    modulus : float
        Elastic modulus E at small strain, in MPa.
    radius : float
        Radius R of the inflated capsule before the test, in µm.
    thickness : float
        Thickness h of the wall free of stress, before inflation, in µm.
    probe_half_width : float
        Radius c of the probe's flat end, in µm, below `radius`.
    poisson_ratio : float, optional
        ν, in (−1, 1) for ``"hooke"``, and 0.5 for the incompressible laws.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Law of the material, as for `indent_disc`.
    inflation : float, optional
        Stretch of the wall before the test, at least 1: R over the radius free of stress.
    support : {"plate"}, optional
        What the capsule rests on: a flat plate without friction.
    punch : {"bonded", "frictionless"}, optional
        Whether the wall sticks to the probe's face from the beginning or slides on it, and over its
        edge, freely.

    Returns
    -------
    MembraneState
        `depth` of the probe's end below the dimple's crest, and `approach`, 2R less the height of
        that end above the plate (µm); `rim_radius` of the crest and `contact_radius` on the plate,
        which are equal (µm); the meridian `r`, `z` from the probe to the middle of the plate (µm),
        with `stretches` and nominal `stresses` (MPa) along it and around the axis, (2, N) each;
        `pressure` above that outside (MPa); elastic `energy` (pJ); `volume` (µm³).

    Raises
    ------
    ValueError
        If an argument is out of its range; if the force is too small to lay a bonded wall on the
        whole face; or if it has no equilibrium with a dimple above the plate.

    See Also
    --------
    capsule_modulus : The inverse.

    Notes
    -----
    A point at the angle S of the undeformed sphere, counted from the plate's middle, has ρ =
    (R/λ) sin S and moves to r(S), z(S). With the tension's parts a radian as in `indent_disc`,

    .. math::

        V &= \frac{p r^2}{2} - \frac{F}{2\pi},\\
        H' &= h N_2 - p\, r z',\\
        \sqrt{H^2 + V^2} &= h \rho N_1,\\
        (r', z') &= \lambda_1 (H, V)/\sqrt{H^2 + V^2},

    the primes per undeformed arc (derived here). On the plate V = 0, and the pressure p is the one
    that keeps the volume :math:`\frac43 \pi R^3`. V is zero again at the crest of the dimple,
    whose radius is therefore the contact's, :math:`a = \sqrt{F/(\pi p)}`, for every law.

    Where the hoop stress would be negative the wall is wrinkled (relaxed energy), and where both
    stresses would be, in the middle of the plate, it is slack: a state of no stress inside a
    circle that the solver finds.

    A bonded probe's face is flat, and so is the wall on it: to flatten it takes the approach
    :math:`c^2/2R` and, in this model, no force. A frictionless probe lets the wall slide, and its
    edge can bear at most the tension that the wall has: :math:`F < 2\pi c h E/3` for neo-Hooke.

    Bending is left out; `capsule_bending_force` estimates it. A solution is returned only if a
    second integration and the balance of virtual work for a uniform swelling agree with it to
    1e-5.

    References
    ----------
    A. Patil, A. Nordmark, A. Eriksson, *Instabilities of wrinkled membranes with pressure
    loadings*, J. Mech. Phys. Solids, 2016 (read in the abstract), uses the relaxed energy for
    axisymmetric membranes under fluid pressure.

    Examples
    --------
    >>> state = indent_capsule(
    ...     100.0, modulus=1.0, radius=600.0, thickness=3.0, probe_half_width=25.0, inflation=1.05
    ... )
    >>> print(f"{state.depth:.2f} µm deep, rim at {state.rim_radius:.2f} µm")
    65.35 µm deep, rim at 184.90 µm
    """
    return indent_near(
        None,
        force,
        modulus=modulus,
        radius=radius,
        thickness=thickness,
        probe_half_width=probe_half_width,
        poisson_ratio=poisson_ratio,
        law=law,
        inflation=inflation,
        support=support,
        punch=punch,
    )[0]


def indent_near(
    near: Solved | None,
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
    punch: str = "bonded",
) -> tuple[MembraneState, Solved | None]:
    """Return the state of `indent_capsule`, and what the search for one nearby can start from."""
    load = scalar("force", force, least=0)
    stiffness = scalar("modulus", modulus, above=0)
    r0, h, c = _sizes(radius, thickness, probe_half_width)
    one_of("support", support, ("plate",))
    bonded = one_of("punch", punch, ("bonded", "frictionless")) == "bonded"
    stretch = scalar("inflation", inflation, above=0)
    if stretch < 1:
        raise ValueError(f"inflation must be at least 1, got {stretch:g}")
    material = law_of(law, poisson_ratio)
    if load == 0:
        return _sphere(material, stretch, stiffness, r0, h), None
    unit = stiffness * h * r0
    problem = replace(_problem(material, bonded, c / r0, load / unit, stretch), unit=unit)
    solved = None if near is None else _solve_near(problem, *near)
    problem, solution = solved or _solve(problem)
    return _state(problem, solution, stiffness, r0, h), (problem, solution)


def capsule_modulus(
    force: float,
    rim_radius: float,
    depth: float,
    *,
    radius: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float = 0.5,
    law: str = "neo-hooke",
    support: str = "plate",
    punch: str = "bonded",
) -> CapsuleModulus:
    r"""
    Elastic modulus and inflation of a capsule from its dimple and its radius.

    Parameters
    ----------
    force : float
        Force F, in µN.
    rim_radius : float
        Radius a of the dimple's crest, in µm.
    depth : float
        Depth w_d of the probe's end below the crest, in µm.
    radius, thickness, probe_half_width, poisson_ratio, law, support, punch
        As for `indent_capsule`.

    Returns
    -------
    CapsuleModulus
        `modulus` (MPa), `inflation`, and the `state` of the capsule, as from `indent_capsule`.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if no inflated capsule has this shape.

    Notes
    -----
    The crest fixes the pressure, :math:`p = F/(\pi a^2)`, whatever the modulus is. The shape
    depends on the inflation and on F/(E h R) alone, so that a and w_d over R give both.

    Examples
    --------
    >>> found = capsule_modulus(
    ...     197.24, 246.95, 121.22, radius=600.0, thickness=3.0, probe_half_width=25.0
    ... )
    >>> print(f"{found.modulus:.2f} MPa, inflated by {found.inflation:.3f}")
    1.12 MPa, inflated by 1.042
    """
    load = scalar("force", force, above=0)
    r0, h, c = _sizes(radius, thickness, probe_half_width)
    a, deep = scalar("rim_radius", rim_radius, above=0), scalar("depth", depth, above=0)
    one_of("support", support, ("plate",))
    bonded = one_of("punch", punch, ("bonded", "frictionless")) == "bonded"
    if not c < a < r0:
        raise ValueError(
            f"rim_radius must lie between probe_half_width {c:g} and radius {r0:g}, got {a:g}"
        )
    if deep >= 2 * r0:
        raise ValueError(f"depth must be below the capsule's height {2 * r0:g}, got {deep:g}")
    problem = _Capsule(
        law=law_of(law, poisson_ratio),
        probe=c / r0,
        tension=0.05,
        bonded=bonded,
        rim=a / r0,
        depth=deep / r0,
    )
    try:
        problem, solution = _solve(problem)
    except ValueError as reason:
        raise ValueError(
            f"depth must be one that a capsule of radius {r0:g} has at rim_radius {a:g}, "
            f"got {deep:g}: {reason}"
        ) from None
    u = problem.unpack(solution.p)
    if u.inflation < 1:
        raise ValueError(
            f"depth must be one of an inflated capsule, got {deep:g} at rim_radius {a:g} and "
            f"radius {r0:g}, which needs an inflation of {u.inflation:.4f}"
        )
    found = load / (u.force * h * r0)
    return CapsuleModulus(found, float(u.inflation), _state(problem, solution, found, r0, h))


def _sizes(radius: float, thickness: float, probe_half_width: float) -> tuple[float, float, float]:
    r0 = scalar("radius", radius, above=0, most=_LARGEST)
    h = scalar("thickness", thickness, above=0, most=_LARGEST)
    return r0, h, scalar("probe_half_width", probe_half_width, within=(_LEAST_WIDTH * r0, r0))


def _problem(law: Law, bonded: bool, probe: float, force: float, inflation: float) -> _Capsule:
    even = np.array(inflation)
    start = float(law.stress(even, even)[0]) / inflation
    return _Capsule(
        law=law,
        probe=probe,
        tension=max(start, 0.1 * force**0.8),
        bonded=bonded,
        inflation=inflation,
        force=force,
        partial=not bonded and force < 2 * np.pi * start * probe**2,
    )


def _solve(problem: _Capsule) -> tuple[_Capsule, Any]:
    """Return a checked solution and the problem that it solves, which may have a slack zone."""
    solved, solution, u = _find(problem)
    # A dimple's rim lies outside the probe; on a smaller circle the face only flattens the wall.
    if not solved.partial and u.rim <= solved.probe:
        if problem.bonded:
            least = np.pi * solved.probe**2 * u.pressure
            raise ValueError(
                "force must lay the wall on the whole face of a bonded probe, which takes about "
                f"{least * problem.unit:.3g} µN, got {u.force * problem.unit:.3g} µN; "
                "punch='frictionless' has no such limit"
            )
        solved, solution, u = _find(replace(problem, partial=True))
    elif solved.partial and u.rim > solved.probe:
        solved, solution, u = _find(replace(problem, partial=False))
    _check_shape(solved, solution, u)
    return solved, solution


def _solve_near(problem: _Capsule, other: _Capsule, start: Any) -> Solved | None:
    """Return a checked solution found from that of another problem, or None if it is too far."""
    stretches, forces = (
        np.array(pair, float)
        for pair in ((problem.inflation, other.inflation), (problem.force, other.force))
    )
    apart = max(np.ptp(stretches), 0.1 * np.ptp(np.log(forces)))
    if apart > _NEAR or problem.partial != other.partial or start.x.size > _NEAR_NODES:
        return None
    problem = replace(problem, slack=other.slack)
    with_tension = _retensed(other, problem, start.y)
    solution = problem.solve(start.x, with_tension, start.p, most_nodes=_NEAR_NODES)
    if solution.status != 0 or not np.isfinite(solution.y).all():
        return None
    u = problem.unpack(solution.p)
    compressed = not problem.slack and solution.y[0, 0] < np.sin(u.core) / u.inflation
    dimpled = (u.rim > problem.probe) != problem.partial
    if compressed or u.core <= 0 or not dimpled or not _is_sound(problem, solution):
        return None
    _check_shape(problem, solution, u)
    return problem, solution


def _retensed(old: _Capsule, new: _Capsule, y: Array) -> Array:
    """Return a state with its tensions in the size of another problem's."""
    scaled = y.copy()
    scaled[[row for row in (1, 4, 8, 11) if row < len(y)]] *= old.tension / new.tension
    return scaled


def _find(problem: _Capsule) -> tuple[_Capsule, Any, _Unknowns]:
    """Return a solution of the problem as posed, or refuse."""
    solved, solution = _attempt(problem, problem.guess())
    if solution is None and problem.force is not None:
        solved, solution = _climb(problem)
    if solution is None:
        raise ValueError(f"force must have an equilibrium, none was found{_said(problem)}")
    return solved, solution, solved.unpack(solution.p)


def _said(problem: _Capsule) -> str:
    if problem.force is None:
        return f" for a rim of {problem.rim:.3g} R and a depth of {problem.depth:.3g} R"
    return f" at {problem.force * problem.unit:.4g} µN and inflation {problem.inflation:.4g}"


def _attempt(problem: _Capsule, guess: tuple[Array, Array, Array]) -> tuple[_Capsule, Any]:
    """Return a sound solution, with a slack zone if the plate's middle is compressed, or None."""
    rough = problem.solve(*guess, tolerance=_ROUGH, most_nodes=_ROUGH_NODES)
    if rough.status != 0 or not np.isfinite(rough.y).all():
        return problem, None
    u = problem.unpack(rough.p)
    if not problem.slack and rough.y[0, 0] < np.sin(u.core) / u.inflation:
        return _attempt(replace(problem, slack=True), _loosened(problem, rough))
    solution = problem.solve(rough.x, rough.y, rough.p)
    if solution.status != 0 or not np.isfinite(solution.y).all():
        return problem, None
    return problem, (solution if _is_sound(problem, solution) else None)


def _loosened(problem: _Capsule, solution: Any) -> tuple[Array, Array, Array]:
    """Return a guess with a slack zone from a solution with a compressed one."""
    u = problem.unpack(solution.p)
    arc = problem.zones(solution.x, u)[0][2]
    tight = np.flatnonzero(solution.y[0] >= np.sin(arc) / u.inflation)
    core = arc[tight[0]] if tight.size else 0.9 * u.plate
    core = min(core, 0.9 * u.plate)
    y = solution.y.copy()
    targets = [(0, core, u.plate)]
    if problem.partial:
        targets.append((len(y) - 2, core, np.pi - u.edge))
    for row, low, high in targets:
        wanted = low * (high / low) ** solution.x
        own = problem.zones(solution.x, u)[0 if row == 0 else -1][2]
        y[row] = np.interp(wanted, own, solution.y[row])
        y[row + 1] = np.maximum(np.interp(wanted, own, solution.y[row + 1]), 0.0)
    place = 2 if problem.depth is None else 3
    k = np.insert(solution.p, place, core)
    every = max(1, solution.x.size // 100)
    keep = np.unique(np.append(np.arange(0, solution.x.size, every), solution.x.size - 1))
    return solution.x[keep], y[:, keep], k


def _climb(problem: _Capsule) -> tuple[_Capsule, Any]:
    """Return the solution by steps of the force from one that is solved easily."""
    assert problem.force is not None
    assert problem.inflation is not None
    steps = int(np.ceil(abs(np.log(problem.force / _EASY_FORCE)) / np.log(_LADDER)))
    if problem.partial or not 0 < steps <= _RUNGS:
        return problem, None
    solved, found, last = problem, None, None
    for force in np.geomspace(_EASY_FORCE, problem.force, steps + 1):
        stage = replace(
            _problem(problem.law, problem.bonded, problem.probe, force, problem.inflation),
            partial=False,
            unit=problem.unit,
        )
        guess = stage.guess()
        if found is not None:
            # The unknowns go on as they went; the tension has another size.
            k = found.p if last is None or last.size != found.p.size else 2 * found.p - last
            y = _retensed(solved, stage, found.y)
            stage, guess, last = replace(stage, slack=solved.slack), (found.x, y, k), found.p
        solved, found = _attempt(stage, guess)
        if found is None:
            break
    return solved, found


def _is_sound(problem: _Capsule, solution: Any) -> bool:
    """Tell whether a solution passes two checks that the collocation knows nothing of."""
    with np.errstate(all="ignore"):
        missed = reintegration_error(
            lambda x, y: problem.slopes(x, y, solution.p), solution.x, solution.y
        )
        return bool(missed < _ACCEPTED and _virtual_work(problem, solution) < _ACCEPTED)


def _virtual_work(problem: _Capsule, solution: Any) -> float:
    """Return the imbalance of virtual work when the shape swells about the plate's middle."""
    u = problem.unpack(solution.p)
    x, weight = gauss_points(solution.x)
    y, rate = solution.sol(x), solution.sol(x, 1)
    inside = 0.0
    for kind, rows, arc, speed in problem.zones(x, u):
        rho = np.sin(arc) / u.inflation
        own = rate[rows] / speed * u.inflation
        first = np.hypot(own[0], own[1]) if kind == "free" else np.abs(own[0])
        second = y[rows][0] / rho
        along, across = relaxed_stress(problem.law, first, second)
        area = rho * speed / u.inflation * weight
        inside += float(np.sum((along * first + across * second) * area))
    # Within the first arc of a zone that is not slack the stretch is even.
    starts = [(u.core, solution.y[0, 0])] if not problem.slack else []
    if not problem.bonded and not (problem.partial and problem.slack):
        starts.append((u.face_core, solution.y[-2, 0]))
    for start, r in starts:
        stretch = np.array(r * u.inflation / np.sin(start))
        even = float((problem.law.stress(stretch, stretch)[0] * stretch).item())
        inside += 2 * even * (1 - np.cos(start)) / u.inflation**2
    top = 6 if problem.partial else 10
    r, z, horizontal, _ = solution.y[top - 4 : top, -1]
    reaction = horizontal * problem.tension
    if not problem.bonded:
        reaction += solution.y[-1, -1] * problem.tension
    work = 3 * u.pressure * _SPHERE / (2 * np.pi) - u.force * z / (2 * np.pi) + reaction * r
    return float(abs(inside - work) / (abs(inside) + u.pressure + u.force))


def _check_shape(problem: _Capsule, solution: Any, u: _Unknowns) -> None:
    """Refuse a shape that passes through the plate, the probe or itself."""
    last = 6 if problem.partial else 10
    r, z, horizontal, _ = solution.y[last - 4 : last]
    if not problem.partial and z.min() <= 0:
        raise ValueError(
            "force must keep the probe above the plate, got one that presses the dimple through it"
            f"{_said(problem)}"
        )
    if not problem.partial and (horizontal[-1] >= 0 or r.min() < (1 - 1e-9) * problem.probe):
        raise ValueError(
            f"force must leave the wall clear of the probe's side, got one that folds it below the "
            f"probe{_said(problem)}"
        )
    ordered = 0 < u.core < u.plate < u.crest <= u.edge < np.pi
    if not ordered or not u.plate < np.pi / 2 < u.crest:
        raise ValueError(
            "force must leave a wall between the plate's contact and the dimple, got one that "
            f"swallows it{_said(problem)}"
        )


def _state(
    problem: _Capsule, solution: Any, modulus: float, radius: float, h: float
) -> MembraneState:
    u = problem.unpack(solution.p)
    x, weight = gauss_points(solution.x)
    dense = solution.sol(x)
    energy = 0.0
    shape: list[Array] = []
    for kind, rows, arc, _ in problem.zones(solution.x, u):
        y = solution.y[rows]
        if kind == "flat":
            rho, r, size, first, across = problem.flat(arc, y, u)
            face = rows.start > 0
            z = np.full_like(r, solution.y[rows.start - 3, -1] if face else 0.0)
        else:
            rho, r, _, _, size, first, across = problem.free(arc, y, u)
            z = y[1]
        part = np.array([r, z, first, r / rho, size / rho, across])
        shape.append(part[:, ::-1] if kind == "free" or rows.start == 0 else part)
    for kind, rows, arc, speed in problem.zones(x, u):
        values = (problem.flat if kind == "flat" else problem.free)(arc, dense[rows], u)
        rho, first = values[0], values[-2]
        area = rho * speed / u.inflation * weight
        energy += float(np.sum(problem.law.energy(first, dense[rows][0] / rho) * area))
    energy += _even_energy(problem, solution, u)
    # From the probe's edge to the plate's middle; what lies on the probe's face comes first.
    ordered = [shape[-1]] if not problem.bonded else []
    ordered += list(reversed(shape[: 2 if problem.partial else 3]))
    middle = np.array([0.0, 0.0, *(_middle(problem, solution, u))])
    meridian = np.column_stack([*ordered, middle])
    # Zones share their ends.
    again = np.flatnonzero(np.hypot(*np.diff(meridian[:2])) == 0) + 1
    meridian = np.delete(meridian, again, axis=1)
    last = 6 if problem.partial else 10
    crest = solution.y[7, 0] if not problem.partial else solution.y[3, -1]
    end = solution.y[last - 3, -1]
    pressure = u.pressure * modulus * h / radius
    return MembraneState(
        depth=float((crest - end) * radius),
        approach=float((2 - end) * radius),
        rim_radius=float(u.rim * radius),
        r=meridian[0] * radius,
        z=meridian[1] * radius,
        stretches=meridian[2:4],
        stresses=meridian[4:] * modulus,
        pressure=float(pressure),
        contact_radius=float(u.rim * radius),
        energy=float(2 * np.pi * energy * modulus * h * radius**2),
        volume=float(_enclosed(problem, solution) * radius**3),
    )


def _enclosed(problem: _Capsule, solution: Any) -> float:
    """Return the volume from the shape by quadrature, not from the state that was held to it."""
    x, weight = gauss_points(solution.x)
    y, rate = solution.sol(x), solution.sol(x, 1)
    rows = [2] if problem.partial else [2, 6]
    return float(sum(np.pi * np.sum(y[row] ** 2 * rate[row + 1] * weight) for row in rows))


def _even_energy(problem: _Capsule, solution: Any, u: _Unknowns) -> float:
    """Return the energy of what is not in the zones: their first arcs, the wall on the probe."""
    found = 0.0
    starts = [] if problem.slack else [(u.core, solution.y[0, 0] * u.inflation / np.sin(u.core))]
    if problem.bonded:
        starts.append((np.pi - u.edge, u.inflation))
    elif not (problem.partial and problem.slack):
        starts.append((u.face_core, solution.y[-2, 0] * u.inflation / np.sin(u.face_core)))
    for arc, stretch in starts:
        even = np.array(stretch)
        found += float(problem.law.energy(even, even)) * (1 - np.cos(arc)) / u.inflation**2
    return found


def _middle(problem: _Capsule, solution: Any, u: _Unknowns) -> list[float]:
    """Return stretches and stresses in the middle of the plate."""
    if problem.slack:
        return [np.nan, np.nan, 0.0, 0.0]
    stretch = solution.y[0, 0] * u.inflation / np.sin(u.core)
    even = float(problem.law.stress(np.array(stretch), np.array(stretch))[0])
    return [stretch, stretch, even, even]


def _sphere(law: Law, inflation: float, modulus: float, radius: float, h: float) -> MembraneState:
    """Return the inflated capsule that nothing presses, from its top to the plate."""
    angle = np.linspace(0.0, np.pi, 4 * _NODES + 1)
    even = np.array(inflation)
    stress = float(law.stress(even, even)[0])
    area = 4 * np.pi * (radius / inflation) ** 2
    return MembraneState(
        depth=0.0,
        approach=0.0,
        rim_radius=0.0,
        r=radius * np.sin(angle),
        z=radius * (1 + np.cos(angle)),
        stretches=np.full((2, angle.size), inflation),
        stresses=np.full((2, angle.size), modulus * stress),
        pressure=2 * modulus * h * stress / (inflation * radius),
        contact_radius=0.0,
        energy=float(law.energy(even, even)) * modulus * h * area,
        volume=_SPHERE * radius**3,
    )
