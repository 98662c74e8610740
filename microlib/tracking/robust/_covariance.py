"""Covariance of an alignment whose residuals are correlated and partly outliers."""

from __future__ import annotations

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._esm import Alignment, Level
from microlib.tracking._geometry import corner_jacobian
from microlib.tracking._normal_equations import gram, ridged


def corner_covariance(level: Level, fit: Alignment, slope: Image) -> Array:
    """Return the covariance of the corners (8: x, y of each), px² of the frame.

    Parameters
    ----------
    level : Level
        A template that is sampled at half pixels.
    fit : Alignment
        An alignment of that level.
    slope : ndarray, shape (H, W)
        Derivatives of the weighted residuals by the residuals.
    """
    covariance = sandwich(
        fit.design,
        fit.residual,
        fit.weight,
        slope,
        transmission=level.noise_gain**2,
        smoothing=level.settings.residual_smoothing,
        wanted=len(level.basis),
    )
    jacobian = corner_jacobian(fit.pose, level.basis, level.corners)
    return jacobian.T @ covariance @ jacobian


def sandwich(
    design: Array,
    residual: Array,
    weight: Array,
    slope: Array,
    *,
    transmission: float,
    smoothing: float,
    wanted: int,
) -> Array:
    """Return the covariance of the first parameters of a weighted least-squares fit.

    This is the sandwich estimator N⁻¹ (X W K)(X W K)ᵀ N⁻¹ s² with Huber's correction for weights
    (Huber and Ronchetti 2009, section 7.6). X is the design, W the weights, N = X W Xᵀ, s² the
    variance of the residuals, and K the Gaussian by which interpolation and smoothing correlate
    white noise.

    Parameters
    ----------
    design : ndarray, shape (k, N)
        Derivatives of the residual by the parameters.
    residual, weight : ndarray, shape (H, W)
        Residuals of the N = HW pixels, and their weights.
    slope : ndarray, shape (H, W)
        Derivatives of the weighted residuals by the residuals.
    transmission : float
        Share of the variance of white noise that smoothing and interpolation leave.
    smoothing : float
        Standard deviation (samples) of the Gaussian after which the residuals should be noise.
    wanted : int
        Number of parameters whose covariance is wanted; the others are estimated along with them.

    Returns
    -------
    ndarray, shape (wanted, wanted)
        NaN if the pixels do not determine the parameters.
    """
    motions, nuisance, weights = design[:wanted], design[wanted:], weight.ravel()
    weighted = nuisance * weights
    projection = np.linalg.solve(ridged(gram(weighted, nuisance)), gram(weighted, motions))
    motions = motions - projection.T @ nuisance
    try:  # `inverse_symmetric` would add 2 % to the time of a frame
        inverse = np.linalg.inv(gram(motions * weights, motions))
    except np.linalg.LinAlgError:
        return np.full((wanted, wanted), np.nan)
    efficiency = max(float(slope.sum()), 0.1 * float(weight.sum())) / float(weight.sum())
    variance = np.sum(np.square(weight * residual)) / np.sum(np.square(weight))
    scores = (motions * weights * np.sqrt(variance)).astype(np.float32)
    scores = scores.reshape(wanted, *residual.shape)
    correlated = _correlate(scores, transmission)
    middle = gram(correlated, correlated) / transmission
    excess = _excess_variance(residual * np.sqrt(weight), transmission, smoothing)
    return excess * inverse @ middle @ inverse / efficiency**2


def _correlate(scores: Image, transmission: float) -> Image:
    """Return images after the Gaussian that transmits a share of white noise's variance, n×N."""
    if transmission < 1:
        sigma = 1 / (2 * np.sqrt(np.pi * transmission))
        scores = np.stack(
            [
                cv2.GaussianBlur(each, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
                for each in scores
            ]
        )
    return scores.reshape(len(scores), -1)


def _excess_variance(residual: Array, transmission: float, smoothing: float) -> float:
    """Return by what factor a Gaussian leaves more of the residuals than of noise, at least 1.

    White noise after a Gaussian of variance s has a variance in proportion to 1/s.
    """
    sigma = 1 / (2 * np.sqrt(np.pi * transmission))
    blurred = cv2.GaussianBlur(np.asarray(residual, np.float32), (0, 0), smoothing)
    expected = sigma**2 / (sigma**2 + smoothing**2) * float(np.mean(residual**2))
    return max(float(np.mean(blurred**2)) / expected, 1.0) if expected > 0 else 1.0


def largest_sigma(covariance: Array) -> float:
    """Return the largest standard deviation; infinite where any is not known."""
    variance = np.diag(covariance)
    return float(np.sqrt(variance.max())) if np.isfinite(variance).all() else np.inf
