"""How the inner loops are compiled.

They hold no lock of the interpreter, so that threads work side by side, and are kept on disk. Two
functions of one name in a module would take each other's place there: each has a name of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

__all__ = ["compiled", "summing"]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function when it is first called; every number is rounded as it is written.

    A product that is added without rounding would save nothing, as loops wait for memory, and make
    a pixel depend on its place in a loop.
    """
    return _compiled(function, set())


def summing(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, and sums may be made in any order, several numbers at a time."""
    return _compiled(function, {"reassoc", "nsz"})


def _compiled(function: Callable[..., Any], freedom: set[str]) -> Callable[..., Any]:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": freedom}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder may be written to: compile again in every process
        return numba.njit(**options)(function)
