"""Focus measures of one image: larger where it is sharper."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Image, as_array, as_choice, as_integer, as_scalar

#: A focus measure: grey image to measure of the same shape, zero or positive.
FocusMeasure = Callable[[Image], NDArray]


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
    n = as_integer("window", window, least=1, odd=True)
    s = as_integer("step", step, least=1)
    limit = as_scalar("threshold", threshold, least=0)
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


#: The focus measures of one frame, by the name that `depth_from_focus` gives them. Each takes an
#: image and ``window``, the side of the square over which it is summed, px. A new one is one entry:
#: error messages, tests and benchmarks read this table.
MEASURES: dict[str, Callable[..., NDArray]] = {"sml": sum_modified_laplacian}


def single_measure(measure: str | FocusMeasure, window: int | None) -> FocusMeasure | None:
    """Return the measure of one frame; None for "multiscale", which has several."""
    known = ("multiscale", *MEASURES)
    name = "a function" if callable(measure) else repr(as_choice("measure", measure, known))
    if measure in MEASURES:
        side = 5 if window is None else as_integer("window", window, least=1, odd=True)
        return partial(MEASURES[str(measure)], window=side)
    if window is not None:
        raise ValueError(f"window must not be given with measure {name}, got {window!r}")
    return partial(_user_measure, measure) if callable(measure) else None


def _user_measure(measure: FocusMeasure, image: Image) -> NDArray:
    """Return the measure of an image by a function of the user, checked."""
    value = as_array("measure(frame)", measure(image), shape=image.shape, dtype=np.float32)
    if (value < 0).any():
        raise ValueError(f"measure(frame) must be zero or positive, got {value.min():g}")
    return value
