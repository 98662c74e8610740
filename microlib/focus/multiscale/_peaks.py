"""One peak for every second pixel: that of the narrow measures on its own side, or the wide one.

All depths are frame coordinates, and all lengths in pixels of the grid of every second pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus.common import Spread, blur, doubled, peak_significance, run_jobs
from microlib.focus.multiscale._axis import Axis
from microlib.focus.multiscale._fits import Fits
from microlib.focus.multiscale._maps import despiked, fill_nearest, relative
from microlib.focus.multiscale._measure import NoiseFloor
from microlib.focus.multiscale._settings import FocusSettings

_NAN = np.float32(np.nan)
#: Height of a peak over the mean that rounding makes. From 3 to 8, bare ground of rounded frames
#: has no sure depth, and the rows of benchmarks/focus_depth.py stay as they are.
_ROUNDED = 4.0


@dataclass(frozen=True)
class Peaks:
    """One peak for every second pixel, with the evidence for it; maps of shape (rows, cols).

    Attributes
    ----------
    depth : ndarray
        On the pixel's own side of a step, or that of the wide window; NaN where there is no peak or
        it was rejected.
    weight : ndarray
        Weight of the depth in a mean: the strength of the fit over a typical one, 1 where no fit
        succeeded, and 0.02 (`wide_weight`) for a depth of the wide window.
    disagreement, local_disagreement : ndarray
        Distance of the depths by the product and by the edge measure; and its local mean.
    sure_detail, probable_detail : ndarray of bool
        Where the frame has fine detail that no defocused image has, for sure and probably.
    wide_low, wide_high : ndarray
        Range of the wide depth around, NaN where it is unknown.
    random_error : ndarray
        Standard deviation of the depth if its peak may be noise; 0 where it is clear.
    best : ndarray of int
        Number of the averaged frame with the highest measure.
    count : int
        Number of averaged frames.
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
    best: NDArray[np.uint16]
    count: int

    def without(self, mask: NDArray[np.bool_]) -> Peaks:
        """Return the peaks with those of a mask rejected."""
        return replace(self, depth=np.where(mask, _NAN, self.depth))

    def beyond_wide(self, gap: float) -> NDArray[np.bool_]:
        """Return where the depth is more than `gap` outside of the range of wide depths."""
        return (self.depth < self.wide_low - gap) | (self.depth > self.wide_high + gap)


def find_peaks(
    fits: Fits,
    axis: Axis,
    settings: FocusSettings,
    typical_strength: float,
    *,
    spread: Spread = map,
) -> Peaks:
    """Choose the peak of each pixel: of the narrow measures on its own side, or of the wide one.

    Parameters
    ----------
    fits : Fits
        Peaks of all measures.
    axis, settings
        As for `fit_stack`.
    typical_strength : float
        Median of the strengths, of the whole image.
    spread : callable
        `map`, or that of a pool of threads.
    """
    rounding = rounding_peak(axis, settings)
    significance = peak_significance(fits.profiles, fits.top, 2, rounding)
    depth = np.where(significance.insignificant, _NAN, fits.depth)
    wide = np.where(significance.near_texture, doubled(fits.wide, depth.shape), _NAN)

    def chosen() -> tuple[NDArray, NDArray, NDArray]:
        filled = despiked(fill_nearest(depth))
        own, disagreement = choose_side(filled, fill_nearest(fits.edge), settings.jump)
        # The median ignores the edges of what is narrow, where the measures always disagree.
        local = cv2.medianBlur(np.minimum(disagreement, np.float32(3)), 5)
        return despiked(own), disagreement, cv2.blur(local, (settings.local_window,) * 2)

    (sure_detail, probable_detail), (low, high, slope), (own, disagreement, local) = run_jobs(
        spread,
        lambda: detail_masks(fits, axis, settings),
        lambda: wide_range(wide, settings),
        chosen,
    )
    own[np.isnan(depth)] = _NAN
    peaks = Peaks(
        depth=own,
        weight=relative(fits.strength, typical_strength),
        disagreement=disagreement,
        local_disagreement=local,
        sure_detail=sure_detail,
        probable_detail=probable_detail,
        wide_low=low,
        wide_high=high,
        random_error=np.float32(axis.coordinates[-1]) * significance.random_error,
        best=fits.best,
        count=len(axis.coordinates),
    )
    # A wide window spans both sides of a step.
    better = wide_is_better(peaks, settings) & (slope < settings.wide_slope)
    np.copyto(peaks.depth, wide, where=better)
    np.copyto(peaks.weight, np.float32(settings.wide_weight), where=better)
    return peaks


def rounding_peak(axis: Axis, settings: FocusSettings) -> float:
    """Return the height below which a peak may be made by the rounding of grey levels.

    Where the light changes by less than a step of the grey levels, noise of less than half a step
    is rounded away in some frames and not in others. Neighboring blocks then have a common peak.
    """
    noise, rounding = (NoiseFloor.of(value, settings) for value in (axis.noise, axis.rounding))
    most = (noise.fine + rounding.fine) * (noise.coarse + rounding.coarse)
    return _ROUNDED * (most - noise.fine * noise.coarse)


def choose_side(
    depth: NDArray, edge: NDArray, jump: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return each pixel's depth on its own side of a step, and the disagreement of both measures.

    Next to a step the windows of the product contain the other side as well, and the side with more
    texture wins. A few pixels away, on the pixel's own side, they do not. Where the edge measure is
    not noise and its depth, after two medians, differs by a jump, the depth of that
    neighbor is taken that agrees with it best, to a frame.
    """
    once = np.asarray(cv2.medianBlur(edge, 3))
    disagreement = np.abs(depth - once)
    steady = cv2.medianBlur(np.abs(edge - once), 5) < 1
    twice = np.asarray(cv2.medianBlur(once, 3))
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


def wide_is_better(peaks: Peaks, settings: FocusSettings) -> NDArray[np.bool_]:
    """Return where the depth by the wide window is the better one.

    Beside a strong edge its blur is the largest change of all frames, at a wrong depth. A wide
    window contains the edge itself, and has the right depth. It is chosen in these cases:

    ==================  ==================  =================
    depth               both measures       fine detail
    ==================  ==================  =================
    unknown             any                 any
    `wide_gap` beyond   agree               not even probable
    `wide_gap` beyond   may disagree        not for sure
    `agreement` beyond  clearly disagree    not for sure
    ==================  ==================  =================
    """
    disagreement = peaks.local_disagreement
    may_disagree = disagreement > settings.disagreement / 2
    clearly_disagree = disagreement > settings.disagreement
    defocused = ~np.where(may_disagree, peaks.sure_detail, peaks.probable_detail)
    contradicts = peaks.beyond_wide(settings.wide_gap)
    contradicts |= clearly_disagree & peaks.beyond_wide(settings.agreement)
    unknown = np.isnan(peaks.depth)
    return np.isfinite(peaks.wide_low) & (unknown | (contradicts & defocused))


def wide_range(wide: NDArray, settings: FocusSettings) -> tuple[NDArray, NDArray, NDArray]:
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
    low -= bias
    high += bias
    low[~known] = high[~known] = _NAN
    return low, high, slope


def detail_masks(
    fits: Fits, axis: Axis, settings: FocusSettings
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
