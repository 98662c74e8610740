"""The command ``microlib track``."""

from __future__ import annotations

import argparse
import csv
import warnings
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from microlib._command._files import Unfinished, beside, refuse_targets, write
from microlib._command._scales import add_scales, settle
from microlib._common import scalar


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Example: microlib track film.avi --box 30 40 64 64 --rate 33 -o track.csv"
    parser.set_defaults(table=True, words={"frames": "source", "image": "source"})
    parser.add_argument("source", metavar="FILM", help="video, TIFF, folder or quoted pattern")
    corner, box = ("X", "Y", "W", "H"), "the part in the first frame, px"
    parser.add_argument("--box", nargs=4, type=int, required=True, metavar=corner, help=box)
    motions = ["translation", "affine", "homography"]
    parser.add_argument("--motion", choices=motions, default=motions[0], help="how the part moves")
    parser.add_argument("--rate", type=float, help="frames per second, for a column of times")
    add_scales(parser, "pixel_size")
    parser.add_argument("--video", action="store_true", help="also a film with the part marked")
    early = "a film that ends before its header says is no fault"
    parser.add_argument("--allow-truncated", action="store_true", help=early)


def run(a: argparse.Namespace) -> None:
    """Position of a part in every frame of a film."""
    import cv2
    import pandas as pd

    from microlib._plots import path
    from microlib.io import read_frames
    from microlib.tracking import ESMTracker

    rate = None if a.rate is None else scalar("rate", a.rate, above=0)
    frames = read_frames(a.source, color=True)
    size = frames.pixel_size if a.pixel_size is None else a.pixel_size
    if size is not None:
        settle(a, "pixel_size", pixel_size=frames.pixel_size)
    look, video = beside(a.out, "_look.png"), beside(a.out, "_look.mp4")
    refuse_targets(a, [a.out, *([] if a.no_look else [look]), *([video] if a.video else [])])
    rows: list[dict[str, Any]] = []
    lost = 0
    stop: BaseException | None = None
    with ExitStack() as opened:
        bar = opened.enter_context(tqdm(total=frames.count, unit=" frames", **a.bar))
        try:
            for number, frame in enumerate(frames):
                if number == 0:
                    first, tracker = frame, ESMTracker(frame, tuple(a.box), a.motion)
                track = tracker.track(frame)
                row: dict[str, Any] = {"frame": number}
                row |= {} if rate is None else {"time_s": number / rate}
                row |= track.to_dict()
                if number == 0:
                    start = track.center
                if size is not None:
                    row |= dict(zip(("x_um", "y_um"), size * (track.center - start), strict=True))
                if track.lost:
                    places = ("corners", "center", "x_um", "y_um")
                    row |= {name: None for name in row if name.startswith(places)}
                if number == 0:
                    # As it goes: what is killed leaves the rows so far.
                    a.out.parent.mkdir(parents=True, exist_ok=True)
                    file = opened.enter_context(a.out.open("w", 1, encoding="utf-8", newline=""))
                    table = csv.DictWriter(file, row, lineterminator="\n")
                    table.writeheader()
                    if a.video:
                        kind, shape = cv2.VideoWriter.fourcc(*"mp4v"), frame.shape[1::-1]
                        film = cv2.VideoWriter(str(video), kind, rate or 25, shape)
                        opened.callback(film.release)
                table.writerow(row)
                rows.append(row)
                lost += track.lost
                if a.video:
                    film.write(_marked(frame, track, first))
                bar.set_postfix_str(f"lost in {lost / len(rows):.0%}", False)
                bar.update()
        except (OSError, ValueError, KeyboardInterrupt) as error:
            if not rows:
                raise
            stop = error
    if not rows:
        raise ValueError(f"{a.source} holds no frame")
    if not a.no_look:
        write(look, path(pd.DataFrame(rows), first))
    summary = f"lost in {lost} of {len(rows)} frames"
    a.say(f"{summary}\n{a.out}: one row a frame; lengths in px, of columns …_um in µm")
    kept = f"{a.out} keeps the {len(rows)} rows so far"
    if isinstance(stop, KeyboardInterrupt):
        raise Unfinished(130, f"stopped; {kept}")
    if stop is not None and not a.allow_truncated:
        raise Unfinished(3, f"{stop}; {kept}")
    if stop is not None:
        warnings.warn(f"{stop}; {kept}", stacklevel=2)
    if lost > len(rows) / 2:
        remedy = "another --motion, a larger --box, or more frames per second"
        raise Unfinished(4, f"{summary}: try {remedy}")


def _marked(frame: NDArray, track: Any, first: NDArray) -> NDArray[np.uint8]:
    """Return a frame as a film shows it, with the part in yellow, or red where it is lost."""
    import cv2

    low, high = float(first.min()), float(first.max())
    grey = np.clip((frame.astype(np.float32) - low) / (high - low or 1), 0, 1)
    image = (255 * np.atleast_3d(grey)).astype(np.uint8)
    image = np.ascontiguousarray(np.broadcast_to(image[..., ::-1], (*frame.shape[:2], 3)))
    color = (0, 0, 255) if track.lost else (0, 255, 255)  # OpenCV puts blue first
    cv2.polylines(image, [np.rint(track.corners).astype(np.int32)], True, color, 2)
    return image
