"""The command ``microlib calibrate``."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from microlib._command._scales import add_scales, settle


def add_options(parser: argparse.ArgumentParser) -> None:
    scales = "--pitch 200 --cell 4.8 --focal-length 126000"
    parser.epilog = f"Example: microlib calibrate grid.png {scales} -o camera"
    files = ["camera.csv", "camera.json", "points.csv", "look.png"]
    words = {"pixel_size": "--cell", "image": "photograph", "world": "photographs"}
    parser.set_defaults(files=files, words=words)
    photos = "images of a grid, of one microscope and in one size"
    parser.add_argument("source", metavar="PHOTO", nargs="+", help=photos)
    add_scales(parser, "pitch", "cell", "focal_length")
    marks = ["auto", "chessboard", "charuco", "squares", "circles"]
    parser.add_argument("--marks", choices=marks, default=marks[0], help="of the grid")


def run(a: argparse.Namespace) -> Iterator[tuple[str, Callable]]:
    """Magnification, pose and distortion of a microscope from photographs of a pattern."""
    import pandas as pd

    from microlib.calibration import calibrate
    from microlib.io import read_grey

    settle(a, "pitch", "cell", *(["focal_length"] if a.focal_length is not None else []))
    seen: dict[str, tuple[NDArray, Any]] = {}
    faults = []
    for photo in tqdm(a.source, unit=" photos", **a.bar):
        try:
            image = read_grey(photo)
            name, found = _detect(image, a.marks)
            seen[photo] = image, found
            a.say(f"{photo}: {name}: {found}")
        except ValueError as fault:
            faults.append(f"{photo}: {fault}")
    if not seen:
        raise ValueError(faults[0] + f"; so {len(faults)} photographs" * (len(faults) > 1))
    for text in faults:
        warnings.warn(f"left out {text}", stacklevel=2)
    images, views = zip(*seen.values(), strict=True)
    result = calibrate(views, pitch=a.pitch, pixel_size=a.cell, focal_length=a.focal_length)
    for advice in _advice(result, views):
        warnings.warn(advice, stacklevel=2)
    tables = [found.to_frame().assign(photo=photo) for photo, (_, found) in seen.items()]
    points, camera = pd.concat(tables).set_index("photo"), result.to_frame()
    yield "points.csv", partial(points.to_csv, lineterminator="\n")
    yield "camera.csv", partial(camera.to_csv, lineterminator="\n")
    yield "camera.json", lambda file: file.write_text(result.to_json(), encoding="utf-8")
    yield "look.png", lambda file: result.plot(found=views, images=images).savefig(file, dpi=150)
    a.say(result)


def _detect(image: NDArray, marks: str) -> tuple[str, Any]:
    """Return what the photograph shows, and its points."""
    from microlib.calibration import detect_charuco, detect_circles, detect_squares

    ways: dict[str, Callable[[NDArray], Any]] = {
        "chessboard": partial(detect_squares, pattern="chessboard"),
        "charuco": detect_charuco,
        "squares": detect_squares,
    }
    for lattice in ("square", "hexagonal", "asymmetric"):
        ways[f"circles, {lattice} lattice"] = partial(detect_circles, lattice=lattice)
    faults: dict[str, None] = {}
    for name, way in ways.items():
        if name.startswith("" if marks == "auto" else marks):
            try:
                return name, way(image)
            except ValueError as fault:
                faults[str(fault)] = None
    raise ValueError("; ".join(faults))


def _advice(result: Any, found: Sequence[Any]) -> Iterator[str]:
    """Yield what to do about a calibration that is worth little."""
    shares = [np.ptp(each.points, axis=0).prod() / np.prod(each.image_size) for each in found]
    if max(shares) < 0.05:
        yield "the grid covers less than 5 % of the image: let it fill the image"
    if not result.fits:
        yield (
            "the model does not fit the points: is the pattern flat and sharp, and --pitch the "
            f"same everywhere?{' Several photographs show more of the lens' * (len(found) == 1)}"
        )
    if result.interval("magnification")[0] <= 0:
        yield "the magnification's interval reaches zero: photograph more marks, over more of it"
    elif result.unobservable:
        names = ", ".join(result.unobservable)
        yield f"{names}: not determined; give --focal-length, or tilt the pattern by 20° or more"
