"""Detect the lines of a stage micrometer: what a pixel measures, from the scale that labs have."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from microlib._common import Array, Tidy, scalar
from microlib.calibration._uncertainty import inverse_interval

#: Fewest lines that are a scale: five leave three residuals beside a straight line. Closer lines
#: than so many pixels have no ground between them.
_FEWEST, _CLOSEST = 5, 4.0
#: Most residual of a line in divisions: scales are ruled to a hundredth of a division, and stripes
#: that only look like one rarely lie within a twentieth.
_MOST_RESIDUAL = 0.02
#: Least part of the places between the first line and the last that have a line, and most
#: difference of a gap from the others, in gaps.
_LEAST_PRESENT, _ALIKE = 0.8, 0.25
#: Least prominence of a line in the profile, in that of the strongest: numerals and dirt lie lower
#: once the profile is averaged along the lines.
_LEAST_PROMINENCE = 0.3
#: Half of the turn about the gradients' own direction in which the sharpest profile is sought, rad,
#: and the steps.
_TURN, _TURNS = 0.1, 81
#: A line's place is the center of what is dark within so many divisions to both sides, and is taken
#: so often, each time about the last.
_REACH, _ROUNDS = 0.4, 4


@dataclass(frozen=True, eq=False, repr=False)
class Micrometer(Tidy):
    """Lines of a stage micrometer found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        A point (x, y) of each line, on the axis of the scale, px.
    divisions : ndarray of int, shape (N,)
        Which line of the scale each is, from zero on.
    residuals : ndarray, shape (N,)
        Place of each line across it less that of equal divisions, px.
    spacing : float
        Distance of neighboring lines, px.
    spacing_sigma : float
        Its standard deviation, from the residuals.
    angle : float
        Direction across the lines, from the image's x axis, rad, from x to y.
    """

    _samples = ("divisions", "points", "residuals")

    points: Array
    divisions: NDArray[np.intp]
    residuals: Array
    spacing: float
    spacing_sigma: float
    angle: float

    def um_per_pixel(self, division: float) -> tuple[float, float, float]:
        """What a pixel measures, µm, and the ends of its 95 % interval.

        Parameters
        ----------
        division : float
            Distance of neighboring lines of the scale, µm.

        Returns
        -------
        tuple of float
            Estimate, low and high.
        """
        size = scalar("division", division, above=0) / self.spacing
        quantile = float(stdtrit(len(self.points) - 2, 0.975))
        return size, *inverse_interval(size, quantile * self.spacing_sigma / self.spacing)


def find_scale(grey: NDArray[np.float32]) -> Micrometer:
    """Lines of a scale in an image, as :func:`detect_micrometer` finds them."""
    angle = _direction(grey)
    upright, matrix = _turned(grey, angle)
    # Rows along which much changes cross the lines.
    change = _mean(np.abs(cv2.Sobel(upright, cv2.CV_32F, 1, 0)).T)
    high = change >= (np.nanmin(change) + np.nanmax(change)) / 2
    profile = _mean(upright[high]) if high.any() else np.full(1, np.nan)
    known = profile[np.isfinite(profile)]
    if known.size and 2 * known.mean() < known.min() + known.max():  # lines are the lesser part
        profile = -profile
    dark = np.nan_to_num(np.nanmax(profile, initial=-np.inf) - profile)
    from scipy.signal import find_peaks  # here, as it takes long to import

    peaks, shape = find_peaks(dark, prominence=np.finfo(float).tiny)
    depth = shape["prominences"]
    places = peaks[depth > _LEAST_PROMINENCE * depth.max(initial=0)].astype(np.float64)
    gaps = np.diff(places)
    alike = np.abs(gaps - np.median(gaps)) < _ALIKE * np.median(gaps) if len(gaps) else gaps > 0
    if alike.sum() < _FEWEST - 1 or alike.mean() < _LEAST_PRESENT:
        raise _refusal(f"{int(alike.sum())} equal gaps of {len(gaps)}")
    spacing = gaps[alike].mean()
    reach = _REACH * spacing * np.linspace(-1, 1, 2 * int(2 * spacing) + 1)
    for _ in range(_ROUNDS):
        line = np.interp(places[:, None] + reach, np.arange(len(dark)), dark)
        line = np.maximum(line - np.maximum(line[:, :1], line[:, -1:]), 0)
        places = places + line @ reach / np.maximum(line.sum(axis=1), np.finfo(float).tiny)
    divisions = np.concatenate([[0], np.cumsum(np.round(np.diff(places) / spacing))]).astype(
        np.intp
    )
    if len(np.unique(divisions)) < len(places) or len(places) < _LEAST_PRESENT * divisions[-1]:
        raise _refusal(f"{len(places)} lines on {divisions[-1] + 1} places")
    spacing, first = np.polyfit(divisions, places, 1)
    residuals = places - first - spacing * divisions
    rms = np.sqrt((residuals**2).sum() / (len(places) - 2))
    if spacing < _CLOSEST or rms > _MOST_RESIDUAL * spacing:
        raise _refusal(f"lines {spacing:.3g} px apart, {rms / spacing:.2g} of it beside equal ones")
    sigma = rms / np.sqrt(((divisions - divisions.mean()) ** 2).sum())
    upright_points = np.column_stack([places, np.full(len(places), np.flatnonzero(high).mean())])
    points = (upright_points - matrix[:, 2]) @ matrix[:, :2]
    return Micrometer(points, divisions, residuals, float(spacing), float(sigma), angle)


def _direction(grey: NDArray[np.float32]) -> float:
    """Angle across the lines: the gradients' own, then where the mean profile is sharpest."""
    gx, gy = (cv2.Sobel(grey, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    first = float(np.angle(np.sum((gx + 1j * gy).astype(np.complex128) ** 2))) / 2
    turns = first + np.linspace(-_TURN, _TURN, _TURNS)
    sharp = [np.nanmean(np.diff(_mean(_turned(grey, turn)[0])) ** 2) for turn in turns]
    return float(turns[np.argmax(sharp)])


def _turned(grey: NDArray[np.float32], angle: float) -> tuple[NDArray[np.float32], Array]:
    """Image with the lines upright, NaN outside, and the matrix to its coordinates."""
    height, width = grey.shape
    matrix = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0]])
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ matrix[:, :2].T
    matrix[:, 2] = -corners.min(axis=0)
    size = np.ceil(np.ptp(corners, axis=0)).astype(int).tolist()
    upright = cv2.warpAffine(grey, matrix, size, borderValue=float("nan"))
    return np.asarray(upright, dtype=np.float32), matrix


def _mean(rows: NDArray[np.float32]) -> Array:
    """Mean of each column, NaN where less than half of it is image."""
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    sums = np.where(known, rows, 0).sum(axis=0, dtype=np.float64)
    return np.where(count > len(rows) / 2, sums / np.maximum(count, 1), np.nan)


def _refusal(got: str) -> ValueError:
    return ValueError(f"image must show a scale of equidistant lines, got {got}")
