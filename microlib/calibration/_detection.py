"""What a detector returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Tidy

if TYPE_CHECKING:
    import pandas as pd

#: A homography from the grid to the image needs as many shapes.
FEWEST = 4


@dataclass(frozen=True, eq=False, repr=False)
class Detection(Tidy):
    """Points of a calibration pattern found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        (x, y), px.
    grid : ndarray of int, shape (N, 2)
        Coordinates in the pattern, from zero on, or from its origin mark; times the pitch they are
        world points up to a shift.
    sigma : ndarray, shape (N,)
        Standard deviation of a coordinate of each point, px: as the fit of its outline tells it, or
        as the points' residuals from a smooth image of a lattice do, where these are larger.
    group : ndarray of int, shape (N,)
        Number of the shape that each point belongs to: errors within one shape are correlated.
    positions : ndarray, shape (N, 2)
        Where the points lie in the pattern, in pitches from mark to mark; times the pitch in µm
        they are world points up to a shift. Of squares they hold the side that was measured, which
        need not be half of the pitch; of an asymmetric grid the unit is the distance of its rows.
    side : float
        Side of the squares in pitches; NaN for circles.
    misfit : float
        What the points' residuals are, over what their outlines' fits state; about one for a
        pattern without faults. NaN where there are too few marks to tell.
    image_size : tuple of int
        Width and height of the photograph, px.
    """

    _large = ("grid", "positions", "points", "sigma", "group")

    points: Array
    grid: NDArray[np.intp]
    sigma: Array
    group: NDArray[np.intp]
    positions: Array
    side: float
    misfit: float
    image_size: tuple[int, int]

    def __repr__(self) -> str:
        side = "" if np.isnan(self.side) else f", side {self.side:.4g} pitches"
        return (
            f"Detection of {len(self.points)} points of {len(np.unique(self.group))} marks in "
            f"{self.image_size[0]}×{self.image_size[1]} px{side}, "
            f"σ {np.median(self.sigma):.2g} px, misfit {self.misfit:.2g}"
        )

    def to_frame(self) -> pd.DataFrame:
        """Return the points as a table.

        Returns
        -------
        pandas.DataFrame
            One row a point: ``grid_i``, ``grid_j``, ``positions_x``, ``positions_y``, ``points_x``
            and ``points_y`` (px), ``sigma`` (px), ``group``.
        """
        import pandas as pd  # here, as it takes long to import

        pairs = {"grid": self.grid, "positions": self.positions, "points": self.points}
        names = {"grid": "ij", "positions": "xy", "points": "xy"}
        columns = {f"{k}_{n}": v[:, i] for k, v in pairs.items() for i, n in enumerate(names[k])}
        return pd.DataFrame(columns | {"sigma": self.sigma, "group": self.group})

    def plot(self, ax: Any = None, *, image: NDArray | None = None) -> Any:
        """Draw the points, some with their place in the grid, by Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw; by default in a new figure.
        image : ndarray, optional
            The photograph, to draw on.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from microlib._plots import marks

        return marks([self], None if image is None else [image], None, ax)
