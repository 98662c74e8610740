"""What one frame shows of a pipette and an egg, before they touch and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array
from microlib.embryo import extract_boundary

#: Share of the egg's radius to either side of the pipette over which its outline is averaged to
#: see it sink: at the first touch the whole top sinks, near the pipette more than elsewhere. In an
#: egg of 150 px that is the mean of some seventy points, known to 0.01 px.
_NEAR = 0.25
#: Standard deviation of the pipette's end as `extract_boundary` finds it over ground, px, at the
#: usual noise. The calibration tells what more there is.
_TIP_STD = 0.02


@dataclass(frozen=True)
class Sight:
    """Pipette and egg in an image that is turned so that the pipette comes from above.

    Attributes
    ----------
    tip : ndarray, shape (2,)
        Middle of the pipette's end, (x, y) in px, y down.
    along : ndarray, shape (2,)
        Direction of the pipette, of length one.
    outline : ndarray, shape (n, 2)
        Points of the wall's middle, px, y down.
    center : ndarray, shape (2,)
        Of the circle through them, px.
    radius : float
        Of that circle, px.
    direction : str
        Edge of the image that the pipette comes from.
    """

    tip: Array
    along: Array
    outline: Array
    center: Array
    radius: float
    direction: str

    @property
    def crown(self) -> float:
        """Height of the circle's highest point, px, y down."""
        return float(self.center[1] - self.radius)

    @property
    def dimple(self) -> float:
        """Depth of the pipette's end below the outline's highest point, px; negative above."""
        return float(self.tip[1] - self.outline[:, 1].min())

    def sunk(self, reference: Sight) -> float:
        """Return how far the outline near the pipette lies below another's circle, px."""
        x, y = self.outline.T
        near = np.abs(x - reference.center[0]) < _NEAR * reference.radius
        if not near.any():
            raise ValueError("image must show the outline near the pipette, got none")
        across = x[near] - reference.center[0]
        round_one = reference.center[1] - np.sqrt(reference.radius**2 - across**2)
        return float(np.mean(y[near] - round_one))


def see(
    image: ArrayLike, direction: str, region: tuple[int, int, int, int] | None, dimple: bool = False
) -> Sight:
    """Find pipette and egg in an image; `ValueError` says what it does not show."""
    found = extract_boundary(image, direction=direction, region=region, dimple=dimple)
    seen = ~found.under_probe
    x, y = found.x[seen], found.image_height - 1 - found.y[seen]
    # x² + y² = 2 x x₀ + 2 y y₀ + (R² − x₀² − y₀²), linear in what is sought.
    design = np.column_stack([2 * x, 2 * y, np.ones_like(x)])
    x0, y0, rest = np.linalg.lstsq(design, x**2 + y**2, rcond=None)[0]
    down = np.array([found.probe.slope, 1.0])
    return Sight(
        tip=np.array(found.probe.tip),
        along=down / np.hypot(*down),
        outline=np.column_stack([x, y]),
        center=np.array([x0, y0]),
        radius=float(np.sqrt(rest + x0**2 + y0**2)),
        direction=found.direction,
    )


@dataclass(frozen=True)
class TipTrack:
    """Where the pipette's end is, in the form that `servo` takes."""

    center: Array
    lost: bool
    reason: str
    covariance: Array


class TipTracker:
    """Finds the pipette's end in each frame anew, so that nothing is ever lost for good."""

    def __init__(self, direction: str, region: tuple[int, int, int, int] | None) -> None:
        self._direction, self._region = direction, region

    def track(self, frame: Any) -> TipTrack:
        """Return the pipette's end in a frame, px of the turned image."""
        try:
            tip, reason = see(frame, self._direction, self._region).tip, ""
        except ValueError as error:
            tip, reason = np.full(2, np.nan), str(error)
        return TipTrack(tip, bool(reason), reason, _TIP_STD**2 * np.eye(2))
