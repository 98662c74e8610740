"""How uncertain is an alignment whose residuals are neither white nor all of the model?"""

from __future__ import annotations

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._esm import Alignment, Level
from microlib.tracking._geometry import corner_jacobian
from microlib.tracking.robust._normal_equations import gram, ridged

#: Standard deviation (px) of the Gaussian behind which the residuals should be noise.
_BEHIND = 1.5


def corner_covariance(
    level: Level, fit: Alignment, slope: Image, kept: float = 1.0, factor: float = 1.0
) -> Array:
    """Return the covariance of the corners (8: x, y of each), px² of the frame.

    Parameters
    ----------
    level : Level
        A template that is sampled at half pixels.
    fit : Alignment
        What its alignment left.
    slope : ndarray, shape (H, W)
        Derivatives of the weighted residuals by the residuals.
    kept : float
        Share of the variance of white noise that smoothing and interpolation leave.
    factor : float
        What the covariance is multiplied by.
    """
    n = len(level.basis)
    covariance = sandwich(fit.design, fit.residual, fit.weight, slope, kept, n)
    jacobian = corner_jacobian(fit.pose, level.basis, level.corners)
    return factor * jacobian.T @ covariance @ jacobian


def sandwich(
    design: Array,
    residual: Array,
    weight: Array,
    slope: Array,
    kept: float,
    n: int,
) -> Array:
    """Return the covariance of the first `n` parameters of a weighted least-squares fit.

    The residuals are taken as white noise that interpolation and smoothing spread by a Gaussian
    (the sandwich estimator with Huber's correction for weights).

    Parameters
    ----------
    design : ndarray, shape (k, N)
        Derivatives of the residual by the parameters.
    residual, weight : ndarray, shape (H, W)
        Residuals of the N = HW pixels, and their weights.
    slope : ndarray, shape (H, W)
        Derivatives of the weighted residuals by the residuals.
    kept : float
        Share of the variance of white noise that smoothing and interpolation leave.
    n : int
        Parameters wanted; the others are estimated along with them.

    Returns
    -------
    ndarray, shape (n, n)
        NaN where the pixels do not determine them.
    """
    own, rest, share = design[:n], design[n:], weight.ravel()
    try:
        weighted = rest * share
        own = own - np.linalg.solve(ridged(gram(weighted, rest)), gram(weighted, own)).T @ rest
        inverse = np.linalg.inv(gram(own * share, own))
    except np.linalg.LinAlgError:
        return np.full((n, n), np.nan)
    efficiency = max(float(slope.sum()), 0.1 * float(weight.sum())) / float(weight.sum())
    variance = np.sum(np.square(weight * residual)) / np.sum(np.square(weight))
    scores = (own * share * np.sqrt(variance)).astype(np.float32).reshape(n, *residual.shape)
    parts = _spread(scores, kept)
    middle = gram(parts, parts) / kept
    alike = _correlated(residual * np.sqrt(weight), kept)
    return alike * inverse @ middle @ inverse / efficiency**2


def _spread(scores: Image, kept: float) -> Image:
    """Return images behind the Gaussian that keeps a share of the variance of white noise, n×N."""
    if kept < 1:
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


def largest_sigma(covariance: Array) -> float:
    """Return the largest standard deviation; infinite where any is not known."""
    variance = np.diag(covariance)
    return float(np.sqrt(variance.max())) if np.isfinite(variance).all() else np.inf
