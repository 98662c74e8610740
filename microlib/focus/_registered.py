"""The frames of a stack as one camera at rest, under one light, would have taken them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._poses import Frame, Geometry

__all__ = ["SATURATED", "Registered"]

#: Share of the grey level where the camera saturates from which on a pixel does not count.
SATURATED = 0.99
#: Frames that are looked ahead for a pixel that is not saturated: a matter of memory.
_AHEAD = 6


@dataclass(frozen=True)
class Registered:
    """How the frames of a stack lie beside each other.

    Attributes
    ----------
    frames : list of Frame
        Each frame that is kept.
    kept : ndarray of int
        Their numbers in the stack.
    correlation : ndarray
        Correlation of each neighboring pair of the stack after alignment.
    geometry : Geometry
        The pixels of the full frames.
    saturation : float
        Grey level at which the camera saturates; infinite if it never does.
    """

    frames: list[Frame]
    kept: NDArray[np.intp]
    correlation: Array
    geometry: Geometry
    saturation: float

    def unseen(self, index: NDArray[np.integer], reach: int) -> NDArray[np.bool_]:
        """Tell which pixels one of the frames around theirs does not show.

        Parameters
        ----------
        index : ndarray of int, shape (rows, cols)
            Number of a kept frame for each pixel.
        reach : int
            How many frames around it count.
        """
        result = np.zeros(self.geometry.shape, bool)
        for k, frame in enumerate(self.frames):
            at = np.nonzero(~self.geometry.inside(frame))
            result[at] |= np.abs(index[at] - k) <= reach
        return result

    def poses(self, count: int) -> Array:
        """Return the map of every frame of a stack of `count`, NaN for those left out."""
        result = np.full((count, 2, 3), np.nan)
        result[self.kept] = [self.geometry.matrix(frame) for frame in self.frames]
        return result

    def gain(self, count: int) -> Array:
        """Return the gain of every frame at the image's center, NaN for those left out."""
        result = np.full(count, np.nan)
        result[self.kept] = [np.exp(frame.log_gain[0]) for frame in self.frames]
        return result

    def offset(self, count: int) -> Array:
        """Return the offset of every frame, NaN for those left out."""
        result = np.full(count, np.nan)
        result[self.kept] = [frame.offset for frame in self.frames]
        return result

    def colors(self, source: Iterator[Image]) -> Iterator[NDArray[np.float32]]:
        """Yield the kept color frames as the reference's camera would have taken them."""
        wanted = dict(zip(self.kept.tolist(), self.frames, strict=True))
        for k, image in enumerate(source):
            if k in wanted:
                frame = wanted[k]
                color = image.astype(np.float32)
                moved = self.geometry.warped(color, frame, flags=cv2.INTER_LANCZOS4)
                gain = self.geometry.gain(frame)[..., None]
                yield (moved - np.float32(frame.offset)) / gain

    def images(self, source: Iterator[Image]) -> Iterator[NDArray[np.float32]]:
        """Yield the kept frames of the stack as the reference's camera would have taken them."""
        wanted = dict(zip(self.kept.tolist(), self.frames, strict=True))
        corrected = (self._image(image, wanted[k]) for k, image in enumerate(source) if k in wanted)
        if np.isinf(self.saturation):
            yield from (image for image, _ in corrected)
        else:
            yield from _desaturated(corrected)

    def _image(self, image: Image, frame: Frame) -> tuple[NDArray, NDArray[np.intp]]:
        """Return a corrected image and which of its pixels saw saturated ones."""
        grey = image.astype(np.float32)
        warped = self.geometry.warped(grey, frame, flags=cv2.INTER_LANCZOS4)
        warped = (warped - np.float32(frame.offset)) / self.geometry.gain(frame)
        bright = (image >= SATURATED * self.saturation).view(np.uint8)
        if not bright.any():
            return warped, np.zeros(0, np.intp)
        seen = self.geometry.warped(255 * bright, frame, flags=cv2.INTER_LINEAR)
        return warped, np.flatnonzero(seen)


def _desaturated(
    images: Iterator[tuple[NDArray, NDArray[np.intp]]],
) -> Iterator[NDArray[np.float32]]:
    """Fill saturated pixels from the nearest frame where they are not, never below what they have.

    Frames before count however far they are, frames after up to `_AHEAD`.
    """
    window = deque(islice(images, 1 + _AHEAD))
    # The last value of each pixel that was not saturated, and how many frames ago that was.
    past, age = np.zeros(0, np.float32), np.full(window[0][0].size, 2**15, np.int32)
    while window:
        image, bad = window[0]
        flat = image.ravel()
        value = past[bad] if len(past) else flat[bad]
        since = age[bad] + 1
        distance = since.copy()
        past = flat
        if len(bad):
            best = value.copy()
            for ahead in range(1, len(window)):
                other, missing = window[ahead]
                nearer = (ahead < distance) & ~np.isin(bad, missing, assume_unique=True)
                best[nearer], distance[nearer] = other.ravel()[bad[nearer]], ahead
            past = flat.copy()
            flat[bad] = np.maximum(flat[bad], best)
        past[bad] = value
        age[:] = 0
        age[bad] = since
        yield image
        window.popleft()
        window.extend(islice(images, 1))
