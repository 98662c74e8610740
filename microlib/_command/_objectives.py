"""The task of ``microlib calibrate --marks micrometer``: a table of objectives."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from functools import partial

import numpy as np

from microlib._command._options import detect_each, photographs, question_size, resolve_scales
from microlib._command._session import End, Session, option, picture, rounded, text

#: Names of the files that it writes, beside a picture.
FILES = ("objectives.csv", "micromanager.txt", "imagej.ijm")


def run(a: argparse.Namespace, session: Session) -> End:
    """Measure the pixel size of each objective, which has the name of its photograph."""
    import pandas as pd

    from microlib._plots import micrometers
    from microlib.calibration import detect_micrometer

    for name in ("pitch", "pitch_y", "pixel_pitch", "focal_length"):
        if getattr(a, name) is not None:
            raise ValueError(f"a micrometer needs --division, not {option(name)}")
    resolve_scales(a, session, "division")
    photos = photographs(a.source, session)
    names = {photo: re.sub(r'[,"\\]', "_", photo.stem) for photo in photos}
    if len(set(names.values())) < len(photos):
        raise ValueError(f"names of photographs must differ, got {[*names.values()]}")
    found = detect_each(
        photos, detect_micrometer, session, lambda found: f"{len(found.points)} lines"
    )
    images = {names[photo]: image for photo, (image, _) in found.items()}
    scales = {names[photo]: scale for photo, (_, scale) in found.items()}
    sizes = {name: scale.um_per_pixel(a.division) for name, scale in scales.items()}
    _check_magnifications(session, {name: size.value for name, size in sizes.items()})
    rows = [vars(size) for size in sizes.values()]
    table = pd.DataFrame(rows, index=pd.Index(sizes, name="objective"))
    table["lines"] = [len(scale.points) for scale in scales.values()]
    digits = {name: f"{size.value:.7g}" for name, size in sizes.items()}
    session.write("objectives.csv", text(rounded(table).to_csv(lineterminator="\n")))
    session.write("micromanager.txt", text(_micro_manager(digits)))
    session.write("imagej.ijm", text(_imagej(digits)))
    session.write("look.png", picture(partial(micrometers, scales, images)))
    for name, size in sizes.items():
        session.say(f"{name}: {size}")
        question_size(session, size.value)
        if size.uncertainty > 0.01 * size.value:
            session.note(f"{name}: the lines are uneven by more than those of a micrometer")
    return End()


def _check_magnifications(session: Session, sizes: Mapping[str, float]) -> None:
    """Note objectives whose pixel size does not fit the magnification in the name, as of 10x."""
    read = {name: re.search(r"(\d+(?:\.\d+)?) ?[xX×]", name) for name in sizes}
    products = {name: float(found[1]) * sizes[name] for name, found in read.items() if found}
    usual = np.median([*products.values()]) if products else np.nan
    for name, product in products.items():
        if not 1 / 1.5 < product / usual < 1.5:
            session.note(
                f"{name}: its pixel size is {product / usual:.3g} times what the others and the "
                "magnifications in the names give: does its photograph show other divisions?"
            )


def _micro_manager(digits: Mapping[str, str]) -> str:
    """Return lines for a configuration file of Micro-Manager."""
    lines = [
        "# Append these lines to the configuration file of Micro-Manager. Replace Objective by the",
        "# name of the turret there, and the last word of each ConfigPixelSize by the label of the",
        "# objective.",
    ]
    for name, size in digits.items():
        lines += [f"ConfigPixelSize,{name},Objective,Label,{name}", f"PixelSize_um,{name},{size}"]
    return "\n".join([*lines, ""])


def _imagej(digits: Mapping[str, str]) -> str:
    """Return a macro of ImageJ that sets the scale of the open image."""
    names, sizes = (", ".join(f'"{each}"' for each in part) for part in (digits, digits.values()))
    return f"""// Sets the scale of the open image: drop this file on ImageJ, and choose Run Macro.
names = newArray({names});
sizes = newArray({sizes});  // micrometers per pixel
Dialog.create("Scale of the image");
Dialog.addChoice("Objective", names);
Dialog.show();
name = Dialog.getChoice();
for (i = 0; i < names.length; i++)
    if (names[i] == name)
        run("Set Scale...", "distance=1 known=" + sizes[i] + " pixel=1 unit=um");
"""
