"""How sharp is an image around each pixel? Focus measures, larger where the image is sharper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_array, as_image, one_of, positive, whole
from microlib.focus._loops import sum_rows

__all__ = ["FocusMeasure", "grey_variance", "sum_modified_laplacian", "tenengrad"]

#: What `depth_from_focus` accepts in place of a name: grey image to focus measure of the same
#: shape.
FocusMeasure = Callable[[NDArray], NDArray]

#: The border is mirrored about its outermost pixel, as OpenCV does by default.
_BORDER = cv2.BORDER_REFLECT_101


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
        whole("window", self.window, least=1, odd=True)
        whole("step", self.step, least=1)
        positive("threshold", self.threshold, zero=True)

    @property
    def reach(self) -> int:
        return self.step + self.window // 2

    def __call__(self, image: NDArray, rows: slice) -> NDArray:
        if self.step >= min(image.shape):
            raise ValueError(f"step must be below the image's sides {image.shape}, got {self.step}")
        # 4 * 255 * 7 * 7 < 2¹⁶
        exact = image.dtype == np.uint8 and self.window <= 7
        shape = (rows.stop - rows.start, image.shape[1])
        result = np.empty(shape, np.uint16 if exact else np.float32)
        # No sum of whole numbers lies between the threshold and the whole number below it.
        threshold = min(np.floor(self.threshold), 65535.0) if exact else self.threshold
        sum_rows(image, rows.start, self.window, self.step, float(threshold), result)
        return result


def tenengrad(image: ArrayLike, *, window: int = 5) -> NDArray[np.float32]:
    """Return the squared Sobel gradient summed over a square.

    Parameters
    ----------
    image : array_like, shape (rows, cols)
        Grey image of 8 or 16 bits; any other is taken as float32.
    window : int
        Side of the square, px, odd.

    Returns
    -------
    ndarray of float32, shape (rows, cols)

    Raises
    ------
    ValueError
        If the image is not grey or not finite, or `window` is not an odd positive number.

    References
    ----------
    E. Krotkov, Focusing, International Journal of Computer Vision 1 (1988) 223.

    Examples
    --------
    >>> ramp = np.tile(np.arange(6, dtype=np.uint8), (6, 1))
    >>> float(tenengrad(ramp, window=3)[3, 3])  # nine times the square of 8
    576.0
    """
    n = whole("window", window, least=1, odd=True)
    grey = _grey(image)
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    return _box_sum(gx * gx + gy * gy, n)


def grey_variance(image: ArrayLike, *, window: int = 5) -> NDArray[np.float32]:
    """Return the variance of the grey levels in a square.

    Parameters
    ----------
    image : array_like, shape (rows, cols)
        Grey image of 8 or 16 bits; any other is taken as float32.
    window : int
        Side of the square, px, odd.

    Returns
    -------
    ndarray of float32, shape (rows, cols)

    Raises
    ------
    ValueError
        If the image is not grey or not finite, or `window` is not an odd positive number.

    Examples
    --------
    >>> ramp = np.tile(np.arange(6, dtype=np.uint8), (6, 1))
    >>> round(float(grey_variance(ramp, window=3)[3, 3]), 4)
    0.6667
    """
    n = whole("window", window, least=1, odd=True)
    grey = _grey(image)
    # The difference of two large numbers: float64 keeps 16-bit images exact.
    mean = cv2.boxFilter(grey, cv2.CV_64F, (n, n))
    square = cv2.sqrBoxFilter(grey, cv2.CV_64F, (n, n))
    return np.maximum(square - mean * mean, 0).astype(np.float32)


def _grey(image: ArrayLike) -> NDArray:
    """Return an image of 8 or 16 bits as it is, any other as float32, checked."""
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        return as_image("image", image)
    return as_array("image", image, shape=(None, None), dtype=image.dtype)


def _box_sum(image: NDArray, n: int) -> NDArray:
    return cv2.boxFilter(image, cv2.CV_32F, (n, n), normalize=False, borderType=_BORDER)


def blur(image: NDArray, sigma: float) -> NDArray:
    """Smooth by a Gaussian; a wide one by two boxes of the same variance, which is faster."""
    if sigma < 4:
        return cv2.GaussianBlur(image, (0, 0), sigma, borderType=_BORDER)
    n = 2 * round((np.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1
    if n < 10:  # two such boxes are a triangle, in one go
        triangle = np.convolve(np.ones(n), np.ones(n)) / n**2
        return cv2.sepFilter2D(image, -1, triangle, triangle, borderType=_BORDER)
    once = cv2.boxFilter(image, -1, (n, n), borderType=_BORDER)
    return cv2.boxFilter(once, -1, (n, n), borderType=_BORDER)


class RowsMeasure(Protocol):
    """A focus measure of some rows of an image, for which it looks `reach` rows further."""

    @property
    def reach(self) -> int: ...

    def __call__(self, image: NDArray, rows: slice) -> NDArray: ...


@dataclass(frozen=True)
class Banded:
    """A measure of whole images, made one of some rows: it looks no further than `reach` pixels."""

    function: FocusMeasure
    reach: int

    def __call__(self, image: NDArray, rows: slice) -> NDArray:
        low = max(rows.start - self.reach, 0)
        seen = self.function(image[low : rows.stop + self.reach])
        return seen[rows.start - low : rows.stop - low]


def named_measure(name: str, window: int, step: int, threshold: float) -> RowsMeasure:
    """Return the classical measure of that name."""
    one_of("measure", name, ("multiscale", "sml", "tenengrad", "variance"))
    if name == "sml":
        return SumModifiedLaplacian(window, step, threshold)
    if (step, threshold) != (1, 0.0):
        raise ValueError(f"step and threshold are for measure 'sml' only, got measure {name!r}")
    function = {"tenengrad": tenengrad, "variance": grey_variance}[name]
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
        kernel = cv2.getGaussianKernel(31, self.smooth).ravel()
        second = np.convolve(kernel, [-1.0, 2.0, -1.0])
        return float(2 * np.sqrt(2 / np.pi) * np.sqrt(np.sum(second**2) * np.sum(kernel**2)))

    @property
    def reach(self) -> int:
        return int(np.ceil(4 * self.smooth + 1 + 4 * self.spread))

    def __call__(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        return blur(_modified_laplacian(blur(image, self.smooth)), self.spread)


#: The scales that decide the depth, chosen on rendered stacks with slopes, weak and coarse texture,
#: noise and JPEG; benchmarks/focus.py compares.
_SCALES = (Scale(0.8, 1.0), Scale(2.0, 3.0))


def multiscale_measure(noise: float) -> Banded:
    """Return a product of modified Laplacians at two scales, for frames with that much noise.

    The fine scale places the peak on a slope, the coarse one keeps it where texture is weak. Each
    is raised by what it makes of noise alone: where it sees nothing else, it is nearly flat, and
    the other decides.
    """
    fine, coarse = _SCALES
    floors = [np.float32(noise * scale.gain) for scale in _SCALES]

    def measure(image: NDArray) -> NDArray:
        grey = image.astype(np.float32)
        return (fine(grey) + floors[0]) * (coarse(grey) + floors[1])

    return Banded(measure, reach=max(scale.reach for scale in _SCALES))


def blank_level(noise: float) -> float:
    """Return what `multiscale_measure` is, on average, where there is noise and nothing else."""
    return float(np.prod([2 * noise * scale.gain for scale in _SCALES]))


def edge_measure(noise: float) -> Banded:
    """Return a measure that tells on which side of a step in depth a pixel lies.

    It is the deviation of the pixel from a mean over 4 px. A second difference takes half of its
    weight from the neighbours, and next to a step they may be those of the other side; here the
    pixel itself counts, and its neighbours only through a window of half a pixel. A second window
    of 2 px steadies the product.
    """
    floor = np.float32(noise * np.sqrt(2 / np.pi))

    def measure(image: NDArray) -> NDArray:
        grey = image.astype(np.float32)
        deviation = np.abs(grey - blur(grey, 4.0))
        return (blur(deviation, 0.5) + floor) * (blur(deviation, 2.0) + floor)

    return Banded(measure, reach=24)


def noise_level(frame: NDArray) -> float:
    """Estimate the noise of a frame from its quietest twentieth, grey levels."""
    scale = Scale(0.5, 3.0)
    quiet = float(np.percentile(scale(frame.astype(np.float32)), 5)) / scale.gain
    rounding = np.sqrt(1 / 12) if frame.dtype.kind == "u" else 0.0
    # A floor keeps the product and its logarithm positive; float32 holds seven digits.
    return max(quiet, rounding, 1e-6 * float(np.abs(frame).max()), 1e-30)


def _modified_laplacian(image: NDArray[np.float32]) -> NDArray[np.float32]:
    second = np.array([[-1.0, 2.0, -1.0]], np.float32)
    return np.abs(cv2.filter2D(image, -1, second)) + np.abs(cv2.filter2D(image, -1, second.T))
