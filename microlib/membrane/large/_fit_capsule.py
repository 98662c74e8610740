"""A capsule's modulus from its outline: the shell that passes closest to the points."""

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
from microlib.membrane.large._capsule import Solved, capsule_modulus, indent_capsule, indent_near
from microlib.membrane.large._solver import MembraneState

# Way of the first step in widths of the outline: 1 µm of an egg. What is tried further off is
# another capsule, which takes the solver ten times as long.
_FIRST_STEP = 1e-3
# Searches from other starts. Of outlines of capsules the third finds what the twelfth would.
_MOST_SEARCHES = 3


@dataclass(frozen=True, eq=False, repr=False)
class CapsuleFit(Tidy):
    """
    The capsule that an outline shows, from `fit_capsule`.

    Attributes
    ----------
    modulus, modulus_std : float
        Elastic modulus E at small strain and its standard deviation from the scatter of the points
        alone, in MPa.
    inflation : float
        Stretch of the wall before the test.
    radius : float
        Radius R before the test, in µm, fitted or as given.
    center : tuple of float
        Position of the axis, and of the plate, in the outline's coordinates, in µm.
    tilt : float
        Angle of the axis clockwise from the vertical, in radians; 0 where it was not fitted.
    misfit : float
        Root mean square distance of the points from the shell, in µm.
    state : MembraneState
        The fitted capsule.

    Notes
    -----
    `misfit` beside the noise of the points tells whether the model draws the outline at all;
    `modulus_std` knows nothing of a wrong model.
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
    r"""
    Elastic modulus and inflation of a capsule from points of its outline.

    Parameters
    ----------
    force : float
        Force F of the probe, in µN.
    outline : (N, 2) array_like
        Points of the outline seen from the side, across and up, in µm, N ≥ 20, in the outline's
        order. Of one side only, they are counted from about the axis. Points nearer to the axis
        than `probe_half_width` are left out.
    thickness, probe_half_width : float
        h before inflation and c, in µm.
    radius : float, optional
        R before the test, in µm. By default it is fitted, which needs the outline's widest part.
    poisson_ratio, law
        As for `indent_capsule`.
    start : tuple of float, optional
        Modulus (MPa) and inflation to search from first, such as those of the same egg in the image
        before; saves most of the time. By default, and where that search ends further from the
        points than `thickness`, from where the outline turns.
    fit_tilt : bool, optional
        Whether the axis may be off the vertical by a small angle, which is then fitted; needs both
        sides. An image shows a probe's direction to about a mrad, and an outline whose sides are
        off by that scatters as if the modulus were twice as uncertain.

    Returns
    -------
    CapsuleFit
        `modulus` and `modulus_std` (MPa), `inflation`, `radius` (µm), the `center` of axis and
        plate in the outline's coordinates (µm), the axis' `tilt` (radians), the root mean square
        `misfit` (µm), and the `state` of the capsule, as from `indent_capsule`. `modulus_std` is
        that of the points' scatter alone: a `misfit` above the noise says that the capsule does not
        draw the outline.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if no capsule comes near the points.

    Notes
    -----
    Least squares of the distances between points and the meridian of `indent_capsule`, over E, the
    inflation (at least 1), the place of axis and plate, R, and the tilt. The standard deviation
    allows for distances that are alike along the outline, over up to √N points (Newey and West
    1987), and for what the fit follows of the errors.

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
    # Fewer cannot tell four or five numbers and their scatter.
    if len(points) < 20:
        raise ValueError(f"outline must have at least 20 points, got {len(points)}")
    if (wide := np.ptp(points[:, 0])) <= c:
        raise ValueError(f"outline must be wider than half the probe, {c:g} µm, got {wide:g} µm")
    known = None if radius is None else scalar("radius", radius, above=0)
    near = None if start is None else as_array("start", start, shape=(2,))
    shell = {"thickness": thickness, "probe_half_width": c, "poisson_ratio": poisson_ratio}
    fit = _Fit(load, points, shell | {"law": law}, known)
    searches = []
    for guess in islice(fit.starts(near), _MOST_SEARCHES):
        searches.append(fit.search(guess))
        place, found = min(searches, key=lambda each: float(each[1].cost))
        # Whoever says where to begin knows the egg: a search that comes this near was not caught.
        if near is not None and np.sqrt(np.mean(found.fun**2)) < thickness:
            break
        # What is left of a capsule's outline changes sign from point to point: the correlation of
        # neighbors is 0.3 to 0.5 in an image, and 0.97 where a search was caught on its way.
        left = searches[-1][1].fun
        if left[1:] @ left[:-1] <= 0.85 * (left @ left):
            break
    # Once more with the points that lie outside the probe as it was found.
    place, found = fit.search(place, fit_tilt)
    modulus = float(np.exp(place.log_modulus))
    spread = _variance(found.jac, found.fun)  # of the logarithm
    center = fit.middle + _turn(place.tilt) @ ((place.axis, place.plate) - fit.middle)
    return CapsuleFit(
        modulus=modulus,
        modulus_std=float(modulus * np.sqrt(spread)),
        inflation=float(place.inflation),
        radius=float(place.radius),
        center=(float(center[0]), float(center[1])),
        tilt=float(place.tilt),
        misfit=float(np.sqrt(np.mean(found.fun**2))),
        state=fit.state(place),
    )


class _Place(NamedTuple):
    """A capsule, and where it lies in the outline's coordinates; the tilt is about the middle."""

    log_modulus: float
    inflation: float
    axis: float
    plate: float
    radius: float
    tilt: float = 0.0


class _Fit:
    """The search for the capsule that passes closest to the points of an outline."""

    def __init__(
        self, force: float, points: Array, shell: dict[str, Any], radius: float | None
    ) -> None:
        self.force, self.points, self.shell, self.radius = force, points, shell, radius
        self.middle, self.wide = points.mean(axis=0), float(np.ptp(points[:, 0]))
        self._states: dict[tuple[float, ...], MembraneState] = {}
        self._last: Solved | None = None

    def state(self, place: _Place) -> MembraneState:
        """Return the capsule; the search for it goes on from the last: a third of the time."""
        key = (float(place.log_modulus), float(place.inflation), float(place.radius))
        if key not in self._states:
            modulus, wall = float(np.exp(key[0])), (key[2], *self.shell.values())
            found = indent_near(self._last, self.force, modulus, key[1], wall)
            self._states[key], self._last = found
        return self._states[key]

    def distances(self, place: _Place, used: Array) -> Array:
        """Return how far points lie from the meridian, positive on one side of it."""
        try:
            state = self.state(place)
        except ValueError:
            # No such capsule: further than any point can be.
            return np.full(len(used), np.ptp(used))
        if place.tilt:
            used = self.middle + (used - self.middle) @ _turn(place.tilt)
        # A point that the axis comes too near to stays beside the probe: no distance jumps.
        across = np.maximum(np.abs(used[:, 0] - place.axis), self.shell["probe_half_width"])
        return _signed_distances(across, used[:, 1] - place.plate, state.r, state.z)

    def search(self, start: _Place, tilted: bool = False) -> tuple[_Place, OptimizeResult]:
        """Return the place nearest to the points beside the probe, and SciPy's result."""
        off_axis = np.abs(self.points[:, 0] - start.axis)
        used = self.points[off_axis > self.shell["probe_half_width"]]
        sought = [True, True, True, True, self.radius is None, tilted]
        # Counted from the start, but for the plate's height, whose distance from its origin is how
        # far the first step may go.
        origin = np.array(start)
        origin[3] -= _FIRST_STEP * self.wide
        # Far above the solver's error, far below any curvature.
        step = 1e-4 * np.array([1.0, 1.0, self.wide, self.wide, start.radius, 1.0])[sought]
        least = np.array([-np.inf, 1.0 - origin[1], *[-np.inf] * 4])[sought]

        def place(moved: Array) -> _Place:
            there = origin.copy()
            there[sought] += moved
            return _Place(*there)

        def left(moved: Array) -> Array:
            return self.distances(place(moved), used)

        def slopes(moved: Array) -> Array:
            here = left(moved)
            return np.transpose([(left(moved + by) - here) / by.sum() for by in np.diag(step)])

        # Of N points it is N × 1e-6 of their variance, which moves no parameter by more than 0.03
        # of its deviation for a thousand of them.
        stop = {"ftol": 1e-6, "max_nfev": 40}
        first, bounds = (np.array(start) - origin)[sought], (least, np.inf)
        fit = least_squares(left, first, slopes, bounds, x_scale="jac", **stop)
        return place(fit.x), fit

    def starts(self, given: Array | None) -> Iterator[_Place]:
        """Yield the capsule that was given, and those that turn where the points do."""
        (x, z), c = self.points.T, self.shell["probe_half_width"]
        crest, half = float(z.max()), self.wide / 2
        top = x[z > crest - 0.01 * half]
        # Two crests have the dimple between them; one is that of a single side, from its axis.
        between = (x > top.min()) & (x < top.max()) & (z > crest - half)
        two = between.any() and crest - z[between].min() > 0.015 * half
        axis = float(top.min() + top.max()) / 2 if two else 0.0
        across = np.abs(x - axis)
        size = float(across.max()) if self.radius is None else self.radius
        if given is not None:
            with suppress(ValueError):  # no such capsule: the outline itself says where to begin
                modulus, inflation = given
                egg = indent_capsule(
                    self.force, modulus=modulus, inflation=inflation, radius=size, **self.shell
                )
                yield _Place(np.log(modulus), inflation, axis, crest - egg.z.max(), size)
        rim = float(np.clip(np.median(np.abs(top - axis)), 3 / 2 * c, 3 / 4 * size))
        depth = max(_depth(across, crest - z, rim, c, size), 0.02 * size)
        # The crest is flat, so its radius is the least certain.
        refused, found = None, False
        for wider, deeper in product((1.0, 0.9, 1.1, 0.8), (1.0, 1.4, 2.0)):
            try:
                near = capsule_modulus(
                    self.force, wider * rim, deeper * depth, radius=size, **self.shell
                )
            except ValueError as reason:
                refused = reason
                continue
            found = True
            plate = crest - near.state.z.max()
            yield _Place(np.log(near.modulus), near.inflation, axis, plate, size)
        if not found:
            raise ValueError(f"outline must be near to that of a capsule: {refused}")


def _turn(angle: float) -> Array:
    """Return the matrix that turns columns (x, y) clockwise, and rows, multiplied by it, back."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, sin], [-sin, cos]])


def _depth(across: Array, below: Array, rim: float, c: float, size: float) -> float:
    """Return how deep the outline lies at the probe's edge, which it ends beside."""
    inside = (across < rim) & (across > c) & (below < size)
    if not inside.any():
        return 0.0
    # It is steepest there, and goes on as a logarithm.
    first = float(across[inside].min())
    beside = inside & (across < 2 * first)
    slope = np.polyfit(np.log(across[beside]), below[beside], 1)[0] if beside.sum() > 2 else 0.0
    return float(below[beside].max() - min(slope, 0.0) * np.log(first / c))


def _signed_distances(across: Array, up: Array, r: Array, z: Array) -> Array:
    """Return each point's distance from the nearest part of the meridian, positive on one side."""
    dr, dz = np.diff(r), np.diff(z)
    square = dr**2 + dz**2
    x, y = across[:, None] - r[:-1], up[:, None] - z[:-1]
    along = np.clip((x * dr + y * dz) / square, 0.0, 1.0)
    gap = np.hypot(x - along * dr, y - along * dz)
    nearest = np.argmin(gap, axis=1)
    rows = np.arange(across.size)
    side = (x * dz - y * dr)[rows, nearest]
    return np.where(side < 0, -1.0, 1.0) * gap[rows, nearest]


def _variance(jacobian: Array, left: Array) -> float:
    """Return the first parameter's variance, whatever correlation neighbors have on an outline.

    Products of scores up to the root of the number of points apart, with weights that fall to none
    there (Newey and West 1987): distances along an outline are alike over some points, and then of
    the other sign, which no single correlation describes. The fit follows a part of the errors, so
    that what is left scatters less: by how much is known for independent errors, and made up for.
    """
    count = len(jacobian)
    weights = np.maximum(1 - np.abs(np.arange(1 - count, count)) / round(np.sqrt(count)), 0)

    def alike(score: Array) -> float:
        return float(weights @ np.correlate(score, score, "full"))

    by_point = np.linalg.pinv(jacobian)[0]
    followed = sum(alike(by_point * each) for each in np.linalg.qr(jacobian)[0].T)
    share = 1 - followed / (by_point @ by_point)
    # Of no more points than parameters nothing is left.
    return alike(by_point * left) / max(share, float(np.finfo(float).eps))
