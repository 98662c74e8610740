"""Numbers with units: how they are read from a line, asked for, and told to be unusual."""

from __future__ import annotations

import argparse
import re
import warnings
from collections.abc import Callable, Mapping

#: What stands before the unit that the library computes in, and what it comes to there.
_PREFIXES = {"n": 1e-3, "u": 1.0, "µ": 1.0, "μ": 1.0, "m": 1e3, "c": 1e4, "": 1e6}

#: Unit of each scale, what it is, and from where to where microscopy meets it.
_SCALES = {
    "spacing": ("µm", "between frames, if the file does not say", 0.01, 1e4),
    "pixel_size": ("µm", "per pixel in the object plane, if the file does not say", 0.02, 100),
    "pitch": ("µm", "between the middles of neighboring marks, or side of a field", 0.5, 1e5),
    "cell": ("µm", "size of a cell of the camera's sensor", 0.5, 100),
    "focal_length": ("µm", "of the objective, from its maker; else it is estimated", 500, 1e6),
    "force": ("µN", "of the probe", 1e-3, 1e6),
    "force_std": ("µN", "standard deviation of the force, 0", 0, 1e6),
    "thickness": ("µm", "of the membrane", 0.005, 1e3),
    "thickness_std": ("µm", "standard deviation of the thickness, 0", 0, 1e3),
    "probe_half_width": ("µm", "of its end", 0.05, 1e4),
    "poisson": ("ratio", "of the membrane", -1, 0.5),
}


def add_scales(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add an option for each of these scales."""
    for name in names:
        unit, about = _SCALES[name][:2]
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, type=_quantity(unit), metavar=unit, help=about)


def _quantity(unit: str) -> Callable[[str], float]:
    """Return what reads a number, with or without a unit of its own, in `unit`."""

    def read(text: str) -> float:
        found = re.fullmatch(rf"(.*?)\s*(?:([nuµμmc]?){unit[1:]}(?:/px)?)?", text.strip())
        try:
            number = float(found[1].replace(",", ".")) if found else float("nan")
        except ValueError:
            number = float("nan")
        if found is None or not abs(number) < float("inf"):
            raise argparse.ArgumentTypeError(
                f"must be a number in {unit}, or with its unit, as 0.2m{unit[1:]}, got {text!r}"
            )
        return number if found[2] is None else number * _PREFIXES[found[2]]

    return read


def settle(
    path: object,
    given: Mapping[str, float | None],
    told: Mapping[str, float | None],
    say: Callable[[str], object],
) -> dict[str, float]:
    """Return each scale, as given or told by the file, and say which; ask for the missing.

    One that is not positive is refused, one that microscopy does not meet is noted.
    """
    values = {name: told.get(name) if value is None else value for name, value in given.items()}
    options = {name: f"--{name.replace('_', '-')}" for name in values}
    missing = [f"{options[name]} {_SCALES[name][0]}" for name in values if values[name] is None]
    if missing:
        raise ValueError(f"{path} does not tell its scale: give {', '.join(missing)}")
    settled = {name: float(value) for name, value in values.items() if value is not None}
    for name, value in settled.items():
        unit, _, low, high = _SCALES[name]
        if value <= 0 and name != "poisson" and not (name == "spacing" and value < 0):
            raise ValueError(f"{options[name]} must be positive, in {unit}, got {value:g}")
        say(f"{name} {value:g} {unit} ({'the file' if given[name] is None else 'given'})")
        if not low <= abs(value) <= high:
            warnings.warn(
                f"{options[name]} {value:g} {unit} is unusual under a microscope, which meets "
                f"{low:g} to {high:g} {unit}: is it in another unit? 0.2m{unit[1:]} may be given "
                "with it",
                stacklevel=2,
            )
    return settled
