"""The rules that reject peaks.

All depths are frame coordinates, and all lengths in pixels of the grid of every second pixel. The
table of the method with one stage left out of benchmarks/focus.py shows what each rule contributes.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.focus.common import blur, ratio
from microlib.focus.multiscale._peaks import Peaks
from microlib.focus.multiscale._settings import FocusSettings


def contradicted_mask(peaks: Peaks, settings: FocusSettings) -> NDArray[np.bool_]:
    """Return where the measures disagree, no wide depth confirms the peak, and no detail is sure.

    On ground without texture noise has the largest change in some frame, different in each measure.
    """
    disagree = peaks.local_disagreement > settings.disagreement
    unconfirmed = peaks.beyond_wide(settings.reject_gap) | np.isnan(peaks.wide_low)
    return disagree & unconfirmed & ~peaks.sure_detail


def halo_mask(peaks: Peaks, settings: FocusSettings) -> NDArray[np.bool_]:
    """Return where the peak is that of the defocused image of something brighter.

    Blur carries the light of a strong edge into places without texture, where it is the largest
    change of all frames, but at the wrong depth. Peaks at that depth are lower, on average, than
    those all around, whereas both sides of a step have high ones.
    """
    depth = np.nan_to_num(peaks.depth)
    weight = np.where(np.isfinite(peaks.depth), peaks.weight, np.float32(0))
    sigma = settings.halo_sigma
    around = blur(weight, sigma)
    far = np.abs(depth - ratio(blur(depth * weight, sigma), around)) > settings.halo_gap
    halo, level = np.zeros(depth.shape, bool), np.rint(depth)
    for k in np.unique(level[far]):
        near = (np.abs(depth - k) <= 1).astype(np.float32)
        theirs, share = blur(near * weight, sigma), blur(near, sigma)
        halo |= (level == k) & (theirs < settings.faint * around * share)
    return halo & far & ~peaks.sure_detail


def speck_mask(peaks: Peaks, settings: FocusSettings) -> NDArray[np.bool_]:
    """Return the pixels of separate pieces of surface of a few pixels only."""
    # In 64ths of a frame, of which 16 bits hold 1023; what lies higher is one surface.
    unknown, part = np.iinfo(np.int16).min, 64
    level = np.clip(part * (peaks.depth + 0.5) + unknown + 1, unknown + 1, -unknown - 1)
    level = np.where(np.isnan(peaks.depth), unknown, level).astype(np.int16)
    area = round(np.pi * settings.neighborhood_sigma**2 / 2)
    cv2.filterSpeckles(level, unknown, area, part * settings.jump)
    return np.asarray(level == unknown)


def isolated_mask(peaks: Peaks, settings: FocusSettings) -> NDArray[np.bool_]:
    """Return where most of the neighbors have no depth: the rest is right by chance."""
    return blur(np.isfinite(peaks.depth).astype(np.float32), settings.neighborhood_sigma) < 0.5


#: A rule returns the mask of the peaks to reject.
Rule = Callable[[Peaks, FocusSettings], NDArray[np.bool_]]
#: The rules in their order; each one gets the peaks that the rules before have left.
RULES: tuple[Rule, ...] = (contradicted_mask, halo_mask, speck_mask, isolated_mask)
