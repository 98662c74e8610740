"""The command ``microlib calibrate``."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from microlib._command._files import add_output, refuse_targets, write
from microlib._command._scales import add_scales, settle

if TYPE_CHECKING:
    from microlib.calibration import Calibration, Detection

#: What circles may lie on.
_LATTICES = ("square", "hexagonal", "asymmetric")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "Example: microlib calibrate grid.png --pitch 200 --cell 4.8 --focal-length 126000 "
        "-o camera"
    )
    words = {"pixel_size": "--cell", "image": "photograph", "world": "photographs"}
    parser.set_defaults(words=words)
    photos = "images of a grid, of one microscope and in one size"
    parser.add_argument("photos", metavar="PHOTO", nargs="+", help=photos)
    add_output(parser)
    add_scales(parser, "pitch", "cell", "focal_length")
    marks = ["auto", "chessboard", "squares", "circles"]
    parser.add_argument("--marks", choices=marks, default=marks[0], help="of the grid")
    parser.add_argument("--lattice", choices=_LATTICES, help="of circles; else each is tried")


def run(a: argparse.Namespace) -> None:
    """Magnification, pose and distortion of a microscope from photographs of a pattern."""
    import pandas as pd

    from microlib.calibration import calibrate
    from microlib.io import read_grey

    if a.lattice and a.marks in ("chessboard", "squares"):
        raise ValueError(f"--lattice must be left out with --marks {a.marks}")
    asked = {"pitch": a.pitch, "cell": a.cell}
    if a.focal_length is not None:
        asked["focal_length"] = a.focal_length
    scales = settle(a.photos[0], asked, {}, a.say)
    names = ["camera.csv", "camera.json", "points.csv", *([] if a.no_look else ["look.png"])]
    refuse_targets(a, [a.out / name for name in names])
    images, found = {}, {}
    for photo in tqdm(a.photos, desc="calibrate", unit=" photos", **a.bar):
        try:
            image = read_grey(photo)
            name, detection = _detect(image, a.marks, a.lattice)
        except ValueError as error:
            if len(a.photos) == 1:
                raise
            warnings.warn(f"{photo} is left out: {error}", stacklevel=2)
            continue
        images[photo], found[photo] = image, detection
        a.say(f"{photo}: {name}: {detection}")
    if not found:
        raise ValueError(f"none of {len(a.photos)} photographs shows a grid: try another --marks")
    result = calibrate(
        list(found.values()),
        pitch=scales["pitch"],
        pixel_size=scales["cell"],
        focal_length=a.focal_length,
    )
    for advice in _advice(result, list(found.values())):
        warnings.warn(advice, stacklevel=2)
    tables = {photo: detection.to_frame() for photo, detection in found.items()}
    write(a.out / "points.csv", pd.concat(tables, names=["photo"]).droplevel(1))
    write(a.out / "camera.csv", result.to_frame())
    write(a.out / "camera.json", result.to_json())
    if not a.no_look:
        write(
            a.out / "look.png",
            result.plot(found=list(found.values()), images=list(images.values())),
        )
    a.say(f"{result}\n{a.out}: {', '.join(names)}")


def _detect(image: NDArray, marks: str, lattice: str | None) -> tuple[str, Detection]:
    """Return what the photograph shows, and its points."""
    from microlib.calibration import detect_circles, detect_squares

    ways: dict[str, Callable[[NDArray], Detection]] = {}
    if not lattice:
        ways = {
            "chessboard": partial(detect_squares, pattern="chessboard"),
            "squares": detect_squares,
        }
    for each in [lattice] if lattice else _LATTICES:
        ways[f"circles on a lattice that is {each}"] = partial(detect_circles, lattice=each)
    faults: list[str] = []
    for name, way in ways.items():
        if marks in ("auto", name.split()[0]):
            try:
                return name, way(image)
            except ValueError as fault:
                faults.append(f"{name}: {fault}")
    raise ValueError("; ".join(faults))


def _advice(result: Calibration, found: list[Detection]) -> Iterator[str]:
    """Yield what to do about a calibration that is worth little."""
    if max(np.ptp(f.points, axis=0).prod() / np.prod(f.image_size) for f in found) < 0.05:
        yield (
            "the grid covers less than 5 % of the image, so that the distortion and the pose hang "
            "on little: let it fill the image"
        )
    if not result.fits:
        yield (
            "the model does not fit the points: is the pattern flat and sharp, and --pitch the "
            "same everywhere? Several photographs of it show more of the lens"
        )
    if result.interval("magnification")[0] <= 0:
        yield (
            "the interval of the magnification reaches zero: photograph more marks over more of "
            "the image"
        )
    elif result.unobservable:
        names = ", ".join(result.unobservable)
        yield (
            f"{names}: the points do not determine them; give --focal-length, or tilt the pattern "
            "by 20° and more"
        )
