"""Detection of the probe in an image: its end, direction and width.

The probe is a dark bar that enters the image through its upper edge. Its sides are followed from
row to row down to the row where its width jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, median_filter

from microlib._common import Array, FlatResult, as_array, robust_std

# The grey levels that separate the probe from what is beside and below it are stated here alone.
# Each is a mixture of two grey levels that are measured in the same image.

#: A run of pixels at the upper edge of the image belongs to a probe if it is darker than this
#: fraction of the ground. A blur of 1 px keeps noise from interrupting the probe's sides.
_DARKNESS = 0.75
#: Level that ends the probe sideways in each row, from that of the probe (0) to that of the ground
#: (1). The fluid of the embryo is darker than the ground, so that the level is below the middle.
_SIDE_LEVEL = 1 / 3
#: Level at which an edge is located to a fraction of a pixel: a blur does not move the middle.
_EDGE_LEVEL = 1 / 2

# Lengths are in px. Numbers without a name below may be halved or doubled: E of nine embryos then
# changes by less than 2 %.

#: Rows at the upper edge in which the probe is searched.
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
#: Largest tilt. The model has its load along the axis; outlines are found up to four times this
#: tilt (measured).
_MAX_TILT = np.deg2rad(4.0)
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


def find_probe(grey: NDArray[np.float32]) -> Probe:
    """Return the bar that enters an image through its upper edge.

    Its edges are found to a fraction of a pixel. Its upper part gives direction and width, because
    the embryo is beside its end.
    """
    smooth = np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0), dtype=np.float32)
    ends, level = _entering(smooth)
    width = np.ptp(ends, axis=1)
    end = _end_row(width)
    if end < 2 * _TOP_ROWS or end >= len(grey) - 4:
        raise ValueError(
            f"image must show the probe's end inside it, got a bar that ends at row {end} of "
            f"{len(grey)}"
        )
    columns = np.arange(grey.shape[1])
    rows = np.arange(2, int(_UPPER_PART * end))
    usual = np.median(width[:_TOP_ROWS])
    sides = []
    for row in rows:
        across = width[row] if abs(width[row] - usual) > MARGIN else usual
        distance, middle = np.arange(0.0, across / 2 + 4, _INTERVAL), (ends[row].sum() - 1) / 2
        left, right = (
            np.interp(middle + sign * distance, columns, smooth[row]) for sign in (-1, 1)
        )
        sides.append((middle - _edge(left, level, 4), middle + _edge(right, level, 4)))
    slopes, starts = np.transpose([_robust_line(rows, side) for side in np.transpose(sides)])
    slope, start = float(slopes.mean()), float(starts.mean())
    if abs(slope) > np.tan(_MAX_TILT):
        raise ValueError(
            "image must show a probe within 4° of the vertical, got one that leans by "
            f"{np.rad2deg(np.arctan(slope)):.1f}°; rotate the image first"
        )
    narrowing = float(slopes[1] - slopes[0])
    tapered = abs(narrowing) * rows.size > MARGIN
    half_width = float(starts[1] - starts[0] + narrowing * (end if tapered else rows.mean())) / 2
    upper = Probe((start, 0.0), slope, half_width)
    tip = _tip_row(smooth, upper, end, level)
    taper = narrowing / 2 if tapered else 0.0
    return Probe((float(upper.axis(tip)), tip), slope, half_width / np.hypot(1.0, slope), taper)


def _entering(smooth: NDArray[np.float32]) -> tuple[NDArray, float]:
    """Return both ends of the bar in each row, as from `_follow`, and its grey level."""
    top = smooth[:_TOP_ROWS].mean(axis=0)
    widest = int(_WIDEST * top.size)
    ground = median_filter(top, 4 * widest + 1, mode="nearest")  # four times as wide as a bar
    dark = np.concatenate([[0], (top < _DARKNESS * ground).view(np.int8), [0]])
    runs = np.flatnonzero(np.diff(dark)).reshape(-1, 2)
    width = np.ptp(runs, axis=1)
    bars = runs[(width >= 4) & (width <= widest)]
    if len(bars) != 1:
        raise ValueError(
            "image must show one dark probe that enters through its upper edge, "
            f"got {len(bars)} bars of 4 to {widest} px there (first rotate the image of a leaning "
            "probe, and darken the inside of a glass tube)"
        )
    level = float(top[bars[0].sum() // 2])
    return _follow(smooth, bars[0], level, ground), level


def _follow(smooth: NDArray[np.float32], run: NDArray, level: float, ground: Array) -> NDArray:
    """Return both ends of a dark run in each row until the run ends.

    Below the end of a probe the run extends over the embryo.
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
