"""Settings of the robust search, found on development photographs and checked on others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the attempts, with the reason for each.

    Attributes
    ----------
    min_agreement : float
        Texture of the blocks that agree over that of all, from which on a pose needs no search.
    min_texture : float
        Sum of the variances of the blocks over that of the noise that this decision needs.
    max_sigma : float
        Standard deviation of a corner (px) up to which this decision is made.
    steady_light, changed_ground : tuple of float
        Largest residual of the blocks' means about one gain and bias: a multiple of the noise plus
        a multiple of the contrast. Up to the first the illumination counts as unchanged; up to the
        second a plain alignment can confirm a photometric fit, though the ground between details of
        the template may have changed.
    max_difference : float
        Largest distance of the corners (px) at which a plain alignment confirms a photometric fit,
        and largest standard deviation of that fit. Without this rule a frame of the gripper takes
        four times as long.
    max_residual : float
        Robust standard deviation of the residual of a photometric fit over the noise, up to which
        nothing is hidden.
    threshold : float
        Probability of being right from which on a pose is accepted.
    lookalike_ncc : float
        Normalized correlation from which on another place of a frame may be a lookalike.
    max_side : int
        Largest side (px), at the finest level of the search, of a square of the template's area. It
        limits the cost.
    distortion_step : float
        Step of the distorted starts along each generator. Without these starts 75 % instead of 92 %
        of the homographies of 15 px are found.
    max_matches : int
        Peaks of the correlation that are tried. Without them no translation of 32 px is found.
    beam : int
        Starts that are aligned with the photometric model.
    beam_share : float
        Score over that of the best start that such a start needs.
    least_score : float
        Score (nats) that such a start needs; below it no photometric fit is made.
    blurs : tuple of float
        Standard deviations (px) of the blurs of the template.
    bias_splines : int
        Cubic splines of the bias along a side.
    covariance_factor : float
        Factor of the covariance of a photometric fit for what its model omits: a blur between those
        tried.
    """

    min_agreement: float = 0.95
    min_texture: float = 100.0
    max_sigma: float = 0.15
    steady_light: tuple[float, float] = (0.5, 0.02)
    changed_ground: tuple[float, float] = (1.0, 0.2)
    max_difference: float = 0.5
    max_residual: float = 1.5
    threshold: float = 0.7
    lookalike_ncc: float = 0.9
    max_side: int = 64
    distortion_step: float = 0.15
    max_matches: int = 6
    beam: int = 3
    beam_share: float = 0.5
    least_score: float = 1.0
    blurs: tuple[float, ...] = (0.0, 1.0, 1.6, 2.5)
    bias_splines: int = 5
    covariance_factor: float = 1.5
