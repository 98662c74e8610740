"""The command ``microlib calibrate``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import mode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._command import _objectives
from microlib._command import _options as options
from microlib._command._session import End, Session, picture, rounded, text
from microlib._common import PHYSICAL_RANGES

#: Names of the files that it writes.
FILES = ("camera.csv", "camera.json", "points.csv", "look.png", *_objectives.FILES)
#: Grey levels and the detected pattern of each photograph.
Views = dict[Path, tuple[NDArray, Any]]


def add_options(parser: argparse.ArgumentParser) -> None:
    photos = "images of a pattern, folder or quoted file name pattern; one microscope, one size"
    parser.add_argument("source", metavar="PHOTO", nargs="+", help=photos)
    options.add_scales(parser, "pitch", "pitch_y", "pixel_pitch", "focal_length", "division")
    marks = ["auto", "chessboard", "charuco", "squares", "circles", "micrometer"]
    about = "kind of marks; micrometer: lines of a scale, a photograph for each objective"
    parser.add_argument("--marks", choices=marks, default=marks[0], help=about)


def run(a: argparse.Namespace, session: Session) -> End:
    """Scale, pose and distortion of a microscope from photographs of a pattern.

    Example: microlib calibrate grid.png --pitch 200 --pixel-pitch 4.8 -o camera
    """
    if a.marks == "micrometer":
        return _objectives.run(a, session)
    if a.division is not None:
        raise ValueError("--division belongs to --marks micrometer; other marks have a --pitch")
    import pandas as pd

    from microlib.calibration import calibrate

    known = [n for n in ("pitch_y", "pixel_pitch", "focal_length") if getattr(a, n) is not None]
    lens = ["pixel_pitch"] * (a.focal_length is not None)  # of which a length in µm needs the pitch
    options.resolve_scales(a, session, "pitch", *sorted({*lens, *known}))
    pitch = (a.pitch, a.pitch_y or a.pitch)
    scales = {"pitch": pitch, "pixel_pitch": a.pixel_pitch, "focal_length": a.focal_length}
    views = _detect(session, a.source, a.marks)
    while True:
        detections = [found for _, found in views.values()]
        try:
            result = calibrate(detections, **scales)
            inconsistent = result.inconsistent
        except ValueError as error:
            if not (inconsistent := getattr(error, "views", ())) or len(inconsistent) == len(views):
                raise
        if not inconsistent:
            break
        for photo in [list(views)[view] for view in inconsistent]:
            views.pop(photo)
            session.note(f"left out {photo}: it shows another pattern or lens than the others")
    size, (_, least, most) = result.um_per_pixel.value, PHYSICAL_RANGES["pixel_size"]
    if not least <= size <= most:
        meant = f"{a.pitch:g}{'mm' if size < least else 'nm'}"
        raise ValueError(
            f"--pitch {a.pitch:g} µm gives {size:.3g} µm per pixel, and a microscope has {least:g} "
            f"to {most:g}: did you mean --pitch {meant}?"
        )
    options.question_size(session, size)
    images = [image for image, _ in views.values()]
    _advise(session, result, views, a.focal_length is not None)
    camera = result.to_json()
    difference = json.loads(camera)["opencv"]["distortion_model_error_px"]
    if difference is not None and difference > result.reprojection.rms:
        session.note(
            f"OpenCV's camera in camera.json deviates by up to {difference:.2g} px from the "
            f"calibrated model; residuals are {result.reprojection.rms:.2g} px rms"
        )
    tables = [found.to_frame().assign(photo=photo) for photo, (_, found) in views.items()]
    session.write(
        "points.csv", text(pd.concat(tables).set_index("photo").to_csv(lineterminator="\n"))
    )
    table = rounded(result.to_frame())
    session.write("camera.csv", text(table.to_csv(lineterminator="\n")))
    session.write("camera.json", text(camera))
    session.write("look.png", picture(partial(result.plot, found=detections, images=images)))
    session.say(result)
    return End()


def _detect(session: Session, source: Sequence[str], pattern: str) -> Views:
    """Return the photographs with a pattern, all of the usual size, and the patterns found."""
    from microlib.calibration import detect_pattern

    found = options.detect_each(
        options.photographs(source, session),
        partial(detect_pattern, pattern=pattern),
        session,
        lambda found: f"{found[0]}: {found[1]}",
    )
    views = {photo: (image, detection) for photo, (image, (_, detection)) in found.items()}
    sizes = {photo: "×".join(map(str, found.image_size)) for photo, (_, found) in views.items()}
    usual_size = mode(sizes.values())
    for photo, size in sizes.items():
        if size != usual_size:
            views.pop(photo)
            session.note(f"left out {photo}: its size is {size} px, of most {usual_size}")
    return views


def _advise(session: Session, result: Any, views: Views, focal_given: bool) -> None:
    """Note what to do about a calibration that is worth little, whose summary states why."""
    shares = [
        np.ptp(found.points, axis=0).prod() / np.prod(found.image_size)
        for _, found in views.values()
    ]
    if max(shares) < 0.05:
        session.note("the grid covers less than 5 % of the image: let it fill the image")
    if result.print_aspect != 1:
        session.note("measure the print, and give --pitch and --pitch-y: it is not square")
    if "beta" in result.undetermined and (tilt := result.microscope.tilt) > np.deg2rad(10):
        session.note(
            f"in one direction the marks are {1 / np.cos(tilt):.3f} times as far apart as in the "
            f"other, compared with --pitch: if that is no tilt of {np.rad2deg(tilt):.0f}°, give "
            "--pitch and --pitch-y"
        )
    if not result.adequate:
        focal = "--focal-length that of the objective, " * focal_given
        suspects = f"is {focal}the pattern flat and sharp, and --pitch the same everywhere?"
        if len(views) == 1:
            suspects = (
                "one photograph does not determine the center of the lens, which is assumed to be "
                f"in the middle of the image: give several, tilted; otherwise, {suspects}"
            )
        ends = np.cumsum([len(found.points) for _, found in views.values()])[:-1]
        rms = [np.sqrt((each**2).sum(axis=1).mean()) for each in np.split(result.residuals, ends)]
        worst = [
            f"{photo.name} {size:.2g} px"
            for size, photo in sorted(zip(rms, views, strict=True))[::-1]
        ]
        session.note(f"residuals are larger than noise, most in {', '.join(worst[:3])}; {suspects}")
    if np.isnan(result.lack_of_fit):
        session.note("photograph more marks: intervals contain only noise")
    if result.um_per_pixel.high == np.inf:
        session.note("the pixel size has no upper limit: photograph more marks over more area")
    elif result.undetermined:
        names = ", ".join(result.undetermined)
        session.note(f"give --focal-length, or tilt the pattern by 20°, to determine {names}")
