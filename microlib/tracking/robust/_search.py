"""Search for a template that is partly hidden, in another light, or far away.

Starts are aligned at the coarsest and at the finest level. A beam of those in which the blocks of
the template agree best is aligned with the photometric model, the template as blurred as the frame.
The score of the blocks ranks these fits, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._esm import Alignment, Level, Template, make_level
from microlib.tracking._geometry import apply_homography, cut_around, translate
from microlib.tracking._sampling import View, half_pixel
from microlib.tracking.robust._blocks import Agreement, compare
from microlib.tracking.robust._covariance import corner_covariance
from microlib.tracking.robust._photometric import PhotometricFit, PhotometricLevel, make_photometric
from microlib.tracking.robust._settings import Settings
from microlib.tracking.robust._starts import PointFlow, distortions, ncc_peaks

#: Standard deviation (px) of the smoothing of the last levels.
_SHARP = 0.6

#: Margin (px) around the template in which it is aligned at half pixels.
_MARGIN = 8.0


@dataclass(frozen=True, eq=False)
class Finding:
    """The best pose that a search found.

    Attributes
    ----------
    fit : PhotometricFit
        Pose, photometric parameters, weights and residuals.
    score, second_score : float
        Information (nats) in which the blocks agree; and that of the best pose elsewhere.
    second_motion_score : float
        How much more some blocks agree at the pose to which other points of the template move
        together, nats, summed over these blocks; 0 if there is no such pose.
    inlier_ratio : float
        Share of the template's points that stay when they are followed from the pose.
    displacement : float
        Distance of the center from the expected one, in longer sides of the template.
    """

    fit: PhotometricFit
    score: float
    second_score: float
    second_motion_score: float
    inlier_ratio: float
    displacement: float


class RobustSearch:
    """A template at the resolutions of the robust attempts.

    Attributes
    ----------
    template : Template
        Its levels for plain alignments.
    settings : Settings
        Thresholds and sizes of the search.
    noise : float
        Standard deviation of the noise of the first frame.
    side : int
        The longer side of the box, px.
    first_lookalikes : ndarray, shape (k, 2)
        Where else the first frame shows the template, as offsets (px).
    """

    def __init__(
        self,
        template: Template,
        view: View,
        box: tuple[int, int, int, int],
        pose: Array,
        motion: str,
    ) -> None:
        self.template, self.settings, self.noise = template, Settings(), view.noise
        width, height = box[2:]
        settings, self.side, self.shape = self.settings, max(width, height), (height, width)
        size = np.sqrt(width * height)  # an oblong box keeps more than a few rows
        self._finest = max(0, int(np.ceil(np.log2(size / settings.max_side))))
        self._scale = 2.0**self._finest
        cut = partial(make_level, box=box, pose=pose, motion=motion)
        fine = view.layer(self._finest)
        #: Of the coarsest level: up to two more while the shorter side keeps 12 px.
        self._halvings = self._finest
        while self._halvings < self._finest + 2 and min(width, height) >= 24 << self._halvings:
            self._halvings += 1
        coarse = view.layer(self._halvings)
        self._coarse = cut(coarse, halvings=self._halvings, smoothing=1.0)
        self._blurred: list[Level] = []
        self._photometric: list[PhotometricLevel] = []
        for blur in settings.blurs:
            image = cv2.GaussianBlur(fine, (0, 0), blur) if blur else fine
            self._blurred.append(cut(image, halvings=self._finest, smoothing=1.0))
            sharp, blurred = (
                cut(half_pixel(one), halvings=self._finest, smoothing=_SHARP, density=2)
                for one in (image, cv2.GaussianBlur(image, (0, 0), 0.8))
            )
            self._photometric.append(make_photometric(sharp, blurred, settings.bias_splines))
        self._points = PointFlow(self._blurred[0], fine, pose, self.side >> self._finest)
        self._distortions = distortions(motion, settings.distortion_step)
        self.first_lookalikes = self.lookalikes(view.image, pose)

    def is_enough(self, agreement: Agreement) -> bool:
        """Return whether the blocks of the template agree, and have enough texture for that."""
        most_agree = agreement.agreeing >= self.settings.min_agreement
        return most_agree and agreement.texture >= self.settings.min_texture

    def blocks_agree(self, fit: Alignment, limit: tuple[float, float] | None = None) -> bool:
        """Return whether all blocks of the template agree with an alignment of one gain and bias.

        The `limit` of the residual of their means is in the noise and in the contrast.
        """
        if fit.reason:
            return False
        sharp = self.template.sharp
        agreement = compare(fit.grey, sharp.grey, fit.weight, self.noise).agreement()
        noise, contrast = limit or self.settings.changed_ground
        most = noise * self.noise + contrast * abs(fit.gain) * sharp.contrast
        return self.is_enough(agreement) and agreement.residual <= most

    def flow_poses(self, view: View, pose: Array) -> list[Array]:
        """Return the pose to which most points of the template flow, if there is one."""
        found = self._points.flow_pose(view.layer(self._finest), pose)
        return [] if found is None else [found]

    def match_poses(self, view: View, pose: Array) -> list[Array]:
        """Return the pose translated to where the template correlates best in the view."""
        layer, apart = view.layer(self._halvings), min(self._coarse.grey.shape) // 4
        return ncc_peaks(self._coarse, layer, pose, apart=apart)[: self.settings.max_matches]

    def far_poses(self, view: View, pose: Array) -> list[Array]:
        """Return the best of a pose that is distorted, or translated to the best matches.

        The template's points are followed from the best one, too.
        """
        starts = [pose @ warp for warp in self._distortions] + self.match_poses(view, pose)
        aligned = self.align_starts(view, starts)
        return aligned + [far for start in aligned[:1] for far in self.flow_poses(view, start)]

    def align_starts(self, view: View, starts: list[Array]) -> list[Array]:
        """Return where the best starts lead, aligned at the coarsest level and the finest."""
        layer = view.layer(self._halvings)
        fits = [self._coarse.align(layer, start, tolerance=0.3, iterations=5) for start in starts]
        fits = [fit for fit in fits if not fit.failure]
        best = self._different([fit.pose for fit in fits], [fit.correlation for fit in fits])
        fine, layer = self._blurred[0], view.layer(self._finest)
        beam = [fits[k].pose for k in best[: self.settings.beam]]
        return [fine.align(layer, start, tolerance=0.3).pose for start in beam]

    def search(
        self, view: View, pose: Array, starts: list[Array], fits: list[PhotometricFit]
    ) -> Finding | None:
        """Return the best pose that the starts lead to, or None if there is none.

        Parameters
        ----------
        view : View
            The frame.
        pose : ndarray, shape (3, 3)
            Where the template is expected.
        starts : list of ndarray, shape (3, 3)
            Poses to begin with.
        fits : list of PhotometricFit
            Photometric fits from other starts, which compete with those of `starts`.
        """
        settings = self.settings
        scores = [self._score(view, start) for start in starts]
        beam = self._different(starts, scores)[: settings.beam]
        least = max([settings.least_score, *(settings.beam_share * scores[k] for k in beam)])
        for start in (starts[k] for k in beam if scores[k] >= least):
            fit = self._align_best_blur(view, start)
            fits = fits if fit is None else [*fits, fit]
        if not fits:
            return None
        scores = [fit.blocks.score() for fit in fits]
        best, *others = self._different([fit.pose for fit in fits], scores)
        inlier_ratio, moved = self._points.follow_from(view.layer(self._finest), fits[best].pose)
        return Finding(
            fit=fits[best],
            score=scores[best],
            second_score=scores[others[0]] if others else 0.0,
            second_motion_score=self._second_motion_score(view, fits[best], moved),
            inlier_ratio=inlier_ratio,
            displacement=float(np.hypot(*self.displacement(pose, fits[best].pose)) / self.side),
        )

    def corners_of(self, pose: Array) -> Array:
        """Return the corners of the template at a pose, px of the view."""
        return apply_homography(pose, self.template.sharp.corners)

    def displacement(self, before: Array, after: Array) -> Array:
        """Return how the center of the template moves from a pose to another, (x, y) in px."""
        return (self.corners_of(after) - self.corners_of(before)).mean(axis=0)

    def distance(self, pose: Array, other: Array) -> float:
        """Return the largest coordinate by which the corners of two poses differ, px."""
        return float(np.abs(self.corners_of(pose) - self.corners_of(other)).max())

    def lookalikes(self, image: Image, pose: Array) -> Array:
        """Return where else in a frame all blocks agree: offsets from the pose, k×2 (x, y) in px.

        Only the nearest places are tested.
        """
        view, least = View(image, 0.0), self.settings.lookalike_ncc
        peaks = ncc_peaks(self._blurred[0], view.layer(self._finest), pose, apart=2, least=least)
        offsets = [self.displacement(pose, peak) for peak in peaks]
        elsewhere = sorted((np.hypot(*off), *off) for off in offsets if np.hypot(*off) > 3)
        fits = [
            self.template.align(view.image, translate(pose, np.array(off)))
            for _, *off in elsewhere[: self.settings.max_matches]
        ]
        equal = [self.displacement(pose, fit.pose) for fit in fits if self.blocks_agree(fit)]
        return np.array([off for off in equal if np.hypot(*off) > 3]).reshape(-1, 2)

    def continue_photometrically(self, view: View, plain: Alignment) -> PhotometricFit | None:
        """Continue an alignment with the photometric model, unless it is not the template."""
        return None if plain.reason else self.align_photometric(view, plain.pose)

    def align_photometric(self, view: View, pose: Array, blur: int = 0) -> PhotometricFit | None:
        """Align with the photometric model at half pixels of the finest level."""
        corners = self.corners_of(pose) / self._scale
        near, first = cut_around(view.layer(self._finest), corners, _MARGIN)
        if min(near.shape) < _MARGIN:
            return None
        offset = first * self._scale
        start = translate(pose, -offset)
        fit = self._photometric[blur].align_photometric(
            half_pixel(near), start, view.noise, view.saturation
        )
        return None if fit is None else replace(fit, pose=translate(fit.pose, offset))

    def covariance(self, fit: PhotometricFit) -> Array:
        """Return the covariance of the corners (8: x, y of each), px² of the frame."""
        level = self._photometric[0]
        return corner_covariance(
            level,
            fit,
            slope=fit.psi_slope,
            transmission=level.noise**2,
            factor=self.settings.covariance_factor,
        )

    def _score(self, view: View, pose: Array, blur: int = 0) -> float:
        """Return the score of a pose from the blocks of the template in one of its blurs."""
        level = self._blurred[blur]
        grey, _, weight = level.patch(view.layer(self._finest), pose, view.saturation)
        return compare(grey, level.grey, weight, view.noise * level.noise).score()

    def _second_motion_score(self, view: View, fit: PhotometricFit, start: Array | None) -> float:
        """Return how much more some blocks agree where other points move together, nats.

        That pose only causes doubt and is never accepted: which of two parts that move differently
        is the object cannot be known.
        """
        if start is None or self._score(view, start) < self.settings.least_score:
            return 0.0
        other = self._align_best_blur(view, start)
        if other is None or not self._apart(fit.pose, other.pose):
            return 0.0
        return fit.blocks.excess_in(other.blocks)

    def _align_best_blur(self, view: View, pose: Array) -> PhotometricFit | None:
        """Align with the photometric model, with the template in the blur that agrees best."""
        return self.align_photometric(view, pose, self._best_blur(view, pose))

    def _best_blur(self, view: View, pose: Array) -> int:
        """Return the blur of the template in which the blocks agree best at a pose."""
        blurs = range(len(self._blurred))
        return max(blurs, key=lambda blur: self._score(view, pose, blur))

    def _apart(self, pose: Array, other: Array) -> bool:
        """Return whether two poses are over 3 px of the finest level apart."""
        return self.distance(pose, other) > 3 * self._scale

    def _different(self, poses: list[Array], scores: list[float]) -> list[int]:
        """Return the numbers of the poses that are apart from all better ones, the best first."""
        found: list[int] = []
        for k in sorted(range(len(poses)), key=lambda k: -scores[k]):
            if all(self._apart(poses[k], poses[n]) for n in found):
                found.append(k)
        return found
