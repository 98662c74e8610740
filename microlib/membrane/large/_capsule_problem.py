r"""The boundary-value problem of a closed, fluid-filled capsule between a probe and a plate.

Lengths are in inflated radii R, forces in E h R, pressures in E h/R. A point of the wall has the
polar angle S on the undeformed sphere, counted from the pole on the plate, and the undeformed
radius ρ = sin(S)/λ, where λ is the inflation. The meridian has three zones, each over x in [0, 1]:

1. *contact*, the wall on the plate, from its middle to the edge of contact. The plate carries the
   load, so that V = 0.
2. *side*, the free wall from the plate to the crest of the dimple.
3. *dimple*, the free wall from the crest to the edge of the probe.

V = p r²/2 − F/2π is zero at the edge of contact and at the crest. Both have therefore the same
radius, the rim radius a = √(F/πp).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from microlib._common import Array
from microlib.membrane.large._laws import Law
from microlib.membrane.large._solver import Guess, Segment, collocate, equilibrium, segment

#: Volume of the inflated capsule.
_VOLUME = 4 * np.pi / 3


class ContactZone(NamedTuple):
    """State of the wall on the plate."""

    r: Array
    horizontal: Array  # tension H, in tension scales


class FreeZone(NamedTuple):
    """State of the free wall."""

    r: Array
    z: Array
    horizontal: Array
    volume: Array  # ∫ π r² dz along the meridian from the plate


class Zones(NamedTuple):
    """The state of the whole meridian."""

    contact: ContactZone
    side: FreeZone
    dimple: FreeZone

    @classmethod
    def unpack(cls, y: Any) -> Zones:
        """Return the zones of the rows of `solve_bvp`."""
        return cls(ContactZone(*y[:2]), FreeZone(*y[2:6]), FreeZone(*y[6:]))

    def pack(self) -> Array:
        """Return the rows of `solve_bvp`."""
        return np.array([row for zone in self for row in zone])


class Unknowns(NamedTuple):
    """Unknown numbers beside the state, and numbers that follow from them. Arcs are angles S."""

    pressure: float
    inflation: float
    force: float
    rim: float
    middle_arc: float  # where the contact zone begins
    contact_arc: float  # where the wall leaves the plate
    crest_arc: float  # where the wall is highest


@dataclass(frozen=True)
class PrescribedForce:
    """Force and inflation are given; the rim radius follows from the pressure."""

    force: float
    inflation: float
    unknowns = ()

    def resolve(self, pressure: float, parameters: dict[str, Any]) -> tuple[float, float, float]:
        """Return inflation, force and rim radius."""
        return self.inflation, self.force, np.sqrt(self.force / (np.pi * pressure))

    def tension_scale(self, law: Law) -> float:
        return max(law.equibiaxial_stress(self.inflation) / self.inflation, 0.1 * self.force**0.8)

    def guess(self, law: Law) -> tuple[float, float]:
        """Return inflation and rim radius of a first guess."""
        # The tension of an uninflated capsule comes from the force, about as F^⅔. The lower limit
        # is above rounding, so that the logarithm of the pressure exists.
        inflation = max(self.inflation, 1 + max(self.force ** (2 / 3) / 3, 1e-12))
        pressure = 2 * (law.equibiaxial_stress(inflation) / inflation)
        return inflation, min(np.sqrt(self.force / (np.pi * pressure)), 3 / 4)

    def residual(self, depth: Any) -> list[Any]:
        return []

    def advice(self, probe: float) -> str:
        """Return which problem has no solution, and what to change."""
        small = "; without an inflation, such as 1.001, small forces have no solution"
        return f"at F/(E h R) = {self.force:.2g}{small * (self.inflation == 1)}"


@dataclass(frozen=True)
class PrescribedDimple:
    """Rim radius and depth are given; force and inflation are unknown."""

    rim: float
    depth: float
    unknowns = ("inflation",)

    def resolve(self, pressure: float, parameters: dict[str, Any]) -> tuple[float, float, float]:
        """Return inflation, force and rim radius."""
        return parameters["inflation"], np.pi * pressure * self.rim**2, self.rim

    def tension_scale(self, law: Law) -> float:
        return 0.05

    def guess(self, law: Law) -> tuple[float, float]:
        """Return inflation and rim radius of a first guess."""
        return 1.05, self.rim

    def residual(self, depth: Any) -> list[Any]:
        return [depth - self.depth]

    def advice(self, probe: float) -> str:
        """Return which problem has no solution, and what to change."""
        depth = self.depth / self.rim
        # All of 40 dimples by `indent_capsule` that were not inverted have a w_d/a below 0.22.
        reason = (
            "where the depth hardly determines the modulus: press deeper, or by a narrower probe"
            if depth < 0.22
            else "a dimple that probably no capsule has: check these lengths"
        )
        return (
            f"at w_d/a = {depth:.2g}, c/a = {probe / self.rim:.2g}, a/R = {self.rim:.2g}, {reason}"
        )


@dataclass(frozen=True)
class CapsuleProblem:
    """The capsule under a probe of radius `probe`, for a given force or a given dimple.

    The middle of the contact zone is in one of two states. If it is taut, it is stretched evenly.
    If it is slack, it has no stress: the wall would be shorter there than undeformed.

    The state is that of `Zones`. The methods have the form that SciPy's `solve_bvp` needs.
    """

    law: Law
    probe: float
    given: PrescribedForce | PrescribedDimple
    #: Whether the middle is slack. The contact zone then begins at the edge of the slack middle,
    #: whose arc is unknown and where the wall is undeformed, r = ρ. With a taut middle, the contact
    #: zone begins at a hundredth of the arc of contact. The error of the even stretch inside falls
    #: with the fourth power of this fraction.
    slack: bool = False

    @cached_property
    def tension_scale(self) -> float:
        return self.given.tension_scale(self.law)

    @property
    def probe_arc(self) -> float:
        """Arc of the wall at the probe's edge, where the wall keeps its radius."""
        return np.pi - float(np.arcsin(self.probe))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters of `solve_bvp`, in order.

        The arc of a slack middle has a negative sign. At its edge, where the wall begins to
        wrinkle, the stress has a kink. SciPy's differences increase a parameter, which makes the
        middle smaller and stays on its taut side.
        """
        own = ("log_pressure", "contact_arc", "crest_arc")
        return own + self.given.unknowns + (("minus_middle_arc",) if self.slack else ())

    def unpack(self, k: Any) -> Unknowns:
        """Return the unknowns of the parameters of `solve_bvp`."""
        parameters = dict(zip(self.parameter_names, k, strict=True))
        pressure = np.exp(parameters["log_pressure"])
        inflation, force, rim = self.given.resolve(pressure, parameters)
        contact_arc = parameters["contact_arc"]
        return Unknowns(
            pressure=pressure,
            inflation=inflation,
            force=force,
            rim=rim,
            middle_arc=-parameters["minus_middle_arc"] if self.slack else 0.01 * contact_arc,
            contact_arc=contact_arc,
            crest_arc=parameters["crest_arc"],
        )

    def arcs(self, x: Array, u: Unknowns) -> list[tuple[Array, Array]]:
        """Return S(x) and dS/dx of the three zones."""
        side = u.crest_arc - u.contact_arc
        # The distance from the upper pole falls in equal ratios: the dimple is nearly logarithmic.
        to_pole, rate = _geometric(np.pi - u.crest_arc, np.pi - self.probe_arc, x)
        return [
            _geometric(u.middle_arc, u.contact_arc, x),
            (u.contact_arc + side * x, np.full_like(x, side)),
            (np.pi - to_pole, -rate),
        ]

    def segments(self, x: Array, y: Array, k: Any) -> list[Segment]:
        """Return the three zones as segments of the meridian."""
        u = self.unpack(k)
        parts = []
        zones: Any = Zones.unpack(y)
        for (arc, arc_rate), zone in zip(self.arcs(x, u), zones, strict=True):
            rho, rate = np.sin(arc) / u.inflation, arc_rate / u.inflation
            # The plate carries the load on its zone.
            z, load = np.zeros_like(x), (0.0, 0.0)
            if isinstance(zone, FreeZone):
                z, load = zone.z, (u.force, u.pressure)
            horizontal = self.tension_scale * zone.horizontal
            parts.append(segment(rho, rate, zone.r, z, horizontal, *load))
        return parts

    def right_hand_side(self, x: Array, y: Array, k: Any) -> Array:
        """Return dy/dx in equilibrium."""
        rates = []
        for part in self.segments(x, y, k):
            r, z, horizontal = equilibrium(self.law, part)
            rates.append(FreeZone(r, z, horizontal / self.tension_scale, np.pi * part.r**2 * z))
        contact, side, dimple = rates
        return Zones(ContactZone(contact.r, contact.horizontal), side, dimple).pack()

    def boundary_residual(self, left: Array, right: Array, k: Any) -> Array:
        """Return the residual: zones join, the probe's edge is held, and the volume is kept."""
        u = self.unpack(k)
        start, end = Zones.unpack(left), Zones.unpack(right)
        r, horizontal = start.contact
        rho = np.sin(u.middle_arc) / u.inflation
        if self.slack:
            middle = [(r - rho) / u.middle_arc, horizontal]
        else:
            even = self.law.equibiaxial_stress(r / rho) / self.tension_scale
            middle = [horizontal / rho - even]
        contact = [end.contact.r - u.rim, end.contact.horizontal - start.side.horizontal]
        side = [start.side.r - u.rim, start.side.z, start.side.volume, end.side.r - u.rim]
        crest = [start.dimple.r - u.rim, *np.subtract(start.dimple, end.side)[1:]]  # z, H, volume
        probe = [end.dimple.r - self.probe, end.dimple.volume - _VOLUME]
        depth = self.given.residual(start.dimple.z - end.dimple.z)
        return np.array([*middle, *contact, *side, *crest, *probe, *depth])

    def initial_guess(self) -> Guess:
        """Return a sphere with a flat bottom and a logarithmic dimple."""
        inflation, rim = self.given.guess(self.law)
        rim = min(max(rim, 1.2 * self.probe), 0.95)
        tension = self.law.equibiaxial_stress(inflation) / inflation
        contact_arc = float(np.arcsin(rim))
        parameters = {
            "log_pressure": np.log(2 * tension),
            "contact_arc": contact_arc,
            "crest_arc": np.pi - contact_arc,
            "inflation": inflation,
        }
        k = np.array([parameters[name] for name in self.parameter_names])
        x = np.linspace(0.0, 1.0, 40)
        contact, side, dimple = (arc for arc, _ in self.arcs(x, self.unpack(k)))
        relative = tension / self.tension_scale

        def free(arc: Array, z: Array, volume: Array) -> FreeZone:
            return FreeZone(np.sin(arc), z, relative * np.sin(arc) * np.cos(arc), volume)

        r = rim * contact / contact_arc
        hollow = rim / 3 * np.log(rim / np.sin(dimple)) / np.log(rim / self.probe)
        zones = Zones(
            ContactZone(r, relative * r),
            free(side, np.cos(contact_arc) - np.cos(side), _VOLUME * x),
            free(dimple, 2 * np.cos(contact_arc) - hollow, np.full_like(x, _VOLUME)),
        )
        return x, zones.pack(), k

    def collocate(self, guess: Guess, tolerance: float = 1e-6) -> Any:
        """Return a solution near a guess, or None; its depth is exact to about 1e-8 of R."""
        return collocate(
            self.right_hand_side, self.boundary_residual, guess,
            tolerance=tolerance, max_nodes=1500,
        )  # fmt: skip

    def solve(self) -> tuple[CapsuleProblem, Any]:
        """Return the problem with the middle that it has, taut or slack, and its solution."""
        problem = self
        # A coarse solution is sufficient to see whether a taut middle is compressed.
        solution = problem.collocate(problem.initial_guess(), 1e-3)
        if solution is not None and problem.is_compressed(solution):
            guess = problem._slack_guess(solution)
            problem = replace(problem, slack=True)
            solution = problem.collocate(guess, 1e-3)
        if solution is not None and problem.unpack(solution.p).middle_arc > 0:
            solution = problem.collocate((solution.x, solution.y, solution.p))
            if solution is not None:
                return problem, solution
        raise self.failure

    @property
    def failure(self) -> ValueError:
        """The error for a problem without a solution."""
        return ValueError(f"the solver does not converge {self.given.advice(self.probe)}")

    def is_compressed(self, solution: Any) -> bool:
        """Return whether the middle of the contact zone is shorter than the undeformed wall."""
        u = self.unpack(solution.p)
        rho = np.sin(u.middle_arc) / u.inflation
        return bool(Zones.unpack(solution.y).contact.r[0] < rho)

    def _slack_guess(self, solution: Any) -> Guess:
        """Return a guess with a slack middle from a solution with a compressed taut one."""
        u, zones = self.unpack(solution.p), Zones.unpack(solution.y)
        arc, _ = self.arcs(solution.x, u)[0]
        taut = np.flatnonzero(zones.contact.r >= np.sin(arc) / u.inflation)
        middle_arc = min(arc[taut[0]] if taut.size else np.inf, 0.9 * u.contact_arc)
        wanted, _ = _geometric(middle_arc, u.contact_arc, solution.x)
        r, horizontal = (np.interp(wanted, arc, row) for row in zones.contact)
        contact = ContactZone(r, np.maximum(horizontal, 0.0))
        # The arc of the middle is the last of the parameters of the slack problem.
        return (
            solution.x,
            zones._replace(contact=contact).pack(),
            np.append(solution.p, -middle_arc),
        )


def _geometric(first: float, last: float, x: Array) -> tuple[Array, Array]:
    """Return the values from `first` to `last` in equal ratios, and their derivative by x."""
    ratio = np.log(last / first)
    values = first * np.exp(ratio * x)
    return values, ratio * values
