"""The probe in an image: where it ends, how it leans and how wide it is.

A dark bar, or a glass tube that is bright between two dark walls, enters the image through its
upper edge. Its sides are followed from row to row down to where its width jumps, which no taper
does. One that leans is looked for in the image turned so that it is upright.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, median_filter

from microlib._common import Array, Tidy, as_array
from microlib.embryo._view import View

# Lengths are in px. Where a number stands in its place, half of it and twice of it change E of nine
# embryos by less than 2 %.

#: Rows at the upper edge in which the probe is looked for, and the least length of one that leans.
_TOP_ROWS = 16
#: Least side of an image.
SMALLEST = 4 * _TOP_ROWS
#: Largest width of a probe, as a share of the image's: what else enters from above is no probe.
_WIDEST = 0.1
#: Direction and width of the probe, and the ground beside it, are read from this part of its
#: length: near its end the embryo stands beside it. 0.5 to 0.85 change E by 0.2 of its deviation.
_UPPER_PART = 0.7
#: What is left free beside a blurred edge to be sure of it; 0 to 5 change E by up to 0.2 of its
#: deviation.
MARGIN = 2
#: A crossing of the probe's outline is sought in steps of this.
_STEP = 0.25
#: Median absolute deviation to standard deviation, of the normal distribution.
MAD_TO_STD = 1.4826
#: The largest lean to which an image is turned.
_LARGEST_LEAN = np.deg2rad(62.0)
#: Left free beside the probe, for its blur.
CLEARANCE = 3.0


@dataclass(frozen=True)
class Probe(Tidy):
    """The probe in an image that is turned so that it comes from above.

    Attributes
    ----------
    tip : tuple of float
        Middle of its lower end, (x, y) in px, y down.
    slope : float
        Change of x for each px down: the tangent of its tilt.
    half_width : float
        Half of its width at the tip, in px.
    taper : float
        Change of that for each px down; 0 for a probe whose sides are parallel.
    """

    tip: tuple[float, float]
    slope: float
    half_width: float
    taper: float = 0.0

    def axis(self, y: ArrayLike) -> Array:
        """Return x of the probe's axis at the image height `y`, both in px."""
        return self.tip[0] + self.slope * (as_array("y", y) - self.tip[1])

    def half_width_at(self, y: ArrayLike) -> Array:
        """Return half of the width in px at the image height `y`; the tip's below the tip."""
        above = np.minimum(as_array("y", y) - self.tip[1], 0.0)
        return self.half_width + self.taper * above


def find_probe(whole: NDArray[np.float32], view: View) -> tuple[NDArray[np.float32], Probe, View]:
    """Return an image turned, the probe in it, and the view in which it is upright."""
    reasons: list[str] = []
    # Blurred, so that noise does not break its outline, and then once more with less blur and on a
    # fainter mark: the walls of a glass tube are one px wide in a coarse image.
    for blur, dark in ((1, 3 / 4), (0.5, 0.85)):
        views = [view]
        for each in views:
            if each.tilt and min(each.frame[2:]) < SMALLEST:
                reasons.append("image must show the probe's end, got its shaft alone")
                continue
            grey = np.ascontiguousarray(each.of(whole))
            smooth = np.asarray(cv2.GaussianBlur(grey, (0, 0), blur), dtype=np.float32)
            try:
                return grey, _measure(smooth, dark), each
            except ValueError as reason:
                reasons.append(str(reason))
            if each is view:
                views += _turned_views(smooth, view, dark)
    raise ValueError(reasons[0])


def _runs(
    smooth: NDArray[np.float32], rows: int, dark: float, widest: int, mode: str
) -> tuple[Array, Array, NDArray]:
    """Return the mean of the first rows, its ground, and both ends of each run darker than that."""
    top = smooth[:rows].mean(axis=0)
    ground = median_filter(top, 4 * widest + 1, mode=mode)  # a bar is a quarter of it
    below = np.concatenate([[0], (top < dark * ground).view(np.int8), [0]])
    return top, ground, np.flatnonzero(np.diff(below)).reshape(-1, 2)


def _follow(smooth: NDArray[np.float32], left: int, right: int, limit: float) -> NDArray:
    """Return both ends of a dark run, or of a tube's walls, in each row down to where it is gone.

    From row to row the end of one that leans moves by up to 1.9 px. Below its end a probe's run
    grows into what it stands on.
    """
    ends = []
    for row in smooth:
        first, last = max(left - 3, 0), min(right + 3, row.size)
        below = np.flatnonzero(row[first:last] < limit)
        if below.size == 0:
            break
        left, right = first + int(below[0]), first + int(below[-1]) + 1
        ends.append((left, right))
    return np.array(ends, dtype=int).reshape(-1, 2)


def _end_row(width: NDArray) -> int:
    """Return the row in which a bar of these widths ends: they jump, as no taper does, or are 0."""
    if len(width) < _TOP_ROWS:
        return len(width)
    before = np.concatenate([width[:_TOP_ROWS], width[:-1]])
    windows = sliding_window_view(before, _TOP_ROWS)
    half = _TOP_ROWS // 2
    upper, lower = np.median(windows[:, :half], axis=1), np.median(windows[:, half:], axis=1)
    # A taper goes on as between the middles of the last rows' halves.
    usual = lower + (lower - upper) * (half + 1) / (2 * half)
    usual[:_TOP_ROWS] = np.median(windows[:_TOP_ROWS], axis=1)
    odd = (np.abs(width - usual) > usual / 3 + 1) | (width == 0)
    return int(np.append(odd, True).argmax())


def _turned_views(smooth: NDArray[np.float32], view: View, dark: float) -> list[View]:
    """Return the views in which the longest bar that enters at the upper edge is upright.

    They begin where it has come in with all of its width, which through a corner of the image is
    below the upper edge; for a thin one first as if it were a tube's wall.
    """
    columns = smooth.shape[1]
    widest = int(_WIDEST * columns / np.cos(_LARGEST_LEAN))
    # Reflected, for a bar in the corner would be continued as dark ground.
    top, ground, runs = _runs(smooth, 3, dark, widest, "reflect")
    found = []
    for left, right in runs:
        limit = float((top[left:right].min() + ground[left:right].mean()) / 2)
        ends = _follow(smooth, int(left), int(right), limit)
        # A side cuts a bar that comes in through a corner: its width grows on the first rows.
        cut = (ends[:, 0] == 0) | (ends[:, 1] == columns)
        row = int(np.append(cut, False).argmin())
        width = np.ptp(ends[row:], axis=1)
        rows = row + np.arange(_end_row(width))
        if rows.size > _TOP_ROWS and 2 <= width[0] <= widest:
            slope, start = _robust_line(rows, (ends[rows].sum(axis=1) - 1) / 2)
            if abs(slope) < np.tan(_LARGEST_LEAN):
                found.append((rows.size, slope, start, float(width[0]) / 2))
    if not found:
        return []
    _, slope, start, half = max(found)
    sides = start + np.array([-half, half])
    # What comes in through a side of the image does so below its upper edge.
    inside = np.clip(sides, 0.0, columns - 1.0)
    below = np.maximum((inside - sides) / slope, 0.0) if slope else np.zeros(2)
    bar = np.stack([inside, below], axis=1)
    entries = [bar]
    if half < 8:
        # A tube's other wall may stand on either side of the one that was followed. What that costs
        # of a short bar's length may be too much.
        tube = np.stack([sides + np.array([-widest, widest]), np.zeros(2)], axis=1)
        entries = [np.concatenate([tube, bar]), bar]
    return [view.upright(slope, entry) for entry in entries]


def _measure(grey: NDArray[np.float32], dark: float) -> Probe:
    """Return the one bar or tube that enters a blurred image through its upper edge.

    Its ends are found to a fraction of a pixel. Near its end the embryo stands beside it, so that
    the upper part gives direction and width.
    """
    ends, bar, glass = _entering(grey, dark)
    width = np.ptp(ends, axis=1)
    end = _end_row(width)
    if end < 2 * _TOP_ROWS or end >= len(grey) - 4:
        raise ValueError(
            f"image must show the probe's end inside it, got a bar that ends at row {end} of "
            f"{len(grey)}"
        )
    columns = np.arange(grey.shape[1])
    if glass:
        # Down to where both walls are gone: the end of glass is as dark as the chorion below it.
        within = (columns >= ends[:, :1]) & (columns < ends[:, 1:])
        grey = grey.copy()
        np.minimum(grey[: len(ends)], bar, out=grey[: len(ends)], where=within)
    rows = np.arange(2, int(_UPPER_PART * end))
    usual = np.median(width[:_TOP_ROWS])
    sides = []
    for row in rows:
        across = width[row] if abs(width[row] - usual) > MARGIN else usual
        distance, middle = np.arange(0.0, across / 2 + 4, _STEP), (ends[row].sum() - 1) / 2
        left, right = (np.interp(middle + way * distance, columns, grey[row]) for way in (-1, 1))
        sides.append((middle - _half_way(left, bar, 4), middle + _half_way(right, bar, 4)))
    slopes, starts = np.transpose([_robust_line(rows, side) for side in np.transpose(sides)])
    slope, start = float(slopes.mean()), float(starts.mean())
    # The model has its load along the axis. The outline is found up to four times this tilt
    # (measured).
    if abs(slope) > np.tan(np.deg2rad(4)):
        raise ValueError(
            "image must show a straight probe, got one that bends by "
            f"{np.rad2deg(np.arctan(slope)):.1f}°"
        )
    narrowing = float(slopes[1] - slopes[0])
    tapered = abs(narrowing) * rows.size > MARGIN
    half_width = float(starts[1] - starts[0] + narrowing * (end if tapered else rows.mean())) / 2
    upper = Probe((start, 0.0), slope, half_width)
    tip = _tip_row(grey, upper, end, bar)
    taper = narrowing / 2 if tapered else 0.0
    return Probe((float(upper.axis(tip)), tip), slope, half_width / np.hypot(1.0, slope), taper)


def _entering(grey: NDArray[np.float32], dark: float) -> tuple[NDArray, float, bool]:
    """Return both ends in each row of the bar or tube that enters, its grey, and if it is glass."""
    widest = int(_WIDEST * grey.shape[1])
    top, ground, runs = _runs(grey, _TOP_ROWS, dark, widest, "nearest")
    width = np.ptp(runs, axis=1)
    bars = runs[(width >= 4) & (width <= widest)]
    # Two runs are the walls of a tube if they are thin and alike: of 2 px at least, what a blur of
    # 1 px leaves of a thin wall; light comes from one side.
    tubes = np.stack([runs[:-1, 0], runs[1:, 1]], axis=1)
    across = np.ptp(tubes, axis=1)
    thin, thick = np.minimum(width[:-1], width[1:]), np.maximum(width[:-1], width[1:])
    tubes = tubes[(thin >= 2) & (thick <= 2 * thin) & (thick <= across / 3) & (across <= widest)]
    glass = len(tubes) == 1 and bool(np.all((bars >= tubes[0, 0]) & (bars <= tubes[0, 1])))
    if not glass and len(bars) != 1:
        raise ValueError(
            "image must show one dark probe that enters through its upper edge, "
            f"got {len(bars)} bars of 4 to {widest} px there"
        )
    left, right = (tubes if glass else bars)[0].tolist()
    bar = float(top[left:right].min() if glass else top[(left + right) // 2])
    # Below one half of the way to the ground's grey, which the embryo's fluid does not reach.
    return _follow(grey, left, right, bar + (ground[left:right].mean() - bar) / 3), bar, glass


def _half_way(profile: Array, bar: float, ground: int) -> float:
    """Return how far along a profile it is half-way from the bar to its last samples' mean, in px.

    NaN where it begins beyond.
    """
    half = (bar + profile[-ground:].mean()) / 2
    k = int((profile > half).argmax())
    beyond = (half - profile[k - 1]) / (profile[k] - profile[k - 1]) if k > 0 else np.nan
    return _STEP * float(k - 1 + beyond)


def _robust_line(x: NDArray, y: NDArray) -> tuple[float, float]:
    """Slope and value at 0 of a straight line, outliers beyond three deviations left out once."""
    use = np.isfinite(y)
    # More than a line's two numbers, fewer than the rows of the shortest probe.
    if use.sum() < _TOP_ROWS // 2:
        raise ValueError(
            f"image must show the probe's edges against a brighter ground, got {use.sum()} of "
            f"{use.size} rows in which it does"
        )
    for _ in range(2):
        slope, start = np.polyfit(x[use], y[use], 1)
        off = np.abs(y - start - slope * x)
        use = off <= 3 * MAD_TO_STD * np.median(off[use]) + np.finfo(np.float32).eps
    return float(slope), float(start)


def _tip_row(grey: NDArray[np.float32], upper: Probe, end: int, bar: float) -> float:
    """Image height where the probe's middle turns from its own grey to that of the embryo."""
    # It is only checked against the fit, with room for 2 px.
    reach = _TOP_ROWS // 2
    y = np.arange(end - reach, min(end + reach + 1, len(grey) - 1.0), _STEP)
    across = np.linspace(-0.5, 0.5, 4) * upper.half_width
    x = upper.axis(y)[:, np.newaxis] + across
    where = np.stack([np.broadcast_to(y[:, np.newaxis], x.shape), x])
    profile = map_coordinates(grey, where, order=1, mode="nearest").mean(axis=1)
    tip = float(y[0] + _half_way(profile, bar, round(3 / _STEP)))
    if np.isnan(tip):
        raise ValueError("image must show the probe's end against something brighter, got none")
    return tip


def remove_probe(grey: NDArray[np.float32], probe: Probe) -> NDArray[np.float32]:
    """Return an image with its probe filled by the grey of the ground beside it.

    The ground on either side is measured above the embryo and continued downwards, as a straight
    line in the row, to the probe's end.
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
