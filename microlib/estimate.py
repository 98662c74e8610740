"""A number with its uncertainty, which the results of several subjects contain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microlib._common import FlatResult

__all__ = ["Estimate"]


@dataclass(frozen=True, repr=False)
class Estimate(FlatResult):
    """A measured quantity with its standard uncertainty and its 95 % interval.

    Attributes
    ----------
    value : float
        The estimate; NaN if the data do not determine it.
    uncertainty : float
        Standard deviation of its error.
    low, high : float
        Limits of the 95 % confidence interval. The interval is not symmetric where the error is
        not normal, and a limit may be infinite.
    unit : str
        Unit of the four numbers, such as "µm/px"; empty for a number without a unit.

    Examples
    --------
    >>> from microlib.estimate import Estimate
    >>> size = Estimate(0.50217, 0.00042, 0.50134, 0.503, "µm/px")
    >>> print(size)
    0.50217 µm/px (95 %: 0.50134 to 0.50300)
    >>> size.interval
    (0.50134, 0.503)
    """

    value: float
    uncertainty: float
    low: float
    high: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """The limits of the 95 % interval."""
        return self.low, self.high

    def __str__(self) -> str:
        if np.isnan(self.value):
            return "not determined"
        # Two digits of the uncertainty; six digits where it is unknown or tiny.
        known = np.isfinite(self.uncertainty) and self.uncertainty > 0
        digits = 1 - int(np.floor(np.log10(self.uncertainty))) if known else 0
        shown = (
            f"{number:.{max(digits, 0)}f}" if known and digits < 8 else f"{number:.6g}"
            for number in (self.value, self.low, self.high)
        )
        value, low, high = shown
        return f"{f'{value} {self.unit}'.rstrip()} (95 %: {low} to {high})"

    def __repr__(self) -> str:
        return f"Estimate({self})"
