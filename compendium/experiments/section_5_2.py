"""Section 5.2: photograph each microscope of Table 5.1, calibrate, and see what comes back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t as student

from compendium import thesis
from compendium.experiments._processes import in_processes
from compendium.ledger import claim
from microlib.calibration import (
    Calibration,
    Detection,
    calibrate,
    detect_circles,
    detect_squares,
)
from microlib.microscope import Microscope, undistort
from microlib.synthetic import ImagingConditions, render_circles, render_squares

#: Assumed: standard deviations of the point-spread function (px) and of the noise (grey levels).
IMAGING = ImagingConditions(blur=1.0, noise=2.0)
#: What the intervals are counted for, by the library's names and those of Table 5.1.
COVERED = {
    "magnification": "M",
    "distortion": "κ",
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "tx": "T_x",
    "ty": "T_y",
}
#: Name in Table 5.1: name in the library, factor to the printed unit, found with f given?
RECOVERED = {
    "T_op": ("tube_length", 1.0, False),
    "f": ("focal_length", 1.0, False),
    "kappa": ("distortion", 1.0, True),
    "alpha": ("alpha", 180 / np.pi, True),
    "beta": ("beta", 180 / np.pi, True),
    "gamma": ("gamma", 180 / np.pi, True),
    "T_x": ("tx", 1.0, True),
    "T_y": ("ty", 1.0, True),
}
SENSOR: dict[str, Any] = {"pixel_size": thesis.BASLER_CELL, "image_size": thesis.BASLER_IMAGE_SIZE}


@dataclass(frozen=True)
class CalibrationDraw:
    """One photograph of a pattern, calibrated twice.

    Attributes
    ----------
    with_f, without_f : Calibration
        With the focal length given, as in the thesis, and without.
    world : ndarray, shape (N, 2)
        Points of the pattern that were found, µm.
    errors : ndarray, shape (N, 2)
        Detected minus true image points, px.
    """

    with_f: Calibration
    without_f: Calibration
    world: NDArray
    errors: NDArray


def photograph(column: str, rng: np.random.Generator) -> NDArray:
    """Return a rendered image of the pattern of a column of Table 5.1, in grey levels."""
    scope, pitch = thesis.microscope(column), thesis.pattern_pitch(column)
    if column.startswith("circle"):
        return render_circles(scope, pitch=pitch, imaging=IMAGING, rng=rng)
    return render_squares(scope, side=pitch, imaging=IMAGING, rng=rng)


def find(column: str, image: NDArray) -> Detection:
    """Return the points of a photograph.

    Which way the pattern lies is told to within 45°, and whether it is seen from behind.
    """
    detect = detect_circles if column.startswith("circle") else detect_squares
    alpha, gamma = (np.deg2rad(thesis.table_5_1(column, name)) for name in ("alpha", "gamma"))
    return detect(image, direction=alpha, mirrored=bool(np.cos(gamma) < 0))


def world_points(column: str, found: Detection) -> NDArray:
    """Return the points of the pattern in µm; one known point says where the grid's origin is."""
    pitch = thesis.pattern_pitch(column)
    first = thesis.microscope(column).back_project(found.points[:1]) / pitch
    return (found.grid + np.round(first - found.grid[:1])) * pitch


def examples(seed: int) -> dict[str, tuple[NDArray, Detection]]:
    """Return one photograph of each column of Table 5.1 and what is found in it (figure 5.2)."""
    return dict(
        zip(
            thesis.COLUMNS,
            in_processes(_example, [(column, seed) for column in thesis.COLUMNS]),
            strict=True,
        )
    )


def _example(column: str, seed: int) -> tuple[NDArray, Detection]:
    image = photograph(column, np.random.default_rng([seed, 0]))
    return image, find(column, image)


def calibration_draws(seed: int, draws: int) -> dict[str, list[CalibrationDraw]]:
    """Photograph and calibrate every microscope of Table 5.1 several times.

    Parameters
    ----------
    seed : int
        Of the noise.
    draws : int
        Photographs of each column.

    Returns
    -------
    dict of str to list of CalibrationDraw
        By column.
    """
    columns = list(thesis.COLUMNS)
    each = [(column, [seed, k, draw]) for k, column in enumerate(columns) for draw in range(draws)]
    found = in_processes(calibration_draw, each)
    return {column: found[k * draws : (k + 1) * draws] for k, column in enumerate(columns)}


def calibration_draw(column: str, seed: int | list[int]) -> CalibrationDraw:
    """Photograph the pattern of a column of Table 5.1 and calibrate from nothing but the pixels."""
    found = find(column, photograph(column, np.random.default_rng(seed)))
    world = world_points(column, found)
    groups = found.group if column.startswith("square") else None
    focal_length = thesis.table_5_1(column, "f")
    return CalibrationDraw(
        calibrate(world, found.points, focal_length=focal_length, groups=groups, **SENSOR),
        calibrate(world, found.points, groups=groups, **SENSOR),
        world,
        found.points - thesis.microscope(column).project(world),
    )


def over_draws(values: ArrayLike) -> tuple[float, tuple[float, float]]:
    """Return the mean, and the 95 % interval in which one more normal draw would fall.

    Examples
    --------
    >>> mean, (low, high) = over_draws([1.0, 2.0, 3.0])
    >>> mean, round(high, 3)
    (2.0, 6.968)
    """
    x = np.asarray(values, dtype=float)
    reach = student.ppf(0.975, len(x) - 1) * x.std(ddof=1) * np.sqrt(1 + 1 / len(x))
    return float(x.mean()), (float(x.mean() - reach), float(x.mean() + reach))


def recovered_parameters(draws: dict[str, list[CalibrationDraw]]) -> pd.DataFrame:
    """Return Table 5.1 as the images give it back.

    Returns
    -------
    pandas.DataFrame
        A row each entry: column, parameter (its name in the table), mean, and the ends low and high
        of the interval of `over_draws`, in the printed unit.
    """
    rows = []
    for column, several in draws.items():
        for name, (field, factor, given) in RECOVERED.items():
            fits = [draw.with_f if given else draw.without_f for draw in several]
            values = factor * np.array([getattr(fit.microscope, field) for fit in fits])
            if name == "gamma":
                values %= 360
            mean, (low, high) = over_draws(values)
            rows.append((column, name, mean, low, high))
    return pd.DataFrame(rows, columns=["column", "parameter", "mean", "low", "high"])


def pattern_errors(draws: dict[str, list[CalibrationDraw]]) -> pd.DataFrame:
    """Return Table 5.2 as the images give it: distances on the pattern.

    Returns
    -------
    pandas.DataFrame
        A row each entry: column, statistic (mean, std, max), value, and the ends low and high of
        the interval of `over_draws`, µm.
    """
    rows = []
    for column, several in draws.items():
        for statistic in ("mean", "std", "max"):
            values = [getattr(draw.with_f.plane_error, statistic) for draw in several]
            mean, (low, high) = over_draws(values)
            rows.append((column, statistic, mean, low, high))
    return pd.DataFrame(rows, columns=["column", "statistic", "value", "low", "high"])


def beside_print(errors: pd.DataFrame) -> pd.DataFrame:
    """Return Table 5.2 as printed beside `pattern_errors`, and the largest possible spread.

    Numbers between 0 and m with the mean a have a variance of at most a (m − a), whatever they are.

    Parameters
    ----------
    errors : pandas.DataFrame
        From `pattern_errors`.

    Returns
    -------
    pandas.DataFrame
        A row each column of the table, µm.
    """
    rows = []
    for column, several in errors.groupby("column", sort=False):
        row: dict[str, Any] = {"column": thesis.COLUMNS[str(column)]}
        for entry in several.itertuples():
            row[f"{entry.statistic}, printed"] = claim(
                f"table-5.2/{column}/{entry.statistic}"
            ).value
            row[f"{entry.statistic}, ours"] = entry.value
        mean, largest = row["mean, printed"], row["max, printed"]
        rows.append(row | {"largest std possible": np.sqrt(mean * (largest - mean))})
    return pd.DataFrame(rows)


def coverage(draws: dict[str, list[CalibrationDraw]], seed: int, runs: int) -> pd.DataFrame:
    """Count how often the stated 95 % intervals contain the truth.

    Parameters
    ----------
    draws : dict of str to list of CalibrationDraw
        The first of each column gives the points and the size of the noise.
    seed : int
        Of the noise on exact points.
    runs : int
        Calibrations of each column.

    Returns
    -------
    pandas.DataFrame
        A row each column: its title, points, noise (px), and the share in per cent for each
        parameter and for all of them.
    """
    each = [(column, *_first(several), seed, runs) for column, several in draws.items()]
    rows = [
        (thesis.COLUMNS[column], len(world), noise, *100 * inside.mean(axis=0), 100 * inside.mean())
        for (column, world, noise, *_), inside in zip(
            each, in_processes(_covered, each), strict=True
        )
    ]
    return pd.DataFrame(rows, columns=["column", "points", "noise (px)", *COVERED.values(), "all"])


def _first(several: list[CalibrationDraw]) -> tuple[NDArray, float]:
    return several[0].world, float(several[0].errors.std())


def _covered(column: str, world: NDArray, noise: float, seed: int, runs: int) -> NDArray:
    """Return whether an interval holds the truth, a row each run, a column each parameter."""
    truth = thesis.microscope(column)
    # In focus, so that the truth is of the model that is fitted, at the scale that the image has.
    truth = replace(
        truth,
        tube_length=truth.magnification * truth.focal_length,
        distance=truth.focal_length / truth.magnification,
    )
    exact = truth.project(world)
    expected = np.array([getattr(truth, name) for name in COVERED])
    rng = np.random.default_rng([seed, 9])
    inside = []
    for _ in range(runs):
        seen = exact + rng.normal(0, noise, exact.shape)
        fit = calibrate(world, seen, focal_length=truth.focal_length, **SENSOR)
        low, high = np.transpose([fit.interval(name) for name in COVERED])
        inside.append((low <= expected) & (expected <= high))
    return np.array(inside)


def blur_study(seed: int, blurs: ArrayLike) -> pd.DataFrame:
    """Measure circles and squares at a pitch of 30 px under ever more blur.

    Parameters
    ----------
    seed : int
        Of the noise.
    blurs : array_like
        Standard deviations of the point-spread function, px.

    Returns
    -------
    pandas.DataFrame
        RMS error of a coordinate in px, a row each blur: of the two detectors, and of OpenCV's
        ``cornerSubPix`` started at the corners of the second.
    """
    sigmas = np.asarray(blurs, dtype=float)
    rows = in_processes(_blurred_errors, [(seed, float(sigma)) for sigma in sigmas])
    names = ["circles", "squares", "squares, cornerSubPix"]
    return pd.DataFrame(rows, columns=names, index=pd.Index(sigmas, name="blur (px)"))


def _blurred_errors(seed: int, blur: float) -> tuple[float, float, float]:
    scope = Microscope(
        2e5,
        1e5,
        5e4,
        alpha=0.1,
        tx=-700,
        ty=-560,
        pixel_size=thesis.BASLER_CELL,
        image_size=(320, 260),
    )
    pitch = 30 * thesis.BASLER_CELL / scope.magnification
    rng = np.random.default_rng(seed)
    look = replace(IMAGING, blur=blur)

    def rms_error(points: NDArray) -> float:
        grid = np.round(scope.back_project(points) / pitch)
        return float(np.sqrt(np.mean((points - scope.project(grid * pitch)) ** 2)))

    image = render_circles(
        scope, radius=pitch / 4, pitch=pitch, counts=(8, 7), imaging=look, rng=rng
    )
    centers = detect_circles(image).points
    image = render_squares(scope, side=pitch, counts=(4, 4), imaging=look, rng=rng)
    corners = detect_squares(image).points
    local = cv2.cornerSubPix(
        np.round(image).astype(np.uint8),
        corners.astype(np.float32)[:, None].copy(),
        (5, 5),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4),
    )
    return rms_error(centers), rms_error(corners), rms_error(local[:, 0].astype(float))


def corner_shift(column: str) -> float:
    """Return by how much the distortion of Table 5.1 moves a corner of the image, px."""
    corner = np.array(thesis.BASLER_IMAGE_SIZE) * thesis.BASLER_CELL / 2
    moved = undistort(corner, thesis.table_5_1(column, "kappa")) - corner
    return float(np.hypot(*moved)) / thesis.BASLER_CELL
