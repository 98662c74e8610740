"""Shape from focus: the height of every pixel from its sharpest frame (3.10 to 3.14)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Frames, Image, flag, of_kind, one_of, whole
from microlib.focus._blocks import depth_in_blocks, is_in_blocks
from microlib.focus._measures import TINY, FocusMeasure, blur, sum_modified_laplacian, user_measure
from microlib.focus._peaks import check_count, check_positions, three_point_peak
from microlib.focus._registration import Registered
from microlib.focus._registration import register as find_registration
from microlib.focus._result import FocusResult, as_type, finished
from microlib.focus._significance import block_means, judge_peaks
from microlib.focus._stages import default_depth
from microlib.io import read_frames

#: What is told how many parts of the work are done, and of how many; an exception from it ends all.
Progress = Callable[[int, int], object]

#: Reach of the measures' windows, px.
_WINDOW = 6
#: Axes of metadata that are no focus.
_NO_FOCUS = {"T": "times", "C": "channels"}


def depth_from_focus(
    frames: Frames,
    positions: ArrayLike | None = None,
    *,
    spacing: float | None = None,
    measure: str | FocusMeasure = "multiscale",
    window: int | None = None,
    workers: int = 1,
    register: bool = False,
    region: tuple[int, int, int, int] | None = None,
    reduce: int = 1,
    progress: Progress | None = None,
) -> FocusResult:
    """Return the depth of every pixel of a focal stack.

    Parameters
    ----------
    frames : array_like, path, iterable, or dask or zarr array
        At least three frames, grey or in color, of 8 or 16 bits or floating point, in whatever
        `microlib.io.read_frames` reads: an array or what is like one, a multi-page TIFF or
        OME-TIFF, a folder or pattern of images, a video, or an iterable of images or image files,
        such as a generator. The depth comes from luminance. All frames are held in memory. A dask
        or zarr array of shape (n, rows, cols), which may be larger, is worked on block by block.
    positions : array_like, shape (n,), optional
        Position of each frame along the optical axis, µm, rising or falling, not necessarily even.
        By default what a TIFF's OME or ImageJ metadata or an xarray.DataArray say.
    spacing : float, optional
        Distance of the frames instead, µm; the first one is at 0.
    measure : {"multiscale", "sml"} or callable
        Focus measure. The default is the most accurate; "sml" is the thesis'
        sum-modified-Laplacian. A callable takes a frame and returns its measure, zero or positive
        and of the same shape, such as ``functools.partial(sum_modified_laplacian, threshold=7)``.
    window : int, optional
        Side of the square over which the measure is summed, px, odd; by default 5. Neither for
        "multiscale", which has windows of its own, nor for a callable.
    workers : int
        Number of threads. The result is the same for any number. Blocks of a dask or zarr array are
        shared out by dask instead.
    register : bool
        Whether to undo shift, rotation, scale and brightness that change from frame to frame. The
        result is that of the middle frame's camera; what lies outside some frame that matters for a
        pixel has no depth.
    region : tuple of four ints, optional
        Part of the frames that is looked at, (x, y, width, height) in px.
    reduce : int
        Side of the square blocks of pixels that become one, for a quick preview.
    progress : callable, optional
        Told how many parts of the work are done and how many there are: one for each frame that is
        read, and as many again for the depth. An exception from it ends the work. Neither this nor
        `measure`, `register` or `reduce` are for dask and zarr arrays.

    Returns
    -------
    FocusResult
        Depth in µm with its uncertainty, and the all-in-focus image. Of a dask or zarr array dask
        arrays, which are computed when they are asked for, on whatever scheduler dask is told to
        use, and which ``to_zarr`` writes.

    Raises
    ------
    ValueError
        If there are fewer than three frames or not as many as positions; frames differ in size or
        type, are no images, not finite or beyond ±10¹⁰, or differ in time or channel and not in
        focus; positions are not finite, not strictly monotonic, or not known; a file cannot be
        read, or an option is out of range or none that this measure or array can use. With
        `register`, if less than half of the frames show one scene.

    Warns
    -----
    UserWarning
        If frames that show something else are left out by `register`; if light or position change
        from frame to frame and `register` is not given; if frames have black margins.

    Notes
    -----
    "multiscale" multiplies modified Laplacians of smoothed frames, at σ = 0.8 px of the frame and
    1 px of the frame at half its size. A wide scale alone blurs edges and a narrow one fails on
    weak texture; a product peaks where both agree. It is followed in every second pixel. The
    logarithm of its profile is fitted by a parabola over seven frames, weighted with the measure,
    because Gaussian blur makes the profile nearly a Gaussian, (3.9). Profiles are more pointed than
    that, which pulls depths towards the frames, and this is taken back. A second measure decides on
    which side of a step a pixel lies, and `smooth_depth` averages over what remains on its side.
    Where the depth is unknown, or far from that by a window of 52 px and without the fine detail
    that blurred light lacks, the wide depth is taken, but none beside steps. Detail that the
    smoothing takes away is put back as far as it is relief: depths from second differences along
    rows and down columns have nearly independent errors, so that their covariance is that of the
    object, and their difference tells the noise.
    Where the depth is steep or has a step, the peaks are fitted again at full size.
    Frames that are closer than the depth of field asks for are averaged first, as many as make the
    peaks about four frames wide, so that more frames mean less noise. With any other measure three
    frames tell the peak, (3.13), and nothing is corrected; `correct_spikes` and `smooth_depth` may
    follow.

    A lens that moves makes peaks asymmetric, which shifts the vertex of a parabola. With
    "multiscale" the shift is found from fits with two widths of weights (Richardson's
    extrapolation), subtracted, and a quarter of it is stated.

    A depth is NaN where the measure is zero or flat, and where the peak is no more than noise:
    profiles of blocks of 8 px have no peak in common with their neighbors that exceeds what they
    differ by. Where such a peak is doubtful, the stated uncertainty is that of a random depth. Bare
    ground in JPEG, smoothed or quantized frames keeps a depth that is stated as certain in at most
    2 % of its pixels on average, up to 14 % in resized JPEG frames. Bars of 4 px have a wrong depth
    with a small uncertainty in 20 to 26 % of their pixels, bars of 8 px in up to 4 %. "multiscale"
    also gives NaN where peaks are five times fainter than those around and more than two frames
    away from them, which is the blur of a strong edge near by, in specks of a few pixels, where
    half of the surroundings are unknown, and where depths by two measures differ but no wide window
    decides. A pixel whose best frame is the first or the last is flagged and gets that frame's
    position, unless the fit of seven frames puts it further in. Equal maxima go to the first.

    Blocks of a dask array are chunks of 1024 px, or as they are if their sides are multiples of
    64 px, with 128 px around them. They agree with the whole image to 0.004 of the frames' spacing.

    References
    ----------
    S. K. Nayar and Y. Nakagawa, Shape from focus, IEEE Trans. PAMI 16 (1994) 824.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib import synthetic
    >>> from microlib.focus import depth_from_focus
    >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
    >>> positions = np.arange(0.0, 100.0, 10.0)
    >>> height = np.full((48, 48), 42.0)
    >>> stack = synthetic.focal_stack(texture, height, positions, blur_rate=0.1)
    >>> result = depth_from_focus(stack, spacing=10.0)
    >>> round(float(np.median(result.depth)))
    42
    """
    single = _single_measure(measure, window)
    threads, register = whole("workers", workers, least=1), flag("register", register)
    of_kind("progress", progress, Callable, type(None))
    if is_in_blocks(getattr(frames, "data", frames)):  # that of an xarray.DataArray
        given: dict[str, Any] = {"measure": measure, "workers": workers, "register": register}
        given |= {"reduce": reduce, "progress": progress}
        usual: Any = depth_from_focus.__kwdefaults__
        for name, value in given.items():
            if value != usual[name]:
                raise ValueError(
                    f"{name} must not be given for a dask or zarr array, got {value!r}"
                )
        return depth_in_blocks(frames, positions, spacing, region)
    tell = progress or (lambda done, count: None)
    reader = read_frames(frames, region=region, reduce=reduce, color=True)
    stack = open_stack(reader, positions, spacing, tell)
    count, inside = len(stack.positions), margin_mask(stack.grey)
    if not register:
        warn_of_changes(stack.grey)

    def done(share: float) -> None:
        tell(round(count * (1 + share)), 2 * count)

    found = find_registration(stack.grey) if register else None
    seen = stack if found is None else stack.registered(found)
    if single is None:
        result = default_depth(seen.grey, seen.color, seen.positions, workers=threads, done=done)
    else:
        result = three_point_depth(seen, single, done)
    if found is not None:
        result = _cut(result, found, stack.grey[0].dtype)
    if not inside.all():
        warnings.warn("frames have black margins: no depth there", stacklevel=2)
        result = _masked(result, ~inside)
    return replace(result, pixel_size=stack.pixel_size, corner=stack.corner)


def _single_measure(measure: str | FocusMeasure, window: int | None) -> FocusMeasure | None:
    """Return the measure of one frame; None for "multiscale", which has several."""
    name = "a function"
    if not callable(measure):
        name = repr(one_of("measure", measure, ("multiscale", "sml")))
    if window is not None and measure != "sml":
        raise ValueError(f"window must not be given with measure {name}, got {window!r}")
    if measure == "sml":
        side = 5 if window is None else whole("window", window, least=1, odd=True)
        return partial(sum_modified_laplacian, window=side)
    return partial(user_measure, measure) if callable(measure) else None


@dataclass(frozen=True, eq=False)
class Stack:
    """Frames in memory.

    Attributes
    ----------
    grey : list of ndarray, shape (rows, cols)
        Their grey levels, or luminance.
    color : list of ndarray, shape (rows, cols, 3), or None
        Their colors, if they have any.
    positions : ndarray of float64, shape (n,)
        Position of each, µm.
    pixel_size, corner
        As the frames' reader has them.
    """

    grey: list[Image]
    color: list[Image] | None
    positions: Array
    pixel_size: float | None = None
    corner: tuple[float, float] = (0.0, 0.0)

    def registered(self, found: Registered) -> Stack:
        """Return the frames that were not left out, where the middle one has them."""
        color = None if self.color is None else found.images(self.color)
        return Stack(found.images(self.grey), color, self.positions[found.kept])


def open_stack(
    reader: Any, positions: ArrayLike | None, spacing: float | None, tell: Progress
) -> Stack:
    """Read a stack, once all that can be refused before was looked at."""
    if reader.axis in _NO_FOCUS:
        raise ValueError(
            f"frames must differ in focus, got a file of {reader.count} {_NO_FOCUS[reader.axis]} "
            f"(axis {reader.axis}); if they do, pass the array, as tifffile.imread gives it"
        )
    z, count = None, reader.count
    if spacing is None:
        z = check_positions(positions, told=reader.positions)
        # An iterator does not say how many there are; what has positions has as many frames.
        count = len(z)
        check_count(reader.count or count, count)
    raw: list[Image] = []
    for frame in islice(reader, None if count is None else count + 1):
        raw.append(frame)
        if count is not None:
            tell(min(len(raw), count), 2 * count)
    if not raw:
        raise ValueError("frames must hold at least three frames, got none")
    z = check_positions(positions, spacing, len(raw)) if z is None else z
    check_count(len(raw) if len(raw) <= len(z) else f"more than {len(z)}", len(z))
    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in raw] if reader.color else raw
    return Stack(grey, raw if reader.color else None, z, reader.pixel_size, reader.corner)


def three_point_depth(
    stack: Stack, measure: FocusMeasure, done: Callable[[float], object]
) -> FocusResult:
    """Return the peaks of one measure by (3.13)."""
    z = stack.positions
    window, profiles, best = track_peaks(stack.grey, measure, done)
    depth = three_point_peak(window, best, z)
    insignificant, random, _ = judge_peaks(profiles, window[1], 3)
    depth[insignificant] = np.nan
    return finished(
        depth,
        np.hypot(_roughness(depth, z, best), np.ptp(z) * random),
        best,
        spacing=float(np.median(np.abs(np.diff(z)))),
        at_end=(best == 0) | (best == len(z) - 1),
        shown=stack.grey if stack.color is None else stack.color,
    )


def track_peaks(
    frames: Sequence[Image], measure: FocusMeasure, done: Callable[[float], object]
) -> tuple[NDArray, NDArray, NDArray[np.uint16]]:
    """Return each pixel's measures around its best frame, profiles, and number of that frame.

    Returns
    -------
    window : ndarray of float32, shape (3, rows, cols)
        0 beyond the stack.
    profiles : ndarray of float32, shape (n, rows / 8, cols / 8)
        Means of the measure over blocks of 8 px.
    best : ndarray of uint16, shape (rows, cols)
        The first of equals.
    """
    shape = frames[0].shape
    before, top, after = window = np.zeros((3, *shape), np.float32)
    zero, last, profiles = np.zeros(shape, np.float32), np.zeros(shape, np.float32), []
    best = np.zeros(shape, np.uint16)
    for k, frame in enumerate(frames):
        value = np.asarray(measure(frame), np.float32)
        profiles.append(block_means(value, 3))
        cv2.copyTo(value, cv2.inRange(best, k - 1, k - 1), after)
        better = cv2.compare(value, top, cv2.CMP_GT)
        number = np.full(shape, k, np.uint16)
        for place, new in ((before, last), (top, value), (after, zero), (best, number)):
            cv2.copyTo(new, better, place)
        last = value
        done((k + 1) / len(frames))
    return window, np.stack(profiles), best


def _roughness(depth: NDArray, positions: Array, index: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return the local root mean square of what no smooth surface has, µm.

    Four times the difference from a Gaussian mean of 8 px: slopes and constant curvature leave no
    trace in it, and errors that change within some ten pixels pass. Taken on every second pixel,
    with the best frame's position where there is no depth.
    """
    # From the middle of the stack, where float32 has digits to spare.
    rough, frame = depth[::2, ::2], positions[index[::2, ::2]]
    rough = (np.where(np.isnan(rough), frame, rough) - positions.mean()).astype(np.float32)
    for _ in range(4):
        rough = rough - blur(rough, 4.0)
    rough = np.sqrt(np.maximum(cv2.boxFilter(rough * rough, -1, (3, 3)), 0))
    return np.asarray(cv2.resize(rough, depth.shape[::-1]))


def _masked(result: FocusResult, mask: NDArray[np.bool_]) -> FocusResult:
    """Set the depth of some pixels to NaN."""
    return replace(
        result,
        depth=np.where(mask, np.float32(np.nan), result.depth),
        uncertainty=np.where(mask, np.float32(np.nan), result.uncertainty),
        confidence=np.where(mask, np.float32(0), result.confidence),
        index=np.where(mask, np.int32(-1), result.index),
    )


def _cut(result: FocusResult, found: Registered, dtype: np.dtype) -> FocusResult:
    """Set pixels to NaN whose sharpest frames did not show them; number all frames."""
    result = _masked(result, found.unseen(result.index))
    return replace(
        result,
        index=np.append(found.kept, -1)[result.index].astype(np.int32),
        all_in_focus=as_type(result.all_in_focus, dtype),
        poses=found.poses,
        gain=found.gain,
        offset=found.offset,
    )


def margin_mask(frames: Sequence[Image]) -> NDArray[np.bool_]:
    """Return what no frame hides by a black margin, as other programs leave where they align."""
    inside = np.ones(frames[0].shape, bool)
    for frame, turn in product(frames, range(4)):
        turned = np.rot90(frame, turn)
        if not turned[0].any() and turned.any():
            first = int(np.argmax(turned.any(axis=1)))
            if np.count_nonzero(turned[first]) > turned.shape[1] / 2:  # no thing on black ground
                np.rot90(inside, turn)[: first + _WINDOW] = False
    return inside


def warn_of_changes(frames: Sequence[Image]) -> None:
    """Warn if light or position change from frame to frame, which registration undoes."""
    if len(frames) < 4 or min(frames[0].shape) < 64:  # too few or too small to tell
        return
    # Of other sides than powers of two cv2.phaseCorrelate finds half a pixel where nothing moved.
    side = min(2 ** int(np.log2(min(frames[0].shape))), 256)
    small = [
        cv2.resize(f, (side, side), interpolation=cv2.INTER_AREA).astype(np.float32) for f in frames
    ]
    level = np.log(np.maximum([float(frame.mean()) for frame in small], TINY))
    # Defocus changes the light smoothly, which third differences suppress.
    flicker, moves = float(np.median(np.abs(np.diff(level, 3)))), []
    for k in (len(small) - 1) * np.arange(1, 4) // 4:
        shift, peak = cv2.phaseCorrelate(small[k], small[k + 1])
        move = float(np.hypot(shift[0], shift[1]))
        moves.append(move if peak > 0.4 and move < 16 else 0.0)  # of noise it may be any
    # Light that scatters by 2 % gives 0.06; at rest one of the moves stays below 0.2 px.
    if flicker > 0.06 or min(moves) > 0.25:
        what = "light" if flicker > 0.06 else "position"
        warnings.warn(
            f"frames change in {what} from one to the next: register=True (--register) undoes it",
            stacklevel=3,
        )
