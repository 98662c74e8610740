"""Correction of spikes (3.14), and smoothing of a depth map that preserves its steps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from microlib._common import Array, as_integer, as_map, as_scalar
from microlib.focus.common import smooth_planes


def correct_spikes(depth: ArrayLike, *, window: int = 9, delta: float = 2.0) -> Array:
    """Replace spikes of a depth map by the median around them.

    Parameters
    ----------
    depth : array_like, shape (rows, cols)
        Depths, µm; NaN where unknown.
    window : int
        Side M of the square for median and standard deviation, px, odd. The thesis uses 9.
    delta : float
        How many standard deviations from the median a depth may lie. The thesis uses 2.

    Returns
    -------
    ndarray of float64, shape (rows, cols)
        Depths, µm. An unknown depth becomes the median of what is known in its window, and stays
        NaN where nothing is.

    Raises
    ------
    ValueError
        If the map is not two-dimensional, is infinite somewhere or empty, `window` is not odd, or
        `delta` negative.

    Notes
    -----
    :math:`R \\leftarrow \\mathrm{median}(R)` where :math:`|R - \\mathrm{median}(R)| >
    \\delta\\,\\mathrm{std}_M(R)`. (3.14) prints the opposite condition, by which every depth but
    the spikes would be replaced. The standard deviation is that of the window's values themselves
    (divided by their number); the map is mirrored at its border.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.focus import correct_spikes
    >>> depth = np.zeros((9, 9))
    >>> depth[4, 4] = 50.0
    >>> float(np.abs(correct_spikes(depth)).max())
    0.0
    """
    z = as_map("depth", depth)
    n = as_integer("window", window, least=3, odd=True, most=255)
    limit = as_scalar("delta", delta, least=0)
    unknown = np.isnan(z)
    if unknown.all():
        return z.copy()
    median = _median_of_known(z, n)
    # Deviations from one common value keep the difference of squares exact for small steps on a
    # great height.
    centered = np.where(unknown, 0.0, z - np.nanmean(z))
    share = _mean(np.where(unknown, 0.0, 1.0), n)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = _mean(centered, n) / share
        variance = np.maximum(_mean(centered**2, n) / share - mean**2, 0)
        spike = unknown | (np.abs(z - median) > limit * np.sqrt(variance))
    return np.where(spike, median, z)


def _mean(image: Array, n: int) -> Array:
    mean = cv2.boxFilter(image, cv2.CV_64F, (n, n), borderType=cv2.BORDER_REFLECT)
    return np.asarray(mean, np.float64)


def _median_of_known(z: Array, n: int) -> Array:
    """Median of the values that are not NaN in a square of side n, NaN where there are none."""
    windows = sliding_window_view(np.pad(z, n // 2, mode="symmetric"), (n, n))
    result = np.empty_like(z)
    for row, window in zip(result, windows, strict=True):
        values = np.sort(window.reshape(len(row), -1), axis=1)  # NaN last
        known = np.count_nonzero(~np.isnan(values), axis=1)
        column = np.arange(len(row))
        row[:] = (values[column, (known - 1) // 2] + values[column, known // 2]) / 2
    return result


def smooth_depth(depth: ArrayLike, *, jump: float, sigma: float = 7.0) -> Array:
    """Smooth a depth map by planes fitted around every pixel, but not across jumps in height.

    Parameters
    ----------
    depth : array_like, shape (rows, cols)
        Depths, µm; NaN where unknown.
    jump : float
        Difference in depth at and above which a neighbor has no weight, µm. Choose a value well
        above the noise and below the steps that are to be kept.
    sigma : float
        Standard deviation of the Gaussian that weights neighbors by distance, px. The Gaussian is
        cut off at two standard deviations.

    Returns
    -------
    ndarray of float64, shape (rows, cols)
        Smoothed depths, µm; NaN where `depth` is NaN.

    Raises
    ------
    ValueError
        If the map is not two-dimensional or contains an infinity, or if a length is not positive.

    Notes
    -----
    A plane is fitted instead of a mean, because a mean is biased on a slope whose neighbors have
    unequal weights. A neighbor whose depth differs by v has the weight
    :math:`(1 - (v/\\mathrm{jump})^2)^2`, Tukey's biweight. On a slope
    these weights narrow the window along the gradient, which limits the bias on steep flanks. The
    residuals of the planes are smoothed in the same way and added (Tukey's twicing), which removes
    most of the bias on a curved surface. The neighbors are sampled several pixels apart, because
    the errors of a depth from focus are correlated between adjacent pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.focus import smooth_depth
    >>> x = np.arange(32.0)
    >>> step = np.tile(np.where(x < 16, 0.0, 100.0) + 0.1 * x, (32, 1))
    >>> bool(np.allclose(smooth_depth(step, jump=20.0), step, atol=0.02))
    True
    """
    z = as_map("depth", depth)
    limit = as_scalar("jump", jump, above=0)
    deviation = as_scalar("sigma", sigma, above=0, most=250)
    return smooth_planes(z, np.ones_like(z), jump=limit, sigma=deviation)
