"""Grids of squares."""

from __future__ import annotations

import numpy as np

from microlib._common import Array
from microlib.calibration.detection._image import CELL, GreyImage
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._outlines import BLUR, CONTRAST, SLOPES, OutlineFit
from microlib.calibration.detection._pattern import FittedLattice, Pattern, check_surroundings
from microlib.calibration.detection._shapes import (
    CORNERS,
    MarkPoints,
    are_round,
    fit_quads,
    line_crossings,
)


class Squares(Pattern):
    """Squares with gaps between them, darker or brighter than their background."""

    name = "squares"
    shown = "a grid of whole squares"
    offsets = CORNERS
    smooth = (0, 1, 2, 3, BLUR, CONTRAST, *SLOPES)  # the directions of the sides, too

    def fit(self, image: GreyImage, marks: Marks, steps: Array) -> OutlineFit:
        if are_round(image, marks, steps, self.settings):
            raise ValueError("image must show squares, got circles")
        return fit_quads(image, marks, steps, self.settings)

    def locate(self, outlines: OutlineFit) -> MarkPoints:
        return line_crossings(outlines)

    def bias(self, lattice: FittedLattice) -> Array:
        """Crossings of straight lines through the distorted sides minus the images of the
        corners, px."""
        to_image, positions = lattice.to_image, lattice.positions
        ends = np.roll(positions, -1, axis=1)
        first, last = to_image(positions), to_image(ends)
        along = (last - first) / np.linalg.norm(last - first, axis=-1, keepdims=True)
        bend = to_image((positions + ends) / 2) - (first + last) / 2
        bend -= (bend * along).sum(axis=-1, keepdims=True) * along
        # The mean of a parabola is two thirds of its height. Near a right angle, the line of one
        # side moves the corner along the other side.
        return np.asarray(2 / 3 * (bend + np.roll(bend, 1, axis=1)))

    def side(self, lattice: FittedLattice) -> float:
        return float(np.ptp(lattice.positions[0], axis=0).mean())

    def check(self, lattice: FittedLattice) -> None:
        """Raise an error if the sides of the marks differ or leave no gap."""
        width, height = sides = np.ptp(lattice.positions[0], axis=0)
        if np.ptp(sides) > self.settings.max_skew * sides.min() or sides.max() >= 1:
            raise ValueError(
                f"image must show squares, got rectangles of {width:.3g} × {height:.3g}"
            )
        check_surroundings(self, lattice, np.abs(CELL).max(axis=1) < self.side(lattice) / 2)
