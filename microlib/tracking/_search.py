"""The robust attempts: at a template that is partly hidden, in another light, or far away.

Every start is aligned in local illumination, all as one stack at half the resolution; the best ones
go on, with the template as blurred as the frame, and end in smooth light. What the blocks agree in,
beyond chance, ranks the poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from microlib._common import Array
from microlib.tracking._covariance import corner_covariance
from microlib.tracking._geometry import TINY, apply_homography, area, cut_around, shifted
from microlib.tracking._light import LitFit, LitLevel, make_lit
from microlib.tracking._local import LocalLevel, make_local
from microlib.tracking._sampling import View, half_pixel
from microlib.tracking._settings import Settings
from microlib.tracking._starts import PointFlow, best_matches, distortions

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
    fit: LitFit | None = None


@dataclass(frozen=True, eq=False)
class Finding:
    """The best pose that a search found.

    Attributes
    ----------
    fit : LitFit
        Pose, light, weights and residuals.
    score, rival : float
        Nats in which the blocks agree; and those of the best pose elsewhere that was followed to
        the end, too.
    support : float
        Share of the template's points that stay when they are followed from the pose.
    area : float
        Logarithm of the area's ratio, without sign.
    far : bool
        Whether the starts were far from the last pose.
    """

    fit: LitFit
    score: float
    rival: float
    support: float
    area: float
    far: bool


class RobustSearch:
    """A template at the resolutions of the robust attempts."""

    def __init__(
        self,
        view: View,
        box: tuple[int, int, int, int],
        pose: Array,
        motion: str,
        settings: Settings,
    ) -> None:
        width, height = box[2:]
        self._settings = settings
        self._finest = max(0, int(np.ceil(np.log2(max(width, height) / settings.largest))))
        self._scale = 2.0**self._finest
        cut = partial(make_local, box=box, pose=pose, motion=motion, finest=self._finest)
        fine = view.layer(self._finest)
        #: From the finest level on, halved while the template keeps 12 px and may deform.
        halvings = [self._finest]
        while len(halvings) < 3 and min(width, height) >= 12 << (halvings[-1] + 1):
            halvings.append(halvings[-1] + 1)
        coarse = [cut(view.layer(k), halvings=k, smoothing=1.0) for k in halvings]
        self._coarse, self._coarsest = coarse[min(1, len(coarse) - 1)], coarse[-1]
        self._wide: list[LocalLevel] = []
        self._sharp: list[LocalLevel] = []
        self._lit: list[LitLevel] = []
        for blur in settings.blurs:
            image = cv2.GaussianBlur(fine, (0, 0), blur) if blur else fine
            self._wide.append(cut(image, halvings=self._finest, smoothing=1.0))
            self._sharp.append(cut(image, halvings=self._finest, smoothing=_SHARP))
            sharp, blurred = (
                cut(half_pixel(one), halvings=self._finest, smoothing=_SHARP, density=2)
                for one in (image, cv2.GaussianBlur(image, (0, 0), 0.8))
            )
            self._lit.append(make_lit(sharp, blurred, settings.knots))
        self._corners = self._coarse.corners
        reach = max(width, height) >> self._finest
        self._points = PointFlow(self._wide[0], fine, pose, reach)
        self._distortions = distortions(self._corners, motion, settings.distortion)

    def flowing(self, view: View, pose: Array) -> list[Array]:
        """Return the poses to which most points of the template flow, at most two."""
        image = view.layer(self._finest)
        return self._points.poses(image, pose) if self._settings.points else []

    def places(self, view: View, pose: Array) -> list[Array]:
        """Return the pose shifted to where the template correlates best in the view."""
        layer = view.layer(self._coarsest.halvings)
        return best_matches(self._coarsest, layer, pose, self._settings.places)

    def far_starts(self, view: View, pose: Array) -> list[Array]:
        """Return the best of a pose that is distorted, or shifted to the best matches.

        They are aligned for some steps at a quarter of the resolution, and the template's points
        followed from the best one.
        """
        starts = [pose @ warp for warp in self._distortions] + self.places(view, pose)
        begun = self._aligned(view, self._coarsest, starts, 10)
        best = [one.pose for one in self._different(begun)[: self._settings.far]]
        return best + [pose for start in best[:1] for pose in self.flowing(view, start)[:1]]

    def search(
        self, view: View, pose: Array, starts: Sequence[Array], *, far: bool
    ) -> Finding | None:
        """Return the best pose that the starts lead to, or None if none is any good.

        Parameters
        ----------
        view : View
            The frame.
        pose : ndarray, shape (3, 3)
            Where the template was.
        starts : sequence of ndarray, shape (3, 3)
            Poses to begin with.
        far : bool
            Whether they are far from it.
        """
        settings = self._settings
        begun = self._aligned(view, self._coarse, starts, 15)
        begun += self._judged(view, self._wide[0], starts)
        hopeful = self._different(begun)[: settings.hopeful]
        if not hopeful or hopeful[0].score < settings.hopeless:
            return None
        least = settings.rivaling * hopeful[0].score
        hopeful = self._blurred(view, [one for one in hopeful if one.score >= least])
        ended = [
            end
            for blur in {one.blur for one in hopeful}
            for end in self._finished(view, blur, [one.pose for one in hopeful if one.blur == blur])
        ]
        if not ended:
            return None
        best, *others = self._different(ended)
        assert best.fit is not None
        corners = [apply_homography(one, self._corners) for one in (best.pose, pose)]
        return Finding(
            fit=best.fit,
            score=best.score,
            rival=others[0].score if others else 0.0,
            support=self._points.support(view.layer(self._finest), best.pose),
            area=abs(float(np.log(max(float(area(corners[0]) / area(corners[1])), TINY)))),
            far=far,
        )

    def polish(self, view: View, pose: Array, blur: int = 0) -> LitFit | None:
        """Align in smooth light at half pixels of the finest level."""
        corners = apply_homography(pose, self._corners) / self._scale
        near, first = cut_around(view.layer(self._finest), corners, _MARGIN)
        if min(near.shape) < _MARGIN:
            return None
        offset = first * self._scale
        start = shifted(pose, -offset)
        fit = self._lit[blur].align_lit(half_pixel(near), start, view.noise, view.ceiling)
        return None if fit is None else replace(fit, pose=shifted(fit.pose, offset))

    def covariance(self, fit: LitFit) -> Array:
        """Return the covariance of the corners (8: x, y of each), px² of the frame."""
        level, unmodeled = self._lit[0], self._settings.unmodeled * (1 + fit.hidden.mean())
        return corner_covariance(level, fit, fit.slope, level.noise**2, unmodeled)

    def _aligned(
        self, view: View, level: LocalLevel, starts: Sequence[Array], steps: int
    ) -> list[Candidate]:
        """Return starts aligned in local illumination, judged at the finest level."""
        poses = level.align_locally(view, starts, iterations=steps, tolerance=0.15)
        return self._judged(view, self._wide[0], poses)

    def _judged(
        self, view: View, level: LocalLevel, poses: Sequence[Array], blur: int = 0
    ) -> list[Candidate]:
        if not len(poses):
            return []
        scores = level.blocks(view, np.array(poses)).score()
        return [
            Candidate(pose, float(score), blur) for pose, score in zip(poses, scores, strict=True)
        ]

    def _different(self, candidates: list[Candidate]) -> list[Candidate]:
        """Return the candidates, best first, that are more than 3 px from each better one."""
        found: list[Candidate] = []
        corners = np.empty((0, 4, 2))
        for one in sorted(candidates, key=lambda one: -one.score):
            own = apply_homography(one.pose, self._corners)
            if (np.abs(corners - own).max(axis=(1, 2)) > 3 * self._scale).all():
                found.append(one)
                corners = np.concatenate([corners, own[None]])
        return found

    def _blurred(self, view: View, starts: list[Candidate]) -> list[Candidate]:
        """Return each start with the blur of which the blocks say most."""
        factor, nats = self._settings.blurred
        poses, found = [one.pose for one in starts], list(starts)
        for blur, level in enumerate(self._wide[1:], 1):
            for k, one in enumerate(self._judged(view, level, poses, blur)):
                if one.score > max(factor * starts[k].score + nats, found[k].score):
                    found[k] = one
        return found

    def _finished(self, view: View, blur: int, starts: Sequence[Array]) -> list[Candidate]:
        """Return starts of one blur aligned to the end: locally, and in smooth light."""
        poses = self._wide[blur].align_locally(view, starts)
        poses = self._sharp[blur].align_locally(view, poses, tolerance=0.03)
        ended = []
        # A blur may leave less to align than the start had: then that is the better one.
        for pose in [*poses, *(starts if blur else [])]:
            fit = self.polish(view, pose, blur)
            if fit is not None:
                ended.append(Candidate(fit.pose, float(fit.blocks.score()), blur, fit))
        return ended
