"""One peak for every second pixel, and the rules that reject it.

All depths are in steps, which are spacings of the averaged frames; a step of the surface is a jump
in depth. All lengths are in pixels of the grid of every second pixel. The table "one step left out"
of benchmarks/focus.py shows what each rule contributes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus._filters import blur, ratio
from microlib.focus.multiscale._axis import Axis
from microlib.focus.multiscale._fits import Fits
from microlib.focus.multiscale._measure import NoiseFloor, doubled
from microlib.focus.multiscale._settings import Settings
from microlib.focus.multiscale._significance import peak_significance

_NAN = np.float32(np.nan)


@dataclass(frozen=True)
class Peaks:
    """One peak for every second pixel, with the evidence for it; maps of shape (rows, cols).

    Attributes
    ----------
    depth : ndarray
        On the pixel's own side of a step, or that of the wide window; NaN where there is no peak or
        it was rejected.
    weight : ndarray
        Weight of the depth in a mean.
    disagreement, local_disagreement : ndarray
        Distance of the depths by the product and by the edge measure; and its local mean.
    sure_detail, probable_detail : ndarray of bool
        Where the frame has fine detail that no defocused image has, for sure and probably.
    wide_low, wide_high : ndarray
        Range of the wide depth around, NaN where it is unknown.
    random_error : ndarray
        Standard deviation of the depth if its peak may be noise; 0 where it is clear.
    """

    depth: NDArray[np.float32]
    weight: NDArray[np.float32]
    disagreement: NDArray[np.float32]
    local_disagreement: NDArray[np.float32]
    sure_detail: NDArray[np.bool_]
    probable_detail: NDArray[np.bool_]
    wide_low: NDArray[np.float32]
    wide_high: NDArray[np.float32]
    random_error: NDArray[np.float32]

    def without(self, mask: NDArray[np.bool_]) -> Peaks:
        """Return the peaks with those of a mask rejected."""
        return replace(self, depth=np.where(mask, _NAN, self.depth))

    def beyond_wide(self, gap: float) -> NDArray[np.bool_]:
        """Return where the depth is more than `gap` outside of the range of wide depths."""
        return (self.depth < self.wide_low - gap) | (self.depth > self.wide_high + gap)


def find_peaks(fits: Fits, axis: Axis, settings: Settings, typical_strength: float) -> Peaks:
    """Choose the peak of each pixel: of the narrow measures on its own side, or of the wide one.

    Parameters
    ----------
    fits : Fits
        Peaks of all measures.
    axis, settings
        As for `fit_stack`.
    typical_strength : float
        Median of the strengths, of the whole image.
    """
    significance = peak_significance(fits.profiles, fits.top, 2)
    depth = np.where(significance.insignificant, _NAN, fits.depth)
    filled = despiked(fill_nearest(depth))
    own, disagreement = choose_side(filled, fill_nearest(fits.edge), 3, settings.jump)
    wide = np.where(significance.near_texture, doubled(fits.wide, depth.shape), _NAN)
    low, high, slope = wide_range(wide, settings)
    # The median ignores the edges of what is narrow, where the measures always disagree.
    local = cv2.medianBlur(np.minimum(disagreement, np.float32(3)), 5)
    sure_detail, probable_detail = detail_masks(fits, axis, settings)
    peaks = Peaks(
        depth=np.where(np.isnan(depth), _NAN, despiked(own)),
        weight=relative(fits.strength, typical_strength),
        disagreement=disagreement,
        local_disagreement=np.asarray(cv2.blur(local, (settings.local_window,) * 2), np.float32),
        sure_detail=sure_detail,
        probable_detail=probable_detail,
        wide_low=low,
        wide_high=high,
        random_error=np.float32(axis.steps[-1]) * significance.random_error,
    )
    # A wide window spans both sides of a step.
    better = wide_is_better(peaks, settings) & (slope < settings.wide_slope)
    return replace(
        peaks,
        depth=np.where(better, wide, peaks.depth),
        weight=np.where(better, np.float32(settings.wide_weight), peaks.weight),
    )


# --- Which peak is chosen ------------------------------------------------------------------------


def choose_side(
    depth: NDArray, edge: NDArray, side: int, jump: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return each pixel's depth on its own side of a step, and the disagreement of both measures.

    Next to a step the windows of the product contain the other side as well, and the side with more
    texture wins. A few pixels away, on the pixel's own side, they do not. Where the edge measure is
    not noise and its depth, after two medians of `side` px, differs by a jump, the depth of that
    neighbor is taken that agrees with it best, to a step.
    """
    once = np.asarray(cv2.medianBlur(edge, side))
    disagreement = np.abs(depth - once)
    steady = cv2.medianBlur(np.abs(edge - once), 5) < 1
    twice = np.asarray(cv2.medianBlur(once, side))
    padded = np.pad(depth, 3, mode="symmetric")
    rows, cols = np.nonzero(steady & (np.abs(depth - twice) > jump))
    own, found = twice[rows, cols], depth[rows, cols]
    gap = np.abs(found - own)
    for distance in (1, 3):
        for dy, dx in product((-distance, 0, distance), repeat=2):
            neighbor = padded[rows + 3 + dy, cols + 3 + dx]
            other = np.abs(neighbor - own)
            better = (other < gap) & (other < 1)
            found, gap = np.where(better, neighbor, found), np.where(better, other, gap)
    result = depth.copy()
    result[rows, cols] = found
    return result, disagreement


def wide_is_better(peaks: Peaks, settings: Settings) -> NDArray[np.bool_]:
    """Return where the depth by the wide window is the better one.

    Beside a strong edge its blur is the largest change of all frames, at a wrong depth. A wide
    window contains the edge itself, and has the right depth. It is chosen in these cases:

    ================  ==================  ===============
    depth             both measures       fine detail
    ================  ==================  ===============
    unknown           any                 any
    1.2 steps beyond  agree               not even probable
    1.2 steps beyond  may disagree        not for sure
    agreement beyond  clearly disagree    not for sure
    ================  ==================  ===============
    """
    disagreement = peaks.local_disagreement
    may_disagree = disagreement > settings.disagreement / 2
    clearly_disagree = disagreement > settings.disagreement
    defocused = ~np.where(may_disagree, peaks.sure_detail, peaks.probable_detail)
    contradicts = peaks.beyond_wide(1.2)
    contradicts |= clearly_disagree & peaks.beyond_wide(settings.agreement)
    unknown = np.isnan(peaks.depth)
    return np.isfinite(peaks.wide_low) & (unknown | (contradicts & defocused))


def wide_range(wide: NDArray, settings: Settings) -> tuple[NDArray, NDArray, NDArray]:
    """Return least and greatest wide depth around each pixel, NaN where unknown, and the slope.

    The slope is the steepest within the wide window. At the border of the image the window has its
    inner side only, which biases its depth on a slope; the range contains that bias.
    """
    known, reach = np.isfinite(wide), settings.wide  # every second pixel: that many on either side
    square = np.ones((settings.local_window,) * 2, np.uint8)
    low = cv2.erode(np.where(known, wide, np.float32(np.inf)), square)
    high = cv2.dilate(np.where(known, wide, np.float32(-np.inf)), square)
    down, along = np.gradient(np.nan_to_num(wide))
    slope = cv2.dilate(np.hypot(down, along), np.ones((2 * reach + 1,) * 2, np.uint8))
    inside = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in wide.shape)
    outer = np.maximum(reach - np.minimum.outer(*inside), 0).astype(np.float32)
    bias = slope * (outer * outer / (2 * reach))
    return np.where(known, low - bias, _NAN), np.where(known, high + bias, _NAN), slope


def detail_masks(
    fits: Fits, axis: Axis, settings: Settings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where the best frame surely and probably has fine detail, as no defocused one has."""
    floor, middle = NoiseFloor.of(axis.noise, settings), len(fits.along) // 2
    fine = fits.along[middle] + fits.down[middle]
    # The peak of the product is (fine + floor)(coarse + floor), see `measure`.
    coarse = fits.top / (fine + np.float32(floor.fine)) - np.float32(floor.coarse)
    fine, coarse = blur(fine, 1.0), blur(coarse, 1.0)
    ratio, snr = settings.sure_detail
    sure, probable = (
        fine - share * snr * floor.fine > share * ratio * coarse for share in (1, 0.5)
    )
    return sure, probable


def relative(strength: NDArray, typical_strength: float) -> NDArray[np.float32]:
    """Return strengths over a typical one; 1 where no fit succeeded."""
    share = strength / np.float32(typical_strength)
    return np.where(strength > 0, share, np.float32(1))


def typical(strength: NDArray) -> float:
    """Return the median of the strengths of all fits."""
    fitted = strength > 0
    return float(np.median(strength[fitted])) if fitted.any() else 1.0


# --- Rules that reject a peak --------------------------------------------------------------------


def contradicted_mask(peaks: Peaks, settings: Settings) -> NDArray[np.bool_]:
    """Return where the measures disagree, no wide depth confirms the peak, and no detail is sure.

    On ground without texture noise has the largest change in some frame, different in each measure.
    """
    disagree = peaks.local_disagreement > settings.disagreement
    unconfirmed = peaks.beyond_wide(settings.reject_gap) | np.isnan(peaks.wide_low)
    return disagree & unconfirmed & ~peaks.sure_detail


def halo_mask(peaks: Peaks, settings: Settings) -> NDArray[np.bool_]:
    """Return where the peak is that of the defocused image of something brighter.

    Blur carries the light of a strong edge into places without texture, where it is the largest
    change of all frames, but at the wrong depth. Peaks at that depth are lower, on average, than
    those all around, whereas both sides of a step have high ones.
    """
    depth = np.nan_to_num(peaks.depth)
    weight = np.where(np.isfinite(peaks.depth), peaks.weight, np.float32(0))
    radius = settings.halo_radius
    around = blur(weight, radius)
    far = np.abs(depth - ratio(blur(depth * weight, radius), around)) > 2
    halo, level = np.zeros(depth.shape, bool), np.rint(depth)
    for k in np.unique(level[far]):
        near = (np.abs(depth - k) <= 1).astype(np.float32)
        theirs, share = blur(near * weight, radius), blur(near, radius)
        halo |= (level == k) & (theirs < settings.faint * around * share)
    return halo & far & ~peaks.sure_detail


def speck_mask(peaks: Peaks, settings: Settings) -> NDArray[np.bool_]:
    """Return the pixels of separate pieces of surface of a few pixels only."""
    # In 64ths of a step, of which 16 bits hold 1023; what lies higher is one surface.
    unknown, part = np.iinfo(np.int16).min, 64
    level = np.clip(part * (peaks.depth + 0.5) + unknown + 1, unknown + 1, -unknown - 1)
    level = np.where(np.isnan(peaks.depth), unknown, level).astype(np.int16)
    area = round(np.pi * settings.neighborhood**2 / 2)
    cv2.filterSpeckles(level, unknown, area, part * settings.jump)
    return np.asarray(level == unknown)


def isolated_mask(peaks: Peaks, settings: Settings) -> NDArray[np.bool_]:
    """Return where most of the neighbors have no depth: the rest is right by chance."""
    return blur(np.isfinite(peaks.depth).astype(np.float32), settings.neighborhood) < 0.5


#: A rule returns the mask of the peaks to reject.
Rule = Callable[[Peaks, Settings], NDArray[np.bool_]]
#: The rules in their order; each one gets the peaks that the rules before have left.
RULES: tuple[Rule, ...] = (contradicted_mask, halo_mask, speck_mask, isolated_mask)


# --- Maps with unknown depths --------------------------------------------------------------------


def despiked(depth: NDArray, side: int = 3) -> NDArray[np.float32]:
    """Replace by the median what is more than a step away from it."""
    median = cv2.medianBlur(depth, side)
    return np.where(np.abs(depth - median) > 1, median, depth)


def fill_nearest(depth: NDArray) -> NDArray[np.float32]:
    """Give unknown pixels the depth of the nearest known one; 0 if there is none."""
    unknown = np.isnan(depth)
    if not unknown.any():
        return depth
    _, label = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(label.max() + 1, np.float32)
    table[label[~unknown]] = depth[~unknown]
    return table[label]
