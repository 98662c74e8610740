"""Inner corners of a chessboard: where two edges cross, fitted to grey levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._agreement import agree_with_map
from microlib.calibration._complete import absent_places, predict_places
from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._detection import FEWEST, Detection, find_inliers
from microlib.calibration._grid_map import GridMap, fit_grid_map
from microlib.calibration._grid_order import mean_steps
from microlib.calibration._lattice_form import Form, orient, refuse_gaps
from microlib.calibration._outline_fit import (
    LEAST_BLUR,
    OutlineFit,
    Patches,
    cut_patches,
    fit_outlines,
    smooth_parameters,
)

# Places of the parameters: crossing, directions of the two edges' normals, blur, half the contrast
# and its slopes, mean level and its slopes.
CENTER, ANGLE, BLUR, CONTRAST, LEVEL = slice(0, 2), slice(2, 4), 4, slice(5, 8), slice(8, 11)
# What varies smoothly across the image: directions, blur.
_SMOOTH = [2, 3, 4]
#: Half the width of a patch in sides of a field: the next edges are a whole side away, and their
#: blur and a slant of the board must stay out. At most so many px: more adds little but distortion.
_REACH, _MOST_REACH, _LEAST_REACH = 0.45, 12.0, 3.0
#: A corner lies so near to where it is looked for, in reaches.
_MOST_MOVED = 0.5
#: Least contrast of a corner, in medians: at the rim of a board, where one of four fields is dark,
#: a crossing has half of it.
_LEAST_CONTRAST = 0.75
#: Rings of corners around those between the dark fields that were found.
_RINGS = 8
#: Most angle between a fitted edge and the lattice's step beside it, rad: crossings of chance have
#: any.
_MOST_SLANT = 0.1
_SQUARE = Form("square", np.eye(2))


def chessboard(
    regions: DarkRegions,
    index: NDArray[np.intp],
    grid: NDArray[np.intp],
    direction: float,
    mirrored: bool,
) -> Detection:
    """Inner corners between the dark fields that lie on one of the board's two diagonal lattices.

    Parameters
    ----------
    regions : DarkRegions
        From an image.
    index : ndarray of int, shape (N,)
        The dark fields.
    grid : ndarray of int, shape (N, 2)
        Their coordinates along the diagonals.
    direction, mirrored
        As in :func:`microlib.calibration.detect_squares`.

    Returns
    -------
    Detection
        Positions in sides of a field.

    Raises
    ------
    ValueError
        If the corners are no chessboard's.
    """
    refuse_gaps("dark fields", grid)
    start, cells = _start(regions, index, grid)
    side = float(np.sqrt(np.median(regions.areas[index])))
    reach = float(np.clip(_REACH * side, _LEAST_REACH, _MOST_REACH))
    fit, origins = _fit(regions.image, start, reach)
    inlier = _inliers(fit, origins, regions.image.shape, reach)
    fit, origins, cells = fit[inlier], origins[inlier], cells[inlier]
    for _ in range(_RINGS):
        if len(cells) < FEWEST:
            raise ValueError(
                f"image must show a chessboard, got {len(cells)} corners between dark fields"
            )
        more = _next_ring(fit, origins, cells, regions.image.shape, reach)
        if more is None:
            break
        new, beside = _fit(regions.image, more[0], reach)
        both = OutlineFit(
            np.concatenate([fit.parameters, new.parameters]),
            np.concatenate([fit.covariance, new.covariance]),
            np.concatenate([fit.rms, new.rms]),
        )
        every = np.concatenate([origins, beside])
        inlier = _inliers(both, every, regions.image.shape, reach)
        inlier[: len(cells)] = True
        if inlier.sum() == len(cells):
            break
        fit, origins = both[inlier], every[inlier]
        cells = np.concatenate([cells, more[1]])[inlier]
    fit = smooth_parameters(fit, origins, _SMOOTH)
    points, sigma = fit.parameters[:, CENTER] + origins, _sigma(fit)
    places = orient(points, cells, _SQUARE, "square", direction=direction, mirrored=mirrored)
    refuse_gaps("corners", places)
    flat = places.astype(np.float64)
    to_image = fit_grid_map(points, flat, regions.image.shape)
    _refuse_slant(fit, to_image, flat)
    agreement = agree_with_map(points, flat, to_image, sigma, np.arange(len(points)), middles=flat)
    kept = agreement.kept
    places = places[kept] - places[kept].min(axis=0)
    return Detection(
        points[kept],
        places,
        agreement.sigma[kept],
        np.arange(len(places)),
        places.astype(np.float64),
        1.0,
        agreement.misfit,
    )


def _fit(image: NDArray[np.float32], start: Array, reach: float) -> tuple[OutlineFit, Array]:
    """Crossings from starts in the image's coordinates, and the origins that they count from.

    Of the contrast a start has the sign, of the level nothing.
    """
    patches = cut_patches(
        image, start[:, CENTER], int(np.ceil(reach)), lambda x, y: np.hypot(x, y) <= reach
    )
    start = start.copy()
    start[:, CENTER] -= patches.centers
    seen = np.where(patches.weight > 0, patches.grey, np.nan)
    low, high = np.nanmin(seen, axis=1), np.nanmax(seen, axis=1)
    start[:, CONTRAST.start] = np.sign(start[:, CONTRAST.start]) * (high - low) / 2
    start[:, LEVEL.start] = (high + low) / 2
    return fit_outlines(lambda p: _grey_levels(p, patches), start, patches), patches.centers


def _inliers(
    fit: OutlineFit, origins: Array, shape: tuple[int, ...], reach: float
) -> NDArray[np.bool_]:
    """Crossings that lie in the image, where they were looked for, fitted as well as the others."""
    moved = np.abs(fit.parameters[:, CENTER]).max(axis=1)
    points = fit.parameters[:, CENTER] + origins
    contrast = np.abs(fit.parameters[:, CONTRAST.start])
    good = find_inliers(shape, points - 1, points + 1, fit.rms, contrast, _sigma(fit))
    typical = np.median(contrast[good]) if good.any() else 0.0
    return good & (moved < _MOST_MOVED * reach) & (contrast > _LEAST_CONTRAST * typical)


def _next_ring(
    fit: OutlineFit,
    origins: Array,
    cells: NDArray[np.intp],
    shape: tuple[int, ...],
    reach: float,
) -> tuple[Array, NDArray[np.intp]] | None:
    """Starts at the places beside those found, and these; None where there are none."""
    absent = absent_places(cells)
    places = predict_places(fit.parameters[:, CENTER] + origins, cells, absent)
    limit = np.array(shape[1::-1]) - 1 - reach
    inside = ((places > reach) & (places < limit)).all(axis=1)
    absent, places = absent[inside], places[inside]
    if len(absent) == 0:
        return None
    apart = absent[:, None] - cells
    near = np.linalg.norm(apart, axis=2).argmin(axis=1)
    start = fit.parameters[near].copy()
    start[:, CENTER] = places
    # From corner to corner dark and bright change places.
    start[:, CONTRAST.start] *= 1 - 2 * (np.abs(absent - cells[near]).sum(axis=1) % 2)
    start[:, CONTRAST.start + 1 : CONTRAST.stop] = 0
    start[:, LEVEL] = 0
    return start, absent


def _start(
    regions: DarkRegions, index: NDArray[np.intp], grid: NDArray[np.intp]
) -> tuple[Array, NDArray[np.intp]]:
    """A corner half way between each two dark fields that touch, and its place on the board.

    Fields (m, n) along the diagonals are fields (m − n, m + n) of the board; the corner between
    (m, n) and its neighbor along m is at (m − n, m + n) in corners, that along n at (m − n − 1,
    m + n).
    """
    held = {tuple(cell): k for cell, k in zip(grid.tolist(), index.tolist(), strict=True)}
    places, at, ahead = [], [], []
    for (m, n), k in held.items():
        for (step_m, step_n), place in (((1, 0), (m - n, m + n)), ((0, 1), (m - n - 1, m + n))):
            other = held.get((m + step_m, n + step_n))
            if other is not None:
                places.append(place)
                at.append((regions.centers[k] + regions.centers[other]) / 2)
                ahead.append((step_m, step_n))
    if len(places) < FEWEST:
        raise ValueError(f"image must show a chessboard, got {len(places)} corners of fields")
    diagonals = mean_steps(regions.centers[index], grid)
    sides = np.array([[1.0, -1.0], [1.0, 1.0]]) / 2 @ diagonals
    start = np.zeros((len(places), 11))
    start[:, CENTER] = at
    # The normal of an edge is across its side. Dark is ahead and behind, along the diagonal: there
    # the product of both steps has the sign of that of the normals' parts.
    normals = np.array([[-side[1], side[0]] for side in sides])
    forward = np.array(ahead) @ diagonals
    start[:, ANGLE] = np.arctan2(normals[:, 1], normals[:, 0])
    start[:, CONTRAST.start] = -np.sign((forward @ normals.T).prod(axis=1))
    start[:, BLUR] = regions.blur
    return start, np.array(places, dtype=np.intp)


def _grey_levels(parameters: Array, patches: Patches) -> tuple[Array, Array]:
    """Model of a crossing of two blurred edges, L + C·s₁·s₂ with steps s from −1 to 1, and its
    derivatives."""
    dx, dy = patches.x - parameters[:, :1], patches.y - parameters[:, 1:2]
    blur = np.maximum(np.abs(parameters[:, BLUR, None]), LEAST_BLUR)
    basis = np.stack([np.ones_like(dx), patches.x, patches.y], axis=-1)
    contrast = np.einsum("nkj,nj->nk", basis, parameters[:, CONTRAST])
    level = np.einsum("nkj,nj->nk", basis, parameters[:, LEVEL])
    steps, slopes, distances, normals = [], [], [], []
    for k in (2, 3):
        cos, sin = np.cos(parameters[:, k, None]), np.sin(parameters[:, k, None])
        distance = cos * dx + sin * dy
        z = distance / blur
        steps.append(2 * ndtr(z) - 1)
        slopes.append(2 * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur))
        distances.append(distance)
        normals.append((cos, sin))
    by = [contrast * slopes[0] * steps[1], contrast * slopes[1] * steps[0]]
    jacobian = np.empty((*dx.shape, 11))
    for axis in (0, 1):
        jacobian[..., axis] = -(by[0] * normals[0][axis] + by[1] * normals[1][axis])
    for k, (cos, sin) in enumerate(normals):
        jacobian[..., 2 + k] = by[k] * (cos * dy - sin * dx)
    turned = np.where(parameters[:, BLUR, None] < 0, -1.0, 1.0)  # the model has |blur|
    jacobian[..., BLUR] = -(by[0] * distances[0] + by[1] * distances[1]) / blur * turned
    jacobian[..., CONTRAST] = basis * (steps[0] * steps[1])[..., None]
    jacobian[..., LEVEL] = basis
    return level + contrast * steps[0] * steps[1], jacobian


def _sigma(fit: OutlineFit) -> Array:
    """Standard deviation of a coordinate of each corner, px."""
    return np.sqrt(np.einsum("nii->ni", fit.covariance[:, CENTER, CENTER]).mean(axis=1))


def _refuse_slant(fit: OutlineFit, to_image: GridMap, places: Array) -> None:
    """Refuse corners whose edges do not run along the lattice."""
    steps = to_image.steps(places)
    wanted = np.arctan2(steps[:, 1], steps[:, 0]) + np.pi / 2  # (n, 2), the normals' angles
    found = fit.parameters[:, ANGLE]
    slant = [
        np.abs(np.angle(np.exp(2j * (found[:, order] - wanted)))).max(axis=1) / 2
        for order in ([0, 1], [1, 0])
    ]
    worst = float(np.median(np.minimum(*slant)))
    if worst > _MOST_SLANT:
        raise ValueError(
            "image must show a chessboard, got crossings whose edges run "
            f"{np.rad2deg(worst):.0f}° beside its rows"
        )
