"""Inner corners of a chessboard: found by OpenCV, then two crossing edges fitted to grey levels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._detection import FEWEST
from microlib.calibration._grid_map import fit_grid_map
from microlib.calibration._lattice import absent_places, mean_steps
from microlib.calibration._marks import START_BLUR
from microlib.calibration._outlines import (
    LEAST_BLUR,
    OutlineFit,
    Patches,
    cut_patches,
    find_inliers,
    fit_outlines,
    smooth_parameters,
)

# Places of the parameters: crossing, directions of the two edges' normals, blur, half the contrast
# and its slopes, mean level and its slopes.
_CENTER, _ANGLE, _BLUR, _CONTRAST, _LEVEL = (
    slice(0, 2), slice(2, 4), 4, slice(5, 8), slice(8, 11)
)  # fmt: skip
# What varies smoothly across the image: directions, blur.
_SMOOTH = [2, 3, 4]
#: Half the width of a patch in sides of a field: the next edges are a whole side away, and their
#: blur and a slant of the board must stay out. At most so many px: more adds little but distortion.
_REACH, _MOST_REACH, _LEAST_REACH = 0.45, 12.0, 3.0
#: Boards that OpenCV is asked for, in corners; a part of one is enough, and larger ones are found
#: with it.
_BOARDS = ((4, 4), (3, 3))
_FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_LARGER
#: Rings of corners around those that OpenCV finds.
_RINGS = 8
#: A corner lies so near to where it is looked for, in reaches; and its least contrast, in medians:
#: at the rim of a board, where one of four fields is dark, a crossing has half of it.
_MOST_MOVED, _LEAST_CONTRAST = 0.5, 0.75


def find_crossings(grey: NDArray[np.float32]) -> tuple[Array, Array, NDArray[np.intp]]:
    """Corners of a board (n, 2), their σ (n,) and their grid (n, 2).

    Raises
    ------
    ValueError
        If the image shows no chessboard of at least three by three corners.
    """
    board, grid = _seed(grey)
    for part in (0.5, 1.0):  # OpenCV may skip every second row: the steps are not known at first
        steps = mean_steps(board, grid)
        side = float(np.sqrt(np.abs(np.linalg.det(steps))))
        reach = float(np.clip(part * _REACH * side, _LEAST_REACH, _MOST_REACH))
        start = np.zeros((len(board), 11))
        start[:, _CENTER] = board
        # The normals, across the fields' sides.
        start[:, _ANGLE] = np.arctan2(steps[:, 1], steps[:, 0]) + np.pi / 2
        start[:, _BLUR] = START_BLUR
        fit, good = _fit(grey, start, reach)
        fit, grid = fit[good], grid[good]
        if len(grid) < FEWEST:
            raise ValueError(f"image must show a chessboard, got {len(grid)} corners of one")
        # From corner to corner dark and bright change places.
        board, sign = fit.parameters[:, _CENTER], np.sign(fit.parameters[:, _CONTRAST.start])
        changes = max(
            np.ndindex(2, 2), key=lambda c: abs((sign * (-1.0) ** (grid @ np.array(c))).sum())
        )
        grid = grid * (2 - np.array(changes)) if part < 1 else grid
    for _ in range(_RINGS):
        absent = absent_places(grid)
        flat, middle = grid.astype(np.float64), np.zeros((1, 2))
        to_image, _ = fit_grid_map(fit.parameters[:, None, _CENTER], flat, middle, grey.shape)
        near = np.linalg.norm(absent[:, None] - grid, axis=2).argmin(axis=1)
        start = fit.parameters[near].copy()
        start[:, _CENTER] = to_image(absent.astype(np.float64))
        limit = np.array(grey.shape[::-1]) - 1 - reach
        inside = ((start[:, _CENTER] > reach) & (start[:, _CENTER] < limit)).all(axis=1)
        if not inside.any():
            break
        new, good = _fit(grey, start[inside], reach, like=fit)
        if not good.any():
            break
        each = (
            (getattr(a, n) for a in (fit, new[good])) for n in ("parameters", "covariance", "rms")
        )
        fit = OutlineFit(*(np.concatenate(list(both)) for both in each))
        grid = np.concatenate([grid, absent[inside][good]])
    fit = smooth_parameters(fit, fit.parameters[:, _CENTER], _SMOOTH)
    return fit.parameters[:, _CENTER], _sigma(fit), grid


def _seed(grey: NDArray[np.float32]) -> tuple[Array, NDArray[np.intp]]:
    """Corners as OpenCV finds them, and their grid."""
    low, high = float(grey.min()), float(grey.max())
    eight = np.round((grey - low) * (255 / max(high - low, 1e-9)))
    for size in _BOARDS:
        for each in (eight.astype(np.uint8), (255 - eight).astype(np.uint8)):
            found, corners, meta = cv2.findChessboardCornersSBWithMeta(each, size, _FLAGS)
            if found:
                rows, columns = np.asarray(meta).shape
                grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
                board: Array = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
                return board, grid.reshape(-1, 2)
    raise ValueError("image must show a chessboard, got none")


def _fit(
    grey: NDArray[np.float32], start: Array, reach: float, like: OutlineFit | None = None
) -> tuple[OutlineFit, NDArray[np.bool_]]:
    """Crossings in the image's coordinates, and which of them lie in the image, where they were
    looked for, fitted as well as the others, or as those that they should be like."""
    half = int(np.ceil(reach))
    patches = cut_patches(grey, start[:, _CENTER], half, lambda x, y: np.hypot(x, y) <= reach)
    start = start.copy()
    start[:, _CENTER] -= patches.centers
    seen = np.where(patches.weight > 0, patches.grey, np.nan)
    low, high = np.nanmin(seen, axis=1), np.nanmax(seen, axis=1)
    first, second = _steps(start, patches)[0]
    dark = first * second * (patches.grey - (low + high)[:, None] / 2) * patches.weight
    start[:, _CONTRAST] = start[:, _LEVEL] = 0
    start[:, _CONTRAST.start] = np.sign(dark.sum(axis=1)) * (high - low) / 2
    start[:, _LEVEL.start] = (high + low) / 2
    fit = fit_outlines(_grey_levels, start, patches)
    moved = np.abs(fit.parameters[:, _CENTER] - start[:, _CENTER]).max(axis=1)
    fit.parameters[:, _CENTER] += patches.centers
    places = fit.parameters[:, _CENTER]
    of = [(f.rms, np.abs(f.parameters[:, _CONTRAST.start]), _sigma(f)) for f in (fit, like or fit)]
    inside = np.full((len(like.rms), 2), half) if like else places
    rms, contrast, sigma = (np.concatenate(pair) for pair in zip(*of, strict=True))
    both = np.concatenate([places, inside])
    good = find_inliers(grey.shape, both - 1, both + 1, rms, contrast, sigma)
    typical = np.median(contrast[good]) if good.any() else 0.0
    good &= contrast > _LEAST_CONTRAST * typical
    return fit, good[: len(places)] & (moved < _MOST_MOVED * reach)


def _sigma(fit: OutlineFit) -> Array:
    """Standard deviation of a coordinate of each corner, px."""
    return np.sqrt(np.einsum("nii->ni", fit.covariance[:, _CENTER, _CENTER]).mean(axis=1))


def _steps(parameters: Array, patches: Patches) -> tuple[list[Array], list[tuple[Array, ...]]]:
    """Both steps from −1 to 1 across the edges; and slope, distance and normal of each."""
    dx, dy = patches.x - parameters[:, :1], patches.y - parameters[:, 1:2]
    blur = np.maximum(np.abs(parameters[:, _BLUR, None]), LEAST_BLUR)
    steps: list[Array] = []
    edges: list[tuple[Array, ...]] = []
    for k in (2, 3):
        cos, sin = np.cos(parameters[:, k, None]), np.sin(parameters[:, k, None])
        z = (cos * dx + sin * dy) / blur
        steps.append(2 * ndtr(z) - 1)
        slope = 2 * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
        edges.append((slope, z, cos, sin, cos * dy - sin * dx))
    return steps, edges


def _grey_levels(parameters: Array, patches: Patches) -> tuple[Array, Array]:
    """Model of a crossing of two blurred edges, L + C·s₁·s₂ with steps s from −1 to 1, and its
    derivatives."""
    basis = np.stack([np.ones_like(patches.x), patches.x, patches.y], axis=-1)
    contrast = np.einsum("nkj,nj->nk", basis, parameters[:, _CONTRAST])
    level = np.einsum("nkj,nj->nk", basis, parameters[:, _LEVEL])
    steps, edges = _steps(parameters, patches)
    jacobian = np.zeros((*patches.x.shape, 11))
    turned = np.where(parameters[:, _BLUR, None] < 0, -1.0, 1.0)  # the model has |blur|
    for k, (slope, z, cos, sin, turning) in enumerate(edges):
        by = contrast * slope * steps[1 - k]
        jacobian[..., 0] -= by * cos
        jacobian[..., 1] -= by * sin
        jacobian[..., 2 + k] = by * turning
        jacobian[..., _BLUR] -= by * z * turned
    jacobian[..., _CONTRAST] = basis * (steps[0] * steps[1])[..., None]
    jacobian[..., _LEVEL] = basis
    return level + contrast * steps[0] * steps[1], jacobian
