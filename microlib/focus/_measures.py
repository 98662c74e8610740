"""How sharp is an image around each pixel? Focus measures, larger where the image is sharper."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Image, as_array, scalar, whole

#: A focus measure of the user: grey image to measure of the same shape.
FocusMeasure = Callable[[Image], NDArray]
#: Side of a window, px, and number of frames: their numbers fit into 16 bits.
MOST = 2**16 - 1
#: What is divided by is no less: the measure of a black frame is 0.
TINY = np.float32(1e-30)


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
        number or as large as the image, or `threshold` negative
        or beyond what grey levels can give.

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
    >>> import numpy as np
    >>> from microlib.focus import sum_modified_laplacian
    >>> spot = np.zeros((5, 5), np.uint8)
    >>> spot[2, 2] = 10
    >>> sum_modified_laplacian(spot, window=3)[2]
    array([20, 70, 80, 70, 20], dtype=uint16)
    """
    kind = getattr(image, "dtype", None)
    kind = kind if kind in (np.uint8, np.uint16) else np.float32
    grey = as_array("image", image, shape=(None, None), dtype=kind)
    n = whole("window", window, least=1, odd=True, most=MOST)
    s = whole("step", step, least=1)
    limit = scalar("threshold", threshold, least=0)
    if s >= min(grey.shape):
        raise ValueError(f"step must be below the image's sides {grey.shape}, got {step}")
    padded = cv2.copyMakeBorder(grey, s, s, s, s, cv2.BORDER_REFLECT_101)
    padded = padded.astype(np.int16 if grey.dtype == np.uint8 else np.float32)
    twice = 2 * padded[s:-s, s:-s]
    along = np.abs(twice - padded[s:-s, : -2 * s] - padded[s:-s, 2 * s :])
    down = np.abs(twice - padded[: -2 * s, s:-s] - padded[2 * s :, s:-s])
    laplacian = along + down
    if limit > 0:
        laplacian[laplacian <= limit] = 0
    total = np.asarray(cv2.boxFilter(laplacian, cv2.CV_32F, (n, n), normalize=False))
    # Each of the 7 * 7 modified Laplacians is at most 4 * 255: their sum is below 2¹⁶.
    return total.astype(np.uint16) if grey.dtype == np.uint8 and n <= 7 else total


def user_measure(measure: FocusMeasure, image: Image) -> NDArray:
    """Return the measure of an image by a function of the user, checked."""
    value = as_array("measure(frame)", measure(image), shape=image.shape, dtype=np.float32)
    if (value < 0).any():
        raise ValueError(f"measure(frame) must be zero or positive, got {value.min():g}")
    return value


# --- What the default measure is made of -------------------------------------------------------


def absolute_seconds(image: NDArray, sigma: float) -> tuple[NDArray, NDArray]:
    """Return |second derivative| along rows and down columns of an image smoothed by `sigma` px.

    Smoothing and difference are one separable filter; the Gaussian is cut off at 3 sigma.
    """
    smooth = cv2.getGaussianKernel(2 * round(3 * sigma) + 1, sigma, cv2.CV_32F).ravel()
    second = np.convolve(smooth, np.array([1, -2, 1], np.float32))
    along = cv2.sepFilter2D(image, cv2.CV_32F, second, smooth)
    down = cv2.sepFilter2D(image, cv2.CV_32F, smooth, second)
    return np.abs(along, out=along), np.abs(down, out=down)


def noise_gain(sigma: float) -> float:
    """Return the mean of the sum of both `absolute_seconds` on white noise of unit deviation.

    The noise left by the smoothing and the second difference, times the mean of the modulus of
    two normal variates.
    """
    smooth = cv2.getGaussianKernel(31, sigma).ravel()
    second = np.convolve(smooth, [-1.0, 2.0, -1.0])
    return float(2 * np.sqrt(2 / np.pi) * np.sqrt(np.sum(second**2) * np.sum(smooth**2)))


def blur(image: NDArray, sigma: float) -> NDArray:
    """Smooth by a Gaussian; beyond 1 px by two boxes of nearly its variance, which is faster."""
    if sigma <= 1:
        side = 2 * round(4 * sigma) - 1  # 3 to 7 px
        return np.asarray(cv2.GaussianBlur(image, (side, side), sigma))
    # A box of n px has the variance (n² − 1) / 12.
    side = 2 * round((np.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1
    return np.asarray(cv2.blur(cv2.blur(image, (side, side)), (side, side)))


# --- Between the full grid and that of every second pixel --------------------------------------


def halved(image: NDArray) -> NDArray:
    """Return the means of blocks of two by two pixels; an odd side is continued by its edge."""
    rows, cols = (n % 2 for n in image.shape)
    if rows or cols:
        image = cv2.copyMakeBorder(image, 0, rows, 0, cols, cv2.BORDER_REPLICATE)
    size = image.shape[1] // 2, image.shape[0] // 2
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def doubled(half: NDArray, shape: tuple[int, ...], how: int = cv2.INTER_LINEAR) -> NDArray:
    """Return an image of `shape` from one of half its sides."""
    mask = half.dtype == bool
    image = half.astype(np.uint8) if mask else half
    how = cv2.INTER_NEAREST if mask else how
    full = cv2.resize(image, (2 * half.shape[1], 2 * half.shape[0]), interpolation=how)
    full = np.asarray(full)[: shape[0], : shape[1]]
    return full > 0 if mask else full
