"""The command ``microlib depth``."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from math import ceil, sqrt

import numpy as np

from microlib._command import _options as options
from microlib._command._session import End, Session, picture, text

#: The maps, and what they contain.
_MAPS = {
    "height.ome.tif": "heights in µm",
    "uncertainty.ome.tif": "standard deviation of each height, µm",
    "frame.ome.tif": "number of the frame nearest to focus, from 0; -1 where unknown",
    "all_in_focus.ome.tif": "every pixel from that frame",
}
#: Names of the files that it writes.
FILES = (*_MAPS, "surface.ply", "summary.json", "look.png")


def add_options(parser: argparse.ArgumentParser) -> None:
    stack = "TIFF, OME-TIFF, video, folder, or pictures, in the natural order of their names"
    parser.add_argument("source", metavar="STACK", nargs="+", help=stack)
    options.add_scales(parser, "spacing", "pixel_size")
    options.add_axes(parser)
    parser.add_argument(
        "--register",
        nargs="?",
        const=True,
        default=False,
        choices=["auto"],
        help="correct motion, scale and brightness between frames; auto: where they change",
    )
    parser.add_argument("--region", help="part of the frames to use, px", **options.BOX)
    parser.add_argument("--reduce", type=int, default=1, metavar="N", help="average N×N px")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="number of threads")


def run(a: argparse.Namespace, session: Session) -> End:
    """Height of every pixel of a focal stack.

    Example: microlib depth scan.tif --spacing 25 --pixel-size 3.9 -o heights
    """
    from microlib import focus, io

    frames = options.open_frames(a, session)
    if frames.count is not None and frames.count < 3:
        raise ValueError(
            f"{', '.join(a.source)} must hold three frames or more, got {frames.count}"
        )
    z = frames.positions
    spacing = None if z is None else float(np.diff(z).mean())
    scales = options.resolve_scales(
        a, session, "spacing", "pixel_size", spacing=spacing, pixel_size=frames.pixel_size
    )
    how = {name: getattr(a, name) for name in ("register", "region", "reduce", "workers")}
    how |= {"positions": z} if a.spacing is None else {"spacing": a.spacing}
    with session.bar(unit=" frames") as bar:

        def progress(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = focus.depth_from_focus(frames, **how, progress=progress)
    size = scales["pixel_size"] * a.reduce
    result = replace(result, pixel_size=size)
    maps = (result.depth, result.uncertainty, result.index, result.all_in_focus)
    for (name, what), values in zip(_MAPS.items(), maps, strict=True):
        session.write(
            name, partial(io.write_height_tiff, height=values, pixel_size=size, what=what)
        )
    sharp = result.all_in_focus
    grey = np.interp(sharp, (sharp.min(), sharp.max()), (0, 255)).astype(np.uint8)
    step = max(1, ceil(sqrt(result.depth.size / 250_000)))  # more vertices are slow to show
    mesh = {"height": result.depth[::step, ::step], "image": grey[::step, ::step]}
    session.write("surface.ply", partial(io.write_ply, **mesh, pixel_size=size * step))
    summary = result.to_dict() | scales | {"pixel_size": size}
    session.write("summary.json", text(json.dumps(summary, indent=2)))
    session.write("look.png", picture(result.plot))
    session.say(result)
    if a.register == "auto" and result.warps is None:
        session.say("frames do not change in light, position or scale: not registered")
    return End()
