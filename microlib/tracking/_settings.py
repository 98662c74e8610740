"""Settings of the tracker, chosen on development photographs and checked on other photographs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of the alignments and of the attempts, with the reason for each.

    Lengths in px are those of the finest level of a search, unless they are said to be those of the
    frame or of another level.

    Attributes
    ----------
    smoothing : float
        Standard deviation (px of the frame) of the Gaussian of the first level of a plain
        alignment. With twice as much, fine texture is lost; without it, the range of convergence is
        smaller.
    min_visible : float
        Least share of the template's pixels that must lie inside the image.
    min_correlation : float
        Normalized correlation below which an alignment is not the template.
    max_iterations : int
        Most steps of a plain alignment at one level.
    robust_iterations : int
        Most steps of a photometric alignment. With 8 steps 70 % instead of 80 % of the homographies
        with 40 % of the template hidden are found (40 pairs of development photographs). With 40
        steps no more are found.
    rough_tolerance, tolerance : float
        Motion of the corners (px of the frame) that ends a plain alignment: at a level that another
        level refines, and at the last level. One more step after a motion by 0.05 px would move the
        corners by about 0.05² px.
    robust_tolerance : float
        Motion of the corners (px) that ends a photometric alignment. Its weights change with every
        step, so that it converges more slowly than a plain alignment.
    min_agreement : float
        Share of the texture, by blocks, that must agree with the frame so that no search follows.
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
        Largest distance of the corners (px), and largest standard deviation of a corner (px), at
        which a plain alignment confirms a photometric fit. Without this rule a frame of the gripper
        takes four times as long.
    max_residual : float
        Robust standard deviation of the residual of a photometric fit over the noise, up to which
        nothing is hidden.
    threshold : float
        Probability of being right from which on a pose is accepted.
    confidence_coefficients : tuple of float
        Coefficients of the logistic regression that gives this probability: of 1, of the logarithm
        of the best score over the second best, of the inlier ratio of the points plus half of the
        hidden share, of the displacement, and of the logarithm of the standard deviation of the
        corners. They were fitted by maximum likelihood to 445 poses that searches found on
        photographs. The hidden share was added later, and the first coefficient lowered for it, on
        1376 pairs of 16 other photographs. In 2400 pairs of 16 further photographs, none of which
        the benchmark has, 94.5 % of the templates were then found within 3 px, for 93.8 % before,
        and 0.2 % of the poses were wrong in silence, as before.
    min_inlier_ratio : float
        Share of the points that must stay at the result of a search nearby: the majority.
    period_ncc, period_share : float
        Normalized correlation, and score over that of the template's own place, from which on
        another place of the first frame resembles the template.
    max_periods : int
        Most such places: the nearest neighbors in a periodic texture.
    other_period : float
        Gain in score, of the blocks of the template and its surroundings that agree better at such
        a place, from which on it may be the right one. In a periodic texture without end it is at
        most 0.08 for 95 % of poses, and where the texture ends at least 0.1 for 95 %.
    undecided : float
        Loss in score, of the blocks that agree less there, up to which the place may be right. It
        is at most 0.17 in a periodic texture without end, and at least 0.2 where it ends.
    max_period_share : float
        Motion, in periods, from which on the pose in such a texture is not believed.
    around : float
        Correlation of the surroundings of the template with the frame, in local contrast, from
        which on they agree with a pose.
    elsewhere : float
        By how much more the hidden part of the template must correlate with one place nearby than
        with all others, so that it moved there. Of 437 right poses on photographs, of which a part
        was hidden, 2 exceeded it, and of 109 poses of the ground around an object 97 %.
    least_object : float
        Share of the template that must be hidden for this. Without it, a bush and a barn in a film
        from a moving camera are lost in 64 and 29 of 80 frames, with it in 48 and 12.
    max_sigma_alone : float
        Largest standard deviation of a corner (px) at a pose of an object that left the ground in
        its box. If the surroundings do not agree for another reason, twice as much is allowed.
    near : float
        Motion, in longer sides of the template, from which on the last frame is searched for a
        lookalike that has been there before.
    apart : float
        Distance of the corners (px) from which on two poses are different ones.
    max_side : int
        Largest root of the template's area (px) at the finest level of the search. It limits the
        cost.
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
    point_spacing, point_error : float
        Spacing of the points that are followed by optical flow (px), and the error up to which a
        point counts as an inlier of a motion.
    min_points : int
        Fewest points that make a motion.
    coarse_smoothing, fine_smoothing : float
        Standard deviations (px) of the Gaussians of the levels of the search, and of the levels of
        the photometric model, which are sampled at half pixels.
    window : float
        Standard deviation (px) of the Gaussian window in which gain and bias count as constant.
        With twice as much no more is found.
    blurs : tuple of float
        Standard deviations (px) of the blurs of the template. With a fourth blur no more templates
        are found.
    bias_splines : int
        Cubic splines of the bias along a side. With 5 splines 80 % instead of 88 % of the
        homographies with glare are found (40 pairs of development photographs).
    covariance_factor : float
        Factor of the covariance of a photometric fit for what its model omits: a blur between those
        tried.
    residual_smoothing : float
        Standard deviation (samples) of the Gaussian after which residuals should be noise. What
        remains in excess of the noise increases the covariance.
    unrelated_information : float
        Mean information (nats) of a block that shows something else.
    interpolation_error : float
        Share of a block's variance that interpolation leaves: the mean over photographs without
        noise.
    max_block_weight : float
        Largest weight of one block in the agreement: its variance over that of the noise.
    """

    smoothing: float = 1.25
    min_visible: float = 0.25
    min_correlation: float = 0.7
    max_iterations: int = 6
    robust_iterations: int = 20
    rough_tolerance: float = 0.5
    tolerance: float = 0.05
    robust_tolerance: float = 0.02
    min_agreement: float = 0.95
    min_texture: float = 100.0
    max_sigma: float = 0.15
    steady_light: tuple[float, float] = (0.5, 0.02)
    changed_ground: tuple[float, float] = (1.0, 0.2)
    max_difference: float = 0.5
    max_residual: float = 1.5
    threshold: float = 0.7
    confidence_coefficients: tuple[float, ...] = (-3.8, 0.33, 4.16, -9.86, -1.45)
    min_inlier_ratio: float = 0.5
    period_ncc: float = 0.3
    period_share: float = 0.2
    max_periods: int = 8
    other_period: float = 0.1
    undecided: float = 0.2
    max_period_share: float = 0.38
    around: float = 0.65
    elsewhere: float = 0.2
    least_object: float = 0.1
    max_sigma_alone: float = 0.2
    near: float = 0.25
    apart: float = 3.0
    max_side: int = 64
    distortion_step: float = 0.15
    max_matches: int = 6
    beam: int = 3
    beam_share: float = 0.5
    least_score: float = 1.0
    point_spacing: int = 5
    point_error: float = 1.5
    min_points: int = 8
    coarse_smoothing: float = 1.0
    fine_smoothing: float = 0.6
    window: float = 3.5
    blurs: tuple[float, ...] = (0.0, 1.2, 2.2)
    bias_splines: int = 6
    covariance_factor: float = 1.5
    residual_smoothing: float = 1.5
    unrelated_information: float = 0.25
    interpolation_error: float = 0.001
    max_block_weight: float = 50.0
