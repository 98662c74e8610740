"""The robust attempts: at a template that is partly hidden, in another light, or far away.

Distant starts are aligned at the coarsest level first. The starts in which the blocks of the
template agree best, beyond chance, go on, with the template as blurred as the frame, and end in
smooth light; the agreement of the blocks ranks the poses there, too.
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
class Candidate:
    """A pose, what the blocks say of it, and the template's blur; with a fit at the end."""

    pose: Array
    score: float
    blur: int = 0
    fit: PhotometricFit | None = None


@dataclass(frozen=True, eq=False)
class Finding:
    """The best pose that a search found.

    Attributes
    ----------
    fit : PhotometricFit
        Pose, light, weights and residuals.
    score, second_score : float
        Nats in which the blocks agree; and those of the best pose elsewhere that was followed to
        the end, too.
    inlier_ratio : float
        Share of the template's points that stay when they are followed from the pose.
    moved : float
        Distance of the center from the expected one, in sides of the template.
    """

    fit: PhotometricFit
    score: float
    second_score: float
    inlier_ratio: float
    moved: float


class RobustSearch:
    """A template at the resolutions of the robust attempts."""

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
        settings, self.side = self.settings, max(width, height)
        self._finest = max(0, int(np.ceil(np.log2(max(width, height) / settings.largest))))
        self._scale = 2.0**self._finest
        cut = partial(make_level, box=box, pose=pose, motion=motion)
        fine = view.layer(self._finest)
        #: Halved twice more while the template keeps 12 px and may deform.
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
        self._corners = template.sharp.corners
        reach = max(width, height) >> self._finest
        self._points = PointFlow(self._blurred[0], fine, pose, reach)
        self._distortions = distortions(motion, settings.distortion)
        self.own_lookalikes = self.lookalikes(view.image, pose)

    def is_enough(self, agreement: Agreement) -> bool:
        """Return whether the blocks of the template agree, and have enough texture to say so."""
        most_agree = agreement.agreeing >= self.settings.agreed
        return most_agree and agreement.texture >= self.settings.texture

    def flow_poses(self, view: View, pose: Array) -> list[Array]:
        """Return the poses to which most points of the template flow, at most two."""
        return self._points.poses(view.layer(self._finest), pose)

    def match_poses(self, view: View, pose: Array) -> list[Array]:
        """Return the pose translated to where the template correlates best in the view."""
        layer, apart = view.layer(self._halvings), min(self._coarse.grey.shape) // 4
        return ncc_peaks(self._coarse, layer, pose, apart=apart)[: self.settings.places]

    def align_coarsely(self, view: View, pose: Array) -> Alignment:
        """Align from a pose at the coarsest level."""
        layer = view.layer(self._halvings)
        return self._coarse.align(layer, pose, tolerance=0.3, iterations=5)

    def far_poses(self, view: View, pose: Array) -> list[Array]:
        """Return the best of a pose that is distorted, or translated to the best matches.

        They are aligned at the coarsest level, and the template's points followed from the best.
        """
        starts = [pose @ warp for warp in self._distortions] + self.match_poses(view, pose)
        aligned = self.align_starts(view, starts)
        return aligned + [far for start in aligned[:1] for far in self.flow_poses(view, start)[:1]]

    def align_starts(self, view: View, starts: list[Array]) -> list[Array]:
        """Return where the best starts lead, aligned at the coarsest level and the finest."""
        fits = [self.align_coarsely(view, start) for start in starts]
        ranked = [Candidate(fit.pose, fit.correlation) for fit in fits if not fit.failure]
        coarse = self._different(ranked)[: self.settings.beam]
        fine, layer = self._blurred[0], view.layer(self._finest)
        return [fine.align(layer, one.pose, tolerance=0.3).pose for one in coarse]

    def search(
        self, view: View, pose: Array, starts: list[Array], fits: list[PhotometricFit]
    ) -> Finding | None:
        """Return the best pose that the starts lead to, or None if none is any good.

        Parameters
        ----------
        view : View
            The frame.
        pose : ndarray, shape (3, 3)
            Where the template is expected.
        starts : list of ndarray, shape (3, 3)
            Poses to begin with.
        fits : list of PhotometricFit
            Alignments that are complete.
        """
        settings = self.settings
        ended = [Candidate(fit.pose, fit.blocks.score(), fit=fit) for fit in fits]
        beam = self._different([self._judged(view, start) for start in starts])[: settings.beam]
        least = max(
            settings.least_score, settings.beam_share * max((one.score for one in beam), default=0)
        )
        for one in self._with_best_blur(view, [one for one in beam if one.score >= least]):
            fit = self.polish(view, one.pose, one.blur)
            if fit is not None:
                ended.append(Candidate(fit.pose, fit.blocks.score(), one.blur, fit))
        if not ended:
            return None
        best, *others = self._different(ended)
        assert best.fit is not None
        return Finding(
            fit=best.fit,
            score=best.score,
            second_score=others[0].score if others else 0.0,
            inlier_ratio=self._points.inlier_ratio(view.layer(self._finest), best.pose),
            moved=float(np.hypot(*self.moved(pose, best.pose)) / self.side),
        )

    def corners_of(self, pose: Array) -> Array:
        """Return the corners of the template at a pose, px of the view."""
        return apply_homography(pose, self._corners)

    def moved(self, before: Array, after: Array) -> Array:
        """Return how the center of the template moves from a pose to another, (x, y) in px."""
        return (self.corners_of(after) - self.corners_of(before)).mean(axis=0)

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

    def lookalikes(self, image: Image, pose: Array) -> Array:
        """Return where else in a frame all blocks agree: offsets from the pose, k×2 (x, y) in px.

        Only the nearest places are tested.
        """
        view, least = View(image, 0.0), self.settings.alike
        peaks = ncc_peaks(self._blurred[0], view.layer(self._finest), pose, apart=2, least=least)
        offsets = [self.moved(pose, peak) for peak in peaks]
        elsewhere = sorted((np.hypot(*off), *off) for off in offsets if np.hypot(*off) > 3)
        fits = [
            self.template.align(view.image, translate(pose, np.array(off)))
            for _, *off in elsewhere[: self.settings.places]
        ]
        equal = [self.moved(pose, fit.pose) for fit in fits if self.blocks_agree(fit)]
        return np.array([off for off in equal if np.hypot(*off) > 3]).reshape(-1, 2)

    def polish(self, view: View, pose: Array, blur: int = 0) -> PhotometricFit | None:
        """Align in smooth light at half pixels of the finest level."""
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
        return corner_covariance(level, fit, fit.slope, level.noise**2, self.settings.unmodeled)

    def _judged(self, view: View, pose: Array, blur: int = 0) -> Candidate:
        """Return a pose with the score of the blocks of the template in one of its blurs."""
        level = self._blurred[blur]
        grey, _, share = level.patch(view.layer(self._finest), pose, view.saturation)
        blocks = compare(grey, level.grey, share, view.noise * level.noise)
        return Candidate(pose, blocks.score(), blur)

    def _different(self, candidates: list[Candidate]) -> list[Candidate]:
        """Return the candidates, best first, that are more than 3 px from each better one."""
        found: list[Candidate] = []
        corners = np.empty((0, 4, 2))
        for one in sorted(candidates, key=lambda one: -one.score):
            own = self.corners_of(one.pose)
            if (np.abs(corners - own).max(axis=(1, 2)) > 3 * self._scale).all():
                found.append(one)
                corners = np.concatenate([corners, own[None]])
        return found

    def _with_best_blur(self, view: View, starts: list[Candidate]) -> list[Candidate]:
        """Return each start with the blur of the template in which the blocks agree best."""
        blurs = range(len(self._blurred))
        return [
            max((self._judged(view, one.pose, blur) for blur in blurs), key=lambda one: one.score)
            for one in starts
        ]
