"""Mean and Gaussian curvature of a height map (3.15 to 3.23) and its surface types (3.24, 3.25).

Heights point to the viewer, so a dome has H < 0 and K > 0 (Table 3.1). Heights and `pixel_size`
share one unit, here µm; H is then in 1/µm and K in 1/µm².
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import comb
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    MICROMETERS,
    Array,
    Result,
    as_array,
    as_map,
    of_kind,
    positive,
    scalar,
    whole,
)
from microlib._common._opencv import cv2

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "HK_NAMES",
    "clean_labels",
    "curvature_windows",
    "hk_labels",
    "region_table",
    "surface_curvature",
]

#: Table 3.1: the surface type of each label. A smooth surface has H² ≥ K, so label 4 (H = 0 and K
#: > 0) cannot occur but through noise or thresholds that do not match.
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


@dataclass(frozen=True, eq=False, repr=False)
class Windows(Result):
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


@dataclass(frozen=True, eq=False, repr=False)
class Curvature(Result):
    """Curvature of a height map.

    Attributes
    ----------
    mean, gaussian : ndarray of float64, shape (rows, cols)
        H in 1/µm and K in 1/µm² (3.22, 3.23). NaN where a window leaves the map or meets a NaN.
    mean_error, gaussian_error : ndarray of float64, shape (rows, cols)
        Standard errors of H and K, in the same units; NaN if the noise is not known.
    """

    mean: Array
    gaussian: Array
    mean_error: Array
    gaussian_error: Array


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
    >>> from microlib.curvature import curvature_windows
    >>> windows = curvature_windows(7)
    >>> (64 * windows.smooth).round().astype(int).tolist()
    [1, 6, 15, 20, 15, 6, 1]
    >>> (42 * windows.second_derivative).round().astype(int).tolist()
    [5, 0, -3, -4, -3, 0, 5]
    """
    n = whole("size", size, least=3, odd=True)
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
    pixel_size: float | tuple[float, float] | None = None,
    *,
    size: int = 7,
    noise: float | None = None,
) -> Curvature:
    """Return mean and Gaussian curvature of a height map, with their standard errors.

    Parameters
    ----------
    height : array_like, shape (rows, cols)
        Heights, µm, towards the viewer. NaN marks what is unknown. An xarray.DataArray may have
        another unit of length in ``attrs["units"]``.
    pixel_size : float or tuple of float, optional
        Distance between neighboring pixels on the object, µm; (x, y) where they are not square. By
        default that of the coordinates of an xarray.DataArray.
    size : int
        Side of the windows, px, odd, at least 3. The scale of what is seen: a window of `size`
        smooths and differentiates over 2 `size` - 1 pixels.
    noise : float, optional
        Standard deviation of the heights, µm, independent from pixel to pixel. Without it the
        standard errors are NaN; a map does not tell its noise from fine relief or from noise that
        neighbors share. The rounding of the heights is taken as noise where it is larger.

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
        not positive or not that of the coordinates, `noise` is negative, or `size` is not an odd
        whole number of at least 3.

    Warns
    -----
    UserWarning
        If half of the map is steeper than 76°, as it is where heights and pixels differ in unit.

    Notes
    -----
    Derivatives are the windows (3.15)–(3.19) applied as in (3.20)–(3.21), divided by the pixel
    size and its square; H and K follow (3.22)–(3.23). The thesis leaves out the pixel size, which
    fixes the units of H and K and so the meaning of any threshold.

    A pixel depends on what lies `size` - 1 pixels around it alone: tiles that overlap by as much,
    such as those of `dask.array.map_overlap`, have the curvature of the whole.

    The error of a second derivative is `noise` times the root of the sum of the squares of its
    window. It enters H to first order, K to first and second order, because on a plane K is a
    product of errors. The errors of the slopes are left out: in pixels they are smaller by the
    ratio of the window to the radius of curvature.

    Examples
    --------
    A ball of 100 µm radius seen from above, 1 µm a pixel:

    >>> import numpy as np
    >>> from microlib.curvature import surface_curvature
    >>> y, x = np.mgrid[-20:21, -20:21]
    >>> ball = surface_curvature(np.sqrt(100.0**2 - x**2 - y**2), pixel_size=1.0)
    >>> round(float(ball.mean[20, 20]), 4), round(float(ball.gaussian[20, 20]), 6)
    (-0.01, 0.0001)
    """
    n = whole("size", size, least=3, odd=True)
    z, pitch_x, pitch_y = _in_micrometers(height, pixel_size)
    sigma = np.nan if noise is None else scalar("noise", noise, least=0)
    if min(z.shape) < 2 * n - 1:
        raise ValueError(f"height must be at least {2 * n - 1} px on each side, got {z.shape}")

    windows = curvature_windows(n)
    value, slope, second = (
        np.convolve(windows.smooth, d)
        for d in (windows.mean, windows.slope, windows.second_derivative)
    )
    unknown = np.isnan(z)
    filled, border = np.where(unknown, 0.0, z), cv2.BORDER_REPLICATE
    zx, zy, zxx, zyy, zxy = (
        cv2.sepFilter2D(filled, cv2.CV_64F, along_x, along_y, borderType=border) / pitch
        for pitch, along_x, along_y in (
            (pitch_x, slope, value),
            (pitch_y, value, slope),
            (pitch_x**2, second, value),
            (pitch_y**2, value, second),
            (pitch_x * pitch_y, slope, slope),
        )
    )
    blind = cv2.dilate(unknown.astype(np.uint8), np.ones((2 * n - 1,) * 2, np.uint8)) > 0
    margin = n - 1
    blind[:margin], blind[-margin:], blind[:, :margin], blind[:, -margin:] = True, True, True, True
    if not blind.all() and (steepness := float(np.median(np.hypot(zx, zy)[~blind]))) > 4:
        warnings.warn(
            f"half of height is steeper than {steepness:.3g}: is it in the unit of pixel_size, µm?",
            stacklevel=2,
        )

    steep = 1 + zx**2 + zy**2
    ex, ey = 1 + zx**2, 1 + zy**2
    mean = (ex * zyy - 2 * zx * zy * zxy + ey * zxx) / (2 * steep**1.5)
    gaussian = (zxx * zyy - zxy**2) / steep**2

    # Covariance of (zxx, zyy, zxy); the mixed window is odd in x and y and so uncorrelated with
    # the others.
    # A sum over 2n − 1 pixels a side is rounded by no more than this part of the heights.
    rounding = (2 * n - 1) * _rounding(height) * np.abs(filled).max()
    along_x, along_y = (np.maximum(sigma, rounding) / np.array([pitch_x, pitch_y]) ** 2) ** 2
    straight_x, straight_y = np.sum(second**2) * np.sum(value**2) * np.array([along_x, along_y])
    cross = np.sqrt(along_x * along_y) * np.sum(second * value) ** 2
    mixed = np.sqrt(along_x * along_y) * np.sum(slope**2) ** 2
    mean_variance = (
        straight_y * ex**2 + straight_x * ey**2 + 2 * cross * ex * ey + mixed * (2 * zx * zy) ** 2
    ) / (4 * steep**3)
    # To first order, less what noise alone puts into the squares, and never below the second order.
    second_order = straight_x * straight_y + cross**2 + 2 * mixed**2
    first_order = straight_x * zyy**2 + straight_y * zxx**2
    first_order += 2 * cross * zxx * zyy + 4 * mixed * zxy**2
    gaussian_variance = np.maximum(first_order - second_order, second_order) / steep**4
    fields = [mean, gaussian, np.sqrt(mean_variance), np.sqrt(gaussian_variance)]
    return Curvature(*(np.where(blind, np.nan, np.asarray(field)) for field in fields))


def _in_micrometers(
    height: Any, pixel_size: float | tuple[float, float] | None
) -> tuple[Array, float, float]:
    """Return heights and both sides of a pixel, in µm."""
    z, own = as_map("height", height), [np.nan, np.nan]
    if hasattr(height, "coords"):  # xarray's
        z = z * _micrometers(height.attrs.get("units", "µm"))
        own = [_step(height.coords[dim]) for dim in height.dims[::-1] if dim in height.coords]
    labeled = len(own) == 2 and np.isfinite(own).all()
    if pixel_size is None and not labeled:
        raise ValueError("pixel_size must be given for a map without coordinates, got None")
    sides = positive("pixel_size", own if pixel_size is None else pixel_size)
    if sides.shape not in ((), (2,)):
        raise ValueError(f"pixel_size must be a number or (x, y), got the shape {sides.shape}")
    if labeled and not np.allclose(sides, own, rtol=0.01):
        raise ValueError(f"pixel_size must be that of the coordinates, {own} µm, got {pixel_size}")
    x, y = np.broadcast_to(sides, 2).tolist()
    return z, x, y


def _step(coordinate: Any) -> float:
    """Return the distance of neighbors in µm; NaN where a coordinate only numbers the pixels."""
    steps, unit = np.diff(coordinate.values), coordinate.attrs.get("units")
    if steps.size == 0 or (unit is None and (steps == 1).all()):
        return np.nan
    if not np.allclose(steps, steps[0], rtol=1e-3):
        raise ValueError(f"height must have evenly spaced coordinates, got {coordinate.name}")
    return float(abs(steps.mean())) * _micrometers("µm" if unit is None else unit)


def _micrometers(unit: object) -> float:
    if str(unit) not in MICROMETERS:
        raise ValueError(f"height must be in a unit of length, got {unit}")
    return MICROMETERS[str(unit)]


def _rounding(height: Any) -> float:
    """Return the relative rounding of the numbers of a map."""
    kind = np.asarray(height).dtype
    return float(np.finfo(kind if kind.kind == "f" else float).eps)


def hk_labels(
    mean: ArrayLike | Curvature,
    gaussian: ArrayLike | None = None,
    h_zero: ArrayLike | None = None,
    k_zero: ArrayLike | None = None,
) -> NDArray[np.uint8]:
    """Return the surface type of every pixel from the signs of H and K.

    Parameters
    ----------
    mean : Curvature or array_like
        What `surface_curvature` returned, for a known noise: H and K are then zero within 3.5 of
        their standard errors, unless thresholds are given. Or H in 1/µm; NaN where unknown.
    gaussian : array_like, optional
        K in 1/µm², of the shape of `mean`; only beside an array.
    h_zero, k_zero : float or array_like, optional
        Largest magnitudes of H and K that count as zero, in the same units; a number, or one for
        each pixel. They may be left out for a `Curvature` alone.

    Returns
    -------
    ndarray of uint8
        Labels of Table 3.1, named in `HK_NAMES`; 0 where H, K or a threshold is NaN.

    Raises
    ------
    ValueError
        If the shapes differ, a threshold is negative or missing, or a `Curvature` without
        thresholds has no errors.

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

    A ball with 5 nm of noise, whose thresholds follow from it:

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
            raise ValueError("gaussian must be left out beside a Curvature, got both")
        curved = mean
        mean, gaussian = curved.mean, curved.gaussian
        known = np.isfinite(curved.mean)
        unsure = known.any() and np.isnan(curved.mean_error[known]).all()
        if (h_zero is None or k_zero is None) and unsure:
            raise ValueError(
                "mean must have errors where h_zero or k_zero is left out, got a Curvature "
                "without: give surface_curvature the noise of the heights"
            )
        errors = 3.5  # beyond, noise leaves one of 2000 pixels that are zero
        h_zero = errors * curved.mean_error if h_zero is None else h_zero
        k_zero = errors * curved.gaussian_error if k_zero is None else k_zero
    if gaussian is None or h_zero is None or k_zero is None:
        raise ValueError("gaussian, h_zero and k_zero must be given beside an array, got None")
    h, k = as_array("mean", mean, finite=False), as_array("gaussian", gaussian, finite=False)
    if k.shape != h.shape:
        raise ValueError(f"gaussian must have the shape {h.shape} of mean, got {k.shape}")
    limits = []
    for name, value in (("h_zero", h_zero), ("k_zero", k_zero)):
        limits.append(limit := as_array(name, value, finite=False))
        if limit.ndim and limit.shape != h.shape:
            raise ValueError(f"{name} must have the shape {h.shape} of mean, got {limit.shape}")
        if (limit < 0).any():
            raise ValueError(f"{name} must be zero or positive, got {np.nanmin(limit):g}")
    known = ~np.isnan(h + k + limits[0] + limits[1])
    of_h, of_k = (
        (x > limit).astype(np.int8) - (x < -limit).astype(np.int8)
        for x, limit in zip((h, k), limits, strict=True)
    )
    return np.where(known, 1 + 3 * (1 + of_h) + (1 - of_k), 0).astype(np.uint8)


def _regions(labels: ArrayLike) -> tuple[NDArray[np.uint8], NDArray[np.intp]]:
    """Return checked labels of `hk_labels`, and the number of each pixel's region, 0 for none."""
    from skimage.measure import label  # here, as it takes long to import

    given = as_array("labels", labels, shape=(None, None))
    wrong = (given < 0) | (given > 9) | (given != np.rint(given))
    if wrong.any():
        raise ValueError(f"labels must be 0 to 9 and whole numbers, got {given[wrong][0]:g}")
    types = given.astype(np.uint8)
    return types, label(types, background=0, connectivity=1)


def clean_labels(labels: ArrayLike, smallest: int) -> NDArray[np.uint8]:
    """Give the pixels of small regions the label of the nearest region that is not small.

    Parameters
    ----------
    labels : array_like of int, shape (rows, cols)
        Labels of `hk_labels`; 0 stays 0.
    smallest : int
        Area in pixels below which a region, connected along rows and columns, is removed.

    Returns
    -------
    ndarray of uint8, shape (rows, cols)
        Cleaned labels. If every region is small, the labels are returned unchanged.

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
    from skimage.segmentation import expand_labels  # here, as it takes long to import

    types, regions = _regions(labels)
    least = whole("smallest", smallest, least=1)
    kept = np.where(np.bincount(regions.ravel())[regions] >= least, types, 0)
    if not kept.any():
        return types
    return np.where(types > 0, expand_labels(kept, distance=types.size), 0).astype(np.uint8)


def region_table(labels: ArrayLike, curvature: Curvature) -> pd.DataFrame:
    """Return one row for each connected region of one surface type, the largest first.

    Parameters
    ----------
    labels : array_like of int, shape (rows, cols)
        Labels of `hk_labels`; pixels of label 0 belong to no region.
    curvature : Curvature
        Curvature of the same map.

    Returns
    -------
    pandas.DataFrame
        Columns ``label``, ``name``, ``area`` (px), ``mean`` (mean of H, 1/µm), ``gaussian`` (mean
        of K, 1/µm²) and the centroid ``x``, ``y`` (px). Regions are connected along rows and
        columns.

    Raises
    ------
    ValueError
        If the labels are not 0 to 9 or have not the shape of the curvature.

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
    of_kind("curvature", curvature, Curvature)
    if types.shape != curvature.mean.shape:
        raise ValueError(
            f"labels must have the curvature's shape {curvature.mean.shape}, got {types.shape}"
        )
    import pandas as pd  # here, as they take long to import
    from skimage.measure import regionprops_table

    fields = np.stack([types, curvature.mean, curvature.gaussian], axis=-1)
    found = regionprops_table(regions, fields, properties=("intensity_mean", "area", "centroid"))
    label = found["intensity_mean-0"].astype(int)
    table = pd.DataFrame(
        {
            "label": label,
            "name": [HK_NAMES[kind] for kind in label],
            "area": found["area"].astype(int),
            "mean": found["intensity_mean-1"],
            "gaussian": found["intensity_mean-2"],
            "x": found["centroid-1"],
            "y": found["centroid-0"],
        }
    )
    return table.sort_values("area", ascending=False, kind="stable", ignore_index=True)
