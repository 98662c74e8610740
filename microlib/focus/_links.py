"""What ties two frames of a focal stack together: motion, brightness, and the change of blur.

A frame J of a link is compared with another, I, by the linear model of small differences about
their mean M,

    J − I  ≈  −u·∇M + c(x) M + o + D(x) ∇²M,

with u a similarity, c the logarithm of the gain, o the offset and D half the growth of the blur's
variance. Differences about the mean have no second-order terms (as in ESM, Malis 2004), and blur
grows like heat spreads. All coefficients come from one robust least-squares fit, so that blur is
not taken for motion or gain where its shape is known.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array

__all__ = ["Link", "basis", "fit_link", "laplacian", "motion_columns", "spread_over_stack"]

#: Frames that a link compares: number of the first and of the second.
Link = tuple[int, int]

#: Tukey's constant, for 95 % of the efficiency of least squares, and a Gaussian's standard
#: deviation over its median absolute deviation.
_TUKEY, _GAUSSIAN = 4.685, 1.4826
#: Every how many pixels the spread of the residual is taken: a matter of time.
_SAMPLING = 5
#: Relative damping of the normal equations, above the rounding of float32 sums: a direction that
#: the pixels do not determine stays at rest.
_DAMPING = 1e-6
#: Weight of links over two frames beside those over one: they have twice the change of blur.
LAG_TWO = 0.7


def basis(x: NDArray, y: NDArray) -> NDArray:
    """Return the six quadratic monomials of coordinates, the shape of a gain or a smooth depth."""
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def laplacian(image: NDArray) -> NDArray:
    """Return the five-point Laplacian, per px²."""
    return np.asarray(cv2.Laplacian(image, cv2.CV_32F))


def motion_columns(mean: NDArray, x: NDArray, y: NDArray) -> list[NDArray]:
    """Return what growth, rotation and shift by one would change; x and y in px from the center."""
    dx = cv2.Sobel(mean, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    dy = cv2.Sobel(mean, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    return [-(x * dx + y * dy), y * dx - x * dy, -dx, -dy]


def fit_link(columns: Sequence[NDArray], difference: NDArray, weight: NDArray) -> Array:
    """Return the coefficients of the columns that explain the difference, with Tukey's weights.

    Parameters
    ----------
    columns : sequence of ndarray of float32, shape (rows, cols)
        What the difference may be made of.
    difference : ndarray of float32, shape (rows, cols)
        Second frame less the first.
    weight : ndarray of float32, shape (rows, cols)
        Weight of each pixel, 0 where it is not to count.

    Returns
    -------
    ndarray, shape (len(columns),)
        0 for what the pixels do not determine.
    """
    use = weight.ravel() > 0
    design = np.stack([column.ravel()[use] for column in columns])
    target, given = difference.ravel()[use], weight.ravel()[use]
    found = _solve(design, target, given)
    residual = target - found.astype(np.float32) @ design
    spread = _GAUSSIAN * float(np.median(np.abs(residual[::_SAMPLING]))) if use.any() else 0.0
    if spread == 0:
        return found
    share = residual / np.float32(_TUKEY * spread)
    return _solve(design, target, given * np.maximum(1 - share * share, 0) ** 2)


def _solve(design: NDArray, target: NDArray, weight: NDArray) -> Array:
    weighted = design * weight
    normal = (weighted @ design.T).astype(np.float64)
    right = (weighted @ target).astype(np.float64)
    scale = np.sqrt(np.diagonal(normal))
    scale = np.where(scale > 0, scale, 1.0)
    scaled = normal / np.outer(scale, scale) + _DAMPING * np.eye(len(scale))
    return np.asarray(np.linalg.solve(scaled, right / scale)) / scale


def spread_over_stack(
    count: int, links: Sequence[Link], values: Array, weights: Array, reference: int
) -> Array:
    """Return a value for each frame whose differences are the links', by least squares.

    Parameters
    ----------
    count : int
        Number of frames.
    links : sequence of pairs of int
        Frames i and j of each link.
    values : ndarray, shape (len(links), m)
        Value of frame j less that of frame i.
    weights : ndarray, shape (len(links),)
        Weight of each link; those with 0 do not count, and the others must join all frames.
    reference : int
        Frame whose value is 0.

    Returns
    -------
    ndarray, shape (count, m)

    Examples
    --------
    >>> found = spread_over_stack(3, [(0, 1), (1, 2)], np.array([[1.0], [2.0]]), np.ones(2), 1)
    >>> found.ravel().round(6).tolist()
    [-1.0, 0.0, 2.0]
    """
    normal = np.zeros((count, count))
    right = np.zeros((count, values.shape[1]))
    for (i, j), value, weight in zip(links, values, weights, strict=True):
        normal[[i, j], [i, j]] += weight
        normal[[i, j], [j, i]] -= weight
        right[j] += weight * value
        right[i] -= weight * value
    free = np.arange(count) != reference
    result = np.zeros_like(right)
    result[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free])
    return result
