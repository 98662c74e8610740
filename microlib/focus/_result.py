"""The result of shape from focus, and how it is built from a depth map."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, FlatResult, Image, flat_row
from microlib.focus._registration import Registration
from microlib.focus.common import END_REACH, DepthMap, Frame, bands, blur
from microlib.io import Stack

#: Rows that are blended at a time, and the reach of the weights of the all-in-focus image.
_BAND, _REACH = 64, 4


@dataclass(frozen=True, eq=False, repr=False)
class FocusResult(FlatResult):
    """Result of `depth_from_focus`: depth, uncertainty and more for every pixel.

    Attributes
    ----------
    depth : ndarray of float32, shape (rows, cols)
        Position at which the pixel is sharpest, µm; NaN where it cannot be determined. It is of
        float64 where float32 would round it to more than a thousandth of the frame spacing.
    uncertainty : ndarray of float32, shape (rows, cols)
        Standard deviation of the depth, µm; NaN where `depth` is. With "multiscale" it covers noise
        and relief that cannot be separated from noise (from the difference of the depths by
        horizontal and by vertical detail), slopes and steps, where a pixel may belong to either
        side, illumination that changes from frame to frame, objects too thin to be resolved, and
        the bias by the shape of the peaks, which is common to the whole map. With other measures it
        covers the roughness of the depth and the same bias, but no other error that is smooth over
        ten pixels: where all pixels lie equally far from a frame, the bias towards that frame
        remains (measured 1 µm at a stated 0.2 to 0.45 µm, with a frame spacing of 10 µm). Below
        about 60×60 px no bias is measured. With every measure it covers a peak that may be noise
        and a depth at an end of the scan: each adds up to the standard deviation of a random depth,
        in quadrature. Errors of the positions and the field curvature of the lens are never part of
        it.
    confidence : ndarray of float32, shape (rows, cols)
        1 / (1 + (uncertainty / spacing of the frames)²), from 0 to 1; 0 where `depth` is NaN. The
        spacing is that of the averaged frames where "multiscale" averages.
    index : ndarray of int32, shape (rows, cols)
        Number of the frame nearest to the depth by "multiscale", of the sharpest frame by any other
        measure; -1 where `depth` is NaN.
    all_in_focus : ndarray of the frames' type, shape (rows, cols) or (rows, cols, 3)
        Every pixel from the frame `index`, or where there is no depth from its sharpest one. Where
        this number changes, the frames are blended over a few pixels.
    at_end : ndarray of bool, shape (rows, cols)
        Whether the true focus may lie outside the stack, because the sharpest frame of the pixel or
        of a quarter of the pixels around it is the first or the last; see `depth_from_focus`.
        Averaged frames count as one.
    warps : ndarray, shape (n, 2, 3), or None
        If the stack was registered: warp matrix of each frame, as `cv2.findTransformECC` returns
        it, which takes x, y and 1 of a pixel of the result to x and y in the frame, px. NaN for
        frames that were left out.
    gain, offset : ndarray, shape (n,), or None
        If the stack was registered: grey levels of the frame are `gain` times those of the middle
        frame, plus `offset`.
    pixel_size : float or None
        Side of a pixel of the maps, µm, if the metadata of the frames contain it.
    unit : {"µm", "frames"}
        Unit of the depth and of its uncertainty.
    """

    depth: Array
    uncertainty: NDArray[np.float32]
    confidence: NDArray[np.float32]
    index: NDArray[np.int32]
    all_in_focus: Image
    at_end: NDArray[np.bool_]
    warps: Array | None = None
    gain: Array | None = None
    offset: Array | None = None
    pixel_size: float | None = None
    unit: str = "µm"

    def __repr__(self) -> str:
        rows, columns = self.depth.shape
        numbers = self.to_dict()
        text = f"FocusResult({columns}×{rows} px, {100 * numbers['known']:.1f} % known"
        if numbers["known"]:
            text += ", depth {depth_least:.4g} to {depth_largest:.4g} {unit}".format(**numbers)
            text += ", uncertainty {uncertainty_median:.2g} {unit}".format(**numbers)
        return f"{text}{'' if self.warps is None else ', registered'})"

    def to_dict(self) -> dict[str, Any]:
        """Return a summary of the maps as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            ``rows`` and ``columns``; ``known``, the share of pixels that have a depth; least,
            median and largest depth, median and largest uncertainty, None where nothing is known;
            ``unit``, that of these five; ``at_end``, the share of the pixels with a depth that are
            sharpest in an end frame; ``registered``, whether the stack was registered.
        """
        known = np.isfinite(self.depth)
        maps = (values[known] for values in (self.depth, self.uncertainty, self.at_end))
        depth, error, ends = (values if known.any() else np.full(1, np.nan) for values in maps)
        return flat_row(
            {
                "rows": self.depth.shape[0],
                "columns": self.depth.shape[1],
                "known": known.mean(),
                "depth_least": depth.min(),
                "depth_median": np.median(depth),
                "depth_largest": depth.max(),
                "uncertainty_median": np.median(error),
                "uncertainty_largest": error.max(),
                "unit": self.unit,
                "at_end": ends.mean(),
                "registered": self.warps is not None,
            }
        )

    def plot(self, ax: Any = None) -> Any:
        """Draw the maps by Matplotlib: all in focus, height and uncertainty.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw the height alone; by default all three are panels of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from microlib._plots import maps

        return maps(self, ax)


def build_result(
    found: DepthMap,
    images: Iterable[Frame],
    stack: Stack,
    numbers: NDArray[np.intp],
    *,
    origin: float,
    registration: Registration | None,
    margin: NDArray[np.bool_],
    done: Callable[[float], object],
    unit: str,
) -> FocusResult:
    """Return a result; without depth are the pixels in a margin or outside of registered frames.

    Parameters
    ----------
    found : DepthMap
        Depth of every pixel; its maps become those of the result.
    images : iterable of ndarray
        Frames from which it was found, registered if they were; they are iterated once.
    stack : Stack
        Their positions, pixel size and type.
    numbers : ndarray of int, shape (n,)
        Number of each of these frames in the source, from which frames may be left out.
    origin : float
        Where the depths and positions are zero, µm; the result has no origin of its own.
    registration : Registration or None
        Where the frames were before.
    margin : ndarray of bool, shape (rows, cols)
        Pixels that are in the black margin of some frame.
    done : callable
        Called with the share of the frames of which the all-in-focus image is made.
    unit : str
        Unit of the positions.
    """
    image = composite(images, stack, found.frame, lambda k: done(k / len(numbers)))
    depth, uncertainty, index = found.depth, found.uncertainty, found.frame
    known = np.isfinite(depth)
    warps = gain = offset = None
    if registration is not None:
        known &= ~registration.outside(index)
        warps, gain, offset = registration.warps, registration.gain, registration.offset
    known &= ~margin
    # A depth this near an end of the scan may lie beyond it: it is as uncertain as a random depth.
    z = np.asarray(stack.positions)
    low, high = np.float32(z.min()), np.float32(z.max())
    end = depth[found.at_end]
    beyond = np.minimum(end - low, high - end) < END_REACH * found.spacing
    random = np.where(beyond, (high - low) / np.float32(np.sqrt(12)), 0)
    uncertainty[found.at_end] = np.hypot(uncertainty[found.at_end], random)
    depth[~known] = uncertainty[~known] = np.nan
    confidence = np.square(uncertainty / np.float32(found.spacing))
    np.divide(1, confidence + 1, out=confidence)
    confidence[~known] = 0
    largest = np.float32(np.abs(z + origin).max())
    exact = np.float64 if np.spacing(largest) > found.spacing / 1000 else np.float32
    return FocusResult(
        depth=np.add(depth, origin, dtype=np.float64).astype(exact),
        uncertainty=uncertainty,
        confidence=confidence,
        index=np.where(known, numbers.astype(np.int32)[index], np.int32(-1)),
        all_in_focus=image,
        at_end=found.at_end,
        pixel_size=stack.pixel_size,
        unit=unit,
        warps=warps,
        gain=gain,
        offset=offset,
    )


def composite(
    images: Iterable[Frame], stack: Stack, index: NDArray[np.integer], done: Callable[[int], object]
) -> Image:
    """Return the frames blended by the number of each pixel's frame, in the type of the stack.

    The weight of a frame is the mean, by a Gaussian of σ = 2 px, of the pixels with its number.
    Without this mean, the differences of grey levels between neighbors are wrong by 40 % more where
    the number changes than elsewhere, and by three times as much in light that varies by 10 %.
    """
    total = np.zeros(stack.first.shape, np.float32)
    for k, frame in enumerate(images):
        for rows, padded, own in bands(len(total), _BAND, _REACH):
            here = index[padded] == k
            if here.any():
                weight = blur(here.astype(np.float32), 2.0)[own]
                total[rows] += (weight[..., None] if stack.color else weight) * frame[rows]
        done(k + 1)
    if stack.dtype.kind in "ui":
        ends = np.iinfo(stack.dtype)
        np.clip(np.rint(total, out=total), ends.min, ends.max, out=total)
    return total.astype(stack.dtype, copy=False)
