"""The command ``microlib track``."""

from __future__ import annotations

import argparse
import csv
import warnings
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from microlib._command._files import Unfinished, add_output, beside, refuse_targets, write
from microlib._command._scales import add_scales, settle
from microlib._common import scalar

if TYPE_CHECKING:
    from microlib.tracking import Track


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Example: microlib track film.avi --box 30 40 64 64 --rate 33 -o track.csv"
    parser.set_defaults(words={"frames": "film", "image": "film"})
    parser.add_argument("film", metavar="FILM", help="video, TIFF, folder or quoted pattern")
    add_output(parser, table=True)
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
    import pandas as pd

    from microlib._plots import path
    from microlib.io import read_frames
    from microlib.tracking import ESMTracker

    rate = None if a.rate is None else scalar("rate", a.rate, above=0)
    frames = read_frames(a.film, color=True)
    size = frames.pixel_size if a.pixel_size is None else a.pixel_size
    if size is not None:
        told = {"pixel_size": frames.pixel_size}
        settle(a.film, {"pixel_size": a.pixel_size}, told, a.say)
    look, video = beside(a.out, "_look.png"), beside(a.out, "_look.mp4")
    refuse_targets(a, [a.out, *([] if a.no_look else [look]), *([video] if a.video else [])])
    rows: list[dict[str, Any]] = []
    lost, film = 0, None
    stop: BaseException | None = None
    with ExitStack() as opened:
        bar = tqdm(total=frames.count, desc="track", unit=" frames", **a.bar)
        opened.enter_context(bar)
        try:
            for number, frame in enumerate(frames):
                if number == 0:
                    first, tracker = frame, ESMTracker(frame, tuple(a.box), a.motion)
                track = tracker.track(frame)
                rows.append(_row(number, track, rate, size, rows[:1]))
                if number == 0:
                    # As it goes: what is killed leaves the rows so far.
                    file = opened.enter_context(a.out.open("w", 1, encoding="utf-8", newline=""))
                    table = csv.DictWriter(file, rows[0], lineterminator="\n")
                    table.writeheader()
                    if a.video:
                        film = opened.enter_context(closing(_Film(video, first, rate)))
                table.writerow(rows[-1])
                lost += track.lost
                bar.set_postfix_str(f"lost in {lost / len(rows):.0%}", refresh=False)
                bar.update()
                if film is not None:
                    film.add(frame, track)
        except (OSError, ValueError, KeyboardInterrupt) as error:
            if not rows:
                raise
            stop = error
    if not rows:
        raise ValueError(f"{a.film} holds no frame")
    if not a.no_look:
        write(look, path(pd.DataFrame(rows), first))
    a.say(f"lost in {lost} of {len(rows)} frames")
    units = ["px", *["µm"] * (size is not None), *["s"] * (rate is not None)]
    a.say(f"{a.out}: one row a frame, in {', '.join(units)}")
    kept = f"{a.out} keeps the {len(rows)} rows so far"
    if isinstance(stop, KeyboardInterrupt):
        raise Unfinished(130, f"stopped; {kept}")
    if stop is not None and not a.allow_truncated:
        raise Unfinished(3, f"{stop}; {kept}")
    if stop is not None:
        warnings.warn(f"{stop}; {kept}", stacklevel=2)
    if lost > len(rows) / 2:
        raise Unfinished(
            4,
            f"lost in {lost} of {len(rows)} frames: try another --motion, a larger --box, or more "
            "frames per second",
        )


def _row(
    number: int, track: Track, rate: float | None, size: float | None, first: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return a row of the table; positions of a frame in which the part is lost are empty."""
    row = track.to_dict()
    if track.lost:
        row |= {name: None for name in row if name.startswith(("corners", "center"))}
    if size is not None:
        for axis in "xy":
            center = row[f"center_{axis}"]
            start = (first[0] if first else row)[f"center_{axis}"]
            row[f"{axis}_um"] = None if center is None else size * (center - start)
    time = {} if rate is None else {"time_s": number / rate}
    return {"frame": number} | time | row


class _Film:
    """A film of the frames with the part marked: yellow, or red where it is lost."""

    def __init__(self, path: Path, first: NDArray, rate: float | None) -> None:
        import cv2

        size = first.shape[1::-1]
        self._film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate or 25, size)
        if not self._film.isOpened():
            raise ValueError(f"--video cannot write {path}: OpenCV has no encoder for it")
        self._low, self._high = float(first.min()), float(first.max())

    def add(self, frame: NDArray, track: Track) -> None:
        import cv2

        levels = (frame.astype(np.float32) - self._low) / (self._high - self._low or 1)
        image = (255 * np.clip(levels, 0, 1)).astype(np.uint8)
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_RGB2BGR)
        color = (0, 0, 255) if track.lost else (0, 255, 255)  # OpenCV puts blue first
        cv2.polylines(image, [np.rint(track.corners).astype(np.int32)], True, color, 2)
        self._film.write(image)

    def close(self) -> None:
        self._film.release()
