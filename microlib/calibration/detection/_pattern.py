"""Detection of a pattern of marks, in the same steps for all patterns.

1. Find marks in the grey image, and connect them to a lattice.
2. Fit the outline of each mark to the grey levels.
3. Remove the bias of the points under perspective and distortion.
4. Test that the points are the image of a lattice, and that the image shows the pattern.

A pattern is a subclass of `Pattern` in a file of its own, which answers what differs from one
pattern to the next.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS, Detection
from microlib.calibration.detection._grid_map import (
    MIDDLE,
    GridIndex,
    GridMap,
    check_residuals,
    fit_grid_map,
    map_centers,
)
from microlib.calibration.detection._image import CELL, GreyImage
from microlib.calibration.detection._lattice import (
    MarkLattice,
    fill,
    index_basis,
    search_lattices,
)
from microlib.calibration.detection._marks import Marks, Rows
from microlib.calibration.detection._outlines import BLUR, OutlineFit, smooth_parameters
from microlib.calibration.detection._settings import DetectionSettings
from microlib.calibration.detection._shapes import MarkPoints


@dataclass(frozen=True)
class FittedMarks(Rows):
    """Marks that lie in the image and are fitted as well as the others.

    Attributes
    ----------
    grid : ndarray of int, shape (n, 2)
        Coordinates in the lattice.
    points : ndarray, shape (n, k, 2)
        The k points of each mark, px.
    uncertainty : ndarray, shape (n, k)
        Standard deviation of a coordinate of each point, px.
    outlines : OutlineFit
        The n fitted outlines.
    """

    grid: GridIndex
    points: Array
    uncertainty: Array
    outlines: OutlineFit


class FittedLattice(NamedTuple):
    """Fitted marks with the map from the lattice to their points.

    Attributes
    ----------
    image : GreyImage
        Image in which the marks are dark.
    marks : FittedMarks
        The n marks.
    to_image : GridMap
        Map from coordinates in the lattice to the image, fitted to the points.
    positions : ndarray, shape (n, k, 2)
        Coordinates of the points in the lattice.
    """

    image: GreyImage
    marks: FittedMarks
    to_image: GridMap
    positions: Array


@dataclass(frozen=True)
class Pattern(ABC):
    """A kind of calibration pattern.

    Attributes
    ----------
    settings : DetectionSettings
        Settings of the detection.
    name : str
        Name of the pattern for users.
    shown : str
        What an image of the pattern must show, in messages.
    offsets : ndarray, shape (k, 2)
        Points of a mark relative to its coordinates in the lattice, in sides of the mark.
    smooth : tuple of int
        Parameters of the outlines that vary smoothly across the image.
    """

    settings: DetectionSettings
    name: ClassVar[str]
    shown: ClassVar[str]
    offsets: ClassVar[Array] = MIDDLE
    smooth: ClassVar[tuple[int, ...]] = ()

    @property
    def max_residual(self) -> float:
        """Largest rms deviation of points from a smooth image of the lattice, in pitches."""
        return self.settings.max_residual

    def search(self, image: GreyImage) -> Iterator[MarkLattice]:
        """Lattices of marks that may be the pattern, the most likely first."""
        return search_lattices(image, self.settings)

    @abstractmethod
    def fit(self, image: GreyImage, marks: Marks, steps: Array) -> OutlineFit:
        """Outlines fitted to the grey levels of the marks.

        `steps` are the derivatives of the image points by the coordinates of the lattice, (n, 2,
        2): one column each, px. Raises a ValueError if the marks have another shape.
        """

    @abstractmethod
    def locate(self, outlines: OutlineFit) -> MarkPoints:
        """Points of the outlines."""

    def bias(self, lattice: FittedLattice) -> Array:
        """Points minus the images of the points of the pattern, (n, k, 2), px."""
        return np.zeros_like(lattice.positions)

    def side(self, lattice: FittedLattice) -> float:
        """Side of the marks in pitches; NaN for marks without one."""
        return np.nan

    @abstractmethod
    def check(self, lattice: FittedLattice) -> None:
        """Raise an error if the image does not show the pattern."""


def find_pattern(image: GreyImage, patterns: Sequence[Pattern]) -> tuple[str, Detection]:
    """Detect the first of several patterns whose lattices are found by the same search.

    Returns
    -------
    name : str
        Name of the pattern.
    detection : Detection
        Its points.

    Raises
    ------
    ValueError
        If the image shows none. The message has the reason for each pattern.
    """
    faults: dict[str, str] = {}
    for lattice in _search(image, patterns[0]):
        for pattern in patterns:
            try:
                return pattern.name, _detect(pattern, lattice)
            except ValueError as fault:
                faults.setdefault(pattern.name, str(fault))  # that of the largest lattice
    shown = " or ".join(pattern.shown for pattern in patterns)
    raise ValueError(
        "; ".join(dict.fromkeys(faults.values())) or f"image must show {shown}, got none"
    )


def _search(image: GreyImage, pattern: Pattern) -> Iterator[MarkLattice]:
    """Lattices that may be the pattern; those of a large image are searched at reduced size.

    If there are many small marks at that size, or in the middle of the image at full size, some may
    be lost, and the image is searched at full size.
    """
    settings = pattern.settings
    factor = int(np.ceil(np.sqrt(image.grey.size / settings.max_pixels)))
    if factor == 1:
        yield from pattern.search(image)
        return
    reduced, dense = image.reduced(factor), False
    for lattice in pattern.search(reduced):
        small = np.sqrt(np.median(lattice.marks.areas)) < settings.min_reduced_side
        if small and len(lattice.grid) >= settings.many_marks:
            dense = True
        else:
            polarity = image if lattice.image is reduced else image.negative()
            yield lattice.enlarged(polarity, factor)
    middle = image.middle(4 * factor)
    if dense or any(len(each.grid) >= settings.many_marks for each in pattern.search(middle)):
        yield from pattern.search(image)


def _detect(pattern: Pattern, lattice: MarkLattice) -> Detection:
    """Fit the marks of a lattice, and test that they form the pattern."""
    image, shape = lattice.image, lattice.image.grey.shape
    fitted = _fit_marks(pattern, lattice)
    share = fill(fitted.grid)
    if share < pattern.settings.min_fill:
        raise ValueError(f"image must show {pattern.shown}, got {share:.0%} of them")
    basis = index_basis(fitted.points.mean(axis=1), fitted.grid)
    fitted = replace(fitted, grid=np.round(fitted.grid @ basis).astype(np.intp))
    fitted = fitted[np.lexsort(fitted.grid.T)]  # row by row, wherever the lattice was begun
    offsets = pattern.offsets @ basis
    while True:
        if len(fitted.grid) < MIN_MARKS:
            raise ValueError(f"image must show a plane grid, got {len(fitted.grid)} marks of one")
        biased = fit_grid_map(fitted.points, fitted.grid, offsets, shape)
        points = fitted.points - pattern.bias(FittedLattice(image, fitted, *biased))
        to_image, positions = fit_grid_map(points, fitted.grid, offsets, shape)
        test = check_residuals(
            points, positions, to_image, fitted.uncertainty, pattern.max_residual, pattern.settings
        )
        if test.kept.all():
            break
        fitted = fitted[test.kept]  # without the outliers, which bend the map
    # A homography maps any four points to any others, and clutter has many.
    if not (lattice.alone or np.isfinite(test.normalized_rms)):
        raise ValueError(
            f"image must show more {pattern.name} or nothing else, got {len(lattice.grid)}"
        )
    result = FittedLattice(image, fitted, to_image, positions)
    pattern.check(result)
    side = pattern.side(result)
    order = np.lexsort(offsets.T)  # the corners of a square row by row, too
    ends = (offsets[order] > 0).astype(np.intp)
    cells = fitted.grid[:, None] - fitted.grid.min(axis=0)
    ends_per_pitch = len(np.unique(ends[:, 0]))
    return Detection(
        points=points[:, order].reshape(-1, 2),
        grid=(ends_per_pitch * cells + ends).reshape(-1, 2),
        uncertainty=test.uncertainty[:, order].ravel(),
        group=np.repeat(np.arange(len(cells)), len(ends)),
        positions=(cells + np.where(ends, side, 0)).reshape(-1, 2),
        side=side,
        normalized_rms=test.normalized_rms,
        image_size=(shape[1], shape[0]),
    )


def _fit_marks(pattern: Pattern, lattice: MarkLattice) -> FittedMarks:
    """Fit the marks of a lattice; leave out those that are cut off or fit worse than others."""
    image, marks, grid, _ = lattice
    settings = pattern.settings
    to_image = map_centers(marks.centers, grid, image.grey.shape)
    if not to_image.scale(grid).min() > 1:
        raise ValueError(f"image must show {pattern.shown}, got marks that are on no plane grid")
    outlines = pattern.fit(image, marks, to_image.steps(grid))
    points, uncertainty, extent = pattern.locate(outlines)
    width, worst = np.sqrt(marks.areas), uncertainty.max(axis=1)
    inside = (points >= extent) & (points <= image.last_pixel - extent)
    moved = np.linalg.norm(points.mean(axis=1) - marks.centers, axis=1)
    good = inside.all(axis=(1, 2)) & np.isfinite(worst) & (moved < settings.max_shift * width)
    good &= np.abs(outlines.parameters[:, BLUR]) < settings.max_blur * width
    if good.any():
        good &= outlines.rms <= settings.max_rms_ratio * np.median(outlines.rms[good])
        typical = settings.max_uncertainty_ratio * np.median(worst[good])
        good &= worst <= np.minimum(typical, settings.max_uncertainty * width)
    if good.sum() < MIN_MARKS:
        raise ValueError(f"image must show {pattern.shown}, got {int(good.sum())} that fit")
    outlines = smooth_parameters(outlines[good], pattern.smooth, settings)
    points, uncertainty, _ = pattern.locate(outlines)
    return FittedMarks(grid=grid[good], points=points, uncertainty=uncertainty, outlines=outlines)


def check_surroundings(pattern: Pattern, lattice: FittedLattice, drawn: Array) -> None:
    """Raise an error if the image around the marks does not correlate with the drawn pattern.

    Other marks lie between the marks of a sublattice and on a chessboard. `drawn` is whether a mark
    covers each of the places `CELL`.
    """
    centers, steps = lattice.marks.points.mean(axis=1), lattice.to_image.steps(lattice.marks.grid)
    between = centers + steps.mean(axis=2)
    on_marks, between_marks = (
        float(np.median(lattice.image.correlation(at, steps, CELL, sign * drawn)))
        for at, sign in ((centers, 1), (between, -1))
    )
    # Blurred circles correlate less than the gaps between them.
    if on_marks < max(pattern.settings.min_correlation, between_marks):
        raise ValueError(
            f"image must show {pattern.name} apart from each other, got a correlation of "
            f"{on_marks:.2f} with such a pattern, and of {between_marks:.2f} between its marks"
        )
