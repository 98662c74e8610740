"""The command ``microlib track``."""

from __future__ import annotations

import argparse
import csv
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from microlib._command import _shared
from microlib._command._shared import Files, open_frames, picture, settle


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(files=["table", "look.png", "look.mp4"])
    parser.add_argument("source", metavar="FILM", help="video, TIFF, folder or quoted pattern")
    corner, box = ("X", "Y", "W", "H"), "the part in the first frame, px"
    parser.add_argument("--box", nargs=4, type=int, required=True, metavar=corner, help=box)
    motions = ["translation", "affine", "homography"]
    parser.add_argument("--motion", choices=motions, default=motions[0], help="how the part moves")
    parser.add_argument("--rate", type=float, help="frames per second, for a column of times")
    _shared.add_scales(parser, "pixel_size")
    _shared.add_axes(parser)
    film = "also a film with the part marked"
    parser.add_argument("--video", action="store_true", help=film)


def run(a: argparse.Namespace) -> Files:
    """Position of a part in every frame of a film.

    Example: microlib track film.avi --box 30 40 64 64 --rate 33 -o track.csv
    """
    import pandas as pd

    from microlib import tracking

    frames = open_frames(a)
    size = frames.pixel_size if a.pixel_size is None else a.pixel_size
    if size is not None:
        settle(a, "pixel_size", pixel_size=frames.pixel_size)
    each = tracking.track_each(frames, a.box, a.motion, rate=a.rate, pixel_size=size)
    rows, lost = [next(each)], 0
    stop: BaseException | None = None
    a.out.parent.mkdir(parents=True, exist_ok=True)
    with (
        a.out.open("w", 1, encoding="utf-8", newline="") as file,
        a.bar(each, initial=1, total=frames.count, unit=" frames") as bar,
    ):
        # As it goes: what is killed leaves the rows so far.
        lines = csv.DictWriter(file, rows[0], lineterminator="\n")
        lines.writeheader()
        lines.writerow(rows[0])
        try:
            for row in bar:
                lines.writerow(row)
                rows.append(row)
                lost += row["lost"]
                bar.set_postfix_str(f"lost in {lost / len(rows):.0%}", False)
        except (OSError, ValueError, KeyboardInterrupt) as error:
            stop = error
    table = pd.DataFrame(rows)
    yield "look.png", picture(lambda: tracking.plot_track(table, next(iter(frames))))
    yield "look.mp4", partial(_film, a, table)
    summary = f"lost in {lost} of {len(rows)} frames"
    a.say(f"{summary}; one row a frame, lengths in px, of columns …_um in µm")
    if stop is not None:
        status = 130 if isinstance(stop, KeyboardInterrupt) else 3
        kept = a.out.read_text(encoding="utf-8").count("\n") - 1  # Ctrl-C may precede the counting
        a.end = status, f"{str(stop) or 'stopped'}; {a.out} keeps the {kept} rows so far"
    elif lost > len(rows) / 2:
        remedy = "another --motion, a larger --box, or more frames per second"
        a.end = 4, f"{summary}: try {remedy}"


def _film(a: argparse.Namespace, table: Any, path: Path) -> None:
    """Write the frames with the part in yellow, or in red where it was last seen."""
    import cv2

    frames = _shared.read(a)
    width, height = frames.shape[::-1]
    code = cv2.VideoWriter.fourcc(*"mp4v")
    film = cv2.VideoWriter(str(path), code, a.rate or 25, (width, height))
    if not film.isOpened():
        raise ValueError(f"OpenCV cannot write a film of {width}×{height} px here")
    corners = table.filter(like="corners_").ffill().to_numpy(float).reshape(-1, 4, 2)
    levels = None
    for corner, lost, frame in zip(corners, table["lost"], frames, strict=False):
        levels = levels or (frame.min(), frame.max())  # those of the first frame
        seen = np.interp(frame, levels, (0, 255)).astype(np.uint8)
        image = cv2.cvtColor(seen, cv2.COLOR_GRAY2BGR if seen.ndim == 2 else cv2.COLOR_RGB2BGR)
        color = (0, 0, 255) if lost else (0, 255, 255)  # OpenCV puts blue first
        cv2.polylines(image, [np.rint(corner).astype(np.int32)], True, color, 2)
        film.write(image)
    film.release()
