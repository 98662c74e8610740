r"""A closed, fluid-filled capsule pressed by a probe on top, on a flat plate.

The chorion of an embryo is a closed bag of a fluid that hardly leaks within seconds: what the probe
takes at the top, the whole shell has to give. The capsule is solved as it stands, for any depth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from microlib._common import Array, Tidy, scalar
from microlib.membrane._point_load import warn_if_implausible
from microlib.membrane.large._laws import Law, law_of
from microlib.membrane.large._solver import Guess, MembraneState, Problem, Strip, in_units, strip_of

#: Volume of a capsule of unit radius.
_SPHERE = 4 * np.pi / 3


class _Unknowns(NamedTuple):
    """What the solver finds beside the shape; arcs are angles on the undeformed sphere."""

    pressure: float
    inflation: float
    force: float
    rim: float
    core: float  # where the plate's zone begins
    plate: float  # where the shell leaves the plate
    crest: float  # where it is highest


class _Flat(NamedTuple):
    """The state on the plate: the radius and the tension's pull outward."""

    r: Array
    pull: Array


class _Free(NamedTuple):
    """The state of the free wall, with its height and the volume so far."""

    r: Array
    z: Array
    pull: Array
    volume: Array


def _parts(y: Any) -> tuple[Any, Any, Any]:
    """Return the solver's rows by zone, _Flat on the plate, _Free up to the crest and beyond."""
    return _Flat(*y[:2]), _Free(*y[2:-4]), _Free(*y[-4:])


def _graded(first: float, last: float, x: Array) -> tuple[Array, Array]:
    """Return what grows from `first` to `last` by equal factors, and its slope."""
    logarithm = np.log(last / first)
    grown = first * np.exp(logarithm * x)
    return grown, logarithm * grown


@dataclass(frozen=True)
class _Capsule(Problem):
    """The problem without units: lengths in inflated radii R, forces in E h R.

    Given are either `force` and `inflation`, or `rim` and `depth`.
    """

    law: Law
    probe: float
    inflation: float | None = None
    force: float | None = None
    rim: float = np.nan
    depth: float | None = None
    slack: bool = False  # the middle of the plate's zone carries nothing
    unit: float = np.nan  # E h R in µN, for messages

    # Relative residual of the collocation: the depth is then good to about 1e-8.
    tolerance = 1e-6
    most_nodes = 1500
    # The first: enough to see whether the middle of the plate is slack.
    rough = 1e-3

    @cached_property
    def tension(self) -> float:
        """Size of the tension."""
        if self.force is None or self.inflation is None:
            return 0.05
        return max(self.law.even_stress(self.inflation) / self.inflation, 0.1 * self.force**0.8)

    @property
    def edge(self) -> float:
        """Arc of the wall that is on the probe's edge."""
        return np.pi - float(np.arcsin(self.probe))

    @property
    def sought(self) -> list[str]:
        """Names of the solver's parameters, in its order."""
        names = ["logarithm of the pressure", "plate", "crest"]
        return names + ["inflation"] * (self.inflation is None) + ["core"] * self.slack

    def unpack(self, k: Any) -> _Unknowns:
        """Return the unknowns of the solver's parameters."""
        found: dict[str, Any] = dict(zip(self.sought, k, strict=True))
        # Of NumPy, whose quotients by zero are infinite: a step may go anywhere.
        pressure = np.exp(found["logarithm of the pressure"])
        inflation: Any = found.get("inflation", self.inflation)
        rim = self.rim
        if self.force is None:
            force = np.pi * pressure * rim**2
        else:
            force, rim = self.force, np.sqrt(self.force / (np.pi * pressure))
        # Within a hundredth of its arc the plate's zone is stretched evenly: the error falls with
        # the fourth power.
        core = found.get("core", 0.01 * found["plate"])
        return _Unknowns(pressure, inflation, force, rim, core, found["plate"], found["crest"])

    def arcs(self, x: Array, u: _Unknowns) -> list[tuple[Array, Array]]:
        """Return each zone's arc and its slope, from the plate's middle to the probe."""
        wide = u.crest - u.plate
        # Graded towards the probe as the logarithm of the dimple is.
        rest, slope = _graded(np.pi - u.crest, np.pi - self.edge, x)
        side = u.plate + wide * x, np.full_like(x, wide)
        return [_graded(u.core, u.plate, x), side, (np.pi - rest, -slope)]

    def strips(self, x: Array, y: Array, k: Any) -> list[Strip]:
        u = self.unpack(k)
        found = []
        for (arc, slope), part in zip(self.arcs(x, u), _parts(y), strict=True):
            rho, rate = np.sin(arc) / u.inflation, slope / u.inflation
            # The plate carries all that presses on its zone.
            z, load = np.zeros_like(x), (0.0, 0.0)
            if isinstance(part, _Free):
                z, load = part.z, (u.force, u.pressure)
            found.append(strip_of(rho, rate, part.r, z, self.tension * part.pull, *load))
        return found

    def rates(self, x: Array, slope: Array) -> list[tuple[Any, Any]]:
        return [(part.r, getattr(part, "z", np.zeros_like(x))) for part in _parts(slope)]

    def slopes(self, x: Array, y: Array, k: Any = None) -> Array:
        """Right-hand side of the equilibrium over x, which runs from 0 to 1 in every zone."""
        plate, *free = self.strips(x, y, k)
        r, _, pull = self.balance(plate)
        parts: list[Array] = [*_Flat(r, pull / self.tension)]
        for strip in free:
            r, z, pull = self.balance(strip)
            parts += _Free(r, z, pull / self.tension, volume=np.pi * strip.r**2 * z)
        return np.array(parts)

    def edges(self, left: Array, right: Array, k: Any = None) -> Array:
        """Residual: the zones' ends meet, the probe's edge is held, the volume is kept."""
        u = self.unpack(k)
        plate, side, dimple = _parts(left)
        plate_end, side_end, probe = _parts(right)
        rho = np.sin(u.core) / u.inflation
        if self.slack:
            found = [(plate.r - rho) / u.core, plate.pull]
        else:
            found = [plate.pull / rho - self.law.even_stress(plate.r / rho) / self.tension]
        found += [plate_end.r - u.rim, plate_end.pull - side.pull]
        found += [side.r - u.rim, side.z, side.volume, side_end.r - u.rim]
        found += [dimple.r - u.rim, *np.subtract(dimple, side_end)[1:]]
        found += [probe.r - self.probe, probe.volume - _SPHERE]
        if self.depth is not None:
            found.append(dimple.z - probe.z - self.depth)
        return np.array(found)

    def guess(self) -> Guess:
        """Return mesh, state and unknowns of a sphere with a flat bottom and a hollow top."""
        inflation = self.inflation or 1.05
        if self.force is not None:
            # An unstretched shell gets its tension from the force, by about the power of states.
            # The least is more than rounding, and its pressure has a logarithm.
            inflation = max(inflation, 1 + max(self.force ** (2 / 3) / 3, 1e-12))
        tension = self.law.even_stress(inflation) / inflation
        pressure = 2 * tension
        rim = self.rim if self.force is None else np.sqrt(self.force / (np.pi * pressure))
        if self.force is not None:
            rim = min(rim, 3 / 4)
        rim = min(max(rim, 1.2 * self.probe), 0.95)
        plate = float(np.arcsin(rim))
        values = {"plate": plate, "crest": np.pi - plate, "inflation": inflation}
        values["logarithm of the pressure"] = np.log(pressure)
        k = np.array([values[name] for name in self.sought])
        x = np.linspace(0.0, 1.0, 40)
        flat, side, dimple = (arc for arc, _ in self.arcs(x, self.unpack(k)))
        r, pull = rim * flat / plate, tension / self.tension
        rows = [*_Flat(r, pull * r)]
        hollow = rim / 3 * np.log(rim / np.sin(dimple)) / np.log(rim / self.probe)
        height = np.cos(plate) - np.cos(side)
        for arc, z, volume in (
            (side, height, _SPHERE * x),
            (dimple, 2 * np.cos(plate) - hollow, np.full_like(x, _SPHERE)),
        ):
            r = np.sin(arc)
            rows += _Free(r, z, pull * r * np.cos(arc), volume)
        return x, np.array(rows), k

    def jacobian(self, x: Array, y: Array, k: Array) -> tuple[Array, Array]:
        """Return derivatives of `slopes` by differences, all zones' radii at once, then forces.

        The zones do not touch each other's slopes, and heights and volumes touch none.
        """
        here = self.slopes(x, y, k)
        by_state = np.zeros((y.shape[0], *y.shape))
        zones: Any = _parts(np.arange(len(y)))
        small = np.sqrt(np.finfo(float).eps)
        for each in ([zone.r for zone in zones], [zone.pull for zone in zones]):
            rows = np.array(each)
            step = small * (1 + np.abs(y[rows]))
            moved = y.copy()
            moved[rows] += step
            change = self.slopes(x, moved, k) - here
            for zone, row, size in zip(zones, rows, step, strict=True):
                by_state[[*zone], row] = change[[*zone]] / size
        by_unknown = np.empty((y.shape[0], k.size, y.shape[1]))
        for index in range(k.size):
            moved = k.copy()
            # Backward. The edge of a slack core lies on a kink, where it wrinkles. A smaller core
            # leaves it taut, as the larger radii above do: all derivatives are those of one side.
            moved[index] -= small * (1 + abs(k[index]))
            by_unknown[:, index] = (self.slopes(x, y, moved) - here) / (moved[index] - k[index])
        return by_state, by_unknown

    def attempt(self, guess: Guess, tolerance: float = rough) -> Solved | None:
        """Return a checked solution, with a slack zone if the plate's middle is compressed."""
        solution = self.collocated(guess, tolerance)
        if solution is None or (u := self.unpack(solution.p)).core <= 0:
            return None
        # Pressed together, which the middle cannot bear.
        if not self.slack and solution.y[0, 0] < np.sin(u.core) / u.inflation:
            return replace(self, slack=True).attempt(self.loosened(solution))
        if tolerance > self.tolerance:
            solution = self.collocated((solution.x, solution.y, solution.p))
        return self.checked(solution)

    def loosened(self, solution: Any) -> Guess:
        """Return a guess with a slack zone from a solution with a compressed one."""
        u = self.unpack(solution.p)
        arc, _ = self.arcs(solution.x, u)[0]
        plate = _parts(solution.y)[0]
        tight = np.flatnonzero(plate.r >= np.sin(arc) / u.inflation)
        core = min(arc[tight[0]] if tight.size else np.inf, 0.9 * u.plate)
        wanted, _ = _graded(core, u.plate, solution.x)
        y = solution.y.copy()
        y[0] = np.interp(wanted, arc, plate.r)
        y[1] = np.maximum(np.interp(wanted, arc, plate.pull), 0.0)
        return solution.x, y, np.append(solution.p, core)  # the last that is sought

    def stages(self) -> Iterator[_Capsule]:
        """Yield problems from a force that every capsule was found to be solved for to this one."""
        if self.force is None or self.inflation is None:
            return
        for force in np.geomspace(0.03, self.force, 14):
            yield replace(self, force=force, slack=False)

    def after(self, solved: _Capsule, solution: Any) -> tuple[_Capsule, Guess]:
        """Return this problem and its guess from another's solution, whose tension differs."""
        scale = solved.tension / self.tension
        parts = [part._replace(pull=scale * part.pull) for part in _parts(solution.y)]
        y = np.array([row for part in parts for row in part])
        return replace(self, slack=solved.slack), (solution.x, y, solution.p)


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
        Radius c of the probe's flat end, in µm, below `radius`. The wall sticks to it.
    poisson_ratio : float, optional
        ν, in (−1, 0.5] for ``"hooke"``, and 0.5 for the incompressible laws.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Law of the material, as for `indent_disc`.
    inflation : float, optional
        Stretch of the wall before the test, at least 1: R over the radius free of stress.

    Returns
    -------
    MembraneState
        `depth` of the probe's end below the dimple's crest, and `approach`, 2R less the height of
        that end above the plate (µm); `rim_radius` of the crest and of the contact on the plate,
        which are equal (µm); the meridian `r`, `z` from the probe to the middle of the plate (µm),
        with `stretches` and nominal `stresses` (MPa) along it and around the axis, (2, N) each;
        `pressure` above that outside (MPa).

    Raises
    ------
    ValueError
        If an argument is out of its range; if the force is too small to lay the wall on the whole
        face; or if it has no equilibrium with a dimple above the plate.

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

    The probe's face is flat, and so is the wall on it: to flatten it takes the approach
    :math:`c^2/2R` and, in this model, no force.

    Bending is left out: on a taut wall of 3 µm it adds about 1 % to the force. A solution is
    returned only if the balance of virtual work for a uniform swelling agrees with it to 1e-5.

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
    wall = (radius, thickness, probe_half_width, poisson_ratio, law)
    return indent_near(None, force, modulus, inflation, wall)[0]


def indent_near(
    near: Solved | None, force: float, modulus: float, inflation: float, wall: tuple[Any, ...]
) -> tuple[MembraneState, Solved | None]:
    """Return the state of `indent_capsule`, and what the search for one nearby can start from."""
    load = scalar("force", force, least=0)
    stiffness = scalar("modulus", modulus, above=0)
    r0, h, c, material = _checked(wall)
    stretch = scalar("inflation", inflation, least=1)
    if load == 0:
        # The inflated capsule that nothing presses, from its top to the plate.
        angle = np.linspace(0.0, np.pi, 161)
        stress, same = material.even_stress(stretch), np.ones((2, angle.size))
        sphere = np.vstack([np.sin(angle), 1 + np.cos(angle), stretch * same, stress * same])
        return in_units(sphere, stiffness, h, r0, pressure=2 * stress / stretch), None
    unit = stiffness * h * r0
    problem = _Capsule(material, c / r0, inflation=stretch, force=load / unit, unit=unit)
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
    radius, thickness, probe_half_width, poisson_ratio, law
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
        As for `elastic_modulus`, if the modulus is outside the range of membranes.

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
    wall = (radius, thickness, probe_half_width, poisson_ratio, law)
    r0, h, c, material = _checked(wall)
    a, deep = scalar("rim_radius", rim_radius, above=0), scalar("depth", depth, above=0)
    if not c < a < r0:
        raise ValueError(
            f"rim_radius must lie between probe_half_width {c:g} and radius {r0:g}, got {a:g}"
        )
    problem = _Capsule(material, c / r0, rim=a / r0, depth=deep / r0)
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
    warn_if_implausible(found)
    return CapsuleModulus(found, float(u.inflation), _state(problem, solution, found, r0, h))


def _checked(wall: tuple[Any, ...]) -> tuple[float, float, float, Law]:
    """Return radius, thickness, probe_half_width and the law."""
    radius, thickness, probe_half_width, poisson_ratio, law = wall
    r0, h = scalar("radius", radius, above=0), scalar("thickness", thickness, above=0)
    c = scalar("probe_half_width", probe_half_width, above=0, below=r0)
    return r0, h, c, law_of(law, poisson_ratio)


def _solve(problem: _Capsule, near: Solved | None = None) -> Solved:
    """Return a checked solution and the problem that it solves, which may have a slack zone.

    A shape that passes through the plate, the probe or itself is refused.
    """
    found = None
    # Of a finer mesh a start from the sphere is faster.
    if near and near[1].x.size <= 400:
        moved, guess = problem.after(*near)
        found = moved.attempt(guess, moved.tolerance)
    solved, solution = found or problem.find()
    u = solved.unpack(solution.p)
    # A dimple's rim lies outside the probe; on a smaller circle the face only flattens the wall.
    if u.rim <= solved.probe:
        least = np.pi * solved.probe**2 * u.pressure
        raise ValueError(
            "force must lay the wall on the whole face of the probe, which takes about "
            f"{least * problem.unit:.3g} µN, got {u.force * problem.unit:.3g} µN"
        )
    dimple = _parts(solution.y)[2]
    above = dimple.z.min() > 0
    clear = dimple.pull[-1] < 0 and dimple.r.min() >= (1 - 1e-9) * solved.probe
    apart = 0 < u.core < u.plate < np.pi / 2 < u.crest <= solved.edge
    for wanted, fine in {
        "keep the probe above the plate, got one that presses the dimple through it": above,
        "leave the wall clear of the probe's side, got one that folds it below the probe": clear,
        "leave a wall between the plate's contact and the dimple, got one that swallows it": apart,
    }.items():
        if not fine:
            raise ValueError(f"force must {wanted}")
    return solved, solution


def _state(
    problem: _Capsule, solution: Any, modulus: float, radius: float, h: float
) -> MembraneState:
    u = problem.unpack(solution.p)
    # The middle of the plate lies in no zone.
    middle = np.array([0.0, 0.0, np.nan, np.nan, 0.0, 0.0])
    if not problem.slack:
        middle[2:4] = stretch = solution.y[0, 0] * u.inflation / np.sin(u.core)
        middle[4:] = problem.law.even_stress(stretch)
    # From the probe's edge to the plate's middle; zones share their ends.
    zones = [zone[:, ::-1] for zone in reversed(problem.meridian(solution))]
    meridian = np.column_stack([*zones, middle])
    again = np.flatnonzero(np.hypot(*np.diff(meridian[:2])) < 1e-12) + 1  # but for rounding
    dimple = _parts(solution.y)[2]
    sizes = {"depth": dimple.z[0] - dimple.z[-1], "approach": 2 - dimple.z[-1]}
    sizes |= {"rim_radius": u.rim, "pressure": u.pressure}
    return in_units(np.delete(meridian, again, axis=1), modulus, h, radius, **sizes)
