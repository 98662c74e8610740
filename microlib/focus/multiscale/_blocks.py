"""Depth of stacks larger than memory, or than one machine, block by block with dask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_region
from microlib.focus._peaks import check_count, check_positions
from microlib.focus._result import FocusResult, build_result
from microlib.focus._stack import bad_frames
from microlib.focus.multiscale._axis import Axis, tile_pixels
from microlib.focus.multiscale._depth import multiscale_depth
from microlib.focus.multiscale._fits import describe_axis, fit_stack
from microlib.focus.multiscale._full_size import GRID
from microlib.focus.multiscale._reject import typical
from microlib.focus.multiscale._settings import Settings
from microlib.io import Stack, read_frames

#: Overlap of the blocks (dask's ``depth``) and side of a block, px. Its place must be a multiple of
#: `GRID`, as every fourth pixel is used, and so many rows are fitted at a time.
_OVERLAP, _SIDE = 128, 1024
#: The maps of a result, in the order in which a block stacks them, and their types.
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
        As for `depth_from_focus`.
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
    rows, cols = (tile_pixels(n) for n in stack.shape[1:])
    # Properties of the whole image are found once, from its tiles.
    tiles, settings = list(stack[:, rows][:, :, cols].compute()), Settings()
    kept = np.flatnonzero(~bad_frames(tiles))
    stack, z, tiles = stack[kept], z[kept], [tiles[k] for k in kept]
    axis = describe_axis(tiles, z, settings)
    strength = typical(fit_stack(tiles, axis, settings).strength)
    inner = [n for chunks in stack.chunks[1:] for n in chunks[:-1]]
    if any(n % GRID or n > 2 * _SIDE or n < _OVERLAP for n in inner):
        stack = stack.rechunk((len(stack), _SIDE, _SIDE))
    # Where one chunk contains all of a side, there is no overlap.
    overlap = {k: _OVERLAP if k > 0 and stack.numblocks[k] > 1 else 0 for k in range(3)}
    parts = da.overlap.overlap(stack.rechunk({0: len(stack)}), overlap, boundary="none")
    chunks, meta = ((len(_MAPS) + 1,), *parts.chunks[1:]), np.empty((0, 0, 0), np.float32)
    found = parts.map_blocks(
        _block, axis=axis, numbers=kept, strength=strength, chunks=chunks, meta=meta
    )
    found = da.overlap.trim_internal(found, overlap, boundary="none")
    maps = {name: found[k].astype(kind) for k, (name, kind) in enumerate(_MAPS.items())}
    image = found[len(_MAPS)].astype(stack.dtype)
    place = {"pixel_size": labels.pixel_size, "corner": labels.corner}
    return FocusResult(**maps, all_in_focus=image, **place)


def _block(
    frames: NDArray, *, axis: Axis, numbers: NDArray[np.intp], strength: float
) -> NDArray[np.float32]:
    """Return the maps of one block, one above the other."""
    grey, z = list(frames), axis.positions
    found = multiscale_depth(grey, z, axis=axis, typical_strength=strength)
    result = build_result(found, Stack(grey, grey[0], positions=z), numbers, frames.dtype)
    maps = (getattr(result, name) for name in _MAPS)
    return np.stack([*maps, result.all_in_focus], dtype=np.float32)
