"""Grids of circles."""

from __future__ import annotations

import numpy as np

from microlib._common import Array
from microlib.calibration.detection._image import CELL, GreyImage
from microlib.calibration.detection._lattice import lattice_metric
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._outlines import BLUR, CONTRAST, SLOPES, OutlineFit
from microlib.calibration.detection._pattern import FittedLattice, Pattern, check_surroundings
from microlib.calibration.detection._shapes import (
    MarkPoints,
    are_round,
    ellipse_centers,
    ellipse_matrices,
    fit_ellipses,
)


class Circles(Pattern):
    """Circles on a square lattice, darker or brighter than their background."""

    name = "circles"
    shown = "a grid of whole circles"
    smooth = (BLUR, CONTRAST, *SLOPES)

    def fit(self, image: GreyImage, marks: Marks, steps: Array) -> OutlineFit:
        if not are_round(image, marks, steps, self.settings):
            raise ValueError("image must show circles, got squares")
        return fit_ellipses(image, marks, self.settings)

    def locate(self, outlines: OutlineFit) -> MarkPoints:
        return ellipse_centers(outlines)

    def bias(self, lattice: FittedLattice) -> Array:
        """Center of the image of each circle minus the image of its center, px."""
        to_image, positions = lattice.to_image, lattice.positions
        # The mean of a cubic polynomial over a disc is its mean over these four points.
        ring = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]) / np.sqrt(2)
        within = positions + _radius(lattice) * ring
        weight = to_image.scale(within)[..., None]
        center = (weight * to_image(within)).sum(axis=1) / weight.sum(axis=1)
        return center[:, None] - to_image(positions)

    def check(self, lattice: FittedLattice) -> None:
        """Raise an error if the circles differ in shape, or lie on another lattice than a square
        one, or are not apart from each other."""
        ellipses = ellipse_matrices(lattice.marks.outlines)
        steps = lattice.to_image.steps(lattice.marks.grid)
        metric, scatter = lattice_metric(ellipses @ ellipses, steps)
        if scatter > self.settings.max_shape_scatter:
            raise ValueError(f"image must show marks of one shape, got a scatter of {scatter:.0%}")
        (a, b), (_, c) = np.linalg.inv(metric)  # the inner products of the steps, up to a factor
        ratio, cosine = np.sqrt(max(a, c) / min(a, c)), b / np.sqrt(a * c)
        if max(ratio - 1, abs(cosine)) > self.settings.max_skew:
            raise ValueError(
                f"image must show circles on a square lattice, got steps of 1 : {ratio:.2f} at "
                f"{np.rad2deg(np.arccos(cosine)):.0f}°"
            )
        check_surroundings(self, lattice, np.hypot(*CELL.T) < _radius(lattice))


def _radius(lattice: FittedLattice) -> float:
    """Median radius of the circles, in pitches."""
    areas = np.abs(np.linalg.det(ellipse_matrices(lattice.marks.outlines)))
    return float(np.sqrt(np.median(areas / lattice.to_image.scale(lattice.marks.grid))))
