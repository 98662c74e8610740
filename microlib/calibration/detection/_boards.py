"""Inner corners of chessboards and ChArUco boards: saddle points of the grey levels.

Two dark and two bright fields meet at a corner. The smoothed image has a saddle point there, whose
second derivative is zero along the two edges. From one corner to the next along an edge, dark and
bright fields are exchanged and the second derivatives change their sign. A lattice that is grown by
this rule skips no row.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS
from microlib.calibration.detection._grid_map import GridIndex, map_centers
from microlib.calibration.detection._image import CELL, GreyImage
from microlib.calibration.detection._lattice import MarkLattice, fill, grow_pieces, neighbors
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._outlines import OutlineFit
from microlib.calibration.detection._pattern import FittedLattice, Pattern
from microlib.calibration.detection._settings import DetectionSettings
from microlib.calibration.detection._shapes import MarkPoints, fit_crossings, line_crossings


class Chessboard(Pattern):
    """Inner corners of a chessboard.

    Attributes
    ----------
    markers : bool
        Whether fields of one color contain markers.
    """

    name = "chessboard"
    shown = "the corners of a chessboard"
    markers: ClassVar[bool] = False

    @property
    def max_residual(self) -> float:
        return self.settings.max_board_residual

    def search(self, image: GreyImage) -> Iterator[MarkLattice]:
        """The largest lattice of corners around which the image correlates with a drawn board.

        The saddle points of a busy ground form larger lattices than those of a small board.
        """
        boards: list[tuple[Array, GridIndex]] = []
        fault = f"fewer than {MIN_MARKS}"
        for blur in self.settings.saddle_blurs:
            for number, (centers, grid) in enumerate(
                self._grow_boards(image, blur)[: self.settings.max_boards]
            ):
                if len(grid) <= max((len(board[1]) for board in boards), default=0):
                    break  # the following pieces are not larger either
                with suppress(ValueError):
                    centers, grid = self._correlated(image, centers, grid)
                    if has_markers(image, centers, grid, self.settings) != self.markers:
                        markers = "no markers" if self.markers else "markers"
                        fault = f"those of a board with {markers} in its fields"
                    elif number == 0 or len(grid) > 2 * MIN_MARKS:
                        boards.append((centers, grid))
        if not boards:
            raise ValueError(f"image must show {self.shown}, got {fault}")
        centers, grid = max(boards, key=lambda board: len(board[1]))
        to_image = map_centers(centers, grid, image.grey.shape)
        moments = np.full((len(grid), 2, 2), np.nan)
        yield MarkLattice(image, Marks(centers, moments, to_image.scale(grid)), grid, alone=True)

    def fit(self, image: GreyImage, marks: Marks, steps: Array) -> OutlineFit:
        half_width = self.settings.corner_width[self.markers]
        return fit_crossings(image, marks, steps, half_width, self.settings)

    def locate(self, outlines: OutlineFit) -> MarkPoints:
        return line_crossings(outlines)

    def side(self, lattice: FittedLattice) -> float:
        return 1.0

    def check(self, lattice: FittedLattice) -> None:
        """Do nothing, because the search has compared the image with the drawn board."""

    def _grow_boards(self, image: GreyImage, blur: float) -> list[tuple[Array, GridIndex]]:
        """Corners and indices of possible boards among the saddle points, the largest first."""
        settings = self.settings
        centers, hessians = _saddles(image.grey, blur, settings)
        if len(centers) < MIN_MARKS:
            return []
        near = neighbors(centers, settings.corner_neighbors[self.markers])
        toward = centers[near] - centers[:, None]
        toward /= np.linalg.norm(toward, axis=2, keepdims=True)
        curvature = np.einsum("nki,nij,nkj->nk", toward, hessians, toward)
        along = np.abs(curvature) < settings.max_edge_curvature

        def may_adjoin(corner: NDArray[np.intp] | int, other: NDArray[np.intp] | int) -> NDArray:
            product = (hessians[corner] * hessians[other]).sum(axis=(-2, -1))
            return np.asarray(product < settings.max_corner_product)

        suits = along & may_adjoin(np.arange(len(near))[:, None], near)
        tolerant = replace(settings, step_tolerance=settings.corner_tolerance)
        pieces = grow_pieces(centers, near, suits, may_adjoin, tolerant)
        return [(centers[numbers], grid) for numbers, grid in pieces]

    def _correlated(
        self, image: GreyImage, centers: Array, grid: GridIndex
    ) -> tuple[Array, GridIndex]:
        """The corners around which the image correlates with a drawn board."""
        places = CELL
        if self.markers:
            places = places[np.abs(places).min(axis=1) < self.settings.edge_width]
        for limit in self.settings.corner_correlations:
            to_image = map_centers(centers, grid, image.grey.shape)
            offset = np.linalg.norm(centers - to_image(grid), axis=1)
            side = np.sqrt(to_image.scale(grid))  # zero where false corners coincide
            drawn = np.sign(places.prod(axis=1)) * (-1.0) ** grid.sum(axis=1)[:, None]
            steps = to_image.steps(grid)
            both = [image.correlation(centers, steps, places, sign * drawn) for sign in (1, -1)]
            kept = (max(both, key=np.median) > limit) & (offset < (1 - limit) * side)
            centers, grid = centers[kept], grid[kept]
            if len(grid) < MIN_MARKS or fill(grid) == 0:
                raise ValueError("no corner of a board is left")
        return centers, grid


class Charuco(Chessboard):
    """Inner corners of a ChArUco board, a chessboard with markers in its fields."""

    name = "charuco"
    shown = "the corners of a ChArUco board"
    markers = True


def has_markers(
    image: GreyImage, centers: Array, grid: GridIndex, settings: DetectionSettings
) -> bool:
    """Whether the fields of one color contain markers, by the scatter of their grey levels.

    It also scatters on a sheared lattice, whose fields contain edges.
    """
    steps = map_centers(centers, grid, image.grey.shape).steps(grid)
    inside = CELL[np.abs(CELL).min(axis=1) > settings.field_margin]
    levels = image.levels(centers[:, None] + inside @ steps.transpose(0, 2, 1))
    color = np.sign(inside.prod(axis=1)) * (-1.0) ** grid.sum(axis=1)[:, None]
    first, second = (
        np.median(np.nanstd(np.where(color == sign, levels, np.nan), axis=1)) for sign in (1, -1)
    )
    low, high = np.percentile(levels, [5, 95])
    return bool(abs(first - second) > settings.min_marker_scatter * (high - low))


def _saddles(
    grey: NDArray[np.float32], blur: float, settings: DetectionSettings
) -> tuple[Array, Array]:
    """Saddle points of the blurred image, the strongest first, and their second derivatives as
    matrices (n, 2, 2) of length one."""
    smooth = cv2.GaussianBlur(grey, (0, 0), blur)
    x, y = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    xx, xy, yy = (cv2.Sobel(*each) for each in ((x, -1, 1, 0), (x, -1, 0, 1), (y, -1, 0, 1)))
    strength = xy * xy - xx * yy
    size = 2 * int(np.ceil(blur)) + 1
    peak = strength == cv2.dilate(strength, np.ones((size, size), np.uint8))
    row, column = np.nonzero(peak & (strength > settings.min_saddle * strength.max()))
    order = np.argsort(-strength[row, column], kind="stable")[: settings.max_saddles]
    at = row[order], column[order]
    hessians = np.stack([xx[at], xy[at], xy[at], yy[at]], axis=-1).reshape(-1, 2, 2).astype(float)
    slope = np.stack([x[at], y[at]], axis=-1).astype(float)
    # Sobel's weights make 8 of a slope, and 64 of a curvature.
    move = -8 * np.linalg.solve(hessians, slope[..., None])[..., 0]
    near = np.abs(move).max(axis=1) < 2
    centers = np.column_stack(at[::-1]) + move
    return centers[near], (hessians / np.linalg.norm(hessians, axis=(1, 2), keepdims=True))[near]
