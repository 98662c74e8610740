"""Section 5.2: photograph each microscope of Table 5.1, calibrate, and see what comes back."""

from __future__ import annotations

from collections.abc import Mapping
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
    """Return the points of a photograph; which pattern it shows is all that is told."""
    detect = detect_circles if column.startswith("circle") else detect_squares
    return detect(image)


def printed_labels(column: str, found: Detection, like: Microscope | None = None) -> NDArray:
    """Return the points of the pattern in µm, labeled so that the pose is the most like the print.

    An unmarked lattice looks the same after a quarter turn, after a step, and from behind. All
    labels fit its image equally well, and the detector takes one of them by its own rule. The
    microscope is calibrated with that one; of those that fit as well, the one whose pose is nearest
    to the print is returned, so that the two can be compared.

    Parameters
    ----------
    column : str
        One of `thesis.COLUMNS`.
    found : Detection
        From `find`.
    like : Microscope, optional
        Whose pose to be near to; that of Table 5.1 by default. Only which label is the nearest
        matters.

    Returns
    -------
    ndarray, shape (N, 2)
        World points, µm.
    """
    like = thesis.microscope(column) if like is None else like
    pitch = thesis.pattern_pitch(column)
    # The same image gives the same pose to within its noise whatever the loss and the groups.
    blind = calibrate(
        found.grid * pitch, found.points, focal_length=thesis.table_5_1(column, "f"), **SENSOR
    ).microscope
    axes = blind.rotation[:, :2]
    signs = [np.diag(each) for each in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    turns = [sign @ swap for sign in signs for swap in (np.eye(2), np.eye(2)[::-1])]
    turn = max(turns, key=lambda each: float(np.sum(axes @ each * like.rotation[:, :2])))
    apart = (like.translation - blind.translation)[:2]
    steps = np.linalg.solve(axes[:2], apart) / pitch
    if column.startswith("square"):  # squares fall on squares, not on the gaps between them
        odd = turn.sum(axis=1) < 0
        steps = odd + 2 * np.round((steps - odd) / 2)
    return pitch * (found.grid - np.round(steps)) @ turn


def turned_over(column: str, found: Detection) -> tuple[float, float]:
    """Label a photograph as if the pattern lay the other side up, and calibrate it again.

    Parameters
    ----------
    column : str
        One of `thesis.COLUMNS`.
    found : Detection
        From `find`.

    Returns
    -------
    gamma : float
        γ with the other labels, degrees from 0 to 360.
    residual : float
        RMS residual with the other labels over that with those of the print.
    """
    front = thesis.microscope(column)
    both = [front, replace(front, gamma=front.gamma + np.pi)]
    fits = [
        calibrate(
            printed_labels(column, found, like),
            found.points,
            focal_length=front.focal_length,
            **SENSOR,
        )
        for like in both
    ]
    gamma = float(np.rad2deg(fits[1].microscope.gamma) % 360)
    return gamma, fits[1].reprojection.rms / fits[0].reprojection.rms


def dependent_entries(column: str) -> dict[str, float]:
    """Return what Table 5.1's lengths T_op, f and d say of its entries M, d and T_z.

    M = T_op/f (2.12), d = f²/T_op (2.20) and T_z = f + d (2.8); lengths in µm.

    Examples
    --------
    >>> round(dependent_entries("circle-1X")["T_z"])
    204900
    """
    t_op, f, d = (thesis.table_5_1(column, name) for name in ("T_op", "f", "d"))
    return {"M": t_op / f, "d": f**2 / t_op, "T_z": f + d}


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
    """Photograph the pattern of a column of Table 5.1, find its points, and calibrate.

    What goes in beside the pixels is what the user of a microscope has: which pattern it is, its
    pitch, the sensor and, for the first of the two calibrations, the focal length. The print
    chooses among labels that fit equally well, see `printed_labels`.
    """
    found = find(column, photograph(column, np.random.default_rng(seed)))
    world = printed_labels(column, found)
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


def over_positive_draws(values: ArrayLike) -> tuple[float, tuple[float, float]]:
    """Return geometric mean and interval as `over_draws` does, of the logarithms.

    For what cannot be negative, whose interval then cannot be either.

    Examples
    --------
    >>> mean, (low, high) = over_positive_draws([1.0, 2.0, 4.0])
    >>> round(mean, 6), round(low, 3), round(high, 1)
    (2.0, 0.064, 62.6)
    """
    mean, (low, high) = over_draws(np.log(np.asarray(values, dtype=float)))
    return float(np.exp(mean)), (float(np.exp(low)), float(np.exp(high)))


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
        the interval of `over_positive_draws`, µm.
    """
    rows = []
    for column, several in draws.items():
        for statistic in ("mean", "std", "max"):
            values = [getattr(draw.with_f.plane_error, statistic) for draw in several]
            value, (low, high) = over_positive_draws(values)
            rows.append((column, statistic, value, low, high))
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


def printed_means() -> dict[str, float]:
    """Return the mean errors that Table 5.2 prints by column, µm."""
    return {column: claim(f"table-5.2/{column}/mean").value for column in thesis.COLUMNS}


def squares_over_circles(means: Mapping[str, float]) -> float:
    """Return by how much the mean error with squares is larger, at the zoom where it is the least.

    Parameters
    ----------
    means : mapping of str to float
        Mean errors by column of Table 5.2, µm.

    Examples
    --------
    >>> squares_over_circles(
    ...     {"circle-1X": 1.0, "square-1X": 3.0, "circle-4X": 1.0, "square-4X": 0.5}
    ... )
    0.5
    """
    return min(means[f"square-{zoom}"] / means[f"circle-{zoom}"] for zoom in thesis.ZOOMS)


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
