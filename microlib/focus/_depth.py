"""Shape from focus: the height of every pixel from its sharpest frame (3.10 to 3.14)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, product

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from microlib._common import Array, Frames, as_array, is_in_memory, positive, whole
from microlib.focus._correction import correct_spikes, smooth_depth
from microlib.focus._loops import fill_in
from microlib.focus._measures import (
    Banded,
    FocusMeasure,
    RowsMeasure,
    blank_level,
    blur,
    edge_measure,
    grey_variance,
    multiscale_measure,
    named_measure,
    noise_level,
    sum_modified_laplacian,
    tenengrad,
)
from microlib.focus._peaks import Profile, track_peaks
from microlib.focus._reliability import forget, is_alone, is_blank, is_chance, is_outshone, is_speck
from microlib.io import read_frames

__all__ = [
    "FocusResult",
    "correct_spikes",
    "depth_from_focus",
    "grey_variance",
    "smooth_depth",
    "sum_modified_laplacian",
    "tenengrad",
]

#: Frames whose numbers fit into 16 bits.
_MOST = 2**16 - 1
#: Frames of a stream that are read in one go.
_BATCH = 8
#: Reach of the broad windows that matters, px.
_BORDER = 8
#: Error of a smoothed depth over its roughness, which does not show errors that are smooth too.
_HIDDEN = 2.0


@dataclass(frozen=True)
class FocusResult:
    """Shape from focus, one value for every pixel.

    Attributes
    ----------
    depth : ndarray of float32, shape (rows, cols)
        Position at which the pixel is sharpest, µm; NaN where that cannot be told.
    uncertainty : ndarray of float32, shape (rows, cols)
        Estimate of the error, µm, from how rough the depth is around the pixel. It does not see
        errors that are smooth over some ten pixels, and is large at steps, where a pixel may belong
        to either side. NaN where `depth` is.
    confidence : ndarray of float32, shape (rows, cols)
        1 / (1 + (uncertainty / spacing of the frames)²), from 0 to 1; 0 where `depth` is NaN.
    index : ndarray of int, shape (rows, cols)
        Number of the sharpest frame; -1 where `depth` is NaN.
    all_in_focus : ndarray of the frames' type, shape (rows, cols)
        Every pixel from its sharpest frame.
    at_end : ndarray of bool, shape (rows, cols)
        Whether the sharpest frame is the first or the last, so that the true focus may lie
        outside the stack.
    """

    depth: NDArray[np.float32]
    uncertainty: NDArray[np.float32]
    confidence: NDArray[np.float32]
    index: NDArray[np.int32]
    all_in_focus: NDArray
    at_end: NDArray[np.bool_]


def depth_from_focus(
    frames: Frames,
    positions: ArrayLike,
    *,
    measure: str | FocusMeasure = "multiscale",
    window: int = 5,
    step: int = 1,
    threshold: float = 0.0,
    points: int | None = None,
    threads: int = 1,
) -> FocusResult:
    """Return the depth of every pixel of a focal stack.

    Parameters
    ----------
    frames : array_like of shape (n, rows, cols), path, or iterable
        At least three grey frames of 8 or 16 bits or floating point: an array, a multi-page TIFF
        or OME-TIFF, or an iterable of images or image files, such as a generator. Frames are read
        once and only a few are held.
    positions : array_like, shape (n,)
        Position of each frame along the optical axis, µm, rising or falling, not necessarily even.
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
    threads : int
        Threads that work on bands of rows. The result is the same for any number. With more than
        one, an iterable is asked for its next frame by whichever thread needs it first, never by
        two at a time.

    Returns
    -------
    FocusResult
        Depth in µm with its uncertainty, and the all-in-focus image.

    Raises
    ------
    ValueError
        If there are fewer than three frames or not as many as positions; frames differ in size or
        type, are not grey or not finite; positions are not finite or not strictly monotonic; a
        file cannot be read, or an option is out of range.

    Notes
    -----
    "multiscale" multiplies modified Laplacians of smoothed frames, at σ = 0.8 px averaged over 1 px
    and at 2 px averaged over 3 px. A wide scale alone blurs edges and a narrow one fails on weak
    texture; a product peaks where both agree. The logarithm of its profile is fitted by a parabola
    over seven frames, weighted with the measure, because Gaussian blur makes the profile nearly a
    Gaussian, (3.9). A second measure decides on which side of a step a pixel lies, and
    `smooth_depth` averages over what remains on its side; detail that stands out of the noise is
    put back. With any other measure the peak is
    fitted and nothing is corrected; `correct_spikes` and `smooth_depth` may follow.

    A depth is NaN where the measure is zero or flat, and where the best frame is random: half of
    its neighbours are more than two frames away from their median. "multiscale" also gives NaN
    where its peak is no higher than noise alone would have it, where peaks are five times fainter
    than those around and more than two frames away from them, which is the blur of a strong edge
    near by, in specks of a few pixels, and where half of the surroundings are unknown. A pixel
    whose best frame is the first or the last is flagged and gets that frame's position, unless a
    fit of more points puts it further in. Equal maxima go to the first.

    The first call on a machine compiles the inner loops, which takes some seconds, and keeps them.

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
    z = _check_positions(positions)
    fit = whole("points", 7 if measure == "multiscale" else 3, least=3, odd=True)
    if points is not None:
        fit = whole("points", points, least=3, odd=True)
    workers = whole("threads", threads, least=1)
    side = whole("window", window, least=1, odd=True)
    limit = float(positive("threshold", threshold, zero=True))
    reader = read_frames(frames)
    first = next(reader, None)
    if first is None:
        raise ValueError("frames must hold at least three frames, got none")

    measures: list[RowsMeasure]
    refined = measure == "multiscale"
    if refined:
        noise = noise_level(first)
        measures = [multiscale_measure(noise), edge_measure(noise)]
    elif callable(measure):
        function = _checked(measure)
        measures = [Banded(function, reach=max(first.shape))]
    else:
        measures = [named_measure(measure, side, whole("step", step, least=1), limit)]
    profile = track_peaks(
        chain([first], reader),
        z,
        measures,
        reaches=[fit // 2, 1][: len(measures)],
        batch=len(z) if is_in_memory(frames) else _BATCH,
        threads=workers,
    )
    depth: NDArray = profile.depths[0]
    forget(depth, is_chance(profile.index, len(z)))
    if refined:
        spacing = float(np.median(np.abs(np.diff(z))))
        if profile.strength is not None:
            ratio = profile.strength / np.float32(blank_level(noise))
            depth[is_blank(ratio, len(z))] = np.nan
        depth = _refine(depth, profile.depths[1], profile.weight, spacing)
        depth = np.clip(depth, z.min(), z.max())
    return _result(depth, profile, z, _HIDDEN if refined else 1.0)


def _check_positions(positions: ArrayLike) -> Array:
    z = as_array("positions", positions, shape=(None,))
    if len(z) < 3:
        raise ValueError(f"positions must be at least three, one for each frame, got {len(z)}")
    if len(z) > _MOST:
        raise ValueError(f"positions must be at most {_MOST}, got {len(z)}")
    gaps = np.diff(z)
    if not ((gaps > 0).all() or (gaps < 0).all()):
        at = int(np.flatnonzero(np.sign(gaps) != np.sign(z[-1] - z[0]))[0])
        raise ValueError(
            f"positions must rise or fall strictly, got {z[at]:g} followed by {z[at + 1]:g}"
        )
    return z


def _checked(measure: FocusMeasure) -> FocusMeasure:
    """Wrap the user's measure so that a wrong answer is refused instead of taken for a depth."""

    def checked(image: NDArray) -> NDArray:
        value = as_array("measure(frame)", measure(image), shape=image.shape, dtype=np.float32)
        if (value < 0).any():
            raise ValueError(f"measure(frame) must be zero or positive, got {value.min():g}")
        return np.ascontiguousarray(value)

    return checked


def _refine(
    depth: NDArray,
    fine: NDArray,
    weight: NDArray | None,
    spacing: float,
) -> Array:
    """Take out spikes, put pixels at steps on their own side, smooth on both sides of steps."""
    known = np.isfinite(depth)
    if not known.any():
        return depth.astype(np.float64)
    broad = _without_spikes(_filled(depth) / np.float32(spacing), 5)
    sharp = _filled(fine) / np.float32(spacing)
    median = cv2.medianBlur(sharp, 5)
    spread = np.asarray(cv2.medianBlur(np.abs(sharp - median), 5))
    sided = _choose_side(broad, np.asarray(cv2.medianBlur(median, 5)), spread < 1)
    steps = np.where(known, _without_spikes(sided, 3), np.nan)
    # At the image's border the windows see one side only and pull a slope inwards: there the planes
    # are to be laid through what lies further in.
    inner = _inside(depth.shape)
    trust = inner**4
    if weight is not None:
        # At an end of the stack a depth may come without a fit and so without a weight.
        fitted = known & (weight > 0)
        forget(steps, is_outshone(steps, np.where(fitted, weight, 0)))
        share = weight / np.median(weight[fitted]) if fitted.any() else np.ones_like(weight)
        trust *= np.where(fitted, np.clip(share, 1e-4, 1e4), 1.0)
    steps[is_speck(steps)] = np.nan
    steps[is_alone(steps)] = np.nan
    wide = smooth_depth(steps, jump=1.5, weight=trust)
    close = smooth_depth(steps, jump=1.5, radius=2.0, weight=trust)
    relief = np.where(inner < 1, 0, _relief(steps - close, close - wide))
    return (wide + relief * (close - wide)) * spacing


def _inside(shape: tuple[int, ...]) -> Array:
    """Return 1 where the broad windows stay inside the image, falling to 0.1 at its border."""
    down, along = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in shape)
    return np.clip((1 + np.minimum.outer(down, along)) / _BORDER, 0.1, 1.0)


def _relief(fine: NDArray, medium: NDArray) -> NDArray:
    """Return how much of the depth's medium detail is relief and not noise, 0 to 1.

    Noise goes through the windows of the measure, which leave it a fixed spectrum: whatever its
    strength, its variance between the wide and the close smoothing is 1.0 to 1.7 times that below
    the close one on smooth surfaces of any texture, contrast, noise and JPEG quality, and nine
    tenths of all pixels stay below 2.5. What exceeds that is on the object. As in Wiener's filter,
    its share of the variance is what is kept.
    """
    fine, medium = (
        blur(np.clip(np.nan_to_num(part), -0.5, 0.5).astype(np.float32) ** 2, 8.0)
        for part in (fine, medium)
    )
    return np.maximum(1 - 2.6 * fine / np.maximum(medium, 1e-12), 0)


def _filled(depth: NDArray) -> NDArray:
    """Put the nearest known depth in place of each NaN."""
    unknown = np.isnan(depth)
    if not unknown.any():
        return depth
    if unknown.all():
        return np.zeros_like(depth)
    nearest = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return depth[tuple(nearest)]


def _without_spikes(depth: NDArray, window: int) -> NDArray:
    """Replace by the median what is further from it than one frame."""
    median = cv2.medianBlur(depth, window)
    return np.where(np.abs(depth - median) > 1, median, depth)


def _choose_side(broad: NDArray, fine: NDArray, sure: NDArray[np.bool_]) -> NDArray:
    """Where fine and broad depth differ, take a neighbour's broad depth that agrees with the fine.

    Next to a step the broad window sees the other side as well, and the better textured side
    wins. A few pixels away, on the pixel's own side, it does not.
    """
    far = 6
    rows, cols = broad.shape
    padded = np.pad(broad, far, mode="symmetric")
    result = broad.copy()
    gap = np.abs(broad - fine)
    wrong = sure & (gap > 1.5)
    for distance in (3, far):
        for dy, dx in product((-distance, 0, distance), repeat=2):
            there = padded[far + dy : far + dy + rows, far + dx : far + dx + cols]
            # Nearer neighbours first: what is further away must agree the better.
            other = np.abs(there - fine) + np.float32(0.05 * distance)
            better = wrong & (other < gap) & (other < 1)
            result[better] = there[better]
            gap[better] = other[better]
    return result


def _result(
    depth: NDArray,
    profile: Profile,
    positions: Array,
    hidden: float,
) -> FocusResult:
    """Estimate the errors of the depths and put the result together."""
    spacing = np.float32(np.median(np.abs(np.diff(positions))))
    error = _roughness(depth, positions, profile.index)
    error *= np.float32(hidden) / spacing
    result = FocusResult(
        depth=depth.astype(np.float32, copy=False),
        uncertainty=error,
        confidence=np.empty_like(error),
        index=np.empty(depth.shape, np.int32),
        all_in_focus=profile.image,
        at_end=np.empty(depth.shape, bool),
    )

    fill_in(
        result.depth,
        profile.index,
        len(positions) - 1,
        spacing,
        result.uncertainty,
        result.confidence,
        result.index,
        result.at_end,
    )
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
    for _ in range(4):
        rough = rough - blur(rough, 4.0)
    rough = np.sqrt(np.maximum(cv2.boxFilter(rough * rough, -1, (3, 3)), 0))
    rows, cols = depth.shape
    return np.asarray(cv2.resize(rough, (cols, rows)))
