"""Argument checks shared by the whole library: one wording for every refusal.

Each function returns the checked value, or raises ``ValueError`` that names the argument, says what
came and what is needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from microlib._common._types import Array

Bounds = tuple[float, float]


def as_array(
    name: str,
    value: ArrayLike,
    *,
    shape: tuple[int | None, ...] | None = None,
    dtype: DTypeLike = np.float64,
    finite: bool = True,
) -> NDArray:
    """Return `value` as an array of `dtype`; ``None`` in `shape` allows any length of that axis."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "buif":
            raise TypeError
        array = array.astype(dtype, copy=False)
    except (TypeError, ValueError):
        got = getattr(value, "dtype", type(value).__name__)
        raise ValueError(f"{name} must hold real numbers, got {got}") from None
    if shape is not None:
        fits = array.ndim == len(shape) and all(
            want is None or want == have for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
            raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
    if array.size == 0:
        raise ValueError(f"{name} must not be empty, got shape {array.shape}")
    if finite and not np.isfinite(array).all():
        bad = int(array.size - np.isfinite(array).sum())
        raise ValueError(f"{name} must be finite, got {bad} NaN or infinite of {array.size}")
    return array


def as_image(name: str, value: ArrayLike, *, smallest: int = 1) -> NDArray:
    """Return a grey image as a finite 2-D float32 array, each side at least `smallest` px."""
    image = as_array(name, value, dtype=np.float32)
    if image.ndim != 2:
        raise ValueError(f"{name} must be a grey image of two dimensions, got {image.ndim}")
    if min(image.shape) < smallest:
        raise ValueError(f"{name} must be at least {smallest} px on each side, got {image.shape}")
    return image


def between(name: str, value: ArrayLike, low: float, high: float, *, closed: bool = False) -> Array:
    """Return `value` as float64, all in (`low`, `high`), or [`low`, `high`] if `closed`."""
    array = as_array(name, value)
    inside = (array >= low) & (array <= high) if closed else (array > low) & (array < high)
    if not inside.all():
        brackets = "[]" if closed else "()"
        worst = array[~inside].flat[0]
        raise ValueError(
            f"{name} must lie in {brackets[0]}{low:g}, {high:g}{brackets[1]}, got {worst:g}"
        )
    return array


def positive(name: str, value: ArrayLike, *, zero: bool = False) -> Array:
    """Return `value` as float64 with every element above zero, or at least zero if `zero`."""
    array = as_array(name, value)
    bad = array < 0 if zero else array <= 0
    if bad.any():
        need = "zero or positive" if zero else "positive"
        raise ValueError(f"{name} must be {need}, got {array[bad].flat[0]:g}")
    return array


def whole(name: str, value: object, *, least: int, odd: bool = False) -> int:
    """Return `value` as an int of at least `least`; odd if `odd`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ValueError(f"{name} must be a whole number, got {value!r}")
    if value < least or (odd and value % 2 == 0):
        kind = "an odd whole number" if odd else "a whole number"
        raise ValueError(f"{name} must be {kind} of at least {least}, got {value}")
    return int(value)


def one_of(name: str, value: object, known: tuple[str, ...]) -> str:
    """Return `value` if it is one of the `known` names."""
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}, got {value!r}")
    return value


def same_length(names: tuple[str, str], first: NDArray, second: NDArray) -> None:
    """Refuse two arrays whose first axes differ in length."""
    if len(first) != len(second):
        raise ValueError(
            f"{names[0]} and {names[1]} must have the same length, "
            f"got {len(first)} and {len(second)}"
        )
