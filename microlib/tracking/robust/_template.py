"""The template at the resolutions of a search: how well it agrees with a frame at a pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._esm import Level, Template, make_level
from microlib.tracking._geometry import cut_around, translate
from microlib.tracking._sampling import SearchFrame, half_pixel
from microlib.tracking._settings import TrackerSettings
from microlib.tracking.robust._blocks import Blocks, compare
from microlib.tracking.robust._photometric import PhotometricFit, PhotometricLevel
from microlib.tracking.robust._starts import PointFlow, ncc_peaks

#: Margin (px) around the template in which it is aligned at half pixels.
_MARGIN = 8.0


@dataclass(frozen=True, eq=False)
class SearchTemplate:
    """A template at the resolutions of a search.

    Attributes
    ----------
    settings : TrackerSettings
        Thresholds and sizes of the search.
    plain : Template
        Levels of a plain alignment, which has one gain and one bias.
    coarse : Level
        Level of the lowest resolution.
    blurred : tuple of Level
        Finest level of the search, in each of the blurs of the settings.
    photometric : tuple of PhotometricLevel
        The same, sampled at half pixels, with the photometric model.
    points : tuple of PointFlow
        Points of the template that optical flow can follow, in each of the blurs.
    noise : float
        Standard deviation of the noise of the first frame.
    shape : tuple of int
        Height and width of the box, px.
    surroundings : Level
        The first frame in a box that is three times as large, as fine as the search.
    periods : tuple of ndarray, shape (3, 3)
        Warps of the normalized coordinates that map the template to other places of the first frame
        that resemble it, in whole or in part: the nearest ones.
    """

    settings: TrackerSettings
    plain: Template
    coarse: Level
    blurred: tuple[Level, ...]
    photometric: tuple[PhotometricLevel, ...]
    points: tuple[PointFlow, ...]
    noise: float
    shape: tuple[int, int]
    surroundings: Level
    periods: tuple[Array, ...] = ()

    @property
    def side(self) -> int:
        """The longer side of the box, px."""
        return max(self.shape)

    @property
    def fine(self) -> Level:
        """Finest level of the search, without blur."""
        return self.blurred[0]

    def displacement(self, before: Array, after: Array) -> Array:
        """Return how the center of the template moves from a pose to another, (x, y) in px."""
        corners = self.plain.corners_of(after) - self.plain.corners_of(before)
        return corners.mean(axis=0)

    def distance(self, pose: Array, other: Array) -> float:
        """Return the largest coordinate by which the corners of two poses differ, px."""
        return float(np.abs(self.plain.corners_of(pose) - self.plain.corners_of(other)).max())

    def apart(self, pose: Array, other: Array) -> bool:
        """Return whether two poses are different ones."""
        return self.distance(pose, other) > self.settings.apart * 2**self.fine.halvings

    def different(self, poses: list[Array], scores: list[float]) -> list[int]:
        """Return the numbers of the poses that are apart from all better ones, the best first."""
        kept: list[int] = []
        for k in sorted(range(len(poses)), key=lambda k: -scores[k]):
            if all(self.apart(poses[k], poses[other]) for other in kept):
                kept.append(k)
        return kept

    def score(self, frame: SearchFrame, pose: Array, blur: int = 0) -> float:
        """Return the score of a pose from the blocks of the template in one of its blurs."""
        return self.blocks(self.blurred[blur], frame, pose).score()

    def blocks(self, level: Level, frame: SearchFrame, pose: Array) -> Blocks:
        """Return the blocks of a level beside those of a frame under a pose."""
        grey, _, weight = level.patch(frame.layer(level.halvings), pose, frame.saturation)
        noise = frame.noise * level.noise_gain
        return compare(grey, level.grey, weight, noise, self.settings)

    def align_photometric(
        self, frame: SearchFrame, pose: Array, blur: int = 0
    ) -> PhotometricFit | None:
        """Align with the photometric model at half pixels of the finest level."""
        level = self.photometric[blur]
        scale = 2.0**level.halvings
        corners = self.plain.corners_of(pose) / scale
        near, first = cut_around(frame.layer(level.halvings), corners, _MARGIN)
        if min(near.shape) < _MARGIN:
            return None
        start = translate(pose, -first * scale)
        fit = level.align_photometric(half_pixel(near), start, frame.noise, frame.saturation)
        return fit and replace(fit, pose=translate(fit.pose, first * scale), blur=blur)

    def align_best_blur(self, frame: SearchFrame, pose: Array) -> PhotometricFit | None:
        """Align with the photometric model, with the template in the blur that agrees best."""
        blurs = range(len(self.blurred))
        best = max(blurs, key=lambda blur: self.score(frame, pose, blur))
        return self.align_photometric(frame, pose, best)


def make_search_template(
    plain: Template,
    frame: SearchFrame,
    box: tuple[int, int, int, int],
    pose: Array,
    motion: str,
    settings: TrackerSettings,
    mask: Image | None,
) -> SearchTemplate:
    """Cut the levels of a search from the first frame; the arguments are those of `make_level`."""
    width, height = box[2:]
    size = np.sqrt(width * height)  # an oblong box keeps more than a few rows
    finest = max(0, int(np.ceil(np.log2(size / settings.max_side))))
    coarsest = finest  # up to two more while the shorter side keeps 12 px
    while coarsest < finest + 2 and min(width, height) >= 24 << coarsest:
        coarsest += 1
    cut = partial(make_level, box=box, pose=pose, motion=motion, settings=settings, mask=mask)
    smoothing = settings.coarse_smoothing
    layer = frame.layer(finest)
    blurred, photometric, points = [], [], []
    for blur in settings.blurs:
        image = cv2.GaussianBlur(layer, (0, 0), blur) if blur else layer
        blurred.append(cut(image, halvings=finest, smoothing=smoothing))
        points.append(PointFlow(blurred[-1], image, pose, max(width, height) >> finest))
        sharp, more_blurred = (
            cut(half_pixel(each), halvings=finest, density=2, smoothing=settings.fine_smoothing)
            for each in (image, cv2.GaussianBlur(image, (0, 0), 0.8))
        )
        photometric.append(PhotometricLevel(**vars(sharp), blurred=more_blurred.grey))
    rows, columns = frame.image.shape
    x, y = np.maximum(np.subtract(box[:2], box[2:]), 0).tolist()
    right, bottom = min(box[0] + 2 * width, columns), min(box[1] + 2 * height, rows)
    template = SearchTemplate(
        settings=settings,
        plain=plain,
        coarse=cut(frame.layer(coarsest), halvings=coarsest, smoothing=smoothing),
        blurred=tuple(blurred),
        photometric=tuple(photometric),
        points=tuple(points),
        noise=frame.noise,
        shape=(height, width),
        surroundings=make_level(
            layer,
            (x, y, right - x, bottom - y),
            pose,
            halvings=finest,
            smoothing=smoothing,
            motion=motion,
            settings=settings,
            mask=mask,
        ),
    )
    return replace(template, periods=_periods(template, frame, pose))


def _periods(template: SearchTemplate, frame: SearchFrame, pose: Array) -> tuple[Array, ...]:
    """Return the shortest warps of a template to places of its frame that resemble it."""
    settings, level = template.settings, template.fine
    layer, own = frame.layer(level.halvings), template.score(frame, pose)
    peaks = ncc_peaks(level, layer, pose, apart=2, least=settings.period_ncc)
    steps = sorted((template.displacement(pose, peak) for peak in peaks), key=np.linalg.norm)
    steps = [step for step in steps if np.hypot(*step) > settings.apart]
    periods = []
    for step in steps[: settings.max_periods]:
        fit = level.align(layer, translate(pose, step), tolerance=settings.rough_tolerance)
        period = template.displacement(pose, fit.pose)
        shifted = translate(pose, period)
        resembles = template.score(frame, shifted) > settings.period_share * own
        if resembles and np.hypot(*period) > settings.apart:
            periods.append(np.linalg.inv(pose) @ shifted)
    return tuple(periods)
