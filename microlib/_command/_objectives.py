"""The task of ``microlib calibrate --marks micrometer``: a table of objectives."""

from __future__ import annotations

import argparse
from functools import partial

from microlib._command._options import detect_each, photographs, resolve_scales
from microlib._command._session import End, Session, option, picture, rounded, text

#: Name of the file that it writes, beside a picture.
FILE = "objectives.csv"


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
    names = [photo.stem for photo in photos]
    if len(set(names)) < len(photos):
        raise ValueError(f"names of files must differ, as they name the objectives, got {names}")
    found = detect_each(photos, detect_micrometer, session)
    images = {photo.stem: image for photo, (image, _) in found.items()}
    scales = {photo.stem: scale for photo, (_, scale) in found.items()}
    sizes = {name: scale.um_per_pixel(a.division) for name, scale in scales.items()}
    rows = [vars(size) for size in sizes.values()]
    table = pd.DataFrame(rows, index=pd.Index(sizes, name="objective"))
    table["lines"] = [len(scale.points) for scale in scales.values()]
    session.write(FILE, text(rounded(table).to_csv(lineterminator="\n")))
    session.write("look.png", picture(partial(micrometers, scales, images)))
    for name, size in sizes.items():
        session.say(f"{name}: {size}, {len(scales[name].points)} lines")
    return End()
