"""Groups of warps, and their effect on points, corners and areas.

A warp is a matrix on homogeneous coordinates. A step x takes it to ``G exp(Σ xᵢ Bᵢ)`` with the
generators Bᵢ of its group: translation, affine, or the homographies through sl(3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array

_E = np.eye(9).reshape(3, 3, 3, 3)
#: Group of warps to its generators, n×3×3; those of the homographies have no trace.
GENERATORS: dict[str, Array] = {
    "translation": _E[[0, 1], [2, 2]],
    "affine": _E[[0, 1, 0, 0, 1, 1], [2, 2, 0, 1, 0, 1]],
    "homography": np.concatenate(
        [
            _E[[0, 1, 0, 1, 2, 2], [2, 2, 1, 0, 0, 1]],
            [_E[0, 0] - _E[1, 1], _E[2, 2] - _E[1, 1]],
        ]
    ),
}

#: Avoids divisions by zero.
TINY = 1e-9

#: Relative size below which a sum in single precision is rounding.
ROUNDING = 1e-6


def apply_homography(matrix: Array, points: Array) -> Array:
    """Map N×2 points by a homography, 3×3, or by several, …×3×3."""
    mapped = points @ np.swapaxes(matrix[..., :2], -1, -2) + matrix[..., None, :, 2]
    return mapped[..., :2] / mapped[..., 2:]


def retract(warp: Array, step: Array, basis: Array) -> Array:
    """Return the retraction ``warp exp(Σ stepₖ basisₖ)``; NaN if a step is huge or not finite.

    Several warps, …×3×3, and steps, …×n, are retracted at once.
    """
    matrix = (step @ basis.reshape(len(basis), 9)).reshape(*step.shape[:-1], 3, 3)
    good = np.abs(matrix).max(axis=(-2, -1), keepdims=True) < 100  # not for NaN
    return np.where(good, warp @ _exponential(np.where(good, matrix, 0.0)), np.nan)


def advance(
    pose: Array, step: Array, start: Array, basis: Array, corners: Array
) -> tuple[Array, float]:
    """Return the retraction of a pose by a step of a minimization, and how far its corners moved.

    The distance is the largest change of a coordinate of the corners, px. It is NaN if the new pose
    is degenerate beside the pose `start`, where the minimization began.
    """
    after = retract(pose, step, basis)
    first, before, last = apply_homography(np.array([start, pose, after]), corners)
    distance = np.nan if degenerate(last, first) else float(np.abs(last - before).max())
    return after, distance


def _exponential(matrix: Array) -> Array:
    """Return the exponential of 3×3 matrices by scaling, a Taylor series and squaring.

    scipy.linalg.expm calls the BLAS of SciPy, whose threads and those of NumPy's BLAS wait for one
    another: a frame then takes twenty times as long.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.linalg import expm
    >>> from microlib.tracking._geometry import _exponential
    >>> for size in (1e-3, 0.3, 3.0):
    ...     matrices = np.random.default_rng(0).normal(0, size, (20, 3, 3))
    ...     truth = np.array([expm(matrix) for matrix in matrices])
    ...     assert np.abs(_exponential(matrices) - truth).max() < 1e-12 * np.abs(truth).max()
    """
    norm = 3 * float(np.abs(matrix).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(16 * norm, 1.0)))))
    one, scaled = np.eye(3), matrix / 2.0**halvings
    total = one
    for order in range(7, 0, -1):  # the next term is below 16⁻⁸/8! = 6e-15
        total = one + scaled @ total / order
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def translate(pose: Array, by: Array) -> Array:
    """Return the pose followed by a translation of the image."""
    shift = np.eye(3)
    shift[:2, 2] = by
    return shift @ pose


def area(corners: Array) -> Array:
    """Return the signed area of a quadrilateral, or of several, …×4×2."""
    across, back = corners[..., 2, :] - corners[..., 0, :], corners[..., 3, :] - corners[..., 1, :]
    return (across[..., 0] * back[..., 1] - across[..., 1] * back[..., 0]) / 2


def degenerate(corners: Array, first: Array) -> NDArray[np.bool_]:
    """Return whether a warp turned the template over, or changed its area more than 4-fold."""
    ratio = area(corners) / area(first)
    return ~((ratio > 1 / 4) & (ratio < 4))  # also for NaN


def cut_around(image: NDArray, corners: Array, margin: float) -> tuple[NDArray, Array]:
    """Return the part of an image around some corners and where its first pixel was, (x, y)."""
    size = np.array(image.shape[1::-1])
    first = np.clip(np.floor(corners.min(axis=0) - margin), 0, size).astype(int)
    last = np.clip(np.ceil(corners.max(axis=0) + margin) + 1, 0, size).astype(int)
    return image[first[1] : last[1], first[0] : last[0]], first.astype(np.float64)


def corner_jacobian(pose: Array, basis: Array, corners: Array) -> Array:
    """Return the derivatives of the mapped corners by the motion, shape (n, 8)."""
    points = np.column_stack([corners, np.ones(len(corners))])
    mapped = points @ pose.T
    velocity = np.einsum("ij,njk,ck->nci", pose, basis, points)
    depth = mapped[:, 2:]
    slope = (velocity[..., :2] - mapped[:, :2] / depth * velocity[..., 2:]) / depth
    return slope.reshape(len(basis), -1)
