"""Candidates for the pose of the template, and what makes them certain."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.tracking._esm import Alignment
from microlib.tracking.robust._blocks import compare
from microlib.tracking.robust._covariance import corner_covariance, largest_sigma
from microlib.tracking.robust._photometric import PhotometricFit
from microlib.tracking.robust._template import SearchTemplate


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose that an attempt found, and the probability that it is right.

    Attributes
    ----------
    fit : Alignment
        Pose, gain, bias and correlation.
    confidence : float
        Probability that the pose is right within a pixel.
    corner_covariance : ndarray, shape (8, 8)
        Covariance of the corners in px².
    hidden : ndarray of bool, shape (height, width)
        Pixels of the template that the frame does not show; empty if the alignment failed.
    reason : str
        Reason for a loss that holds unless the candidate is accepted.
    """

    fit: Alignment
    confidence: float
    corner_covariance: Array
    hidden: NDArray[np.bool_]
    reason: str

    @property
    def photometric(self) -> PhotometricFit | None:
        """The fit, if it is one of the photometric model."""
        return self.fit if isinstance(self.fit, PhotometricFit) else None


def judge_plain(template: SearchTemplate, plain: Alignment) -> Candidate:
    """Return an alignment of one gain and bias; certain if all blocks agree within the noise."""
    settings, covariance = template.settings, np.full((8, 8), np.nan)
    if blocks_agree(template, plain, settings.steady_light):
        covariance = corner_covariance(template.plain.sharp, plain, plain.weight)
    certain = largest_sigma(covariance) < settings.max_sigma
    reason = plain.reason or "no agreement"
    return Candidate(plain, float(certain), covariance, plain.weight == 0, reason)


def judge_photometric(
    template: SearchTemplate, fit: PhotometricFit, plain: Alignment | None = None
) -> Candidate:
    """Return a photometric fit; certain if all blocks agree, or if it confirms a plain alignment.

    The hidden pixels are those at full resolution.
    """
    settings = template.settings
    covariance = corner_covariance(template.photometric[0], fit, fit.psi_slope)
    covariance *= settings.covariance_factor
    sigma = largest_sigma(covariance)
    clear = (
        sigma < settings.max_sigma
        and fit.noise_ratio < settings.max_residual
        and fit.blocks.agree()
    )
    if plain is not None and not clear:
        difference = max(template.distance(fit.pose, plain.pose), sigma)
        confirms = blocks_agree(template, plain, settings.changed_ground)
        clear = confirms and difference < settings.max_difference
    size = template.shape[::-1]
    hidden = cv2.resize(fit.hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return Candidate(fit, float(clear), covariance, hidden, fit.reason or "no agreement")


def blocks_agree(template: SearchTemplate, plain: Alignment, limit: tuple[float, float]) -> bool:
    """Return whether all blocks of the template agree with an alignment of one gain and bias.

    The `limit` of the residual of their means is in the noise and in the contrast.
    """
    if plain.reason:
        return False
    sharp, noise = template.plain.sharp, template.noise
    blocks = compare(plain.grey, sharp.grey, plain.weight, noise, template.settings)
    most = limit[0] * noise + limit[1] * abs(plain.gain) * sharp.contrast
    return blocks.agree() and blocks.residual_of_means() <= most


def confidence(
    coefficients: tuple[float, ...],
    *,
    score: float,
    second_score: float,
    agreeing: float,
    displacement: float,
    sigma: float,
) -> float:
    """Return the probability that a pose is right within a pixel, by a logistic regression.

    Parameters
    ----------
    coefficients : tuple of float
        Those of the regression.
    score, second_score : float
        Information (nats) in which the blocks agree, and that of the best pose elsewhere.
    agreeing : float
        Share of the template's points that stay when they are followed from the pose, and half of
        the share of its pixels that are hidden, whose points cannot stay.
    displacement : float
        Distance of the center from the expected one, in longer sides of the template.
    sigma : float
        Largest standard deviation of a corner, px.
    """
    best, second = (np.log1p(max(each, 0.0)) for each in (score, second_score))
    spread = np.log(np.clip(sigma, 1e-3, 10.0))
    features = np.array([1.0, best - second, agreeing, min(displacement, 0.5), spread])
    return float(1.0 / (1.0 + np.exp(-features @ coefficients)))
