"""A focal stack in memory: read, compared with its positions, and searched for disturbances."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Image
from microlib.focus._filters import TINY
from microlib.focus._peaks import check_count, check_positions

#: Called with the parts of the work that are done, and of how many; an exception ends the work.
Progress = Callable[[int, int], object]

#: Width of a margin that the windows of the measures add to a black one, px.
_WINDOW = 6
#: Axes of a file along which the focus does not change.
_NO_FOCUS = {"T": "times", "C": "channels"}


@dataclass(frozen=True, eq=False)
class Stack:
    """Frames in memory.

    Attributes
    ----------
    grey : list of ndarray, shape (rows, cols)
        Grey levels, or luminance.
    images : list of ndarray, shape (rows, cols) or (rows, cols, 3)
        Grey levels or colors, of which the all-in-focus image is made.
    positions : ndarray of float64, shape (n,)
        Position of each frame, µm.
    numbers : ndarray of int, shape (n,)
        Number of each frame in the source. Frames of the source may be left out of the stack.
    pixel_size, corner
        From the frames' reader.
    """

    grey: list[Image]
    images: list[Image]
    positions: Array
    numbers: NDArray[np.intp]
    pixel_size: float | None = None
    corner: tuple[float, float] = (0.0, 0.0)


def read_stack(
    reader: Any, positions: ArrayLike | None, spacing: float | None, progress: Progress
) -> Stack:
    """Read all frames, after the checks that need none of them."""
    if reader.axis in _NO_FOCUS:
        raise ValueError(
            f"frames must differ in focus, got a file of {reader.count} {_NO_FOCUS[reader.axis]} "
            f"(axis {reader.axis}); if they do, pass the array, as tifffile.imread gives it"
        )
    z, count = None, reader.count
    if spacing is None:
        z = check_positions(positions, from_file=reader.positions)
        # The length of an iterator is not known; there must be as many frames as positions.
        count = len(z)
        check_count(reader.count or count, count)
    images: list[Image] = []
    for image in islice(reader, None if count is None else count + 1):
        images.append(image)
        if count is not None:
            progress(min(len(images), count), 2 * count)
    if not images:
        raise ValueError("frames must hold at least three frames, got none")
    z = check_positions(positions, spacing, len(images)) if z is None else z
    check_count(len(images) if len(images) <= len(z) else f"more than {len(z)}", len(z))
    grey = [cv2.cvtColor(f, cv2.COLOR_RGB2GRAY) for f in images] if reader.color else images
    return Stack(grey, images, z, np.arange(len(z)), reader.pixel_size, reader.corner)


def without_bad_frames(stack: Stack) -> Stack:
    """Return a stack without the `bad_frames`; warn if there are some."""
    bad = bad_frames(stack.grey)
    if not bad.any():
        return stack
    kept = np.flatnonzero(~bad)
    return replace(
        stack,
        grey=[stack.grey[k] for k in kept],
        images=[stack.images[k] for k in kept],
        positions=stack.positions[kept],
        numbers=stack.numbers[kept],
    )


def bad_frames(frames: Sequence[Image]) -> NDArray[np.bool_]:
    """Return which frames do not belong to a stack: black, white, repeated, or of other brightness.

    One of them would give ground without texture a common peak. The brightness of a frame is
    compared with its four nearest frames. It is another one if it lies beyond all of them and if no
    straight line through two of them comes close to it. The limit is above what focus alone changes
    (a camera that Micro-Manager simulates: 11 %). Where more than a quarter of the frames differ,
    there is no rule that some could break, and all frames belong to the stack.

    Warns
    -----
    UserWarning
        If there are such frames, with their numbers.
    """
    count = len(frames)
    if count < 5:
        return np.zeros(count, bool)
    statistics = np.array([np.ravel(cv2.meanStdDev(frame)) for frame in frames])
    level, contrast = statistics.T
    apart = np.array([_from_neighbors(level, k) for k in range(count)])
    bad = apart.min(axis=1) > max(0.15 * abs(np.median(level)), 8 * np.median(apart[:, 0]))
    if np.median(contrast) > 0.01 * abs(np.median(level)):  # rounded frames of a wall may be equal
        bad |= contrast == 0
        for k in range(1, count):
            alike = (statistics[k] == statistics[k - 1]).all()
            bad[k] |= alike and np.array_equal(frames[k - 1], frames[k])
    if np.count_nonzero(bad) > count / 4:
        return np.zeros(count, bool)
    if bad.any():
        names = ", ".join(map(str, np.flatnonzero(bad)))
        warnings.warn(
            f"frames {names} are uniform, repeated or of another brightness: left out",
            stacklevel=4,
        )
    return bad


def _from_neighbors(level: Array, k: int) -> tuple[float, float]:
    """Return the distances of a level from lines through its four nearest, and from their range."""
    number = np.arange(len(level))
    near = np.argsort(np.abs(number - k), kind="stable")[1:5]
    lines = [level[i] + (k - i) * (level[j] - level[i]) / (j - i) for i, j in combinations(near, 2)]
    beyond = max(level[near].min() - level[k], level[k] - level[near].max(), 0.0)
    return float(np.abs(np.array(lines) - level[k]).min()), float(beyond)


def margin_mask(frames: Sequence[Image]) -> NDArray[np.bool_]:
    """Return the pixels in the black margin of some frame, as programs that align frames leave."""
    margin = np.zeros(frames[0].shape, bool)
    for frame, turn in product(frames, range(4)):
        turned, dark = np.rot90(frame, turn), 0.03 * cv2.mean(frame)[0]
        if turned[0].mean() <= dark:  # JPEG leaves 2 grey levels beside an edge
            lines = turned.mean(axis=1) > dark
            first = int(np.argmax(lines))
            inside = turned[min(first + 1, len(turned) - 1)] > 3 * dark
            # An object on dark ground seldom has a sharp edge along half of a side.
            if lines.any() and np.count_nonzero(inside) > len(inside) / 2:
                np.rot90(margin, turn)[: first + _WINDOW] = True
    return margin


def warn_of_changes(frames: Sequence[Image]) -> None:
    """Warn if illumination or position change from frame to frame, which registration corrects."""
    count = len(frames)
    if count < 4 or min(frames[0].shape) < 64:  # too few or too small to decide
        return
    # Defocus changes the light smoothly, which third differences suppress.
    level = np.log(np.maximum([cv2.mean(frame)[0] for frame in frames], TINY))
    flicker = float(np.median(np.abs(np.diff(level, 3))))
    pairs = (frames[k : k + 2] for k in ((count - 1) * n // 4 for n in (1, 2, 3)))
    # Light that scatters by 2 % gives 0.06; at rest one of the moves stays below 0.2 px.
    if flicker > 0.06 or all(_motion(*pair) > 0.25 for pair in pairs):
        what = "light" if flicker > 0.06 else "position"
        warnings.warn(
            f"frames change in {what} from one to the next: register=True (--register) corrects it",
            stacklevel=3,
        )


def _motion(first: Image, second: Image) -> float:
    """Return the motion between two frames, px of a reduced frame; 0 if they do not correlate."""
    # Of other sides than powers of two cv2.phaseCorrelate finds half a pixel where nothing moved.
    side = min(2 ** int(np.log2(min(first.shape))), 256)
    small = [cv2.resize(f, (side, side), interpolation=cv2.INTER_AREA) for f in (first, second)]
    (x, y), peak = cv2.phaseCorrelate(*(image.astype(np.float32) for image in small))
    motion = float(np.hypot(x, y))
    return motion if peak > 0.4 and motion < 16 else 0.0
