"""From an image to the upper outline of an embryo: find the probe, take it out, follow the edge.

The chain of the thesis' section 5.6 (crop, mark and remove the probe, Canny, contour), with nobody
marking anything. The image shows the probe coming from one of its edges onto the embryo, dark on a
bright ground, and is turned so that this edge is the upper one. Image points are (x, y) in px with
y *down*; the outline is given with y *up*, as `fit_gaussians` and the thesis' figures have it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from microlib._common import Array, Tidy, as_image, flag, one_of
from microlib.embryo._probe import CLEARANCE, MARGIN, SMALLEST, Probe, find_probe, remove_probe
from microlib.embryo._view import DIRECTIONS, View
from microlib.embryo._wall import locate_wall

# Lengths are in px. What other values of these do to the modulus stands in the benchmark "Other
# values of the constants" (benchmarks/embryo.py): none moves it by its own standard deviation.
# Where a comment says "nothing changes", that is the range measured there.

#: Share of an image at the top of its scale. A rendered embryo keeps its modulus with 15 % of the
#: pixels saturated, 22 % cost 0.6 % and 53 % cost 2.4 % of it (measured); but saturated ground is a
#: fault of the exposure that only the operator can mend.
_SATURATED_SHARE = 0.005
#: What the probe's blur reaches is left out: `CLEARANCE` px, and so many standard deviations of the
#: blur once it is known. At 3 the normal distribution leaves 0.1 %. Less biases the flank, more
#: takes its steepest part away: 2 to 4.5 change E by up to 0.9 of its deviation.
_BLUR_REACH = 3.0
#: Standard deviation given to the probe's end, which the fit of a dimple leaves out.
_TIP_STD = 0.5
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
#: Keeps an image without any edge from a division by zero.
_ROUNDING = 1e-6
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
#: Blur in px from which points and samples are 2 px and 1 px apart, so that the profiles hold three
#: of its deviations to either side.
_BROAD_BLUR = 1.7
#: Points over which the direction of the outline is averaged; 7 to 17 change E by up to 0.63 of its
#: deviation.
_SMOOTHING = 11
#: Points less certain than so many times the usual are left out; 4 to 10 change E by up to 0.13
#: of its deviation.
_LARGEST_STD = 6.0


@dataclass(frozen=True, eq=False, repr=False)
class Boundary(Tidy):
    """The outline of an embryo on the probe's side, the middle of its chorion, from left to right.

    All but `points` is as seen with the probe coming from above.

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
        Rows of the image as it is turned: y = image_height − 1 − row.
    view : View
        The edge that the probe comes from, `direction`, and how the image was turned to bring the
        probe upright.
    """

    _samples = ("x", "y", "std", "under_probe")

    x: Array
    y: Array
    std: Array
    under_probe: NDArray[np.bool_]
    probe: Probe
    blur: float
    image_height: int
    view: View

    @property
    def points(self) -> Array:
        """The outline as points (x, y) of the whole image, y down, in px; shape (n, 2)."""
        return self.view.to_image(np.stack([self.x, self.image_height - 1 - self.y], axis=1))

    def without_probe(self, image: ArrayLike) -> NDArray[np.float32]:
        """Return `image`, in which the outline was found, with the probe filled by the ground."""
        grey = as_image("image", image, smallest=SMALLEST)
        return self.view.put_back(remove_probe(self.view.of(grey), self.probe), grey)


def extract_boundary(
    image: ArrayLike,
    *,
    direction: str = "auto",
    dimple: bool = True,
) -> Boundary:
    """Find the outline of an embryo on the side where a probe presses it.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey image, integer or float; bright ground, dark probe.
    direction : {"auto", "top", "bottom", "left", "right"}
        Edge of the image that the probe comes from; ``"auto"`` takes the first of the four, in this
        order, from which one comes that makes a dimple.
    dimple : bool, optional
        Whether the probe must make a dimple. If not, it may as well be on its way to the embryo,
        and the outline has no points under it.

    Returns
    -------
    Boundary
        The outline as a function y(x) with the probe above, about one point a px of its length:
        `x`, `y` and `std`, and as points of the image, `points`; with the `probe`, the image
        `without_probe`, and the `view` with the `direction` that the probe comes from.

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
    >>> import numpy as np
    >>> from microlib.embryo import extract_boundary
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> scene = embryo_image(Embryo.pressed(150.0, modulus=1.0), rng=np.random.default_rng(3))
    >>> outline = extract_boundary(scene.image)
    >>> x, y = outline.points[~outline.under_probe].T
    >>> rim = scene.to_pixels([[scene.embryo.dimple_radius, 0.0]])[0]
    >>> bool(abs(np.interp(rim[0], x, y) - rim[1]) < 0.2)
    True
    """
    whole = as_image("image", image, smallest=SMALLEST)
    one_of("direction", direction, ("auto", *DIRECTIONS))
    wanted = flag("dimple", dimple)
    _refuse_saturated(np.asarray(image), whole)
    rows, columns = whole.shape
    refused: dict[str, list[str]] = {}
    for edge in DIRECTIONS if direction == "auto" else (direction,):
        try:
            return _outline_from_above(whole, View((columns, rows), edge), wanted)
        except ValueError as reason:
            refused.setdefault(str(reason), []).append(edge)
    raise ValueError(
        "; ".join(f"{reason} (from the {', '.join(edges)})" for reason, edges in refused.items())
    )


def _outline_from_above(whole: NDArray[np.float32], view: View, dimple: bool) -> Boundary:
    """Find the outline on both sides of a probe that comes from above."""
    grey, probe, view = find_probe(whole, view)
    sides = [_resample(side) for side in _trace(remove_probe(grey, probe), probe)]
    if dimple:
        _refuse_without_dimple(sides, probe)
    sides, blur = _refine(grey, sides, probe, CLEARANCE)
    step = 2 if blur > _BROAD_BLUR else 1
    clearance = max(CLEARANCE, _BLUR_REACH * blur)
    sides, blur = _refine(grey, [side[:, ::step] for side in sides], probe, clearance, step)

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
        view=view,
    )


def _refuse_saturated(image: NDArray, grey: NDArray[np.float32]) -> None:
    """Refuse an image in which the ground has reached the top of its scale."""
    # Resampling may overshoot 8 bits; levels of more bits end at an unknown top, which they reach.
    peak = float(grey.max())
    top = 1.0 if peak <= 1.0 else 255.0 if peak < 2 * 255.0 else peak
    if image.dtype.kind in "ui":
        top = float(np.iinfo(image.dtype).max)
    share = float(np.mean(grey >= top))
    if share > _SATURATED_SHARE:
        raise ValueError(
            f"image must not be saturated, got {share:.1%} of its pixels at {top:g} or above"
        )


def _trace(filled: NDArray[np.float32], probe: Probe) -> list[Array]:
    """Follow the uppermost Canny edge from the probe outwards; (2, n) image points of each side."""
    smooth = cv2.GaussianBlur(filled, (0, 0), _EDGE_BLUR)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    # The threshold stands above the noise, whose gradient the flat ground shows, and above what
    # uneven light does to a picture without noise.
    dark, bright = np.percentile(filled, _DARK_AND_BRIGHT)
    noise = float(np.median(np.abs(dx) + np.abs(dy)))
    least = max(_ABOVE_NOISE * noise, _ABOVE_LIGHT * float(bright - dark))
    scale = _CANNY_RANGE / max(float(np.abs(dx).max()), float(np.abs(dy).max()), _ROUNDING)
    dx, dy = (np.rint(slope * scale).astype(np.int16) for slope in (dx, dy))
    edges = cv2.Canny(dx, dy, least * scale, _HYSTERESIS * least * scale)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(edges, connectivity=8)
    edge = (labels > 0) & (stats[:, cv2.CC_STAT_AREA] >= _SHORTEST_EDGE)[labels]
    first = np.where(edge.any(axis=0), edge.argmax(axis=0), -1)
    sides: list[Array] = []
    for step, name in ((-1, "left"), (1, "right")):
        start = round(probe.tip[0] + step * (probe.half_width + CLEARANCE + 1))
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
    grey: NDArray[np.float32], sides: list[Array], probe: Probe, clearance: float, scale: int = 1
) -> tuple[list[Array], float]:
    """Move the curves onto the middle of the wall: x, y, std of each side, and the blur.

    The profiles are `scale` times as long as `_PROFILE`.
    """
    from scipy.signal import savgol_filter  # here, as it takes long to import

    smooth = [savgol_filter(side[:2], _SMOOTHING, 2, axis=1) for side in sides]
    tangent = [savgol_filter(side[:2], _SMOOTHING, 2, deriv=1, axis=1) for side in sides]
    start, along = np.concatenate(smooth, axis=1), np.concatenate(tangent, axis=1)
    # Both sides run from left to right: turned clockwise on the screen, the tangent points inside.
    normal = np.stack([-along[1], along[0]]) / np.hypot(*along)
    x, y = start[:, :, np.newaxis] + normal[:, :, np.newaxis] * scale * _PROFILE
    profiles = map_coordinates(spline_filter(grey, 3), [y, x], order=3, prefilter=False)
    beside = np.abs(x - probe.axis(y)) > probe.half_width_at(y) + clearance
    clear = beside | (y > probe.tip[1] + clearance + MARGIN)
    wall = locate_wall(profiles, _PROFILE, weights=clear)
    points = start + normal * scale * wall.position
    usual = np.nanmedian(wall.std)
    good = np.isfinite(wall.position) & (wall.std < _LARGEST_STD * usual)
    on_left = np.arange(good.size) < smooth[0].shape[1]
    measured = np.vstack([points, scale * wall.std])
    found = [measured[:, good & on_left], measured[:, good & ~on_left]]
    for name, side in zip(("left", "right"), found, strict=True):
        if side.shape[1] < _SHORTEST_SIDE:
            raise ValueError(
                f"image must show a wall along the outline, got {side.shape[1]} points of it on "
                f"the {name} of the probe"
            )
    return found, scale * wall.width


def _refuse_without_dimple(sides: list[Array], probe: Probe) -> None:
    """Refuse an outline whose highest points are not beside the probe and above its end."""
    for name, (x, y) in zip(("left", "right"), sides, strict=True):
        rim = int(y.argmin())
        depth = probe.tip[1] - y[rim]
        apart = abs(x[rim] - probe.tip[0]) - probe.half_width - CLEARANCE
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
