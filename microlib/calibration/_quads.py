"""Blurred dark quadrilaterals: their grey levels, and the fit of many of them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._detection import band_half_width
from microlib.calibration._neighbors import fit_among_neighbors
from microlib.calibration._outline_fit import (
    LEAST_BLUR,
    START_CONTRAST,
    OutlineFit,
    Patches,
    cut_patches,
    ground,
)

# Places of the parameters: directions of the four outward normals, distances of the lines from the
# patch's origin along them, blur, contrast, ground.
ANGLE, OFFSET, BLUR, CONTRAST, GROUND = slice(0, 4), slice(4, 8), 8, 9, slice(10, 13)
#: Reach of the window of Sobel edges around a square's center, in sides: half a diagonal is 0.71;
#: and two pixels more for the blur.
_WINDOW, _WINDOW_MARGIN = 0.75, 2
#: Least gradient of an edge pixel, as a part of the greatest; from 0.15 to 0.5 the
#: points' error varies by 1 %.
_LEAST_GRADIENT = 0.3
#: Edge pixels are linked to a side if the cosine of their direction to it exceeds this (26°);
#: from 0.8 to 0.97 the points' error varies by 1 %.
_LIKE_DIRECTION = 0.9
#: Sine of the angle below which two lines are parallel.
_PARALLEL = 1e-9
#: Half the side of a patch in sides, without the band: half a diagonal and a tenth for the tilt.
_HALF_SIDE = 0.8


def fit_quads(regions: DarkRegions, index: NDArray[np.intp]) -> tuple[OutlineFit, Patches]:
    """Fit four lines to each of the chosen regions; also the pixels that they were fitted to."""
    start = _start(regions, index)
    patches = _patches(regions.image, regions.centers[index], start)
    return fit_among_neighbors(_grey_levels, start, patches, GROUND), patches


def untangle(fit: OutlineFit) -> OutlineFit:
    """Order the four lines of every square alike and count their angles from one branch."""
    angle = fit.parameters[:, ANGLE]
    first = np.angle(np.exp(4j * angle).mean()) / 4
    turn = np.round((angle - first) / (np.pi / 2)).astype(int)
    order = np.argsort(turn % 4, axis=1)
    parameters, covariance = fit.parameters.copy(), fit.covariance.copy()
    parameters[:, ANGLE] = angle - np.pi / 2 * (turn - turn % 4)
    places = np.concatenate([order, order + 4, np.tile(np.arange(8, 13), (len(order), 1))], axis=1)
    parameters = np.take_along_axis(parameters, places, axis=1)
    covariance = np.take_along_axis(covariance, places[:, :, None], axis=1)
    covariance = np.take_along_axis(covariance, places[:, None, :], axis=2)
    return OutlineFit(parameters, covariance, fit.rms)


def quad_corners(fit: OutlineFit, origins: Array) -> tuple[Array, Array]:
    """Intersections of consecutive lines, (n, 4, 2), and the standard deviation of a coordinate,
    (n, 4), px."""
    angle, offset = fit.parameters[:, ANGLE], fit.parameters[:, OFFSET]
    corners, sigma = np.empty((len(angle), 4, 2)), np.empty((len(angle), 4))
    for k in range(4):
        pair = [k, (k + 1) % 4]
        cos, sin = np.cos(angle[:, pair]), np.sin(angle[:, pair])
        inverse = _inverse(np.stack([cos, sin], axis=-1))
        corners[:, k] = np.einsum("nij,nj->ni", inverse, offset[:, pair])
        # Turning a line by dθ moves it at the corner by (sin θ x − cos θ y) dθ along its normal.
        slide = sin * corners[:, k, :1] - cos * corners[:, k, 1:]
        by = np.concatenate([inverse * slide[:, None], inverse], axis=-1)
        places = [*pair, *(4 + np.array(pair))]
        part = fit.covariance[:, places][:, :, places]
        sigma[:, k] = np.sqrt(np.einsum("nij,njk,nik->n", by, part, by) / 2)
    return corners + origins[:, None], sigma


def _inverse(matrices: Array) -> Array:
    """Inverse of 2×2 matrices; NaN where two lines are parallel."""
    (a, b), (c, d) = np.moveaxis(matrices, (1, 2), (0, 1))
    det = a * d - b * c
    det = np.where(np.abs(det) > _PARALLEL, det, np.nan)
    return np.moveaxis(np.array([[d, -b], [-c, a]]) / det, (0, 1), (1, 2))


def _start(regions: DarkRegions, index: NDArray[np.intp]) -> Array:
    """Sobel edges around each square, linked by place and direction, and a line through each of the
    four links."""
    gx = cv2.Sobel(regions.smooth, cv2.CV_32F, 1, 0, ksize=3)
    gy = cv2.Sobel(regions.smooth, cv2.CV_32F, 0, 1, ksize=3)
    start = np.zeros((len(index), 13))
    start[:, BLUR], start[:, CONTRAST] = regions.blur, START_CONTRAST
    sides = np.sqrt(regions.areas[index])
    for out, center, side in zip(start, regions.centers[index], sides, strict=True):
        lines = _sobel_lines(gx, gy, center, side)
        out[ANGLE], out[OFFSET] = lines
    return start


def _sobel_lines(gx: NDArray, gy: NDArray, center: Array, side: float) -> tuple[Array, Array]:
    """Outward normals' angles and distances from the rounded center of the four lines of one
    square."""
    origin = np.round(center).astype(int)
    half = int(np.ceil(_WINDOW * side)) + _WINDOW_MARGIN
    rows = slice(max(origin[1] - half, 0), origin[1] + half + 1)
    columns = slice(max(origin[0] - half, 0), origin[0] + half + 1)
    row, column = np.mgrid[rows, columns][:, : gx[rows].shape[0], : gx[:, columns].shape[1]]
    x, y = column - origin[0], row - origin[1]
    u, v = gx[rows, columns], gy[rows, columns]
    magnitude = np.hypot(u, v)
    # An edge pixel of this square has its gradient pointing away from it; its neighbors' point
    # back.
    strong = (
        (magnitude > _LEAST_GRADIENT * magnitude.max())
        & (u * x + v * y > 0)
        & (np.hypot(x, y) < side)
    )
    x, y, u, v, weight = x[strong], y[strong], u[strong], v[strong], magnitude[strong] ** 2
    # The four directions are one direction when their angle is taken four times.
    first = np.angle((weight * np.exp(4j * np.arctan2(v, u))).sum()) / 4
    angles, offsets = first + np.arange(4) * np.pi / 2, np.empty(4)
    for k, angle in enumerate(angles.copy()):
        along = np.cos(angle) * u + np.sin(angle) * v
        link = along > _LIKE_DIRECTION * np.hypot(u, v)
        if link.sum() < 3:  # no line; the fit to the grey levels decides
            offsets[k] = side / 2
            continue
        w, points = weight[link], np.column_stack([x, y])[link].astype(np.float64)
        middle = w @ points / w.sum()
        spread = (points - middle).T @ (w[:, None] * (points - middle))
        normal = np.linalg.eigh(spread)[1][:, 0]
        normal = normal if normal @ [np.cos(angle), np.sin(angle)] > 0 else -normal
        angles[k] = np.arctan2(normal[1], normal[0])
        offsets[k] = normal @ middle
    return angles, offsets


def _patches(image: NDArray[np.float32], centers: Array, start: Array) -> Patches:
    """Pixels in a band around each outline."""
    side = float(np.median(start[:, OFFSET].sum(axis=1)) / 2)
    margin = band_half_width(centers, side / 2)

    def near(x: Array, y: Array) -> NDArray[np.bool_]:
        return np.abs(_distances(start, x, y).min(axis=-1)) <= margin

    patches = cut_patches(image, centers, int(np.ceil(side * _HALF_SIDE + margin)), near)
    start[:, GROUND.start] = patches.grey.max(axis=1)
    return patches


def _distances(parameters: Array, x: Array, y: Array) -> Array:
    """Distances to the four lines, positive inside, (n, k, 4), px."""
    angle = parameters[:, None, ANGLE]
    across = np.cos(angle) * x[..., None] + np.sin(angle) * y[..., None]
    return parameters[:, None, OFFSET] - across


def _grey_levels(parameters: Array, patches: Patches) -> tuple[Array, Array]:
    """Model of a blurred dark quadrilateral, and its derivatives."""
    x, y = patches.x, patches.y
    blur = np.maximum(np.abs(parameters[:, BLUR, None, None]), LEAST_BLUR)
    contrast = parameters[:, CONTRAST, None]
    light, by_light = ground(patches, parameters[:, GROUND])
    z = _distances(parameters, x, y) / blur
    steps = ndtr(z)
    a, b, c, d = np.moveaxis(steps, -1, 0)
    inside = a * b * c * d
    others = np.stack([b * c * d, a * c * d, a * b * d, a * b * c], axis=-1)
    by_distance = others * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
    angle = parameters[:, None, ANGLE]
    turning = np.sin(angle) * x[..., None] - np.cos(angle) * y[..., None]
    jacobian = np.empty((*x.shape, 13))
    scale = -(light * contrast)[..., None]
    jacobian[..., ANGLE] = scale * by_distance * turning
    jacobian[..., OFFSET] = scale * by_distance
    turned = np.where(parameters[:, BLUR, None] < 0, -1.0, 1.0)  # the model has |blur|
    jacobian[..., BLUR] = -(scale * by_distance * z).sum(axis=-1) * turned
    jacobian[..., CONTRAST] = -light * inside
    jacobian[..., GROUND] = by_light * (1 - contrast * inside)[..., None]
    return light * (1 - contrast * inside), jacobian
