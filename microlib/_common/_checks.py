"""Argument checks shared by the whole library: one wording for every refusal.

Each function returns the checked value, or raises `ArgumentError`, which names the argument, says
what came and what is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from microlib._common._types import Array, Region

Bounds = tuple[float, float]

#: No length, force, time or coordinate of any unit comes near these: beyond, squares and quotients
#: leave the range of floating point and answers become infinite or NaN.
LARGEST, LEAST = 1e60, 1e-60
#: Grey levels are squared, summed and multiplied in single precision; 32-bit levels lie below.
LARGEST_GREY = 1e10
#: What is measured under a light microscope lies between these; in another unit it does not.
MEASURED = {
    "µN": (1e-3, 1e6),
    "µm": (5e-3, 1e6),
    "µm/px": (0.02, 100.0),
    "MPa": (1e-5, 2e5),
}


class ArgumentError(ValueError):
    """A ``ValueError`` that keeps the name of the argument: the command prints its option instead.

    Parameters
    ----------
    argument : str
        Name of the argument, such as "pixel_size" or "box width"; the message begins with it.
    problem : str
        What is needed, and what came.
    """

    def __init__(self, argument: str, problem: str) -> None:
        super().__init__(argument, problem)  # both, so that it can be pickled
        self.argument, self.problem = argument, problem

    def __str__(self) -> str:
        return f"{self.argument} {self.problem}"


def as_array(
    name: str,
    value: ArrayLike,
    *,
    shape: tuple[int | None, ...] | None = None,
    dtype: DTypeLike = np.float64,
    finite: bool = True,
    largest: float | None = None,
) -> NDArray:
    """Return `value` as an array of `dtype`; ``None`` in `shape` allows any length of that axis.

    Masks are refused, and numbers beyond ±`largest`, by default what the precision bears.
    """
    refuse_masks(name, value)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "buif":
            raise TypeError
        if array.dtype != dtype:
            with np.errstate(over="ignore"):  # what overflows is infinite, and told below
                array = array.astype(dtype)
    except (TypeError, ValueError, OverflowError):
        got = getattr(value, "dtype", type(value).__name__)
        raise ArgumentError(name, f"must hold real numbers, got {got}") from None
    if shape is not None and (
        array.ndim != len(shape)
        or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True))
    ):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ArgumentError(name, f"must have shape ({wanted}), got {array.shape}")
    if array.size == 0:
        raise ArgumentError(name, f"must not be empty, got shape {array.shape}")
    if array.dtype.kind == "f":
        if largest is None:
            # Single precision ends at 3e38.
            largest = LARGEST if array.dtype == np.float64 else 1e18
        # One pass without a copy tells that all are finite and small; else a closer look must.
        if not float(np.vdot(array, array)) <= largest**2:
            known = array[np.isfinite(array)]
            if finite and (bad := array.size - known.size):
                got = f"{bad} NaN or infinite of {array.size}" if array.ndim else f"{array[()]}"
                raise ArgumentError(name, f"must be finite, got {got}")
            if known.size and abs(worst := max(known.min(), known.max(), key=abs)) > largest:
                raise ArgumentError(name, f"must lie within ±{largest:g}, got {worst:g}")
    return array


def as_map(name: str, value: ArrayLike, *, largest: float | None = None) -> Array:
    """Return a map, shape (rows, cols), whose values are finite, or NaN where they are unknown."""
    array = as_array(name, value, shape=(None, None), finite=False, largest=largest)
    if count := int(np.isinf(array).sum()):
        raise ArgumentError(name, f"must be finite or NaN, got {count} infinite")
    return array


def refuse_masks(name: str, value: object) -> None:
    """Refuse a masked array, or a sequence of them."""
    parts = value if isinstance(value, (list, tuple)) else [value]
    if any(isinstance(part, np.ma.MaskedArray) for part in parts):
        raise ArgumentError(name, "must be without a mask: cut the masked values out")


def as_image(name: str, value: ArrayLike, *, smallest: int = 1) -> NDArray:
    """Return a grey image as a finite 2-D float32 array, each side at least `smallest` px."""
    image = as_array(name, value, dtype=np.float32, largest=LARGEST_GREY)
    if image.ndim != 2:
        raise ArgumentError(name, f"must be a grey image of two dimensions, got {image.ndim}")
    if min(image.shape) < smallest:
        raise ArgumentError(name, f"must be at least {smallest} px on each side, got {image.shape}")
    return image


def luminance(name: str, value: ArrayLike) -> NDArray:
    """Return an image as it is, or the luminance of one in color as float32."""
    import cv2  # here, as formulas do without it

    image = value if type(value) is np.ndarray else as_array(name, value)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        color = np.ascontiguousarray(as_array(name, image, dtype=np.float32)[..., :3])
        image = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    return image


def _brief(value: object) -> str:
    try:
        return repr(value)[:80]
    except ValueError:  # an integer of too many digits to print
        return "a huge number"


def scalar(
    name: str,
    value: object,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    within: Bounds | None = None,
    closed: bool = False,
) -> float:
    """Return one finite number as a float; not a list of one, a truth value or text.

    It must exceed `above`, be at least `least` and at most `most`, and lie `within` the open
    interval, or the closed one if `closed`.
    """
    number = value
    if type(number) is not float or not abs(number) <= LARGEST:
        if isinstance(value, (bool, np.bool_, Sequence)) or getattr(value, "ndim", None):
            raise ArgumentError(name, f"must be a single number, got {_brief(value)}")
        number = float(as_array(name, value))  # type: ignore[arg-type]
    need = None
    if above is not None and not number > above:
        need = "positive" if above == 0 else f"above {above:g}"
    elif above == 0 and number < LEAST:
        need = f"at least {LEAST:g}"
    elif least is not None and not number >= least:
        need = "zero or positive" if least == 0 else f"at least {least:g}"
    elif most is not None and not number <= most:
        need = f"at most {most:g}"
    if need:
        raise ArgumentError(name, f"must be {need}, got {number:g}")
    if within is not None:
        between(name, number, *within, closed=closed)
    return number


def measured(name: str, value: object, unit: str) -> float:
    """Return a force, a length or a modulus, in `unit`; refuse what no experiment can have.

    So 150e-6, a force in N, is no force in µN. For what a user types; formulas take any number.
    """
    number = scalar(name, value, above=0)
    low, high = MEASURED[unit]
    if not low <= number <= high:
        raise ArgumentError(
            name,
            f"must be in {unit}, between {low:g} and {high:g} in any experiment, got {number:g}",
        )
    return number


def poisson(ratio: object) -> float:
    """Return the Poisson ratio of an isotropic material."""
    number = scalar("poisson_ratio", ratio)
    if not -1 < number <= 0.5:
        raise ArgumentError("poisson_ratio", f"must lie in (-1, 0.5], got {number:g}")
    return number


def between(name: str, value: ArrayLike, low: float, high: float, *, closed: bool = False) -> Array:
    """Return `value` as float64, all in (`low`, `high`), or [`low`, `high`] if `closed`."""
    array = as_array(name, value)
    inside = (array >= low) & (array <= high) if closed else (array > low) & (array < high)
    if not inside.all():
        interval = f"[{low:g}, {high:g}]" if closed else f"({low:g}, {high:g})"
        raise ArgumentError(name, f"must lie in {interval}, got {array[~inside].flat[0]:g}")
    return array


def positive(name: str, value: ArrayLike, *, zero: bool = False) -> Array:
    """Return `value` as float64 with every element above zero, or at least zero if `zero`."""
    array = as_array(name, value)
    scalar(name, float(array.min()), above=None if zero else 0, least=0)
    return array


def whole(name: str, value: object, *, least: int, odd: bool = False, most: int = 1 << 31) -> int:
    """Return `value` as an int of at least `least` and at most `most`; odd if `odd`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ArgumentError(name, f"must be a whole number, got {_brief(value)}")
    if value < least or (odd and value % 2 == 0):
        kind = "an odd whole number" if odd else "a whole number"
        raise ArgumentError(name, f"must be {kind} of at least {least}, got {value}")
    if value > most:
        raise ArgumentError(name, f"must be at most {most}, got a larger one")
    return int(value)


def of_kind(name: str, value: object, *kinds: Any) -> None:
    """Refuse what is not an instance of one of `kinds`."""
    if not isinstance(value, kinds):
        known = " or ".join(kind.__name__ for kind in kinds)
        raise ArgumentError(name, f"must be of the kind {known}, got {type(value).__name__}")


def flag(name: str, value: object) -> bool:
    """Return `value` if it is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(name, f"must be True or False, got {_brief(value)}")
    return bool(value)


def check_callable(name: str, value: object, *, optional: bool = False) -> None:
    """Refuse what cannot be called; nothing at all is as good if `optional`."""
    if not callable(value) and not (optional and value is None):
        raise ArgumentError(name, f"must be callable, got {type(value).__name__}")


def generator(name: str, value: object) -> np.random.Generator:
    """Return a generator as it is, or the one of a seed: a whole number of at least zero."""
    if isinstance(value, np.random.Generator):
        return value
    need = f"{name} (a numpy.random.Generator or a seed)"
    return np.random.default_rng(whole(need, value, least=0, most=1 << 128))


def items(name: str, value: object, count: int) -> tuple[object, ...]:
    """Return the `count` members of a sequence or array that is no text and has no mask."""
    text = isinstance(value, (str, bytes, np.ma.MaskedArray))
    if text or not isinstance(value, (Sequence, np.ndarray)) or getattr(value, "ndim", 1) != 1:
        raise ArgumentError(name, f"must be {count} numbers, got {_brief(value)}")
    if len(value) != count:
        raise ArgumentError(name, f"must be {count} numbers, got {len(value)}")
    return tuple(value)


def as_region(
    name: str, value: object, shape: tuple[int, ...] | None = None, *, least: int = 1
) -> Region:
    """Return (x, y, width, height) of a part, each side at least `least` px, of an image."""
    four = items(f"{name} (x, y, width, height)", value, 4)
    sides = zip(("x", "y", "width", "height"), four, (0, 0, least, least), strict=True)
    x, y, width, height = (whole(f"{name} {side}", n, least=low) for side, n, low in sides)
    if shape is not None and (y + height > shape[0] or x + width > shape[1]):
        size = f"{shape[1]}×{shape[0]} px"
        raise ArgumentError(name, f"must lie in the image of {size}, got {four}")
    return x, y, width, height


def image_shape(name: str, value: object, *, least: int = 1) -> tuple[int, int]:
    """Return (rows, columns) of an image to make, each at least `least`, as of a sensor."""
    side, area = 1 << 16, 1 << 28
    rows, columns = (whole(name, n, least=least) for n in items(name, value, 2))
    if max(rows, columns) > side or rows * columns > area:
        need = f"{name} must be at most {side} px a side and {area} px in all"
        raise ValueError(f"{need}, got {rows}×{columns}")
    return rows, columns


def one_of(name: str, value: object, known: tuple[str, ...]) -> str:
    """Return `value` if it is one of the `known` names."""
    if not isinstance(value, str) or value not in known:
        raise ArgumentError(name, f"must be one of {', '.join(known)}, got {_brief(value)}")
    return value


def same_length(names: tuple[str, ...], first: NDArray, second: NDArray) -> None:
    """Refuse two arrays whose first axes differ in length."""
    if len(first) != len(second):
        raise ValueError(
            f"{names[0]} and {names[1]} must have the same length, "
            f"got {len(first)} and {len(second)}"
        )
