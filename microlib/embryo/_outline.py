"""Dimple of an outline from a table of points, measured as in section 5.6 of the thesis.

A table of points is read, the part with the dimple is selected, and radius and depth are measured
on eight Gaussians (5.1), (5.3). Their uncertainty includes that of the choice of smoothing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    MICROMETERS,
    Array,
    FlatResult,
    as_array,
    as_scalar,
    check_same_length,
    robust_std,
)
from microlib.embryo._dimple import DimpleGeometry, dimple_geometry, residual_variance
from microlib.embryo._gaussian_sum import GaussianSum, fit_gaussians
from microlib.embryo._loess import loess

#: Spans of LOESS whose dimples are compared. The middle one is that of the thesis. A smaller span
#: follows the corners at the bottom of a dimple and the noise more closely.
SPANS = (0.15, 0.25, 0.35)
#: Largest coordinate, px: above any outline, and far from where squares overflow.
MOST_PIXELS = 1e9
#: Number of parameters of eight Gaussians.
_MIN_POINTS = 24


@dataclass(frozen=True, eq=False, repr=False)
class OutlineTable(FlatResult):
    """Points of an outline, from `read_outline`.

    Attributes
    ----------
    x, y : ndarray, shape (n,)
        Coordinates, in the order of the file.
    pixel_size : float or None
        Unit of x and y, in µm, if the names of the columns contain it.
    y_down : bool
        Whether y points down, as a column called row does.
    """

    _large = ("x", "y")

    x: Array
    y: Array
    pixel_size: float | None
    y_down: bool


def read_outline(path: str | PathLike[str]) -> OutlineTable:
    """Read the points of an outline from a table of text.

    Parameters
    ----------
    path : path-like
        Text in UTF-8 with two columns and no names, or with columns named x and y, or col and row,
        among others. The separator is a comma, semicolon, tab or space. Decimal commas are read if
        the separator is a semicolon or a tab. Empty lines and text after a # are skipped. A name
        may have a unit, such as ``x (px)`` or ``y_um``.

    Returns
    -------
    OutlineTable
        `x` and `y`, shape (n,), in the order of the file; `pixel_size`, 1 for columns in µm and
        None where the names have no unit of length; `y_down`, True for columns col and row.

    Raises
    ------
    ValueError
        If the file contains no such table.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from microlib.embryo import read_outline
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "outline.csv"
    ...     _ = file.write_text("# by hand\\nx (px);y (px)\\n1,5;2\\n2;3,5")
    ...     read_outline(file).x
    array([1.5, 2. ])
    """
    import pandas as pd  # here, because it takes long to import

    try:
        text = re.sub("#.*", "", Path(path).read_text("utf-8-sig")).strip()
    except UnicodeDecodeError:
        raise ValueError(f"{path} must be a table of text with the columns x and y") from None
    # The last line determines the separator, because names may contain spaces.
    last = text.rpartition("\n")[2]
    separator = next((mark for mark in ";\t," if mark in last), r"\s+")
    try:
        cells = pd.read_csv(
            StringIO(text), sep=separator, header=None, dtype=str, skipinitialspace=True
        )
    except ValueError as error:  # of pandas, for lines of different length or none
        raise ValueError(f"{path} must be a table with the columns x and y: {error}") from None
    numbers = cells.replace(",", ".", regex=True).apply(pd.to_numeric, errors="coerce").to_numpy()
    columns, unit, y_down, first = [0, 1], None, False, 0
    if np.isnan(numbers[0, :2]).any():
        columns, unit, y_down = _columns(path, [str(name).strip() for name in cells.iloc[0]])
        first = 1
    elif len(cells.columns) != 2:
        problem = "must have the names of its columns, such as x and y, if these are not all"
        raise ValueError(f"{path} {problem}, got {len(cells.columns)} columns")
    points = numbers[first:, columns]
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if wrong.size or not points.size:
        got = f"{cells.iloc[first + wrong[0]].tolist()}" if wrong.size else "none"
        raise ValueError(f"{path} must have numbers in the columns x and y, got {got}")
    return OutlineTable(points[:, 0], points[:, 1], unit, y_down)


def _columns(path: object, names: list[str]) -> tuple[list[int], float | None, bool]:
    """Return the indices of x and y, their unit in µm or None, and whether y points down."""
    form = re.compile(r"(\w+?)[\s_]*[\[(]?(px|pixels?|[uµμnm]m|)[\])]?")
    known = {m[1]: (k, m[2]) for k, name in enumerate(names) if (m := form.fullmatch(name.lower()))}
    for across, up in (("x", "y"), ("col", "row"), ("column", "row")):
        if across in known and up in known:
            (first, unit), (second, other) = known[across], known[up]
            if MICROMETERS.get(unit) != MICROMETERS.get(other):
                raise ValueError(f"{path} must have x and y in one unit, got {unit} and {other}")
            return [first, second], MICROMETERS.get(unit), up == "row"
    units = "in px, nm, µm or mm, such as x (px) and y (px), or x_um and y_um"
    raise ValueError(f"{path} must have the columns x and y, or col and row, {units}, got {names}")


@dataclass(frozen=True, eq=False, repr=False)
class OutlineDimple(FlatResult):
    """Dimple of an outline, from `dimple_from_outline`.

    Attributes
    ----------
    left, right : DimpleGeometry
        Radius and depth from each rim, with their covariance.
    curve : GaussianSum
        Eight Gaussians (5.1) fitted to the smoothed outline, px.
    x, y : ndarray, shape (n,)
        Part of the outline that was used, px; x ascending, y up from its lowest point.
    y_down : bool
        Whether the dimple was found with y pointing down.
    """

    _large = ("x", "y", "curve")

    left: DimpleGeometry
    right: DimpleGeometry
    curve: GaussianSum
    x: Array
    y: Array
    y_down: bool


def dimple_from_outline(x: ArrayLike, y: ArrayLike, *, pixel_size: float) -> OutlineDimple:
    """Measure the dimple of an outline, equations (5.1) and (5.3), and its uncertainty.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Points of the outline, px, y up. The order is that of the outline, or any order if there is
        one y for each x. Of an outline that turns back in x, such as a closed
        one, the upper part is used. If the inverted outline has a dimple away from its ends and
        the upright one has not, y points down.
    pixel_size : float
        Size of a pixel in the object plane, µm/px; 1 for points in µm.

    Returns
    -------
    OutlineDimple
        Radius and depth from the `left` and the `right` rim, and the fitted `curve`.

    Raises
    ------
    ValueError
        If the outline has fewer than 24 points within two radii of the bottom, has no dimple, or
        has a dimple whose radius or depth is below three standard deviations.

    See Also
    --------
    fit_dimple : Fits the membrane's profile (4.2) to an outline found in an image.

    Notes
    -----
    1. The part with the dimple is selected, up to two radii from its bottom.
    2. `loess` smooths it with the spans 0.15, 0.25 (as in the thesis) and 0.35.
    3. `fit_gaussians` and `dimple_geometry` measure radius and depth of each curve.

    The variances are the sum of three parts: the variance between the three spans, the variance
    from the scatter of the points, and the square of the bias that smoothing causes at the corners
    of the rim and of the bottom. This bias is twice the change of radius and depth when the span of
    LOESS is halved. The radius and the depth are not corrected for it. Of a dimple (4.2) with a
    corner at its rim, the radius is about one standard deviation too small.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.embryo import dimple_from_outline
    >>> x = np.arange(121.0)
    >>> y = 40 * np.exp(-(((x - 30) / 20) ** 2)) + 40 * np.exp(-(((x - 90) / 20) ** 2))
    >>> dimple = dimple_from_outline(x, y, pixel_size=2.0).left
    >>> print(f"a = {dimple.rim_radius:.0f} µm, w_d = {dimple.dimple_depth:.0f} µm")
    a = 60 µm, w_d = 63 µm
    """
    size = as_scalar("pixel_size", pixel_size, above=0)
    limits: dict[str, Any] = {"shape": (None,), "least": -MOST_PIXELS, "most": MOST_PIXELS}
    points = as_array("x", x, **limits), as_array("y", y, **limits)
    check_same_length(("x", "y"), *points)
    across, up, y_down = _part_with_dimple(*points)
    smooth = [loess(across, up, span=span) for span in SPANS]
    half = loess(across, up, span=SPANS[1] / 2)
    # Of smooth curves, a thousand points determine the fit to a thousandth of its uncertainty.
    some = np.linspace(0, across.size - 1, min(across.size, 1000)).astype(int)
    curves = [fit_gaussians(across[some], each[some]) for each in smooth]
    # Clipped at the corners of the bottom, where the bias of a smooth curve exceeds the noise.
    residuals = up - smooth[0]
    limit = 3 * robust_std(residuals)
    residuals = np.clip(residuals, -limit, limit)
    # A parabola fitted to k points of variance 1 with tricube weights, up to the distance h, has
    # the variance 2.85/k of its value and 6.9/(k h²) of its slope in the middle. The error of the
    # slope divided by the second derivative is that of an extremum.
    half_span = SPANS[1] * float(np.ptp(across)) / 2
    scatter = residual_variance(residuals, int(3 / SPANS[0])) / (SPANS[1] * across.size)
    sides = {}
    for rim in ("left", "right"):
        each = [dimple_geometry(curve, pixel_size=size, rim=rim) for curve in curves]
        sizes = np.array([(g.rim_radius, g.dimple_depth) for g in each])
        second = curves[1].second_derivative([each[1].rim[0], each[1].bottom[0]])
        noise = size**2 * scatter * np.array([7 / half_span**2 * np.sum(second**-2.0), 6])
        # The bias of a corner is proportional to the span, so that half of the span halves it. The
        # noise of the narrow curve, which is 8 and 2 times that of the wide one, is no bias.
        wide, narrow = (_extrema(across, curve, each[1]) for curve in (smooth[1], half))
        bias = np.maximum((2 * size * (narrow - wide)) ** 2 - 4 * noise * [8, 2], 0)
        variances = sizes.var(axis=0, ddof=1) + noise
        if (sizes[1] < 3 * np.sqrt(variances)).any():
            (a, w), (a_std, w_std) = sizes[1] / size, np.sqrt(variances) / size
            raise ValueError(
                f"y must show a dimple, got a radius of {a:.2g} ± {a_std:.2g} and a depth of "
                f"{w:.2g} ± {w_std:.2g} px from the {rim} rim"
            )
        sides[rim] = replace(each[1], covariance=np.diag(variances + bias))
    return OutlineDimple(**sides, curve=curves[1], x=across, y=up, y_down=y_down)


def _extrema(x: Array, y: Array, near: DimpleGeometry) -> Array:
    """Return the distance of the rim from the bottom, and the depth, of a smoothed outline, px."""
    bottom = near.bottom[0]
    side = (x < bottom) == (near.rim[0] < bottom)
    # Half of the way around the rim, where a wider curve finds it.
    side &= np.abs(x - near.rim[0]) < abs(near.rim[0] - bottom) / 2
    k = int(np.clip(np.flatnonzero(side)[y[side].argmax()], 1, x.size - 2))
    top = np.polyfit(x[k - 1 : k + 2] - x[k], y[k - 1 : k + 2], 2)
    crest = np.clip(-top[1] / (2 * top[0]), *(x[[k - 1, k + 1]] - x[k])) if top[0] < 0 else 0.0
    inside = np.abs(x - bottom) < abs(near.rim[0] - bottom) / 2
    return np.array([abs(x[k] + crest - bottom), y[k] - y[inside].min()])


def _part_with_dimple(x: Array, y: Array) -> tuple[Array, Array, bool]:
    """Return the outline around its dimple, x ascending, y up from 0, and if y was down."""
    parts = _single_valued_parts(x, y)
    reason = ValueError()
    # A dimple away from the ends of the upper part, or of the inverted outline's, is the best. The
    # rim may be at the end if the outline was cut off there.
    for sign, away_from_ends in ((1, True), (-1, True), (1, False)):
        part = max(parts, key=lambda part: float(np.mean(sign * y[part])))
        try:
            across, up = _around_dimple(x[part], sign * y[part], away_from_ends)
        except ValueError as error:
            reason = error
        else:
            return across, up, sign < 0
    raise reason


def _around_dimple(x: Array, y: Array, away_from_ends: bool) -> tuple[Array, Array]:
    """Return the points around the one dimple of a part of an outline; raise if it has none."""
    dip = _deepest(y)
    # Eight Gaussians describe an outline well within two radii of the bottom.
    reach = 2 * (x[dip.bottom] - x[dip.rim]) or np.inf
    near = np.abs(x - x[dip.bottom]) <= reach * (1 + 1e-9)  # a margin for rounding
    if near.sum() < _MIN_POINTS:
        raise ValueError(
            f"y must show a dimple of at least {_MIN_POINTS} points, got {near.sum()} "
            "within two radii of where it is deepest"
        )
    # Correlated noise has several dips of about the same depth; the limit is two of its sigma.
    others = [_deepest(half).depth for half in (y[: dip.bottom + 1], y[dip.bottom :])]
    other = max(*others, 2 * robust_std(y - loess(x, y, span=SPANS[1])))
    if dip.depth <= 2 * other or (away_from_ends and not dip.inside):
        raise ValueError(
            f"y must show one dimple, got one of {dip.depth:.2g} px beside others of "
            f"{other:.2g} px; if x turns back, the points must be in order along the outline"
        )
    # Gaussians fall to zero.
    return x[near], y[near] - y[near].min()


def _single_valued_parts(x: Array, y: Array) -> list[NDArray[np.intp]]:
    """Return indices of the points by ascending x, in two parts if the outline turns back in x."""

    def length(x: Array, y: Array) -> float:
        return float(np.hypot(np.diff(x), np.diff(y)).sum())

    order = np.argsort(x, kind="stable")
    # The order of ascending x jumps between the two parts of an outline that turns back.
    if length(x[order], y[order]) <= length(x, y) * (1 + 1e-9):
        return [order]
    first, last = int(np.argmin(x)), int(np.argmax(x))
    around = np.roll(np.arange(x.size), -first)
    turn = (last - first) % x.size
    # Without the ends, where a closed outline is vertical.
    within = (x > x[first]) & (x < x[last])
    parts = [part[within[part]] for part in (around[:turn], around[turn:])]
    # A short part is the end of an outline that turns back a little, and contains no dimple.
    whole = [part for part in parts if part.size >= _MIN_POINTS]
    return [part[np.argsort(x[part], kind="stable")] for part in whole] or [order]


class _Dip(NamedTuple):
    """Deepest point of a curve between higher parts, and the higher part on its left."""

    bottom: int
    rim: int
    depth: float
    inside: bool  # whether both higher parts are away from the ends of the curve


def _deepest(y: Array) -> _Dip:
    left, right = np.maximum.accumulate(y), np.maximum.accumulate(y[::-1])[::-1]
    depths = np.minimum(left, right) - y
    bottom = int(np.argmax(depths))
    rims = int(np.argmax(y[: bottom + 1])), bottom + int(np.argmax(y[bottom:]))
    # A curve that falls to its ends by noise alone has a rim within its first twentieth.
    inside = min(rims[0], len(y) - 1 - rims[1]) > len(y) // 20
    return _Dip(bottom, rims[0], float(depths[bottom]), inside)
