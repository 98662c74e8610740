"""A focal stack in memory: read, compared with its positions, and searched for disturbances."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations, islice

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Image, as_array, as_scalar
from microlib.focus._registration import motion_between
from microlib.focus.common import TINY
from microlib.io import Stack

#: Called with the parts of the work that are done, and of how many; an exception ends the work.
Progress = Callable[[int, int], object]

#: Width of a margin that the windows of the measures add to a black one, px.
_WINDOW = 6


def read_stack(
    source: Stack, positions: ArrayLike | None, spacing: float | None, progress: Progress
) -> tuple[list[Image], Iterable[Image] | None, Array]:
    """Read a stack; check first what needs no frame.

    Returns
    -------
    list of ndarray
        The grey levels of the frames, their luminance if they are in color.
    iterable of ndarray or None
        The frames in color if they are. Those of files are read again when they are needed, others
        are held in memory.
    ndarray, shape (n,)
        Their positions, µm.
    """
    if source.axis == "T":
        raise ValueError(
            f"frames must differ in focus, got a file of {source.count} times (axis T); if they "
            'do, axis="T" of read_frames (--axis T) says so'
        )
    z, count = None, source.count
    if spacing is None:
        z = check_positions(positions, from_file=source.positions)
        # The length of an iterator is not known; there must be as many frames as positions.
        count = len(z)
        check_count(source.count or count, count)
    grey: list[Image] = []
    colors: list[Image] = []
    for image in islice(source, None if count is None else count + 1):
        if source.color and not source.files:
            colors.append(image)
        grey.append(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if source.color else image)
        if count is not None:
            progress(min(len(grey), count), count)
    z = check_positions(positions, spacing, len(grey)) if z is None else z
    check_count(len(grey) if len(grey) <= len(z) else f"more than {len(z)}", len(z))
    return grey, (colors or source) if source.color else None, z


def check_positions(
    positions: ArrayLike | None,
    spacing: float | None = None,
    count: int = 0,
    from_file: ArrayLike | None = None,
) -> Array:
    """Return the positions of all frames, µm: given, evenly spaced, or from the file."""
    if spacing is not None:
        if positions is not None:
            raise ValueError("positions and spacing must not both be given")
        positions = as_scalar("spacing", spacing) * np.arange(count)
    positions = from_file if positions is None else positions
    if positions is None:
        raise ValueError(
            "positions or spacing must be given, got None and frames without positions of their "
            'own; spacing="frame" gives depths in frames'
        )
    z = as_array("positions", positions, shape=(None,))
    if not 3 <= len(z) < 2**16:  # frames are counted in 16 bits
        raise ValueError(f"positions must hold 3 to 65535 values, got {len(z)}")
    for at in np.flatnonzero(np.diff(z) * np.sign(z[-1] - z[0]) <= 0):
        raise ValueError(
            f"positions must rise or fall strictly, got {z[at]:g} followed by {z[at + 1]:g}"
        )
    return z


def frame_names(source: Stack, count: int, numbers: NDArray[np.intp]) -> str:
    """Return the names, at most nine, of some of `count` frames, their numbers if not of files."""
    files = source.files if len(source.files) == count else ()
    names = [files[k].name if files else str(k) for k in numbers[:9]]
    return ", ".join(names) + (" …" if len(numbers) > 9 else "")


def check_count(got: int | str, count: int) -> None:
    """Raise an error if there are not as many frames as positions."""
    if got != count:
        raise ValueError(f"frames and positions must be equal in number, got {got} and {count}")


def bad_frames(frames: Sequence[Image]) -> NDArray[np.bool_]:
    """Return which frames do not belong to a stack: black, white, repeated, or of other brightness.

    One of them would give ground without texture a common peak. The brightness of a frame is
    compared with its four nearest frames. It is another one if it lies beyond all of them and if no
    straight line through two of them comes close to it. The limit is above what focus alone changes
    (a camera that Micro-Manager simulates: 11 %). Where more than a quarter of the frames differ,
    there is no rule that some could break, and all frames belong to the stack.
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
    return bad & (np.count_nonzero(bad) <= count / 4)


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
    for frame in frames:
        dark = 0.03 * cv2.mean(frame)[0]  # JPEG leaves 2 grey levels beside an edge
        for turn in range(4):
            turned = np.rot90(frame, turn)
            if turned[0].mean() > dark:
                continue
            lines = turned.mean(axis=1) > dark
            first = int(np.argmax(lines))
            inside = turned[min(first + 1, len(turned) - 1)] > 3 * dark
            # An object on dark ground seldom has a sharp edge along half of a side.
            if lines.any() and np.count_nonzero(inside) > len(inside) / 2:
                np.rot90(margin, turn)[: first + _WINDOW] = True
    return margin


def change_between(frames: Sequence[Image], margin: NDArray[np.bool_]) -> str:
    """Return what changes beside the margin from frame to frame, which registration corrects.

    It is "light", or "position or scale" with the median of three measured motions, or nothing.
    """
    count = len(frames)
    rows, cols = (np.flatnonzero(~margin.all(axis=axis)) for axis in (1, 0))
    if count < 4 or min(len(rows), len(cols)) < 64:  # too few or too small to decide
        return ""
    frames = [f[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1] for f in frames]
    # Defocus changes the light smoothly, which third differences suppress, and by 11 % at most.
    level = np.log(np.maximum([cv2.mean(frame)[0] for frame in frames], TINY))
    flicker = float(np.median(np.abs(np.diff(level, 3))))
    drift = abs(np.polyfit(np.linspace(0, 1, count), level, 1)[0])
    pairs = (frames[k : k + 2] for k in ((count - 1) * n // 4 for n in (1, 2, 3)))
    motions = [motion_between(*pair) for pair in pairs]
    # At rest one of the motions stays below 0.2 px; light that scatters by 2 % gives 0.06.
    if min(motion.size for motion in motions) > 0.25:
        _, shift, growth, turn = np.median(motions, axis=0)
        percent, degrees = np.round([100 * growth, turn], 2) + 0.0  # no -0
        return f"position or scale (by {shift:.1f} px, {percent:g} % and {degrees:g}°)"
    return "light" if flicker > 0.06 or drift > 0.2 else ""
