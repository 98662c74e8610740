"""Argument checks of the whole library.

Each function returns the checked value or raises an `ArgumentError` that names the argument, the
requirement and the value.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from operator import ge, gt, le, lt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from microlib._common._types import Array


class ArgumentError(ValueError):
    """A ``ValueError`` that keeps the name of the argument, for which commands print their option.

    Parameters
    ----------
    argument : str
        Name of the argument, such as "pixel_size" or "box width"; the message begins with it.
    problem : str
        The requirement and the value.
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
    **bounds: float | None,
) -> NDArray:
    """Return `value` as an array of `dtype`; ``None`` in `shape` allows any length of that axis.

    `bounds` are those of `check_bounds`, for every element.
    """
    reject_masks(name, value)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in ("buif" if array.ndim else "uif"):  # True is no quantity
            raise TypeError
        array = array.astype(dtype, copy=False)
    except (TypeError, ValueError):
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
    if finite and not (known := np.isfinite(array)).all():
        got = f"{np.sum(~known)} NaN or infinite of {array.size}" if array.ndim else f"{array[()]}"
        raise ArgumentError(name, f"must be finite, got {got}")
    if bounds:
        check_bounds(name, array.min(), array.max(), **bounds)
    return array


def check_bounds(
    name: str,
    smallest: float,
    largest: float,
    *,
    above: float | None = None,
    below: float | None = None,
    least: float | None = None,
    most: float | None = None,
) -> None:
    """Raise unless values from `smallest` to `largest` lie within the bounds."""
    checks = (
        (above, "above", smallest, gt),
        (least, "at least", smallest, ge),
        (below, "below", largest, lt),
        (most, "at most", largest, le),
    )
    for bound, words, value, holds in checks:
        if bound is not None and not holds(value, bound):
            special = {"above 0": "positive", "at least 0": "zero or positive"}
            need = f"{words} {bound:g}"
            raise ArgumentError(name, f"must be {special.get(need, need)}, got {value:g}")


def as_symmetric(name: str, value: ArrayLike, size: int, *, definite: bool = False) -> Array:
    """Return a covariance, or NaN where unknown; if `definite` every eigenvalue is above zero."""
    matrix = as_array(name, value, shape=(size, size), finite=definite)
    if np.isfinite(matrix).all():
        if np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
            raise ArgumentError(name, "must be symmetric")
        values = np.linalg.eigvalsh(matrix)
        if values[0] <= 0 if definite else values[0] < -1e-9 * values[-1]:
            kind = "definite" if definite else "semidefinite"
            raise ArgumentError(name, f"must be positive {kind}, got the eigenvalue {values[0]:g}")
    return matrix


def as_map(name: str, value: ArrayLike) -> Array:
    """Return a map of shape (rows, cols) whose values are finite, or NaN where unknown."""
    array = as_array(name, value, shape=(None, None), finite=False)
    if count := int(np.isinf(array).sum()):
        raise ArgumentError(name, f"must be finite or NaN, got {count} infinite")
    return array


def reject_masks(name: str, value: object) -> None:
    """Raise for a masked array, or a sequence of them."""
    parts = value if isinstance(value, (list, tuple)) else [value]
    if any(isinstance(part, np.ma.MaskedArray) for part in parts):
        raise ArgumentError(
            name, "must be without a mask: give its .filled(np.nan), or cut the values out"
        )


def as_scalar(name: str, value: object, **bounds: float | None) -> float:
    """Return one finite number within `bounds`."""
    if isinstance(value, (bool, np.bool_, Sequence)) or getattr(value, "ndim", None):
        raise ArgumentError(name, f"must be a single number, got {value!r:.80}")
    if type(value) is not float or not isfinite(value):
        value = float(as_array(name, value))  # type: ignore[arg-type]
    check_bounds(name, value, value, **bounds)
    return value


def positive_scalars(**values: object) -> list[float]:
    """Return single numbers, each above zero."""
    return [as_scalar(name, value, above=0) for name, value in values.items()]


def as_positive(name: str, value: ArrayLike) -> Array:
    """Return `value` as float64, every element above zero."""
    return as_array(name, value, above=0)


def as_integer(
    name: str, value: object, *, least: int, odd: bool = False, most: int | None = None
) -> int:
    """Return `value` as an int of at least `least` and at most `most`; odd if `odd`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ArgumentError(name, f"must be a whole number, got {value!r:.80}")
    number = int(value)
    check_bounds(name, number, number, least=least, most=most)
    if odd and number % 2 == 0:
        raise ArgumentError(name, f"must be odd, got {number}")
    return number


def as_generator(name: str, value: object) -> np.random.Generator:
    """Return a random generator, given as such or by its seed."""
    if isinstance(value, np.random.Generator):
        return value
    return np.random.default_rng(as_integer(name, value, least=0))


def as_tuple(name: str, value: object, count: int) -> tuple[object, ...]:
    """Return the `count` items of a sequence or one-dimensional array."""
    reject_masks(name, value)
    sequence = isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes))
    if not sequence or getattr(value, "ndim", 1) != 1 or len(value) != count:  # type: ignore[arg-type]
        raise ArgumentError(name, f"must be {count} numbers, got {value!r:.80}")
    return tuple(value)  # type: ignore[arg-type]


def as_choice(name: str, value: object, known: tuple[str, ...]) -> str:
    """Return `value` if it is one of the `known` names."""
    if not isinstance(value, str) or value not in known:
        raise ArgumentError(name, f"must be one of {', '.join(known)}, got {value!r:.80}")
    return value


def as_instance(name: str, value: object, kind: Any) -> Any:
    """Return `value` if it is of the `kind`, which may be ``Callable``."""
    if not isinstance(value, kind):
        raise ArgumentError(name, f"must be of type {kind.__name__}, got {value!r:.80}")
    return value


def check_same_length(names: tuple[str, ...], first: NDArray, second: NDArray) -> None:
    """Raise for two arrays whose first axes differ in length."""
    if len(first) != len(second):
        problem = f"and {names[1]} must have the same length, got {len(first)} and {len(second)}"
        raise ArgumentError(names[0], problem)
