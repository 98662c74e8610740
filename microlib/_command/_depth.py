"""The command ``microlib depth``."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from math import ceil, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from microlib._command import _options as options
from microlib._command._session import End, Session, picture, text
from microlib._common import SOFTWARE, as_scalar

if TYPE_CHECKING:
    from microlib.focus import FocusResult

#: The maps, and what they contain.
_MAPS = {
    "height.ome.tif": "heights in {unit}",
    "uncertainty.ome.tif": "standard deviation of each height, {unit}",
    "frame.ome.tif": "number of the frame nearest to focus, from 0; -1 where unknown",
    "all_in_focus.ome.tif": "every pixel from that frame, blended where the number changes",
}
#: Smallest and largest spacing that is not noted, in pixels. A depth of field is that of 4/NA
#: pixels that sample the resolution twice: 3 pixels for immersion, 200 for a macro lens.
_LEAST_STEP, _LARGEST_STEP = 0.05, 1000.0
#: Names of the files that it writes.
FILES = (*_MAPS, "all_in_focus.png", "surface.ply", "surface.stl", "summary.json", "look.png")


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
    options.add_scales(parser, "max_uncertainty")
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
    from_file = {"spacing": spacing, "pixel_size": frames.pixel_size}
    known = [name for name, value in from_file.items() if value or getattr(a, name) is not None]
    scales = from_file | options.resolve_scales(a, session, *known, **from_file)
    how = {name: getattr(a, name) for name in ("register", "region", "reduce", "workers")}
    if z is None or a.spacing is not None:
        how["spacing"] = scales["spacing"] or "frame"
        if a.max_uncertainty is not None and how["spacing"] == "frame":
            raise ValueError("--max-uncertainty is in µm: give --spacing")
    else:
        how["positions"] = z
    _advise(session, **scales)
    with session.bar(unit=" frames") as bar:

        def progress(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = focus.depth_from_focus(frames, **how, progress=progress)
    size = scales["pixel_size"] and scales["pixel_size"] * a.reduce
    result = replace(_within(result, a.max_uncertainty), pixel_size=size)
    maps = (result.depth, result.uncertainty, result.index, result.all_in_focus)
    for (name, what), values in zip(_MAPS.items(), maps, strict=True):
        about: dict[str, Any] = {"pixel_size": size, "what": what.format(unit=result.unit)}
        session.write(name, partial(io.write_height_tiff, height=values, **about))
    sharp = result.all_in_focus
    if sharp.dtype != np.uint8:
        sharp = np.interp(sharp, (sharp.min(), sharp.max()), (0, 255)).astype(np.uint8)
    session.write("all_in_focus.png", partial(_write_png, sharp))
    if size and result.unit == "µm":
        step = max(1, ceil(sqrt(result.depth.size / 250_000)))  # more vertices are slow to show
        few = (slice(None, None, step),) * 2
        mesh = {"height": result.depth[few], "pixel_size": size * step}
        session.write("surface.ply", partial(io.write_ply, image=sharp[few], **mesh))
        session.write("surface.stl", partial(io.write_stl, **mesh))
    summary = result.to_dict() | scales | {"pixel_size": size}
    session.write("summary.json", text(json.dumps(summary, indent=2)))
    session.write("look.png", picture(result.plot))
    session.say(result)
    if not summary["known"]:
        session.note("no height is known: frames must differ in focus and show texture")
    elif (share := summary["at_end"]) > 0.1:
        session.note(f"{share:.0%} of the heights are at the first or last frame, or outside")
    elif summary["uncertainty_median"] > abs(scales["spacing"] or 1):
        session.note("the uncertainty exceeds the spacing: are the frames in order of focus?")
    if a.register == "auto" and result.warps is None:
        session.say(
            "no change of light, position or scale is detected: not registered; motion of less "
            "than 0.1 % of the shorter side per frame is not detected, --register corrects it"
        )
    return End()


def _advise(session: Session, spacing: Any, pixel_size: Any) -> None:
    """Note what an unknown, a negative or an unlikely scale means for the heights."""
    scales = {"--spacing": spacing, "--pixel-size": pixel_size}
    if missing := [name for name, value in scales.items() if value is None]:
        without = ["heights are in frames"] * (spacing is None)
        without += ["the maps have no scale"] * (pixel_size is None) + ["no mesh is written"]
        session.note(f"{', '.join(without)}: give {' and '.join(missing)}")
    if spacing is not None and spacing < 0:
        session.note("the spacing is negative: each frame is focused lower than the one before")
    if not missing and not _LEAST_STEP <= abs(spacing) / pixel_size <= _LARGEST_STEP:
        session.note(
            f"a spacing of {abs(spacing):g} µm is {abs(spacing) / pixel_size:.2g} pixels of "
            f"{pixel_size:g} µm, where 2 to 50 are usual: is the unit right, as in 0.2mm?"
        )


def _within(result: FocusResult, limit: float | None) -> FocusResult:
    """Return a result without the heights whose uncertainty is larger than a limit."""
    if limit is None:
        return result
    as_scalar("max_uncertainty", limit, above=0)
    out = result.uncertainty > limit
    maps: dict[str, Any] = {"depth": np.nan, "uncertainty": np.nan, "confidence": 0, "index": -1}
    maps = {name: np.where(out, fill, getattr(result, name)) for name, fill in maps.items()}
    return replace(result, **maps)


def _write_png(image: NDArray[np.uint8], file: Path) -> None:
    about = PngInfo()
    about.add_text("Software", SOFTWARE)
    Image.fromarray(image).save(file, pnginfo=about)
