"""What commands share: scales, which are numbers with units, frames and photographs."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from microlib._command._session import Session, option
from microlib._common import PREFIXES, as_physical, as_poisson_ratio, home_path

if TYPE_CHECKING:
    from microlib.io import Stack

#: Unit and description of each scale.
_SCALES = {
    "spacing": ("µm", "distance between frames, negative downwards; by default from the file"),
    "pixel_size": ("µm/px", "pixel size in the object plane; by default from the file"),
    "max_uncertainty": ("µm", "leave out heights whose stated uncertainty is larger"),
    "pitch": ("µm", "distance between the centers of neighboring marks, or side of a field"),
    "pitch_y": ("µm", "the same along the other direction, downwards, if the print is not square"),
    "division": ("µm", "distance of the closest lines of a stage micrometer"),
    "pixel_pitch": ("µm", "pixel pitch: distance of neighboring pixels on the sensor"),
    "focal_length": ("µm", "focal length of the objective as a thin lens; otherwise estimated"),
    "force": ("µN", "force of the probe"),
    "force_uncertainty": ("µN", "standard deviation of the force; 0 by default"),
    "thickness": ("µm", "thickness of the membrane"),
    "thickness_uncertainty": ("µm", "standard deviation of the thickness; 0 by default"),
    "probe_half_width": ("µm", "half of the width of the probe at its end"),
    "poisson_ratio": ("ratio", "Poisson ratio of the membrane; 0.5 for constant volume"),
}
#: Options of a part of an image.
BOX: dict[str, Any] = {"nargs": 4, "type": int, "metavar": ("X", "Y", "W", "H")}


def add_scales(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add an option for each of these scales."""
    for name in names:
        unit, about = _SCALES[name]
        parser.add_argument(option(name), type=_quantity(unit), metavar=unit, help=about)


def _quantity(unit: str) -> Callable[[str], float]:
    """Return a parser of numbers with or without a unit of their own, which converts to `unit`."""

    def read(text: str) -> float:
        if "," in text:
            raise argparse.ArgumentTypeError(f"must have a decimal point, got {text}")
        own = re.search(rf"\s*([nuµμmc]?){unit[1:].removesuffix('/px')}(/px)?$", text)
        number = float(text[: own.start() if own else None])
        return number * PREFIXES[own[1]] if own else number

    read.__name__ = f"number in {unit}"  # as argparse calls it
    return read


def resolve_scales(
    a: argparse.Namespace, session: Session, *names: str, **from_file: float | None
) -> dict[str, float]:
    """Return and print each scale, as given or from the file; raise if a scale is missing."""
    given = {name: value for name in names if (value := getattr(a, name)) is not None}
    scales: dict[str, Any] = {name: given.get(name, from_file.get(name)) for name in names}
    missing = [f"{option(n)} {_SCALES[n][0]}" for n, value in scales.items() if value is None]
    if missing:
        raise ValueError(f"no scale is in the file: give {', '.join(missing)}")
    for name, value in scales.items():
        unit = _SCALES[name][0]
        session.say(f"{name} {value:g} {unit} ({'given' if name in given else 'the file'})")
        if name == "poisson_ratio":
            as_poisson_ratio(value)
        else:
            as_physical(name, value, signed=name == "spacing")
        if name in given:
            compare(session, name, value, from_file.get(name), unit)
    if "pixel_size" in given:
        question_size(session, given["pixel_size"])
    return scales


def compare(session: Session, name: str, given: float, own: float | None, unit: str) -> None:
    """Note that a given value differs from that of the file."""
    if own and abs(given - own) > 0.01 * abs(own):
        session.note(f"the file has {own:.4g} {unit}: {option(name)} {given:g} is used")


def question_size(session: Session, size: float) -> None:
    """Note that a pixel is larger than those of microscopes and macro lenses."""
    if size > 100:
        session.note(f"a pixel of {size:.3g} µm is that of no microscope: is the unit right?")


def add_axes(parser: argparse.ArgumentParser) -> None:
    """Add the choice among the axes of a file that has more than a stack."""
    labels = "letter of the axis of frames, if a TIFF calls that of a focal stack T or C"
    parser.add_argument("--axis", choices=["C", "T", "Z"], help=labels)
    for name in ("channel", "time", "series"):
        parser.add_argument(
            option(name), type=int, metavar="N", help=f"{name} to read, counted from 0"
        )


def open_frames(a: argparse.Namespace, session: Session) -> Stack:
    """Return the frames, whose files are printed and cannot be overwritten."""
    from microlib.io import image_files, in_order, read_frames

    source = a.source[0]
    if len(a.source) > 1:  # as a shell makes of a pattern, in an order without regard to numbers
        source = in_order(image_files(*map(home_path, a.source)))
    choice = {name: getattr(a, name) for name in ("axis", "channel", "time", "series")}
    frames = read_frames(source, color=True, **choice)
    session.protect(frames.files)
    if len(frames.files) > 1:
        first, *_, last = frames.files
        session.say(f"{len(frames.files)} files, from {first.name} to {last.name}")
    return frames


def photographs(source: Iterable[str], session: Session) -> list[Path]:
    """Return the photographs, which cannot be overwritten."""
    from microlib.io import image_files

    photos = image_files(*map(home_path, source))
    session.protect(photos)
    return photos


def detect_each(
    photos: Sequence[Path],
    detect: Callable[[NDArray], Any],
    session: Session,
    describe: Callable[[Any], str],
) -> dict[Path, tuple[NDArray, Any]]:
    """Return the grey levels of each photograph and what is detected; note those left out.

    A line with the description of what is detected is printed after each photograph.
    """
    from microlib.io import read_grey

    found, fault = {}, ""
    for photo in session.bar(photos, unit=" photos"):
        try:
            image = read_grey(photo)
            found[photo] = image, detect(image)
            session.say(f"{photo}: {describe(found[photo][1])}")
        except ValueError as error:
            reason = str(error).removeprefix(f"path must name an image, got {photo}: ")
            fault = f"{photo}: {reason}"
            session.note(f"left out {fault}")
            session.say(f"{photo}: left out")
    if not found:
        raise ValueError(fault + f"; so {len(photos)} photographs" * (len(photos) > 1))
    return found
