"""How sharp is an image around each pixel? Focus measures, larger where the image is sharper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Image, as_array, as_image, one_of, scalar, whole
from microlib.focus._filters import (
    MOST_REACH,
    box_rows,
    edge_rows,
    gaussian_taps,
    laplacian_rows,
    own_room,
    product_rows,
    smooth_rows,
    taps,
)
from microlib.focus._loops import sum_rows

#: What `depth_from_focus` accepts in place of a name: grey image to focus measure of the same
#: shape.
FocusMeasure = Callable[[Image], NDArray]

#: The border is mirrored about its outermost pixel, as OpenCV does by default.
_MIRROR = cv2.BORDER_REFLECT_101
#: Smoothing from which on boxes take the place of a Gaussian, px: a matter of time, not of the
#: result.
_BOXES_FROM = 4.0
#: Side of a window, px: no image is larger.
_WIDEST = (1 << 16) - 1
#: Radius of the mean that a pixel is compared with to tell the side of a step, and the two windows
#: over which its deviation is averaged, px; the first is half a pixel, so that the pixel itself
#: counts. Table "constant changed" of benchmarks/focus.py.
_EDGE_MEAN, _EDGE_FINE, _EDGE_COARSE = 4.0, 0.5, 2.0
#: Share of a frame that is taken for its quietest, %.
_QUIET = 5
#: Least noise over the largest grey level, where float32 has seven digits, and the least of all,
#: which keeps a black frame's product and its logarithm finite.
_LEAST_NOISE_SHARE, _LEAST_NOISE = 1e-6, 1e-30


def sum_modified_laplacian(
    image: ArrayLike, *, window: int = 5, step: int = 1, threshold: float = 0.0
) -> NDArray:
    """Return the sum-modified-Laplacian of an image (3.10)–(3.12).

    Parameters
    ----------
    image : array_like, shape (rows, cols)
        Grey image of 8 or 16 bits; any other is taken as float32.
    window : int
        Side 2W + 1 of the square over which is summed, px, odd.
    step : int
        Distance of the pixels that are compared, px.
    threshold : float
        T; only modified Laplacians greater than it are summed, grey levels.

    Returns
    -------
    ndarray of uint16 or float32, shape (rows, cols)
        F of (3.12). Exact integers of 16 bits for an 8-bit image and a window of up to 7 px,
        where they cannot overflow; float32 otherwise.

    Raises
    ------
    ValueError
        If the image is not grey or not finite, `window` is not odd, `step` not a positive whole
        number or as large as the image, or `threshold` negative.

    Notes
    -----
    :math:`ML(u,v) = |2I(u,v) - I(u-s,v) - I(u+s,v)| + |2I(u,v) - I(u,v-s) - I(u,v+s)|` (3.11),
    summed where it exceeds T (3.12). The thesis says nothing of the border, which is mirrored
    here.

    References
    ----------
    S. K. Nayar and Y. Nakagawa, Shape from focus, IEEE Trans. PAMI 16 (1994) 824.

    Examples
    --------
    >>> spot = np.zeros((5, 5), np.uint8); spot[2, 2] = 10
    >>> sum_modified_laplacian(spot, window=3)[2]
    array([20, 70, 80, 70, 20], dtype=uint16)
    """
    grey = _grey(image)
    return SumModifiedLaplacian(window, step, threshold)(grey, slice(0, len(grey)))


@dataclass(frozen=True)
class SumModifiedLaplacian:
    """`sum_modified_laplacian` of some rows of an image."""

    window: int
    step: int
    threshold: float

    def __post_init__(self) -> None:
        whole("window", self.window, least=1, odd=True, most=_WIDEST)
        whole("step", self.step, least=1)
        object.__setattr__(self, "threshold", scalar("threshold", self.threshold, least=0))

    @property
    def reach(self) -> int:
        return self.step + self.window // 2

    def __call__(self, image: Image, rows: slice) -> NDArray:
        if self.step >= min(image.shape):
            raise ValueError(f"step must be below the image's sides {image.shape}, got {self.step}")
        # Each of the 7 * 7 modified Laplacians is at most 4 * 255: their sum is below 2¹⁶.
        exact = image.dtype == np.uint8 and self.window <= 7
        shape = (rows.stop - rows.start, image.shape[1])
        result = np.empty(shape, np.uint16 if exact else np.float32)
        # No sum of whole numbers lies between the threshold and the whole number below it.
        threshold = min(np.floor(self.threshold), 2.0**16 - 1) if exact else self.threshold
        sum_rows(image, rows.start, self.window, self.step, float(threshold), result)
        return result


def _tenengrad(image: ArrayLike, *, window: int = 5) -> NDArray[np.float32]:
    """Return the squared Sobel gradient summed over a square of `window` px (Krotkov, 1988).

    Examples
    --------
    >>> ramp = np.tile(np.arange(6, dtype=np.uint8), (6, 1))
    >>> float(_tenengrad(ramp, window=3)[3, 3])  # nine times the square of 8
    576.0
    """
    n = whole("window", window, least=1, odd=True, most=_WIDEST)
    grey = _grey(image)
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    return _box_sum(gx * gx + gy * gy, n)


def _grey_variance(image: ArrayLike, *, window: int = 5) -> NDArray[np.float32]:
    """Return the variance of the grey levels in a square of `window` px.

    Examples
    --------
    >>> ramp = np.tile(np.arange(6, dtype=np.uint8), (6, 1))
    >>> round(float(_grey_variance(ramp, window=3)[3, 3]), 4)
    0.6667
    """
    n = whole("window", window, least=1, odd=True, most=_WIDEST)
    grey = _grey(image)
    # The difference of two large numbers: float64 keeps 16-bit images exact.
    mean = cv2.boxFilter(grey, cv2.CV_64F, (n, n))
    square = cv2.sqrBoxFilter(grey, cv2.CV_64F, (n, n))
    return np.maximum(square - mean * mean, 0).astype(np.float32)


def _grey(image: ArrayLike) -> Image:
    """Return an image of 8 or 16 bits as it is, any other as float32, checked."""
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        return as_image("image", image)
    return as_array("image", image, shape=(None, None), dtype=image.dtype)


def _box_sum(image: NDArray, n: int) -> NDArray:
    return cv2.boxFilter(image, cv2.CV_32F, (n, n), normalize=False, borderType=_MIRROR)


def blur(image: NDArray, sigma: float) -> NDArray[np.float32]:
    """Smooth by a Gaussian; a wide one by two boxes of the same variance, which is faster.

    A pixel's mean depends on the pixels around it alone, to the last bit, and not on where the
    image begins or ends: OpenCV's running sums do.
    """
    if sigma < _BOXES_FROM:
        return _filtered(image, gaussian_taps(sigma))
    side = blur_side(sigma)
    return box(box(image, side), side)


def _filtered(image: NDArray, filter_: NDArray[np.float32]) -> NDArray[np.float32]:
    out = np.empty(image.shape, np.float32)
    smooth_rows(np.ascontiguousarray(image, np.float32), filter_, own_room(), out)
    return out


def box(image: NDArray, side: int) -> NDArray[np.float32]:
    """Return the mean over a square; as of `blur`, a pixel's depends on those around it alone."""
    source = np.ascontiguousarray(image, np.float32)
    out = np.empty(source.shape, np.float32)
    if side // 2 <= MOST_REACH:
        box_rows(source, side, own_room(), out)
        return out
    # Seldom so wide: the same sums without a tile's memory.
    for axis in range(2):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (side // 2, side // 2)
        source = np.moveaxis(np.pad(source, pad, mode="reflect"), axis, 0)
        source = np.moveaxis(_sums(source, side), 0, axis)
    return source * np.float32(1 / side**2)


def _sums(image: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Add up `side` rows from each on, by sums of two, four, eight and so on."""
    count = len(image) - side + 1
    total, done, width, power = image[:count].copy(), 1, 1, image
    while 2 * width <= side:
        power = power[: len(power) - width] + power[width:]
        width *= 2
        if side & width:
            total += power[done : done + count]
            done += width
    return total


def blur_side(sigma: float) -> int:
    """Return the side of the box of which two have the variance of a wide Gaussian, px, odd."""
    # A box of n has the variance (n² - 1) / 12.
    return 2 * round((np.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1


def _two_boxes(n: int) -> NDArray[np.float64]:
    return np.convolve(np.ones(n), np.ones(n)) / n**2


def blur_taps(sigma: float) -> NDArray[np.float32]:
    """Return the taps of `blur`, for the compiled filters."""
    return gaussian_taps(sigma) if sigma < _BOXES_FROM else taps(_two_boxes(blur_side(sigma)))


class RowsMeasure(Protocol):
    """A focus measure of some rows of an image, for which it looks `reach` rows further."""

    @property
    def reach(self) -> int: ...

    def __call__(self, image: Image, rows: slice) -> NDArray: ...


@dataclass(frozen=True)
class Banded:
    """A measure of whole images, made one of some rows: it looks no further than `reach` pixels."""

    function: FocusMeasure
    reach: int

    def __call__(self, image: Image, rows: slice) -> NDArray:
        low = max(rows.start - self.reach, 0)
        seen = self.function(image[low : rows.stop + self.reach])
        return seen[rows.start - low : rows.stop - low]


#: Names of the focus measures.
MEASURES = ("multiscale", "sml", "tenengrad", "variance")


def named_measure(name: str, window: int, step: int, threshold: float) -> RowsMeasure:
    """Return the classical measure of that name."""
    one_of("measure", name, MEASURES)
    if name == "sml":
        return SumModifiedLaplacian(window, step, threshold)
    if (step, threshold) != (1, 0.0):
        raise ValueError(f"step and threshold are for measure 'sml' only, got measure {name!r}")
    function = {"tenengrad": _tenengrad, "variance": _grey_variance}[name]
    return Banded(partial(function, window=window), reach=1 + window // 2)


@dataclass(frozen=True)
class Scale:
    """A modified Laplacian after smoothing by `smooth` px, averaged over a Gaussian of `spread` px.

    `gain` is its mean on white noise of unit standard deviation: the noise left by the smoothing
    and the second difference, times the mean of the modulus of two normal variates.
    """

    smooth: float
    spread: float

    @property
    def gain(self) -> float:
        # 31 px are seven standard deviations to either side of the widest.
        kernel = cv2.getGaussianKernel(31, self.smooth).ravel()
        second = np.convolve(kernel, [-1.0, 2.0, -1.0])
        return float(2 * np.sqrt(2 / np.pi) * np.sqrt(np.sum(second**2) * np.sum(kernel**2)))

    @property
    def reach(self) -> int:
        # OpenCV cuts a Gaussian of float32 off at four standard deviations.
        return int(np.ceil(4 * self.smooth + 1 + 4 * self.spread))

    def __call__(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        filters = blur_taps(self.smooth), blur_taps(self.spread)
        out = np.empty(image.shape, np.float32)
        laplacian_rows(np.ascontiguousarray(image), filters, own_room(), out)
        return out


#: The scales that decide the depth, chosen on rendered stacks with slopes, weak and coarse texture,
#: noise and JPEG; benchmarks/focus.py compares.
_SCALES = (Scale(0.8, 1.0), Scale(2.0, 3.0))
#: The scale at which noise is measured: hardly smoothed, and steadied over 3 px.
_NOISE_SCALE = Scale(0.5, 3.0)


def rows_around(image: Image, rows: slice, reach: int) -> tuple[NDArray[np.float32], int]:
    """Return the rows of an image up to `reach` further, float32, and the number of the first."""
    low = max(rows.start - reach, 0)
    return np.ascontiguousarray(image[low : rows.stop + reach], np.float32), low


@dataclass(frozen=True)
class _Multiscale:
    """A product of modified Laplacians at two scales, see `multiscale_measure`."""

    filters: tuple[NDArray, NDArray, NDArray, NDArray]
    floors: tuple[np.float32, np.float32]

    @property
    def reach(self) -> int:
        smooth, spread, wide_smooth, wide_spread = map(len, self.filters)
        # The length of taps is one more than the radius; the second difference looks one further.
        return max(smooth + spread, wide_smooth + wide_spread) - 1

    def __call__(self, image: Image, rows: slice) -> NDArray[np.float32]:
        part, first = rows_around(image, rows, self.reach)
        out = np.empty((rows.stop - rows.start, image.shape[1]), np.float32)
        at = first, len(image), rows.start
        product_rows(part, *at, self.filters, self.floors, own_room(), out)
        return out


def multiscale_measure(noise: float) -> RowsMeasure:
    """Return a product of modified Laplacians at two scales, for frames with that much noise.

    The fine scale places the peak on a slope, the coarse one keeps it where texture is weak. Each
    is raised by what it makes of noise alone: where it sees nothing else, it is nearly flat, and
    the other decides.
    """
    fine, coarse = _SCALES
    smooth, spread = blur_taps(fine.smooth), blur_taps(fine.spread)
    wide_smooth, wide_spread = blur_taps(coarse.smooth), blur_taps(coarse.spread)
    floors = np.float32(noise * fine.gain), np.float32(noise * coarse.gain)
    return _Multiscale((smooth, spread, wide_smooth, wide_spread), floors)


def noise_response(noise: float) -> float:
    """Return what `multiscale_measure` is, on average, where there is noise and nothing else.

    There each factor is the noise and as much again, its floor.
    """
    return float(np.prod([2 * noise * scale.gain for scale in _SCALES]))


@dataclass(frozen=True)
class _Edge:
    """A product of two means of a deviation, see `edge_measure`."""

    filters: tuple[NDArray, NDArray, NDArray]
    floors: tuple[np.float32, np.float32]

    @property
    def reach(self) -> int:
        wide, fine, coarse = map(len, self.filters)
        return wide + max(fine, coarse) - 2

    def __call__(self, image: Image, rows: slice) -> NDArray[np.float32]:
        part, first = rows_around(image, rows, self.reach)
        out = np.empty((rows.stop - rows.start, image.shape[1]), np.float32)
        at = first, len(image), rows.start
        edge_rows(part, *at, self.filters, self.floors, own_room(), out)
        return out


def edge_measure(noise: float) -> RowsMeasure:
    """Return a measure that tells on which side of a step in depth a pixel lies.

    It is the deviation of the pixel from the mean around it. A second difference takes half of its
    weight from the neighbors, and next to a step they may be those of the other side; here the
    pixel itself counts, and its neighbors only through a window of half a pixel. A second, wider
    window steadies the product.
    """
    filters = blur_taps(_EDGE_MEAN), blur_taps(_EDGE_FINE), blur_taps(_EDGE_COARSE)
    # The mean of the modulus of a normal variate.
    floor = np.float32(noise * np.sqrt(2 / np.pi))
    return _Edge(filters, (floor, floor))


def noise_level(samples: list[tuple[NDArray[np.float32], float, np.dtype]]) -> float:
    """Estimate the noise of a frame from its quietest twentieth, grey levels.

    From what `noise_sample` makes of its parts.
    """
    measure = np.concatenate([values.ravel() for values, _, _ in samples])
    quiet = float(np.percentile(measure, _QUIET)) / _NOISE_SCALE.gain
    rounding = np.sqrt(1 / 12) if samples[0][2].kind == "u" else 0.0
    largest = max(most for _, most, _ in samples)
    return max(quiet, rounding, _LEAST_NOISE_SHARE * largest, _LEAST_NOISE)


def noise_sample(frame: Image) -> tuple[NDArray[np.float32], float, np.dtype]:
    """Return a fine measure of a part of a frame, its largest grey level, and its type."""
    measure = _NOISE_SCALE(frame.astype(np.float32))
    return measure, float(np.abs(frame).max()), frame.dtype
