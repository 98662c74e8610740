"""The command ``microlib track``."""

from __future__ import annotations

import argparse
import csv
import errno
import os
from functools import partial
from pathlib import Path
from statistics import mode
from typing import Any

import numpy as np

from microlib._command import _options as options
from microlib._command._session import End, Session, explain, picture
from microlib._common import ArgumentError, home_path

#: Names of the files that it writes.
FILES = ("table", "look.png", "look.mp4")
#: Kinds of motion, each with more freedom than the one before.
_MOTIONS = ("translation", "affine", "homography")
#: Remedies by the reason of a loss, if another motion is none.
_REMEDIES = {
    "two motions": "a --mask of the part, or a tighter --box",
    "out of view": "a --box around a part that stays in the image",
    "ambiguous": "more frames per second, as the texture repeats",
}


def add_options(parser: argparse.ArgumentParser) -> None:
    film = "video, TIFF, folder, or pictures, in the natural order of their names"
    parser.add_argument("source", metavar="FILM", nargs="+", help=film)
    box = "box around the part in the first frame, px"
    parser.add_argument("--box", required=True, help=box, **options.BOX)
    mask = "image of the frame's size that is not black where the box shows the part"
    parser.add_argument("--mask", metavar="FILE", help=mask)
    parser.add_argument("--motion", choices=_MOTIONS, default=_MOTIONS[0], help="kind of motion")
    rate = "frames per second, for the column of times; by default times are those of the file"
    parser.add_argument("--rate", type=float, help=rate)
    options.add_scales(parser, "pixel_size")
    options.add_axes(parser)
    film = "also write a film that marks the part, with 25 frames/s if no time is known"
    parser.add_argument("--video", action="store_true", help=film)


def run(a: argparse.Namespace, session: Session) -> End:
    """Position of a part in every frame of a film.

    Example: microlib track film.avi --box 30 40 64 64 --rate 33 -o track.csv
    """
    import pandas as pd

    from microlib import io, tracking

    frames = options.open_frames(a, session)
    if frames.count == 1:
        raise ValueError(f"{', '.join(a.source)} must hold two frames or more, got 1")
    size = frames.pixel_size if a.pixel_size is None else a.pixel_size
    if size is not None:
        options.resolve_scales(a, session, "pixel_size", pixel_size=frames.pixel_size)
    mask = None
    if a.mask is not None:
        try:
            mask = io.read_grey(home_path(a.mask))
        except ValueError as error:
            raise ArgumentError("mask", str(error).removeprefix("path ")) from error
        session.protect([home_path(a.mask)])
    each = tracking.track_each(frames, a.box, a.motion, rate=a.rate, pixel_size=size, mask=mask)
    rows, lost = [next(each)], 0
    if a.rate is not None:
        session.say(f"rate {a.rate:g} frames/s (given)")
    elif "time_s" in rows[0]:
        session.say("times of the frames (the file)")
    stop: Exception | KeyboardInterrupt | None = None
    try:
        with (
            session.open_lines("table") as file,
            session.bar(each, initial=1, total=frames.count, unit=" frames") as bar,
        ):
            # Each row at once, so that a killed process leaves the rows so far.
            table = csv.DictWriter(file, rows[0], lineterminator="\n")
            table.writeheader()
            table.writerow(_rounded(rows[0]))
            for row in bar:
                table.writerow(_rounded(row))
                rows.append(row)
                lost += row["lost"]
                bar.set_postfix_str(f"lost in {lost / len(rows):.0%}", False)
    except (OSError, ValueError, KeyboardInterrupt) as error:
        stop = error
    track = pd.DataFrame(rows)
    rate, last = a.rate or 25, frames.time(len(rows) - 1)
    if last:
        from_file = (len(rows) - 1) / last
        if a.rate is None:
            rate = from_file
        options.compare(session, "rate", rate, from_file, "frames/s")
    session.write("look.png", picture(lambda: tracking.plot_track(track, next(iter(frames)))))
    if a.video:
        session.write("look.mp4", partial(_write_film, frames, track, rate))
    summary, failed = f"lost in {lost} of {len(rows)} frames", lost > len(rows) / 2 and not stop
    physical = ", x_um and y_um in µm" * (size is not None)
    session.say(f"{summary}; " * (not failed) + f"one row per frame, lengths in px{physical}")
    if stop is not None:
        out = session.files["table"]
        kept = 0
        if out.is_file():  # and no device
            lines = out.read_bytes()
            os.truncate(out, lines.rfind(b"\n") + 1)  # a full disk keeps a part of the last row
            kept = max(lines.count(b"\n") - 1, 0)  # Ctrl-C can precede the counting
        why = "stopped" if isinstance(stop, KeyboardInterrupt) else explain(stop, out)
        reason = f"{why}; {out} keeps the {kept} rows so far"
        return End(130 if isinstance(stop, KeyboardInterrupt) else 3, reason)
    if failed:
        lost_rows = track[track["lost"]]
        first, reason = lost_rows["frame"].min(), mode(lost_rows["reason"])
        further = _MOTIONS[_MOTIONS.index(a.motion) + 1 :]
        other = "".join(f"--motion {motion}, or " for motion in further[:1])
        remedy = _REMEDIES.get(reason, f"{other}more frames per second")
        return End(4, f"{summary}, first in frame {first}, mostly by {reason}: try {remedy}")
    return End()


def _rounded(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row with seven digits, a ten-thousandth of a pixel in most images."""
    return {
        name: f"{value:.7g}" if isinstance(value, float) else value for name, value in row.items()
    }


def _write_film(frames: Any, track: Any, rate: float, path: Path) -> None:
    """Write the frames with the part in yellow, or in red where it was last seen."""
    import cv2

    width, height = frames.shape[::-1]
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    if not film.isOpened():
        raise ValueError(f"OpenCV cannot write a film of {width}×{height} px here")
    corners = track.filter(like="corners_").ffill().to_numpy(float).reshape(-1, 4, 2)
    levels = None
    for corner, lost, frame in zip(corners, track["lost"], frames, strict=False):
        levels = levels or (frame.min(), frame.max())  # those of the first frame
        grey = np.interp(frame, levels, (0, 255)).astype(np.uint8)
        image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR if grey.ndim == 2 else cv2.COLOR_RGB2BGR)
        color = (0, 0, 255) if lost else (0, 255, 255)  # OpenCV puts blue first
        cv2.polylines(image, [np.rint(corner).astype(np.int32)], True, color, 2)
        film.write(image)
    film.release()
    # OpenCV reports no error of a full disk.
    whole = cv2.VideoCapture(str(path))
    if whole.get(cv2.CAP_PROP_FRAME_COUNT) < len(track):
        raise OSError(errno.EIO, "the film is not whole; is the disk full?", str(path))
