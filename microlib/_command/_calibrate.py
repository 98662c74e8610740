"""The command ``microlib calibrate``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import mode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._command._options import add_scales, resolve_scales
from microlib._command._session import End, Session, picture, text
from microlib._common import home_path

#: Names of the files that it writes.
FILES = ("camera.csv", "camera.json", "points.csv", "look.png")


def add_options(parser: argparse.ArgumentParser) -> None:
    photos = "images of a pattern, folder or quoted file name pattern; one microscope, one size"
    parser.add_argument("source", metavar="PHOTO", nargs="+", help=photos)
    add_scales(parser, "pitch", "pixel_pitch", "focal_length")
    marks = ["auto", "chessboard", "charuco", "squares", "circles"]
    parser.add_argument("--marks", choices=marks, default=marks[0], help="kind of marks")


def run(a: argparse.Namespace, session: Session) -> End:
    """Magnification, pose and distortion of a microscope from photographs of a pattern.

    Example: microlib calibrate grid.png --pitch 200 --pixel-pitch 4.8 -o camera
    """
    import pandas as pd

    from microlib.calibration import calibrate, detect_pattern
    from microlib.io import image_files, read_grey

    given = [name for name in ("pixel_pitch", "focal_length") if getattr(a, name) is not None]
    # A focal length in µm needs the pixel pitch.
    resolve_scales(a, session, "pitch", *(sorted({"pixel_pitch", *given}) if given else []))
    if not given:
        session.note(
            "without --pixel-pitch, lengths in the camera are in pixels of its sensor, not in µm"
        )
    paths = [home_path(name) for name in a.source]
    photos = [file for path in paths for file in ([path] if path.is_file() else image_files(path))]
    session.protect(photos)
    views: dict[Path, tuple[NDArray, Any]] = {}

    def leave_out(photo: Path, reason: object) -> str:
        views.pop(photo, None)
        session.note(f"left out {photo}: {reason}")
        return f"{photo}: {reason}"

    fault = ""
    for photo in session.bar(photos, unit=" photos"):
        try:
            image = read_grey(photo)
            name, found = detect_pattern(image, a.marks)
            views[photo] = image, found
            session.say(f"{photo}: {name}: {found}")
        except ValueError as error:
            reason = str(error).removeprefix(f"path must name an image, got {photo}: ")
            fault = leave_out(photo, reason)
    if not views:
        raise ValueError(fault + f"; so {len(photos)} photographs" * (len(photos) > 1))
    sizes = {photo: "×".join(map(str, each.image_size)) for photo, (_, each) in views.items()}
    usual_size = mode(sizes.values())
    for photo, size in sizes.items():
        if size != usual_size:
            leave_out(photo, f"its size is {size} px, of most {usual_size}")
    scales = {"pitch": a.pitch, "pixel_pitch": a.pixel_pitch or 1.0, "focal_length": a.focal_length}
    result = calibrate([each for _, each in views.values()], **scales)
    usual = np.nanmedian(result.held_out) if np.isfinite(result.held_out).any() else np.inf
    if (result.held_out > 10 * usual).any():
        for photo, off in zip(list(views), result.held_out, strict=True):
            if off > 10 * usual:
                leave_out(
                    photo, f"it disagrees with the others by {off:.2g} px, they by {usual:.2g}"
                )
        result = calibrate([each for _, each in views.values()], **scales)
    images, detections = zip(*views.values(), strict=True)
    _advise(session, result, detections, a.focal_length is not None)
    tables = [each.to_frame().assign(photo=photo) for photo, (_, each) in views.items()]
    session.write(
        "points.csv", text(pd.concat(tables).set_index("photo").to_csv(lineterminator="\n"))
    )
    session.write("camera.csv", text(result.to_frame().to_csv(lineterminator="\n")))
    session.write("camera.json", text(result.to_json()))
    session.write("look.png", picture(partial(result.plot, found=detections, images=images)))
    session.say(result)
    return End()


def _advise(session: Session, result: Any, detections: Sequence[Any], focal_given: bool) -> None:
    """Note what to do about a calibration that is worth little."""
    shares = [
        np.ptp(detection.points, axis=0).prod() / np.prod(detection.image_size)
        for detection in detections
    ]
    if max(shares) < 0.05:
        session.note("the grid covers less than 5 % of the image: let it fill the image")
    if not result.adequate:
        more = " Several photographs show more of the lens" * (len(detections) == 1)
        focal = "--focal-length that of the objective, " * focal_given
        suspects = f"is {focal}the pattern flat and sharp, and --pitch the same everywhere?"
        session.note(f"the model does not fit the points: {suspects}{more}")
    if np.isnan(result.misfit):
        session.note(
            "too few marks to test whether the model fits: the intervals contain only noise; "
            "photograph more marks"
        )
    if result.interval("magnification")[0] <= 0:
        session.note(
            "the magnification's interval reaches zero: photograph more marks, over more of it"
        )
    elif result.undetermined:
        names = ", ".join(result.undetermined)
        session.note(
            f"{names}: undetermined; give --focal-length, or tilt the pattern by 20° or more"
        )
