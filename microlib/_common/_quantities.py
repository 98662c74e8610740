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
#: Ranges of quantities under a light microscope, wide enough that only a wrong unit is outside.
PHYSICAL_RANGES = {
    "µN": (1e-3, 1e6),
    "µm": (5e-3, 1e6),
    "µm/px": (0.02, 100.0),
    "MPa": (1e-5, 2e5),
}


def as_physical(name: str, value: object, unit: str) -> float:
    """Return a force, a length or a modulus in `unit`; raise outside the range of experiments.

    A force of 150e-6, which is in N, is rejected as a force in µN.
    """
    number = as_scalar(name, value, above=0)
    low, high = PHYSICAL_RANGES[unit]
    if not low <= number <= high:
        need = f"must be in {unit}, between {low:g} and {high:g} in any experiment"
        raise ArgumentError(name, f"{need}, got {number:g}")
    return number


def as_poisson_ratio(ratio: object) -> float:
    """Return the Poisson ratio of an isotropic material."""
    return as_scalar("poisson_ratio", ratio, above=-1, most=0.5)
