"""Correction of spikes (3.14), and smoothing of a depth map that preserves its steps."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import product

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, as_map, scalar, whole

#: Rows and columns that are smoothed at a time. All their neighbors stay in the processor's cache.
#: A product of matrices with more columns is shared among the threads of OpenBLAS, which takes ten
#: times as long on a busy machine.
_TILE = 6, 512


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
    n = whole("window", window, least=3, odd=True, most=255)
    limit = scalar("delta", delta, least=0)
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


def smooth_depth(depth: ArrayLike, *, jump: float, radius: float = 7.0) -> Array:
    """Smooth a depth map by planes fitted around every pixel, on its own side of a step.

    Parameters
    ----------
    depth : array_like, shape (rows, cols)
        Depths, µm; NaN where unknown.
    jump : float
        Difference in depth at and above which a neighbor has no weight, µm. Choose a value well
        above the noise and below the steps that are to be kept.
    radius : float
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
    limit = scalar("jump", jump, above=0)
    sigma = scalar("radius", radius, above=0, most=250)
    return smooth_planes(z, np.ones_like(z), jump=limit, sigma=sigma)


def smooth_planes(
    depth: NDArray, weight: NDArray, *, jump: float, sigma: float, workers: int = 1
) -> NDArray:
    """Do the work of `smooth_depth` for depths that have weights; the type is that of `depth`."""
    unknown = np.isnan(depth)
    if unknown.all():
        return depth.copy()
    # The Gaussian is cut off at two standard deviations, where a neighbor counts e⁻²: twice as far
    # the sums would take four times as long. The spacing leaves 37 neighbors in the circle.
    stride = max(1, round(sigma / 1.75))
    reach = stride * int(2 * sigma / stride)
    span = range(-reach, reach + 1, stride)
    offsets = [(y, x) for y, x in product(span, span) if y * y + x * x <= 4 * sigma**2]
    low, high = np.nanmin(depth), np.nanmax(depth)
    # A jump far beyond all differences is none: every neighbor counts in full. One below what
    # single precision tells apart lets none count but equal ones.
    unit = depth.dtype.type(np.clip(jump, 1e-9 * (high - low), 1e6 * (high - low)) or jump)
    # In units of the jump and from the middle, where float32 has digits to spare.
    rest = np.where(unknown, 0, (depth - (low + high) / 2) / unit).astype(np.float32)
    mass = np.pad(np.where(unknown, 0, weight).astype(np.float32), reach)
    # What planes leave over is their shift with its sign turned; the smooth parts are the rest.
    for _ in range(2):
        rest = -_plane_shift(np.pad(rest, reach), mass, np.array(offsets), sigma, workers)
    return depth - unit * rest


def _plane_shift(
    value: NDArray[np.float32],
    mass: NDArray[np.float32],
    offsets: NDArray[np.intp],
    sigma: float,
    workers: int,
) -> NDArray[np.float32]:
    """Return by how much the plane through its neighborhood passes above each value, in jumps."""
    reach = int(offsets.max())
    rows, cols = (n - 2 * reach for n in value.shape)
    y, x = offsets.T
    share = np.exp(-(y**2 + x**2) / (2 * sigma**2))
    basis = (np.stack([np.ones(len(x)), x, y, x * x, y * y, x * y]) * share).astype(np.float32)
    out = np.empty((rows, cols), np.float32)

    def fit(corner: tuple[int, int]) -> None:
        top, left = corner
        tile = out[top : top + _TILE[0], left : left + _TILE[1]]
        gaps, weights = (
            sliding_window_view(image, tile.shape)[top + reach + y, left + reach + x]
            for image in (value, mass)
        )
        gaps -= value[top + reach :, left + reach :][: len(tile), : len(tile[0])]
        # Tukey's biweight of the differences in jumps, times the mass.
        biweight = gaps * gaps
        np.maximum(np.subtract(1, biweight, out=biweight), 0, out=biweight)
        biweight *= biweight
        weights *= biweight
        gaps *= weights
        # One product for each row.
        moments = np.moveaxis(basis @ np.moveaxis(weights, 1, 0), 1, 0)
        raised = np.moveaxis(basis[:3] @ np.moveaxis(gaps, 1, 0), 1, 0)
        tile[:] = _plane_height(moments, raised, sigma)

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fit, product(range(0, rows, _TILE[0]), range(0, cols, _TILE[1]))))
    return out


def _plane_height(moments: NDArray, raised: NDArray, sigma: float) -> NDArray:
    """Return how far planes lie above their pixels, by Cramer's rule; 0 where there is none.

    Parameters
    ----------
    moments : ndarray, shape (6, rows, cols)
        Sums of the weights with 1, x, y, x², y², xy.
    raised : ndarray, shape (3, rows, cols)
        Sums of the weighted gaps with 1, x, y.
    sigma : float
        Radius of the Gaussian, px.
    """
    s, sx, sy, sxx, syy, sxy = moments.astype(np.float64)
    t, tx, ty = raised
    # Added to the variance of the neighbors' places, this makes the planes stiff where neighbors
    # lie on one line; beside that of a full circle, 0.7 of the radius squared, it is nothing.
    stiffness = 0.001 * sigma**2 * s
    sxx, syy = sxx + stiffness, syy + stiffness
    c0, c1, c2 = sxx * syy - sxy * sxy, sx * syy - sxy * sy, sx * sxy - sxx * sy
    determinant = s * c0 - sx * c1 + sy * c2
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(determinant > 0, (t * c0 - tx * c1 + ty * c2) / determinant, 0)
