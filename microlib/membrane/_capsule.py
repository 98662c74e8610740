r"""A closed, fluid-filled capsule pressed by a probe on top, on a flat plate.

The chorion of an embryo is a closed bag of a fluid that hardly leaks within seconds: what the probe
takes at the top, the whole shell has to give. The capsule is solved as it stands, for any depth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from microlib._common import Array, Tidy, one_of, scalar
from microlib.membrane._laws import Law, law_of
from microlib.membrane._point_load import warn_of_units
from microlib.membrane._solver import Guess, MembraneState, Problem, gauss_points, in_units

_NODES = 40
# Enough to see whether the middle of the plate is slack.
_ROUGH = 1e-3
# The flat zones begin at this fraction of their arc, the rest of which is stretched evenly: the
# error falls with the fourth power.
_CORE = 0.01
# Force from which every capsule was found to be solved without help, and the steps away from it.
_EASY_FORCE = 0.03
_RUNGS = 14
# A guess has at least this strain: far more than rounding, and its pressure has a logarithm.
_LEAST_STRETCH = 1e-12
_SPHERE = 4 * np.pi / 3
# A search starts from another's solution if its mesh has not more nodes: beyond, a start from the
# sphere is faster.
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


class _Zone(NamedTuple):
    """A part of the wall: flat on the plate or the face, or free."""

    flat: bool
    rows: slice  # of the state: r and tension if flat, else r, z, H and the volume
    arc: Array
    rate: Array  # of the arc over x


@dataclass(frozen=True)
class _Capsule(Problem):
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

    # Relative residual of the collocation: the depth is then good to about 1e-8.
    tolerance = 1e-6
    most_nodes = 1500

    @property
    def top(self) -> int:
        """Rows of the state up to the probe's edge."""
        return 6 if self.partial else 10

    @property
    def said(self) -> str:
        if self.force is None:
            return f" for a rim of {self.rim:.3g} R and a depth of {self.depth:.3g} R"
        return f" at {self.force * self.unit:.4g} µN and inflation {self.inflation:.4g}"

    def unpack(self, k: Any) -> _Unknowns:
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

    def zones(self, x: Array, u: _Unknowns) -> list[_Zone]:
        """Return the zones, from the plate's middle to the probe's."""
        graded = np.log(u.plate / u.core)
        arc = u.core * np.exp(graded * x)
        found = [_Zone(True, slice(0, 2), arc, graded * arc)]
        side = u.crest - u.plate
        found.append(_Zone(False, slice(2, 6), u.plate + side * x, np.full_like(x, side)))
        if not self.partial:
            # Graded towards the probe as the logarithm of the dimple is.
            graded = np.log((np.pi - u.crest) / (np.pi - u.edge))
            rest = (np.pi - u.crest) * np.exp(-graded * x)
            found.append(_Zone(False, slice(6, 10), np.pi - rest, graded * rest))
        if not self.bonded:
            graded = np.log((np.pi - u.edge) / u.face_core)
            arc = u.face_core * np.exp(graded * x)
            found.append(_Zone(True, slice(self.top, self.top + 2), arc, graded * arc))
        return found

    def local(self, zone: _Zone, y: Array, u: _Unknowns) -> tuple[Array, ...]:
        """Return ρ, r, H, V, the tension's size, stretch and hoop stress in a zone."""
        rho, r = np.sin(zone.arc) / u.inflation, y[zone.rows][0]
        horizontal = y[zone.rows][1 if zone.flat else 2] * self.tension
        vertical = np.zeros_like(r)
        size = horizontal
        if not zone.flat:
            vertical = u.pressure * r**2 / 2 - u.force / (2 * np.pi)
            size = np.hypot(horizontal, vertical)
        first, hoop = self.law.meridian(size / rho, r / rho)
        return rho, r, horizontal, vertical, size, first, hoop

    def slopes(self, x: Array, y: Array, k: Any = None) -> Array:
        """Right-hand side of the equilibrium over x, which runs from 0 to 1 in every zone."""
        u = self.unpack(k)
        parts: list[Array] = []
        for zone in self.zones(x, u):
            _, r, horizontal, vertical, size, first, hoop = self.local(zone, y, u)
            scale = zone.rate / u.inflation
            if zone.flat:
                parts += [first * scale, hoop * scale / self.tension]
                continue
            rise = first * vertical / size
            parts += [
                first * horizontal / size * scale,
                rise * scale,
                (hoop - u.pressure * r * rise) * scale / self.tension,
                np.pi * r**2 * rise * scale,
            ]
        return np.array(parts)

    def edges(self, left: Array, right: Array, k: Any = None) -> Array:
        """Residual: the zones' ends meet, the probe's edge is held, the volume is kept."""
        u = self.unpack(k)
        found = self._start(left[:2], u.core, u)
        found += [right[0] - u.rim, left[2] - u.rim, right[1] - left[4], left[3], left[5]]
        top = self.top
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
        return [y[1] / rho - self.law.even_stress(y[0] / rho) / self.tension]

    def guess(self) -> Guess:
        """Return mesh, state and unknowns of a sphere with a flat bottom and a hollow top."""
        inflation = self.inflation or 1.05
        if self.force is not None:
            # An unstretched shell gets its tension from the force; the power was fitted to states.
            inflation = max(inflation, 1 + max(0.3 * self.force**0.7, _LEAST_STRETCH))
        tension = self.law.even_stress(inflation) / inflation
        pressure = 2 * tension
        if self.force is None:
            assert self.rim is not None
            rim = self.rim
        else:
            rim = min(np.sqrt(self.force / (np.pi * pressure)), 0.7)
        if not rim > _LEAST_WIDTH:
            raise ValueError(
                "force must be zero or flatten a spot that rounding does not hide, got one that "
                f"flattens {rim:.2g} R{self.said}"
            )
        if not self.partial:
            rim = max(rim, 1.2 * self.probe)
        rim = min(rim, 0.95)
        plate = float(np.arcsin(rim))
        unknowns = [
            (True, np.log(pressure)),
            (True, plate),
            (self.depth is not None, inflation),
            (self.slack, 0.1 * plate),
            (not self.bonded, plate if self.partial else 0.7 * self.probe),
            (not self.partial, np.pi - plate),
        ]
        k = np.array([value for wanted, value in unknowns if wanted])
        x = np.linspace(0.0, 1.0, _NODES)
        u = self.unpack(k)
        rows: list[Array] = []
        for index, (flat, _, arc, _) in enumerate(self.zones(x, u)):
            pull = tension / self.tension
            if flat:
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
        widths = [2, 4] + [4] * (not self.partial) + [2] * (not self.bonded)
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

    def attempt(self, guess: Guess, tolerance: float = _ROUGH) -> Solved | None:
        """Return a checked solution, with a slack zone if the plate's middle is compressed."""
        solution = self.collocated(guess, tolerance)
        if solution is None or self.unpack(solution.p).core <= 0:
            return None
        if self.compressed(solution):
            return replace(self, slack=True).attempt(self.loosened(solution))
        if tolerance > self.tolerance:
            solution = self.collocated((solution.x, solution.y, solution.p))
        return self.checked(solution)

    def compressed(self, solution: Any) -> bool:
        """Tell whether the plate's middle is pressed together, which it cannot bear."""
        u = self.unpack(solution.p)
        return bool(not self.slack and solution.y[0, 0] < np.sin(u.core) / u.inflation)

    def loosened(self, solution: Any) -> Guess:
        """Return a guess with a slack zone from a solution with a compressed one."""
        u = self.unpack(solution.p)
        arc = self.zones(solution.x, u)[0][2]
        tight = np.flatnonzero(solution.y[0] >= np.sin(arc) / u.inflation)
        core = arc[tight[0]] if tight.size else 0.9 * u.plate
        core = min(core, 0.9 * u.plate)
        y = solution.y.copy()
        targets = [(0, u.plate), (len(y) - 2, np.pi - u.edge)]
        for row, high in targets[: 1 + self.partial]:
            wanted = core * (high / core) ** solution.x
            own = self.zones(solution.x, u)[0 if row == 0 else -1][2]
            y[row] = np.interp(wanted, own, solution.y[row])
            y[row + 1] = np.maximum(np.interp(wanted, own, solution.y[row + 1]), 0.0)
        place = 2 if self.depth is None else 3
        k = np.insert(solution.p, place, core)
        return solution.x, y, k

    def stages(self) -> Iterator[_Capsule]:
        """Yield problems from a force that is solved easily to this one."""
        if self.force is None or self.inflation is None or self.partial:
            return
        for force in np.geomspace(_EASY_FORCE, self.force, _RUNGS):
            stage = _problem(self.law, self.bonded, self.probe, force, self.inflation)
            yield replace(stage, partial=False, unit=self.unit)

    def after(self, solved: _Capsule, solution: Any) -> tuple[_Capsule, Guess]:
        """Return this problem and its guess from another's solution, whose tension differs."""
        y = solution.y.copy()
        y[[row for row in (1, 4, 8, 11) if row < len(y)]] *= solved.tension / self.tension
        return replace(self, slack=solved.slack), (solution.x, y, solution.p)

    def even_parts(self, solution: Any, u: _Unknowns) -> list[tuple[float, float]]:
        """Return arc and stretch of the poles, which lie in no zone and are evenly stretched."""
        found = [] if self.slack else [(u.core, solution.y[0, 0])]
        if not self.bonded and not (self.partial and self.slack):
            found.append((u.face_core, solution.y[-2, 0]))
        return [(arc, float(r * u.inflation / np.sin(arc))) for arc, r in found]

    def virtual_work(self, solution: Any) -> float:
        """Return the imbalance of virtual work when the shape swells about the plate's middle."""
        u = self.unpack(solution.p)
        x, weight = gauss_points(solution.x)
        y, rate = solution.sol(x), solution.sol(x, 1)
        inside = 0.0
        for flat, rows, arc, speed in self.zones(x, u):
            rho = np.sin(arc) / u.inflation
            own = rate[rows] / speed * u.inflation
            first = np.abs(own[0]) if flat else np.hypot(own[0], own[1])
            second = y[rows][0] / rho
            along, across = self.law.relaxed_stress(first, second)
            area = rho * speed / u.inflation * weight
            inside += float(np.sum((along * first + across * second) * area))
        for end, stretch in self.even_parts(solution, u):
            even = self.law.even_stress(stretch) * stretch
            inside += 2 * even * (1 - np.cos(end)) / u.inflation**2
        r, z, horizontal, _ = solution.y[self.top - 4 : self.top, -1]
        # A wall that slides over the probe's edge pulls there, too.
        pull = self.tension * (horizontal + (0.0 if self.bonded else solution.y[-1, -1]))
        work = (3 * u.pressure * _SPHERE - u.force * z) / (2 * np.pi) + pull * r
        return float(abs(inside - work) / (abs(inside) + u.pressure + u.force))


#: A problem and SciPy's solution of it.
Solved = tuple[_Capsule, Any]


@dataclass(frozen=True, eq=False, repr=False)
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
    punch: str = "bonded",
) -> MembraneState:
    r"""
    Shape and stress of a fluid-filled capsule under a flat-ended probe, on a smooth plate.

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
        ν, in (−1, 0.5] for ``"hooke"``, and 0.5 for the incompressible laws.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Law of the material, as for `indent_disc`.
    inflation : float, optional
        Stretch of the wall before the test, at least 1: R over the radius free of stress.
    punch : {"bonded", "frictionless"}, optional
        Whether the wall sticks to the probe's face from the beginning or slides on it, and over its
        edge, freely.

    Returns
    -------
    MembraneState
        `depth` of the probe's end below the dimple's crest, and `approach`, 2R less the height of
        that end above the plate (µm); `rim_radius` of the crest and of the contact on the plate,
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

    Bending is left out: on a taut wall of 3 µm it adds about 1 % to the force. A solution is
    returned only if a second integration and the balance of virtual work for a uniform swelling
    agree with it to 1e-5.

    References
    ----------
    A. Patil, A. Nordmark, A. Eriksson, *Instabilities of wrinkled membranes with pressure
    loadings*, J. Mech. Phys. Solids, 2016 (read in the abstract), uses the relaxed energy for
    axisymmetric membranes under fluid pressure.

    Examples
    --------
    >>> from microlib.membrane import indent_capsule
    >>> state = indent_capsule(
    ...     100.0, modulus=1.0, radius=600.0, thickness=3.0, probe_half_width=25.0, inflation=1.05
    ... )
    >>> print(f"{state.depth:.2f} µm deep, rim at {state.rim_radius:.2f} µm")
    65.35 µm deep, rim at 184.90 µm
    """
    wall = (radius, thickness, probe_half_width, poisson_ratio, law, punch)
    return indent_near(None, force, modulus, inflation, wall)[0]


#: radius, thickness, probe_half_width, poisson_ratio, law and punch of a capsule.
Wall = tuple[float, float, float, float, str, str]


def indent_near(
    near: Solved | None, force: float, modulus: float, inflation: float, wall: Wall
) -> tuple[MembraneState, Solved | None]:
    """Return the state of `indent_capsule`, and what the search for one nearby can start from."""
    load = scalar("force", force, least=0)
    stiffness = scalar("modulus", modulus, above=0)
    r0, h, c, material, bonded = _checked(wall)
    stretch = scalar("inflation", inflation, least=1)
    if load == 0:
        # The inflated capsule that nothing presses, from its top to the plate.
        angle = np.linspace(0.0, np.pi, 4 * _NODES + 1)
        stress, same = material.even_stress(stretch), np.ones((2, angle.size))
        sphere = in_units(
            np.vstack([np.sin(angle), 1 + np.cos(angle), stretch * same, stress * same]),
            stiffness,
            h,
            r0,
            pressure=2 * stress / stretch,
            energy=4 * np.pi * material.even_energy(stretch) / stretch**2,
            volume=_SPHERE,
        )
        return sphere, None
    unit = stiffness * h * r0
    problem = replace(_problem(material, bonded, c / r0, load / unit, stretch), unit=unit)
    problem, solution = _solve(problem, near)
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
    radius, thickness, probe_half_width, poisson_ratio, law, punch
        As for `indent_capsule`.

    Returns
    -------
    CapsuleModulus
        `modulus` (MPa), `inflation`, and the `state` of the capsule, as from `indent_capsule`.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if no inflated capsule has this shape.

    Warns
    -----
    UserWarning
        As for `elastic_modulus`, if the modulus is that of no membrane.

    Notes
    -----
    The crest fixes the pressure, :math:`p = F/(\pi a^2)`, whatever the modulus is. The shape
    depends on the inflation and on F/(E h R) alone, so that a and w_d over R give both.

    Examples
    --------
    >>> from microlib.membrane import capsule_modulus
    >>> found = capsule_modulus(
    ...     197.24, 246.95, 121.22, radius=600.0, thickness=3.0, probe_half_width=25.0
    ... )
    >>> print(f"{found.modulus:.2f} MPa, inflated by {found.inflation:.3f}")
    1.12 MPa, inflated by 1.042
    """
    load = scalar("force", force, above=0)
    wall = (radius, thickness, probe_half_width, poisson_ratio, law, punch)
    r0, h, c, material, bonded = _checked(wall)
    a, deep = scalar("rim_radius", rim_radius, above=0), scalar("depth", depth, above=0)
    if not c < a < r0:
        raise ValueError(
            f"rim_radius must lie between probe_half_width {c:g} and radius {r0:g}, got {a:g}"
        )
    if deep >= 2 * r0:
        raise ValueError(f"depth must be below the capsule's height {2 * r0:g}, got {deep:g}")
    problem = _Capsule(material, c / r0, tension=0.05, bonded=bonded, rim=a / r0, depth=deep / r0)
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
    warn_of_units(found)
    return CapsuleModulus(found, float(u.inflation), _state(problem, solution, found, r0, h))


def _checked(wall: Wall) -> tuple[float, float, float, Law, bool]:
    """Return radius, thickness, probe_half_width, the law and whether the probe is bonded."""
    radius, thickness, probe_half_width, poisson_ratio, law, punch = wall
    r0 = scalar("radius", radius, above=0, most=_LARGEST)
    h = scalar("thickness", thickness, above=0, most=_LARGEST)
    c = scalar("probe_half_width", probe_half_width, within=(_LEAST_WIDTH * r0, r0))
    bonded = one_of("punch", punch, ("bonded", "frictionless")) == "bonded"
    return r0, h, c, law_of(law, poisson_ratio), bonded


def _problem(law: Law, bonded: bool, probe: float, force: float, inflation: float) -> _Capsule:
    start = law.even_stress(inflation) / inflation
    return _Capsule(
        law=law,
        probe=probe,
        tension=max(start, 0.1 * force**0.8),
        bonded=bonded,
        inflation=inflation,
        force=force,
        partial=not bonded and force < 2 * np.pi * start * probe**2,
    )


def _solve(problem: _Capsule, near: Solved | None = None) -> Solved:
    """Return a checked solution and the problem that it solves, which may have a slack zone.

    A shape that passes through the plate, the probe or itself is refused.
    """
    found = None
    if near and near[0].partial == problem.partial and near[1].x.size <= _NEAR_NODES:
        moved, guess = problem.after(*near)
        found = moved.attempt(guess, moved.tolerance)
    solved, solution = found or problem.find()
    u = solved.unpack(solution.p)
    # A dimple's rim lies outside the probe; on a smaller circle the face only flattens the wall.
    if solved.partial != (u.rim <= solved.probe):
        if problem.bonded:
            least = np.pi * solved.probe**2 * u.pressure
            raise ValueError(
                "force must lay the wall on the whole face of a bonded probe, which takes about "
                f"{least * problem.unit:.3g} µN, got {u.force * problem.unit:.3g} µN; "
                "punch='frictionless' has no such limit"
            )
        solved, solution = replace(problem, partial=not solved.partial).find()
    u = solved.unpack(solution.p)
    r, z, horizontal, _ = solution.y[solved.top - 4 : solved.top]
    ordered = 0 < u.core < u.plate < u.crest <= u.edge < np.pi
    clear = horizontal[-1] < 0 and r.min() >= (1 - 1e-9) * solved.probe
    for fine, wanted in (
        (
            solved.partial or z.min() > 0,
            "keep the probe above the plate, got one that presses the dimple through it",
        ),
        (
            solved.partial or clear,
            "leave the wall clear of the probe's side, got one that folds it below the probe",
        ),
        (
            ordered and u.plate < np.pi / 2 < u.crest,
            "leave a wall between the plate's contact and the dimple, got one that swallows it",
        ),
    ):
        if not fine:
            raise ValueError(f"force must {wanted}{solved.said}")
    return solved, solution


def _state(
    problem: _Capsule, solution: Any, modulus: float, radius: float, h: float
) -> MembraneState:
    u, top = problem.unpack(solution.p), problem.top
    x, weight = gauss_points(solution.x)
    dense, rate = solution.sol(x), solution.sol(x, 1)
    end = solution.y[top - 3, -1]
    shape: list[Array] = []
    energy = volume = 0.0
    for zone, fine in zip(problem.zones(solution.x, u), problem.zones(x, u), strict=True):
        rho, r, _, _, size, first, across = problem.local(zone, solution.y, u)
        on_face = zone.flat and zone.rows.start > 0
        z = np.full_like(r, end if on_face else 0.0) if zone.flat else solution.y[zone.rows][1]
        part = np.array([r, z, first, r / rho, size / rho, across])
        shape.append(part if on_face else part[:, ::-1])
        rho, r, *_, first, _ = problem.local(fine, dense, u)
        area = rho * fine.rate / u.inflation * weight
        energy += float(np.sum(problem.law.energy(first, r / rho) * area))
        if not zone.flat:
            # By quadrature of the shape, not from the state that was held to it.
            volume += float(np.pi * np.sum(r**2 * rate[zone.rows][1] * weight))
    poles = problem.even_parts(solution, u)
    middle = np.array([0.0, 0.0, np.nan, np.nan, 0.0, 0.0])
    if not problem.slack:
        middle[2:4], middle[4:] = poles[0][1], problem.law.even_stress(poles[0][1])
    if problem.bonded:
        poles.append((np.pi - u.edge, u.inflation))
    for end_arc, stretch in poles:
        energy += problem.law.even_energy(stretch) * (1 - np.cos(end_arc)) / u.inflation**2
    # From the probe's edge to the plate's middle; what lies on the probe's face comes first.
    face = [] if problem.bonded else [shape.pop()]
    meridian = np.column_stack([*face, *reversed(shape), middle])
    # Zones share their ends.
    again = np.flatnonzero(np.hypot(*np.diff(meridian[:2])) == 0) + 1
    return in_units(
        np.delete(meridian, again, axis=1),
        modulus,
        h,
        radius,
        depth=(solution.y[3, -1] if problem.partial else solution.y[7, 0]) - end,
        approach=2 - end,
        rim_radius=u.rim,
        pressure=u.pressure,
        energy=2 * np.pi * energy,
        volume=volume,
    )
