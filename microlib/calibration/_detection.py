"""Result of the detection of a pattern."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Result

if TYPE_CHECKING:
    import pandas as pd

#: Fewest marks of a detection: a homography needs four points.
MIN_MARKS = 4


@dataclass(frozen=True, eq=False, repr=False)
class Detection(Result):
    """Points of a calibration pattern found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Image points (x, y), px.
    grid : ndarray of int, shape (N, 2)
        Integer coordinates in the pattern, from zero.
    uncertainty : ndarray, shape (N,)
        Standard deviation of a coordinate of each point, px, from the fit of its outline or from
        the residuals of the points, whichever is larger. `calibrate` gives all points the same
        weight.
    group : ndarray of int, shape (N,)
        Number of the mark of each point. The errors of the points of a mark are correlated.
    positions : ndarray, shape (N, 2)
        Coordinates in the pattern in pitches, the distance between neighboring marks. Times the
        pitch in µm they are world points up to a shift. For squares they include the measured side.
    side : float
        Side of the squares in pitches; NaN for circles.
    normalized_rms : float
        Rms of the residuals over the standard deviations by the fits of the outlines, about one for
        a pattern without faults. NaN for too few marks.
    image_size : tuple of int
        Width and height of the photograph, px.
    """

    points: Array
    grid: NDArray[np.intp]
    uncertainty: Array
    group: NDArray[np.intp]
    positions: Array
    side: float
    normalized_rms: float
    image_size: tuple[int, int]

    def __repr__(self) -> str:
        side = "" if np.isnan(self.side) else f", side {self.side:.4g} pitches"
        return (
            f"Detection of {len(self.points)} points of {len(np.unique(self.group))} marks in "
            f"{self.image_size[0]}×{self.image_size[1]} px{side}, "
            f"σ {np.median(self.uncertainty):.2g} px, residuals {self.normalized_rms:.2g} σ"
        )

    def to_frame(self) -> pd.DataFrame:
        """Return the points as a table.

        Returns
        -------
        pandas.DataFrame
            One row for each point: ``grid_i``, ``grid_j``, ``positions_x``, ``positions_y``,
            ``points_x`` and ``points_y`` (px), ``uncertainty`` (px), ``group``.
        """
        import pandas as pd  # here, as it takes long to import

        pairs = {"grid": self.grid, "positions": self.positions, "points": self.points}
        names = {"grid": "ij", "positions": "xy", "points": "xy"}
        columns = {f"{k}_{n}": v[:, i] for k, v in pairs.items() for i, n in enumerate(names[k])}
        return pd.DataFrame(columns | {"uncertainty": self.uncertainty, "group": self.group})

    def plot(self, ax: Any = None, *, image: NDArray | None = None) -> Any:
        """Draw the points, some with their grid coordinates, by Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes of the drawing, by default in a new figure.
        image : ndarray, optional
            Photograph in the background.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from microlib._plots import marks

        return marks([self], None if image is None else [image], None, ax)
