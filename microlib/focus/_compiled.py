"""How the inner loops are compiled.

They hold no lock of the interpreter, so that threads work side by side, and are kept on disk. Two
functions of one name in a module would take each other's place there: each has a name of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

__all__ = ["compiled"]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function when it is first called; a product may be added without rounding."""
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder may be written to: compile again in every process
        return numba.njit(**options)(function)
