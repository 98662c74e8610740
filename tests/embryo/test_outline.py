"""Outlines from tables: formats of the file, the part with the dimple, and its uncertainty."""

import csv
import tomllib
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from microlib.embryo import (
    OutlineDimple,
    dimple_from_outline,
    dimple_geometry,
    fit_gaussians,
    loess,
    read_outline,
)
from microlib.membrane import dimple_profile
from tests.checks import hold_sigma

DATA = Path(__file__).parents[2] / "data" / "synthetic"
ABOUT = tomllib.loads((DATA / "MANIFEST.toml").read_text(encoding="utf-8"))["outline.csv"]
POINTS = pd.read_csv(DATA / "outline.csv")
X, Y = POINTS.to_numpy().T
PIXEL = ABOUT["settings"]["pixel_size"]
#: 193 columns of a smooth dimple.
ACROSS = np.arange(193.0)


def smooth(x: NDArray) -> NDArray:
    """Two rims and a dimple, px."""
    hills = 3 * np.exp(-(((x - 20) / 30) ** 2)) + 3 * np.exp(-(((x - 172) / 30) ** 2))
    return 28 + hills - 12 * np.exp(-(((x - 96) / 28) ** 2))


RIM = float(minimize_scalar(lambda x: -smooth(x), bounds=(15, 60), method="bounded").x)
RADIUS, DEPTH = 96 - RIM, float(smooth(np.array(RIM)) - smooth(np.array(96.0)))


def traced(seed: int = 2, noise: float = 0.15) -> NDArray:
    return smooth(ACROSS) + np.random.default_rng(seed).normal(0, noise, ACROSS.size)


def test_dimple_of_synthetic_outline_matches_truth() -> None:
    truth = ABOUT["truth"]
    found = dimple_from_outline(X, Y, pixel_size=PIXEL)
    for dimple in (found.left, found.right):
        radius_std, depth_std = np.sqrt(np.diag(dimple.covariance))
        assert abs(dimple.rim_radius - truth["rim_radius_um"]) < 2 * radius_std
        assert abs(dimple.dimple_depth - truth["dimple_depth_um"]) < 2 * depth_std
        # The smooth curve rounds the corners by half a pixel of depth; the position of a flat rim
        # varies more.
        assert radius_std < 2 * PIXEL
        assert depth_std < PIXEL / 2
        way = PIXEL * np.subtract(dimple.rim, dimple.bottom)
        assert abs(way) == pytest.approx([dimple.rim_radius, dimple.dimple_depth])
    assert found.left.rim[0] < found.left.bottom[0] < found.right.rim[0]


def test_dimple_does_not_depend_on_order_origin_and_unit() -> None:
    plain = dimple_from_outline(X, Y, pixel_size=PIXEL).left
    shuffled = np.random.default_rng(0).permutation(X.size)
    x, y = 0.6 * (X[shuffled] + 700.0), 0.6 * (Y[shuffled] - 300.0)
    moved = dimple_from_outline(x, y, pixel_size=PIXEL / 0.6 * 1.7).left
    # The search for eight Gaussians ends at a relative change of 1e-8 of its sum of squares.
    assert moved.rim_radius == pytest.approx(1.7 * plain.rim_radius, rel=2e-3)
    assert moved.dimple_depth == pytest.approx(1.7 * plain.dimple_depth, rel=1e-3)
    assert moved.rim[0] == pytest.approx(0.6 * (plain.rim[0] + 700.0), rel=1e-3)
    stds = (np.sqrt(np.diag(each.covariance)) for each in (moved, plain))
    np.testing.assert_allclose(np.divide(*stds), 1.7, rtol=0.3)


@pytest.fixture
def few_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit three Gaussians, as good as eight where not their fit but its points are asked for."""
    few = partial(fit_gaussians, terms=3)
    monkeypatch.setattr("microlib.embryo._outline.fit_gaussians", few)


@cache
def measured(seed: int, noise: float) -> OutlineDimple:
    return dimple_from_outline(ACROSS, traced(seed, noise), pixel_size=1.0)


@pytest.mark.parametrize(("noise", "outlines"), [(0.15, 3), (0.6, 8)])
def test_covariance_matches_errors(noise: float, outlines: int) -> None:
    errors, covariances = [], []
    for seed in range(outlines):
        found = measured(seed, noise)
        for dimple in (found.left, found.right):
            errors.append([dimple.rim_radius - RADIUS, dimple.dimple_depth - DEPTH])
            covariances.append(dimple.covariance)
    pulls = np.array(errors) / np.sqrt(np.array([np.diag(each) for each in covariances]))
    # Smoothing rounds the rim, a bias of all outlines that the variance between spans covers. One
    # of 1000 trials of normal errors has a larger sum of squares.
    assert (pulls**2).sum(axis=0).max() < chi2.isf(1e-3, len(pulls))
    if noise == 0.6:
        hold_sigma(np.subtract(errors, np.mean(errors, axis=0)), covariances)


@pytest.mark.parametrize("form", ["rounded", "exact", "few"])
def test_outline_without_noise_has_finite_covariance(form: str) -> None:
    x = ACROSS[::6] if form == "few" else ACROSS
    y = np.round(smooth(x), 3) if form == "rounded" else smooth(x)
    dimple = dimple_from_outline(x, y, pixel_size=1.0).left
    assert np.isfinite(dimple.covariance).all()
    assert dimple.dimple_depth == pytest.approx(DEPTH, abs=3 * dimple.covariance[1, 1] ** 0.5)


def test_covariance_without_noise_is_that_of_spans_and_of_smoothing():
    found = dimple_from_outline(ACROSS, smooth(ACROSS), pixel_size=2.0)
    curves = [
        fit_gaussians(found.x, loess(found.x, found.y, span=span)) for span in (0.15, 0.25, 0.35)
    ]
    dimples = [dimple_geometry(curve, pixel_size=2.0) for curve in curves]
    sizes = [[dimple.rim_radius, dimple.dimple_depth] for dimple in dimples]
    np.testing.assert_allclose(found.curve(found.x), curves[1](found.x))
    assert [found.left.rim_radius, found.left.dimple_depth] == pytest.approx(sizes[1])
    extrema = []
    for span in (0.25, 0.125):
        curve = loess(found.x, found.y, span=span)
        peak = CubicSpline(found.x, -curve)
        rim = minimize_scalar(peak, bounds=(RIM - 15, RIM + 15), method="bounded")
        extrema.append([-2 * rim.x, -2 * rim.fun - 2 * curve.min()])
    bias = 2 * np.diff(extrema, axis=0)[0]
    of_spans = np.var(sizes, axis=0, ddof=1)
    radius, depth = np.diag(found.left.covariance)
    # The shift of a level rim is not beyond what noise would do, for which the outline's distance
    # from its smooth curve is taken.
    assert 0.9 * of_spans[0] < radius < of_spans[0] + bias[0] ** 2
    assert depth == pytest.approx(of_spans[1] + bias[1] ** 2, rel=0.1)


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize(
    ("egg", "radius", "depth"), [(600, 150, 30), (600, 250, 120), (2000, 200, 20)]
)
def test_uncertainty_covers_the_corner_of_a_rim(egg, radius, depth, noise):
    """The profile (4.2) is level inside the rim, and an arc of a circle falls outside, µm."""
    x = np.arange(-500.0, 501.0, 2.0)
    arc = np.sqrt(egg**2 - x**2) - np.sqrt(egg**2 - radius**2)
    inside = -dimple_profile(np.clip(abs(x), 25, radius), radius, depth, probe_half_width=25)
    y = np.where(abs(x) < radius, inside, arc) / 2
    y += np.random.default_rng(3).normal(0, noise, x.size)
    found = dimple_from_outline(x / 2, y, pixel_size=2.0)
    for dimple in (found.left, found.right):
        errors = dimple.rim_radius - radius, dimple.dimple_depth - depth
        assert (np.abs(errors) < 2.5 * np.sqrt(np.diag(dimple.covariance))).all()


#: Closed outlines: heights of the part that returns below the dimple, number of the first point,
#: whether the order is reversed, and whether y points down.
CLOSED = {
    "border": (np.zeros(193), 0, False, False),
    "chord": (np.full(193, traced().min() - 2), 300, True, True),
    "inner edge": (traced() - 3, 50, False, True),
    "egg": (28 - 60 * np.sqrt(1 - ((ACROSS - 96) / 97) ** 2), 193, True, False),
    # A dimple is a twentieth of the height of this egg.
    "large egg": (28 - 400 * np.sqrt(1 - ((ACROSS - 96) / 97) ** 2), 70, False, True),
}


@pytest.mark.usefixtures("few_terms")
@pytest.mark.parametrize(("returning", "start", "back", "down"), CLOSED.values(), ids=CLOSED)
def test_upper_part_of_closed_outline_is_used(returning, start, back, down) -> None:
    order = np.roll(np.arange(386), start)[:: -1 if back else 1]
    x, y = np.r_[ACROSS, ACROSS[::-1]][order], np.r_[traced(), returning[::-1]][order]
    found = dimple_from_outline(x, 200 - y if down else y, pixel_size=1.0)
    assert found.y_down == down
    # Without the first and last points, where the parts meet.
    upper = traced()[1:-1] - traced()[1:-1].min()
    np.testing.assert_allclose([found.x, found.y], [ACROSS[1:-1], upper], atol=1e-12)


@pytest.mark.usefixtures("few_terms")
@pytest.mark.parametrize(("turned", "down"), [(4, False), (20, True), (40, False)])
def test_ends_that_turn_back_are_left_out(turned: int, down: bool) -> None:
    """The sides of an egg fall steeply and turn back by up to 16 px, as far as they were traced."""
    below = np.arange(1.0, turned + 1)
    side = traced()[0] - 3 * below
    inwards = ACROSS[0] + 0.4 * below
    x = np.r_[inwards[::-1], ACROSS, ACROSS[-1] - 0.4 * below]
    y = np.r_[side[::-1], traced(), side]
    found = dimple_from_outline(x, -y if down else y, pixel_size=1.0)
    wanted = dimple_from_outline(ACROSS, traced(), pixel_size=1.0)
    assert found.y_down == down
    # The point at each end is left out, which shifts the smoothing a little.
    assert found.left.dimple_depth == pytest.approx(wanted.left.dimple_depth, rel=0.02)
    assert found.right.rim_radius == pytest.approx(wanted.right.rim_radius, rel=0.02)


@pytest.mark.parametrize(("noise", "shared"), [(0.05, 1), (0.5, 6)])
def test_noisy_arc_is_rejected(noise: float, shared: int) -> None:
    """An arc such as the edge of a coin has no dimple, with independent or correlated noise."""
    x = np.arange(300.0) - 150
    for seed in range(6):
        rough = uniform_filter1d(np.random.default_rng(seed).normal(0, noise, x.size), shared)
        with pytest.raises(ValueError, match=r"[xy] must|curve must"):
            dimple_from_outline(x, np.sqrt(400.0**2 - x**2) + rough, pixel_size=3.9)


MIXED = np.random.default_rng(0).permutation(386)
#: Narrower than what LOESS smooths over: each span gives another depth.
NOTCH = 6 * np.exp(-(((ACROSS - 96) / 4) ** 2))
NOTCH -= 12 * np.exp(-(((ACROSS - 96) / 28) ** 2))


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (X, -(((X - 100) / 20) ** 2), r"one dimple, got one of 0 px|between two maxima"),
        (X, 0 * X, "must show one dimple"),
        (X, 1e200 * Y, "y must be at most 1e"),
        (X[::12], Y[::12], "y must show a dimple of at least 24 points"),
        (ACROSS, smooth(ACROSS) - NOTCH, r"must show a dimple, got a radius of .* ± .* px from"),
        # A closed outline in random order.
        (np.r_[ACROSS, ACROSS][MIXED], np.r_[traced(), 0 * ACROSS][MIXED],
            "points must be in order along the outline"),
    ],
)  # fmt: skip
def test_outline_without_dimple_is_rejected(x, y, message) -> None:
    """In pixels, whatever their size."""
    errors = []
    for pixel_size in (1.0, 3.9):
        with pytest.raises(ValueError, match=message) as error:
            dimple_from_outline(x, y, pixel_size=pixel_size)
        errors.append(str(error.value))
    assert errors[0] == errors[1]


TABLES = {
    "semicolon": POINTS.to_csv(index=False, sep=";"),
    "decimal comma": POINTS.to_csv(index=False, sep=";", decimal=","),
    "decimal comma, tabs": POINTS.to_csv(index=False, header=False, sep="\t", decimal=","),
    "capitals": POINTS.rename(columns=str.upper).to_csv(),
    "no header": POINTS.to_csv(index=False, header=False, sep="\t"),
    "spaces": POINTS.to_string(index=False, header=False),
    "spaces after commas": POINTS.to_csv(index=False).replace(",", ", "),
    "quotes": POINTS.to_csv(index=False, quoting=csv.QUOTE_ALL),
    "comments": "# traced by hand\n\n" + POINTS.to_csv(index=False) + "\n# end\n",
    "empty lines": POINTS.to_csv(index=False).replace("\n", "\n\n"),
    "units": POINTS.rename(columns={"x": "x (px)", "y": "y (px)"}).to_csv(index=False),
    "µm": POINTS.rename(columns={"x": "x_um", "y": "Y [µm]"}).to_csv(index=False),
    "mm": POINTS.rename(columns={"x": "x mm", "y": "y mm"}).to_csv(index=False),
    "rows": POINTS.rename(columns={"x": "col", "y": "row"}).to_csv(index=False),
    "rows and columns": POINTS.iloc[:, ::-1].set_axis(["Row", "Column"], axis=1).to_csv(),
    "other columns": POINTS.assign(id=7, z=1.5)[["id", "y", "z", "x"]].to_csv(index=False),
}


@pytest.mark.parametrize("name", TABLES)
def test_read_outline_accepts_common_forms(name: str, tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    for encoding in ("utf-8", "utf-8-sig"):
        file.write_text(TABLES[name], encoding=encoding)
        found = read_outline(file)
        np.testing.assert_array_equal([found.x, found.y], [X, Y])
        assert found.pixel_size == {"µm": 1.0, "mm": 1000.0}.get(name)
        assert found.y_down == name.startswith("rows")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a table with the columns x and y: No columns"),
        ("x,y\n", "numbers in the columns x and y, got none"),
        ("y\n1\n", r"the columns x and y, or col and row, in px, .* x_um and y_um, got \['y'\]"),
        ("x,y\n1,2\n\n3,\n4,5\n", r"numbers in the columns x and y, got \['3', nan\]"),
        ("# by hand\nx,y\n1,2\n2,nan\n3,4\n", r"numbers in the columns x and y, got \['2', nan\]"),
        ("1,2\n2,about 3\n3,4\n", r"numbers in the columns x and y, got \['2', 'about 3'\]"),
        ("0,1,2\n1,2,3\n", "the names of its columns, such as x and y, .* got 3 columns"),
        ("1\n2\n", "the names of its columns, such as x and y, .* got 1 columns"),
        ("1,2\n2,3\n3,4,5\n", "a table with the columns x and y: .* in line 3, saw 3"),
        ("x_um,y_px\n1,2\n", "x and y in one unit, got um and px"),
        (b"\x89PNG\r\n\x1a\n\x00\x00\xff", "a table of text"),
    ],
)
def test_read_outline_error_contains_row(text: str | bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=rf"points\.csv must (have|be) {message}"):
        read_outline(file)
