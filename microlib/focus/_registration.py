"""Registration of a focal stack: shift, rotation, scale and brightness of each frame.

Each frame is aligned to the one before by maximizing the enhanced correlation coefficient
(Evangelidis and Psarakis, 2008), which does not depend on gain and offset, from the middle of the
stack outwards. A frame that does not correlate is left out, and the next one is aligned to the last
that did.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import TUKEY_LIMIT, Array, Image, robust_std, tukey_weights

#: Least side of a frame that can be registered, px, and the shorter side above which frames are
#: reduced by whole blocks before they are compared.
_MIN_SIDE, _WORKING_SIDE = 32, 240
#: Correlation of the aligned frames below which they do not show one scene: noise and foreign
#: frames stay below 0.2.
_CORRELATION = 0.5


@dataclass(frozen=True, eq=False)
class Registration:
    """Position and brightness of the frames of a stack relative to the middle one.

    Attributes
    ----------
    kept : ndarray of int
        Numbers of the frames that were not left out.
    warps : ndarray, shape (n, 2, 3)
        Warp matrix from the middle frame to each frame, px; NaN for those left out.
    gain, offset : ndarray, shape (n,)
        Grey levels of each frame are `gain` times those of the middle frame, plus `offset`.
    """

    kept: NDArray[np.intp]
    warps: Array
    gain: Array
    offset: Array

    def aligned(self, frame: Image, number: int | np.integer) -> AlignedFrame:
        """Return a frame, grey or in color, as the middle frame has it in position and light."""
        return AlignedFrame(frame, self.warps[number], self.gain[number], self.offset[number])

    def outside(self, index: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Return the pixels that some frame near to theirs, `index`, does not contain."""
        reach = max(3, round(0.1 * len(self.kept)))
        full, result = np.ones(index.shape, np.uint8), np.zeros(index.shape, bool)
        how = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP  # up to half a pixel beyond is inside
        for k, warp in enumerate(self.warps[self.kept]):
            outside = cv2.warpAffine(full, warp, index.shape[::-1], flags=how) == 0
            result |= outside & (index >= k - reach) & (index <= k + reach)
        return result


@dataclass(frozen=True, eq=False)
class AlignedFrame:
    """A frame, of which rows are aligned when they are indexed, so that it takes no memory.

    Attributes
    ----------
    frame : ndarray
        The frame as it was taken.
    warp, gain, offset
        Its own ones of those of `Registration`.
    """

    frame: Image
    warp: Array
    gain: float
    offset: float

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the frame."""
        return self.frame.shape

    def __getitem__(self, rows: slice) -> NDArray[np.float32]:
        height, width = self.shape[:2]
        top, bottom, _ = rows.indices(height)
        warp = self.warp.copy()
        # Only the rows that are shown are converted, and four on either side for the filter.
        y = warp[1] @ [[0, width, 0, width], [top, top, bottom, bottom], [1, 1, 1, 1]]
        first = int(np.clip(y.min() - 4, 0, height - 1))
        last = int(np.clip(y.max() + 5, first + 1, height))
        warp[:, 2] += top * warp[:, 1]
        warp[1, 2] -= first
        image, size = self.frame[first:last].astype(np.float32), (width, bottom - top)
        flags, border = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
        moved = cv2.warpAffine(image, warp, size, flags=flags, borderMode=border)
        result = np.asarray(moved, np.float32)
        result -= np.float32(self.offset)
        result /= np.float32(self.gain)
        return result


def _ignore(share: float) -> None:
    """Show no progress."""


def register(
    frames: Sequence[Image],
    *,
    names: Callable[[NDArray[np.intp]], str],
    at_rest: bool = False,
    done: Callable[[float], object] = _ignore,
) -> Registration:
    """Find position and brightness of the frames of a stack, relative to the middle one.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        The frames, grey.
    names : callable
        Returns the names of frames in messages from their numbers.
    at_rest : bool
        Whether only the brightness changes.
    done : callable
        Called with the share of the frames that are compared.

    Raises
    ------
    ValueError
        If the frames are too small, or less than half of them show one scene; those that do not are
        named.

    Warns
    -----
    UserWarning
        If some frames are left out for that reason.
    """
    shape, count = frames[0].shape, len(frames)
    if min(shape) < _MIN_SIDE:
        raise ValueError(
            f"frames must be at least {_MIN_SIDE} px on each side to be registered, got {shape}"
        )
    factor = max(min(shape) // _WORKING_SIDE, 1)
    small = [_block_means(frame.astype(np.float32), factor) for frame in frames]
    bands = [_band_pass(image) for image in small]
    # If the middle frame shows another scene, its neighbors hardly do.
    most: dict[int, Array] = {}
    for start in (count // 2, count // 2 - 1, count // 2 + 1):
        most = max(most, _chain(bands, start, done), key=len)
        if len(most) >= max(3, count / 2):
            break
        done = _ignore  # of another attempt
    kept = np.array(sorted(most))
    if len(kept) < count:
        out = names(np.setdiff1d(np.arange(count), kept))
        if len(kept) < max(3, count / 2):
            raise ValueError(
                f"frames must show one scene to be registered, got {len(kept)} of {count} that do; "
                f"frames {out} cannot be registered to those before them"
            )
        warnings.warn(f"frames {out} cannot be registered: left out", stacklevel=4)
    reference = int(kept[np.abs(kept - count // 2).argmin()])
    inverse = np.linalg.inv(most[reference])
    relative = {k: np.eye(3) if at_rest else most[k] @ inverse for k in most}
    gain, offset = _brightness(small, kept, relative, reference)
    warps = np.full((count, 2, 3), np.nan)
    # From pixels of the small frames, whose centers lie between those of a block.
    scale = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]])
    for k in kept:
        warps[k] = (scale @ relative[int(k)] @ np.linalg.inv(scale))[:2]
    return Registration(kept=kept, warps=warps, gain=gain, offset=offset)


class Motion(NamedTuple):
    """Motion of the image from one frame to the next.

    Attributes
    ----------
    size : float
        Root mean square over the centers of the four quarters of the frame, px of a reduced frame,
        so that a turn and a growth of the image count as a shift does.
    shift : float
        Motion of the center, px.
    growth : float
        Change of the scale, a share of it.
    turn : float
        Rotation, degrees.
    """

    size: float
    shift: float
    growth: float
    turn: float


def motion_between(first: Image, second: Image) -> Motion:
    """Return the motion between two frames; none if they do not correlate."""
    factor = max(min(first.shape) // _WORKING_SIDE, 1)
    bands = [_band_pass(_block_means(f.astype(np.float32), factor)) for f in (first, second)]
    if (warp := _link(*bands)) is None:
        return Motion(0.0, 0.0, 0.0, 0.0)
    rows, cols = bands[0].shape
    centers = np.array([(x * cols, y * rows, 1) for x in (0.25, 0.75) for y in (0.25, 0.75)])
    moved = (centers @ warp.T - centers)[:, :2]
    change = complex(*warp[:2, 0])  # of the scale and the direction
    return Motion(
        size=float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))),
        shift=factor * float(np.hypot(*moved.mean(axis=0))),
        growth=abs(change) - 1,
        turn=float(np.degrees(np.angle(change))),
    )


def _block_means(image: NDArray, side: int) -> NDArray:
    """Return the means of square blocks; rows and columns that are left over are cut off."""
    rows, cols = (n // side for n in image.shape)
    whole = image[: rows * side, : cols * side]
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA))


def _band_pass(image: NDArray) -> NDArray:
    """Return what is coarser than the noise and finer than the illumination."""
    return cv2.GaussianBlur(image, (0, 0), 1.0) - cv2.GaussianBlur(image, (0, 0), 15)


def _chain(
    bands: Sequence[NDArray], start: int, done: Callable[[float], object]
) -> dict[int, Array]:
    """Return the frames that can be aligned, starting at one, each with its 3×3 warp from there."""
    warps: dict[int, Array] = {start: np.eye(3)}
    for numbers in (range(start - 1, -1, -1), range(start + 1, len(bands))):
        last = start
        for k in numbers:
            done((k if k > start else start - k) / len(bands))
            link = _link(bands[last], bands[k])
            if link is not None:
                warps[k] = link @ warps[last]
                last = k
    return warps


def _link(first: NDArray, second: NDArray) -> Array | None:
    """Return the similarity transform from the first image to the second, if they correlate."""
    start = np.eye(2, 3, dtype=np.float32)
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-6)
    try:
        correlation, found = cv2.findTransformECC(
            first, second, start, cv2.MOTION_AFFINE, end, np.ones(first.shape, np.uint8), 1
        )
    except cv2.error:  # a flat image, or one that leaves the other
        return None
    matrix = np.asarray(found)
    if not correlation > _CORRELATION:
        return None
    a, b = (matrix[0, 0] + matrix[1, 1]) / 2, (matrix[1, 0] - matrix[0, 1]) / 2
    center = (np.array(first.shape[::-1]) - 1) / 2
    warp = _similarity(a, b, matrix[:, :2] @ center + matrix[:, 2] - center, first.shape)
    return _small_motion(first, second) if np.hypot(*warp[:2, 2]) < 0.35 else warp  # of the corner


def _similarity(a: float, b: float, move: Array, shape: tuple[int, ...]) -> Array:
    """Return the 3×3 matrix of a turn and growth by a + bi about the center, which moves."""
    turn, center = np.array([[a, -b], [b, a]], float), (np.array(shape[::-1]) - 1) / 2
    return np.vstack([np.column_stack([turn, center + move - turn @ center]), [0, 0, 1]])


def _small_motion(first: NDArray, second: NDArray) -> Array:
    """Return the similarity transform from the first image to the second beside a change of blur.

    A growth of the blur that varies over the image resembles a motion: without this step, the depth
    of a stack at rest in benchmarks/registration.py becomes worse by 4 %. After larger motions the
    depth is better without it.
    """
    mean = (first + second) / 2
    dx, dy = (cv2.Scharr(mean, cv2.CV_32F, *order) / 32 for order in ((1, 0), (0, 1)))
    half = np.float32(max(mean.shape) / 2)
    y, x = ((np.arange(n, dtype=np.float32) - (n - 1) / 2) / half for n in mean.shape)
    y = y[:, None]
    columns = [dx, dy, x * dx + y * dy, x * dy - y * dx, mean, *_blur_columns(mean)]
    inner = slice(4, -4, 2)  # neighbors are smoothed, and the border may come from outside
    design, change = np.stack(columns)[:, inner, inner], (first - second)[inner, inner]
    right, down, growth, turn = _robust(design.reshape(len(columns), -1), change.ravel())[:4]
    return _similarity(1 + growth / half, turn / half, np.array([right, down]), mean.shape)


def _blur_columns(mean: NDArray) -> list[NDArray]:
    """Return the changes by a growth of the blur whose variance is a quadratic of the position."""
    blur = cv2.Laplacian(mean, cv2.CV_32F)
    v, u = (np.linspace(-1, 1, n, dtype=np.float32) for n in mean.shape)
    v = v[:, None]
    return [blur * shape for shape in (np.float32(1), u, v, u * u, u * v, v * v)]


def _robust(design: NDArray, target: NDArray) -> Array:
    """Return the coefficients of the rows of a design, an M-estimate with Tukey's biweight."""
    weight, rounding = np.ones_like(target), np.finfo(np.float32).eps * np.abs(target).max()
    for _ in range(2):
        weighted = design * weight
        found = np.linalg.lstsq(weighted @ design.T, weighted @ target, rcond=1e-9)[0]
        off = target - found.astype(np.float32) @ design
        limit = max(TUKEY_LIMIT * robust_std(off), rounding)
        weight = tukey_weights(off, limit) if limit else weight
    return found


def _brightness(
    small: Sequence[NDArray],
    kept: NDArray[np.intp],
    warps: dict[int, Array],
    reference: int,
) -> tuple[Array, Array]:
    """Return gain and offset of every frame relative to the reference, NaN for those left out."""
    smooth = [_smooth(small[k], warps[int(k)][:2]) for k in kept]
    links = [_illumination_change(a, b, m & n) for (a, m), (b, n) in pairwise(smooth)]
    # An offset of less than 1 % of the grey level is none, and one that a gain compensates is blur.
    level = abs(float(np.mean([image.mean() for image, _ in smooth])))
    if (
        np.median([min(abs(plus), level * abs(ratio - 1)) for _, plus, ratio in links])
        < 0.01 * level
    ):
        links = [(ratio, 0.0, ratio) for _, _, ratio in links]
    gain, offset = np.full((2, len(small)), np.nan)
    gain[kept[0]], offset[kept[0]] = 1, 0
    for (a, b), (factor, plus, _) in zip(pairwise(kept), links, strict=True):
        gain[b], offset[b] = factor * gain[a], factor * offset[a] + plus
    gain /= gain[reference]
    return gain, offset - gain * offset[reference]


def _smooth(image: NDArray, warp: Array) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return an aligned frame, smoothed so that blur no longer matters, and where it is known."""
    size, flags = image.shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    inside = cv2.warpAffine(np.ones_like(image), warp, size, flags=flags)
    moved = cv2.warpAffine(image, warp, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(moved, (0, 0), 4.0), cv2.GaussianBlur(inside, (0, 0), 4.0) > 0.99


def _illumination_change(
    first: NDArray, second: NDArray, known: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Return gain and offset from one smooth frame to the next, and their ratio if it is a gain."""
    mean = (first + second) / 2
    columns = np.stack([mean, np.ones_like(mean), *_blur_columns(mean)])
    # Differences about the mean: b − a = c (a + b) / 2 + o.
    change, plus = 0.0, 0.0
    some = known[::2, ::2]  # of smooth frames
    if some.any():
        change, plus = _robust(columns[:, ::2, ::2][:, some], (second - first)[::2, ::2][some])[:2]
    lit = known & (first > 0) & (second > 0)
    ratio = np.exp(np.median(np.log(second[lit] / first[lit]))) if lit.any() else 1.0
    return (2 + change) / (2 - change), 2 * plus / (2 - change), float(ratio)
