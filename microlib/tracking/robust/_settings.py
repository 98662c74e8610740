"""What the tracker is set to: found on development photographs, and checked on others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the attempts, with the reason for each.

    "Variants" is that table of the tracker's benchmark on photographs.

    Attributes
    ----------
    agreed, texture, certain : float
        Share of the texture that must agree, how much of it (blocks' variance over the noise's) and
        how certain a corner (px) there must be, for a pose to need no further search.
    steady_light, changed_ground : tuple of float
        Residual of the blocks' means about one gain and bias, in the noise and in the contrast: up
        to the first the light counts as unchanged, up to the second the template as the same on
        changed ground.
    confirmed : float
        Corner distance (px) up to which two alignments with different photometric models agree, and
        their largest standard deviation. Without this rule a frame of the gripper takes four times
        as long.
    clear : float
        Residual in smooth light, in the noise, up to which nothing is hidden.
    threshold : float
        Probability of being right from which on a pose is accepted.
    alike : float
        Normalized correlation from which on another place of a frame looks like the template.
    largest : int
        Side (px) that the template has at most at the finest level of the search: its cost.
    distortion : float
        Step of the distorted starts along each generator. Without these starts 75 % instead of 92 %
        of the homographies of 15 px are found.
    places : int
        Best matches that are tried: without them no translation of 32 px is found.
    beam : int
        Starts that are followed to the end.
    beam_share : float
        Share of the best start's nats that the others need for that.
    least_score : float
        Nats below which no start is finished: no template that was there had less.
    blurs : tuple of float
        Standard deviations (px) of the blurs of the template: "Variants".
    bias_splines : int
        Cubic splines of the bias along a side.
    unmodeled : float
        Factor of the covariance of a photometric fit for what its model leaves out: a blur between
        those tried.
    """

    agreed: float = 0.95
    texture: float = 100.0
    certain: float = 0.15
    steady_light: tuple[float, float] = (0.5, 0.02)
    changed_ground: tuple[float, float] = (1.0, 0.2)
    confirmed: float = 0.5
    clear: float = 1.5
    threshold: float = 0.7
    alike: float = 0.9
    largest: int = 64
    distortion: float = 0.15
    places: int = 6
    beam: int = 3
    beam_share: float = 0.5
    least_score: float = 1.0
    blurs: tuple[float, ...] = (0.0, 1.0, 1.6, 2.5)
    bias_splines: int = 5
    unmodeled: float = 1.5
