"""The options of a depth, checked at one place for all that take them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from microlib._common import Image, Region, as_region, check_callable, flag, one_of, scalar, whole
from microlib.focus._measures import MEASURES, MOST, FocusMeasure, focus_measure
from microlib.focus._registration import check_size
from microlib.io import read_frames

#: What is told how many parts of the work are done, and of how many; an exception from it ends all.
Progress = Callable[[int, int], object]


@dataclass(frozen=True)
class Options:
    """The options of `depth_from_focus`, as they are used."""

    measure: str | FocusMeasure
    window: int
    step: int
    threshold: float
    points: int
    workers: int
    register: bool
    region: Region | None
    reduce: int
    progress: Progress | None

    def chosen(self) -> FocusMeasure:
        """Return the measure of one frame; not for "multiscale", which has several."""
        return focus_measure(self.measure, self.window, self.step, self.threshold)

    def check_frame(self, frame: Image) -> None:
        """Refuse what frames of this size cannot have, or a measure that fails on them."""
        for part in read_frames([frame], region=self.region, reduce=self.reduce):
            if self.register:
                check_size(part.shape)
            if self.measure != "multiscale":
                self.chosen()(part)


def check_options(
    *,
    blocks: bool = False,
    measure: str | FocusMeasure = "multiscale",
    window: int | None = None,
    step: int | None = None,
    threshold: float | None = None,
    points: int | None = None,
    workers: int = 1,
    register: bool = False,
    region: Region | None = None,
    reduce: int = 1,
    progress: Progress | None = None,
) -> Options:
    """Return the options of `depth_from_focus`, each refused if it is wrong or cannot be used.

    Parameters
    ----------
    blocks : bool
        Whether they are for a dask or zarr array.
    measure, window, step, threshold, points, workers, register, region, reduce, progress
        As for `depth_from_focus`.
    """
    own = callable(measure)
    name = "a function" if own else repr(one_of("measure", measure, tuple(MEASURES)))
    used = () if own else MEASURES[str(measure)]
    for key, value in {"window": window, "step": step, "threshold": threshold}.items():
        if value is not None and key not in used:
            raise ValueError(f"{key} must not be given with measure {name}, got {value!r}")
    check_callable("progress", progress, optional=True)
    usual = 7 if measure == "multiscale" else 3
    options = Options(
        measure,
        5 if window is None else whole("window", window, least=1, odd=True, most=MOST),
        1 if step is None else whole("step", step, least=1),
        0.0 if threshold is None else scalar("threshold", threshold, least=0),
        # More points take a gigabyte a megapixel; no machine has more processors.
        whole("points", usual if points is None else points, least=3, odd=True, most=255),
        whole("workers", workers, least=1, most=256),
        flag("register", register),
        None if region is None else as_region("region", region),
        whole("reduce", reduce, least=1),
        progress,
    )
    if blocks:
        plain = check_options(points=points, region=region)
        for key in (field.name for field in fields(Options)):
            if getattr(options, key) != getattr(plain, key):
                value = getattr(options, key)
                raise ValueError(f"{key} must not be given for a dask or zarr array, got {value!r}")
    return options
