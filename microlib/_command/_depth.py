"""The command ``microlib depth``."""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from math import ceil, sqrt
from typing import Any

import numpy as np
from tqdm import tqdm

from microlib._command._files import refuse_targets, write
from microlib._command._scales import add_scales, settle


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Example: microlib depth scan.tif --spacing 25 --pixel-size 3.9 -o heights"
    parser.set_defaults(table=False, words={"frames": "source", "positions": "--spacing"})
    stack = "TIFF, OME-TIFF, zarr, video, folder or quoted pattern; one frame a focus position"
    parser.add_argument("source", metavar="STACK", help=stack)
    add_scales(parser, "spacing", "pixel_size")
    parser.add_argument("--register", action="store_true", help="undo motion from frame to frame")
    corner = ("X", "Y", "W", "H")
    parser.add_argument("--region", nargs=4, type=int, metavar=corner, help="part, px")
    parser.add_argument("--reduce", type=int, default=1, metavar="N", help="N×N px become one")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="threads")


def run(a: argparse.Namespace) -> None:
    """Height of every pixel of a focal stack."""
    from microlib.focus import depth_from_focus
    from microlib.io import read_frames, write_height_tiff, write_ply

    part: dict[str, Any] = {"region": a.region and tuple(a.region), "reduce": a.reduce}
    frames = read_frames(a.source, **part)
    z, size = frames.positions, frames.pixel_size
    settled = settle(
        a,
        "spacing",
        "pixel_size",
        spacing=None if z is None else float(np.diff(z).mean()),
        pixel_size=size and size / a.reduce,
    )
    size = settled["pixel_size"] * a.reduce
    if frames.count is not None and frames.count < 3:
        raise ValueError(f"{a.source} must hold three frames or more, got {frames.count}")
    files = [f"{name}.ome.tif" for name in ("height", "uncertainty", "frame", "all_in_focus")]
    files += ["surface.ply", "summary.json", *([] if a.no_look else ["look.png"])]
    refuse_targets(a, [a.out / name for name in files])
    with tqdm(unit=" frames", **a.bar) as bar:

        def progress(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        found = depth_from_focus(
            a.source,
            **({"positions": z} if a.spacing is None else {"spacing": a.spacing}),
            register=a.register,
            workers=a.workers,
            progress=progress,
            **part,
        )
    found = replace(found, pixel_size=size)
    a.out.mkdir(parents=True, exist_ok=True)
    maps = [
        (found.depth, "heights in µm"),
        (found.uncertainty, "error to be expected of each height, µm"),
        (found.index, "number of the frame nearest to focus, from 0; -1 where unknown"),
        (found.all_in_focus, "every pixel from that frame"),
    ]
    for name, (values, what) in zip(files, maps, strict=False):
        write_height_tiff(a.out / name, values, pixel_size=size, what=what)
    seen = found.all_in_focus.astype(np.float64)
    low, high = seen.min(), seen.max()
    grey = np.uint8(255 * (seen - low) / (high - low or 1))
    step = max(1, ceil(sqrt(found.depth.size / 250_000)))  # more corners are slow to show
    mesh = a.out / "surface.ply"
    try:
        write_ply(mesh, found.depth, pixel_size=size, image=grey, step=step)
    except ValueError as error:
        files.remove(mesh.name)
        mesh.unlink(missing_ok=True)  # of another run
        warnings.warn(f"{mesh.name} is not written: {error}", stacklevel=2)
    write(a.out / "summary.json", json.dumps(found.to_dict() | settled, indent=2))
    if not a.no_look:
        write(a.out / "look.png", found.plot())
    a.say(f"{found}\n{a.out}: {', '.join(files)}")
