"""Upper outline of an embryo in an image: find the probe, remove it, and follow the edge.

The steps are those of section 5.6 of the thesis (crop, mark and remove the probe, Canny, contour),
without marking by hand. The image shows a dark probe on a bright ground, which enters through one
edge of the image. The image is rotated so that this edge is the upper one. Image points are (x, y)
in px with y *down*. The outline has y *up*, as in `fit_gaussians` and the figures of the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from microlib._common import Array, FlatResult, as_choice, as_image, luminance
from microlib.embryo._probe import CLEARANCE, MARGIN, MIN_IMAGE, Probe, find_probe, remove_probe
from microlib.embryo._rotation import DIRECTIONS, Rotation
from microlib.embryo._wall import locate_wall

#: Least number of columns of the outline on each side of the probe; 10 to 40 change nothing.
MIN_SIDE = 20
#: Standard deviation of the Gaussian filter before Canny, px.
_EDGE_BLUR = 1.4
#: Points over which a Savitzky–Golay filter averages the direction of the outline.
_SMOOTHING = 11


@dataclass(frozen=True, eq=False, repr=False)
class Boundary(FlatResult):
    """Outline of an embryo on the side of the probe, along the middle of its chorion.

    All fields refer to the image rotated so that the probe comes from above. `points` are points of
    the image itself.

    Attributes
    ----------
    x, y : ndarray, shape (n,)
        Outline from left to right, in px, y *up* from the last row of the image.
    uncertainty : ndarray, shape (n,)
        Standard deviation of the error of each point across the outline, in px.
    under_probe : ndarray of bool, shape (n,)
        Points at the end of the probe, where the probe hides the chorion.
    probe : Probe
        Position and width of the probe, y down.
    blur : float
        Standard deviation of the image's blur at the outline, in px.
    image_height : int
        Rows of the rotated image: y = image_height − 1 − row.
    rotation : Rotation
        Rotation of the image, with the edge that the probe comes from as `direction`.
    """

    _large = ("x", "y", "uncertainty", "under_probe")

    x: Array
    y: Array
    uncertainty: Array
    under_probe: NDArray[np.bool_]
    probe: Probe
    blur: float
    image_height: int
    rotation: Rotation

    @property
    def points(self) -> Array:
        """Points (x, y) of the outline in the image, y down, in px; shape (n, 2)."""
        return self.rotation.to_image(np.stack([self.x, self.image_height - 1 - self.y], axis=1))

    def without_probe(self, image: ArrayLike) -> NDArray[np.float32]:
        """Return the rotated image with the probe replaced by the ground beside it."""
        grey = as_image("image", luminance("image", image), smallest=MIN_IMAGE)
        return remove_probe(self.rotation.apply(grey), self.probe)


def extract_boundary(image: ArrayLike, *, direction: str = "auto") -> Boundary:
    """Find the outline of an embryo on the side where a probe presses it.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey or color image, integer or float; bright ground, and a dark probe within 4° of the
        vertical or the horizontal.
    direction : {"auto", "top", "bottom", "left", "right"}
        Edge of the image that the probe comes from. ``"auto"`` is the first of the four, in this
        order, for which an outline is found.

    Returns
    -------
    Boundary
        The outline `x`, `y` with its `uncertainty`, about one point per px of its length, and the
        same outline as `points` of the image; the `probe` and the `rotation`.

    Raises
    ------
    ValueError
        If the image is saturated, no probe comes from the edge, the probe leans by more than 4°, or
        the image shows no outline or no dimple on both sides of the probe.

    See Also
    --------
    microlib.embryo.fit_dimple : From the outline to the dimple.

    Notes
    -----
    1. The probe is found.
    2. The probe is replaced by the ground beside it, and Canny edges give the outline to a pixel.
    3. A blurred wall is fitted to the grey profile along each normal, twice. Its position is the
       *middle* of the chorion, or that of the middle grey level if there is no dark wall. Samples
       within the blur of the probe are not used.
    4. Under the probe, the outline is the end of the probe.

    The uncertainty covers the noise of the profiles. A wall that is darker outside than
    inside shifts all points alike, by about 0.02 px, and a wall that is hardly visible beside the
    step of grey level by up to half the blur. An image blurred by more than about 2.7 px
    must be reduced first, for example to half of its size, with twice the `pixel_size`.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.embryo import extract_boundary
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo.pressed(150.0, modulus=1.0)
    >>> scene = embryo_image(embryo, rng=3, shape=(480, 640))
    >>> outline = extract_boundary(scene.image)
    >>> x, y = outline.points[~outline.under_probe].T
    >>> rim = scene.to_pixels([[scene.embryo.rim_radius, 0.0]])[0]
    >>> bool(abs(np.interp(rim[0], x, y) - rim[1]) < 0.2)
    True
    """
    whole = as_image("image", luminance("image", image), smallest=MIN_IMAGE)
    as_choice("direction", direction, ("auto", *DIRECTIONS))
    _check_exposure(np.asarray(image), whole)
    reasons: dict[str, list[str]] = {}
    for edge in DIRECTIONS if direction == "auto" else (direction,):
        try:
            return _extract_from_above(whole, Rotation(whole.shape[::-1], edge))
        except ValueError as reason:
            reasons.setdefault(str(reason), []).append(edge)
    raise ValueError(
        "; ".join(f"{reason} (from the {', '.join(edges)})" for reason, edges in reasons.items())
    )


def _extract_from_above(whole: NDArray[np.float32], rotation: Rotation) -> Boundary:
    """Find the outline on both sides of a probe that comes from above."""
    grey = np.ascontiguousarray(rotation.apply(whole))
    probe = find_probe(grey)
    edges, blur = _trace_outline(remove_probe(grey, probe), probe)
    sides = [_resample(side, _spacing(blur)) for side in edges]
    _check_dimple(sides, probe)
    spline = spline_filter(grey, 3)
    for _ in range(2):
        sides, blur = _refine_on_wall(spline, sides, probe, blur)

    reach = int(probe.half_width)
    hidden = probe.tip[0] + np.arange(-reach, reach + 1.0)
    # The uncertainty of points under the probe is a nominal half pixel: they are not fitted.
    tip = np.stack([hidden, np.full(hidden.size, probe.tip[1]), np.full(hidden.size, 0.5)])
    x, y, uncertainty = np.concatenate([*sides, tip], axis=1)
    under = np.arange(x.size) >= x.size - hidden.size
    order = np.argsort(x, kind="stable")
    return Boundary(
        x=x[order],
        y=len(grey) - 1 - y[order],
        uncertainty=uncertainty[order],
        under_probe=under[order],
        probe=probe,
        blur=blur,
        image_height=len(grey),
        rotation=rotation,
    )


def _check_exposure(image: NDArray, grey: NDArray[np.float32]) -> None:
    """Raise for an image whose ground is saturated."""
    # Resampling may overshoot 8 bits. Images of more bits have an unknown white level, which
    # saturated images reach.
    peak = float(grey.max())
    byte = float(np.iinfo(np.uint8).max)
    white = 1.0 if peak <= 1.0 else byte if peak < 2 * byte else peak
    if image.dtype == np.uint8:
        white = byte
    fraction = float(np.mean(grey >= white))
    # 15 % of saturated pixels cost the modulus of a rendered embryo nothing and 53 % cost 2.4 %.
    # Saturated ground is nevertheless a fault of the exposure, which the user can correct.
    if fraction > 0.005:
        raise ValueError(
            f"image must not be saturated, got {fraction:.1%} of its pixels at {white:g} or above"
        )


def _trace_outline(filled: NDArray[np.float32], probe: Probe) -> tuple[list[Array], float]:
    """Follow the uppermost edge from the probe outwards.

    Return (2, n) image points of each side, and the blur that is assumed of the image.
    """
    # The broader filter finds the edges of a blurred image.
    for scale, blur in ((1, 0.0), (2, 2 * _EDGE_BLUR)):
        edge = _canny(filled, scale)
        first = np.where(edge.any(axis=0), edge.argmax(axis=0), -1)
        sides: list[Array] = []
        for step in (-1, 1):
            apart = probe.half_width + CLEARANCE * scale**2 + 1
            start = round(probe.tip[0] + step * apart)
            columns = np.arange(first.size)[::step]
            columns = columns[step * (columns - start) >= 0]
            rows = first[columns]
            broken = (rows < 0) | (np.abs(np.diff(rows, prepend=rows[:1])) > 6 * scale)
            length = int(np.append(broken, True).argmax())
            sides.append(np.stack([columns[:length], rows[:length]]).astype(np.float64)[:, ::step])
        lengths = [side.shape[1] for side in sides]
        if min(lengths) >= MIN_SIDE:
            return sides, blur
    raise ValueError(
        "image must show an embryo's outline on both sides of the probe, got "
        f"{lengths[0]} columns of it on the left and {lengths[1]} on the right"
    )


def _canny(filled: NDArray[np.float32], scale: int) -> NDArray[np.bool_]:
    """Return Canny edges of at least 2 × `MIN_SIDE` px."""
    smooth = cv2.GaussianBlur(filled, (0, 0), scale * _EDGE_BLUR)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    # The threshold is above the noise, whose median gradient is that of the flat ground, and above
    # the gradient of uneven light in an image without noise. The gradient of an edge falls with the
    # width of the filter.
    dark, bright = np.percentile(filled, (1, 99))
    noise = float(np.median(np.abs(dx) + np.abs(dy)))
    least = max(4 * noise, float(bright - dark) / (4 * scale))
    # Canny takes gradients of 16 bits and adds two: the largest is a quarter of the range.
    largest = float(max(np.abs(dx).max(), np.abs(dy).max())) or 1.0
    gain = np.iinfo(np.int16).max / 4 / largest
    dx, dy = (np.rint(slope * gain).astype(np.int16) for slope in (dx, dy))
    edges = cv2.Canny(dx, dy, least * gain, 2 * least * gain)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(edges)
    return (labels > 0) & (stats[:, cv2.CC_STAT_AREA] >= 2 * MIN_SIDE)[labels]


def _spacing(blur: float) -> int:
    """Return the distance of the points of an outline, px, for an image with this blur."""
    return 2 if 3 * blur > 5 else 1


def _resample(curve: Array, spacing: int) -> Array:
    """Return points at equal distances of about `spacing` px along a curve."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve[:2])))])
    even = np.linspace(0.0, length[-1], max(int(length[-1] / spacing) + 1, _SMOOTHING))
    return np.stack([np.interp(even, length, row) for row in curve[:2]])


def _refine_on_wall(
    spline: NDArray, sides: list[Array], probe: Probe, blur: float
) -> tuple[list[Array], float]:
    """Move the curves to the middle of the wall: return x, y, uncertainty of each, and the blur.

    `spline` contains the coefficients of the image, and `blur` is its blur as known before.
    """
    from scipy.signal import savgol_filter  # here, because it takes long to import

    # Profiles run from outside to inside, with two samples per px: the blurred wall, the error of
    # Canny's edge, and ground and fluid beyond. For a broad blur they have twice the length.
    scale = _spacing(blur)
    offsets = scale * np.linspace(-5, 5, 21)
    smooth = [savgol_filter(side[:2], _SMOOTHING, 2, axis=1) for side in sides]
    tangent = [savgol_filter(side[:2], _SMOOTHING, 2, deriv=1, axis=1) for side in sides]
    start, along = np.concatenate(smooth, axis=1), np.concatenate(tangent, axis=1)
    # Both sides run from left to right: rotated clockwise on the screen, the tangent points inside.
    normal = np.stack([-along[1], along[0]]) / np.hypot(*along)
    x, y = start[:, :, np.newaxis] + normal[:, :, np.newaxis] * offsets
    profiles = map_coordinates(spline, [y, x], order=3, mode="nearest", prefilter=False)
    # Samples within three standard deviations of the probe's blur are not used: two bias the flank,
    # and more remove its steepest part.
    clearance = max(CLEARANCE, 3 * blur)
    beside = np.abs(x - probe.axis(y)) > probe.half_width_at(y) + clearance
    clear = beside | (y > probe.tip[1] + clearance + MARGIN)
    wall = locate_wall(profiles, offsets / scale, weights=clear, pixel=1 / scale)
    if _spacing(scale * wall.blur) > scale:
        coarse = [_resample(side, 2) for side in sides]
        return _refine_on_wall(spline, coarse, probe, wall.blur)
    points = start + normal * scale * wall.position
    good = wall.uncertainty < 6 * np.nanmedian(wall.uncertainty)  # False for NaN
    on_left = np.arange(good.size) < smooth[0].shape[1]
    measured = np.vstack([points, scale * wall.uncertainty])
    refined = [measured[:, good & on_left], measured[:, good & ~on_left]]
    for name, side in zip(("left", "right"), refined, strict=True):
        if side.shape[1] < MIN_SIDE:
            raise ValueError(
                f"image must show a wall along the outline, got {side.shape[1]} points of it on "
                f"the {name} of the probe"
            )
    return refined, scale * wall.blur


def _check_dimple(sides: list[Array], probe: Probe) -> None:
    """Raise for an outline without a dimple around the end of the probe."""
    for name, (x, y) in zip(("left", "right"), sides, strict=True):
        rim = int(y.argmin())
        depth = probe.tip[1] - y[rim]
        apart = abs(x[rim] - probe.tip[0]) - probe.half_width - CLEARANCE
        to_end = min(rim, y.size - 1 - rim)
        fall = (y[-1] if name == "left" else y[0]) - y[rim]
        # A depth of 3 px leaves the modulus uncertain by 20 %, one of 6 px by 5 % (measured). At
        # 3 px from the thinnest needle, (4.2) and capsules have fallen by half of their depth. An
        # outline with an object on top has not fallen. The fall is known to one row, and a fall of
        # two rows is one.
        if min(depth, apart, to_end) < 3 or fall < depth / 3 - (fall >= 2):
            raise ValueError(
                "image must show a dimple at least 3 px deep around the probe's end, to which the "
                f"outline falls, got {depth:.1f} px and a fall of {fall:.1f} px on the {name}"
            )
