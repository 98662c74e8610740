"""What every solved membrane has in common: the search for it, the proof, and the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_bvp

from microlib._common import Array, Tidy
from microlib.membrane.large._laws import Law

#: Where a search begins: mesh, state, and unknowns beside the state, None where there are none.
Guess = tuple[Array, Array, Array | None]

#: Relative imbalance of virtual work that a solution may leave.
_ACCEPTED = 1e-5


class Strip(NamedTuple):
    """A part of the meridian over x in [0, 1], without units; tensions are those a radian."""

    rho: Array  # undeformed radius
    rate: Array  # of the undeformed arc over x
    r: Array
    z: Array
    tension: Array  # and its direction, outward and up
    cosine: Array
    sine: Array
    pressure: float


def strip_of(
    rho: Array, rate: Array, r: Array, z: Array, pull: Array, force: float, pressure: float
) -> Strip:
    """Return the strip whose tension pulls outward and carries the probe and what presses on it."""
    lift = pressure * r**2 / 2 - force / (2 * np.pi)
    if not lift.any():  # level throughout, where a tension below zero is a compression
        return Strip(rho, rate, r, z, pull, np.ones_like(r), lift, pressure)
    tension = np.hypot(pull, lift)
    # The direction of a slack meridian is undetermined, and its tension is then zero.
    size = np.maximum(tension, np.finfo(float).tiny)
    return Strip(rho, rate, r, z, tension, pull / size, lift / size, pressure)


class Problem:
    """A membrane's equilibrium over x in [0, 1], without units, as SciPy's `solve_bvp` has it.

    A subclass gives the equations, a guess, and the stages of a load that grows, for where the
    guess is too far.
    """

    law: Law
    tolerance: float
    most_nodes: int
    strips: Callable[..., list[Strip]]  # the parts of the meridian that a state is
    rates: Callable[[Array, Array], list[tuple[Any, Any]]]  # of r and z over x, by the state's
    slopes: Callable[..., Array]  # right-hand side of the equilibrium
    edges: Callable[..., Array]  # residual at the ends
    jacobian: Any = None  # of the slopes, where differences are too slow
    guess: Callable[[], Guess]
    stages: Callable[[], Iterator[Any]]

    def after(self, solved: Any, solution: Any) -> tuple[Any, Guess]:
        """Return this problem and its guess from the solution of the stage before."""
        return self, (solution.x, solution.y, solution.p)

    def attempt(self, guess: Guess) -> tuple[Any, Any] | None:
        """Return the problem and its checked solution, or None."""
        return self.checked(self.collocated(guess))

    def collocated(self, guess: Guess, tolerance: float | None = None) -> Any:
        """Return SciPy's solution from a guess, or None."""
        x, y, k = guess
        limits = {"tol": tolerance or self.tolerance, "max_nodes": self.most_nodes}
        with np.errstate(all="ignore"):
            solution = solve_bvp(self.slopes, self.edges, x, y, k, fun_jac=self.jacobian, **limits)
        return solution if solution.status == 0 and np.isfinite(solution.y).all() else None

    def checked(self, solution: Any) -> tuple[Any, Any] | None:
        """Return a solution whose virtual work, of which the collocation knows nothing, is even."""
        if solution is None:
            return None
        with np.errstate(all="ignore"):
            return (self, solution) if self.imbalance(solution) < _ACCEPTED else None

    def find(self) -> tuple[Any, Any]:
        """Return a solved problem and its solution, by growing loads where the guess is too far."""
        found = self.attempt(self.guess())
        if found is None:
            for stage in self.stages():
                problem, guess = (stage, stage.guess()) if found is None else stage.after(*found)
                found = problem.attempt(guess)
                if found is None:
                    break
        if found is None:
            raise ValueError("force must have an equilibrium, the solver found none")
        return found

    def stressed(self, strip: Strip) -> tuple[Array, Array]:
        """Return the meridian's stretch and the hoop stress."""
        return self.law.meridian(strip.tension / strip.rho, strip.r / strip.rho)

    def balance(self, strip: Strip) -> tuple[Array, Array, Array]:
        """Return the slopes of r, z and the horizontal tension over x in equilibrium."""
        first, hoop = self.stressed(strip)
        outward, rise = first * strip.cosine, first * strip.sine
        swept = strip.pressure * strip.r * rise
        return outward * strip.rate, rise * strip.rate, (hoop - swept) * strip.rate

    def imbalance(self, solution: Any) -> float:
        """Return the relative imbalance of virtual work.

        When the whole shape swells, stresses do the work ∫(N₁λ₁ + N₂λ₂) ρ ds, the tensions at the
        ends H r + V z, and the pressure p ∫ r (r dz − z dr); all a radian.
        """
        # Four abscissae of Gauss in every interval of the mesh.
        nodes, weights = np.polynomial.legendre.leggauss(4)
        half = np.diff(solution.x)[:, np.newaxis] / 2
        x, weight = (solution.x[:-1, np.newaxis] + half + half * nodes).ravel(), half * weights
        weight = weight.ravel()
        inside = outside = 0.0
        strips = self.strips(x, solution.sol(x), solution.p)
        for strip, (r_rate, z_rate) in zip(strips, self.rates(x, solution.sol(x, 1)), strict=True):
            first = np.hypot(r_rate / strip.rate, z_rate / strip.rate)
            second = strip.r / strip.rho
            along, across = self.law.relaxed_stress(first, second)
            inside += float((along * first + across * second) @ (strip.rho * strip.rate * weight))
            pushed = strip.r * (strip.r * z_rate - strip.z * r_rate)
            outside += strip.pressure * float(pushed @ weight)
        for strip in self.strips(solution.x[[0, -1]], solution.y[:, [0, -1]], solution.p):
            lever = strip.cosine * strip.r + strip.sine * strip.z
            outside += float(np.diff(strip.tension * lever)[0])
        return abs(inside - outside) / inside if inside else abs(outside)

    def meridian(self, solution: Any) -> list[Array]:
        """Return r, z, stretches and stresses at the nodes of each strip, (6, n) each."""
        found = []
        for strip in self.strips(solution.x, solution.y, solution.p):
            first, hoop = self.stressed(strip)
            stretches, along = (first, strip.r / strip.rho), strip.tension / strip.rho
            found.append(np.array([strip.r, strip.z, *stretches, along, hoop]))
        return found


@dataclass(frozen=True, eq=False, repr=False)
class MembraneState(Tidy):
    r"""
    A membrane in equilibrium under a probe, from `indent_disc` or `indent_capsule`.

    Attributes
    ----------
    depth : float
        Depth of the probe's edge below the rim, in µm.
    approach : float
        How far the probe has moved since it touched, in µm.
    rim_radius : float
        Radius a of the rim, in µm: the clamped edge of a disc; the crest of a capsule's dimple,
        which is also the radius of its flat circle on the plate.
    r, z : (N,) ndarray
        The meridian from the probe's edge to the disc's rim or to the middle of the plate: distance
        from the axis, and height above the rim's plane or the plate, in µm.
    stretches : (2, N) ndarray
        Along the meridian and around the axis, from the stress-free membrane; NaN where slack.
    stresses : (2, N) ndarray
        Nominal stresses in the same directions, force over undeformed section, in MPa; zero around
        the axis where the membrane is wrinkled.
    pressure : float
        Pressure below the disc, or inside the capsule above that outside, in MPa.

    Notes
    -----
    The true stress is :math:`\lambda_i` times the nominal one in an incompressible membrane.
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


def in_units(
    meridian: Array,
    modulus: float,
    thickness: float,
    length: float,
    *,
    pressure: float,
    depth: float = 0.0,
    approach: float = 0.0,
    rim_radius: float = 0.0,
) -> MembraneState:
    """Return a state from r, z, stretches, stresses and sizes without units."""
    return MembraneState(
        depth=float(depth * length),
        approach=float(approach * length),
        rim_radius=float(rim_radius * length),
        pressure=float(pressure * modulus * thickness / length),
        r=meridian[0] * length,
        z=meridian[1] * length,
        stretches=meridian[2:4],
        stresses=meridian[4:] * modulus,
    )
