"""What the tracker is set to: found on development photographs, and checked on others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the attempts, with the reason for each.

    "Variants" is that table of the tracker's benchmark on photographs.

    Attributes
    ----------
    smoothing : float
        Standard deviation (px) of the Gaussian at the first level: twice as much loses fine
        texture, none loses reach.
    least_correlation : float
        Normalized correlation below which nothing is the template.
    convincing : float
        Correlation that makes an alignment worth testing without a light of its own.
    agreed, texture, certain : float
        Share of the texture that must agree, how much of it (blocks' variance over the noise's) and
        how certain a corner (px) there must be, for a pose to need no further search.
    steady, unsteady : tuple of float
        Drift of the blocks' grey levels, in the noise and in the contrast, that is no change of
        light; and that is none of the template, where nothing better is found: the ground between
        the details of a template may change.
    confirmed : float
        Corner distance (px) up to which two alignments in different light say the same, and their
        standard deviation.
    clear : float
        Residual in smooth light, in the noise, up to which nothing is hidden.
    believed : float
        Probability of being right from which on a pose is believed: 0.4 % of the right ones on
        photographs held out and 2.6 % on those fitted to are below it (table "Findings").
    largest : int
        Side (px) that the template has at most at the finest level of the search: its cost.
    distortion : float
        How far a distorted start moves each corner coordinate, in sides of the template. Without
        these starts 75 % instead of 92 % of the homographies of 15 px are found.
    places : int
        Best matches that are tried: without them no translation of 32 px is found.
    far : int
        Starts from far away that go on: without any 50 % of the homographies of 15 px are found.
    hopeful : int
        Starts that are followed to the end.
    rivaling : float
        Share of the best start's nats that the others need for that.
    hopeless : float
        Nats below which no start is finished: no template that was there had less.
    blurs : tuple of float
        Standard deviations (px) of the blurs of the template: "Variants".
    blurred : tuple of float
        How much more, as a factor and in nats, a blurred template must say to be taken.
    knots : int
        Most knots of the bias along a side: "Variants".
    points : bool
        Whether the points of the template are followed: "Variants".
    unmodeled : float
        What the covariance of a fit in smooth light is short of, as a factor, where nothing is
        hidden: a blur between those tried. Where all is hidden it is twice as much, since the
        border of hidden parts counts a little.
    """

    smoothing: float = 1.25
    least_correlation: float = 0.7
    convincing: float = 0.9
    agreed: float = 0.95
    texture: float = 100.0
    certain: float = 0.15
    steady: tuple[float, float] = (0.5, 0.02)
    unsteady: tuple[float, float] = (1.0, 0.2)
    confirmed: float = 0.5
    clear: float = 1.5
    believed: float = 0.65
    largest: int = 64
    distortion: float = 0.17
    places: int = 6
    far: int = 3
    hopeful: int = 3
    rivaling: float = 0.5
    hopeless: float = 1.0
    blurs: tuple[float, ...] = (0.0, 1.0, 1.6, 2.5)
    blurred: tuple[float, float] = (1.1, 1.0)
    knots: int = 5
    points: bool = True
    unmodeled: float = 1.5
