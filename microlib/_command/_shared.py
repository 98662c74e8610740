"""What the commands share: options, numbers with units, frames, texts and pictures."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from microlib._common import MEASURED, SOFTWARE, scalar

#: Writes a file; what a task gives, by the names of its files.
Writer = Callable[[Path], object]
Files = Iterator[tuple[str, Writer]]

#: What stands before the unit that the library computes in, and what it comes to there.
_PREFIXES = {"n": 1e-3, "u": 1.0, "µ": 1.0, "μ": 1.0, "m": 1e3, "c": 1e4, "": 1e6}

#: Unit of each scale, and what it is.
_SCALES = {
    "spacing": ("µm", "between frames, if the file does not say"),
    "pixel_size": ("µm/px", "in the object plane, if the file does not say"),
    "pitch": ("µm", "between the middles of neighboring marks, or side of a field"),
    "cell": ("µm", "size of a cell of the camera's sensor"),
    "focal_length": ("µm", "of the objective, from its maker; else it is estimated"),
    "force": ("µN", "of the probe"),
    "force_std": ("µN", "standard deviation of the force, 0"),
    "thickness": ("µm", "of the membrane"),
    "thickness_std": ("µm", "standard deviation of the thickness, 0"),
    "probe_half_width": ("µm", "of its end"),
    "poisson_ratio": ("ratio", "of the membrane; 0.5 if it keeps its volume"),
}
#: Those that may be zero or negative.
_SIGNED = ("spacing", "poisson_ratio")


def option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def add_scales(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add an option for each of these scales."""
    for name in names:
        unit, about = _SCALES[name]
        parser.add_argument(option(name), type=_quantity(unit), metavar=unit, help=about)


def _quantity(unit: str) -> Callable[[str], float]:
    """Return what reads a number, with or without a unit of its own, in `unit`."""

    def read(text: str) -> float:
        own = re.search(rf"\s*([nuµμmc]?){unit[1:].removesuffix('/px')}(/px)?$", text)
        number = plain_number(text[: own.start() if own else None])
        return number * _PREFIXES[own[1]] if own else number

    read.__name__ = f"number in {unit}"  # as argparse calls it
    return read


class AmbiguousNumberError(argparse.ArgumentTypeError, ValueError):
    """A number whose comma may be of decimals or of thousands; argparse shows its message."""


def plain_number(text: str) -> float:
    """Return a number with a decimal point or comma; 126,000 may be one of thousands."""
    plain, decimal = text.replace(",", ""), text.replace(",", ".")
    thousands = re.fullmatch(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?", text)
    if thousands and text.count(",") == 1 and not thousands[2]:
        raise AmbiguousNumberError(f"{text} can be {plain} or {decimal}: write one of them")
    return float(plain if thousands else decimal)


def settle(a: argparse.Namespace, *names: str, **read: float | None) -> dict[str, float]:
    """Return each scale, as given or read from the file, and say which; ask for the missing."""
    values = {name: getattr(a, name) for name in names}
    values = {name: read.get(name) if value is None else value for name, value in values.items()}
    missing = [f"{option(name)} {_SCALES[name][0]}" for name in names if values[name] is None]
    if missing:
        raise ValueError(f"no scale is in the file: give {', '.join(missing)}")
    for name, value in values.items():
        unit = _SCALES[name][0]
        scalar(name, value, above=None if name in _SIGNED else 0)
        a.say(f"{name} {value:g} {unit} ({'the file' if getattr(a, name) is None else 'given'})")
        low, high = MEASURED.get(unit, (0, 1))
        if not low <= abs(value) <= high:
            usual = f"{low:g} to {high:g} {unit}"
            text = f"{option(name)} {value:g} is unusual under a microscope, which meets {usual}"
            a.note(f"{text}; a number may have its unit, as 0.2mm")
    return values


def add_axes(parser: argparse.ArgumentParser) -> None:
    """Add the choice among the axes of a file that has more than a stack."""
    for name in ("channel", "time", "series"):
        parser.add_argument(option(name), type=int, metavar="N", help=f"{name} to read, from 0")


def read(a: argparse.Namespace) -> Any:
    """Return a reader of the frames of a task."""
    from microlib.io import read_frames

    chosen = {name: getattr(a, name) for name in ("channel", "time", "series")}
    return read_frames(a.source, color=True, **chosen)


def open_frames(a: argparse.Namespace) -> Any:
    """Return a reader, once the order of files is printed and none of them is to be replaced."""
    frames = read(a)
    a.protect(frames.files)
    if len(frames.files) > 1:
        a.say(f"{len(frames.files)} files, from {frames.files[0].name} to {frames.files[-1].name}")
    return frames


def text(content: str) -> Writer:
    return lambda file: file.write_text(content, encoding="utf-8", newline="\n")


def picture(draw: Callable[[], Any]) -> Writer:
    """Return what draws a figure once its file is to be written."""

    def write(file: Path) -> None:
        from microlib._plots import default_style

        with default_style():
            draw().savefig(file, dpi=150, metadata={"Software": SOFTWARE})

    return write
