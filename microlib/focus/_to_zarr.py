"""The default depth of a large image, written tile by tile into an OME-Zarr, here or on a cluster.

A tile is done once its mark is written, which comes last: whatever is killed is done again, and
nothing else. What is done does not depend on who does it (`_survey.py`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Frames, as_array, as_image, check_callable, refuse_masks, scalar, whole
from microlib.focus._depth import depth_from_focus, survey_focus
from microlib.focus._errors import NoiseCurve
from microlib.focus._stack import Progress
from microlib.focus._survey import FocusSurvey
from microlib.focus._tiles import tiles_of
from microlib.focus._window import Window

__all__ = ["depth_to_zarr"]

#: The maps, and whether the mean of two by two pixels makes a pixel of the next level, or the first
#: of them: there is no mean of frames' numbers.
_AVERAGED = {
    "depth": True,
    "uncertainty": True,
    "confidence": True,
    "index": False,
    "all_in_focus": True,
    "at_end": False,
}
#: Sides of the levels of the pyramid end below this, px: it fits on a screen.
_SMALLEST = 1024
#: How often a tile is tried that fails on a worker, as a file system may.
_RETRIES = 3


def depth_to_zarr(
    frames: Frames,
    path: str | PathLike[str],
    positions: ArrayLike,
    *,
    pixel_size: float,
    tile: int = 1024,
    points: int = 7,
    workers: int = 1,
    client: Any = None,
    progress: Progress | None = None,
) -> None:
    """Write the default depth of a focal stack into an OME-Zarr, tile by tile.

    Parameters
    ----------
    frames : array_like, shape (n, rows, cols), or path
        Grey frames: an array, also one of zarr or dask, or the folder of a zarr array. With a
        `client` it must be one that the workers can read.
    path : path-like
        The folder ``*.zarr``. If it is there, only what is missing in it is done.
    positions : array_like, shape (n,)
        Position of each frame, µm.
    pixel_size : float
        Side of a pixel, µm/px.
    tile : int
        Side of the tiles and of the chunks, px.
    points, workers
        As for `depth_from_focus`; `workers` for each tile.
    client : distributed.Client, optional
        A cluster that shares the tiles (``pip install microlib[dask]``). By default they are done
        in this process, one after the other.
    progress : callable, optional
        Told how many tiles are done and how many there are. An exception from it ends the work.

    Raises
    ------
    ValueError
        If zarr is not installed, `path` holds the depth of another stack, in other tiles or by
        other options, or as `depth_from_focus`. With a client, whatever a tile failed with for the
        fourth time.

    Notes
    -----
    The group holds one multiscale image for each map of `FocusResult`, ``depth``, ``uncertainty``,
    ``confidence``, ``index``, ``all_in_focus`` and ``at_end``, with levels of half the size each
    (OME-NGFF 0.5), and the attribute ``microlib`` with positions and the survey. All of it is that
    of the whole image to the last bit, whatever the tiles and whoever did them. A worker that dies
    costs what it was doing, and so does a run that is killed: another call does the rest.

    Examples
    --------
    >>> import tempfile
    >>> from microlib import synthetic
    >>> texture = synthetic.mixed_texture((48, 90), np.random.default_rng(0))
    >>> positions = np.arange(0.0, 100.0, 10.0)
    >>> stack = synthetic.focal_stack(texture, np.full((48, 90), 42.0), positions, blur_rate=0.1)
    >>> if find_spec("zarr"):
    ...     import zarr
    ...
    ...     with tempfile.TemporaryDirectory() as folder:
    ...         depth_to_zarr(stack, f"{folder}/a.zarr", positions, pixel_size=0.5, tile=64)
    ...         depth = zarr.open(f"{folder}/a.zarr", mode="r")["depth/0"][:]
    ...     assert abs(np.median(depth) - 42.0) < 0.5
    """
    side = whole("tile", tile, least=16)
    size = scalar("pixel_size", pixel_size, above=0)
    fit = whole("points", points, least=3, odd=True)
    threads = whole("workers", workers, least=1)
    z = as_array("positions", positions, shape=(None,))
    if not isinstance(path, (str, PathLike)):
        raise ValueError(f"path must be text or a path, got {type(path).__name__}")
    check_callable("progress", progress, optional=True)
    if client is not None and not hasattr(client, "scatter"):
        raise ValueError(f"client must be one of dask.distributed, got {type(client).__name__}")
    target = str(Path(path).expanduser())
    stack = _opened(frames)
    if len(stack.shape) == 3 and stack.shape[0]:
        # What a first look can refuse, it does before anything is written.
        as_image("frames", np.asarray(stack[0, :1, :1]))
    root = _root(target, stack, z, side=side, pixel_size=size, points=fit, workers=threads)
    survey = _survey_from(root.attrs["microlib"])
    tiles = tiles_of(Window.whole(survey.shape), side)
    due = [tile for tile in tiles if not _is_done(root, tile, side)]
    count = len(tiles) - len(due)
    for _ in _doing(due, stack, target, survey, side, threads, client):
        count += 1
        if progress is not None:
            progress(count, len(tiles))
    if not root.attrs["microlib"].get("complete"):
        for name in _AVERAGED:
            _make_pyramid(root[name], side, averaged=_AVERAGED[name])
        root.attrs["microlib"] = {**root.attrs["microlib"], "complete": True}


def _zarr() -> Any:
    if not find_spec("zarr"):
        raise ValueError("path must be a zarr that can be written: pip install microlib[zarr]")
    return import_module("zarr")  # the user's own, and slow to import


def _opened(frames: Any) -> Any:
    """Return the frames as an array that is loaded as it is indexed."""
    refuse_masks("frames", frames)
    if isinstance(frames, (str, PathLike)):
        try:
            return _zarr().open_array(str(frames), mode="r")
        except FileNotFoundError:
            raise ValueError(f"frames must be an array of zarr, got no file {frames}") from None
    if hasattr(frames, "shape"):
        return frames
    try:
        return np.stack([np.asarray(f) for f in frames])
    except (TypeError, ValueError):
        raise ValueError(
            f"frames must be an array or images of one size, got {type(frames).__name__}"
        ) from None


def _root(
    path: str,
    frames: Any,
    positions: NDArray,
    *,
    side: int,
    pixel_size: float,
    points: int,
    workers: int,
) -> Any:
    """Open the group, or make it, with everything in it but the tiles."""
    zarr = _zarr()
    given = {
        "frames": [*map(int, frames.shape), str(frames.dtype)],
        "positions": positions.tolist(),
        "tile": side,
        "pixel_size": pixel_size,
        "points": points,
    }
    root = zarr.open_group(path, mode="a")
    made = root.attrs.get("microlib", {})
    if made:
        if made["given"] != given:
            differ = [name for name in given if made["given"].get(name) != given[name]]
            raise ValueError(f"path must hold the depth of this stack, got other {differ[0]}")
        return root
    survey = survey_focus(frames, positions, points=points, workers=workers)
    shape = survey.shape
    kinds = {"index": "i4", "all_in_focus": _grey_type(frames.dtype), "at_end": "bool"}
    for name in _AVERAGED:
        _make_image(root, name, shape, side, kinds.get(name, "f4"), pixel_size)
    grid = tuple(-(-length // side) for length in shape)
    # How often each tile was done, in a file for each: two workers never write to one.
    root.create_array("tiles", shape=grid, chunks=(1, 1), dtype="u1", overwrite=True)
    root.create_group("OME", overwrite=True).attrs["ome"] = {
        "version": "0.5",
        "series": list(_AVERAGED),
    }
    root.attrs["ome"] = {"version": "0.5", "bioformats2raw.layout": 3}
    # Last, as it says that all the rest is there.
    root.attrs["microlib"] = {"given": given, "survey": _written(survey)}
    return root


def _grey_type(kind: np.dtype) -> np.dtype:
    """Return the type in which frames are read."""
    return kind if kind in (np.uint8, np.uint16) else np.dtype(np.float32)


def _make_image(
    root: Any, name: str, shape: tuple[int, int], side: int, kind: Any, pixel_size: float
) -> None:
    """Make the levels of an image, empty, and say how large a pixel is in each."""
    group = root.create_group(name, overwrite=True)
    levels = []
    for level, (rows, cols) in enumerate(_levels(shape)):
        group.create_array(
            str(level),
            shape=(rows, cols),
            chunks=(min(side, rows), min(side, cols)),
            dtype=kind,
            dimension_names=("y", "x"),
        )
        scale = [pixel_size * 2**level] * 2
        shift = [pixel_size * (2**level - 1) / 2] * 2 if _AVERAGED[name] else [0.0, 0.0]
        levels.append(
            {
                "path": str(level),
                "coordinateTransformations": [
                    {"type": "scale", "scale": scale},
                    {"type": "translation", "translation": shift},
                ],
            }
        )
    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "yx"]
    multiscale = {"name": name, "axes": axes, "datasets": levels}
    group.attrs["ome"] = {"version": "0.5", "multiscales": [multiscale]}


def _levels(shape: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield the shape of each level.

    Examples
    --------
    >>> list(_levels((3000, 700)))
    [(3000, 700), (1500, 350), (750, 175)]
    """
    rows, cols = shape
    yield rows, cols
    while max(rows, cols) > _SMALLEST:
        rows, cols = -(-rows // 2), -(-cols // 2)
        yield rows, cols


def _written(survey: FocusSurvey) -> dict[str, Any]:
    """Return a survey as JSON has it; numbers keep every bit."""
    curve = survey.noise_curve
    found = {name: getattr(survey, name) for name in survey.__dataclass_fields__}
    found["noise_curve"] = None if curve is None else dict(vars(curve))
    return dict(json.loads(json.dumps(found, default=np.ndarray.tolist)))


def _survey_from(attributes: dict[str, Any]) -> FocusSurvey:
    found = dict(attributes["survey"])
    curve = found["noise_curve"]
    if curve is not None:
        lists = {name: np.array(curve[name]) for name in ("scarcity", "variance")}
        found["noise_curve"] = NoiseCurve(**(curve | lists))
    found["shape"] = tuple(found["shape"])
    for name in ("positions", "levels", "weights"):
        found[name] = np.array(found[name])
    found["pull"] = np.array(found["pull"], np.float32)
    return FocusSurvey(**found)


def _is_done(root: Any, tile: Window, side: int) -> bool:
    return bool(root["tiles"][tile.top // side, tile.left // side])


def _doing(
    due: list[Window],
    frames: Any,
    path: str,
    survey: FocusSurvey,
    side: int,
    threads: int,
    client: Any,
) -> Iterator[Window]:
    """Do tiles, and yield each that is done."""
    if client is None:
        for tile in due:
            yield _do(tile, frames, path, survey, side, threads)
        return
    distributed = import_module("distributed")
    # An array in memory goes to each worker once; any other is but a name, and a worker that takes
    # the place of a dead one has it too.
    stack = client.scatter(frames, broadcast=True) if isinstance(frames, np.ndarray) else frames
    given = {"frames": stack, "path": path, "survey": survey, "side": side, "threads": threads}
    todo = distributed.as_completed(
        client.map(_do, due, **given, pure=False, retries=_RETRIES), with_results=True
    )
    for _, tile in todo:
        yield tile


def _do(
    tile: Window, frames: Any, path: str, survey: FocusSurvey, side: int, threads: int
) -> Window:
    """Do a tile, if nobody has: a worker that dies takes the news of what it did with it."""
    root = _zarr().open_group(path, mode="r+")
    if _is_done(root, tile, side):
        return tile
    rows, cols = tile.size
    with _plainly():
        found = depth_from_focus(
            frames,
            survey.positions,
            points=survey.points,
            workers=threads,
            region=(tile.top, tile.left, rows, cols),
            tile=side,
            survey=survey,
        )
    for name in _AVERAGED:
        here = slice(tile.top, tile.bottom), slice(tile.left, tile.right)
        root[name]["0"][here] = getattr(found, name)
    at = tile.top // side, tile.left // side
    root["tiles"][at] = root["tiles"][at] + 1
    return tile


def _plainly() -> Any:
    """Return a context in which dask loads arrays in this thread, which would wait for itself."""
    if find_spec("dask"):
        return import_module("dask").config.set(scheduler="synchronous")
    from contextlib import nullcontext

    return nullcontext()


def _make_pyramid(group: Any, side: int, *, averaged: bool) -> None:
    """Fill the levels above the first, a chunk at a time."""
    levels = [group[str(k)] for k in range(len(list(group.array_keys())))]
    for finer, coarser in pairwise(levels):
        for part in tiles_of(Window.whole(coarser.shape), side):
            rows = slice(2 * part.top, min(2 * part.bottom, finer.shape[0]))
            cols = slice(2 * part.left, min(2 * part.right, finer.shape[1]))
            values = finer[rows, cols]
            here = slice(part.top, part.bottom), slice(part.left, part.right)
            coarser[here] = _averaged(values) if averaged else values[::2, ::2]


def _averaged(values: NDArray) -> NDArray:
    """Return the mean of what is known of two by two pixels, in the same type.

    Examples
    --------
    >>> _averaged(np.array([[1.0, np.nan, 5.0], [3.0, np.nan, 7.0]])).tolist()
    [[2.0, 6.0]]
    """
    even = np.pad(values, [(0, length % 2) for length in values.shape], mode="edge")
    blocks = np.stack([even[i::2, j::2] for i in (0, 1) for j in (0, 1)]).astype(np.float64)
    known = np.isfinite(blocks)
    count = known.sum(axis=0)
    mean = np.where(known, blocks, 0).sum(axis=0) / np.maximum(count, 1)
    if values.dtype.kind in "ui":
        return np.rint(mean).astype(values.dtype)
    return np.where(count > 0, mean, np.nan).astype(values.dtype)
