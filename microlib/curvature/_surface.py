"""Mean and Gaussian curvature of a height map: 3.15 to 3.23."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from microlib._common import Array, as_array, scalar, whole


@dataclass(frozen=True)
class Windows:
    """The windows from which all derivative windows are built; see `curvature_windows`.

    Attributes
    ----------
    smooth : ndarray of float64, shape (size,)
        Binomial smoother s (3.15).
    mean, slope, second_derivative : ndarray of float64, shape (size,)
        Least-squares value :math:`d_0` (3.17), first derivative :math:`d_1` (3.18, per px) and
        second derivative :math:`d_2` (3.19 corrected, per px²).
    """

    smooth: Array
    mean: Array
    slope: Array
    second_derivative: Array


@dataclass(frozen=True)
class Curvature:
    """Curvature of a height map.

    Attributes
    ----------
    mean, gaussian : ndarray of float64, shape (rows, cols)
        H in 1/µm and K in 1/µm² (3.22, 3.23). NaN where a window leaves the map or meets a NaN.
    mean_error, gaussian_error : ndarray of float64, shape (rows, cols)
        Standard errors of H and K, in the same units; zero if no noise was given.
    """

    mean: Array
    gaussian: Array
    mean_error: Array
    gaussian_error: Array


#: Micrometers, and the inverse of the least: heights and pixels between have curvatures and squares
#: of them within the range of floating point.
_FARTHEST = 1e12
#: Largest window, px: the binomial weights are divided by 2 to its power, at most 2¹⁰²³.
_LARGEST_WINDOW = 1001


def curvature_windows(size: int = 7) -> Windows:
    """Return Besl's separable smoothing and derivative windows for a square of `size` pixels.

    Parameters
    ----------
    size : int
        Side of the square, px, odd, at least 3. The thesis uses 7.

    Returns
    -------
    Windows
        Four columns of length `size`: the smoother ``smooth``, and ``mean``, ``slope`` (per px) and
        ``second_derivative`` (per px²). They are written for correlation; (3.16) speaks of
        convolution, which would flip the sign of the first derivatives and leave H and K as they
        are.

    Raises
    ------
    ValueError
        If `size` is not an odd whole number of at least 3.

    Notes
    -----
    The smoothing window is the binomial one (3.15). :math:`d_0` (3.17), :math:`d_1` (3.18) and
    :math:`d_2` (3.19) are the value, slope and second derivative at the center of the parabola
    that fits the window in the least-squares sense. (3.19) prints :math:`d_2` with 1/84, which
    yields the coefficient of t², half the second derivative: applied to t² it gives 1 instead of
    2. Here the factor is 1/42, without which H comes out at half
    and K at a quarter of the truth, wherever R_xy = 0.

    Examples
    --------
    >>> windows = curvature_windows(7)
    >>> (64 * windows.smooth).round().astype(int).tolist()
    [1, 6, 15, 20, 15, 6, 1]
    >>> (42 * windows.second_derivative).round().astype(int).tolist()
    [5, 0, -3, -4, -3, 0, 5]
    """
    n = whole("size", size, least=3, odd=True, most=_LARGEST_WINDOW)
    t = np.arange(n, dtype=np.float64) - n // 2
    quadratic = t**2 - np.mean(t**2)
    return Windows(
        smooth=np.array([comb(n - 1, k) for k in range(n)]) / 2.0 ** (n - 1),
        mean=np.full(n, 1.0 / n),
        slope=t / np.sum(t**2),
        second_derivative=2 * quadratic / np.sum(quadratic**2),
    )


def surface_curvature(
    height: ArrayLike, pixel_size: float, *, size: int = 7, noise: float = 0.0
) -> Curvature:
    """Return mean and Gaussian curvature of a height map, with their standard errors.

    Parameters
    ----------
    height : array_like, shape (rows, cols)
        Heights, µm, towards the viewer. NaN marks what is unknown.
    pixel_size : float
        Distance between neighboring pixels on the object, µm.
    size : int
        Side of the windows, px, odd, at least 3. The scale of what is seen: a window of `size`
        smooths and differentiates over 2 `size` - 1 pixels.
    noise : float
        Standard deviation of the heights, µm, independent from pixel to pixel.

    Returns
    -------
    Curvature
        ``mean`` (1/µm) and ``gaussian`` (1/µm²) with their standard errors ``mean_error`` and
        ``gaussian_error``, arrays of the map's shape. A band of `size` - 1 pixels along the border,
        and around every NaN, is NaN.

    Raises
    ------
    ValueError
        If the map is smaller than 2 `size` - 1 on a side or holds an infinity, `pixel_size` is
        not positive, `noise` is negative, or `size` is not an odd whole number of at least 3.

    Notes
    -----
    Derivatives are the windows (3.15)–(3.19) applied as in (3.20)–(3.21), divided by the pixel
    size and its square; H and K follow (3.22)–(3.23). The thesis leaves out the pixel size, which
    fixes the units of H and K and so the meaning of any threshold.

    A pixel depends on what lies `size` - 1 pixels around it alone, to the last bit: tiles that
    overlap by as much, such as those of `dask.array.map_overlap`, have the curvature of the whole.

    The error of a second derivative is `noise` times the root of the sum of the squares of its
    window. It enters H to first order, K to first and second order, because on a plane K is a
    product of errors. The errors of the slopes are left out: in pixels they are smaller by the
    ratio of the window to the radius of curvature.

    Examples
    --------
    A ball of 100 µm radius seen from above, 1 µm a pixel:

    >>> y, x = np.mgrid[-20:21, -20:21]
    >>> ball = surface_curvature(np.sqrt(100.0**2 - x**2 - y**2), pixel_size=1.0)
    >>> round(float(ball.mean[20, 20]), 4), round(float(ball.gaussian[20, 20]), 6)
    (-0.01, 0.0001)
    """
    n = whole("size", size, least=3, odd=True, most=_LARGEST_WINDOW)
    pitch = scalar("pixel_size", pixel_size, above=0, least=1 / _FARTHEST, most=_FARTHEST)
    sigma = scalar("noise", noise, least=0)
    z = as_array("height", height, shape=(None, None), finite=False, largest=_FARTHEST)
    if np.isinf(z).any():
        raise ValueError(f"height must be finite or NaN, got {int(np.isinf(z).sum())} infinite")
    if min(z.shape) < 2 * n - 1:
        raise ValueError(f"height must be at least {2 * n - 1} px on each side, got {z.shape}")

    value, slope, second = _combined(n)
    unknown = np.isnan(z)
    zx, zy, zxx, zyy, zxy = derivatives(np.where(unknown, 0.0, z), pitch, n)
    blind = (
        ndimage.binary_dilation(unknown, np.ones((2 * n - 1,) * 2)) if unknown.any() else unknown
    )
    margin = n - 1
    blind[:margin], blind[-margin:], blind[:, :margin], blind[:, -margin:] = True, True, True, True

    steep = 1 + zx**2 + zy**2
    ex, ey = 1 + zx**2, 1 + zy**2
    mean = (ex * zyy - 2 * zx * zy * zxy + ey * zxx) / (2 * steep**1.5)
    gaussian = (zxx * zyy - zxy**2) / steep**2

    # Covariance of (zxx, zyy, zxy); the mixed window is odd in x and y and so uncorrelated with
    # the others.
    scale = (sigma / pitch**2) ** 2
    straight = scale * np.sum(second**2) * np.sum(value**2)
    cross = scale * np.sum(second * value) ** 2
    mixed = scale * np.sum(slope**2) ** 2
    mean_variance = (
        straight * (ex**2 + ey**2) + 2 * cross * ex * ey + mixed * (2 * zx * zy) ** 2
    ) / (4 * steep**3)
    # To first order, less what noise alone puts into the squares, and never below the second order.
    second_order = straight**2 + cross**2 + 2 * mixed**2
    first_order = straight * (zxx**2 + zyy**2) + 2 * cross * zxx * zyy + 4 * mixed * zxy**2
    gaussian_variance = np.maximum(first_order - second_order, second_order) / steep**4
    fields = (mean, gaussian, np.sqrt(mean_variance), np.sqrt(gaussian_variance))
    for field in fields:
        field[blind] = np.nan
    return Curvature(*fields)


def derivatives(z: Array, pitch: float, n: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return the derivatives along x, y, xx, yy and xy (3.20, 3.21) of a map without NaN."""
    value, slope, second = _combined(n)
    pairs = ((slope, value), (value, slope), (second, value), (value, second), (slope, slope))
    zx, zy, zxx, zyy, zxy = (_correlate(z, *pair) for pair in pairs)
    return zx / pitch, zy / pitch, zxx / pitch**2, zyy / pitch**2, zxy / pitch**2


def _combined(n: int) -> tuple[Array, Array, Array]:
    """Return value, slope and second-derivative windows with the smoother folded in."""
    windows = curvature_windows(n)
    value, slope, second = (
        np.convolve(windows.smooth, d)
        for d in (windows.mean, windows.slope, windows.second_derivative)
    )
    return value, slope, second


def _correlate(image: Array, along_x: Array, along_y: Array) -> Array:
    return np.asarray(
        cv2.sepFilter2D(image, cv2.CV_64F, along_x, along_y, borderType=cv2.BORDER_REPLICATE),
        np.float64,
    )
