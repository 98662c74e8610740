"""The search for a template that is partly hidden, in another light, or not there at all.

Blocks of the template vote for shifts; the best shifts are refined in local illumination, first at
half the resolution, then with the template as blurred as the frame; a last alignment takes light,
blur and tone as smooth. What the blocks agree in, beyond chance, ranks the poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._covariance import (
    corner_jacobian,
    lag_between,
    sandwich,
    squared_frequency,
)
from microlib.tracking._esm import apply_homography, area, cut_around, half_pixel, pyramid, shifted
from microlib.tracking._light import LitFit, LitLevel, make_lit
from microlib.tracking._local import LocalLevel, make_local

# The benchmark of tracking in bad light, table "Constants", says what the following are worth.

#: Side (px) that the template has at most at the finest level of the search.
_LARGEST = 64

#: Least side (px) of a template that may deform, and of the coarser level of the search.
_DEFORMABLE = 12

#: Standard deviations (px of the finest level) of the blurs that are tried.
_BLURS = (0.0, 1.0, 1.6, 2.5)

#: Standard deviation (px) of the blur whose effect on the template is a column of its light.
_LITTLE = 0.8

#: How much more, as a factor and in nats, a blurred template must say to be taken.
_BLURRED = (1.1, 1.0)

#: Reach (sides of the template) of the blocks' votes, smoothing of their sum and distance of its
#: peaks (px), and how many of them are tried.
_REACH, _PEAK, _APART, _PEAKS = 0.5, 1.0, 3, 6

#: Most steps of the coarser level; of more starts than so many, the best ones after some steps at
#: half its resolution.
_COARSE_STEPS, _MANY, _FIRST_STEPS = 15, 10, 10

#: Starts that are finished, the share of the best one's nats they need, and how far apart (px)
#: their corners must be to be two.
_FINISHED, _RIVALING, _DIFFERENT = 3, 0.4, 1.5

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

#: Residual, in the noise, that no other blur could explain better.
_EXPLAINED = 1.2

#: Reach (px) of the blocks when they fit the deformation, before and after an alignment.
_FIT, _REFIT = 5, 3


@dataclass(frozen=True)
class Finding:
    """The best pose that the search found.

    Attributes
    ----------
    pose : ndarray, shape (3, 3)
        Normalized template coordinates to px of the image.
    score : float
        Nats in which the blocks agree, less those of the motion.
    rival : float
        The same of the best pose elsewhere.
    share : float
        Share of the blocks that agree in anything.
    fit : LitFit or None
        Light, weights and residuals; none if only local illumination explains the frame.
    blur : int
        Index of the template's blur.
    motion, deformation : float
        Of the corners since the start: of their mean, and root mean square about it, px.
    area : float
        Logarithm of the area's ratio, without sign.
    """

    pose: Array
    score: float
    rival: float
    share: float
    fit: LitFit | None
    blur: int
    motion: float
    deformation: float
    area: float


@dataclass(frozen=True)
class _Pose:
    pose: Array
    score: float
    share: float
    blur: int
    fit: LitFit | None = None


@dataclass(frozen=True)
class _View:
    """A frame as the search sees it."""

    coarse: Image
    fine: Image
    noise: float
    ceiling: float


class RobustSearch:
    """The levels of a template for the robust search, and the search."""

    def __init__(
        self,
        image: Image,
        box: tuple[int, int, int, int],
        pose: Array,
        motion: str,
        mask: Image,
    ) -> None:
        width, height = box[2:]
        self.finest = max(0, int(np.ceil(np.log2(max(width, height) / _LARGEST))))
        layers = pyramid(image, self.finest + 3)
        self.coarsest = self.finest + 1
        if min(width, height) < _DEFORMABLE * 2**self.coarsest:
            self.coarsest = self.finest
        self._motion = _MOTION * max(width, height)
        self._reach = int(_REACH * max(width, height)) >> self.finest

        def cut(image: Image, halvings: int, smoothing: float, density: int = 1) -> LocalLevel:
            return make_local(
                image,
                box,
                pose,
                halvings=halvings,
                finest=self.finest,
                smoothing=smoothing,
                motion=motion,
                mask=mask,
                density=density,
            )

        self._coarse = cut(layers[self.coarsest], self.coarsest, 1.0)
        self._first = self._coarse
        if min(width, height) >= _DEFORMABLE << (self.coarsest + 1):
            self._first = cut(layers[self.coarsest + 1], self.coarsest + 1, 1.0)
        self._wide: list[LocalLevel] = []
        self._sharp: list[LocalLevel] = []
        self._lit: list[LitLevel] = []
        for blur in _BLURS:
            image = layers[self.finest]
            if blur:
                image = cv2.GaussianBlur(image, (0, 0), blur)
            self._wide.append(cut(image, self.finest, 1.0))
            self._sharp.append(cut(image, self.finest, 0.6))
            lit, blurrier = (
                cut(half_pixel(one), self.finest, 0.6, 2)
                for one in (image, cv2.GaussianBlur(image, (0, 0), _LITTLE))
            )
            self._lit.append(make_lit(lit, blurrier))
        sharpest = self._lit[0].local
        self._lattice = sharpest.lattice()
        self._fineness = squared_frequency(
            sharpest.slope.reshape(2, *sharpest.grey.shape).astype(np.float64)
        )
        self._corners = self._coarse.level.corners
        self._scale = 2.0**self.finest

    def polish(
        self, fine: Image, pose: Array, noise: float, ceiling: float, blur: int = 0
    ) -> LitFit | None:
        """Align in smooth light on an image of the finest level."""
        level = self._lit[blur]
        near, first = cut_around(fine, self._at(pose) / self._scale, _MARGIN)
        if min(near.shape) < _MARGIN:
            return None
        offset = first * self._scale
        half = half_pixel(near)
        near_pose = shifted(pose, -offset)
        trust = np.ascontiguousarray(level.local.trust(half, near_pose, noise, ceiling))
        fit = level.align(
            half, near_pose, trust, noise=noise, ceiling=ceiling, iterations=6, tolerance=0.02
        )
        return None if fit is None else replace(fit, pose=shifted(fit.pose, offset))

    @property
    def kept_noise(self) -> float:
        """Standard deviation that unit white noise has in the residuals of a fit."""
        return self._lit[0].local.noise

    def corner_covariance(self, fit: LitFit) -> Array:
        """Return the covariance of the corners (8: x, y of each), px² of the frame."""
        level = self._lit[0].local
        weight, residual = fit.weight.ravel(), fit.residual.ravel()
        n = len(level.basis)
        kept = (level.noise**2, level.noise**2)
        covariance = sandwich(
            fit.design, residual, weight, fit.slope.ravel(), kept, fit.weight.shape, n
        )
        jacobian = corner_jacobian(fit.pose, level.level.basis, self._corners)
        places = apply_homography(fit.pose, self._lattice) / self._scale
        lag = np.tile(lag_between(places) * self._fineness, 4) * self._scale
        return _UNMODELED * jacobian.T @ covariance @ jacobian + np.outer(lag, lag)

    def search(
        self,
        layers: list[Image],
        pose: Array,
        others: Sequence[Array],
        noise: float,
        ceiling: float,
        *,
        near: bool = True,
        vote: bool = True,
        hopeless: float = _HOPELESS,
    ) -> Finding | None:
        """Return the best pose, or None if no start leads to any.

        Parameters
        ----------
        layers : list of ndarray
            The frame and its halves.
        pose : ndarray, shape (3, 3)
            Where the template should be.
        others : sequence of ndarray
            Further starts.
        noise, ceiling : float
            Of the frame.
        near : bool
            Whether far from `pose` is unlikely.
        vote : bool
            Whether the blocks' votes give starts, too.
        hopeless : float
            Nats below which no start is finished.
        """
        view = _View(layers[self.coarsest], layers[self.finest], noise, ceiling)
        starts = [pose, *others, *(self._peaks(view, pose) if vote else [])]
        found = self._refined(view, starts)
        spent = self._spent(pose) if near else lambda _: 0.0
        hopeful = [self._blurred(view, one) for one in found[:_FINISHED]]
        best = max((one.score for one in hopeful), default=0.0)
        if best < hopeless:
            return None
        finished = [self._finished(view, one) for one in hopeful if one.score > _RIVALING * best]
        finished.sort(key=lambda one: spent(one.pose) - one.score)
        first = self._reblurred(view, finished[0])
        corners = self._at(first.pose)
        rivals = [
            one.score - spent(one.pose)
            for one in [*finished[1:], *found]
            if np.abs(self._at(one.pose) - corners).max() > _OTHER * self._scale
        ]
        start = self._at(pose)
        moved = corners - start
        shift = moved.mean(axis=0)
        return Finding(
            pose=first.pose,
            score=first.score - spent(first.pose),
            rival=max(rivals, default=0.0),
            share=first.share,
            fit=first.fit,
            blur=first.blur,
            motion=float(np.hypot(*shift)),
            deformation=float(np.sqrt(((moved - shift) ** 2).sum(axis=1).mean())),
            area=abs(float(np.log(max(area(corners) / area(start), 1e-9)))),
        )

    def _at(self, pose: Array) -> Array:
        return apply_homography(pose, self._corners)

    def _spent(self, pose: Array) -> Callable[[Array], float]:
        """Return the nats that a motion costs."""
        start = self._at(pose).mean(axis=0)

        def cost(other: Array) -> float:
            off = self._at(other).mean(axis=0) - start
            return float(off @ off) / (2 * self._motion**2)

        return cost

    def _peaks(self, view: _View, pose: Array) -> list[Array]:
        """Return the pose shifted to where most blocks agree."""
        level = self._wide[0]
        each = level.votes(view.fine, pose, self._reach, view.noise)
        near = np.ones((3, 3), np.uint8)  # between the pixels, and where the template is deformed
        votes = np.sum([cv2.dilate(v, near) for v in each.reshape(-1, *each.shape[2:])], axis=0)
        votes = cv2.GaussianBlur(votes, (0, 0), _PEAK, borderType=cv2.BORDER_CONSTANT)
        size = 2 * _APART + 1
        peaks = (votes == cv2.dilate(votes, np.ones((size, size), np.uint8))) & (votes > 0)
        rows, columns = np.nonzero(peaks)
        best = np.argsort(-votes[rows, columns])[:_PEAKS]
        return [
            _shifted_before(pose, level, columns[k] - self._reach, rows[k] - self._reach)
            for k in best
        ]

    def _refined(self, view: _View, starts: list[Array]) -> list[_Pose]:
        """Return the starts aligned at the coarser level, those that differ, the best first."""
        if len(starts) > _MANY:  # a few steps tell the better ones
            begun = self._coarsely(view, starts, _FIRST_STEPS, self._first)
            starts = [one.pose for one in sorted(begun, key=lambda one: -one.score)[:_MANY]]
        aligned = self._coarsely(view, starts, _COARSE_STEPS, self._coarse)
        found: list[_Pose] = []
        limit = _DIFFERENT * self._scale
        for one in sorted(aligned, key=lambda one: -one.score):
            corners = self._at(one.pose)
            if all(np.abs(self._at(other.pose) - corners).max() > limit for other in found):
                found.append(one)
        return found

    def _coarsely(
        self, view: _View, starts: Sequence[Array], steps: int, level: LocalLevel
    ) -> list[_Pose]:
        """Return the starts aligned at a coarser level, but for those that diverge."""
        aligned = []
        image = view.coarse if level is self._coarse else cv2.pyrDown(view.coarse)
        for start in starts:
            pose = level.align(
                image,
                start,
                noise=view.noise,
                ceiling=view.ceiling,
                iterations=steps,
                tolerance=0.15,
            )
            if pose is not None:
                aligned.append(self._judged(view, pose, self._wide[0], 0))
        return aligned

    def _judged(self, view: _View, pose: Array, level: LocalLevel, blur: int) -> _Pose:
        said = level.agreement(view.fine, pose, view.noise, view.ceiling)
        return _Pose(pose, said.score, said.share, blur)

    def _blurred(self, view: _View, one: _Pose) -> _Pose:
        """Return the pose with the blur of which the blocks say most."""
        tried = [
            self._judged(view, one.pose, level, blur)
            for blur, level in enumerate(self._wide)
            if blur
        ]
        best = max(tried, key=lambda other: other.score, default=one)
        return best if best.score > _BLURRED[0] * one.score + _BLURRED[1] else one

    def _finished(self, view: _View, one: _Pose) -> _Pose:
        """Return a start aligned to the end: locally, by its blocks, and in smooth light."""
        blur = one.blur
        wide, sharp = self._wide[blur], self._sharp[blur]
        moved = wide.fit_blocks(view.fine, one.pose, _FIT, view.noise)
        one = max(one, self._judged(view, moved, wide, blur), key=lambda other: other.score)
        tried = [self._judged(view, one.pose, sharp, blur)]
        pose: Array | None = one.pose
        for again in (True, False):
            for level, tolerance in ((wide, 0.1), (sharp, 0.03)):
                if pose is not None:
                    pose = level.align(
                        view.fine,
                        pose,
                        noise=view.noise,
                        ceiling=view.ceiling,
                        iterations=10,
                        tolerance=tolerance,
                    )
            if pose is not None:
                tried.append(self._judged(view, pose, sharp, blur))
            if again:
                pose = wide.fit_blocks(view.fine, tried[-1].pose, _REFIT, view.noise)
        best = max(tried, key=lambda other: other.score)
        polished = [self._polished(view, best.pose, blur)]
        if blur and best is not tried[0]:
            polished.append(self._polished(view, tried[0].pose, blur))
        kept = [p for p in polished if p is not None and p.score > _KEPT * best.score]
        return max(kept, key=lambda other: other.score, default=best)

    def _polished(self, view: _View, pose: Array, blur: int) -> _Pose | None:
        fit = self.polish(view.fine, pose, view.noise, view.ceiling, blur)
        if fit is None:
            return None
        return _Pose(fit.pose, fit.agreement.score, fit.agreement.share, blur, fit)

    def _reblurred(self, view: _View, one: _Pose) -> _Pose:
        """Return the pose aligned with the neighboring blurs of which the blocks say more."""
        for _ in range(len(_BLURS)):
            if one.fit is not None and one.fit.noise < _EXPLAINED:
                break
            better = one
            for blur in (one.blur + 1, one.blur - 1):
                if not 0 <= blur < len(_BLURS):
                    continue
                other = self._polished(view, one.pose, blur)
                if other is not None and other.score > better.score:
                    better = other
            if better is one:
                break
            one = better
        return one


def _shifted_before(pose: Array, level: LocalLevel, x: float, y: float) -> Array:
    """Return the pose of a template that lies (x, y) px of the level further on."""
    shift = np.eye(3)
    shift[:2, 2] = level.level.to_template[0, 0] * np.array([x, y])
    return pose @ shift


@cache
def compile_loops() -> None:
    """Run everything that is compiled once, so that the first frame that needs it need not wait.

    It takes half a minute where the library runs for the first time, else a tenth of a second to
    load what was compiled then.
    """
    noise = np.random.default_rng(0).uniform(0, 255, (48, 48))
    image: Image = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), 1.0)
    pose = np.array([[8.0, 0, 23.5], [0, 8.0, 23.5], [0, 0, 1]])
    search = RobustSearch(
        image, (16, 16, 16, 16), pose, "homography", np.ones((16, 16), np.float32)
    )
    search.search(pyramid(image, search.coarsest + 1), pose, [], 1.0, np.inf, hopeless=0.0)
