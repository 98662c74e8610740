"""Shape from focus: the height of every pixel from its sharpest frame (3.10 to 3.14)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    Frames,
    Image,
    Tidy,
    as_array,
    flag,
    is_in_memory,
    of_kind,
    one_of,
    scalar,
    whole,
)
from microlib.focus._loops import fill_in
from microlib.focus._measures import (
    MEASURES,
    Banded,
    FocusMeasure,
    RowsMeasure,
    blur,
    named_measure,
)
from microlib.focus._multiscale import Axis, Maps, Part, depth_steps
from microlib.focus._peaks import FARTHEST, track_peaks
from microlib.focus._questions import answered
from microlib.focus._reliability import incoherent_mask, set_to_nan
from microlib.focus._replay import Replay
from microlib.focus._selection import select, warped
from microlib.focus._stack import Progress, open_stack
from microlib.focus._survey import (
    MOST_PIXELS,
    FocusSurvey,
    answers_of,
    axis_of,
    axis_of_survey,
    check_survey,
    survey_of,
)
from microlib.focus._tiles import tile_maps, tiles_of
from microlib.focus._window import Window
from microlib.io import read_frames

#: Frames whose numbers fit into 16 bits.
_MOST = 2**16 - 1
#: Frames in a fit of the peak: beyond, its window takes a gigabyte a megapixel. Threads: more than
#: any machine has processors.
_MOST_POINTS, _MOST_WORKERS = 255, 256
#: Frames of a stream that are read in one go: memory against turns of the interpreter. The result
#: is the same for any.
_BATCH = 8
#: Pixels up to which an image is worked on as a whole, which takes some 200 bytes for each, and the
#: side of the tiles of a larger one, px: with what is around them they take half a gigabyte. A tile
#: of less than a depth's own windows is no tile.
_MOST_WHOLE, _TILE, _LEAST_TILE = 2**24, 1024, 16
#: What a result has for each pixel.
_MAPS = ("depth", "uncertainty", "confidence", "index", "all_in_focus", "at_end")

# The constants of the default depth. What the result owes to each is measured in the table
# "constant changed" of benchmarks/focus.py; lengths along the axis are in frames.

#: Frames in the default's fit of the peak.
_POINTS = 7
#: Differences from a Gaussian mean that leave the roughness, its radius and the window over which
#: its square is averaged, in every second pixel. The depth does not depend on them.
_ROUGH_TIMES, _ROUGH_RADIUS, _ROUGH_WINDOW = 4, 4.0, 3


@dataclass(frozen=True)
class FocusResult(Tidy):
    """Shape from focus, one value for every pixel.

    Attributes
    ----------
    depth : ndarray of float32, shape (rows, cols)
        Position at which the pixel is sharpest, µm; NaN where that cannot be told.
    uncertainty : ndarray of float32, shape (rows, cols)
        Estimate of the error, µm; NaN where `depth` is. By "multiscale" from how far depths from
        horizontal and from vertical detail differ: noise, and relief that could not be told from
        it; from edges of the depth, where a pixel may belong to either side; and from how the light
        changes from frame to frame. It does not see a depth that is wrong as a whole. By other
        measures from how rough the depth is, which does not show errors that are smooth over some
        ten pixels.
    confidence : ndarray of float32, shape (rows, cols)
        1 / (1 + (uncertainty / spacing of the frames)²), from 0 to 1; 0 where `depth` is NaN. The
        spacing is that of the averaged frames where "multiscale" averages, see Notes.
    index : ndarray of int, shape (rows, cols)
        Number of the frame nearest to the depth by "multiscale", of the sharpest frame by any other
        measure; -1 where `depth` is NaN.
    all_in_focus : ndarray of the frames' type, shape (rows, cols)
        Every pixel from the frame `index`, or where there is no depth from its sharpest one.
    at_end : ndarray of bool, shape (rows, cols)
        Whether the sharpest frame is the first or the last, so that the true focus may lie
        outside the stack. Averaged frames count as one.
    poses : ndarray, shape (n, 2, 3), or None
        If the stack was registered: for each frame the matrix that takes x, y and 1 of a pixel of
        the result to x and y of the same place in the frame, px. NaN for frames that were left out.
    gain, offset : ndarray, shape (n,), or None
        If the stack was registered: grey levels of the frame at the image's center are `gain` times
        those of the middle frame, plus `offset`.
    """

    depth: NDArray[np.float32]
    uncertainty: NDArray[np.float32]
    confidence: NDArray[np.float32]
    index: NDArray[np.int32]
    all_in_focus: Image
    at_end: NDArray[np.bool_]
    poses: Array | None = None
    gain: Array | None = None
    offset: Array | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return what the maps come to as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            ``rows`` and ``columns``; ``known``, the share of pixels that have a depth; least,
            median and largest depth, median and largest uncertainty, µm, None where nothing is
            known; ``at_end``, the share of pixels that are sharpest in an end frame.
        """
        known = np.isfinite(self.depth)
        depth, uncertainty = self.depth[known], self.uncertainty[known]
        nothing = not known.any()
        return {
            "rows": self.depth.shape[0],
            "columns": self.depth.shape[1],
            "known": float(known.mean()),
            "depth_least": None if nothing else float(depth.min()),
            "depth_median": None if nothing else float(np.median(depth)),
            "depth_largest": None if nothing else float(depth.max()),
            "uncertainty_median": None if nothing else float(np.median(uncertainty)),
            "uncertainty_largest": None if nothing else float(uncertainty.max()),
            "at_end": float(self.at_end.mean()),
        }

    def select(self, frames: Frames) -> Image:
        """Return an image of other frames of the same places, such as another channel.

        Parameters
        ----------
        frames : array_like, path, or iterable
            As many frames as the stack has, of the same size, grey or in color, as for
            `microlib.io.read_frames`.

        Returns
        -------
        ndarray of the frames' type, shape (rows, cols) or (rows, cols, 3)
            Every pixel from the frame `index`, or that of the nearest pixel that has one. If the
            stack was registered, its `poses` are applied, its `gain` and `offset` are not.

        Raises
        ------
        ValueError
            If no pixel has a depth, or the frames are too few or of another size.

        Examples
        --------
        >>> from microlib import synthetic
        >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
        >>> positions = np.arange(0.0, 100.0, 10.0)
        >>> flat = np.full((48, 48), 42.0)
        >>> stack = synthetic.focal_stack(texture, flat, positions, blur_rate=0.1)
        >>> result = depth_from_focus(stack, positions)
        >>> bool((result.select(255 - stack) == 255 - result.all_in_focus).all())
        True
        """
        if (self.index < 0).all():
            raise ValueError("frames cannot be chosen from, got a depth that is nowhere known")
        reader: Iterable[Image] = read_frames(frames, color=True)
        if self.poses is not None:
            known = zip(reader, self.poses, strict=False)
            # A frame that was left out is nobody's best one.
            reader = (warped(f, pose) if np.isfinite(pose).all() else f for f, pose in known)
        return select(reader, self.index)


def depth_from_focus(
    frames: Frames,
    positions: ArrayLike | None = None,
    *,
    measure: str | FocusMeasure = "multiscale",
    window: int = 5,
    step: int = 1,
    threshold: float = 0.0,
    points: int | None = None,
    workers: int = 1,
    register: bool = False,
    region: tuple[int, int, int, int] | None = None,
    reduce: int = 1,
    progress: Progress | None = None,
    tile: int | None = None,
    survey: FocusSurvey | None = None,
) -> FocusResult:
    """Return the depth of every pixel of a focal stack.

    Parameters
    ----------
    frames : array_like, path, or iterable
        At least three frames, grey or in color, of 8 or 16 bits or floating point, in whatever
        `microlib.io.read_frames` reads: an array or what is like one, a multi-page TIFF or
        OME-TIFF, a folder or pattern of images, a video, or an iterable of images or image files,
        such as a generator. The depth comes from luminance. Only a few frames are held.
        "multiscale" looks at them several times: what is no array, file, list or tuple, and so may
        come but once, is kept in a temporary file until then. Other measures look once, but with
        colors or `register` frames are read anew, and an iterator is held in memory.
    positions : array_like, shape (n,), optional
        Position of each frame along the optical axis, µm, rising or falling, not necessarily even.
        By default what a TIFF's OME or ImageJ metadata say.
    measure : {"multiscale", "sml", "tenengrad", "variance"} or callable
        Focus measure. The default is the most accurate; "sml" is the thesis'
        sum-modified-Laplacian. A callable takes a frame and returns its measure, zero or positive
        and of the same shape.
    window : int
        Side of the square over which the measure is summed, px, odd. "multiscale" has windows of
        its own.
    step, threshold : int and float
        Spacing (px) and threshold (grey levels) of (3.11) and (3.12); for "sml" only.
    points : int, optional
        Frames in the fit of the peak, odd, at least 3. By default 7 for "multiscale", and 3, the
        thesis' interpolation (3.13), for all others.
    workers : int
        Number of threads that work on bands of rows. The result is the same for any number. With
        more than one, an iterable is asked for its next frame by whichever thread needs it first,
        never by two at a time.
    register : bool
        Whether to undo shift, rotation, scale and brightness that change from frame to frame. The
        result is that of the middle frame's camera; what lies outside some frame that matters for a
        pixel has no depth.
    region : tuple of four ints, optional
        Part of the frames that is looked at: top row, left column, rows and columns, px.
    reduce : int
        Side of the square blocks of pixels that become one, for a quick preview.
    progress : callable, optional
        Told after each frame how many have been read and how many there are to read, in all
        passes; in tiles, how many are done and how many there are. An exception from it ends the
        work.
    tile : int, optional
        Side of the square tiles that are worked on one after the other, px, for grey frames and
        "multiscale". Of an array only the tile and what is around it are loaded, such as from zarr;
        other frames are kept in a temporary file. The result does not depend on it. By default
        images of more than 16 million pixels are worked on in tiles of 1024.
    survey : FocusSurvey, optional
        What `survey_focus` found in the whole of these frames. Then `region` has the depth that the
        whole image has there, to the last bit, so that several machines can share an image.

    Returns
    -------
    FocusResult
        Depth in µm with its uncertainty, and the all-in-focus image.

    Raises
    ------
    ValueError
        If there are fewer than three frames or not as many as positions; frames differ in size or
        type, are no images, not finite or beyond ±10¹⁰, or differ in time or channel and not in
        focus; positions are not finite, not strictly monotonic, or not known; a file cannot be
        read, or an option is out of range. With `register`, if less than half of the frames show
        one scene.

    Warns
    -----
    UserWarning
        If frames that show something else are left out by `register`.

    Notes
    -----
    "multiscale" multiplies modified Laplacians of smoothed frames, at σ = 0.8 px averaged over 1 px
    and at 2 px averaged over 3 px. A wide scale alone blurs edges and a narrow one fails on weak
    texture; a product peaks where both agree. The logarithm of its profile is fitted by a parabola
    over seven frames, weighted with the measure, because Gaussian blur makes the profile nearly a
    Gaussian, (3.9). A second measure decides on which side of a step a pixel lies, and
    `smooth_depth` averages over what remains on its side. Where the depth is unknown or far from
    that by a window of 52 px, the scene as the wide window has it is blurred anew: if what was
    measured is no finer than that, it is the halo of an edge, and the wide depth is taken; beside
    steps none. The same holds on bare ground, where noise or compression decides: there depths by
    both measures differ, by a third of a frame on average. Detail that the smoothing takes away is
    put back as far as it is relief: depths from second differences along rows and along columns
    have nearly independent errors, so that their covariance is that of the object. Their difference
    tells the noise, as a function of how much texture there is, scene by scene; what is stated at
    edges and beside halos is a share of the heights there, and changes of the light count as far as
    the frames' mean levels show them.
    Frames that are closer than the depth of field asks for are averaged first, as many as make the
    peaks about four frames wide, so that more frames mean less noise. With any other measure the
    peak is fitted and nothing is corrected; `correct_spikes` and `smooth_depth` may follow.

    A depth is NaN where the measure is zero or flat, and where the best frame is random: half of
    its neighbors are more than two frames away from their median. "multiscale" also gives NaN
    where its peak is no higher than noise alone would have it, where peaks are five times fainter
    than those around and more than two frames away from them, which is the blur of a strong edge
    near by, in specks of a few pixels, where half of the surroundings are unknown, and where depths
    by two measures differ but no wide window tells. A pixel
    whose best frame is the first or the last is flagged and gets that frame's position, unless a
    fit of more points puts it further in. Equal maxima go to the first.

    Frames are registered by links between neighbors and those two apart: motion, gain and offset
    of each are fitted together with the change of blur, first without and then with a depth that is
    known at reduced size. What blur itself moves, half the gradient of its variance, stays.

    The first call on a machine compiles the inner loops, which takes some seconds, and keeps them;
    the logger "microlib.focus" says so.

    References
    ----------
    S. K. Nayar and Y. Nakagawa, Shape from focus, IEEE Trans. PAMI 16 (1994) 824.

    Examples
    --------
    >>> from microlib import synthetic
    >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
    >>> positions = np.arange(0.0, 100.0, 10.0)
    >>> height = np.full((48, 48), 42.0)
    >>> stack = synthetic.focal_stack(texture, height, positions, blur_rate=0.1)
    >>> result = depth_from_focus(stack, positions)
    >>> bool(np.abs(result.depth - 42.0).max() < 1.0)
    True
    """
    if not callable(measure):
        one_of("measure", measure, MEASURES)
    registered = flag("register", register)
    of_whole = region if survey is None else None
    stack = open_stack(
        frames, positions, region=of_whole, reduce=reduce, progress=progress, again=registered
    )
    z = _check_positions(stack.positions)
    stack.check_count(z)
    if survey is not None:
        of_kind("survey", survey, FocusSurvey)
    in_tiles = tile is not None or survey is not None
    if in_tiles and (measure != "multiscale" or registered or stack.color):
        raise ValueError(
            "tile and survey must be for grey frames, measure 'multiscale' and no register, got "
            f"measure {measure!r}, register {registered} and {'color' if stack.color else 'grey'}"
        )
    if registered or stack.color:
        options: dict[str, Any] = {"measure": measure, "window": window, "step": step}
        options |= {"threshold": threshold, "points": points, "workers": workers}
        return stack.focus(z, partial(depth_from_focus, **options), registered=registered)
    frames = stack.frames
    usual = _POINTS if measure == "multiscale" else 3
    fit = whole("points", usual if points is None else points, least=3, odd=True, most=_MOST_POINTS)
    threads = whole("workers", workers, least=1, most=_MOST_WORKERS)
    side = whole("window", window, least=1, odd=True)
    apart = whole("step", step, least=1)
    limit = scalar("threshold", threshold, least=0)
    batch = len(z) if is_in_memory(frames) else _BATCH
    if measure == "multiscale" and (in_tiles or np.prod(stack.shape) > _MOST_WHOLE):
        square = _TILE if tile is None else whole("tile", tile, least=_LEAST_TILE)
        wanted = _wanted(region if survey else None, stack.shape)
        with Replay(stack.untold, len(z), in_parts=True) as replay:
            turn = {"points": fit, "workers": threads}
            return _tiled(replay, z, survey, tiles_of(wanted, square), wanted, progress, **turn)
    if measure == "multiscale":
        with Replay(frames, len(z)) as replay:
            return _multiscale(replay, z, points=fit, batch=batch, workers=threads)
    reader = read_frames(frames)
    first = next(reader, None)
    if first is None:
        raise ValueError("frames must hold at least three frames, got none")
    chosen: RowsMeasure
    if callable(measure):
        chosen = Banded(_checked(measure), reach=max(first.shape))
    else:
        chosen = named_measure(measure, side, apart, limit)
    profile = track_peaks(
        chain([first], reader), z, [chosen], reaches=[fit // 2], batch=batch, workers=threads
    )
    depth = profile.depths[0]
    index = profile.index
    set_to_nan(depth, incoherent_mask(index, len(z)))
    spacing = np.float32(np.median(np.abs(np.diff(z))))
    error = _roughness(depth, z, index) / spacing
    at_end = (index == 0) | (index == len(z) - 1)
    return _result(depth, error, index, profile.image, at_end, spacing)


def _multiscale(
    stack: Replay, positions: Array, *, points: int, batch: int, workers: int
) -> FocusResult:
    """Find the default depth of a whole image, which answers its own questions if it is small."""
    shape = stack.shape
    turn: dict[str, Any] = {"points": points, "batch": batch, "workers": workers}
    if shape[0] * shape[1] <= MOST_PIXELS:
        axis, answers = axis_of(stack, positions), {}
    else:
        survey = survey_of(stack, positions, **turn)
        axis, answers = axis_of_survey(survey), answers_of(survey)
    window = Window.whole(shape)
    part = Part(lambda: iter(stack), window, window)
    maps = answered([depth_steps(part, axis, **turn)], answers)[0]
    return _of_maps(maps, axis)


def survey_focus(
    frames: Frames,
    positions: ArrayLike | None = None,
    *,
    points: int | None = None,
    workers: int = 1,
) -> FocusSurvey:
    """Measure what the default depth of a pixel owes to the whole stack.

    Parameters
    ----------
    frames, positions, points, workers
        As for `depth_from_focus`, the frames grey.

    Returns
    -------
    FocusSurvey
        To be passed to `depth_from_focus` with a `region`.

    Raises
    ------
    ValueError
        As `depth_from_focus`, or if the frames are in color.

    Notes
    -----
    An image of up to four million pixels is looked at as a whole. Of a larger one 64 small squares
    are, and nine patches of 384 px around those of them that have the highest and the lowest focus
    measures and evenly between.

    Examples
    --------
    >>> from microlib import synthetic
    >>> texture = synthetic.mixed_texture((48, 90), np.random.default_rng(0))
    >>> positions = np.arange(0.0, 100.0, 10.0)
    >>> stack = synthetic.focal_stack(texture, np.full((48, 90), 42.0), positions, blur_rate=0.1)
    >>> survey = survey_focus(stack, positions)
    >>> part = depth_from_focus(stack, positions, survey=survey, region=(8, 30, 32, 40))
    >>> whole = depth_from_focus(stack, positions)
    >>> bool((part.depth == whole.depth[8:40, 30:70]).all())
    True
    """
    stack = open_stack(frames, positions, region=None, reduce=1, progress=None, again=False)
    z = _check_positions(stack.positions)
    stack.check_count(z)
    if stack.color:
        raise ValueError("frames must be grey, got frames in color")
    fit = whole(
        "points", _POINTS if points is None else points, least=3, odd=True, most=_MOST_POINTS
    )
    threads = whole("workers", workers, least=1, most=_MOST_WORKERS)
    with Replay(stack.untold, len(z), in_parts=True) as replay:
        return survey_of(replay, z, points=fit, batch=_BATCH, workers=threads)


def _wanted(region: tuple[int, int, int, int] | None, shape: tuple[int, int]) -> Window:
    if region is None:
        return Window.whole(shape)
    if not isinstance(region, (tuple, list)) or len(region) != 4:
        raise ValueError(f"region must be top, left, rows and columns, got {region!r}")
    names = ("top", "left", "rows", "columns")
    values = zip(names, region, (0, 0, 1, 1), strict=True)
    top, left, rows, cols = (whole(f"region {name}", v, least=k) for name, v, k in values)
    if top + rows > shape[0] or left + cols > shape[1]:
        raise ValueError(f"region must lie in frames of shape {shape}, got {region}")
    return Window(top, left, top + rows, left + cols, shape)


def _tiled(
    stack: Replay,
    positions: Array,
    survey: FocusSurvey | None,
    tiles: list[Window],
    wanted: Window,
    progress: Progress | None,
    *,
    points: int,
    workers: int,
) -> FocusResult:
    """Find the default depth of a window tile by tile."""
    if survey is None:
        survey = survey_of(stack, positions, points=points, batch=_BATCH, workers=workers)
    check_survey(survey, stack.shape, positions, points)
    whole_maps: dict[str, NDArray] = {}
    for number, tile in enumerate(tiles):
        maps = tile_maps(stack, survey, tile, points=points, workers=workers)
        found = _of_maps(maps, axis_of_survey(survey))
        for name in _MAPS:
            value = getattr(found, name)
            if name not in whole_maps:
                whole_maps[name] = np.empty(wanted.size, value.dtype)
            whole_maps[name][tile.inside(wanted)] = value
        if progress is not None:
            progress(number + 1, len(tiles))
    return FocusResult(**whole_maps)


def _of_maps(maps: Maps, axis: Axis) -> FocusResult:
    spacing = np.float32(axis.spacing)
    return _result(maps.depth, maps.error, maps.best, maps.image, maps.at_end, spacing)


def _check_positions(positions: ArrayLike) -> Array:
    z = as_array("positions", positions, shape=(None,), largest=FARTHEST)
    if len(z) < 3:
        raise ValueError(f"positions must be at least three, one for each frame, got {len(z)}")
    if len(z) > _MOST:
        raise ValueError(f"positions must be at most {_MOST}, got {len(z)}")
    gaps = np.diff(z)
    if not ((gaps > 0).all() or (gaps < 0).all()):
        at = int(np.flatnonzero((np.sign(gaps) != np.sign(z[-1] - z[0])) | (gaps == 0))[0])
        raise ValueError(
            f"positions must rise or fall strictly, got {z[at]:g} followed by {z[at + 1]:g}"
        )
    if np.abs(gaps).min() < 1 / FARTHEST:
        raise ValueError(
            f"positions must be at least {1 / FARTHEST:g} µm apart, got {np.abs(gaps).min():g} µm"
        )
    return z


def _checked(measure: FocusMeasure) -> FocusMeasure:
    """Wrap the user's measure so that a wrong answer is refused instead of taken for a depth."""

    def checked(image: Image) -> NDArray:
        value = as_array("measure(frame)", measure(image), shape=image.shape, dtype=np.float32)
        if (value < 0).any():
            raise ValueError(f"measure(frame) must be zero or positive, got {value.min():g}")
        return np.ascontiguousarray(value)

    return checked


def _result(
    depth: NDArray,
    error: NDArray,
    best: NDArray[np.uint16],
    image: Image,
    at_end: NDArray[np.bool_],
    spacing: np.float32,
) -> FocusResult:
    """Put the result together; errors are in frames."""
    result = FocusResult(
        depth=depth.astype(np.float32, copy=False),
        uncertainty=error,
        confidence=np.empty_like(error),
        index=np.empty(depth.shape, np.int32),
        all_in_focus=image,
        at_end=at_end,
    )
    fill_in(result.depth, best, spacing, result.uncertainty, result.confidence, result.index)
    return result


def _roughness(depth: NDArray, positions: Array, index: NDArray[np.uint16]) -> NDArray:
    """Return the local root mean square of what no smooth surface has, µm.

    Four times the difference from a Gaussian mean of 8 px: slopes and constant curvature leave no
    trace in it, and errors that change within some ten pixels pass. Taken on every second pixel,
    with the best frame's position where there is no depth.
    """
    # From the middle of the stack, where float32 has digits to spare.
    rough = (depth[::2, ::2] - depth.dtype.type(positions.mean())).astype(np.float32)
    unknown = np.isnan(rough)
    if unknown.any():
        rough[unknown] = (positions - positions.mean())[index[::2, ::2][unknown]]
    for _ in range(_ROUGH_TIMES):
        rough = rough - blur(rough, _ROUGH_RADIUS)
    window = (_ROUGH_WINDOW, _ROUGH_WINDOW)
    rough = np.sqrt(np.maximum(cv2.boxFilter(rough * rough, -1, window), 0))
    rows, cols = depth.shape
    return np.asarray(cv2.resize(rough, (cols, rows)))
