"""Profiles of the focus measures over the frames of a stack."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Image
from microlib.focus.common import halved
from microlib.focus.multiscale._measure import NoiseFloor, measure
from microlib.focus.multiscale._settings import FocusSettings


class PeakTracker:
    """Profiles of focus measures over the frames, and each pixel's frame with the highest one.

    Parameters
    ----------
    count, kinds : int
        Number of frames, and of measures of each; the first measure decides.
    shape : tuple of int
        Rows and columns.
    reach : int
        Number of frames to either side of the best one that `windows` returns.
    """

    def __init__(self, count: int, kinds: int, shape: tuple[int, ...], reach: int) -> None:
        self._reach = reach
        self._measures = np.zeros((kinds, count + 2 * reach, *shape), np.float32)
        self.top, self.best = np.zeros(shape, np.float32), np.zeros(shape, np.uint16)

    def push(self, k: int, *measures: NDArray) -> None:
        """Add the measures of frame k."""
        for kind, value in enumerate(measures):
            self._measures[kind, k + self._reach] = value
        value = measures[0]
        number = np.multiply(value > self.top, np.uint16(k), dtype=np.uint16)
        cv2.max(value, self.top, self.top)
        cv2.max(self.best, number, self.best)

    def profiles(self, rows: slice) -> NDArray[np.float32]:
        """Return the deciding measure of all frames, shape (n, rows, cols)."""
        count = self._measures.shape[1] - 2 * self._reach
        return self._measures[0, self._reach : self._reach + count, rows]

    def windows(self, rows: slice = slice(None)) -> NDArray[np.float32]:
        """Return the measures around the best frames, shape (kinds, 2 reach + 1, rows, cols)."""
        best = self.best[rows].astype(np.intp)
        first = np.arange(self.best.size).reshape(self.best.shape)[rows] + best * self.best.size
        measures = self._measures.reshape(len(self._measures), -1)
        result = np.empty((len(measures), 2 * self._reach + 1, *best.shape), np.float32)
        for k in range(result.shape[1]):
            np.take(measures, first + k * self.best.size, axis=1, mode="clip", out=result[:, k])
        return result


class Profiles(NamedTuple):
    """Profiles of the focus measures of a stack, or of some rows of it.

    Attributes
    ----------
    product : PeakTracker
        Product of the fine and the coarse measure, and the fine measure in either direction, at
        every second pixel.
    edge : PeakTracker
        Edge measure at every second pixel.
    wide : PeakTracker
        Energy of the coarse measure in a wide window, at every fourth pixel.
    """

    product: PeakTracker
    edge: PeakTracker
    wide: PeakTracker


def find_profiles(
    frames: Iterable[Image],
    count: int,
    shape: tuple[int, ...],
    noise: float,
    settings: FocusSettings,
) -> Profiles:
    """Measure frames one after the other.

    Parameters
    ----------
    frames : iterable of ndarray, shape (rows, cols)
        Frames, averaged if they are.
    count, shape
        Their number, and rows and columns of each.
    noise : float
        Standard deviation of their noise, grey levels.
    settings : FocusSettings
        Settings of the measures.
    """
    floor = NoiseFloor.of(noise, settings)
    rows, cols = (-(-n // 4) for n in shape)  # every fourth pixel
    product = PeakTracker(count, kinds=3, shape=(2 * rows, 2 * cols), reach=3)
    edge = PeakTracker(count, kinds=1, shape=(2 * rows, 2 * cols), reach=1)
    wide = PeakTracker(count, kinds=1, shape=(rows, cols), reach=2)
    down, right = (-n % 4 for n in shape)
    for k, frame in enumerate(frames):
        if down or right:
            frame = cv2.copyMakeBorder(frame, 0, down, 0, right, cv2.BORDER_REPLICATE)
        measures = measure(frame, settings, floor)
        product.push(k, measures.product, measures.along, measures.down)
        edge.push(k, measures.edge)
        energy = measures.coarse_along**2 + measures.coarse_down**2
        wide.push(k, cv2.blur(halved(energy), (settings.wide, settings.wide)))
    return Profiles(product, edge, wide)
