"""From an image to the upper outline of an embryo: find the probe, take it out, follow the edge.

The chain of the thesis' section 5.6 (crop, mark and remove the probe, Canny, contour), with nobody
marking anything. The image shows the probe coming from one of its edges onto the embryo, dark on a
bright ground, and is turned so that this edge is the upper one. Image points are (x, y) in px with
y *down*; the outline is given with y *up*, as `fit_gaussians` and the thesis' figures have it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, median_filter, spline_filter
from scipy.signal import savgol_filter

from microlib._common import Array, Tidy, as_array, as_image, flag, one_of
from microlib.embryo._view import DIRECTIONS, View, part_of
from microlib.embryo._wall import locate_wall

# Lengths are in px. What other values of these do to the modulus stands in the benchmark "Other
# values of the constants" (benchmarks/embryo.py): none moves it by its own standard deviation.
# Where a comment says "nothing changes", that is the range measured there.

#: Least side of an image: four times the rows in which a probe is looked for.
_SMALLEST = 64
#: Rows at the upper edge in which the probe is looked for; 8 to 32 change E by up to 0.05 of its
#: deviation.
_TOP_ROWS = 16
#: A probe is darker than this share of the ground beside it; nothing changes from 0.5 to 0.85.
_DARK = 0.7
#: Least width of a probe, and largest as a share of the image's: what else enters from above is a
#: scratch or no probe. Nothing changes from 2 to 8 and from 0.05 to 0.2.
_NARROWEST, _WIDEST = 4.0, 0.1
#: A wall of a glass tube has at least this width, two differ by at most this factor: what a blur of
#: 1 px leaves of a thin wall, and light from one side.
_THINNEST_WALL, _UNLIKE_WALLS = 2, 2.0
#: Blur under which the probe is looked for, so that noise does not break its outline: 0.5 to 2
#: change E by up to 0.5 of its deviation.
_PROBE_BLUR = 1.0
#: Where no probe is found so, it is looked for once more with less blur and on a fainter mark: the
#: walls of a glass tube are one px wide in a coarse image.
_FINE_BLUR, _FAINT = 0.5, 0.85
#: The probe is what is darker than this, from its own grey at 0 to that of the ground at 1; below
#: one half, which the embryo's fluid does not reach. 0.25 to 0.55 change E by up to 0.1 of its
#: deviation.
_BODY_LEVEL = 0.4
#: Share by which a row's width must differ from those above it to end the probe; nothing changes
#: from 0.2 to 0.6.
_ODD_WIDTH = 0.35
#: Rows wanted below the probe's end, where its grey turns to the embryo's.
_BELOW_TIP = 5
#: Direction and width of the probe, and the ground beside it, are read from this part of its
#: length, from this row on: near its end the embryo stands beside it. The share may be 0.5 to 0.85
#: and the row 0 to 6 for changes of E up to 0.35 of its deviation.
_UPPER_PART, _FIRST_ROW = 0.7, 2
#: What is left free beside a blurred edge to be sure of it; 0 to 5 change E by up to 0.2 of its
#: deviation.
_MARGIN = 2
#: A crossing of the probe's outline is sought so far beside it, in steps of `_STEP`, half-way to
#: the mean of the last samples. Widths of 4 to 10 and 3 to 12 samples change E by up to 0.5 of its
#: deviation.
_GROUND_WIDTH, _GROUND_SAMPLES = 6.0, 6
_STEP = 0.25
#: Standard deviations beyond which a line leaves a point out; 2 to 5 change E by up to 0.15 of its
#: deviation.
_OUTLIER = 3.0
#: Rows in which the edges of a probe are seen, at least: more than a line's two numbers, fewer than
#: the 20 of the shortest probe.
_FEWEST_EDGES = 8
#: Median absolute deviation to standard deviation, of the normal distribution.
MAD_TO_STD = 1.4826
#: More than rounding of grey levels, less than any of their steps.
_ROUNDING = 1e-6
#: The probe's end is sought so far to either side, in the mean of these columns, half-way to the
#: mean of the last samples, 3 px of embryo. It is only checked against the fit, with room for 2 px
#: (`microlib.embryo._dimple`), so that nothing changes from 5 to 14, 3 to 15 and 6 to 20.
_TIP_REACH, _TIP_COLUMNS, _EMBRYO_SAMPLES = 8.0, 7, 12
#: Standard deviation given to the probe's end, which the fit of a dimple leaves out.
_TIP_STD = 0.5
#: The model has its load along the axis. The outline is found up to four times this tilt
#: (measured); beyond it the image is turned, up to the largest lean.
_LARGEST_TILT, _LARGEST_LEAN = np.deg2rad(4.0), np.deg2rad(62.0)
#: A leaning bar is looked for in so many rows at the edge and followed from row to row, in which it
#: moves by up to 1.9 px, for at least as many rows as a probe must have.
_LEAN_ROWS, _LEAN_REACH, _SHORTEST_LEAN = 3, 3, 16
#: Half-width in px below which a run may be one wall of a tube.
_THIN_RUN = 8.0
#: Share of an image at the top of its scale. A rendered embryo keeps its modulus with 15 % of the
#: pixels saturated, 22 % cost 0.6 % and 53 % cost 2.4 % of it (measured); but saturated ground is a
#: fault of the exposure that only the operator can mend.
_SATURATED_SHARE = 0.005
#: What the probe's blur reaches is left out: so many px, and so many standard deviations of the
#: blur once it is known. At 3 the normal distribution leaves 0.1 %. Less biases the flank, more
#: takes its steepest part away: 2 to 4.5 change E by up to 0.9 of its deviation.
_CLEARANCE, _BLUR_REACH = 3.0, 3.0
#: Blur of Canny's edge, which only starts the fits of the wall; 1 to 2 change E by up to 0.7 of its
#: deviation, in the noisiest image.
_EDGE_BLUR = 1.4
#: Percentiles that stand for dark and bright; nothing changes from 0.2 to 5.
_DARK_AND_BRIGHT = (1, 99)
#: Least gradient of an edge: in medians of it over the image, which is ground and so noise, and as
#: a share of the range of grey, for an image without noise. Nothing changes from 2.5 to 6 and from
#: 0.08 to 0.3.
_ABOVE_NOISE, _ABOVE_LIGHT = 4.0, 0.15
#: Canny takes gradients of 16 bits and adds two: the largest, and below a quarter of what they
#: hold.
_CANNY_RANGE = 8000.0
#: Canny's upper threshold in its lower ones; nothing changes from 1.3 to 3.
_HYSTERESIS = 2.0
#: Edges of fewer px are dust; nothing changes from 10 to 80.
_SHORTEST_EDGE = 40
#: Rows a column that an outline may rise or fall; it ends where it breaks, near the probe. 3 to 12
#: change E by up to 0.1 of its deviation.
_STEEPEST = 6
#: Columns of outline wanted on each side of the probe; nothing changes from 10 to 40.
_SHORTEST_SIDE = 20
#: Depth that a dimple must have, and points of the outline beyond its rim. At 3 px the modulus is
#: uncertain by 20 %, at 6 by 5 % (measured); the estimate says so itself.
_LEAST_DEPTH, _LEAST_ENDS = 3.0, 3
#: Share of a dimple's depth by which the outline has fallen beside the probe, at least: (4.2) and
#: capsules have fallen by half of it 3 px beside the thinnest needle. What only holds an embryo
#: stands on an outline that has not fallen at all.
_LEAST_FALL = 0.3
#: The outline is followed in whole rows, so that a fall is seen up to one row too small; but a fall
#: of two rows is one.
_SURE_ROWS = 2
#: Samples along the normal, from outside to inside: a wall's blur of 1 px to either side of where
#: Canny may err, and ground and fluid beyond. 4 to 7 to either side change E by up to one
#: deviation.
_PROFILE = np.arange(-5.0, 5.01, 0.5)
#: Blur in px from which the outline is found in the image at half its size: the profiles above hold
#: three of its deviations to either side.
_BROAD_BLUR = 1.7
#: Points over which the direction of the outline is averaged; 7 to 17 change E by up to 0.63 of its
#: deviation.
_SMOOTHING = 11
#: Points less certain than so many times the usual are left out; 4 to 10 change E by up to 0.13
#: of its deviation.
_LARGEST_STD = 6.0


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


@dataclass(frozen=True)
class Boundary(Tidy):
    """The outline of an embryo on the probe's side, the middle of its chorion, from left to right.

    All but `points` is as seen with the probe coming from above, in the part that was looked at.

    Attributes
    ----------
    x, y : ndarray, shape (n,)
        Outline, in px, x ascending and y *up* from the last row of the image.
    std : ndarray, shape (n,)
        Standard deviation of each point across the outline, in px.
    under_probe : ndarray of bool, shape (n,)
        Points at the probe's end, where the probe hides the chorion.
    probe : Probe
        The probe, y down.
    blur : float
        Standard deviation of the image's blur at the outline, in px.
    image_height : int
        Rows of the part as it is turned: y = image_height − 1 − row.
    direction : str
        Edge of the image that the probe comes from.
    region : tuple of int
        The part that was looked at: x and y of its first pixel, width and height, in px.
    tilt : float
        Angle by which the part was turned clockwise to bring the probe upright, in radians; 0 where
        it is within 4°.
    frame : tuple of int
        What of the turned part was looked at, in px; all zero without a turn.
    """

    _samples = ("x", "y", "std", "under_probe")

    x: Array
    y: Array
    std: Array
    under_probe: NDArray[np.bool_]
    probe: Probe
    blur: float
    image_height: int
    direction: str
    region: tuple[int, int, int, int]
    tilt: float = 0.0
    frame: tuple[int, int, int, int] = (0, 0, 0, 0)

    @property
    def points(self) -> Array:
        """The outline as points (x, y) of the whole image, y down, in px; shape (n, 2)."""
        view = View(self.region, self.direction, self.tilt, self.frame)
        return view.to_image(np.stack([self.x, self.image_height - 1 - self.y], axis=1))

    def without_probe(self, image: ArrayLike) -> NDArray[np.float32]:
        """Return `image`, in which the outline was found, with the probe filled by the ground."""
        grey = as_image("image", image, smallest=_SMALLEST)
        view = View(self.region, self.direction, self.tilt, self.frame)
        return view.put_back(_remove_probe(view.of(grey), self.probe), grey)


def extract_boundary(
    image: ArrayLike,
    *,
    direction: str = "auto",
    region: tuple[int, int, int, int] | None = None,
    dimple: bool = True,
) -> Boundary:
    """Find the outline of an embryo on the side where a probe presses it.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey image, integer or float; bright ground, dark probe.
    direction : {"auto", "top", "bottom", "left", "right"}
        Edge of the image (or the region) that the probe comes from; ``"auto"`` takes the first of
        the four, in this order, from which one comes that makes a dimple.
    region : tuple of int, optional
        Part of the image to look at, (x, y, width, height) in px; all of it by default.
    dimple : bool, optional
        Whether the probe must make a dimple. If not, it may as well be on its way to the embryo,
        and the outline has no points under it.

    Returns
    -------
    Boundary
        The outline as a function y(x) with the probe above, about one point a px of its length:
        `x`, `y` and `std`, and as points of the image, `points`; with the `probe`, the image
        `without_probe`, and the `direction` and `region`.

    Raises
    ------
    ValueError
        If the image is saturated, no probe comes from the edge or it leans by more than 60°, or
        there is no outline or, if there must be one, no dimple on both sides of the probe.

    See Also
    --------
    microlib.embryo.fit_dimple : From the outline to the dimple.

    Notes
    -----
    Canny edges give the outline to a pixel. Along the normals of that curve the grey profile of a
    blurred wall is fitted twice (`locate_wall`), which gives the *middle* of the chorion; samples
    that the probe's blur reaches are left out. Below the probe the outline is the end of the probe.
    An image in which the probe leans by more than 4° is turned first, so that it comes from above.

    Examples
    --------
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> scene = embryo_image(Embryo.pressed(150.0, modulus=1.0), rng=np.random.default_rng(3))
    >>> outline = extract_boundary(scene.image)
    >>> x, y = outline.points[~outline.under_probe].T
    >>> rim = scene.to_pixels([[scene.embryo.dimple_radius, 0.0]])[0]
    >>> bool(abs(np.interp(rim[0], x, y) - rim[1]) < 0.2)
    True
    """
    whole = as_image("image", image, smallest=_SMALLEST)
    one_of("direction", direction, ("auto", *DIRECTIONS))
    wanted = flag("dimple", dimple)
    part = part_of(whole.shape, region, _SMALLEST)
    upright = View(part, "top")
    _refuse_saturated(upright.of(np.asarray(image)), upright.of(whole))
    refused: dict[str, list[str]] = {}
    for edge in DIRECTIONS if direction == "auto" else (direction,):
        view = View(part, edge)
        try:
            return _outline_from_above(whole, view, wanted)
        except ValueError as reason:
            refused.setdefault(str(reason), []).append(edge)
    raise ValueError(
        "; ".join(f"{reason} (from the {', '.join(edges)})" for reason, edges in refused.items())
    )


def _outline_from_above(whole: NDArray[np.float32], view: View, dimple: bool) -> Boundary:
    """Find the outline on both sides of a probe that comes from above."""
    try:
        grey, probe, view = _upright_probe(whole, view, _PROBE_BLUR, _DARK)
    except ValueError as reason:
        try:
            grey, probe, view = _upright_probe(whole, view, _FINE_BLUR, _FAINT)
        except ValueError:
            raise reason from None
    sides, blur = _find_sides(grey, probe, dimple)
    if blur > _BROAD_BLUR:
        # Half of the size holds all of such an image, and what is sought beside an edge is in px.
        rows, columns = (2 * (side // 2) for side in grey.shape)
        half = cv2.resize(
            grey[:rows, :columns], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA
        )
        x, y = probe.tip
        smaller = replace(
            probe, tip=((x - 0.5) / 2, (y - 0.5) / 2), half_width=probe.half_width / 2
        )
        sides, blur = _find_sides(np.asarray(half, dtype=np.float32), smaller, dimple)
        sides = [2 * side + [[0.5], [0.5], [0.0]] for side in sides]
        blur *= 2

    reach = int(probe.half_width)
    hidden = probe.tip[0] + np.arange(-reach, reach + 1.0 if dimple else -reach)
    tip = np.stack([hidden, np.full(hidden.size, probe.tip[1]), np.full(hidden.size, _TIP_STD)])
    x, y, std = np.concatenate([*sides, tip], axis=1)
    under = np.arange(x.size) >= x.size - hidden.size
    order = np.argsort(x, kind="stable")
    return Boundary(
        x=x[order],
        y=len(grey) - 1 - y[order],
        std=std[order],
        under_probe=under[order],
        probe=probe,
        blur=blur,
        image_height=len(grey),
        direction=view.direction,
        region=view.region,
        tilt=view.tilt,
        frame=view.frame,
    )


def _find_sides(grey: NDArray[np.float32], probe: Probe, dimple: bool) -> tuple[list[Array], float]:
    """Return x, y and std of the outline on each side of a probe, and the blur, in px."""
    sides = [_resample(side) for side in _trace(_remove_probe(grey, probe), probe)]
    if dimple:
        _refuse_without_dimple(sides, probe)
    sides, blur = _refine(grey, sides, probe, _CLEARANCE)
    return _refine(grey, sides, probe, max(_CLEARANCE, _BLUR_REACH * blur))


def _upright_probe(
    whole: NDArray[np.float32], view: View, blur: float, dark: float
) -> tuple[NDArray[np.float32], Probe, View]:
    """Return the turned part of an image, the probe in it, and the view in which it is upright."""
    grey = np.ascontiguousarray(view.of(whole))
    refused = None
    try:
        probe = _find_probe(grey, blur, dark)
        if abs(probe.slope) <= np.tan(_LARGEST_TILT):
            return grey, probe, view
    except ValueError as reason:
        refused = reason
    lean = _leaning_bar(grey, blur, dark)
    if lean is None:
        raise refused or ValueError("image must show the probe's direction, got none")
    slope, entries = lean
    reasons = []
    for entry in entries:
        upright = view.upright(slope, entry)
        if min(upright.frame[2:]) < _SMALLEST:
            reasons.append(
                refused or ValueError("image must show the probe's end, got its shaft alone")
            )
            continue
        grey = np.ascontiguousarray(upright.of(whole))
        try:
            return grey, _straight_probe(grey, blur, dark), upright
        except ValueError as reason:
            reasons.append(reason)
    raise reasons[0]


def _straight_probe(grey: NDArray[np.float32], blur: float, dark: float) -> Probe:
    """Find the probe in an image that was turned to have it upright."""
    probe = _find_probe(grey, blur, dark)
    if abs(probe.slope) > np.tan(_LARGEST_TILT):
        raise ValueError(
            f"image must show a straight probe, got one that bends by "
            f"{np.rad2deg(np.arctan(probe.slope)):.1f}°"
        )
    return probe


def _leaning_bar(
    grey: NDArray[np.float32], blur: float, dark_share: float
) -> tuple[float, list[Array]] | None:
    """Return slope and entries of the longest bar that enters at the upper edge, or None.

    Dark runs of the first rows are followed downwards from row to row for as long as they keep
    their width. The entry is where the bar has come in with all of its width, which through a
    corner of the image is below the upper edge; of a thin one first as if it were a tube's wall.
    """
    smooth = _blurred(grey, blur)
    top = smooth[:_LEAN_ROWS].mean(axis=0)
    widest = int(_WIDEST * grey.shape[1] / np.cos(_LARGEST_LEAN))
    # Reflected, for a bar in the corner would be continued as dark ground.
    ground = median_filter(top, 4 * widest + 1, mode="reflect")
    dark = top < dark_share * ground
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dark.view(np.int8), [0]])))
    found: tuple[float, float, float] | None = None
    longest = _SHORTEST_LEAN
    for left, right in edges.reshape(-1, 2):
        limit = float((top[left:right].min() + ground[left:right].mean()) / 2)
        row, left, right = _off_the_side(smooth, int(left), int(right), limit)
        if not _THINNEST_WALL <= right - left <= widest:
            continue
        middles = _follow(smooth[row:], left, right, limit)
        if len(middles) <= longest:
            continue
        rows = np.arange(row, row + len(middles))
        slope, start = _robust_line(rows, np.array(middles))
        if abs(slope) < np.tan(_LARGEST_LEAN):
            longest, found = len(middles), (slope, start, (right - left) / 2)
    if found is None:
        return None
    slope, start, half = found
    ends = start + np.array([-half, half])
    # What comes in through a side of the image does so below its upper edge.
    inside = np.clip(ends, 0.0, grey.shape[1] - 1.0)
    below = np.maximum((inside - ends) / slope, 0.0) if slope else np.zeros(2)
    bar = np.stack([inside, below], axis=1)
    if half >= _THIN_RUN:
        return slope, [bar]
    # A tube's other wall may stand on either side of the one that was followed. What that costs of
    # a short bar's length may be too much.
    tube = np.stack([ends + np.array([-widest, widest]), np.zeros(2)], axis=1)
    return slope, [np.concatenate([tube, bar]), bar]


def _off_the_side(
    smooth: NDArray[np.float32], left: int, right: int, limit: float
) -> tuple[int, int, int]:
    """Return the row in which a dark run stands off the image's sides, and its ends there.

    A side cuts a bar that comes in through a corner, so that its width grows on the first rows.
    """
    row, columns = 0, smooth.shape[1]
    while (left == 0 or right == columns) and row + 1 < len(smooth):
        first, last = max(left - _LEAN_REACH, 0), min(right + _LEAN_REACH, columns)
        dark = np.flatnonzero(smooth[row + 1, first:last] < limit)
        if dark.size == 0:
            break
        row, left, right = row + 1, first + int(dark[0]), first + int(dark[-1]) + 1
    return row, left, right


def _follow(smooth: NDArray[np.float32], left: int, right: int, limit: float) -> list[float]:
    """Return the middle of a dark run in each row down to where its width changes."""
    middles: list[float] = []
    usual = right - left
    for row in smooth:
        first, last = max(left - _LEAN_REACH, 0), min(right + _LEAN_REACH, row.size)
        dark = np.flatnonzero(row[first:last] < limit)
        if dark.size == 0:
            break
        left, right = first + int(dark[0]), first + int(dark[-1]) + 1
        if abs(right - left - usual) > _ODD_WIDTH * usual + _MARGIN:
            break
        middles.append((left + right - 1) / 2)
    return middles


def _find_probe(image: ArrayLike, blur: float = _PROBE_BLUR, dark: float = _DARK) -> Probe:
    """Find the dark bar or the glass tube that enters an image through its upper edge.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey image, bright ground, dark probe.
    blur : float
        Standard deviation of the blur under which it is looked for, in px.
    dark : float
        Share of the ground's grey below which it is dark.

    Returns
    -------
    Probe
        Its end, direction and width, to a fraction of a pixel.

    Raises
    ------
    ValueError
        If there is not exactly one such bar.

    Notes
    -----
    A tube of glass is bright between two dark walls, and is filled before it is measured. The probe
    ends where its width jumps; a taper is no jump.

    Examples
    --------
    >>> image = np.full((120, 160), 200.0)
    >>> image[:70, 74:87] = 40.0
    >>> probe = _find_probe(image)
    >>> [round(float(v), 1) + 0.0 for v in (*probe.tip, probe.slope, probe.half_width)]
    [80.0, 69.5, 0.0, 6.5]
    """
    grey = _blurred(as_image("image", image, smallest=_SMALLEST), blur)
    grey, body, bar = _probe_body(grey, dark)
    width = body.sum(axis=1)
    end = _end_row(width)
    if end < 2 * _TOP_ROWS or end >= len(width) - _BELOW_TIP:
        raise ValueError(
            f"image must show the probe's end inside it, got a bar that ends at row {end} of "
            f"{len(width)}"
        )
    # Near the end the embryo stands beside the probe: the upper part gives direction and width.
    rows = np.arange(_FIRST_ROW, int(_UPPER_PART * end))
    middle = np.array([np.flatnonzero(body[r]).mean() for r in rows])
    usual = np.median(width[:_TOP_ROWS])
    across = np.where(np.abs(width - usual) > _MARGIN, width, usual)[rows]
    sides = np.array(
        [_crossings(grey[r], m, w, bar) for r, m, w in zip(rows, middle, across, strict=True)]
    )
    slopes, starts = zip(*(_robust_line(rows, side) for side in sides.T), strict=True)
    slope = float(np.mean(slopes))
    narrowing = slopes[1] - slopes[0]
    tapered = abs(narrowing) * rows.size > _MARGIN
    half_width = float(starts[1] - starts[0] + narrowing * (end if tapered else rows.mean())) / 2
    upper = Probe((float(np.mean(starts)), 0.0), slope, half_width)
    tip = _tip_row(grey, upper, end, bar)
    return Probe(
        (float(upper.axis(tip)), tip),
        slope,
        half_width / np.hypot(1.0, slope),
        narrowing / 2 if tapered else 0.0,
    )


def _probe_body(
    grey: NDArray[np.float32], dark_share: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_], float]:
    """Return the image with a tube filled, what is probe in it or hangs on it, and its grey."""
    top = grey[:_TOP_ROWS].mean(axis=0)
    widest = int(_WIDEST * grey.shape[1])
    ground = median_filter(top, 4 * widest + 1, mode="nearest")  # a bar is a quarter of it
    dark = top < dark_share * ground
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dark.view(np.int8), [0]])))
    runs = edges.reshape(-1, 2)
    bars = [run for run in runs if _NARROWEST <= run[1] - run[0] <= widest]
    tubes = _tubes(runs, widest)
    glass = len(tubes) == 1 and all(tubes[0][0] <= b[0] and b[1] <= tubes[0][1] for b in bars)
    if not glass and len(bars) != 1:
        raise ValueError(
            "image must show one dark probe that enters through its upper edge, "
            f"got {len(bars)} bars of {_NARROWEST:.0f} to {widest} px there"
        )
    left, right = tubes[0][:2] if glass else bars[0]
    level = ground[left:right].mean()
    bar = top[left:right].min() if glass else top[(left + right) // 2]
    limit = bar + _BODY_LEVEL * (level - bar)
    if glass:
        body = _tube_body(grey, tubes[0], limit)
        grey = np.where(body, np.minimum(grey, bar), grey)
    else:
        _, labels = cv2.connectedComponents((grey < limit).astype(np.uint8))
        body = labels == labels[0, (left + right) // 2]
    return grey, body, float(bar)


def _tubes(runs: NDArray, widest: int) -> list[tuple[int, int, int]]:
    """Return pairs of dark runs that are a tube's walls: its two ends, and the walls' width."""
    found = []
    for first, second in pairwise(runs):
        across = int(second[1] - first[0])
        walls = sorted((int(first[1] - first[0]), int(second[1] - second[0])))
        alike = walls[0] >= _THINNEST_WALL and walls[1] <= _UNLIKE_WALLS * walls[0]
        if alike and walls[1] <= across / 3 and across <= widest:
            found.append((int(first[0]), int(second[1]), walls[1]))
    return found


def _tube_body(
    grey: NDArray[np.float32], tube: tuple[int, int, int], limit: float
) -> NDArray[np.bool_]:
    """Return what lies between a tube's walls, from the upper edge as far as both go on."""
    body = np.zeros(grey.shape, dtype=bool)
    left, right, wall = tube
    for row in range(len(grey)):
        start = max(left - _MARGIN, 0)
        near_left = np.flatnonzero(grey[row, start : left + wall + _MARGIN] < limit)
        inner = max(right - wall - _MARGIN, 0)
        near_right = np.flatnonzero(grey[row, inner : right + _MARGIN] < limit)
        if near_left.size == 0 or near_right.size == 0:
            break
        left, right = start + int(near_left[0]), inner + int(near_right[-1]) + 1
        body[row, left:right] = True
    return body


def _end_row(width: NDArray) -> int:
    """Return the row in which a bar of these widths ends: they jump, as no taper does, or are 0."""
    before = np.concatenate([width[:_TOP_ROWS], width[:-1]])
    windows = sliding_window_view(before, _TOP_ROWS)[: len(width)]
    half = _TOP_ROWS // 2
    upper, lower = np.median(windows[:, :half], axis=1), np.median(windows[:, half:], axis=1)
    # A taper goes on as between the middles of the last rows' halves.
    usual = lower + (lower - upper) * (half + 1) / (2 * half)
    usual[:_TOP_ROWS] = np.median(windows[:_TOP_ROWS], axis=1)
    odd = np.abs(width - usual) > _ODD_WIDTH * usual + 1
    odd |= width == 0
    return int(odd.argmax()) if odd.any() else len(width)


def _remove_probe(image: ArrayLike, probe: Probe) -> NDArray[np.float32]:
    """Fill the probe with the grey of the ground beside it.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey image.
    probe : Probe
        What `_find_probe` found in it.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        The image without the probe.

    Raises
    ------
    ValueError
        If `image` is no grey image.

    Notes
    -----
    The ground on either side is measured above the embryo and continued downwards, as a straight
    line in the row, to the probe's end.

    Examples
    --------
    >>> image = np.full((120, 160), 200.0)
    >>> image[:70, 74:87] = 40.0
    >>> float(_remove_probe(image, _find_probe(image)).min())
    200.0
    """
    filled = as_image("image", image, smallest=_SMALLEST).copy()
    rows = np.arange(int(np.ceil(probe.tip[1] + 1)))
    axis = probe.axis(rows)
    reach = probe.half_width_at(rows) + _CLEARANCE
    measured = rows[: int(_UPPER_PART * rows.size)]
    levels = []
    for side in (-1, 1):
        beside = np.rint(axis[measured] + side * (reach[measured] + _MARGIN)).astype(int)
        beside = np.clip(beside, 0, filled.shape[1] - 1)
        slope, start = _robust_line(measured, filled[measured, beside])
        levels.append(start + slope * rows)
    columns = np.arange(filled.shape[1])
    reach = reach[:, np.newaxis]
    across = (columns - axis[:, np.newaxis] + reach) / (2 * reach)
    ground = levels[0][:, np.newaxis] * (1 - across) + levels[1][:, np.newaxis] * across
    inside = (across >= 0) & (across <= 1)
    filled[: rows.size][inside] = ground[inside]
    return filled


def _blurred(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=np.float32)


def _refuse_saturated(image: NDArray, grey: NDArray[np.float32]) -> None:
    """Refuse an image in which the ground has reached the top of its scale."""
    if image.dtype.kind in "ui":
        top = float(np.iinfo(image.dtype).max)
    else:
        # Resampling may overshoot 8 bits; levels of more bits end at an unknown top, which they
        # reach.
        peak = float(grey.max())
        top = 1.0 if peak <= 1.0 else 255.0 if peak < 2 * 255.0 else peak
    share = float(np.mean(grey >= top))
    if share > _SATURATED_SHARE:
        raise ValueError(
            f"image must not be saturated, got {share:.1%} of its pixels at {top:g} or above"
        )


def _crossings(
    row: NDArray[np.float32], middle: float, width: float, bar: float
) -> tuple[float, float]:
    """Where a row passes half-way between the bar and the ground, left and right of `middle`."""
    found = []
    for side in (-1, 1):
        distance = np.arange(0.0, width / 2 + _GROUND_WIDTH, _STEP)
        profile = np.interp(middle + side * distance, np.arange(row.size), row)
        half = (bar + profile[-_GROUND_SAMPLES:].mean()) / 2
        k = int((profile > half).argmax())
        part = (half - profile[k - 1]) / (profile[k] - profile[k - 1]) if k > 0 else 0.0
        found.append(middle + side * (distance[k - 1] + _STEP * part) if k > 0 else np.nan)
    return found[0], found[1]


def _robust_line(x: NDArray, y: NDArray) -> tuple[float, float]:
    """Slope and value at 0 of a straight line, outliers beyond three deviations left out once."""
    use = np.isfinite(y)
    if use.sum() < _FEWEST_EDGES:
        raise ValueError(
            f"image must show the probe's edges against a brighter ground, got {use.sum()} of "
            f"{use.size} rows in which it does"
        )
    for _ in range(2):
        slope, start = np.polyfit(x[use], y[use], 1)
        off = np.abs(y - start - slope * x)
        use = off <= _OUTLIER * MAD_TO_STD * np.median(off[use]) + _ROUNDING
    return float(slope), float(start)


def _tip_row(grey: NDArray[np.float32], upper: Probe, end: int, bar: float) -> float:
    """Image height where the probe's middle turns from its own grey to that of the embryo."""
    y = np.arange(end - _TIP_REACH, min(end + _TIP_REACH + 1, len(grey) - 1.0), _STEP)
    across = np.linspace(-0.5, 0.5, _TIP_COLUMNS) * upper.half_width
    x = upper.axis(y)[:, np.newaxis] + across
    where = np.stack([np.broadcast_to(y[:, np.newaxis], x.shape), x])
    profile = map_coordinates(grey, where, order=1, mode="nearest").mean(axis=1)
    half = (bar + profile[-_EMBRYO_SAMPLES:].mean()) / 2
    k = int((profile > half).argmax())
    if k == 0:
        raise ValueError("image must show the probe's end against something brighter, got none")
    return float(y[k - 1] + _STEP * (half - profile[k - 1]) / (profile[k] - profile[k - 1]))


def _trace(filled: NDArray[np.float32], probe: Probe) -> list[Array]:
    """Follow the uppermost Canny edge from the probe outwards; (2, n) image points of each side."""
    smooth = _blurred(filled, _EDGE_BLUR)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    # The threshold stands above the noise, whose gradient the flat ground shows, and above what
    # uneven light does to a picture without noise.
    dark, bright = np.percentile(filled, _DARK_AND_BRIGHT)
    least = max(
        _ABOVE_NOISE * float(np.median(np.abs(dx) + np.abs(dy))),
        _ABOVE_LIGHT * float(bright - dark),
    )
    scale = _CANNY_RANGE / max(float(np.abs(dx).max()), float(np.abs(dy).max()), _ROUNDING)
    edges = cv2.Canny(
        np.rint(dx * scale).astype(np.int16),
        np.rint(dy * scale).astype(np.int16),
        least * scale,
        _HYSTERESIS * least * scale,
    )
    _, labels, stats, _ = cv2.connectedComponentsWithStats(edges, connectivity=8)
    long = stats[:, cv2.CC_STAT_AREA] >= _SHORTEST_EDGE
    long[0] = False
    edge = long[labels]
    first = np.where(edge.any(axis=0), edge.argmax(axis=0), -1)
    sides: list[Array] = []
    for step, name in ((-1, "left"), (1, "right")):
        start = round(probe.tip[0] + step * (probe.half_width + _CLEARANCE + 1))
        stop = -1 if step < 0 else len(first)
        columns = np.arange(start, stop, step)
        rows = first[columns] if columns.size and 0 <= start < len(first) else np.empty(0, int)
        broken = np.flatnonzero((rows[1:] < 0) | (np.abs(np.diff(rows)) > _STEEPEST))
        length = int(broken[0]) + 1 if broken.size else rows.size
        if length < _SHORTEST_SIDE or rows[0] < 0:
            raise ValueError(
                f"image must show an embryo's outline on both sides of the probe, got {length} "
                f"columns of it on the {name}"
            )
        sides.append(np.stack([columns[:length], rows[:length]]).astype(np.float64)[:, ::step])
    return sides


def _resample(curve: Array) -> Array:
    """Points at equal distances of about one px along a curve."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve[:2])))])
    even = np.linspace(0.0, length[-1], max(int(length[-1]) + 1, _SMOOTHING))
    return np.stack([np.interp(even, length, row) for row in curve[:2]])


def _refine(
    grey: NDArray[np.float32], sides: list[Array], probe: Probe, clearance: float
) -> tuple[list[Array], float]:
    """Move the curves onto the middle of the wall: x, y, std of each side, and the blur."""
    smooth = [savgol_filter(side[:2], _SMOOTHING, 2, axis=1) for side in sides]
    tangent = [savgol_filter(side[:2], _SMOOTHING, 2, deriv=1, axis=1) for side in sides]
    start, along = np.concatenate(smooth, axis=1), np.concatenate(tangent, axis=1)
    # Both sides run from left to right: turned clockwise on the screen, the tangent points inside.
    normal = np.stack([-along[1], along[0]]) / np.hypot(*along)
    x, y = start[:, :, np.newaxis] + normal[:, :, np.newaxis] * _PROFILE
    profiles = map_coordinates(spline_filter(grey, 3), [y, x], order=3, prefilter=False)
    beside = np.abs(x - probe.axis(y)) > probe.half_width_at(y) + clearance
    clear = beside | (y > probe.tip[1] + clearance + _MARGIN)
    wall = locate_wall(profiles, _PROFILE, weights=clear)
    points = start + normal * wall.position
    usual = np.nanmedian(wall.std)
    good = np.isfinite(wall.position) & (wall.std < _LARGEST_STD * usual)
    split = smooth[0].shape[1]
    found = [
        np.concatenate([points, wall.std[np.newaxis]])[:, part][:, good[part]]
        for part in (slice(0, split), slice(split, None))
    ]
    for name, side in zip(("left", "right"), found, strict=True):
        if side.shape[1] < _SHORTEST_SIDE:
            raise ValueError(
                f"image must show a wall along the outline, got {side.shape[1]} points of it on "
                f"the {name} of the probe"
            )
    return found, wall.width


def _refuse_without_dimple(sides: list[Array], probe: Probe) -> None:
    """Refuse an outline whose highest points are not beside the probe and above its end."""
    for name, (x, y) in zip(("left", "right"), sides, strict=True):
        rim = int(y.argmin())
        depth = probe.tip[1] - y[rim]
        apart = abs(x[rim] - probe.tip[0]) - probe.half_width - _CLEARANCE
        ends = min(rim, y.size - 1 - rim)
        if depth < _LEAST_DEPTH or apart < _LEAST_DEPTH or ends < _LEAST_ENDS:
            raise ValueError(
                f"image must show a dimple at least {_LEAST_DEPTH:.0f} px deep around the probe's "
                f"end, got {depth:.1f} px on the {name}"
            )
        fall = (y[-1] if name == "left" else y[0]) - y[rim]
        if fall < _LEAST_FALL * depth - (fall >= _SURE_ROWS):
            raise ValueError(
                "image must show an outline that falls to the probe's end, got a fall of "
                f"{fall:.1f} px of {depth:.1f} px beside it on the {name}"
            )
