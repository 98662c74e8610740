"""Surface types from the signs of H and K, their regions and how these are joined: 3.24, 3.25."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.measure import label as connected

from microlib._common import as_array, of_kind, whole
from microlib.curvature._surface import Curvature

#: The surface types of Table 3.1 by label.
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


def hk_labels(
    mean: ArrayLike, gaussian: ArrayLike, h_zero: ArrayLike, k_zero: ArrayLike
) -> NDArray[np.uint8]:
    """Return the surface type of every pixel from the signs of H and K.

    Parameters
    ----------
    mean, gaussian : array_like
        H in 1/µm and K in 1/µm², of one shape; NaN where unknown.
    h_zero, k_zero : float or array_like
        Largest magnitudes of H and K that count as zero, in the same units; a number, or one for
        each pixel, such as a multiple of the errors in `Curvature`.

    Returns
    -------
    ndarray of uint8
        Labels of Table 3.1, named in `HK_NAMES`; 0 where H, K or a threshold is NaN.

    Raises
    ------
    ValueError
        If the shapes differ or a threshold is negative.

    Notes
    -----
    :math:`T = 1 + 3(1 + \\mathrm{sgn}_\\varepsilon H) + (1 - \\mathrm{sgn}_\\varepsilon K)`
    (3.24, 3.25).

    Examples
    --------
    >>> labels = hk_labels([-0.1, -0.1, 0.0], [0.01, 0.0, 0.0], h_zero=0.03, k_zero=0.005)
    >>> [HK_NAMES[label] for label in labels.tolist()]
    ['convex elliptic', 'convex cylindric', 'planar']
    """
    h = as_array("mean", mean, finite=False)
    k = as_array("gaussian", gaussian, finite=False)
    h_limit = as_array("h_zero", h_zero, finite=False)
    k_limit = as_array("k_zero", k_zero, finite=False)
    for name, array in (("gaussian", k), ("h_zero", h_limit), ("k_zero", k_limit)):
        if array.shape != h.shape and not (array.ndim == 0 and name != "gaussian"):
            raise ValueError(f"{name} must have the shape {h.shape} of mean, got {array.shape}")
    for name, limit in (("h_zero", h_limit), ("k_zero", k_limit)):
        if (limit < 0).any():
            raise ValueError(f"{name} must be zero or positive, got {np.nanmin(limit):g}")
    known = ~(np.isnan(h) | np.isnan(k) | np.isnan(h_limit) | np.isnan(k_limit))
    signs = [
        (x > limit).astype(np.int8) - (x < -limit).astype(np.int8)
        for x, limit in ((h, h_limit), (k, k_limit))
    ]
    return np.where(known, 1 + 3 * (1 + signs[0]) + (1 - signs[1]), 0).astype(np.uint8)


def _regions(labels: ArrayLike) -> tuple[NDArray[np.uint8], NDArray[np.intp]]:
    """Check a label image and number its regions from 1; 0 where nothing is labeled."""
    given = as_array("labels", labels, shape=(None, None))
    wrong = (given < 0) | (given > 9) | (given != np.rint(given))
    if wrong.any():
        raise ValueError(f"labels must be 0 to 9 and whole numbers, got {given[wrong][0]:g}")
    types = given.astype(np.uint8)
    return types, connected(types, background=0, connectivity=1)


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
    >>> clean_labels([[5, 5, 5], [5, 2, 5], [5, 5, 5]], smallest=2).tolist()
    [[5, 5, 5], [5, 5, 5], [5, 5, 5]]
    """
    types, regions = _regions(labels)
    area = np.bincount(regions.ravel())
    small = (area < whole("smallest", smallest, least=1))[regions] & (types > 0)
    anchor = ~small & (types > 0)
    if not anchor.any():
        return types
    nearest = ndimage.distance_transform_edt(~anchor, return_distances=False, return_indices=True)
    return np.where(small, types[tuple(nearest)], types)


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
    >>> from microlib.curvature import surface_curvature
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
    rows, cols = np.nonzero(regions)
    pixels = pd.DataFrame(
        {
            "region": regions[rows, cols],
            "label": types[rows, cols],
            "mean": curvature.mean[rows, cols],
            "gaussian": curvature.gaussian[rows, cols],
            "x": cols,
            "y": rows,
        }
    )
    table = pixels.groupby("region").agg(
        label=("label", "first"),
        area=("label", "size"),
        mean=("mean", "mean"),
        gaussian=("gaussian", "mean"),
        x=("x", "mean"),
        y=("y", "mean"),
    )
    table.insert(1, "name", table["label"].map(HK_NAMES))
    return table.sort_values("area", ascending=False, kind="stable").reset_index(drop=True)
