"""Depth of what is larger than memory, or than one machine: block by block, by dask."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_region
from microlib.focus._axis import Axis, find_axis, sampled
from microlib.focus._follow import follow, peak_asymmetry
from microlib.focus._peaks import check_count, check_positions
from microlib.focus._result import FocusResult
from microlib.focus._settings import Settings
from microlib.focus._stages import GRID, default_depth, typical
from microlib.io import read_frames

#: What is seen around a block and the side of a block, px, and what its place must be a multiple
#: of (`GRID`): every fourth pixel is looked at, and so many rows are fitted at a time.
_AROUND, _SIDE = 128, 1024
#: What a result has for each pixel, in the order in which blocks stack it, and its type.
_MAPS = {"depth": "f4", "uncertainty": "f4", "confidence": "f4", "index": "i4", "at_end": "?"}


def is_in_blocks(frames: object) -> bool:
    """Return whether frames are a dask or a zarr array."""
    module, name = type(frames).__module__.split(".")[0], type(frames).__name__
    return module in ("dask", "zarr") and name == "Array"


def depth_in_blocks(
    frames: Any,
    positions: ArrayLike | None,
    spacing: float | None,
    region: tuple[int, int, int, int] | None,
) -> FocusResult:
    """Return the default depth of a dask or zarr array, as dask arrays.

    Parameters
    ----------
    frames : dask.array.Array, zarr.Array, or xarray.DataArray of one, shape (n, rows, cols)
        Grey frames.
    positions, spacing, region
        As `depth_from_focus` has them.
    """
    import dask.array as da

    if {"y", "x"} <= set(getattr(frames, "dims", ())):
        frames = frames.transpose(..., "y", "x")
    source = getattr(frames, "data", frames)
    stack = source if isinstance(source, da.Array) else da.from_zarr(source)
    if stack.ndim != 3 or stack.dtype.kind not in "uif":
        raise ValueError(
            "frames must be a dask array of shape (n, rows, cols) and of real numbers, got "
            f"{stack.shape} of {stack.dtype}"
        )
    if region is not None:
        x, y, width, height = as_region("region", region, stack.shape[1:])
        stack = stack[:, y : y + height, x : x + width]
    labels: Any = read_frames(frames, region=region)
    z = check_positions(positions, spacing, len(stack), labels.positions)
    check_count(len(stack), len(z))
    if stack.dtype not in (np.uint8, np.uint16):
        stack = stack.astype(np.float32)
    rows, cols = (sampled(n) for n in stack.shape[1:])
    # What needs the whole image is found once, from the squares that are looked at first.
    squares, settings = list(stack[:, rows][:, :, cols].compute()), Settings()
    axis = find_axis(squares, z, settings.width)
    usual = typical(follow(squares, axis, settings).strength)
    axis = replace(axis, typical=usual, bias=peak_asymmetry(squares, axis, settings))
    inner = [n for chunks in stack.chunks[1:] for n in chunks[:-1]]
    if any(n % GRID or n > 2 * _SIDE or n < _AROUND for n in inner):
        stack = stack.rechunk((len(stack), _SIDE, _SIDE))
    # Where one chunk shows all of a side, nothing is around it.
    around = {k: _AROUND if k > 0 and stack.numblocks[k] > 1 else 0 for k in range(3)}
    seen = da.overlap.overlap(stack.rechunk({0: len(stack)}), around, boundary="none")
    chunks, meta = ((len(_MAPS) + 1,), *seen.chunks[1:]), np.empty((0, 0, 0), np.float32)
    found = seen.map_blocks(_block, axis=axis, chunks=chunks, meta=meta)
    found = da.overlap.trim_internal(found, around, boundary="none")
    maps = {name: found[k].astype(kind) for k, (name, kind) in enumerate(_MAPS.items())}
    picture = found[len(_MAPS)].astype(stack.dtype)
    place = {"pixel_size": labels.pixel_size, "corner": labels.corner}
    return FocusResult(**maps, all_in_focus=picture, **place)


def _block(frames: NDArray, *, axis: Axis) -> NDArray[np.float32]:
    """Return the maps of one block, one above the other."""
    result = default_depth(list(frames), None, axis.positions, axis=axis)
    maps = (getattr(result, name) for name in _MAPS)
    return np.stack([*maps, result.all_in_focus], dtype=np.float32)
