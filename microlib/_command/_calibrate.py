"""The command ``microlib calibrate``."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from microlib._command._files import refuse_targets, write
from microlib._command._scales import add_scales, settle

#: What circles may lie on.
_LATTICES = ("square", "hexagonal", "asymmetric")


def add_options(parser: argparse.ArgumentParser) -> None:
    scales = "--pitch 200 --cell 4.8 --focal-length 126000"
    parser.epilog = f"Example: microlib calibrate grid.png {scales} -o camera"
    words = {"pixel_size": "--cell", "image": "photograph", "world": "photographs"}
    parser.set_defaults(table=False, words=words)
    photos = "images of a grid, of one microscope and in one size"
    parser.add_argument("source", metavar="PHOTO", nargs="+", help=photos)
    add_scales(parser, "pitch", "cell", "focal_length")
    marks = ["auto", "chessboard", "charuco", "squares", "circles"]
    parser.add_argument("--marks", choices=marks, default=marks[0], help="of the grid")
    parser.add_argument("--lattice", choices=_LATTICES, help="of circles; else each is tried")


def run(a: argparse.Namespace) -> None:
    """Magnification, pose and distortion of a microscope from photographs of a pattern."""
    import pandas as pd

    from microlib.calibration import calibrate
    from microlib.io import read_grey

    if a.lattice and a.marks in ("chessboard", "charuco", "squares"):
        raise ValueError(f"--lattice must be left out with --marks {a.marks}")
    given = settle(a, "pitch", "cell", *(["focal_length"] if a.focal_length is not None else []))
    names = ["camera.csv", "camera.json", "points.csv", *([] if a.no_look else ["look.png"])]
    refuse_targets(a, [a.out / name for name in names])
    images, found, faults = [], {}, []
    for photo in tqdm(a.source, unit=" photos", **a.bar):
        try:
            image = read_grey(photo)
            name, found[photo] = _detect(image, a.marks, a.lattice)
            images.append(image)
            a.say(f"{photo}: {name}: {found[photo]}")
        except ValueError as fault:
            faults.append(f"{photo}: {fault}")
    if not found:
        raise ValueError(faults[0] + f"; so {len(faults)} photographs" * (len(faults) > 1))
    for text in faults:
        warnings.warn(f"left out {text}", stacklevel=2)
    detections = list(found.values())
    result = calibrate(
        detections, pitch=given["pitch"], pixel_size=given["cell"], focal_length=a.focal_length
    )
    for advice in _advice(result, detections):
        warnings.warn(advice, stacklevel=2)
    tables = {photo: detection.to_frame() for photo, detection in found.items()}
    write(a.out / "points.csv", pd.concat(tables, names=["photo"]).droplevel(1))
    write(a.out / "camera.csv", result.to_frame())
    write(a.out / "camera.json", result.to_json())
    if not a.no_look:
        write(a.out / "look.png", result.plot(found=detections, images=images))
    a.say(f"{result}\n{a.out}: {', '.join(names)}")


def _detect(image: NDArray, marks: str, lattice: str | None) -> tuple[str, Any]:
    """Return what the photograph shows, and its points."""
    from microlib.calibration import detect_charuco, detect_circles, detect_squares

    ways: dict[str, Callable[[NDArray], Any]] = {
        "chessboard": partial(detect_squares, pattern="chessboard"),
        "charuco": detect_charuco,
        "squares": detect_squares,
    }
    for each in [lattice] if lattice else _LATTICES:
        ways[f"circles, {each} lattice"] = partial(detect_circles, lattice=each)
    faults: list[str] = []
    for name, way in ways.items():
        if name.startswith("circles" if lattice else "" if marks == "auto" else marks):
            try:
                return name, way(image)
            except ValueError as fault:
                faults.append(str(fault))
    raise ValueError("; ".join(dict.fromkeys(faults)))


def _advice(result: Any, found: list[Any]) -> Iterator[str]:
    """Yield what to do about a calibration that is worth little."""
    shares = [np.ptp(each.points, axis=0).prod() / np.prod(each.image_size) for each in found]
    if max(shares) < 0.05:
        yield "the grid covers less than 5 % of the image: let it fill the image"
    if not result.fits:
        yield (
            "the model does not fit the points: is the pattern flat and sharp, and --pitch the "
            "same everywhere? Several photographs of it show more of the lens"
        )
    if result.interval("magnification")[0] <= 0:
        yield "the magnification's interval reaches zero: photograph more marks, over more of it"
    elif result.unobservable:
        names = ", ".join(result.unobservable)
        yield f"{names}: not determined; give --focal-length, or tilt the pattern by 20° or more"
