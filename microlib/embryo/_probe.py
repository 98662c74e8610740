"""Detection of the probe in an image: its end, direction and width.

The probe is a dark bar, or a glass tube that is bright between two dark walls, and enters the image
through its upper edge. Its sides are followed from row to row down to the row where its width
jumps. The image of a leaning probe is rotated so that the probe is vertical.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, median_filter

from microlib._common import Array, FlatResult, as_array, robust_std
from microlib.embryo._rotation import Rotation

# The grey levels that separate the probe from what is beside and below it are stated here alone.
# Each is a mixture of two grey levels that are measured in the same image.

#: A run of pixels at the upper edge of the image belongs to a probe if it is darker than this
#: fraction of the ground. The blur, px, keeps noise from interrupting the probe's sides. The second
#: pair finds the walls of a glass tube in a coarse image, which are one px wide: without it, 12 of
#: 24 tubes in `benchmarks/capsule_embryo.py` are lost.
_BLUR_AND_DARKNESS = ((1.0, 0.75), (0.5, 0.85))
#: Level that ends the probe sideways in each row, from that of the probe (0) to that of the ground
#: (1). The fluid of the embryo is darker than the ground, so that the level is below the middle.
_SIDE_LEVEL = 1 / 3
#: Level at which an edge is located to a fraction of a pixel: a blur does not move the middle.
_EDGE_LEVEL = 1 / 2

# Lengths are in px. Numbers without a name below may be halved or doubled: E of nine embryos then
# changes by less than 2 %.

#: Rows at the upper edge in which the probe is searched, and least length of a leaning probe.
_TOP_ROWS = 16
#: Least side of an image.
MIN_IMAGE = 4 * _TOP_ROWS
#: Largest width of a probe, as a fraction of the width of the image.
_WIDEST = 0.1
#: Upper fraction of its length from which the direction and width of the probe, and the ground, are
#: measured: the embryo is beside its end. 0.5 to 0.85 change E by 0.2 of its standard deviation.
_UPPER_PART = 0.7
#: Margin beside a blurred edge; 0 to 5 change E by up to 0.2 of its standard deviation.
MARGIN = 2
#: Interval of the profiles across the probe's edges.
_INTERVAL = 0.25
#: Largest tilt by which an image is rotated.
_MAX_TILT = np.deg2rad(62.0)
#: Margin beside the probe for its blur.
CLEARANCE = 3.0


@dataclass(frozen=True)
class Probe(FlatResult):
    """Position and width of a probe that comes from above.

    Attributes
    ----------
    tip : tuple of float
        Middle of its lower end, (x, y) in px, y down.
    slope : float
        Change of x for each px down: the tangent of its tilt.
    half_width : float
        Half of its width at the tip, in px.
    taper : float
        Change of the half-width for each px down; 0 for parallel sides.
    """

    tip: tuple[float, float]
    slope: float
    half_width: float
    taper: float = 0.0

    def axis(self, y: ArrayLike) -> Array:
        """Return x of the probe's axis at the image height `y`, both in px."""
        return self.tip[0] + self.slope * (as_array("y", y) - self.tip[1])

    def half_width_at(self, y: ArrayLike) -> Array:
        """Return half of the width in px at the image height `y`, constant below the tip."""
        above = np.minimum(as_array("y", y) - self.tip[1], 0.0)
        return self.half_width + self.taper * above


class UprightImage(NamedTuple):
    """An image in which the probe comes from above, from `find_probe`."""

    grey: NDArray[np.float32]
    probe: Probe
    rotation: Rotation  # from the original image


def find_probe(whole: NDArray[np.float32], rotation: Rotation) -> UprightImage:
    """Find the probe in an image rotated as given, or rotated further by the tilt of the probe."""
    reasons: list[str] = []
    for blur, darkness in _BLUR_AND_DARKNESS:
        for candidate in _rotations(whole, rotation, blur, darkness):
            grey = np.ascontiguousarray(candidate.apply(whole))
            try:
                probe = _measure(_smoothed(grey, blur), darkness)
            except ValueError as reason:
                reasons.append(str(reason))
            else:
                return UprightImage(grey, probe, candidate)
    raise ValueError(reasons[0])  # of the image as given, which is tried first


def _smoothed(grey: NDArray[np.float32], blur: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), blur), dtype=np.float32)


class _Runs(NamedTuple):
    """Dark runs of pixels at the upper edge of an image."""

    top: Array  # mean of the first rows
    ground: Array  # the same without the runs
    ends: NDArray  # first pixel of each run and the one behind its last, shape (n, 2)


def _runs(smooth: NDArray[np.float32], rows: int, darkness: float, widest: int, mode: str) -> _Runs:
    top = smooth[:rows].mean(axis=0)
    ground = median_filter(top, 4 * widest + 1, mode=mode)  # four times as wide as a bar
    dark = np.concatenate([[0], (top < darkness * ground).view(np.int8), [0]])
    return _Runs(top, ground, np.flatnonzero(np.diff(dark)).reshape(-1, 2))


def _follow(smooth: NDArray[np.float32], run: NDArray, level: float, ground: Array) -> NDArray:
    """Return both ends of a dark run, or of the walls of a tube, in each row until the run ends.

    The ends of a leaning run move by up to 1.9 px from row to row. Below the end of a probe the run
    extends over the embryo.
    """
    left, right = run.tolist()
    limit = level + _SIDE_LEVEL * (float(ground[left:right].mean()) - level)
    ends = []
    for row in smooth:
        first, last = max(left - 3, 0), min(right + 3, row.size)
        dark = np.flatnonzero(row[first:last] < limit)
        if dark.size == 0:
            break
        left, right = first + int(dark[0]), first + int(dark[-1]) + 1
        ends.append((left, right))
    return np.array(ends, dtype=int).reshape(-1, 2)


def _end_row(width: NDArray) -> int:
    """Return the row in which a bar of these widths ends, where the width jumps or is 0."""
    if len(width) < _TOP_ROWS:
        return len(width)
    before = np.concatenate([width[:_TOP_ROWS], width[:-1]])
    windows = sliding_window_view(before, _TOP_ROWS)
    half = _TOP_ROWS // 2
    upper, lower = np.median(windows[:, :half], axis=1), np.median(windows[:, half:], axis=1)
    # A taper is extrapolated from the medians of the last rows' two halves.
    expected = lower + (lower - upper) * (half + 1) / (2 * half)
    expected[:_TOP_ROWS] = np.median(windows[:_TOP_ROWS], axis=1)
    jumps = (np.abs(width - expected) > expected / 3 + 1) | (width == 0)
    return int(np.append(jumps, True).argmax())


def _rotations(
    whole: NDArray[np.float32], rotation: Rotation, blur: float, darkness: float
) -> Iterator[Rotation]:
    """Yield the given rotation, then that after which the longest leaning bar is vertical.

    The rotated image begins where the bar is in the image with its whole width, which is below the
    upper edge for a bar that enters through a corner.
    """
    yield rotation
    smooth = _smoothed(np.ascontiguousarray(rotation.apply(whole)), blur)
    columns = smooth.shape[1]
    widest = int(_WIDEST * columns / np.cos(_MAX_TILT))
    # The mode "nearest" would continue a bar in the corner as dark ground.
    runs = _runs(smooth, 3, darkness, widest, "reflect")
    bars = []
    for run in runs.ends:
        ends = _follow(smooth, run, float(runs.top[slice(*run)].min()), runs.ground)
        # The side of the image cuts a bar in the corner, whose width grows over the first rows.
        cut = (ends[:, 0] == 0) | (ends[:, 1] == columns)
        row = int(np.append(cut, False).argmin())
        width = np.ptp(ends[row:], axis=1)
        rows = row + np.arange(_end_row(width))
        if rows.size > _TOP_ROWS and 2 <= width[0] <= widest:
            slope, start = _robust_line(rows, (ends[rows].sum(axis=1) - 1) / 2)
            if abs(slope) < np.tan(_MAX_TILT):
                bars.append((rows.size, slope, start, float(width[0]) / 2))
    if not bars:
        return
    _, slope, start, half = max(bars)
    sides = start + np.array([-half, half])
    # A bar that enters through a side of the image does so below the upper edge.
    inside = np.clip(sides, 0.0, columns - 1.0)
    below = np.maximum((inside - sides) / slope, 0.0) if slope else np.zeros(2)
    upright = rotation.upright(slope, np.stack([inside, below], axis=1))
    if min(upright.frame[2:]) >= MIN_IMAGE:
        yield upright


def _measure(grey: NDArray[np.float32], darkness: float) -> Probe:
    """Return the bar or tube that enters a blurred image through its upper edge.

    Its edges are found to a fraction of a pixel. Its upper part gives direction and width, because
    the embryo is beside its end.
    """
    ends, level, is_tube = _entering(grey, darkness)
    width = np.ptp(ends, axis=1)
    end = _end_row(width)
    if end < 2 * _TOP_ROWS or end >= len(grey) - 4:
        raise ValueError(
            f"image must show the probe's end inside it, got a bar that ends at row {end} of "
            f"{len(grey)}"
        )
    columns = np.arange(grey.shape[1])
    if is_tube:
        # The end of a glass tube is as dark as the chorion below it, so that the tube is filled
        # down to where both walls end.
        within = (columns >= ends[:, :1]) & (columns < ends[:, 1:])
        grey = grey.copy()
        np.minimum(grey[: len(ends)], level, out=grey[: len(ends)], where=within)
    rows = np.arange(2, int(_UPPER_PART * end))
    usual = np.median(width[:_TOP_ROWS])
    sides = []
    for row in rows:
        across = width[row] if abs(width[row] - usual) > MARGIN else usual
        distance, middle = np.arange(0.0, across / 2 + 4, _INTERVAL), (ends[row].sum() - 1) / 2
        left, right = (np.interp(middle + sign * distance, columns, grey[row]) for sign in (-1, 1))
        sides.append((middle - _edge(left, level, 4), middle + _edge(right, level, 4)))
    slopes, starts = np.transpose([_robust_line(rows, side) for side in np.transpose(sides)])
    slope, start = float(slopes.mean()), float(starts.mean())
    # The model has its load along the axis. Outlines are found up to four times this tilt
    # (measured).
    if abs(slope) > np.tan(np.deg2rad(4)):
        raise ValueError(
            "image must show a straight probe, got one that still leans or bends by "
            f"{np.rad2deg(np.arctan(slope)):.1f}° after the image was rotated"
        )
    narrowing = float(slopes[1] - slopes[0])
    tapered = abs(narrowing) * rows.size > MARGIN
    half_width = float(starts[1] - starts[0] + narrowing * (end if tapered else rows.mean())) / 2
    upper = Probe((start, 0.0), slope, half_width)
    tip = _tip_row(grey, upper, end, level)
    taper = narrowing / 2 if tapered else 0.0
    return Probe((float(upper.axis(tip)), tip), slope, half_width / np.hypot(1.0, slope), taper)


class _Entering(NamedTuple):
    """The bar or tube that enters an image through its upper edge."""

    ends: NDArray  # first pixel of each row and the one behind the last, shape (n, 2)
    level: float  # grey level of the bar or of the tube's walls
    is_tube: bool


def _entering(grey: NDArray[np.float32], darkness: float) -> _Entering:
    widest = int(_WIDEST * grey.shape[1])
    runs = _runs(grey, _TOP_ROWS, darkness, widest, "nearest")
    width = np.ptp(runs.ends, axis=1)
    bars = runs.ends[(width >= 4) & (width <= widest)]
    # Two runs are the walls of a tube if they are thin and of similar width. A blur of 1 px makes a
    # thin wall at least 2 px wide.
    tubes = np.stack([runs.ends[:-1, 0], runs.ends[1:, 1]], axis=1)
    across = np.ptp(tubes, axis=1)
    thin, thick = np.minimum(width[:-1], width[1:]), np.maximum(width[:-1], width[1:])
    tubes = tubes[(thin >= 2) & (thick <= 2 * thin) & (thick <= across / 3) & (across <= widest)]
    is_tube = len(tubes) == 1 and bool(np.all((bars >= tubes[0, 0]) & (bars <= tubes[0, 1])))
    if not is_tube and len(bars) != 1:
        raise ValueError(
            "image must show one dark probe that enters through its upper edge, "
            f"got {len(bars)} bars of 4 to {widest} px there"
        )
    run = (tubes if is_tube else bars)[0]
    level = float(runs.top[slice(*run)].min() if is_tube else runs.top[run.sum() // 2])
    return _Entering(_follow(grey, run, level, runs.ground), level, is_tube)


def _edge(profile: Array, level: float, outside: int) -> float:
    """Return where a profile changes from the probe's level to that outside, in px, or NaN.

    The grey level outside of the probe is the mean of the last `outside` samples.
    """
    limit = level + _EDGE_LEVEL * (profile[-outside:].mean() - level)
    k = int((profile > limit).argmax())
    beyond = (limit - profile[k - 1]) / (profile[k] - profile[k - 1]) if k > 0 else np.nan
    return _INTERVAL * float(k - 1 + beyond)


def _robust_line(x: NDArray, y: NDArray) -> tuple[float, float]:
    """Return slope and intercept of a line, fitted again without outliers beyond 3 sigma."""
    use = np.isfinite(y)
    if use.sum() < _TOP_ROWS // 2:
        raise ValueError(
            "image must show the probe's edges against a brighter ground, got them in "
            f"{use.sum()} of {use.size} rows"
        )
    for _ in range(2):
        slope, start = np.polyfit(x[use], y[use], 1)
        off = np.abs(y - start - slope * x)
        use = off <= 3 * robust_std(off[use]) + np.finfo(np.float32).eps
    return float(slope), float(start)


def _tip_row(grey: NDArray[np.float32], upper: Probe, end: int, level: float) -> float:
    """Return the row where the middle of the probe changes to the grey level of the embryo."""
    reach = _TOP_ROWS // 2
    y = np.arange(end - reach, min(end + reach + 1, len(grey) - 1.0), _INTERVAL)
    across = np.linspace(-0.5, 0.5, 4) * upper.half_width
    x = upper.axis(y)[:, np.newaxis] + across
    where = np.stack([np.broadcast_to(y[:, np.newaxis], x.shape), x])
    profile = map_coordinates(grey, where, order=1, mode="nearest").mean(axis=1)
    tip = float(y[0] + _edge(profile, level, round(3 / _INTERVAL)))
    if np.isnan(tip):
        raise ValueError("image must show the probe's end against brighter pixels, got none")
    return tip


def remove_probe(grey: NDArray[np.float32], probe: Probe) -> NDArray[np.float32]:
    """Return an image with its probe replaced by the ground beside it.

    The ground on each side is a line fitted above the embryo and extrapolated to the probe's end.
    Between the sides the ground is interpolated linearly.
    """
    filled = grey.copy()
    rows = np.arange(int(np.ceil(probe.tip[1] + 1)))
    axis = probe.axis(rows)
    reach = probe.half_width_at(rows) + CLEARANCE
    measured = rows[: int(_UPPER_PART * rows.size)]
    levels = []
    for side in (-1, 1):
        beside = np.rint(axis[measured] + side * (reach[measured] + MARGIN)).astype(int)
        beside = np.clip(beside, 0, filled.shape[1] - 1)
        slope, start = _robust_line(measured, filled[measured, beside])
        levels.append(start + slope * rows)
    axis, reach = axis[:, np.newaxis], reach[:, np.newaxis]
    across = (np.arange(filled.shape[1]) - axis + reach) / (2 * reach)
    ground = levels[0][:, np.newaxis] * (1 - across) + levels[1][:, np.newaxis] * across
    inside = (across >= 0) & (across <= 1)
    filled[: rows.size][inside] = ground[inside]
    return filled
