"""From an image to the upper outline of an embryo: find the probe, take it out, follow the edge.

The chain of the thesis' section 5.6 (crop, mark and remove the probe, Canny, contour), with nobody
marking anything. The image shows the probe coming from one of its edges onto the embryo, dark on a
bright ground, and is turned so that this edge is the upper one. Image points are (x, y) in px with
y *down*; the outline is given with y *up*, as `fit_gaussians` and the thesis' figures have it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, spline_filter

from microlib._common import Array, Tidy, as_image, luminance, one_of
from microlib.embryo._probe import CLEARANCE, MARGIN, SMALLEST, Probe, find_probe, remove_probe
from microlib.embryo._view import DIRECTIONS, View
from microlib.embryo._wall import Settings, locate_wall

#: Columns of outline wanted on each side of the probe; nothing changes from 10 to 40.
SHORTEST_SIDE = 20


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

    _large = ("x", "y", "std", "under_probe")

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
        """Return `image`, turned as `view` says, with the probe filled by the ground beside it."""
        width, height = self.view.size
        grey = as_image("image", luminance("image", image), smallest=SMALLEST)[:height, :width]
        return remove_probe(self.view.of(grey), self.probe)


def extract_boundary(image: ArrayLike, *, direction: str = "auto", dimple: bool = True) -> Boundary:
    """Find the outline of an embryo on the side where a probe presses it.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey or color image, integer or float; bright ground, dark probe.
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
    A large image whose edges are too blurred for Canny is searched again, binned 2 × 2.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.embryo import extract_boundary
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo.pressed(150.0, modulus=1.0)
    >>> scene = embryo_image(embryo, rng=3, shape=(480, 640))
    >>> outline = extract_boundary(scene.image)
    >>> x, y = outline.points[~outline.under_probe].T
    >>> rim = scene.to_pixels([[scene.embryo.dimple_radius, 0.0]])[0]
    >>> bool(abs(np.interp(rim[0], x, y) - rim[1]) < 0.2)
    True
    """
    whole = as_image("image", luminance("image", image), smallest=SMALLEST)
    one_of("direction", direction, ("auto", *DIRECTIONS))
    _refuse_saturated(np.asarray(image), whole)
    refused: dict[str, list[str]] = {}
    for edge in DIRECTIONS if direction == "auto" else (direction,):
        try:
            return _outline_at_either_scale(whole, edge, dimple)
        except ValueError as reason:
            refused.setdefault(str(reason), []).append(edge)
    raise ValueError(
        "; ".join(f"{reason} (from the {', '.join(edges)})" for reason, edges in refused.items())
    )


class _NoOutline(ValueError):
    """No outline was found beside a probe."""


def _outline_at_either_scale(whole: NDArray[np.float32], edge: str, dimple: bool) -> Boundary:
    """Find the outline in an image, or in the same binned 2 × 2, whose blur is half as broad."""
    rows, columns = whole.shape
    try:
        return _outline_from_above(whole, View((columns, rows), edge), dimple)
    except _NoOutline:
        if min(rows, columns) < 4 * SMALLEST:
            raise
        even = whole[: rows // 2 * 2, : columns // 2 * 2]
        half = columns // 2, rows // 2
        binned: NDArray = np.asarray(cv2.resize(even, half, interpolation=cv2.INTER_AREA))
        found = _outline_from_above(binned, View(binned.shape[::-1], edge), dimple)
    # The middle of the first of two pixels is a quarter of their bin before that of the bin.
    probe, view = found.probe, found.view
    left, first, width, height = (2 * n for n in view.frame)
    return replace(
        found,
        x=2 * found.x + 0.5,
        y=2 * found.y + 0.5,
        std=2 * found.std,
        probe=replace(
            probe,
            tip=(2 * probe.tip[0] + 0.5, 2 * probe.tip[1] + 0.5),
            half_width=2 * probe.half_width,
        ),
        blur=2 * found.blur,
        image_height=2 * found.image_height,
        view=replace(view, size=even.shape[::-1], frame=(left, first, width, height)),
    )


def _outline_from_above(whole: NDArray[np.float32], view: View, dimple: bool) -> Boundary:
    """Find the outline on both sides of a probe that comes from above, stage by stage."""
    settings = Settings()
    grey, probe, view = find_probe(whole, view)
    sides = _trace(remove_probe(grey, probe), probe, settings)
    sides = [_resample(side, settings.smoothing) for side in sides]
    if dimple:
        _refuse_without_dimple(sides, probe)
    sides, blur = _refine(grey, sides, probe, 0.0, settings)
    sides, blur = _refine(grey, sides, probe, blur, settings)

    reach = int(probe.half_width)
    hidden = probe.tip[0] + np.arange(-reach, reach + 1.0 if dimple else -reach)
    # Half a px: what is under the probe is not fitted.
    tip = np.stack([hidden, np.full(hidden.size, probe.tip[1]), np.full(hidden.size, 0.5)])
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
    byte = float(np.iinfo(np.uint8).max)
    top = 1.0 if peak <= 1.0 else byte if peak < 2 * byte else peak
    if image.dtype == np.uint8:
        top = byte
    share = float(np.mean(grey >= top))
    # 15 % cost a rendered embryo's modulus nothing, 53 % cost 2.4 % of it (measured); but saturated
    # ground is a fault of the exposure that only the operator can mend.
    if share > 0.005:
        raise ValueError(
            f"image must not be saturated, got {share:.1%} of its pixels at {top:g} or above"
        )


def _trace(filled: NDArray[np.float32], probe: Probe, settings: Settings) -> list[Array]:
    """Follow the uppermost Canny edge from the probe outwards; (2, n) image points of each side."""
    smooth = cv2.GaussianBlur(filled, (0, 0), settings.edge_blur)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    # The threshold stands above the noise, whose gradient the flat ground shows, and above what
    # uneven light does to a picture without noise.
    dark, bright = np.percentile(filled, (1, 99))
    noise = float(np.median(np.abs(dx) + np.abs(dy)))
    least = max(4 * noise, float(bright - dark) / 4)
    # Canny takes gradients of 16 bits and adds two: the largest is a quarter of what they hold.
    largest = float(max(np.abs(dx).max(), np.abs(dy).max())) or 1.0
    scale = np.iinfo(np.int16).max / 4 / largest
    dx, dy = (np.rint(slope * scale).astype(np.int16) for slope in (dx, dy))
    edges = cv2.Canny(dx, dy, least * scale, 2 * least * scale)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(edges)
    edge = (labels > 0) & (stats[:, cv2.CC_STAT_AREA] >= 2 * SHORTEST_SIDE)[labels]
    first = np.where(edge.any(axis=0), edge.argmax(axis=0), -1)
    sides: list[Array] = []
    for step, name in ((-1, "left"), (1, "right")):
        start = round(probe.tip[0] + step * (probe.half_width + CLEARANCE + 1))
        columns = np.arange(first.size)[::step]
        columns = columns[step * (columns - start) >= 0]
        rows = first[columns]
        broken = (rows < 0) | (np.abs(np.diff(rows, prepend=rows[:1])) > 6)
        length = int(np.append(broken, True).argmax())
        if length < SHORTEST_SIDE:
            raise _NoOutline(
                f"image must show an embryo's outline on both sides of the probe, got {length} "
                f"columns of it on the {name}"
            )
        sides.append(np.stack([columns[:length], rows[:length]]).astype(np.float64)[:, ::step])
    return sides


def _resample(curve: Array, least: int) -> Array:
    """Points at equal distances of about one px along a curve."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve[:2])))])
    even = np.linspace(0.0, length[-1], max(int(length[-1]) + 1, least))
    return np.stack([np.interp(even, length, row) for row in curve[:2]])


def _refine(
    grey: NDArray[np.float32], sides: list[Array], probe: Probe, blur: float, settings: Settings
) -> tuple[list[Array], float]:
    """Move the curves onto the middle of the wall: x, y, std of each side, and the blur.

    The profiles are sampled twice a px, from outside to inside; `blur` is what is known of it.
    """
    from scipy.signal import savgol_filter  # here, as it takes long to import

    reach = settings.profile_reach
    offsets = np.linspace(-reach, reach, int(4 * reach) + 1)
    clearance = max(CLEARANCE, settings.blur_reach * blur)
    # A broad blur takes profiles of twice the length, of half as many points.
    scale = 2 if settings.blur_reach * blur > reach else 1
    sides = [side[:, ::scale] for side in sides]
    smooth = [savgol_filter(side[:2], settings.smoothing, 2, axis=1) for side in sides]
    tangent = [savgol_filter(side[:2], settings.smoothing, 2, deriv=1, axis=1) for side in sides]
    start, along = np.concatenate(smooth, axis=1), np.concatenate(tangent, axis=1)
    # Both sides run from left to right: turned clockwise on the screen, the tangent points inside.
    normal = np.stack([-along[1], along[0]]) / np.hypot(*along)
    x, y = start[:, :, np.newaxis] + normal[:, :, np.newaxis] * scale * offsets
    profiles = map_coordinates(spline_filter(grey, 3), [y, x], order=3, prefilter=False)
    beside = np.abs(x - probe.axis(y)) > probe.half_width_at(y) + clearance
    clear = beside | (y > probe.tip[1] + clearance + MARGIN)
    wall = locate_wall(profiles, offsets, weights=clear, settings=settings)
    points = start + normal * scale * wall.position
    usual = np.nanmedian(wall.std)
    good = np.isfinite(wall.position) & (wall.std < settings.largest_std * usual)
    on_left = np.arange(good.size) < smooth[0].shape[1]
    measured = np.vstack([points, scale * wall.std])
    found = [measured[:, good & on_left], measured[:, good & ~on_left]]
    for name, side in zip(("left", "right"), found, strict=True):
        if side.shape[1] < SHORTEST_SIDE:
            raise _NoOutline(
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
        fall = (y[-1] if name == "left" else y[0]) - y[rim]
        # At 3 px the modulus is uncertain by 20 %, at 6 by 5 % (measured); the estimate says so.
        # (4.2) and capsules have fallen by half of their depth 3 px beside the thinnest needle; an
        # outline on which something only stands has not fallen at all. It is followed in whole
        # rows, so that a fall is seen up to one row too small; but a fall of two rows is one.
        if min(depth, apart, ends) < 3 or fall < depth / 3 - (fall >= 2):
            raise ValueError(
                "image must show a dimple at least 3 px deep around the probe's end, to which the "
                f"outline falls, got {depth:.1f} px and a fall of {fall:.1f} px on the {name}"
            )
