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
from microlib.tracking._geometry import TINY, translate
from microlib.tracking._sampling import SearchFrame
from microlib.tracking.robust._covariance import largest_sigma
from microlib.tracking.robust._decision import (
    Candidate,
    blocks_agree,
    confidence,
    judge_photometric,
)
from microlib.tracking.robust._photometric import PhotometricFit
from microlib.tracking.robust._starts import distortions, ncc_peaks
from microlib.tracking.robust._template import SearchTemplate


@dataclass(frozen=True, eq=False)
class Sighting:
    """A frame in which the template was found.

    Attributes
    ----------
    template : SearchTemplate
        The template.
    image : ndarray, shape (H, W)
        The whole frame, its grey levels scaled as those of the template.
    pose : ndarray, shape (3, 3)
        Where the template was.
    """

    template: SearchTemplate
    image: Image
    pose: Array

    @cached_property
    def lookalikes(self) -> Array:
        """Where else the frame shows the template, as offsets from its place, k×2 (x, y) in px.

        Only the nearest places are tested: all blocks of the template must agree there.
        """
        template, settings = self.template, self.template.settings
        layer = SearchFrame(self.image, 0.0).layer(template.fine.halvings)
        peaks = ncc_peaks(template.fine, layer, self.pose, apart=2, least=settings.lookalike_ncc)
        starts = self._elsewhere([template.displacement(self.pose, peak) for peak in peaks])
        fits = [
            template.plain.align(self.image, translate(self.pose, offset))
            for offset in starts[: settings.max_matches]
        ]
        equal = [fit for fit in fits if blocks_agree(template, fit, settings.changed_ground)]
        places = self._elsewhere([template.displacement(self.pose, fit.pose) for fit in equal])
        return np.array(places).reshape(-1, 2)

    def _elsewhere(self, offsets: list[Array]) -> list[Array]:
        """Return the offsets that are not that of the template itself, the nearest first."""
        least = self.template.settings.apart
        return sorted(
            (off for off in offsets if np.hypot(*off) > least), key=lambda off: np.hypot(*off)
        )


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
    first_lookalikes : ndarray, shape (k, 2)
        Where else the first frame shows the template, as offsets from its place, px.
    last : Sighting
        The last frame in which the template was found.
    """

    template: SearchTemplate
    frame: SearchFrame
    pose: Array
    seen: bool
    first_lookalikes: Array
    last: Sighting

    def uniqueness(self, pose: Array) -> float:
        """Return the probability that a pose is not that of a lookalike.

        The result is b/(a + b). Here, a is the distance of this pose from the expected one, and b
        is the distance by which the nearest lookalike would have moved to reach this pose. A motion
        by less than a quarter of the template meets only lookalikes that its first frame shows.
        These repeat on all sides in a periodic texture, so that the result is 1 − a/b.
        """
        template = self.template
        offset = template.displacement(self.pose, pose)
        near = self.seen and np.hypot(*offset) < template.settings.near * template.side
        lookalikes = self.first_lookalikes if near else self.last.lookalikes
        if not len(lookalikes):
            return 1.0
        nearest = np.linalg.norm(lookalikes - offset, axis=1).min()
        ratio = float(np.hypot(*offset) / max(nearest, TINY))
        return max(0.0, 1 - ratio) if near else 1 / (1 + ratio)

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
        The probability is multiplied by max(0, 1 − a/b) with the score a of a second motion and the
        score b of the pose: one part of the template may be an object, and the other its
        background.
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
        inlier_ratio, moved = template.points.follow_from(layer, fit.pose)
        candidate = judge_photometric(template, fit)
        if fit.reason:
            return candidate, inlier_ratio
        probability = candidate.confidence or confidence(
            settings.confidence_coefficients,
            score=scores[best],
            second_score=scores[others[0]] if others else 0.0,
            inlier_ratio=inlier_ratio,
            displacement=np.hypot(*template.displacement(self.pose, fit.pose)) / template.side,
            sigma=largest_sigma(candidate.corner_covariance),
        )
        doubt = self._second_motion_score(fit, moved) / max(scores[best], TINY)
        return replace(candidate, confidence=probability * max(0.0, 1.0 - doubt)), inlier_ratio

    def _flow_pose(self, pose: Array) -> Array | None:
        return self.template.points.flow_pose(self.frame.layer(self.template.fine.halvings), pose)

    def _second_motion_score(self, fit: PhotometricFit, start: Array | None) -> float:
        """Return how much more some blocks agree where other points move together, nats.

        That pose only causes doubt and is never accepted: which of two parts that move differently
        is the object cannot be known.
        """
        template = self.template
        if start is None or template.score(self.frame, start) < template.settings.least_score:
            return 0.0
        other = template.align_best_blur(self.frame, start)
        if other is None or not template.apart(fit.pose, other.pose):
            return 0.0
        return fit.blocks.excess_in(other.blocks)
