"""Run a function for many arguments in parallel processes, with the results of a plain loop."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing.connection import wait
from typing import Any, TypeVar

from microlib.membrane import SmallSlopeWarning

T = TypeVar("T")

#: Processes at most: more would start for longer than the experiments here run.
MOST_PROCESSES = 4


def in_processes(function: Callable[..., T], arguments: Iterable[tuple]) -> list[T]:
    """Return ``[function(*each) for each in arguments]``, computed side by side.

    Parameters
    ----------
    function : callable
        Defined at the top of a module, so that another process can import it; draws its random
        numbers from its arguments alone.
    arguments : iterable of tuple
        Taken one by one while the first are computed already, so that a generator may prepare them.

    Returns
    -------
    list
        In the order of the arguments, the same to the last bit as those of the loop.

    Raises
    ------
    Exception
        What `function` raised for the first of the arguments that failed.

    Examples
    --------
    >>> from math import hypot
    >>> in_processes(hypot, [(3.0, 4.0), (5.0, 12.0)])
    [5.0, 13.0]
    """
    pending = [_pool().submit(function, *each) for each in arguments]
    return [each.result() for each in pending]


@cache
def _pool() -> ProcessPoolExecutor:
    # Spawned, since a kernel has threads, which a fork does not survive.
    return ProcessPoolExecutor(
        min(os.cpu_count() or 1, MOST_PROCESSES),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
    )


def _begin() -> None:
    """Be silent, and end with the parent even if it was killed."""
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    # Chapter 4 shows what the steep slopes of the thesis' dimples do to the model.
    warnings.simplefilter("ignore", SmallSlopeWarning)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent: Any = multiprocessing.parent_process()
    wait([parent.sentinel])
    os._exit(1)
