"""How uncertain is an alignment whose residuals are neither white nor all of the model?"""

from __future__ import annotations

import cv2
import numpy as np

from microlib._common import Array, Image

#: Share of the variance from which on noise counts as white: a Gaussian of 0.28 px, which does not
#: reach the neighboring pixel, leaves all of it.
_WHITE = 0.95

#: Standard deviation (px) of the Gaussian behind which the residuals should be noise.
_BEHIND = 1.5

#: Standard deviation (px) of the surroundings over which the size of the residuals is averaged.
_SURROUNDINGS = 3.5


def sandwich(
    design: Array,
    residual: Array,
    weight: Array,
    slope: Array,
    kept: tuple[float, float],
    shape: tuple[int, int],
    n: int,
) -> Array:
    """Return the covariance of the first `n` parameters of a weighted least-squares fit.

    The residuals are taken as white noise that interpolation and smoothing spread by a Gaussian,
    and as large as they are about each pixel (White 1980, with Huber's correction for weights).

    Parameters
    ----------
    design : ndarray, shape (k, N)
        Derivatives of the residual by the parameters.
    residual, weight : ndarray, shape (N,)
        Residuals and their weights.
    slope : ndarray, shape (N,)
        Derivatives of the weighted residuals by the residuals.
    kept : tuple of float
        Share of the variance of white noise that smoothing and interpolation left of the template's
        and of the image's.
    shape : tuple of int
        Rows and columns of the N pixels.
    n : int
        Parameters wanted; the others are estimated along with them.

    Returns
    -------
    ndarray, shape (n, n)
        NaN where the pixels do not determine them.
    """
    rest = design[n:]
    own = design[:n]
    try:
        weighted = rest * weight
        normal = weighted @ rest.T
        normal.flat[:: len(normal) + 1] += 1e-6 * normal.diagonal() + 1e-3
        own = own - np.linalg.solve(normal, weighted @ own.T).T @ rest
        inverse = np.linalg.inv((own * weight) @ own.T)
    except np.linalg.LinAlgError:
        return np.full((n, n), np.nan)
    efficiency = max(float(slope.sum()), 0.1 * float(weight.sum())) / float(weight.sum())
    size = _local_size(residual.reshape(shape), weight.reshape(shape)).ravel()
    scores = (own * (weight * size)).astype(np.float32).reshape(n, *shape)
    parts = [_spread(scores, share) for share in kept]
    middle = sum(part @ part.T for part in parts).astype(np.float64) / sum(kept)
    alike = _correlated(np.asarray(residual * np.sqrt(weight)).reshape(shape), sum(kept) / 2)
    return alike * inverse @ middle @ inverse / efficiency**2


def _spread(scores: Image, kept: float) -> Image:
    """Return images behind the Gaussian that keeps a share of the variance of white noise, n×N."""
    if kept < _WHITE:
        sigma = 1 / (2 * np.sqrt(np.pi * kept))
        scores = np.stack(
            [cv2.GaussianBlur(s, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT) for s in scores]
        )
    return scores.reshape(len(scores), -1)


def _correlated(residual: Array, kept: float) -> float:
    """Return by what factor a blur leaves more of the residuals than of noise, at least 1.

    White noise behind a Gaussian of variance s has a variance in proportion to 1/s.
    """
    spread = 1 / (2 * np.sqrt(np.pi * kept))
    blurred = cv2.GaussianBlur(np.asarray(residual, np.float32), (0, 0), _BEHIND)
    total = spread**2 / (spread**2 + _BEHIND**2) * float(np.mean(residual**2))
    return max(float(np.mean(blurred**2)) / total, 1.0) if total > 0 else 1.0


def _local_size(residual: Array, weight: Array) -> Array:
    """Return the root mean square residual about each pixel."""
    square = np.asarray(weight * residual**2, np.float32)
    counts = cv2.GaussianBlur(np.asarray(weight, np.float32), (0, 0), _SURROUNDINGS)
    total = cv2.GaussianBlur(square, (0, 0), _SURROUNDINGS)
    return np.sqrt(total / np.maximum(counts, 1e-6))


def corner_jacobian(pose: Array, basis: Array, corners: Array) -> Array:
    """Return the derivatives of the mapped corners by the motion, shape (n, 8)."""
    points = np.column_stack([corners, np.ones(len(corners))])
    mapped = points @ pose.T
    velocity = np.einsum("ij,njk,ck->nci", pose, basis, points)
    depth = mapped[:, 2:]
    slope = (velocity[..., :2] - mapped[:, :2] / depth * velocity[..., 2:]) / depth
    return slope.reshape(len(basis), -1)


def kept_between(points: Array) -> float:
    """Return the share of the variance of white noise that is left between the pixels.

    The image is interpolated linearly between half pixels (`half_pixel`); the mean of N×2 points.
    """
    part = 2 * np.abs(points - np.rint(points))  # from a pixel, 0, to the middle of two, 1
    taps = np.array([3, -25, 150, 150, -25, 3]) / 256
    kept = (1 - part) ** 2 + part**2 * float(taps @ taps) + 2 * part * (1 - part) * taps[2]
    return float(kept.prod(axis=1).mean())


def lag_between(points: Array) -> Array:
    """Return by how much linear interpolation between half pixels moves a pattern, (x, y).

    In px times the square of the pattern's frequency in rad/px: at the share u between two samples
    that are ½ px apart, the phase of a wave of frequency ω is wrong by u(1 − u)(1 − 2u)(ω/2)³/6 to
    the lowest order. The mean of N×2 points.
    """
    part = 2 * points - np.floor(2 * points)
    return (part * (1 - part) * (1 - 2 * part)).mean(axis=0) / 48


def squared_frequency(gradient: Array) -> Array:
    """Return the mean square frequency (rad/px) along x and y of a gradient (2×H×W)."""
    bends = [np.gradient(gradient[k], axis=1 - k) for k in range(2)]
    return np.array([np.mean(b**2) for b in bends]) / np.mean(gradient**2, axis=(1, 2))
