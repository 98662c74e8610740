"""The one pass through the frames: what every second pixel and every fourth saw over the stack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Image
from microlib.focus._axis import Axis, every_other
from microlib.focus._measures import absolute_seconds, blur, halved, noise_gain
from microlib.focus._peaks import PeakFollower, fit_peaks
from microlib.focus._settings import Settings
from microlib.focus._significance import block_means

#: Rows that are looked at on either side of a strip: what the measures' windows reach. Rows of a
#: strip, of which fewer are taken of more frames, so that its measures stay below 64 MB.
_MARGIN, _MOST_ROWS = 32, 256


@dataclass(frozen=True)
class Levels:
    """What the measures are on noise alone. Each is raised by it: where a measure sees nothing but
    noise it is nearly flat then, and the others decide.

    Attributes
    ----------
    fine, coarse, edge : float
        Of the second differences at full size and at half, and of the deviation from a mean.
    """

    fine: float
    coarse: float
    edge: float

    @classmethod
    def of(cls, noise: float, settings: Settings) -> Levels:
        """Return them for a noise, grey levels. Halving halves it."""
        coarse = 0.5 * noise * noise_gain(settings.coarse)
        return cls(noise * noise_gain(settings.fine), coarse, 0.4 * noise)


@dataclass(frozen=True)
class Followed:
    """The peaks of every second pixel, the wide ones of every fourth; depths in steps.

    Attributes
    ----------
    depth, strength, top, best : ndarray, shape (rows, cols)
        By the product of the fine and the coarse measure: depth and its certainty, height of the
        peak, and number of the best frame.
    profiles : ndarray, shape (n, rows / 4, cols / 4)
        Product of each frame, as means of blocks.
    along, down : ndarray, shape (7, rows, cols)
        The fine measure of either direction in the frames around the best one.
    edge : ndarray, shape (rows, cols)
        Depth by the edge measure.
    wide : ndarray, shape (rows / 2, cols / 2)
        Depth by the wide window.
    """

    depth: NDArray[np.float32]
    strength: NDArray[np.float32]
    top: NDArray[np.float32]
    best: NDArray[np.uint16]
    profiles: NDArray[np.float32]
    along: NDArray[np.float32]
    down: NDArray[np.float32]
    edge: NDArray[np.float32]
    wide: NDArray[np.float32]


def follow(
    frames: Sequence[Image],
    axis: Axis,
    settings: Settings,
    *,
    workers: int = 1,
    done: Callable[[float], object] = lambda share: None,
) -> Followed:
    """Follow the focus measures of every pixel through the stack, in strips of rows.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames.
    axis : Axis
        How they are averaged.
    settings : Settings
        Those of the measures.
    workers : int
        Threads that share the strips.
    done : callable
        Told after each strip what share of the rows is done.
    """
    shape = frames[0].shape
    rows = 2**24 // max(shape[1] * len(axis.steps), 1) - 2 * _MARGIN
    # A multiple of eight, as blocks of eight rows are averaged.
    tops = range(0, shape[0], int(np.clip(rows // 8 * 8, 64, _MOST_ROWS)))

    def strip(top: int) -> Followed:
        bottom = min(top + tops.step, shape[0])
        start = max(top - _MARGIN, 0)
        seen = slice(start, min(bottom + _MARGIN, shape[0]))
        keep = slice(top - start, bottom - start)
        return _follow_strip(frames, axis, settings, seen, keep)

    parts = []
    with ThreadPoolExecutor(workers) as pool:
        for part in pool.map(strip, tops):  # told here, one after the other, from this thread
            parts.append(part)
            done(len(parts) / len(tops))
    whole = {}
    for field in fields(Followed):
        block = {"profiles": 8, "wide": 4}.get(field.name, 2)
        rows, cols = (-(-n // block) for n in shape)
        joined = np.concatenate([getattr(part, field.name) for part in parts], axis=-2)
        whole[field.name] = np.ascontiguousarray(joined[..., :rows, :cols])
    return Followed(**whole)


def _follow_strip(
    frames: Sequence[Image], axis: Axis, settings: Settings, rows: slice, keep: slice
) -> Followed:
    """Do the work of `follow` on some rows of the frames, of which those to keep are fitted."""
    main, edge, wide = _measure_strip(frames, axis, settings, rows)
    here = slice(keep.start // 2, -(-keep.stop // 2))
    coarse = slice(keep.start // 4, -(-keep.stop // 4))
    windows, steps = main.windows(here), axis.steps
    beyond = (1 - len(steps) / len(axis.positions)) / 2  # the first mean lies half a group inside
    depth, strength = fit_peaks(windows[0], main.best[here], steps, beyond=beyond)
    edges, _ = fit_peaks(edge.windows(here)[0], edge.best[here], steps, beyond=beyond)
    far, _ = fit_peaks(wide.windows(coarse)[0], wide.best[coarse], steps)
    return Followed(
        depth=depth,
        strength=strength,
        top=main.top[here],
        best=main.best[here],
        profiles=np.stack([block_means(m, 2) for m in main.all(here)]),
        along=windows[1],
        down=windows[2],
        edge=edges,
        wide=far,
    )


def _measure_strip(
    frames: Sequence[Image], axis: Axis, settings: Settings, rows: slice
) -> tuple[PeakFollower, PeakFollower, PeakFollower]:
    """Return the measures of some rows: the product with its factors, the edge, the wide window."""
    groups, levels = len(axis.steps), Levels.of(axis.noise, settings)
    for k in range(groups):
        frame = axis.frame(frames, k, (rows, slice(None)))
        # Blocks of four by four pixels for every fourth.
        down, right = (-n % 4 for n in frame.shape)
        if down or right:
            frame = cv2.copyMakeBorder(frame, 0, down, 0, right, cv2.BORDER_REPLICATE)
        half = halved(frame.astype(np.float32, copy=False))
        if k == 0:
            main = PeakFollower(groups, 3, half.shape, 3)
            edge = PeakFollower(groups, 1, half.shape, 1)
            wide = PeakFollower(groups, 1, (half.shape[0] // 2, half.shape[1] // 2), 2)
        product, *directions = main.slot(k)
        for second, out in zip(absolute_seconds(frame, settings.fine), directions, strict=True):
            out[:] = blur(halved(second), settings.fine_window)
        p, q = absolute_seconds(half, settings.coarse)
        np.add(directions[0], directions[1], out=product)
        product += np.float32(levels.fine)
        product *= blur(p + q, settings.coarse_window) + np.float32(levels.coarse)
        main.push(k)
        off, floor = cv2.absdiff(half, blur(half, settings.edge_mean)), np.float32(levels.edge)
        np.multiply(off + floor, blur(off, 1.0) + floor, out=edge.slot(k)[0])
        edge.push(k)
        wide.slot(k)[0] = cv2.blur(halved(p * p + q * q), (settings.wide, settings.wide))
        wide.push(k)
    return main, edge, wide


def peak_asymmetry(mosaics: Sequence[Image], axis: Axis, settings: Settings) -> tuple[float, float]:
    """Return slope and value at 0 µm of what asymmetric peaks add to a depth, µm.

    The blur of a lens that moves grows faster on one side of focus. A parabola is then off by its
    skewness times the mean square width of its weights, and twice the depth by half of that less
    the depth itself is not (Richardson's extrapolation). Found on the frames themselves.

    Parameters
    ----------
    mosaics : sequence of ndarray
        The `mosaic` of each frame.
    axis, settings
        As for `follow`.
    """
    squares = [every_other(image) for image in mosaics]
    z = axis.positions
    spacing = float(np.median(np.abs(np.diff(z))))
    each = replace(
        axis, ends=np.arange(len(z) + 1), means=z, spacing=spacing, steps=np.abs(z - z[0]) / spacing
    )
    depths = []
    for by, narrow in ((axis, 1.0), (each, 1.0), (each, np.sqrt(2))):
        main = _measure_strip(squares, by, settings, slice(None))[0]
        depth, strength = fit_peaks(main.windows()[0], main.best, by.steps, narrow=narrow)
        inside = (main.best > 1) & (main.best < len(by.steps) - 2)
        clear = inside & (strength > np.median(strength))
        depths.append(np.where(clear, by.micrometers(depth), np.nan))
    found, wide, half = depths
    bias, known = found - (2 * half - wide), np.isfinite(found + wide + half)
    if known.sum() < 50:
        return 0.0, 0.0
    off = np.abs(bias - np.median(bias[known]))
    known &= off <= 3 * np.median(off[known])
    bias, found = bias[known], found[known]
    # On a surface at one depth a slope would be that of noise.
    degree = 1 if np.std(found) > 3 * np.std(bias) else 0
    line = np.polyfit(found, bias, degree)
    shift = np.polyval(line, found)
    # Weak texture scatters by 0.3 of a step; symmetric peaks shift by up to 0.015.
    if np.median(np.abs(shift)) < max(0.02 * axis.spacing, np.std(bias - shift) / 2):
        return 0.0, 0.0
    return (0.0, *line)[-2:]
