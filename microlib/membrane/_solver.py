"""What every solved membrane has in common: the search for it, the proof, and the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from microlib._common import Array, Tidy

#: Where a search begins: mesh, state, and unknowns beside the state, None where there are none.
Guess = tuple[Array, Array, Array | None]

_SUBSTEPS = 4
_GAUSS = np.polynomial.legendre.leggauss(5)
# What two independent checks of a solution may leave.
_ACCEPTED = 1e-5


class Problem:
    """A membrane's equilibrium over x in [0, 1], without units, as SciPy's `solve_bvp` has it.

    A subclass gives the equations, a guess, the imbalance of virtual work, which is none in
    equilibrium, and the stages of a load that grows, for where the guess is too far.
    """

    tolerance: float
    most_nodes: int
    said: Any  # the load, for messages
    slopes: Callable[..., Array]  # right-hand side of the equilibrium
    edges: Callable[..., Array]  # residual at the ends
    jacobian: Any = None  # of the slopes, where differences are too slow
    guess: Callable[[], Guess]
    stages: Callable[[], Iterator[Any]]
    virtual_work: Callable[[Any], float]  # its imbalance when the whole shape swells, relative

    def after(self, solved: Any, solution: Any) -> tuple[Any, Guess]:
        """Return this problem and its guess from the solution of the stage before."""
        return self, (solution.x, solution.y, solution.p)

    def attempt(self, guess: Guess) -> tuple[Any, Any] | None:
        """Return the problem and its checked solution, or None."""
        return self.checked(self.collocated(guess))

    def collocated(
        self, guess: Guess, tolerance: float | None = None, most_nodes: int | None = None
    ) -> Any:
        """Return SciPy's solution from a guess, or None."""
        x, y, k = guess
        with np.errstate(all="ignore"):
            solution = solve_bvp(
                self.slopes,
                self.edges,
                x,
                y,
                p=k,
                fun_jac=self.jacobian,
                tol=tolerance or self.tolerance,
                max_nodes=most_nodes or self.most_nodes,
            )
        return solution if solution.status == 0 and np.isfinite(solution.y).all() else None

    def checked(self, solution: Any) -> tuple[Any, Any] | None:
        """Return a solution that passes two checks which the collocation knows nothing of."""
        if solution is None:
            return None
        with np.errstate(all="ignore"):
            missed = reintegration_error(
                lambda x, y: self.slopes(x, y, solution.p), solution.x, solution.y
            )
            sound = missed < _ACCEPTED and self.virtual_work(solution) < _ACCEPTED
        return (self, solution) if sound else None

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
            raise ValueError(f"force must have an equilibrium, none was found{self.said}")
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
    energy : float
        Elastic energy stored since the membrane was free of stress, in pJ (µN·µm).
    volume : float
        Volume between a disc and its rim's plane, or inside the capsule, in µm³.

    Notes
    -----
    The true stress is :math:`\lambda_i` times the nominal one in an incompressible membrane.
    """

    _samples = ("r", "z", "stretches", "stresses")

    depth: float
    approach: float
    rim_radius: float
    r: Array
    z: Array
    stretches: Array
    stresses: Array
    pressure: float
    energy: float
    volume: float


def in_units(
    meridian: Array, modulus: float, thickness: float, length: float, **sizes: float
) -> MembraneState:
    """Return a state from r, z, stretches and stresses, and what is not zero, without units."""
    by = {
        **dict.fromkeys(("depth", "approach", "rim_radius"), length),
        "pressure": modulus * thickness / length,
        "energy": modulus * thickness * length**2,
        "volume": length**3,
    }
    return MembraneState(
        r=meridian[0] * length,
        z=meridian[1] * length,
        stretches=meridian[2:4],
        stresses=meridian[4:] * modulus,
        **{name: float(sizes.get(name, 0.0) * unit) for name, unit in by.items()},
    )


def gauss_points(mesh: Array) -> tuple[Array, Array]:
    """Return five abscissae in every interval of `mesh`, and their weights."""
    nodes, weights = _GAUSS
    half = np.diff(mesh)[:, None] / 2
    points = (mesh[:-1, None] + half) + half * nodes
    return points.ravel(), (half * weights).ravel()


def reintegration_error(
    slopes: Callable[[Array, Array], Array], mesh: Array, values: Array
) -> float:
    """Return how far Runge–Kutta, started at every node, misses the next node; relative."""
    step = np.diff(mesh) / _SUBSTEPS
    x, y = mesh[:-1].copy(), values[:, :-1].copy()
    for _ in range(_SUBSTEPS):
        k1 = slopes(x, y)
        k2 = slopes(x + step / 2, y + step / 2 * k1)
        k3 = slopes(x + step / 2, y + step / 2 * k2)
        k4 = slopes(x + step, y + step * k3)
        x, y = x + step, y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    # The states are scaled to about 1; one that is zero throughout has no size of its own.
    size = np.maximum(np.abs(values).max(axis=1, keepdims=True), 0.1)
    # Summed over the intervals: errors of one sign would pile up so far.
    return float((np.abs(y - values[:, 1:]) / size).sum(axis=1).max())
