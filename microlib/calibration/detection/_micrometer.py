"""Detection of the lines of a stage micrometer, which give the size of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Result, as_scalar
from microlib.calibration._uncertainty import student_quantile
from microlib.calibration.detection._settings import DetectionSettings
from microlib.estimate import Estimate


@dataclass(frozen=True, eq=False, repr=False)
class Micrometer(Result):
    """Lines of a stage micrometer found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        A point (x, y) of each line, on the axis of the scale, px.
    divisions : ndarray of int, shape (N,)
        Number of each line on the scale, from zero.
    residuals : ndarray, shape (N,)
        Position of each line minus that of equal divisions, px.
    spacing : Estimate
        Distance of neighboring lines, px, with the uncertainty by the residuals.
    angle : float
        Direction across the lines, measured from the x axis of the image towards y, rad.
    """

    points: Array
    divisions: NDArray[np.intp]
    residuals: Array
    spacing: Estimate
    angle: float

    def um_per_pixel(self, division: float) -> Estimate:
        """Return the size of a pixel in the object plane, µm/px.

        It is the mean along the scale. The interval does not contain changes of the size over the
        image by distortion or a tilted scale. `residuals` that change smoothly from line to line
        are a sign of them.

        Parameters
        ----------
        division : float
            Distance of neighboring lines of the scale, µm.

        Returns
        -------
        Estimate
            The interval has no upper limit if that of the spacing contains zero.
        """
        division = as_scalar("division", division, above=0)
        spacing, (low, high) = self.spacing, self.spacing.interval
        size = division / spacing.value
        return Estimate(
            value=size,
            uncertainty=size * spacing.uncertainty / spacing.value,
            low=division / high,
            high=division / low if low > 0 else np.inf,
            unit="µm/px",
        )


def find_scale(grey: NDArray[np.float32], settings: DetectionSettings) -> Micrometer:
    """Detect the lines of a scale; see :func:`detect_micrometer`."""
    angle = _direction(grey, settings)
    upright, matrix = _turned(grey, angle)
    rows, dark, within = _profile(upright)
    places, spacing = _lines(dark, within, settings)
    places = _centers(dark, places, settings.line_reach * spacing)
    steps = np.round(np.diff(places) / spacing).astype(np.intp)
    divisions = np.concatenate([[0], np.cumsum(steps)])
    spacing, first = np.polyfit(divisions, places, 1).tolist()
    residuals = places - first - spacing * divisions
    rms = np.sqrt((residuals**2).sum() / (len(places) - 2))
    deviation = rms / spacing
    if spacing < 4 or deviation > settings.max_line_residual:  # closer lines merge
        raise _no_scale(f"lines {spacing:.3g} px apart that are {deviation:.2g} divisions off")
    begin, end = np.clip(places[[0, -1]] + [-spacing, spacing], 0, None).astype(int)
    top, bottom = np.flatnonzero(rows)[[0, -1]]
    common = _row_correlation(upright[top : bottom + 1, begin:end])
    if common < settings.min_correlation:
        raise _no_scale(f"interrupted ones, with a correlation of rows of {common:.2f}")
    uncertainty = float(rms / np.sqrt(((divisions - divisions.mean()) ** 2).sum()))
    half_width = uncertainty * student_quantile(len(places) - 2)
    upright_points = np.column_stack([places, np.full(len(places), np.flatnonzero(rows).mean())])
    points = (upright_points - matrix[:, 2]) @ matrix[:, :2]
    return Micrometer(
        points=points,
        divisions=divisions,
        residuals=residuals,
        spacing=Estimate(spacing, uncertainty, spacing - half_width, spacing + half_width, "px"),
        angle=angle,
    )


def _profile(upright: NDArray[np.float32]) -> tuple[NDArray[np.bool_], Array, tuple[int, int]]:
    """The rows that cross the lines, the darkness of their mean profile, and the first and the last
    column in which most of these rows lie in the image.

    The darkness is from 0 to 1 between the envelopes of the profile, which follow uneven light.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

    change = _mean(np.abs(cv2.Sobel(upright, cv2.CV_32F, 1, 0)).T)
    # In a long strip that is turned by 45°, most of every row lies outside the image.
    known = change[np.isfinite(change)]
    rows = change >= (known.min() + known.max()) / 2 if len(known) else np.isfinite(change)
    profile = _mean(upright[rows])
    columns = np.flatnonzero(np.isfinite(profile))
    if not len(columns):
        raise _no_scale("no row of pixels that crosses the lines and lies mostly in the image")
    profile = np.where(np.isfinite(profile), profile, np.nanmedian(profile))
    size = len(profile) // 4
    low, high = (
        uniform_filter1d(envelope(profile, size), size)
        for envelope in (minimum_filter1d, maximum_filter1d)
    )
    evened = (profile - low) / np.maximum(high - low, np.ptp(profile) / 10 + np.finfo(float).tiny)
    dark = evened if evened.mean() < 1 / 2 else 1 - evened  # lines cover less than half
    return rows, dark, (int(columns[0]), int(columns[-1]))


def _lines(
    dark: Array, within: tuple[int, int], settings: DetectionSettings
) -> tuple[Array, float]:
    """Peaks of a profile that are equidistant with few exceptions, and their distance, px.

    Peaks less than `line_reach` divisions from the first or the last column `within` the image are
    left out, because the edge would move their centroids.
    """
    from scipy.signal import find_peaks  # here, as it takes long to import

    prominence = settings.min_peak * np.ptp(dark)
    places = find_peaks(dark, prominence=prominence)[0].astype(np.float64)
    if len(places) > 1:
        reach = settings.line_reach * np.median(np.diff(places))
        places = places[(places - reach >= within[0]) & (places + reach <= within[1])]
    gaps = np.diff(places)
    steps = gaps / np.median(gaps) if len(gaps) else gaps
    regular = (np.abs(steps - np.round(steps)) < 1 / 4) & (steps > 1 / 2) & (steps < 3)
    ends = np.concatenate([[0], np.flatnonzero(~regular) + 1, [len(places)]])
    longest = int(np.argmax(np.diff(ends)))
    run = slice(ends[longest], ends[longest + 1])
    kept = places[run]
    if len(kept) < max(settings.min_lines, settings.min_regular * len(places)):
        raise _no_scale(f"{len(kept)} of {len(places)} lines that lie away from the image's edges")
    return kept, float(np.diff(kept).sum() / np.round(steps[run][: len(kept) - 1]).sum())


def _centers(dark: Array, places: Array, reach: float) -> Array:
    """Centroid of the darkness within `reach` pixels of each line, in four iterations.

    A straight line is subtracted as the background, which allows for uneven light.
    """
    part = np.linspace(-1, 1, 2 * int(5 * reach) + 1)
    offsets = reach * part
    for _ in range(4):
        line = np.interp(places[:, None] + offsets, np.arange(len(dark)), dark)
        first, last = line[:, :1], line[:, -1:]
        line = np.maximum(line - (first + last + part * (last - first)) / 2, 0)
        places = places + line @ offsets / np.maximum(line.sum(axis=1), np.finfo(float).tiny)
    return places


def _row_correlation(strip: NDArray[np.float32]) -> float:
    """Lower quartile of the correlation of the rows with their mean.

    It is close to zero for a grid of circles or squares, for the rows between them.
    """
    strip = strip[:, np.isfinite(_mean(strip))]
    strip = np.where(np.isfinite(strip), strip, _mean(strip))
    about = strip - strip.mean(axis=1, keepdims=True)
    mean = about.mean(axis=0)
    length = np.linalg.norm(about, axis=1) * np.linalg.norm(mean) + np.finfo(float).tiny
    return float(np.quantile(about @ mean / length, 1 / 4))


def _direction(grey: NDArray[np.float32], settings: DetectionSettings) -> float:
    """Angle across the lines: near the mean direction of the gradients, the one with the sharpest
    mean profile."""
    gx, gy = (cv2.Sobel(grey, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    first = float(np.angle(np.sum((gx + 1j * gy).astype(np.complex128) ** 2))) / 2
    turns = first + np.linspace(-settings.angle_range, settings.angle_range, settings.angle_count)
    changes = [np.diff(_mean(_turned(grey, turn)[0])) ** 2 for turn in turns]
    # A strip with a large rotation has no complete column.
    sharp = [np.nansum(each) / max(np.isfinite(each).sum(), 1) for each in changes]
    return float(turns[np.argmax(sharp)])


def _turned(grey: NDArray[np.float32], angle: float) -> tuple[NDArray[np.float32], Array]:
    """Image rotated to upright lines, NaN outside, and the matrix to its coordinates."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    ends = np.array(grey.shape[::-1]) / 2
    size = 2 * np.ceil(np.abs(turn) @ ends)
    matrix = np.column_stack([turn, size / 2 - turn @ ends])
    upright = cv2.warpAffine(grey, matrix, size.astype(int).tolist(), borderValue=float("nan"))
    return np.asarray(upright, dtype=np.float32), matrix


def _mean(rows: NDArray[np.float32]) -> Array:
    """Mean of each column, NaN where less than half of it is image."""
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    sums = np.where(known, rows, 0).sum(axis=0, dtype=np.float64)
    return np.where(count > len(rows) / 2, sums / np.maximum(count, 1), np.nan)


def _no_scale(got: str) -> ValueError:
    return ValueError(f"image must show a scale of equidistant lines, got {got}")
