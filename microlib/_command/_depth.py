"""The command ``microlib depth``."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from microlib._command._scales import add_scales, settle

#: The maps, and what they show.
_MAPS = {
    "height.ome.tif": "heights in µm",
    "uncertainty.ome.tif": "error to be expected of each height, µm",
    "frame.ome.tif": "number of the frame nearest to focus, from 0; -1 where unknown",
    "all_in_focus.ome.tif": "every pixel from that frame",
}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Example: microlib depth scan.tif --spacing 25 --pixel-size 3.9 -o heights"
    files = [*_MAPS, "surface.ply", "summary.json", "look.png"]
    parser.set_defaults(files=files, words={"frames": "source", "positions": "--spacing"})
    stack = "TIFF, OME-TIFF, zarr, video, folder or quoted pattern; one frame a focus position"
    parser.add_argument("source", metavar="STACK", help=stack)
    add_scales(parser, "spacing", "pixel_size")
    parser.add_argument("--register", action="store_true", help="undo motion from frame to frame")
    corner = ("X", "Y", "W", "H")
    parser.add_argument("--region", nargs=4, type=int, metavar=corner, help="part, px")
    parser.add_argument("--reduce", type=int, default=1, metavar="N", help="N×N px become one")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="threads")
    early = "take the frames before the fault of a film that ends early"
    parser.add_argument("--allow-truncated", action="store_true", help=early)


def run(a: argparse.Namespace) -> Iterator[tuple[str, Callable]]:
    """Height of every pixel of a focal stack."""
    import cv2

    from microlib.focus import depth_from_focus
    from microlib.io import read_frames, write_height_tiff, write_ply

    frames = read_frames(a.source, color=True)
    z = frames.positions
    spacing = None if z is None else float(np.diff(z).mean())
    settled = settle(a, "spacing", "pixel_size", spacing=spacing, pixel_size=frames.pixel_size)
    size = settled["pixel_size"] * a.reduce
    if frames.count is not None and frames.count < 3:
        raise ValueError(f"{a.source} must hold three frames or more, got {frames.count}")
    with tqdm(unit=" frames", **a.bar) as bar:

        def progress(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        found = depth_from_focus(
            _to_the_end(frames) if a.allow_truncated else frames,
            None if a.spacing is not None else z,
            spacing=a.spacing,
            register=a.register,
            region=a.region and tuple(a.region),
            reduce=a.reduce,
            workers=a.workers,
            progress=progress,
        )
    found = replace(found, pixel_size=size)
    maps = (found.depth, found.uncertainty, found.index, found.all_in_focus)
    for (name, what), values in zip(_MAPS.items(), maps, strict=True):
        yield name, partial(write_height_tiff, height=values, pixel_size=size, what=what)
    grey = cv2.normalize(  # type: ignore[call-overload]
        found.all_in_focus, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U
    )
    step = max(1, ceil(sqrt(found.depth.size / 250_000)))  # more corners are slow to show
    mesh = a.out / "surface.ply"
    try:
        write_ply(mesh, found.depth, pixel_size=size, image=grey, step=step)
    except ValueError as error:
        mesh.unlink(missing_ok=True)  # of another run
        warnings.warn(f"{mesh.name} is not written: {error}", stacklevel=2)
    summary = json.dumps(found.to_dict() | settled, indent=2)
    yield "summary.json", lambda file: file.write_text(summary, encoding="utf-8")
    yield "look.png", lambda file: found.plot().savefig(file, dpi=150)
    a.say(found)


def _to_the_end(frames: Iterator[NDArray]) -> Iterator[NDArray]:
    """Yield the frames that can be read, and note how many these are where a film ends early."""
    count = 0
    try:
        for frame in frames:
            yield frame
            count += 1
    except (OSError, ValueError) as error:
        warnings.warn(f"{error}; the {count} frames before are used", stacklevel=2)
