"""Inner corners of a chessboard: found by OpenCV, then two crossing edges fitted to grey levels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._marks import START_BLUR
from microlib.calibration._outlines import (
    LEAST_BLUR,
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
#: Least board that is looked for, in corners; larger ones are found with it.
_LEAST_BOARD = (3, 3)
_FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_LARGER


def find_crossings(grey: NDArray[np.float32]) -> tuple[Array, Array, NDArray[np.intp]]:
    """Corners of the largest board (n, 2), their σ (n,) and their grid (n, 2).

    Raises
    ------
    ValueError
        If the image shows no chessboard of at least three by three corners.
    """
    eight = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    for each in (eight, 255 - eight):
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(each, _LEAST_BOARD, _FLAGS)
        if found:
            break
    else:
        raise ValueError("image must show a chessboard, got none")
    rows, columns = np.asarray(meta).shape
    board: Array = np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2)
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    along = np.stack([np.gradient(board, axis=axis) for axis in (1, 0)], axis=-1).reshape(
        -1, 2, 2
    )  # columns: steps
    board = board.reshape(-1, 2)
    side = np.sqrt(np.median(np.abs(np.linalg.det(along))))
    reach = float(np.clip(_REACH * side, _LEAST_REACH, _MOST_REACH))
    patches = cut_patches(grey, board, int(np.ceil(reach)), lambda x, y: np.hypot(x, y) <= reach)
    start = np.zeros((len(board), 11))
    start[:, _CENTER] = board - patches.centers
    # The normals of both edges, each across the side of a field.
    angle = np.arctan2(along[:, 1], along[:, 0]) + np.pi / 2
    start[:, _ANGLE] = angle[0] + np.angle(np.exp(1j * (angle - angle[0])))  # of one branch
    start[:, _BLUR] = START_BLUR
    seen = np.where(patches.weight > 0, patches.grey, np.nan)
    low, high = np.nanmin(seen, axis=1), np.nanmax(seen, axis=1)
    steps, _ = _steps(start, patches)
    product = np.where(patches.weight > 0, steps[0] * steps[1], 0.0)
    sign = np.sign((product * (patches.grey - (low + high)[:, None] / 2)).sum(axis=1))
    start[:, _CONTRAST.start] = sign * (high - low) / 2
    start[:, _LEVEL.start] = (high + low) / 2
    fit = fit_outlines(_grey_levels, start, patches)
    points = fit.parameters[:, _CENTER] + patches.centers
    sigma = np.sqrt(np.einsum("nii->ni", fit.covariance[:, _CENTER, _CENTER]).mean(axis=1))
    contrast = np.abs(fit.parameters[:, _CONTRAST.start])
    good = find_inliers(grey.shape, points - 1, points + 1, fit.rms, contrast, sigma)
    good &= np.abs(points - board).max(axis=1) < reach / 2
    if good.sum() < 4:
        raise ValueError(f"image must show a chessboard, got {int(good.sum())} corners of one")
    fit, origins = (
        smooth_parameters(fit[good], patches.centers[good], _SMOOTH),
        patches.centers[good],
    )
    sigma = np.sqrt(np.einsum("nii->ni", fit.covariance[:, _CENTER, _CENTER]).mean(axis=1))
    return fit.parameters[:, _CENTER] + origins, sigma, grid[good]


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
