"""Modulus and inflation of a capsule from its outline, by least squares."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares

from microlib._common import Array, Tidy, as_array, scalar
from microlib.membrane.large._capsule import (
    capsule_modulus,
    check_shell,
    indent_capsule,
    solve_indentation,
)
from microlib.membrane.large._capsule_problem import Solved
from microlib.membrane.large._solver import MembraneState

# Length of the first step of a fit, in widths of the outline: 1 µm of an egg. A distant capsule
# takes the solver ten times as long.
_FIRST_STEP = 1e-3
# Largest number of fits from different guesses. On outlines of capsules the third fit finds the
# same minimum as the twelfth.
_MAX_FITS = 3


@dataclass(frozen=True, eq=False, repr=False)
class CapsuleFit(Tidy):
    """The capsule fitted to an outline, from `fit_capsule`.

    Attributes
    ----------
    modulus, modulus_std : float
        Elastic modulus E at small strain, in MPa, and its standard deviation from the scatter of
        the points.
    inflation : float
        Stretch of the wall before the test.
    radius : float
        Radius R before the test, in µm, fitted or as given.
    center : tuple of float
        Foot of the axis on the plate, in the coordinates of the outline, in µm.
    tilt : float
        Angle of the axis clockwise from the vertical, in radians; 0 if it was not fitted.
    misfit : float
        Root mean square distance of the points from the fitted meridian, in µm.
    state : MembraneState
        The fitted capsule.

    Notes
    -----
    `modulus_std` assumes that the model is right. A `misfit` well above the noise of the points
    means that no capsule of this law has the outline.
    """

    modulus: float
    modulus_std: float
    inflation: float
    radius: float
    center: tuple[float, float]
    tilt: float
    misfit: float
    state: MembraneState


def fit_capsule(
    force: float,
    outline: ArrayLike,
    *,
    thickness: float,
    probe_half_width: float,
    radius: float | None = None,
    poisson_ratio: float = 0.5,
    law: str = "neo-hooke",
    start: tuple[float, float] | None = None,
    fit_tilt: bool = False,
) -> CapsuleFit:
    r"""Fit the meridian of an indented capsule to points of its outline.

    Parameters
    ----------
    force : float
        Force F of the probe, in µN.
    outline : (N, 2) array_like
        Points of the outline in a side view, across and up, in µm, N ≥ 20, in the order of the
        outline. The points of one side alone have their distance from the axis as the first
        coordinate. Points closer to the axis than `probe_half_width` are not used.
    thickness, probe_half_width : float
        h before inflation and c, in µm.
    radius : float, optional
        R before the test, in µm. By default the radius is fitted, for which the outline must
        contain the widest part of the capsule.
    poisson_ratio, law
        As for `indent_capsule`.
    start : tuple of float, optional
        Initial modulus (MPa) and inflation, such as those of the same egg in the previous image. A
        good initial value saves most of the time. By default, and where neighboring distances of
        the fit from `start` have a correlation above 0.85, the initial values come from the crest
        of the outline.
    fit_tilt : bool, optional
        Whether a small angle between axis and vertical is fitted, which needs both sides of the
        outline. A tilt of a few mrad that is not fitted doubles `modulus_std`.

    Returns
    -------
    CapsuleFit
        `modulus`, `modulus_std` (MPa), `inflation`, `radius` (µm), `center` (µm), `tilt` (rad),
        `misfit` (µm) and `state`.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if no capsule is near to the outline.

    Notes
    -----
    The sum of squared distances between the points and the meridian of `indent_capsule` is
    minimized over the modulus, the inflation (at least 1), the position of axis and plate, R and
    the tilt. The assumptions are those of `indent_capsule`.

    The standard deviation allows for correlation of the distances along the outline, over up to √N
    points, by the covariance of Newey and West (1987) with a correction for the fitted parameters.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.membrane import fit_capsule, indent_capsule
    >>> state = indent_capsule(
    ...     100.0, modulus=1.0, radius=600.0, thickness=3.0, probe_half_width=25.0, inflation=1.05
    ... )
    >>> points = np.column_stack([state.r, state.z])[::5]
    >>> points += np.random.default_rng(0).normal(0.0, 0.5, points.shape)
    >>> fit = fit_capsule(100.0, points, radius=600.0, thickness=3.0, probe_half_width=25.0)
    >>> print(f"{fit.modulus:.1f} MPa, misfit {fit.misfit:.1f} µm")
    1.0 MPa, misfit 0.4 µm
    """
    load, c = scalar("force", force, above=0), scalar("probe_half_width", probe_half_width, above=0)
    points = as_array("outline", outline, shape=(None, 2))
    # Fewer points do not determine five parameters and their scatter.
    if len(points) < 20:
        raise ValueError(f"outline must have at least 20 points, got {len(points)}")
    if (width := np.ptp(points[:, 0])) <= c:
        raise ValueError(f"outline must be wider than half the probe, {c:g} µm, got {width:g} µm")
    if not isinstance(fit_tilt, (bool, np.bool_)):
        raise ValueError(f"fit_tilt must be True or False, got {fit_tilt!r:.80}")
    given_radius = None if radius is None else scalar("radius", radius, above=0)
    given_start = None if start is None else as_array("start", start, shape=(2,))
    sizes: dict[str, Any] = {"thickness": thickness, "probe_half_width": c}
    sizes |= {"poisson_ratio": poisson_ratio, "law": law}
    fit = _OutlineFit(load, points, sizes, given_radius)
    results = []
    for guess in islice(fit.initial_guesses(given_start), _MAX_FITS):
        results.append(fit.minimize(guess))
        # Neighboring distances have a correlation of 0.3 to 0.5 at the minimum of an outline from
        # an image, and of 0.97 where a fit ended early.
        residual = results[-1][1].fun
        if residual[1:] @ residual[:-1] <= 0.85 * (residual @ residual):
            break
    best = min(results, key=lambda each: float(each[1].cost))[0]
    # Once more, with the points that lie beside the fitted probe.
    best, result = fit.minimize(best, fit_tilt)
    modulus = float(np.exp(best.log_modulus))
    variance = newey_west_variance(result.jac, result.fun)  # of the logarithm
    center = fit.centroid + _rotation(best.tilt) @ ((best.axis, best.plate) - fit.centroid)
    return CapsuleFit(
        modulus=modulus,
        modulus_std=float(modulus * np.sqrt(variance)),
        inflation=float(best.inflation),
        radius=float(best.radius),
        center=(float(center[0]), float(center[1])),
        tilt=float(best.tilt),
        misfit=float(np.sqrt(np.mean(result.fun**2))),
        state=fit.state(best),
    )


class _Parameters(NamedTuple):
    """A capsule and its position in the coordinates of the outline, µm."""

    log_modulus: float
    inflation: float
    axis: float  # horizontal position of the axis
    plate: float  # height of the plate
    radius: float
    tilt: float = 0.0  # about the centroid of the points


class _OutlineFit:
    """Least squares of the distances between points and the meridian of a capsule."""

    def __init__(
        self, force: float, points: Array, sizes: dict[str, Any], radius: float | None
    ) -> None:
        self.force, self.points, self.sizes, self.radius = force, points, sizes, radius
        self.centroid, self.width = points.mean(axis=0), float(np.ptp(points[:, 0]))
        self._states: dict[tuple[float, ...], MembraneState] = {}
        self._last: Solved | None = None

    def state(self, at: _Parameters) -> MembraneState:
        """Return the capsule. The solver starts from the last one, in a third of the time."""
        key = (float(at.log_modulus), float(at.inflation), float(at.radius))
        if key not in self._states:
            shell = check_shell(key[2], **self.sizes)
            modulus = float(np.exp(key[0]))
            solved = solve_indentation(self.force, modulus, key[1], shell, self._last)
            self._states[key], self._last = solved
        return self._states[key]

    def distances(self, at: _Parameters, points: Array) -> Array:
        """Return the distances of points from the meridian, positive on one side of it."""
        try:
            state = self.state(at)
        except ValueError:  # no such capsule: the distance is above that of any point
            return np.full(len(points), np.ptp(points))
        if at.tilt:
            points = self.centroid + (points - self.centroid) @ _rotation(at.tilt)
        # Points that the axis approaches stay beside the probe, so that no distance jumps.
        across = np.maximum(np.abs(points[:, 0] - at.axis), self.sizes["probe_half_width"])
        return _signed_distances(across, points[:, 1] - at.plate, state.r, state.z)

    def minimize(
        self, start: _Parameters, fit_tilt: bool = False
    ) -> tuple[_Parameters, OptimizeResult]:
        """Return the parameters of least squares of the points beside the probe."""
        off_axis = np.abs(self.points[:, 0] - start.axis)
        points = self.points[off_axis > self.sizes["probe_half_width"]]
        free = [True, True, True, True, self.radius is None, fit_tilt]
        # The variables are differences from an origin, which is `start` but for the plate: SciPy's
        # first step is as long as the initial variables are.
        origin = np.array(start)
        origin[3] -= _FIRST_STEP * self.width
        # Steps of the derivatives, far above the error of the solver and below any curvature.
        step = 1e-4 * np.array([1.0, 1.0, self.width, self.width, start.radius, 1.0])[free]
        lower = np.array([-np.inf, 1.0 - origin[1], *[-np.inf] * 4])[free]

        def parameters(variables: Array) -> _Parameters:
            values = origin.copy()
            values[free] += variables
            return _Parameters(*values)

        def residual(variables: Array) -> Array:
            return self.distances(parameters(variables), points)

        def jacobian(variables: Array) -> Array:
            here, by_step = residual(variables), np.diag(step)
            return np.column_stack(
                [(residual(variables + by) - here) / h for by, h in zip(by_step, step, strict=True)]
            )

        # A relative change of 1e-6 of the cost moves no parameter by more than 0.03 of its standard
        # deviation for a thousand points.
        result = least_squares(
            residual, (np.array(start) - origin)[free], jacobian, (lower, np.inf),
            x_scale="jac", ftol=1e-6, max_nfev=40,
        )  # fmt: skip
        return parameters(result.x), result

    def initial_guesses(self, start: Array | None) -> Iterator[_Parameters]:
        """Yield the capsule of `start`, then capsules whose crest is that of the outline."""
        (x, z), c = self.points.T, self.sizes["probe_half_width"]
        crest, half = float(z.max()), self.width / 2
        top = x[z > crest - 0.01 * half]
        # Points of both sides have a dimple between two crests.
        between = (x > top.min()) & (x < top.max()) & (z > crest - half)
        both_sides = between.any() and crest - z[between].min() > 0.015 * half
        axis = float(top.min() + top.max()) / 2 if both_sides else 0.0
        across = np.abs(x - axis)
        radius = float(across.max()) if self.radius is None else self.radius
        if start is not None:
            modulus, inflation = start
            with suppress(ValueError):  # no such capsule
                state = indent_capsule(
                    self.force, modulus=modulus, inflation=inflation, radius=radius, **self.sizes
                )
                yield _Parameters(np.log(modulus), inflation, axis, crest - state.z.max(), radius)
        rim = float(np.clip(np.median(np.abs(top - axis)), 3 / 2 * c, 3 / 4 * radius))
        depth = max(_depth_at_probe(across, crest - z, rim, c, radius), 0.02 * radius)
        # The crest is flat, so that its radius is the least certain.
        error, found = None, False
        for wider, deeper in product((1.0, 0.9, 1.1, 0.8), (1.0, 1.4, 2.0)):
            try:
                near = capsule_modulus(
                    self.force, wider * rim, deeper * depth, radius=radius, **self.sizes
                )
            except ValueError as reason:
                error = reason
                continue
            found = True
            plate = crest - near.state.z.max()
            yield _Parameters(np.log(near.modulus), near.inflation, axis, plate, radius)
        if not found:
            raise ValueError(f"outline must be near to that of a capsule: {error}")


def _rotation(angle: float) -> Array:
    """Return the matrix that rotates columns (x, y) clockwise, and rows counterclockwise."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, sin], [-sin, cos]])


def _depth_at_probe(across: Array, below: Array, rim: float, c: float, radius: float) -> float:
    """Return the depth of the outline at the probe's edge, extrapolated as a logarithm."""
    inside = (across < rim) & (across > c) & (below < radius)
    if not inside.any():
        return 0.0
    first = float(across[inside].min())
    beside = inside & (across < 2 * first)
    slope = np.polyfit(np.log(across[beside]), below[beside], 1)[0] if beside.sum() > 2 else 0.0
    return float(below[beside].max() - min(slope, 0.0) * np.log(first / c))


def _signed_distances(across: Array, up: Array, r: Array, z: Array) -> Array:
    """Return each point's distance from the polyline (r, z), positive on one side."""
    dr, dz = np.diff(r), np.diff(z)
    square = dr**2 + dz**2
    x, y = across[:, None] - r[:-1], up[:, None] - z[:-1]
    along = np.clip((x * dr + y * dz) / square, 0.0, 1.0)
    distance = np.hypot(x - along * dr, y - along * dz)
    nearest = np.argmin(distance, axis=1)
    rows = np.arange(across.size)
    side = (x * dz - y * dr)[rows, nearest]
    return np.where(side < 0, -1.0, 1.0) * distance[rows, nearest]


def newey_west_variance(jacobian: Array, residual: Array) -> float:
    """Return the variance of the first parameter, for residuals correlated along the outline.

    The covariance is that of Newey and West (1987): products of the scores of points up to √N
    apart, with weights that fall to zero there. Residuals scatter less than errors because the
    fit follows a fraction of the errors. The correction divides by the rest of the variance, which
    is exact for independent errors.
    """
    count = len(jacobian)
    weights = np.maximum(1 - np.abs(np.arange(1 - count, count)) / round(np.sqrt(count)), 0)

    def long_run_variance(score: Array) -> float:
        return float(weights @ np.correlate(score, score, "full"))

    influence = np.linalg.pinv(jacobian)[0]
    directions = np.linalg.qr(jacobian)[0].T
    fitted = sum(long_run_variance(influence * each) for each in directions)
    rest = 1 - fitted / (influence @ influence)
    # With no more points than parameters the rest is zero.
    return long_run_variance(influence * residual) / max(rest, float(np.finfo(float).eps))
