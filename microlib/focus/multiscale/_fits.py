"""The one pass through the frames: measures of every second pixel, and the fits to their peaks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from microlib.focus.common import Band, Frame, Spread, bands, halved
from microlib.focus.multiscale._axis import Axis
from microlib.focus.multiscale._fit import fit_peaks
from microlib.focus.multiscale._profiles import find_profiles
from microlib.focus.multiscale._settings import FocusSettings

#: Rows that are read on either side of a strip, the reach of the measures' windows. Rows of a
#: strip, of which fewer are taken of more frames, so that its measures stay below 64 MB.
_MARGIN, _MAX_ROWS = 32, 256


@dataclass(frozen=True)
class Fits:
    """Peaks of the measures at every second pixel, of the wide ones at every fourth.

    Depths are frame coordinates.

    Attributes
    ----------
    depth, strength, top, best : ndarray, shape (rows, cols)
        Of the product of the fine and the coarse measure: position and strength of the fit, height
        of the peak, and number of the best frame.
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

    def without_windows(self) -> Fits:
        """Return the fits without `along`, `down` and `edge`, which take most of the memory."""
        none = np.empty(0, np.float32)
        return replace(self, along=none, down=none, edge=none)


def fit_stack(
    frames: Sequence[Frame],
    axis: Axis,
    settings: FocusSettings,
    *,
    spread: Spread = map,
    done: Callable[[float], object] = lambda share: None,
) -> Fits:
    """Measure every pixel in all frames and fit the peaks, in strips of rows.

    Parameters
    ----------
    frames : sequence of ndarray, shape (rows, cols)
        All frames.
    axis : Axis
        Groups of averaged frames.
    settings : FocusSettings
        Settings of the measures.
    spread : callable
        `map`, or that of a pool of threads, which then share the strips.
    done : callable
        Called after each strip with the share of the rows that is done.
    """
    shape = frames[0].shape
    rows = 2**24 // max(shape[1] * len(axis.coordinates), 1) - 2 * _MARGIN
    # A multiple of eight, as blocks of eight rows are averaged.
    height = int(np.clip(rows // 8 * 8, 64, _MAX_ROWS))
    whole: dict[str, NDArray] = {}

    def strip(band: Band) -> float:
        top, bottom = band.rows.start, band.rows.stop
        for name, values in vars(_fit_strip(frames, axis, settings, band)).items():
            block = {"profiles": 8, "wide": 4}.get(name, 2)
            rows, cols = (-(-n // block) for n in shape)
            new = np.empty((*values.shape[:-2], rows, cols), values.dtype)
            room = whole.setdefault(name, new)[..., top // block :, :]
            room[..., : values.shape[-2], :] = values[..., : room.shape[-2], :cols]
        return bottom / shape[0]

    for share in spread(strip, bands(shape[0], height, _MARGIN)):  # in their order
        done(share)
    return Fits(**whole)


def _fit_strip(frames: Sequence[Frame], axis: Axis, settings: FocusSettings, band: Band) -> Fits:
    """Measure the padded rows of a band, and fit its own."""
    _, rows, keep = band
    coordinates, shape = axis.coordinates, (rows.stop - rows.start, frames[0].shape[1])
    averaged = axis.averaged_frames(frames, rows)
    product, edge, wide = find_profiles(averaged, len(coordinates), shape, axis.noise, settings)
    half = slice(keep.start // 2, -(-keep.stop // 2))
    quarter = slice(keep.start // 4, -(-keep.stop // 4))
    windows = product.windows(half)
    beyond = (1 - len(coordinates) / len(axis.positions)) / 2  # the first mean is half a group in
    depth, strength = fit_peaks(windows[0], product.best[half], coordinates, beyond=beyond)
    edges, _ = fit_peaks(edge.windows(half)[0], edge.best[half], coordinates, beyond=beyond)
    far, _ = fit_peaks(wide.windows(quarter)[0], wide.best[quarter], coordinates)
    return Fits(
        depth=depth,
        strength=strength,
        top=product.top[half],
        best=product.best[half],
        profiles=np.stack([halved(image, 2) for image in product.profiles(half)]),
        along=windows[1],
        down=windows[2],
        edge=edges,
        wide=far,
    )
