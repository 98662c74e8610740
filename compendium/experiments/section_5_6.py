"""Section 5.6: from Table 5.5 and from rendered images of an embryo to its modulus.

The dimples of the thesis are steeper than its model allows: what computes a modulus or a force here
warns of it with `microlib.membrane.SmallSlopeWarning`, as the library does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, linprog
from scipy.stats import chi2

from compendium import thesis
from compendium.ledger import claim, half_ulp
from microlib.embryo import (
    Boundary,
    GaussianSum,
    dimple_geometry,
    fit_gaussians,
    loess,
    modulus_from_image,
)
from microlib.synthetic import Embryo, EmbryoImage, embryo_image

#: Modulus of the rendered embryos: that of Table 5.6, MPa.
MODULUS = claim("table-5.6/E").value
#: What is read off the curve of Table 5.5: rim x_1, y_1 and bottom x_2, y_2 (px), modulus E (MPa).
READ = ("x_1", "y_1", "x_2", "y_2", "E")
#: Changes whose differences give the effects of the rounding, in half units: 0.01 and 1 give the
#: same least share to 1e-10.
_STEPS = 0.1 * np.eye(24)


def read_off(units: ArrayLike = 0.0) -> NDArray:
    """Return what `READ` names of Table 5.5, moved within its rounding.

    Parameters
    ----------
    units : array_like, shape (24,)
        Changes of a1 … a8, b1 … b8, c1 … c8, in half units of the last printed place.
    """
    names = [f"table-5.5/{letter}{i}" for letter in "abc" for i in range(1, 9)]
    half = np.array([half_ulp(claim(name).printed) for name in names])
    printed = thesis.outline_curve()
    values = np.concatenate([printed.amplitudes, printed.centers, printed.widths])
    amplitudes, centers, widths = (values + half * np.asarray(units)).reshape(3, 8)
    curve = GaussianSum(amplitudes, centers, widths, domain=thesis.OUTLINE_DOMAIN)
    dimple = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL)
    modulus = thesis.modulus(dimple.rim_radius, dimple.dimple_depth)
    return np.array([*dimple.rim, *dimple.bottom, modulus])


def rounding_draws(seed: int, draws: int) -> pd.DataFrame:
    """Draw Table 5.5 within its printed rounding: a row each draw, a column each of `READ`."""
    units = np.random.default_rng(seed).uniform(-1, 1, (draws, 24))
    return pd.DataFrame([read_off(each) for each in units], columns=READ)


@dataclass(frozen=True, eq=False)
class RoundingReach:
    """What the printed rounding of Table 5.5 can do to what is read off its curve.

    Attributes
    ----------
    share : float
        Least share of that half unit within which all 24 coefficients have to move for the four
        coordinates to come out as printed together; no rounding gives more than 1.
    units : ndarray, shape (24,)
        How they then move, in half units.
    chi_squared, p : float
        Of the four printed coordinates about the computed ones, and how often evenly distributed
        rounding gives more, as if it were Gaussian.
    """

    share: float
    units: NDArray
    chi_squared: float
    p: float


def rounding_reach() -> RoundingReach:
    """Judge the four printed coordinates of section 5.6 together."""
    entries = [claim(f"section-5.6/{name}") for name in READ[:4]]
    printed = np.array([entry.value for entry in entries])
    half = np.array([half_ulp(entry.printed) for entry in entries])
    effects = _effects(np.zeros(24))
    # An even distribution has a third of its half-width's square as its variance.
    covariance = (effects @ effects.T + np.diag(half**2)) / 3
    apart = printed - read_off()[:4]
    chi_squared = float(apart @ np.linalg.solve(covariance, apart))
    # The least largest |unit| that brings each coordinate to within `half` of the printed one.
    one, none, cost = np.ones((24, 1)), np.zeros((4, 1)), np.append(np.zeros(24), 1.0)
    units, share = np.zeros(24), 0.0
    for _ in range(3):  # three linear programs leave 1e-11 px of the coordinates, two 3e-6 px
        slopes = _effects(units)
        wanted = printed - read_off(units)[:4] + slopes @ units
        bounds = np.block(
            [[slopes, none], [-slopes, none], [np.eye(24), -one], [-np.eye(24), -one]]
        )
        limits = np.concatenate([wanted + half, half - wanted, np.zeros(48)])
        found = linprog(cost, A_ub=bounds, b_ub=limits, bounds=(None, None)).x
        units, share = found[:-1], float(found[-1])
    return RoundingReach(share, units, chi_squared, float(chi2.sf(chi_squared, 4)))


def _effects(units: NDArray) -> NDArray:
    """Return the change of each coordinate for one half unit of each coefficient, 4×24."""
    return np.transpose([(read_off(units + s) - read_off(units - s))[:4] / 0.2 for s in _STEPS])


def printed_dimple() -> tuple[float, float]:
    """Return radius a and depth w_d by (5.3) from the printed coordinates of rim and bottom, µm."""
    x1, y1, x2, y2 = (claim(f"section-5.6/{name}").value for name in ("x_1", "y_1", "x_2", "y_2"))
    return thesis.EMBRYO_PIXEL * abs(x2 - x1), thesis.EMBRYO_PIXEL * abs(y2 - y1)


def right_dimple() -> tuple[float, float]:
    """Return radius and depth of the printed outline from the highest point of its right rim, µm.

    The right rim of (5.1) has two maxima, split by a dip of about one pixel. The higher one is the
    counterpart of the left rim, which is the highest point on its side.
    """
    curve = thesis.outline_curve()
    maxima, _ = curve.extrema()
    x2, y2 = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL).bottom
    right = maxima[maxima > x2]
    x1 = float(right[curve(right).argmax()])
    return thesis.EMBRYO_PIXEL * (x1 - x2), thesis.EMBRYO_PIXEL * (float(curve(x1)) - y2)


def probe_half_widths(*, coordinates: bool = False) -> tuple[float, float]:
    """Return the half-widths (µm) between which (5.2) gives Table 5.6 within its rounding.

    They are the largest and the smallest that radius, depth, force and modulus allow, each off by
    half a unit in its last printed place. With `coordinates`, radius and depth must also agree with
    the printed coordinates of rim and bottom.
    """
    ends = {}
    for name in ("a", "w_d", "F", "E"):
        entry = claim(f"table-5.6/{name}")
        ends[name] = entry.value + half_ulp(entry.printed) * np.array([-1, 1])
    if coordinates:
        # A length is the difference of two coordinates.
        rounding = [2 * half_ulp(claim(f"section-5.6/{one}").printed) for one in ("x_1", "y_1")]
        for name, length, px in zip(("a", "w_d"), printed_dimple(), rounding, strict=True):
            reach = thesis.EMBRYO_PIXEL * px * np.array([-1, 1])
            ends[name] = np.clip(ends[name], *(length + reach))

    def excess(half_width: float, last: int) -> float:
        # (5.2) grows with a and F and falls with w_d and c.
        a, force = ends["a"][last], ends["F"][last]
        w_d, modulus = ends["w_d"][1 - last], ends["E"][1 - last]
        return thesis.modulus(a, w_d, force=force, probe_half_width=half_width) - modulus

    low, high = (float(brentq(excess, 1.0, 200.0, args=(last,))) for last in (0, 1))
    return low, high


def rendered_embryo(rng: np.random.Generator) -> EmbryoImage:
    """Render the embryo of Table 5.6 as the Sony camera would see it under uneven light."""
    embryo = Embryo(
        modulus=MODULUS,
        force=thesis.FORCE,
        rim_radius=claim("table-5.6/a").value,
        **thesis.MEMBRANE,
    )
    return embryo_image(embryo, rng=rng, pixel_size=thesis.EMBRYO_PIXEL, unevenness=0.15)


def smooth_outline(boundary: Boundary) -> tuple[NDArray, GaussianSum]:
    """Smooth an outline as the thesis does: LOESS of the second degree, then eight Gaussians.

    Parameters
    ----------
    boundary : Boundary
        Of a dimple under a probe.

    Returns
    -------
    columns : ndarray, shape (N,)
        Those within two radii of the dimple, read off the rim on the left; px.
    curve : GaussianSum
        Heights above the lowest of them, px: Gaussians die away to zero.
    """
    middle = boundary.probe.tip[0]
    rim = boundary.x[np.where(boundary.x < middle, boundary.y, -np.inf).argmax()]
    first = np.ceil(max(boundary.x[0], middle - 2 * (middle - rim)))
    last = np.floor(min(boundary.x[-1], middle + 2 * (middle - rim)))
    columns = np.arange(first, last + 1)
    height = np.interp(columns, boundary.x, boundary.y)
    smooth = loess(columns, height - height.min(), span=thesis.LOESS_SPAN)
    return columns, fit_gaussians(columns, smooth)


def image_study(rng: np.random.Generator, embryos: int = 5, forces: int = 5) -> pd.DataFrame:
    """Measure one modulus on images of several embryos under several forces, in both ways.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the rims' roundness, of the places and of the noise.
    embryos : int
        Each with its own radius of the rim, around that of Table 5.6.
    forces : int
        From 60 µN (a dimple 70 µm deep) to that of Table 5.6.

    Returns
    -------
    pandas.DataFrame
        A row each image, embryo by embryo: true depth (µm), force (µN), the modulus fitted by the
        profile with the ends low and high of its 95 % interval, and that of the thesis' way (MPa).
    """
    rows = []
    for rim_curvature_radius in rng.uniform(400.0, 500.0, embryos):  # µm
        for load in np.linspace(60.0, thesis.FORCE, forces):
            pressed = Embryo.pressed(
                load, modulus=MODULUS, rim_curvature_radius=rim_curvature_radius, **thesis.MEMBRANE
            )
            place = (rng.uniform(225, 255), rng.uniform(100, 130))
            image = embryo_image(
                pressed, rng=rng, pixel_size=thesis.EMBRYO_PIXEL, shape=(320, 480), center=place
            ).image
            fitted = modulus_from_image(
                image, load, pixel_size=thesis.EMBRYO_PIXEL, **thesis.MEMBRANE
            )
            # The thesis' way: LOESS, (5.1) and (5.3).
            curve = smooth_outline(fitted.boundary)[1]
            dimple = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL)
            by_thesis = thesis.modulus(dimple.rim_radius, dimple.dimple_depth, force=load)
            modulus = fitted.modulus
            row = [pressed.dimple_depth, load, modulus.value, *modulus.interval, by_thesis]
            rows.append(row)
    return pd.DataFrame(rows, columns=["depth", "force", "fitted", "low", "high", "thesis"])


def table_5_7(rng: np.random.Generator, study: pd.DataFrame, draws: int = 4000) -> pd.DataFrame:
    """Predict mean and standard deviation of Table 5.7 from an `image_study`.

    A study is one image at each force. Table 5.6 is the one at the largest force, so that the
    modulus that the chain then reads is the printed one, whatever the truth behind it.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the picks.
    study : pandas.DataFrame
        From `image_study`.
    draws : int
        Studies picked.

    Returns
    -------
    pandas.DataFrame
        A column each statistic (mean, std): its value in each draw, MPa.
    """
    forces = study["force"].nunique()
    by_force = study["thesis"].to_numpy().reshape(-1, forces)
    picks = by_force[rng.integers(0, len(by_force), (draws, forces)), np.arange(forces)]
    picks *= MODULUS / picks[:, -1:]
    return pd.DataFrame({"mean": picks.mean(axis=1), "std": picks.std(axis=1, ddof=1)})
