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
        Distance of neighboring lines, px. Its uncertainty contains errors of the lines and the
        change of the distance over the image.
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

        It is the mean along the scale. The interval also contains the change of the size over the
        image by distortion or a tilted scale, if the lines show it, and errors of single lines. It
        does not contain an error of the length of the whole scale, nor a pixel that is not square.

        Parameters
        ----------
        division : float
            Distance of the closest neighboring lines that the image shows, µm.

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
    places, divisions = _lines(dark, within, settings)
    spacing, first = np.polyfit(divisions, places, 1).tolist()
    begin, end = np.clip(places[[0, -1]] + [-spacing, spacing], 0, None).astype(int)
    top, bottom = np.flatnonzero(rows)[[0, -1]]
    common = _row_correlation(upright[top : bottom + 1, begin:end])
    if common < settings.min_correlation:
        raise _no_scale(f"interrupted ones, with a correlation of rows of {common:.2f}")
    estimate = _spacing(divisions, places)
    if estimate.high - estimate.low > spacing / 5:  # of a photograph of something else, or of wear
        raise _no_scale(f"uneven lines, whose distance of {spacing:.3g} px is uncertain by 10 %")
    upright_points = np.column_stack([places, np.full(len(places), np.flatnonzero(rows).mean())])
    return Micrometer(
        points=(upright_points - matrix[:, 2]) @ matrix[:, :2],
        divisions=divisions,
        residuals=places - first - spacing * divisions,
        spacing=estimate,
        angle=angle,
    )


def _spacing(divisions: NDArray[np.intp], places: Array) -> Estimate:
    """Mean distance of neighboring lines, px, with the uncertainty by noise and by its change."""
    from scipy.stats import f as fisher  # here, as it takes long to import

    count, change = len(places), 0.0
    line, curve, freedom = _smooth_curve(divisions, places)
    errors, smaller = (places - fit(divisions) for fit in (line, curve))
    straight, noise, more = errors @ errors, smaller @ smaller, count - 2 - freedom
    # A curve that fits the lines better than chance in one of 100 images is distortion, a tilt or
    # an error of the ruling. The distance of the lines then differs from place to place.
    if more and straight - noise > fisher.ppf(0.99, more, freedom) * more / freedom * noise:
        change, errors = float(np.std(curve.deriv()(divisions))), smaller
    else:
        freedom, noise = count - 2, straight
    variance = noise / freedom / np.sum((divisions - divisions.mean()) ** 2)
    # The ratio of Durbin and Watson is 2 for independent errors. If errors add up from line to
    # line, the distances are independent instead.
    if np.sum(np.diff(errors) ** 2) < errors @ errors:
        steps = np.diff(divisions)
        variance = max(variance, np.var(np.diff(errors) / np.sqrt(steps)) / np.sum(steps))
    uncertainty = float(np.hypot(np.sqrt(variance), change))
    spacing = float(line.deriv()(0.0))
    half_width = uncertainty * student_quantile(freedom)
    return Estimate(spacing, uncertainty, spacing - half_width, spacing + half_width, "px")


def _smooth_curve(
    divisions: NDArray[np.intp], places: Array
) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial, int]:
    """Straight line and cubic through lines, of less than seven a parabola, of less than five a
    straight line, and the number of lines more than its coefficients."""
    degree = min(3, (len(places) - 1) // 2)
    line, curve = (np.polynomial.Polynomial.fit(divisions, places, n) for n in (1, degree))
    return line, curve, len(places) - degree - 1


def _profile(upright: NDArray[np.float32]) -> tuple[NDArray[np.bool_], Array, tuple[int, int]]:
    """The rows that cross the lines, the darkness of their mean profile, and the first and the last
    column in which most of these rows lie in the image.

    The darkness is from 0 to about 1, because it follows uneven light.
    """
    from scipy.ndimage import grey_closing, grey_opening, maximum_filter1d, uniform_filter1d

    change = _mean(np.abs(cv2.Sobel(upright, cv2.CV_32F, 1, 0)).T)
    # In a long strip that is turned by 45°, most of every row lies outside the image.
    known = change[np.isfinite(change)]
    # Rows that cross only every second line, which is longer than the others, have half the change.
    rows = change >= known.min() + 0.7 * np.ptp(known) if len(known) else np.isfinite(change)
    profile = _mean(upright[rows])
    columns = np.flatnonzero(np.isfinite(profile))
    if not len(columns):
        raise _no_scale("no row of pixels that crosses the lines and lies mostly in the image")
    first, last = int(columns[0]), int(columns[-1])
    known = np.interp(np.arange(first, last + 1), columns, profile[columns])
    size = max(len(known) // 4, 1)
    # A closing removes dark lines and an opening bright ones. Lines cover less than half. The
    # profile goes on beyond its ends as the light does there.
    longer = np.pad(known, size, mode="reflect", reflect_type="odd")
    dark, bright = (
        sign * (uniform_filter1d(envelope(longer, size), size)[size : size + len(known)] - known)
        for sign, envelope in ((1, grey_closing), (-1, grey_opening))
    )
    lines = max(dark, bright, key=lambda each: each.max() - 2 * each.mean())
    height = uniform_filter1d(maximum_filter1d(lines, 2 * size), size)
    height = np.maximum(height, lines.max() / 10 + np.finfo(float).tiny)
    return rows, np.pad(lines / height, (first, len(profile) - 1 - last)), (first, last)


def _lines(
    dark: Array, within: tuple[int, int], settings: DetectionSettings
) -> tuple[Array, NDArray[np.intp]]:
    """Places of the lines in a profile, px, and their numbers on a scale.

    A division is the smallest distance of neighbors with which most lines are equidistant. Peaks
    that the first or the last column `within` the image may cut are left out, because the edge
    would move their centroids.
    """
    from scipy.signal import find_peaks  # here, as it takes long to import

    _, sides = find_peaks(dark, prominence=settings.min_peak * np.ptp(dark), width=0)
    places = (sides["left_ips"] + sides["right_ips"]) / 2  # at half of their height
    width = float(np.median(sides["widths"])) if len(places) else 0.0
    gaps = np.sort(np.diff(places))
    equal = gaps[:-1][gaps[1:] < 1.1 * gaps[:-1]]
    fault = f"{len(places)} lines without two equal distances"
    for spacing in dict.fromkeys(np.round(equal, 1).tolist()):
        reach = min(settings.line_reach * spacing, 1.5 * width + 2)
        inside = places[(places - reach >= within[0]) & (places + reach <= within[1])]
        chosen, divisions = _numbered(inside, spacing)
        if len(chosen) < max(settings.min_lines, settings.min_regular * len(inside)):
            fault = f"{len(chosen)} of {len(inside)} lines that lie away from the image's edges"
            continue
        single = np.diff(divisions) == 1
        if single.mean() < 1 / 2 and np.convolve(single, np.ones(4)).max() < 4:
            fault = "groups of lines, as of a counting chamber, but not four equal distances"
            continue
        centers = _centers(dark, chosen, reach)
        _, curve, freedom = _smooth_curve(divisions, centers)
        rms = np.sqrt(np.sum((centers - curve(divisions)) ** 2) / freedom) / spacing
        if spacing >= 4 and rms <= settings.max_line_residual:  # closer lines merge
            return centers, divisions
        fault = f"lines {spacing:.3g} px apart that are {rms:.2g} divisions off"
    raise _no_scale(fault)


def _numbered(places: Array, spacing: float) -> tuple[Array, NDArray[np.intp]]:
    """Lines at multiples of a spacing, which may change smoothly, and their numbers from zero.

    Lines are added to both sides of the first pair with this spacing.
    """
    pair = np.flatnonzero(np.abs(np.diff(places) - spacing) < 0.1 * spacing)
    if not len(pair):
        return places[:0], np.zeros(0, np.intp)
    chosen, numbers = list(places[pair[0] : pair[0] + 2]), [0, 1]
    for sign, others in ((1, places[pair[0] + 2 :]), (-1, places[: pair[0]][::-1])):
        for place in others:
            near = slice(-5, None)
            local = (chosen[-1] - chosen[near][0]) / (numbers[-1] - numbers[near][0])
            steps = (place - chosen[-1]) / local
            if round(steps) * sign >= 1 and abs(steps - round(steps)) < 1 / 4:
                chosen.append(place)
                numbers.append(numbers[-1] + round(steps))
        chosen, numbers = chosen[::-1], numbers[::-1]
    return np.array(chosen), np.array(numbers) - numbers[0]


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

    def sharpness(turn: float) -> float:
        change = np.diff(_mean(_turned(grey, turn)[0])) ** 2
        # A strip with a large rotation has no complete column.
        return float(np.nansum(change) / max(np.isfinite(change).sum(), 1))

    coarse = max(turns[::4], key=sharpness)
    return float(max(turns[np.argsort(np.abs(turns - coarse))[:7]], key=sharpness))


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
    return ValueError(
        f"image must show a scale of equidistant lines, got {got}; crop the image to sharp lines "
        "of one direction"
    )
