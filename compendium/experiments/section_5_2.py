"""Section 5.2: photograph each microscope of Table 5.1, calibrate, and see what comes back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from compendium import thesis
from compendium.ledger import claim
from microlib.calibration import Calibration, Detection, calibrate, detect_circles, detect_squares
from microlib.microscope import Microscope
from microlib.synthetic import ImagingConditions, render_circles, render_squares

#: Assumed: standard deviations of the point-spread function (px) and of the noise (grey levels).
IMAGING = ImagingConditions(blur=1.0, noise=2.0)
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
SENSOR: dict[str, Any] = {
    "pixel_pitch": thesis.BASLER_PIXEL_PITCH,
    "image_size": thesis.BASLER_IMAGE_SIZE,
}


@dataclass(frozen=True, eq=False)
class Photograph:
    """A rendered image of a pattern, and calibrations from its points.

    Attributes
    ----------
    image : ndarray, shape (height, width)
        Grey levels.
    found : Detection
        Its points.
    images : int
        Number of images whose errors are drawn: more than this one if it has few marks.
    with_f, without_f : list of Calibration
        From true points with errors drawn anew from those of the images: with the focal length
        given, as in the thesis, and without.
    """

    image: NDArray
    found: Detection
    images: int
    with_f: list[Calibration]
    without_f: list[Calibration]


#: Marks whose errors are measured at least. Six circles of one image can err to one side by chance,
#: so more images of them are taken.
LEAST_MARKS = 30


def photograph(column: str, seed: int | list[int], draws: int) -> Photograph:
    """Render the pattern of a column of Table 5.1, find its points, and calibrate `draws` times.

    What goes in beside the pixels is what the user of a microscope has: which pattern it is, its
    pitch, the sensor and, for the first calibrations, the focal length. The thesis' pose chooses
    among labels that fit equally well, see `printed_labels`. The errors of a square's corners are
    drawn together, because they share its sides.
    """
    rng, scope = np.random.default_rng(seed), thesis.microscope(column)
    corners = 4 if column.startswith("square") else 1
    images, errors = [], np.empty((0, corners, 2))
    while len(errors) < LEAST_MARKS:
        image, found = render(column, rng)
        world = printed_labels(column, found, scope)
        order = np.argsort(found.group, kind="stable") if corners > 1 else np.arange(len(world))
        off = found.points - scope.project(world)
        errors = np.concatenate([errors, off[order].reshape(-1, corners, 2)])
        images.append((image, found, world, order))
    image, found, world, order = images[0]
    f = thesis.table_5_1(column, "f")
    with_f, without_f = [], []
    for _ in range(draws):
        seen = scope.project(world)
        chosen = rng.integers(len(errors), size=len(world) // corners)
        seen[order] += errors[chosen].reshape(-1, 2)
        with_f.append(calibrate(world, seen, focal_length=f, **SENSOR))
        without_f.append(calibrate(world, seen, **SENSOR))
    return Photograph(image, found, len(images), with_f, without_f)


def render(column: str, rng: np.random.Generator) -> tuple[NDArray, Detection]:
    """Return an image of the pattern of a column of Table 5.1, in grey levels, and its points."""
    scope, pitch = thesis.microscope(column), thesis.pattern_pitch(column)
    if column.startswith("circle"):
        image = render_circles(scope, pitch=pitch, imaging=IMAGING, rng=rng)
        return image, detect_circles(image)
    image = render_squares(scope, side=pitch, imaging=IMAGING, rng=rng)
    return image, detect_squares(image)


def photographs(seed: int, draws: int) -> dict[str, Photograph]:
    """Return a `photograph` of each column of Table 5.1."""
    return {c: photograph(c, [seed, k], draws) for k, c in enumerate(thesis.COLUMNS)}


def printed_labels(column: str, found: Detection, like: Microscope) -> NDArray:
    """Return the points of the pattern in µm, labeled so that the pose is most like Table 5.1.

    An unmarked lattice looks the same after a quarter turn, after a step, and from behind. All
    labels fit its image equally well, and the detector takes one of them by its own rule. The
    microscope is calibrated with that one; of those that fit as well, the one whose pose is nearest
    to Table 5.1 is returned, so that the two can be compared.

    Parameters
    ----------
    column : str
        One of `thesis.COLUMNS`.
    found : Detection
        The points of its image.
    like : Microscope
        Whose pose to be near to: that of Table 5.1. Only which label is the nearest matters.

    Returns
    -------
    ndarray, shape (N, 2)
        World points, µm.
    """
    pitch, f = thesis.pattern_pitch(column), thesis.table_5_1(column, "f")
    blind = calibrate(found.grid * pitch, found.points, focal_length=f, **SENSOR).microscope
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


def dependent_entries(column: str) -> dict[str, tuple[float, float]]:
    """Return what Table 5.1's lengths T_op, f and d say of its entries M and T_z, with rounding.

    M = T_op/f (2.12) and T_z = f + d (2.8); lengths in µm. The second number of each is what the
    rounding of the lengths, of which five digits are known, changes in 95 % of random draws.

    Examples
    --------
    >>> from compendium.experiments.section_5_2 import dependent_entries
    >>> T_z, rounding = dependent_entries("circle-1X")["T_z"]
    >>> round(T_z), round(rounding)
    (204900, 5)
    """
    lengths = np.array([thesis.table_5_1(column, name) for name in ("T_op", "f", "d")])
    half_units = 0.5 * 10.0 ** (np.floor(np.log10(lengths)) - 4)
    drawn = lengths + half_units * np.random.default_rng(0).uniform(-1, 1, (10_000, 3))
    formulas = {
        "M": lambda t_op, f, d: t_op / f,
        "T_z": lambda t_op, f, d: f + d,
    }
    entries = {}
    for name, follow in formulas.items():
        value = follow(*lengths)
        entries[name] = float(value), float(np.quantile(np.abs(follow(*drawn.T) - value), 0.95))
    return entries


def over_draws(values: ArrayLike, images: int) -> tuple[float, float, float]:
    """Return the mean, and the ends of the 95 % interval in which one more image would fall.

    Parameters
    ----------
    values : array_like
        Normal draws, from the errors of the images.
    images : int
        How many; the mean is known as well as they know it.

    Examples
    --------
    >>> from compendium.experiments.section_5_2 import over_draws
    >>> mean, low, high = over_draws([1.0, 2.0, 3.0], images=3)
    >>> mean, round(high, 3)
    (2.0, 6.968)
    """
    x = np.asarray(values, dtype=float)
    reach = stdtrit(len(x) - 1, 0.975) * x.std(ddof=1) * np.sqrt(1 + 1 / images)
    return float(x.mean()), float(x.mean() - reach), float(x.mean() + reach)


def table_5_1(taken: Mapping[str, Photograph]) -> pd.DataFrame:
    """Return Table 5.1 as the images and the printed lengths give it.

    Returns
    -------
    pandas.DataFrame
        A row each entry: claim, value, the ends low and high in the printed unit, from `over_draws`
        for an input, and whether it is an input; the others are `dependent_entries`.
    """
    rows: list[tuple] = []
    for column, photo in taken.items():
        follows = dependent_entries(column)
        for name in ("M", *RECOVERED, "T_z"):
            if name in follows:
                value, rounding = follows[name]
                found = value, value - rounding, value + rounding
            else:
                field, factor, given = RECOVERED[name]
                fits = photo.with_f if given else photo.without_f
                values = factor * np.array([getattr(fit.microscope, field) for fit in fits])
                found = over_draws(values % 360 if name == "gamma" else values, photo.images)
            rows.append((f"table-5.1/{column}/{name}", *found, name in RECOVERED))
    return pd.DataFrame(rows, columns=["claim", "value", "low", "high", "input"])


def pattern_errors(taken: Mapping[str, Photograph]) -> pd.DataFrame:
    """Return Table 5.2 as the images give it: distances on the pattern, µm.

    Returns
    -------
    pandas.DataFrame
        A row each entry: claim, value (the mean), and the ends low and high. Distances are not
        negative, so means and intervals are those of their logarithms.
    """
    rows = []
    for column, photo in taken.items():
        for statistic in ("mean", "std", "max"):
            values = [getattr(fit.plane_error, statistic) for fit in photo.with_f]
            found = np.exp(over_draws(np.log(values), photo.images))
            rows.append((f"table-5.2/{column}/{statistic}", *found.tolist()))
    return pd.DataFrame(rows, columns=["claim", "value", "low", "high"])


def printed_means() -> dict[str, float]:
    """Return the mean errors that Table 5.2 prints by column, µm."""
    return {column: claim(f"table-5.2/{column}/mean").value for column in thesis.COLUMNS}


def in_pixels(column: str, distance: float) -> float:
    """Return how many pixels a distance on the pattern (µm) is in the image of a column.

    Examples
    --------
    >>> from compendium.experiments.section_5_2 import in_pixels
    >>> round(in_pixels("circle-1X", 0.2202), 3)
    0.035
    """
    return distance * thesis.table_5_1(column, "M") / thesis.BASLER_PIXEL_PITCH


def squares_over_circles(means: Mapping[str, float]) -> float:
    """Return by how much the mean error with squares is larger, at the zoom where it is the least.

    Parameters
    ----------
    means : mapping of str to float
        Mean errors by column of Table 5.2, µm.

    Examples
    --------
    >>> from compendium.experiments.section_5_2 import squares_over_circles
    >>> squares_over_circles(
    ...     {"circle-1X": 1.0, "square-1X": 3.0, "circle-4X": 1.0, "square-4X": 0.5}
    ... )
    0.5
    """
    return min(means[f"square-{zoom}"] / means[f"circle-{zoom}"] for zoom in thesis.ZOOMS)


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
    size: dict[str, Any] = {"pixel_pitch": thesis.BASLER_PIXEL_PITCH, "image_size": (320, 260)}
    scope = Microscope(2e5, 1e5, 5e4, alpha=0.1, tx=-700, ty=-560, **size)
    pitch = 30 * thesis.BASLER_PIXEL_PITCH / scope.magnification
    names = ["circles", "squares", "squares, cornerSubPix"]
    table = pd.DataFrame(index=pd.Index(np.asarray(blurs, float), name="blur (px)"), columns=names)
    for blur in table.index:
        how: dict[str, Any] = {"imaging": replace(IMAGING, blur=blur)}
        how["rng"] = np.random.default_rng(seed)
        discs = render_circles(scope, radius=pitch / 4, pitch=pitch, counts=(8, 7), **how)
        image = render_squares(scope, side=pitch, counts=(4, 4), **how)
        corners = detect_squares(image).points
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        start = corners.astype(np.float32)[:, None].copy()
        grey = np.round(image).astype(np.uint8)
        local = cv2.cornerSubPix(grey, start, (5, 5), (-1, -1), stop)[:, 0].astype(float)
        for name, points in zip(names, (detect_circles(discs).points, corners, local), strict=True):
            grid = np.round(scope.back_project(points) / pitch)
            off = points - scope.project(grid * pitch)
            table.loc[blur, name] = np.sqrt(np.mean(off**2))
    return table.astype(float)
