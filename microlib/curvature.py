"""Mean and Gaussian curvature of a height map (3.15 to 3.23) and its HK labels (3.24, 3.25).

Heights point to the viewer, so that a dome has H < 0 and K > 0 (Table 3.1). Heights and
`pixel_size` are in µm, H is in 1/µm and K in 1/µm².
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import comb
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    Result,
    as_array,
    as_instance,
    as_integer,
    as_map,
    as_positive,
    as_scalar,
)
from microlib._common._opencv import cv2

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "HK_NAMES",
    "Curvature",
    "Windows",
    "clean_labels",
    "curvature_windows",
    "hk_labels",
    "region_table",
    "surface_curvature",
]

#: Table 3.1: the surface type of each label. A smooth surface has H² ≥ K. Label 4 (H = 0 and K > 0)
#: therefore comes only from noise or from thresholds that do not match.
HK_NAMES = {
    1: "convex elliptic",
    2: "convex cylindric",
    3: "saddle ridge",
    4: "none",
    5: "planar",
    6: "minimal surface",
    7: "concave elliptic",
    8: "concave cylindric",
    9: "saddle valley",
}


#: Uncertainties that noise exceeds at one of 2000 pixels.
_SURE = 3.5


@dataclass(frozen=True, eq=False, repr=False)
class Windows(Result):
    """One-dimensional windows of smoothing and differentiation, from `curvature_windows`.

    Attributes
    ----------
    smooth : ndarray of float64, shape (size,)
        Binomial smoothing window s (3.15).
    mean, slope, second_derivative : ndarray of float64, shape (size,)
        Least-squares value :math:`d_0` (3.17), first derivative :math:`d_1` (3.18, per px) and
        second derivative :math:`d_2` (3.19 corrected, per px²).
    """

    smooth: Array
    mean: Array
    slope: Array
    second_derivative: Array


@dataclass(frozen=True, eq=False, repr=False)
class Curvature(Result):
    """Curvature of a height map.

    Attributes
    ----------
    mean, gaussian : ndarray of float64, shape (rows, cols)
        H in 1/µm and K in 1/µm² (3.22, 3.23). NaN where a window extends beyond the map or contains
        a NaN.
    mean_uncertainty, gaussian_uncertainty : ndarray of float64, shape (rows, cols)
        Standard uncertainties of H and K, in the same units. NaN if the noise is unknown.
    """

    mean: Array
    gaussian: Array
    mean_uncertainty: Array
    gaussian_uncertainty: Array


def curvature_windows(size: int = 7) -> Windows:
    """Return smoothing and derivative windows, each of which acts along rows or columns.

    Parameters
    ----------
    size : int
        Length of a window, px, odd, at least 3. The thesis uses 7.

    Returns
    -------
    Windows
        Arrays of length `size`: ``smooth``, ``mean``, ``slope`` (per px) and ``second_derivative``
        (per px²), for correlation. The convolution of (3.16) would reverse the sign of the first
        derivatives, which does not change H and K.

    Raises
    ------
    ValueError
        If `size` is not an odd whole number of at least 3.

    Notes
    -----
    The smoothing window is binomial (3.15). :math:`d_0` (3.17), :math:`d_1` (3.18) and :math:`d_2`
    (3.19) are the value, slope and second derivative at the center of the least-squares parabola of
    the window. (3.19) prints :math:`d_2` with the factor 1/84, which is the coefficient of t², half
    of the second derivative. Here the factor is 1/42. With 1/84, H is half and K a quarter of the
    true value where R_xy = 0.

    Examples
    --------
    >>> from microlib.curvature import curvature_windows
    >>> windows = curvature_windows(7)
    >>> (64 * windows.smooth).round().astype(int).tolist()
    [1, 6, 15, 20, 15, 6, 1]
    >>> (42 * windows.second_derivative).round().astype(int).tolist()
    [5, 0, -3, -4, -3, 0, 5]
    """
    n = as_integer("size", size, least=3, odd=True)
    t = np.arange(n, dtype=np.float64) - n // 2
    quadratic = t**2 - np.mean(t**2)
    return Windows(
        smooth=np.array([comb(n - 1, k) for k in range(n)]) / 2.0 ** (n - 1),
        mean=np.full(n, 1.0 / n),
        slope=t / np.sum(t**2),
        second_derivative=2 * quadratic / np.sum(quadratic**2),
    )


def surface_curvature(
    height: ArrayLike,
    pixel_size: float | tuple[float, float],
    *,
    size: int = 7,
    noise: float | None = None,
) -> Curvature:
    """Return mean and Gaussian curvature of a height map, with their standard uncertainties.

    Parameters
    ----------
    height : array_like, shape (rows, cols)
        Height map, µm, positive towards the viewer. Unknown heights are NaN.
    pixel_size : float or tuple of float
        Distance of neighboring pixels on the object, µm; (x, y) if pixels are not square.
    size : int
        Side of the windows, px, odd, at least 3. Smoothing and differentiation together span 2
        `size` − 1 pixels on a side.
    noise : float, optional
        Standard deviation of the height errors, µm, assumed to be independent from pixel to pixel
        (see Notes). Without `noise` the uncertainties are NaN. If the rounding error of the
        floating-point type of `height` is larger than `noise`, the rounding error is used.

    Returns
    -------
    Curvature
        ``mean`` (1/µm, negative on a dome) and ``gaussian`` (1/µm²) with their standard
        uncertainties ``mean_uncertainty`` and ``gaussian_uncertainty``, arrays of the shape of the
        map. The values are NaN in a band of `size` − 1 pixels along the border and around every
        NaN.

    Raises
    ------
    ValueError
        If the map is smaller than 2 `size` − 1 pixels on a side or contains an infinity. If
        `pixel_size` is not positive, or `noise` is negative. If `size` is not an odd whole number
        of at least 3.

    Warns
    -----
    UserWarning
        If at least half of the map is steeper than 76°, which suggests that heights and
        `pixel_size` have different units.

    Notes
    -----
    With `size` = 7 the windows are (3.15)–(3.19), with the divisor of (3.19) corrected to 42. Other
    sizes use binomial and least-squares windows of that length. The windows are applied to the
    heights as in (3.20)–(3.21). The first derivatives are divided by the pixel size, and the second
    derivatives are divided by its square. H and K follow from (3.22)–(3.23). The thesis omits the
    pixel size, so its thresholds of H and K do not apply here.

    The uncertainties assume that the errors of neighboring heights are independent. Heights of
    `depth_from_focus` are smoothed with a Gaussian of σ = 7 px, so their errors are not independent
    and the uncertainties are approximate: in tests on rendered planes, they exceeded the errors of
    H. The uncertainty of a second derivative is `noise` times the root of the sum of the squared
    window coefficients, divided by the square of the pixel size. The uncertainty of H is computed
    to first order in the errors of the second derivatives, and the uncertainty of K to second
    order, because the terms of first order vanish on a plane. Errors of the first derivatives are
    neglected. Relative to the errors of the second derivatives, the effect of those of the first
    is about the window size divided by the radius of curvature.

    A value depends only on the pixels within a distance of `size` − 1 pixels along rows and
    columns. Tiles with this overlap, such as those of `dask.array.map_overlap`, give the same
    curvature as the whole map.

    Examples
    --------
    A ball with a radius of 100 µm, seen from above, with pixels of 1 µm:

    >>> import numpy as np
    >>> from microlib.curvature import surface_curvature
    >>> y, x = np.mgrid[-20:21, -20:21]
    >>> ball = surface_curvature(np.sqrt(100.0**2 - x**2 - y**2), pixel_size=1.0)
    >>> round(float(ball.mean[20, 20]), 4), round(float(ball.gaussian[20, 20]), 6)
    (-0.01, 0.0001)
    """
    n = as_integer("size", size, least=3, odd=True)
    z = as_map("height", height)
    pitches = as_positive("pixel_size", pixel_size)
    if pitches.shape not in ((), (2,)):
        raise ValueError(f"pixel_size must be a number or (x, y), got shape {pitches.shape}")
    pitches = np.broadcast_to(pitches, 2)
    noise_std = np.nan if noise is None else as_scalar("noise", noise, least=0)
    if min(z.shape) < 2 * n - 1:
        raise ValueError(f"height must be at least {2 * n - 1} px on each side, got {z.shape}")

    # Windows that smooth, and give value, slope and second derivative of a parabola.
    windows = curvature_windows(n)
    fits = (windows.mean, windows.slope, windows.second_derivative)
    kernels = [np.convolve(windows.smooth, window) for window in fits]
    unknown = np.isnan(z)
    filled = np.where(unknown, 0.0, z)
    d = _differentiate(filled, kernels, pitches)
    # Pixels whose windows contain an unknown height or extend beyond the map.
    box, outside = np.ones((2 * n - 1,) * 2, np.uint8), cv2.BORDER_CONSTANT
    blind = cv2.dilate(unknown.astype(np.uint8), box, borderType=outside, borderValue=1) > 0
    if not blind.all() and (steepness := float(np.median(np.hypot(d.x, d.y)[~blind]))) > 4:
        warnings.warn(
            f"height has a median slope of {steepness:.3g}: it must have the unit of pixel_size",
            stacklevel=2,
        )

    ex, ey = 1 + d.x**2, 1 + d.y**2
    squared = ex + d.y**2
    mean = (ex * d.yy - 2 * d.x * d.y * d.xy + ey * d.xx) / (2 * squared**1.5)  # (3.22)
    gaussian = (d.xx * d.yy - d.xy**2) / squared**2  # (3.23)
    # Rounding of a sum over 2n − 1 pixels a side is at most this fraction of the heights.
    kind = np.asarray(height).dtype
    eps = np.finfo(kind if kind.kind == "f" else np.float64).eps
    rounding = (2 * n - 1) * float(eps) * np.abs(filled).max()
    uncertainties = _uncertainties(d, kernels, np.maximum(noise_std, rounding) / pitches**2)
    values = (np.where(blind, np.nan, each) for each in (mean, gaussian, *uncertainties))
    return Curvature(*values)


class _Derivatives(NamedTuple):
    """First and second derivatives of a height map; no unit, and 1/µm."""

    x: Array
    y: Array
    xx: Array
    yy: Array
    xy: Array


def _differentiate(z: Array, kernels: list[Array], pitches: Array) -> _Derivatives:
    """Return the derivatives (3.20) and (3.21) of a map without NaN."""
    (value, slope, second), (pitch_x, pitch_y) = kernels, pitches
    passes = (
        (slope, value, pitch_x),
        (value, slope, pitch_y),
        (second, value, pitch_x**2),
        (value, second, pitch_y**2),
        (slope, slope, pitch_x * pitch_y),
    )
    border = cv2.BORDER_REPLICATE
    maps = (
        cv2.sepFilter2D(z, cv2.CV_64F, along_x, along_y, borderType=border) / unit
        for along_x, along_y, unit in passes
    )
    return _Derivatives(*maps)


def _uncertainties(d: _Derivatives, kernels: list[Array], noise: Array) -> tuple[Array, Array]:
    """Return the uncertainties of H and K.

    `noise` is the standard deviation of the heights, divided by the square of the pixel size along
    x and along y.
    """
    value, slope, second = kernels
    # Covariance of (zxx, zyy, zxy). The mixed window is odd in x and y, so that zxy is uncorrelated
    # with the others.
    var_xx, var_yy = np.sum(second**2) * np.sum(value**2) * noise**2
    cov_xx_yy = noise.prod() * np.sum(second * value) ** 2
    var_xy = noise.prod() * np.sum(slope**2) ** 2
    ex, ey = 1 + d.x**2, 1 + d.y**2
    squared = ex + d.y**2
    mean_variance = (
        var_yy * ex**2 + var_xx * ey**2 + 2 * cov_xx_yy * ex * ey + var_xy * (2 * d.x * d.y) ** 2
    ) / (4 * squared**3)
    # First order of the measured derivatives, whose squares contain the second order of the noise.
    second_order = var_xx * var_yy + cov_xx_yy**2 + 2 * var_xy**2
    first_order = var_xx * d.yy**2 + var_yy * d.xx**2
    first_order += 2 * cov_xx_yy * d.xx * d.yy + 4 * var_xy * d.xy**2
    gaussian_variance = np.maximum(first_order - second_order, second_order) / squared**4
    return np.sqrt(mean_variance), np.sqrt(gaussian_variance)


def hk_labels(
    mean: ArrayLike | Curvature,
    gaussian: ArrayLike | None = None,
    h_zero: ArrayLike | None = None,
    k_zero: ArrayLike | None = None,
) -> NDArray[np.uint8]:
    """Return the HK label of every pixel, which is its surface type by the signs of H and K.

    Parameters
    ----------
    mean : Curvature or array_like
        Result of `surface_curvature`, or H in 1/µm with NaN where it is unknown.
    gaussian : array_like, optional
        K in 1/µm², of the shape of `mean`. Required if `mean` is an array, and only then.
    h_zero, k_zero : float or array_like, optional
        Thresholds: the largest magnitudes of H and K that count as zero, in the same units, for all
        pixels or for each. By default 3.5 uncertainties of a `Curvature` of known noise, which
        noise exceeds at one of 2000 pixels.

    Returns
    -------
    ndarray of uint8
        Labels of Table 3.1, named in `HK_NAMES`; 0 where H, K or a threshold is NaN. "planar" means
        that H and K are below the thresholds: the surface is plane, or its curvature is too small
        to be seen: `region_table` has the limit, which is lower for windows of a larger `size`.

    Raises
    ------
    ValueError
        If the shapes differ, a threshold is negative or missing, or the default thresholds are
        wanted for a `Curvature` without uncertainties.

    Notes
    -----
    :math:`T = 1 + 3(1 + \\mathrm{sgn}_\\varepsilon H) + (1 - \\mathrm{sgn}_\\varepsilon K)`
    (3.24, 3.25).

    Examples
    --------
    >>> from microlib.curvature import HK_NAMES, hk_labels
    >>> labels = hk_labels([-0.1, -0.1, 0.0], [0.01, 0.0, 0.0], h_zero=0.03, k_zero=0.005)
    >>> [HK_NAMES[label] for label in labels.tolist()]
    ['convex elliptic', 'convex cylindric', 'planar']

    A ball with 5 nm of noise, and default thresholds:

    >>> import numpy as np
    >>> from microlib.curvature import surface_curvature
    >>> y, x = np.mgrid[-20:21, -20:21]
    >>> ball = np.sqrt(100.0**2 - x**2 - y**2)
    >>> ball += np.random.default_rng(0).normal(0.0, 0.005, ball.shape)
    >>> labels = hk_labels(surface_curvature(ball, 1.0, noise=0.005))
    >>> float((labels[labels > 0] == 1).mean())
    1.0
    """
    if isinstance(mean, Curvature):
        if gaussian is not None:
            raise ValueError("gaussian must not be given with a Curvature")
        h_zero, k_zero = _noise_limits(mean, h_zero, k_zero)
        gaussian, mean = mean.gaussian, mean.mean
    if gaussian is None or h_zero is None or k_zero is None:
        raise ValueError("gaussian, h_zero and k_zero must be given with an array, got None")
    h = as_array("mean", mean, finite=False)
    k = as_array("gaussian", gaussian, finite=False)
    if k.shape != h.shape:
        raise ValueError(f"gaussian must have the shape {h.shape} of mean, got {k.shape}")
    sign_h = _signs(h, "h_zero", h_zero)
    sign_k = _signs(k, "k_zero", k_zero)
    labels = 1 + 3 * (1 + sign_h) + (1 - sign_k)  # (3.25)
    return np.where(np.isnan(labels), 0, labels).astype(np.uint8)


def _noise_limits(
    curvature: Curvature, h_zero: ArrayLike | None, k_zero: ArrayLike | None
) -> tuple[ArrayLike, ArrayLike]:
    """Return the thresholds of H and K, by default `_SURE` times their uncertainties."""
    known = np.isfinite(curvature.mean)
    without = known.any() and np.isnan(curvature.mean_uncertainty[known]).all()
    if without and (h_zero is None or k_zero is None):
        raise ValueError(
            "h_zero and k_zero must be given for a Curvature without uncertainties, or "
            "surface_curvature must be given the noise of the heights"
        )
    return (
        _SURE * curvature.mean_uncertainty if h_zero is None else h_zero,
        _SURE * curvature.gaussian_uncertainty if k_zero is None else k_zero,
    )


def _signs(values: Array, name: str, zero: ArrayLike) -> Array:
    """Return −1, 0 or 1 for each value (3.24); NaN where the value or its threshold is NaN."""
    limit = as_array(name, zero, finite=False)
    if limit.shape not in ((), values.shape):
        raise ValueError(f"{name} must have the shape {values.shape} of mean, got {limit.shape}")
    if (limit < 0).any():
        raise ValueError(f"{name} must be zero or positive, got {np.nanmin(limit):g}")
    signs = np.where(np.abs(values) > limit, np.sign(values), 0.0)
    return np.where(np.isnan(values + limit), np.nan, signs)


def _regions(labels: ArrayLike) -> tuple[NDArray[np.uint8], NDArray[np.intp]]:
    """Return checked labels of `hk_labels`, and the connected regions of one label, from 1 on."""
    from skimage.measure import label  # here, because it takes long to import

    given = as_array("labels", labels, shape=(None, None))
    wrong = (given < 0) | (given > 9) | (given != np.rint(given))
    if wrong.any():
        raise ValueError(f"labels must be 0 to 9 and whole numbers, got {given[wrong][0]:g}")
    types = given.astype(np.uint8)
    return types, label(types, background=0, connectivity=1)


def clean_labels(labels: ArrayLike, smallest: int) -> NDArray[np.uint8]:
    """Replace the label of small regions by that of the nearest larger region.

    Parameters
    ----------
    labels : array_like of int, shape (rows, cols)
        Labels of `hk_labels`; 0 stays 0.
    smallest : int
        Area below which a region is small, px. Regions are connected along rows and columns.

    Returns
    -------
    ndarray of uint8, shape (rows, cols)
        Labels without small regions. The labels are unchanged if every region is small.

    Raises
    ------
    ValueError
        If the labels are not 0 to 9 or `smallest` is not a positive whole number.

    Examples
    --------
    >>> from microlib.curvature import clean_labels
    >>> clean_labels([[5, 5, 5], [5, 2, 5], [5, 5, 5]], smallest=2).tolist()
    [[5, 5, 5], [5, 5, 5], [5, 5, 5]]
    """
    from skimage.segmentation import expand_labels  # here, because it takes long to import

    types, regions = _regions(labels)
    least = as_integer("smallest", smallest, least=1)
    kept = np.where(np.bincount(regions.ravel())[regions] >= least, types, 0)
    if not kept.any():
        return types
    return np.where(types > 0, expand_labels(kept, distance=types.size), 0).astype(np.uint8)


def region_table(labels: ArrayLike, curvature: Curvature) -> pd.DataFrame:
    """Return a table of the connected regions, each of a single surface type, the largest first.

    Parameters
    ----------
    labels : array_like of int, shape (rows, cols)
        Labels of `hk_labels`. Pixels of label 0 belong to no region.
    curvature : Curvature
        Curvature of the same map.

    Returns
    -------
    pandas.DataFrame
        One row per region: ``label``, ``name``, ``area`` (px), ``mean`` (mean of H, 1/µm),
        ``gaussian`` (mean of K, 1/µm²), ``mean_limit`` (mean of the default threshold of H, 1/µm,
        the smallest H that would be seen; NaN if the noise is unknown) and centroid ``x``, ``y``
        (px). Regions are connected along rows and columns.

    Raises
    ------
    ValueError
        If the labels are not 0 to 9, or their shape is not that of the curvature.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.curvature import hk_labels, region_table, surface_curvature
    >>> y, x = np.mgrid[-20:21, -20:21]
    >>> ball = surface_curvature(np.sqrt(100.0**2 - x**2 - y**2), pixel_size=1.0)
    >>> labels = hk_labels(ball.mean, ball.gaussian, h_zero=1e-3, k_zero=1e-5)
    >>> region_table(labels, ball)[["label", "name", "area"]]
       label             name  area
    0      1  convex elliptic   841
    """
    types, regions = _regions(labels)
    as_instance("curvature", curvature, Curvature)
    if types.shape != curvature.mean.shape:
        raise ValueError(
            f"labels must have the shape {curvature.mean.shape} of curvature, got {types.shape}"
        )
    import pandas as pd  # here, because both take long to import
    from skimage.measure import regionprops_table

    limit = _SURE * curvature.mean_uncertainty
    fields = np.stack([types, curvature.mean, curvature.gaussian, limit], axis=-1)
    measured = regionprops_table(regions, fields, properties=("intensity_mean", "area", "centroid"))
    names = {"intensity_mean-0": "label", "area": "area", "intensity_mean-1": "mean"}
    names |= {"intensity_mean-2": "gaussian", "intensity_mean-3": "mean_limit"}
    names |= {"centroid-1": "x", "centroid-0": "y"}
    table = pd.DataFrame(measured)[list(names)].rename(columns=names)
    table = table.astype({"label": int, "area": int})
    table.insert(1, "name", table["label"].map(HK_NAMES))
    return table.sort_values("area", ascending=False, kind="stable", ignore_index=True)
