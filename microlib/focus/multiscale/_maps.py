"""Maps of depths that are unknown or wrong in some pixels, and of their strengths."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def despiked(depth: NDArray) -> NDArray[np.float32]:
    """Replace by the median what is more than a frame away from it."""
    median = cv2.medianBlur(depth, 3)
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


def relative(strength: NDArray, typical_strength: float) -> NDArray[np.float32]:
    """Return strengths over a typical one; 1 where no fit succeeded."""
    share = strength / np.float32(typical_strength)
    return np.where(strength > 0, share, np.float32(1))


def typical(strength: NDArray) -> float:
    """Return the median of the strengths of all fits."""
    fitted = strength > 0
    return float(np.median(strength[fitted])) if fitted.any() else 1.0
