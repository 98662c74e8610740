"""Search for a template that is partly hidden, in another light, or far away.

Starts are aligned at the coarsest and at the finest level. A beam of those in which the blocks of
the template agree best is aligned with the photometric model, the template as blurred as the frame.
The score of the blocks ranks these fits, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microlib._common import Array, Image
from microlib.tracking._sampling import SearchFrame
from microlib.tracking.robust._covariance import largest_sigma
from microlib.tracking.robust._decision import (
    Candidate,
    blocks_agree,
    confidence,
    judge_photometric,
)
from microlib.tracking.robust._starts import distortions, ncc_peaks
from microlib.tracking.robust._template import SearchTemplate


@dataclass(frozen=True, eq=False)
class Sighting:
    """A frame in which the template was found.

    Attributes
    ----------
    image : ndarray, shape (H, W)
        The whole frame, or its part that is searched; its grey levels scaled as the template's.
    pose : ndarray, shape (3, 3)
        Where the template was, in px of the image.
    """

    image: Image
    pose: Array


@dataclass(frozen=True, eq=False)
class Search:
    """A template, a frame in which it is searched, and what is known from the frames before.

    Attributes
    ----------
    template : SearchTemplate
        The template.
    frame : SearchFrame
        The frame, or its part around the template.
    pose : ndarray, shape (3, 3)
        Expected pose, in px of the frame.
    seen : bool
        Whether the template was found in the frame before.
    last : Sighting
        The same part of the last frame in which the template was found.
    parted : bool
        Whether parts of the template were seen to move differently, so that it shows ground.
    """

    template: SearchTemplate
    frame: SearchFrame
    pose: Array
    seen: bool
    last: Sighting
    parted: bool

    def ambiguous(self, pose: Array) -> bool:
        """Return whether a pose may be that of something that looks like the template.

        That may be a part of a periodic texture, or what was at a distant pose in the last frame.
        """
        template, settings = self.template, self.template.settings
        if template.periods and self._between_periods(pose):
            return True
        if np.hypot(*template.displacement(self.pose, pose)) < settings.near * template.side:
            return False
        before = template.plain.align(self.last.image, pose)
        agrees = blocks_agree(template, before, settings.changed_ground)
        return agrees and template.apart(before.pose, self.last.pose)

    def _between_periods(self, pose: Array) -> bool:
        """Return whether a pose may be wrong by a period of the texture.

        The surroundings of the template decide. If they agree with both poses, a pose may be
        wrong if the expected one is more than `max_period_share` of the period away.
        """
        template, settings = self.template, self.template.settings
        poses = [pose, *(pose @ period for period in template.periods)]
        blocks = [template.blocks(template.surroundings, self.frame, each) for each in poses]
        distances = [np.hypot(*template.displacement(self.pose, each)) for each in poses]
        share = settings.max_period_share / (1 - settings.max_period_share)
        here, score = blocks[0], blocks[0].score()
        for there, distance in zip(blocks[1:], distances[1:], strict=True):
            if here.excess_in(there) > settings.other_period * score:
                return True
            undecided = there.excess_in(here) < settings.undecided * score
            if undecided and distances[0] > share * distance:
                return True
        return False

    @cached_property
    def flow_pose(self) -> Array | None:
        """Pose to which most points flow from the expected pose, if there is one."""
        return self._flow_pose(self.pose)

    def match_poses(self) -> list[Array]:
        """Return the expected pose translated to where the template correlates best."""
        level = self.template.coarse
        layer, apart = self.frame.layer(level.halvings), min(level.grey.shape) // 4
        peaks = ncc_peaks(level, layer, self.pose, apart=apart)
        return peaks[: self.template.settings.max_matches]

    def far_poses(self) -> list[Array]:
        """Return the best of the expected pose distorted, or translated to the best matches.

        The template's points are followed from the best of them, too.
        """
        level, step = self.template.coarse, self.template.settings.distortion_step
        starts = [self.pose @ warp for warp in distortions(level.basis, step)]
        aligned = self.align_starts(starts + self.match_poses())
        moved = self._flow_pose(aligned[0]) if aligned else None
        return aligned if moved is None else [*aligned, moved]

    def align_starts(self, starts: list[Array]) -> list[Array]:
        """Return where the best starts lead, aligned at the coarsest level and the finest."""
        template, tolerance = self.template, self.template.settings.rough_tolerance
        coarse, fine = template.coarse, template.fine
        layer = self.frame.layer(coarse.halvings)
        aligned = [coarse.align(layer, start, tolerance=tolerance) for start in starts]
        aligned = [fit for fit in aligned if fit.correlation > 0]
        poses = [fit.pose for fit in aligned]
        best = template.different(poses, [fit.correlation for fit in aligned])
        beam, layer = best[: template.settings.beam], self.frame.layer(fine.halvings)
        return [fine.align(layer, poses[k], tolerance=tolerance).pose for k in beam]

    def best_candidate(
        self, starts: list[Array], before: Sequence[Candidate]
    ) -> tuple[Candidate, float] | None:
        """Return the best pose to which some starts lead, or None.

        The photometric fits of the candidates `before` compete with those of the starts. The second
        number is the share of the template's points that stay when they are followed from the pose.

        A box is drawn around an object, so that what moves with the surroundings of the box is
        ground. If the hidden part of the template is found elsewhere, there are two motions. The
        pose with which the surroundings agree better is that of the ground, and is not accepted.
        A pose with which they do not agree must be precise.
        """
        template, frame, settings = self.template, self.frame, self.template.settings
        scores = [template.score(frame, start) for start in starts]
        beam = template.different(starts, scores)[: settings.beam]
        least = max([settings.least_score, *(settings.beam_share * scores[k] for k in beam)])
        good = [k for k in beam if scores[k] >= least]
        aligned = [template.align_best_blur(frame, starts[k]) for k in good]
        aligned += [candidate.photometric for candidate in before]
        fits = [fit for fit in aligned if fit is not None]
        if not fits:
            return None
        scores = [fit.blocks.score() for fit in fits]
        best, *others = template.different([fit.pose for fit in fits], scores)
        fit = fits[best]
        layer = frame.layer(template.fine.halvings)
        points = template.points[fit.blur]
        inlier_ratio = points.inlier_ratio(layer, fit.pose)
        candidate = judge_photometric(template, fit)
        if fit.reason:
            return candidate, inlier_ratio
        sigma = largest_sigma(candidate.corner_covariance)
        probability = candidate.confidence or confidence(
            settings.confidence_coefficients,
            score=scores[best],
            second_score=scores[others[0]] if others else 0.0,
            agreeing=inlier_ratio + fit.hidden.mean() / 2,
            displacement=np.hypot(*template.displacement(self.pose, fit.pose)) / template.side,
            sigma=sigma,
        )
        if settings.threshold <= probability < 1:
            around, elsewhere, there = points.ground_evidence(layer, fit.pose, fit.hidden)
            moved = elsewhere > settings.elsewhere and fit.hidden.mean() > settings.least_object
            if (moved or self.parted) and around > (there if moved else settings.around):
                candidate, probability = replace(candidate, reason="two motions"), 0.0
            elif around < settings.around:
                probability *= sigma < settings.max_sigma_alone * (1 if moved or self.parted else 2)
        return replace(candidate, confidence=probability), inlier_ratio

    def _flow_pose(self, pose: Array) -> Array | None:
        layer = self.frame.layer(self.template.fine.halvings)
        return self.template.points[0].flow_pose(layer, pose)
