"""Detect the lines of a stage micrometer: what a pixel measures, from the scale that labs have."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import find_peaks, peak_widths
from scipy.special import ndtr
from scipy.stats import t as student

from microlib._common import Array, Tidy, scalar
from microlib.calibration._outline_fit import (
    LEAST_BLUR,
    START_CONTRAST,
    OutlineFit,
    Patches,
    cut_patches,
    fit_outlines,
    ground,
    smooth_parameters,
)
from microlib.calibration._search import crop, to_grey

# Places of a line's parameters: direction of its normal, offset along it from the patch's origin,
# blur, contrast, ground.
_ANGLE, _OFFSET, _BLUR, _CONTRAST, _GROUND = 0, 1, 2, 3, slice(4, 7)
#: What lines of one scale share: all but where they lie and how bright it is there.
_SMOOTH = [_ANGLE, _BLUR, _CONTRAST]
#: Fewest lines that are a scale: five leave three residuals beside a straight line.
_FEWEST = 5
#: Most residual of a line in divisions, or in what its fit states: scales are ruled to a hundredth
#: of a division, and stripes that only look like one rarely lie within a twentieth.
_MOST_RESIDUAL, _EXPLAINED = 0.012, 1.5
#: Least part of the places between the first line and the last that have a line.
_LEAST_PRESENT = 0.8
#: Least prominence of a line in the profile, in that of the strongest: numerals and dirt lie lower
#: once the profile is averaged along the lines.
_LEAST_PROMINENCE = 0.3
#: Bands across the lines in which they are looked for, half of each in the next: short lines do not
#: reach far, and a band that they fill has all of them at full depth.
_BANDS = 40
#: Half of the turn about the first guess in which the direction is sought, rad, and the steps.
_TURN, _TURNS = 0.05, 41
#: A line's patch reaches so far to both sides, in divisions; its neighbor begins at 0.5.
_REACH = 0.4
#: Steps of a fit: sharp edges need more than the outlines of marks do.
_STEPS = 40
#: Most residual and least contrast of a line, in medians of all.
_MOST_RMS, _LEAST_CONTRAST = 3.0, 0.5


@dataclass(frozen=True)
class Micrometer(Tidy):
    """Lines of a stage micrometer found in an image.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        A point (x, y) of each line, on the axis of the scale, px.
    divisions : ndarray of int, shape (N,)
        Which line of the scale each is, from zero on.
    sigma : ndarray, shape (N,)
        Standard deviation of each line's place across it, px.
    spacing : float
        Distance of neighboring lines, px.
    spacing_sigma : float
        Its standard deviation, from the residuals where these are larger than `sigma` states.
    angle : float
        Direction across the lines, from the image's x axis, rad, from x to y.
    misfit : float
        Residuals from equal divisions, over what the lines' own fits state; about one for a good
        scale. Distortion, a tilt and errors of the ruling make it larger.
    """

    _samples = ("divisions", "points", "sigma")

    points: Array
    divisions: NDArray[np.intp]
    sigma: Array
    spacing: float
    spacing_sigma: float
    angle: float
    misfit: float

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
        quantile = float(student.ppf(0.975, len(self.points) - 2))
        reach = quantile * self.spacing_sigma / self.spacing * size
        return size, size - reach, size + reach


def detect_micrometer(
    image: ArrayLike, *, region: tuple[int, int, int, int] | None = None
) -> Micrometer:
    """Lines of a stage micrometer or a ruler, and their distance in pixels.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Grey levels of any range, or red, green and blue. The lines may be darker or brighter than
        their ground and run in any direction; they need not be equally long.
    region : (int, int, int, int), optional
        Where to look, (x, y, width, height) in px.

    Returns
    -------
    Micrometer

    Raises
    ------
    ValueError
        If `image` is no image, or shows no scale of at least five equidistant lines.

    Notes
    -----
    The direction is that in which the image's mean profile is sharpest. Each line is a dark bar
    under a Gaussian point-spread function, fitted to the grey levels with a direction, a place, a
    width and a blur; direction, width, blur and contrast vary smoothly from line to line. The
    places are regressed on whole numbers.

    Examples
    --------
    >>> x = np.arange(200.0)
    >>> lines = sum(np.exp(-((x - 13.3 - 17.2 * k) ** 2) / 4) for k in range(11))
    >>> noise = np.random.default_rng(0).normal(0, 2, (60, 200))
    >>> scale = detect_micrometer(200 - 120 * lines + noise)
    >>> len(scale.points), round(scale.spacing, 3)
    (11, 17.2)
    >>> round(scale.um_per_pixel(10.0)[0], 4)
    0.5814
    """
    grey, corner = crop(to_grey(image), region)
    scales, refusals = [], []
    for dark in (grey, grey.max() - grey):  # the gaps between lines are a scale, too, a worse one
        try:
            scales.append(_detect(dark))
        except _Unlike as unlike:
            refusals.append(unlike)
    if not scales:
        raise ValueError(f"image must show a scale of equidistant lines, got {refusals[0]}")
    best = min(scales, key=lambda scale: scale.spacing_sigma)
    return replace(best, points=best.points + corner)


class _Unlike(ValueError):
    """What is no scale."""


def _detect(grey: NDArray[np.float32]) -> Micrometer:
    """Find the scale of dark lines."""
    angle = _direction(grey)
    places, along, width = _profile_lines(grey, angle)
    spacing = _spacing(places)
    fit, patches = _fit(grey, angle, places, along, spacing, width)
    good = np.isfinite(fit.rms)
    if good.sum() >= _FEWEST:
        good &= fit.rms <= _MOST_RMS * np.median(fit.rms[good])
        good &= fit.parameters[:, _CONTRAST] > _LEAST_CONTRAST * np.median(
            fit.parameters[good, _CONTRAST]
        )
    if good.sum() < _FEWEST:
        raise _Unlike(f"{int(good.sum())} lines")
    origins = patches.centers[good]
    return _regress(smooth_parameters(fit[good], origins, _SMOOTH), origins, spacing)


def _direction(grey: NDArray[np.float32]) -> float:
    """Angle across the lines: the gradients' own, then where the mean profile is sharpest."""
    gx, gy = (cv2.Sobel(grey, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    square = (gx + 1j * gy).astype(np.complex128) ** 2
    count = 180
    histogram = np.bincount(
        np.round(np.angle(square) / (2 * np.pi) * count).astype(int).ravel() % count,
        weights=np.abs(square).ravel(),
        minlength=count,
    )
    first = np.pi * int(np.argmax(histogram + np.roll(histogram, 1) + np.roll(histogram, -1)))
    first /= count
    turns = first + np.linspace(-_TURN, _TURN, _TURNS)
    sharp = np.array([_sharpness(grey, turn) for turn in turns])
    best = int(np.clip(np.argmax(sharp), 1, _TURNS - 2))
    below, here, above = sharp[best - 1 : best + 2]
    bend = below - 2 * here + above
    return float(
        turns[best] + (0.5 * (below - above) / bend if bend < 0 else 0) * 2 * _TURN / (_TURNS - 1)
    )


def _turned(grey: NDArray[np.float32], angle: float) -> tuple[NDArray[np.float32], Array]:
    """Image with the lines upright, NaN outside, and the matrix to its coordinates."""
    height, width = grey.shape
    cos, sin = np.cos(angle), np.sin(angle)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ [
        [cos, -sin],
        [sin, cos],
    ]
    low = corners.min(axis=0)
    size = np.ceil(np.ptp(corners, axis=0)).astype(int)
    matrix = np.array([[cos, sin, -low[0]], [-sin, cos, -low[1]]])
    upright = cv2.warpAffine(grey, matrix, size.tolist(), borderValue=float("nan"))
    return np.asarray(upright, dtype=np.float32), matrix


def _sharpness(grey: NDArray[np.float32], angle: float) -> float:
    return float(np.nanmean(np.diff(_profile(_turned(grey, angle)[0])) ** 2))


def _profile(band: NDArray[np.float32]) -> Array:
    """Mean of each column, NaN where less than half of it is image."""
    known = np.isfinite(band)
    count = known.sum(axis=0)
    sums = np.where(known, band, 0).sum(axis=0, dtype=np.float64)
    return np.where(count > len(band) / 2, sums / np.maximum(count, 1), np.nan)


def _profile_lines(
    grey: NDArray[np.float32], angle: float
) -> tuple[Array, tuple[float, float], float]:
    """Places of the lines across them, from the image's first pixel, in the band that shows most;
    the ends of that band along them; and the lines' width at half of their depth, px."""
    upright, matrix = _turned(grey, angle)
    best, band, width, score = np.empty(0), (0, 0), 0.0, 0.0
    edges = np.linspace(0, len(upright), _BANDS + 2).round().astype(int)
    for low, high in zip(edges, edges[2:], strict=False):
        profile = _profile(upright[low:high])
        known = np.flatnonzero(np.isfinite(profile))
        if len(known) < 3 * _FEWEST:
            continue
        dark = np.nanmax(profile) - profile[known[0] : known[-1] + 1]
        peaks, shape = find_peaks(np.nan_to_num(dark), prominence=np.finfo(float).tiny)
        depth = shape["prominences"]
        strong = depth > _LEAST_PROMINENCE * depth.max(initial=0)
        peaks, depth = peaks[strong], depth[strong]
        if _regular(peaks) and len(peaks) * np.quantile(depth, 0.1) > score:
            best, band, score = peaks + known[0], (low, high), len(peaks) * np.quantile(depth, 0.1)
            width = float(np.median(peak_widths(dark, peaks)[0]))
    if len(best) < _FEWEST:
        raise _Unlike(f"{len(best)} equidistant lines")
    low, high = band - matrix[1, 2]
    return best - matrix[0, 2], (low, high), width


def _regular(places: Array) -> bool:
    """Tell whether most gaps are alike."""
    gaps = np.diff(places)
    return len(gaps) >= _FEWEST - 1 and bool(_alike(gaps).mean() >= _LEAST_PRESENT)


def _spacing(places: Array) -> float:
    gaps = np.diff(places)
    return float(gaps[_alike(gaps)].mean())


def _alike(gaps: Array) -> NDArray[np.bool_]:
    """Tell the gaps that are one division: a missing line makes two of it."""
    middle = np.median(gaps)
    return np.abs(gaps - middle) < 0.25 * middle


def _fit(
    grey: NDArray[np.float32],
    angle: float,
    places: Array,
    along: tuple[float, float],
    spacing: float,
    width: float,
) -> tuple[OutlineFit, Patches]:
    """Fit a blurred bar to each line.

    Width and blur of a narrow line cannot be told apart, so the width is that at half of its depth,
    which is right for a wide one; any symmetric line has its middle where this one has it.
    """
    normal = np.array([np.cos(angle), np.sin(angle)])
    tangent = np.array([-normal[1], normal[0]])
    middle = places[:, None] * normal + np.mean(along) * tangent
    long = (along[1] - along[0]) / 2
    start = np.zeros((len(places), 7))
    origin = np.round(middle)
    start[:, _ANGLE] = angle
    start[:, _OFFSET] = (middle - origin) @ normal
    start[:, _BLUR], start[:, _CONTRAST] = 0.3 * width, START_CONTRAST

    def near(x: Array, y: Array) -> NDArray[np.bool_]:
        across = x * normal[0] + y * normal[1] - start[:, _OFFSET, None]
        beside = x * tangent[0] + y * tangent[1]
        return (np.abs(across) <= _REACH * spacing) & (np.abs(beside) <= long)

    half = int(np.ceil(np.hypot(long, _REACH * spacing))) + 1
    patches = cut_patches(grey, middle, half, near)
    start[:, _GROUND.start] = patches.grey.max(axis=1)
    fit = fit_outlines(lambda p: _bar(p, width / 2, patches), start, patches, iterations=_STEPS)
    return fit, patches


def _bar(parameters: Array, half: float, patches: Patches) -> tuple[Array, Array]:
    """Model of a blurred dark bar, and its derivatives."""
    angle, offset = parameters[:, _ANGLE, None], parameters[:, _OFFSET, None]
    blur = np.maximum(np.abs(parameters[:, _BLUR, None]), LEAST_BLUR)
    contrast = parameters[:, _CONTRAST, None]
    light, by_light = ground(patches, parameters[:, _GROUND])
    across = np.cos(angle) * patches.x + np.sin(angle) * patches.y - offset
    low, high = (across + half) / blur, (across - half) / blur
    inside = ndtr(low) - ndtr(high)
    at_low, at_high = (np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur) for z in (low, high))
    scale = -light * contrast
    jacobian = np.empty((*across.shape, 7))
    turning = -np.sin(angle) * patches.x + np.cos(angle) * patches.y
    jacobian[..., _ANGLE] = scale * (at_low - at_high) * turning
    jacobian[..., _OFFSET] = -scale * (at_low - at_high)
    turned = np.where(parameters[:, _BLUR, None] < 0, -1.0, 1.0)  # the model has |blur|
    jacobian[..., _BLUR] = -scale * (at_low * low - at_high * high) * turned
    jacobian[..., _CONTRAST] = -light * inside
    jacobian[..., _GROUND] = by_light * (1 - contrast * inside)[..., None]
    return light * (1 - contrast * inside), jacobian


def _regress(fit: OutlineFit, origins: Array, spacing: float) -> Micrometer:
    """Number the lines and fit equal divisions to their places."""
    angle = float(np.median(fit.parameters[:, _ANGLE]))
    normal = np.array([np.cos(angle), np.sin(angle)])
    points = origins + fit.parameters[:, _OFFSET, None] * normal
    place = points @ normal
    sigma = np.sqrt(fit.covariance[:, _OFFSET, _OFFSET])
    order = np.argsort(place)
    points, place, sigma = points[order], place[order], sigma[order]
    divisions = np.concatenate([[0], np.cumsum(np.round(np.diff(place) / spacing))]).astype(int)
    if len(np.unique(divisions)) < len(divisions) or len(place) < _LEAST_PRESENT * divisions[-1]:
        raise _Unlike(f"{len(place)} lines on {divisions[-1] + 1} places")
    design = np.column_stack([np.ones(len(place)), divisions])
    weighted = design / sigma[:, None]
    inverse = np.linalg.inv(weighted.T @ weighted)
    best = inverse @ weighted.T @ (place / sigma)
    residual = place - design @ best
    freedom = len(place) - 2
    rms = float(np.sqrt((residual**2).sum() / freedom))
    if rms > max(_MOST_RESIDUAL * best[1], _EXPLAINED * np.sqrt((sigma**2).mean())):
        raise _Unlike(f"lines {rms / best[1]:.2g} divisions beside equal ones")
    misfit = float(np.sqrt(((residual / sigma) ** 2).sum() / freedom))
    own = float(np.sqrt(inverse[1, 1])) * max(misfit, 1.0)
    return Micrometer(points, divisions, sigma, float(best[1]), own, angle, misfit)
