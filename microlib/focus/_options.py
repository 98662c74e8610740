"""The options of a depth, checked at one place for all that take them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from microlib._common import (
    Image,
    Region,
    as_region,
    flag,
    of_kind,
    one_of,
    whole,
)
from microlib.focus._measures import MEASURES, MOST, FocusMeasure, own_measure
from microlib.focus._registration import check_size
from microlib.io import read_frames

#: What is told how many parts of the work are done, and of how many; an exception from it ends all.
Progress = Callable[[int, int], object]


def silent(done: int, count: int) -> None:
    """Tell nobody how far the work is."""


@dataclass(frozen=True)
class Options:
    """The options of `depth_from_focus`, as they are used."""

    measure: str | FocusMeasure
    window: int
    workers: int
    register: bool
    region: Region | None
    reduce: int
    progress: Progress

    def focus_measure(self) -> FocusMeasure:
        """Return the measure of one frame; not for "multiscale", which has several."""
        if callable(self.measure):
            return partial(own_measure, self.measure)
        return partial(MEASURES[self.measure], window=self.window)

    def check_frame(self, frame: Image) -> None:
        """Refuse what frames of this size cannot have, or a measure that fails on them."""
        for part in read_frames([frame], region=self.region, reduce=self.reduce):
            if self.register:
                check_size(part.shape)
            if self.measure != "multiscale":
                self.focus_measure()(part)


def check_options(
    measure: Any = "multiscale",
    window: Any = None,
    workers: Any = 1,
    register: Any = False,
    region: Any = None,
    reduce: Any = 1,
    progress: Any = None,
) -> Options:
    """Return the options of `depth_from_focus`, each refused if it is wrong or cannot be used."""
    own = callable(measure)
    name = "a function" if own else repr(one_of("measure", measure, ("multiscale", *MEASURES)))
    if window is not None and (own or measure == "multiscale"):
        raise ValueError(f"window must not be given with measure {name}, got {window!r}")
    of_kind("progress", progress, Callable, type(None))
    return Options(
        measure,
        5 if window is None else whole("window", window, least=1, odd=True, most=MOST),
        whole("workers", workers, least=1, most=256),  # no machine has more
        flag("register", register),
        None if region is None else as_region("region", region),
        whole("reduce", reduce, least=1),
        silent if progress is None else progress,
    )


def check_count(got: int | str, count: int) -> None:
    """Refuse frames that are not as many as their positions."""
    if got != count:
        raise ValueError(f"frames and positions must be as many, got {got} and {count}")
