"""How the inner loops are compiled.

They hold no lock of the interpreter, so that threads work side by side, and are kept on disk. Two
functions of one name in a module would take each other's place there: each has a name of its own.
What is kept goes by the text of the function's file: after a change here it is to be deleted.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

__all__ = ["compiled", "summing"]

_LOG = logging.getLogger("microlib.focus")


class _Teller(event.Listener):
    """Says once in a process that there is something to compile, and not only to load."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Any) -> None:
        module = getattr(event.data.get("dispatcher"), "__module__", "")
        if not self._told and module.startswith("microlib."):
            self._told = True
            _LOG.info("compiling the inner loops of shape from focus, once on this machine")

    def on_end(self, event: Any) -> None:
        """Nothing is said at the end."""


event.register("numba:compile", _Teller())


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
