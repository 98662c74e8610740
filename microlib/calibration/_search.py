"""Where the detectors look for marks: first as in a clean image, then in clutter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_array, as_image, items, whole
from microlib.calibration._complete import complete
from microlib.calibration._contours import find_marks
from microlib.calibration._dark_regions import DarkRegions, find_dark_regions
from microlib.calibration._detection import Detection
from microlib.calibration._grid_order import order_grid
from microlib.calibration._grow import grow_lattices
from microlib.calibration._lattice_form import LEAST_FULL, fill

#: From regions, those of a lattice, and their integer coordinates to a detection, or a refusal.
Assemble = Callable[[DarkRegions, NDArray[np.intp], NDArray[np.intp]], Detection]
#: Smallest image in which four marks can be seen, px.
_SMALLEST = 16
#: Luminance of red, green and blue, as frames that are read as grey have it.
_LUMINANCE = (0.299, 0.587, 0.114)
#: If a lattice holds this part of the dark regions of an image, the image shows it and nothing
#: else.
_NOTHING_ELSE = 0.7
#: Another piece is looked at only if it has more marks than this part of those found.
_LARGER = 0.9
#: Pieces of lattice in clutter that are looked at, the largest first.
_PIECES = 3


def search(
    image: ArrayLike,
    assemble: Assemble,
    marks: str,
    *,
    lattice: str = "square",
    region: tuple[int, int, int, int] | None = None,
) -> Detection:
    """Find the largest lattice of an image that `assemble` accepts.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels, or red, green and blue.
    assemble : callable
        Fits the marks and tests them; raises ValueError for what is no pattern.
    marks : str
        What the lattice is of, for refusals.
    lattice : str
        One of `LATTICES`.
    region : tuple of int, optional
        (x, y, width, height) of the part to look at, px.

    Returns
    -------
    Detection

    Raises
    ------
    ValueError
        If nothing is accepted: what was wrong with the largest lattice, or why there was none.
    """
    grey, corner = crop(to_grey(image), region)
    refusals: list[tuple[int, ValueError]] = []
    best = None
    for regions, index, grid in _candidates(grey, marks, lattice, refusals):
        if best is not None and _LARGER * len(index) <= len(np.unique(best.group)):
            continue
        on_lattice = len(index) / len(regions.centers)
        try:
            found = assemble(*complete(regions, index, grid))
        except ValueError as refusal:
            refusals.append((len(index), refusal))
            continue
        if best is None or len(found.points) > len(best.points):
            best = found
        if on_lattice >= _NOTHING_ELSE:
            break
    if best is None:
        raise max(refusals, key=lambda each: each[0])[1]
    return replace(best, points=best.points + corner)


def _candidates(
    grey: NDArray[np.float32], marks: str, lattice: str, refusals: list[tuple[int, ValueError]]
) -> Iterator[tuple[DarkRegions, NDArray[np.intp], NDArray[np.intp]]]:
    """Regions with a lattice among them: of the image as if it showed nothing else, then of the
    largest pieces in clutter."""
    try:
        regions = find_dark_regions(grey)
        yield regions, *order_grid(regions.centers)
    except ValueError as refusal:
        refusals.append((0, ValueError(f"image must show a grid of {marks}: {refusal}")))
    pieces = [
        (regions, *piece)
        for regions in find_marks(grey)
        for piece in grow_lattices(regions, lattice)
        if fill(piece[1]) > LEAST_FULL
    ]
    yield from sorted(pieces, key=lambda piece: -len(piece[1]))[:_PIECES]


def to_grey(image: ArrayLike) -> NDArray[np.float32]:
    array = as_array("image", image, dtype=np.float32)
    if array.ndim == 3 and array.shape[2] in (3, 4):
        array = array[..., :3] @ np.array(_LUMINANCE, dtype=np.float32)
    return np.ascontiguousarray(as_image("image", array, smallest=_SMALLEST))


def crop(
    grey: NDArray[np.float32], region: tuple[int, int, int, int] | None
) -> tuple[NDArray[np.float32], NDArray]:
    """The part of the image to look at, and its first pixel (x, y)."""
    if region is None:
        return grey, np.zeros(2)
    x, y, width, height = (
        whole("region", n, least=least)
        for n, least in zip(items("region", region, 4), (0, 0, _SMALLEST, _SMALLEST), strict=True)
    )
    if x + width > grey.shape[1] or y + height > grey.shape[0]:
        raise ValueError(
            f"region must lie in the image of {grey.shape[1]}×{grey.shape[0]} px, got {region}"
        )
    return np.ascontiguousarray(grey[y : y + height, x : x + width]), np.array([x, y], float)
