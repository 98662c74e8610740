"""Marks that a lattice lacks although the image shows them, and what lies between them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._grid_order import mean_steps

#: Least contrast of a place that is taken for a mark, as a part of the median of those found.
_LEAST_CONTRAST = 0.5
#: Half the width of a mark in standard deviations of its area: 2 for a circle, √3 for the side of a
#: square, √6 for its diagonal.
_HALF_WIDTH = 2.0
#: The quadratic map has six coefficients for each coordinate; it is used with twice as many marks.
_FEWEST_FOR_MAP = 12
#: Rings around the lattice that are looked at, one after the other.
_RINGS = 4
#: Places half a step from a mark, across and along the axes.
_ACROSS = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, 0.5], [-0.5, -0.5]])
_ALONG = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
#: Least ratio of the ground's contrast along and across: 1 but for blur and light, a half between
#: the fields of a chessboard.
_LEAST_ALIKE = 0.75
#: With more blur than this part of a mark's half-width its neighbors shade the places between.
SHARP = 0.3


def complete(
    regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
) -> tuple[DarkRegions, NDArray[np.intp], NDArray[np.intp]]:
    """Add the marks that the image shows where the lattice would have them.

    Parameters
    ----------
    regions : DarkRegions
        From an image.
    index : ndarray of int, shape (N,)
        Those that lie on a lattice.
    grid : ndarray of int, shape (N, 2)
        Their coordinates.

    Returns
    -------
    regions, index, grid
        With the added marks at the end; the same objects where nothing is added.
    """
    for _ in range(_RINGS):
        centers = regions.centers[index]
        absent = absent_places(grid)
        if len(absent) == 0:
            break
        places = predict_places(centers, grid, absent)
        near = np.linalg.norm(absent[:, None] - grid, axis=2).argmin(axis=1)
        moments = regions.moments[index][near]
        reach = _HALF_WIDTH * np.sqrt(np.einsum("nii->ni", moments)) + 1
        height, width = regions.image.shape
        inside = ((places > reach) & (places < np.array([width, height]) - 1 - reach)).all(axis=1)
        new = np.flatnonzero(inside)
        if len(new) == 0:
            break
        steps = mean_steps(centers, grid)
        least = _LEAST_CONTRAST * np.median(_contrast(regions.smooth, centers, steps))
        new = new[_contrast(regions.smooth, places[new], steps) > least]
        if len(new) == 0:
            break
        first = len(regions.centers)
        regions = replace(
            regions,
            centers=np.concatenate([regions.centers, places[new]]),
            moments=np.concatenate([regions.moments, moments[new]]),
            areas=np.concatenate([regions.areas, regions.areas[index][near[new]]]),
        )
        index = np.concatenate([index, first + np.arange(len(new))])
        grid = np.concatenate([grid, absent[new]])
    return regions, index, grid


def absent_places(grid: NDArray[np.intp]) -> NDArray[np.intp]:
    """Places beside a mark, along one of the axes, that hold none."""
    held = set(map(tuple, grid.tolist()))
    beside = (grid[:, None] + [[1, 0], [-1, 0], [0, 1], [0, -1]]).reshape(-1, 2)
    return np.array(sorted(set(map(tuple, beside.tolist())) - held), dtype=np.intp)


def predict_places(centers: Array, grid: NDArray[np.intp], places: NDArray[np.intp]) -> Array:
    """Where the lattice's places would be seen: a homography, and a quadratic that bends it."""
    flat = grid.astype(np.float64)
    homography, _ = cv2.findHomography(flat, centers)
    if homography is None:
        return np.full(places.shape, np.nan)

    def through(points: Array) -> Array:
        seen: Array = cv2.perspectiveTransform(points[None], homography)[0]
        return seen

    wanted = places.astype(np.float64)
    predicted = through(wanted)
    if len(grid) >= _FEWEST_FOR_MAP:
        left = centers - through(flat)
        bend = np.linalg.lstsq(_quadratic(flat, flat), left, rcond=None)[0]
        predicted = predicted + _quadratic(wanted, flat) @ bend
    return predicted


def _quadratic(points: Array, like: Array) -> Array:
    x, y = ((points - like.mean(axis=0)) / np.ptp(like)).T
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def refuse_fields(
    marks: str, regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
) -> None:
    """Refuse marks between which there is more than ground: fields of a chessboard, or a part of a
    finer lattice.

    Parameters
    ----------
    marks : str
        What the lattice is said to be of.
    regions : DarkRegions
        From an image.
    index : ndarray of int, shape (N,)
        Those that lie on the lattice.
    grid : ndarray of int, shape (N, 2)
        Their coordinates.

    Raises
    ------
    ValueError
        If the grey levels half a step away along the axes and across differ.
    """
    centers = regions.centers[index]
    steps = mean_steps(centers, grid)
    middle = _levels(regions.smooth, centers)
    across, along = (
        float(np.median(_levels(regions.smooth, centers[:, None] + half @ steps) - middle[:, None]))
        for half in (_ACROSS, _ALONG)
    )
    if min(across, along) < _LEAST_ALIKE * max(across, along):
        raise ValueError(
            f"image must show {marks} apart from each other, got fields of a chessboard or marks "
            "between them"
        )


def _contrast(smooth: NDArray, centers: Array, steps: Array) -> Array:
    """Grey levels half a step away on all four sides across, less that in the middle."""
    around = centers[:, None] + _ACROSS @ steps
    return _levels(smooth, around).min(axis=1) - _levels(smooth, centers)


def _levels(smooth: NDArray, points: Array) -> Array:
    height, width = smooth.shape
    column, row = np.moveaxis(np.round(points).astype(int), -1, 0)
    levels: Array = smooth[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return levels
