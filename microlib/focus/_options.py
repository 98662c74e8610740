"""The options of a depth, checked at one place for all that take them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from microlib._common import Image, Region, as_region, check_callable, flag, one_of, whole
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

    measure: str | FocusMeasure = "multiscale"
    window: int = 5
    workers: int = 1
    register: bool = False
    region: Region | None = None
    reduce: int = 1
    progress: Progress = silent

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


def check_options(**options: Any) -> Options:
    """Return the options of `depth_from_focus`, each refused if it is wrong or cannot be used."""
    measure = options.get("measure", "multiscale")
    own = callable(measure)
    name = "a function" if own else repr(one_of("measure", measure, ("multiscale", *MEASURES)))
    if options.get("window") is not None and (own or measure == "multiscale"):
        raise ValueError(f"window must not be given with measure {name}, got {options['window']!r}")
    check_callable("progress", options.get("progress"), optional=True)
    usual = {"window": 5, "progress": silent}
    absent = {key: value for key, value in usual.items() if options.get(key) is None}
    given = Options(**options | absent)
    return replace(
        given,
        window=whole("window", given.window, least=1, odd=True, most=MOST),
        workers=whole("workers", given.workers, least=1, most=256),  # no machine has more
        register=flag("register", given.register),
        region=None if given.region is None else as_region("region", given.region),
        reduce=whole("reduce", given.reduce, least=1),
    )


def check_count(got: int | str, count: int) -> None:
    """Refuse frames that are not as many as their positions."""
    if got != count:
        raise ValueError(f"frames and positions must be as many, got {got} and {count}")
