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
from microlib.tracking._geometry import apply_homography, area, cut_around, shifted
from microlib.tracking._light import LitFit, LitLevel, make_lit
from microlib.tracking._local import LocalLevel, make_local
from microlib.tracking._sampling import View, half_pixel
from microlib.tracking._starts import Flow, PointFlow, best_matches, distortions

# What parts of the tracker are worth is in its benchmark on photographs, table "Variants".

#: Side (px) that the template has at most at the finest level of the search.
_LARGEST = 64

#: Least side (px) of a template that may deform, and of the coarser levels of the search.
_DEFORMABLE = 12

#: Standard deviations (px of the finest level) of the blurs that are tried.
_BLURS = (0.0, 1.0, 1.6, 2.5)

#: Standard deviation (px) of the blur whose effect on the template is a column of its light.
_LITTLE = 0.8

#: How much more, as a factor and in nats, a blurred template must say to be taken.
_BLURRED = (1.1, 1.0)

#: Reach (sides of the template) of the flow of its points.
_REACH = 1.0

#: Most steps at half the resolution, and how many places are looked at where the template
#: correlates best.
_STEPS, _PLACES = 15, 6

#: Corner step (px of the level) that ends a coarse level.
_TOLERANCE = 0.15

#: Most steps of the distant starts at a quarter of the resolution, and how many of them go on.
_FAR_STEPS, _FAR = 10, 3

#: Starts that are compared in every blur.
_HOPEFUL = 3

#: Nats below which no start is finished: no template that was there had less.
_HOPELESS = 1.0

#: Distance (px) of the corners beyond which a pose is another one, and no error of the same.
_OTHER = 3.0

#: Standard deviation (sides of the template) of the motion between frames, a priori.
_MOTION = 0.3

#: Share of the nats of the local alignment that the smooth light must keep to be preferred.
_KEPT = 0.95

#: Margin (px) around the template in which it is aligned at half pixels.
_MARGIN = 8.0

#: What the covariance of a fit in smooth light is short of: hidden parts whose border counts a
#: little, and a blur between those tried. Measured on development images.
_UNMODELED = 1.3


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
        Nats in which the blocks agree, less those of the motion; and those of the best pose
        elsewhere.
    support : float
        Share of the template's points that stay when they are followed from the pose.
    area : float
        Logarithm of the area's ratio, without sign.
    """

    fit: LitFit
    score: float
    rival: float
    support: float
    area: float


class RobustSearch:
    """A template at the resolutions of the robust attempts."""

    def __init__(
        self,
        view: View,
        box: tuple[int, int, int, int],
        pose: Array,
        motion: str,
    ) -> None:
        width, height = box[2:]
        self._finest = max(0, int(np.ceil(np.log2(max(width, height) / _LARGEST))))
        self._scale = 2.0**self._finest
        self._motion = _MOTION * max(width, height)
        cut = partial(make_local, box=box, pose=pose, motion=motion, finest=self._finest)
        fine = view.layer(self._finest)
        #: From the finest level on, halved while the template may deform.
        halvings = [self._finest]
        while len(halvings) < 3 and min(width, height) >= _DEFORMABLE << (halvings[-1] + 1):
            halvings.append(halvings[-1] + 1)
        self._half, self._quarter = halvings[min(1, len(halvings) - 1)], halvings[-1]
        coarse = {k: cut(view.layer(k), halvings=k, smoothing=1.0) for k in halvings}
        self._coarse = coarse[self._half]
        self._coarsest = coarse[self._quarter]
        self._wide: list[LocalLevel] = []
        self._sharp: list[LocalLevel] = []
        self._lit: list[LitLevel] = []
        for blur in _BLURS:
            image = cv2.GaussianBlur(fine, (0, 0), blur) if blur else fine
            self._wide.append(cut(image, halvings=self._finest, smoothing=1.0))
            self._sharp.append(cut(image, halvings=self._finest, smoothing=0.6))
            lit, blurrier = (
                cut(half_pixel(one), halvings=self._finest, smoothing=0.6, density=2)
                for one in (image, cv2.GaussianBlur(image, (0, 0), _LITTLE))
            )
            self._lit.append(make_lit(lit, blurrier))
        self._corners = self._coarse.corners
        reach = int(_REACH * max(width, height)) >> self._finest
        self._points = PointFlow(self._wide[0], fine, pose, reach)
        self._distortions = distortions(self._corners, motion)

    def follow(self, view: View, pose: Array) -> Flow:
        """Return where the points of the template flow to from a pose."""
        return self._points.follow(view.layer(self._finest), pose)

    def places(self, view: View, pose: Array) -> list[Array]:
        """Return the pose shifted to where the template correlates best in the view."""
        return best_matches(self._coarsest, view.layer(self._quarter), pose, _PLACES)

    def far_starts(self, view: View, pose: Array) -> list[Array]:
        """Return the best of a pose that is distorted, or shifted to the best matches.

        They are aligned for some steps at a quarter of the resolution, and the template's points
        followed from the best one.
        """
        starts = [pose @ warp for warp in self._distortions] + self.places(view, pose)
        begun = self._aligned(view, self._coarsest, self._quarter, starts, _FAR_STEPS)
        best = [one.pose for one in self._different(sorted(begun, key=_score, reverse=True))[:_FAR]]
        return best + [pose for start in best[:1] for pose in self.follow(view, start).poses[:1]]

    def search(
        self, view: View, pose: Array, starts: Sequence[Array], *, near: bool = True
    ) -> Finding | None:
        """Return the best pose that the starts lead to, or None if none is any good.

        Parameters
        ----------
        view : View
            The frame.
        pose : ndarray, shape (3, 3)
            Where the template should be.
        starts : sequence of ndarray, shape (3, 3)
            Poses to begin with.
        near : bool
            Whether far from `pose` is unlikely.
        """
        start = self._at(pose)

        def score(one: Candidate) -> float:
            off = self._at(one.pose).mean(axis=0) - start.mean(axis=0)
            return one.score - (float(off @ off) / (2 * self._motion**2) if near else 0.0)

        begun = self._aligned(view, self._coarse, self._half, starts, _STEPS)
        begun += self._judged(view, self._wide[0], starts)
        found = self._different(sorted(begun, key=score, reverse=True))
        hopeful = [self._blurred(view, one) for one in found[:_HOPEFUL]]
        if max(map(score, hopeful), default=0.0) < _HOPELESS:
            return None
        best = self._finished(view, max(hopeful, key=score))
        if best.fit is None:
            return None
        corners = self._at(best.pose)
        elsewhere = [
            score(one)
            for one in [*hopeful, *found]
            if np.abs(self._at(one.pose) - corners).max() > _OTHER * self._scale
        ]
        return Finding(
            fit=best.fit,
            score=score(best),
            rival=max(elsewhere, default=0.0),
            support=self.follow(view, best.pose).support(best.pose),
            area=abs(float(np.log(max(float(area(corners) / area(start)), 1e-9)))),
        )

    def polish(self, view: View, pose: Array, blur: int = 0) -> LitFit | None:
        """Align in smooth light at half pixels of the finest level."""
        level, image = self._lit[blur], view.layer(self._finest)
        near, first = cut_around(image, self._at(pose) / self._scale, _MARGIN)
        if min(near.shape) < _MARGIN:
            return None
        offset = first * self._scale
        fit = level.align_lit(
            half_pixel(near),
            shifted(pose, -offset),
            noise=view.noise,
            ceiling=view.ceiling,
            iterations=6,
            tolerance=0.02,
        )
        return None if fit is None else replace(fit, pose=shifted(fit.pose, offset))

    def covariance(self, fit: LitFit) -> Array:
        """Return the covariance of the corners (8: x, y of each), px² of the frame."""
        level = self._lit[0]
        return corner_covariance(level, fit, fit.slope, level.noise**2, _UNMODELED)

    def _at(self, pose: Array) -> Array:
        return apply_homography(pose, self._corners)

    def _aligned(
        self,
        view: View,
        level: LocalLevel,
        halvings: int,
        starts: Sequence[Array],
        steps: int,
    ) -> list[Candidate]:
        """Return starts aligned in local illumination, judged at the finest level."""
        poses = level.align_locally(
            view.layer(halvings),
            starts,
            noise=view.noise,
            ceiling=view.ceiling,
            iterations=steps,
            tolerance=_TOLERANCE,
        )
        return self._judged(view, self._wide[0], poses)

    def _judged(
        self, view: View, level: LocalLevel, poses: Sequence[Array], blur: int = 0
    ) -> list[Candidate]:
        if not len(poses):
            return []
        image = view.layer(self._finest)
        said = level.agreement(image, np.array(poses), view.noise, view.ceiling)
        scores = np.atleast_1d(said.score)
        return [
            Candidate(pose, float(score), blur) for pose, score in zip(poses, scores, strict=True)
        ]

    def _different(self, ranked: list[Candidate]) -> list[Candidate]:
        """Return those that are not the same as a better one."""
        found: list[Candidate] = []
        for one in ranked:
            off = [
                float(np.abs(self._at(other.pose) - self._at(one.pose)).max()) for other in found
            ]
            if min(off, default=np.inf) > _OTHER * self._scale:
                found.append(one)
        return found

    def _blurred(self, view: View, one: Candidate) -> Candidate:
        """Return the pose with the blur of which the blocks say most."""
        tried = [
            self._judged(view, level, [one.pose], blur)[0]
            for blur, level in enumerate(self._wide)
            if blur
        ]
        best = max(tried, key=_score)
        return best if best.score > _BLURRED[0] * one.score + _BLURRED[1] else one

    def _finished(self, view: View, one: Candidate) -> Candidate:
        """Return a start aligned to the end: locally, and in smooth light."""
        blur, image, poses = one.blur, view.layer(self._finest), [one.pose]
        tried = self._judged(view, self._sharp[blur], poses, blur)
        for level, tolerance in ((self._wide[blur], 0.1), (self._sharp[blur], 0.03)):
            poses = level.align_locally(
                image,
                poses,
                noise=view.noise,
                ceiling=view.ceiling,
                iterations=10,
                tolerance=tolerance,
            )
        tried += self._judged(view, self._sharp[blur], poses, blur)
        best = max(tried, key=_score)
        starts = [best, tried[0]] if blur and best is not tried[0] else [best]
        polished = [self._polished(view, start.pose, blur) for start in starts]
        kept = [p for p in polished if p is not None and p.score > _KEPT * best.score]
        return max(kept, key=_score, default=best)

    def _polished(self, view: View, pose: Array, blur: int) -> Candidate | None:
        fit = self.polish(view, pose, blur)
        return None if fit is None else Candidate(fit.pose, float(fit.agreement.score), blur, fit)


def _score(one: Candidate) -> float:
    return one.score
