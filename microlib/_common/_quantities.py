"""Units of length, and checks of physical quantities."""

from __future__ import annotations

from microlib._common._checks import ArgumentError, as_scalar

#: Units of length in OME and ImageJ metadata, in µm: not "pixel", and not "inch", the unit of a
#: printer's resolution.
MICROMETERS = {
    **dict.fromkeys(("nm", "nanometer", "nanometre"), 1e-3),
    **dict.fromkeys(("µm", "μm", "um", "\\u00b5m", "micron", "microns", "micrometer"), 1.0),
    **dict.fromkeys(("micrometre", "micrometers", "micrometres"), 1.0),
    **dict.fromkeys(("mm", "millimeter", "millimetre"), 1e3),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
    **dict.fromkeys(("m", "meter", "metre"), 1e6),
}
#: Unit, smallest and largest value of quantities under a microscope. The ranges are so wide that
#: only a value in another unit is outside.
PHYSICAL_RANGES = {
    "spacing": ("µm", 0.02, 1e4),
    "pixel_size": ("µm/px", 0.02, 2e3),
    "pitch": ("µm", 0.1, 1e6),
    "pitch_y": ("µm", 0.1, 1e6),
    "division": ("µm", 0.1, 1e4),
    "pixel_pitch": ("µm", 0.3, 200.0),
    "focal_length": ("µm", 500.0, 1e6),
    "magnification": ("", 1e-4, 1e3),
    "force": ("µN", 1e-3, 1e6),
    "thickness": ("µm", 5e-3, 1e4),
    "probe_half_width": ("µm", 5e-3, 1e4),
    "modulus": ("MPa", 1e-5, 2e5),
}
#: Prefixes of a unit, relative to the micro-units of the library.
PREFIXES = {"n": 1e-3, "u": 1.0, "µ": 1.0, "μ": 1.0, "m": 1e3, "c": 1e4, "": 1e6}


def as_physical(name: str, value: object, *, signed: bool = False) -> float:
    """Return a quantity in micro-units; raise outside the range of experiments.

    A force of 150e-6, which is in N, is rejected as a force in µN. The error names the units that
    would make the number possible.
    """
    number = as_scalar(name, value, above=None if signed else 0)
    unit, low, high = PHYSICAL_RANGES[name]
    if not low <= abs(number) <= high:
        need = f"must be between {low:g} and {high:g} {unit} in any experiment, got {number:g}"
        meant = [
            f"{number:g}{prefix}{unit[1:]}"
            for prefix in ("n", "m", "")
            if unit[:1] == "µ" and low <= abs(number) * PREFIXES[prefix] <= high
        ]
        raise ArgumentError(name, need + f": did you mean {' or '.join(meant)}?" * bool(meant))
    return number


def as_poisson_ratio(ratio: object) -> float:
    """Return the Poisson ratio of an isotropic material."""
    return as_scalar("poisson_ratio", ratio, above=-1, most=0.5)
