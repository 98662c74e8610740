"""The calls of every public function of curvature: their units, their axes and what they refuse."""

import numpy as np
import pytest

from microlib import curvature
from microlib.curvature import region_table, surface_curvature
from tests.checks import (
    BROKEN,
    NO_COUNT,
    NO_NUMBER,
    each_view,
    hold_call,
    hold_refused,
    hold_scaled,
    no_array,
    no_map,
)

Y, X = np.mgrid[0:31, 0:38] / 10.0
#: A map without a symmetry, µm on pixels of 2.3 µm.
HEIGHT = 3.0 * np.sin(X) * np.cos(0.7 * Y) + 0.4 * X * Y + 0.2 * Y**2
LABELS = np.random.default_rng(2).integers(0, 10, (5, 6)).repeat(5, axis=0).repeat(4, axis=1)
BENT = surface_curvature(HEIGHT, 2.3, noise=0.04)
#: A valid call of each function.
CALLS = {
    curvature.clean_labels: lambda: {"labels": LABELS.copy(), "smallest": 25},
    curvature.curvature_windows: lambda: {"size": 7},
    curvature.hk_labels: lambda: {
        "mean": BENT.mean.copy(), "gaussian": BENT.gaussian.copy(), "h_zero": 0.01, "k_zero": 2e-4,
    },
    curvature.region_table: lambda: {"labels": np.pad(LABELS, ((0, 6), (9, 5))), "curvature": BENT},
    curvature.surface_curvature: lambda: {
        "height": HEIGHT.copy(), "pixel_size": 2.3, "size": 5, "noise": 0.04,
    },
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__name__)
#: NaN leaves a pixel without a label.
THRESHOLD = [None, "text", 1j, {}, [], 1 - 2 * np.eye(*BENT.mean.shape)]
#: What is refused in place of each argument.
REFUSED = {
    curvature.clean_labels: {
        "labels": lambda valid: [*no_array(valid), [[12]], np.full((4, 4), 1.9), -np.eye(4)],
    },
    curvature.curvature_windows: {"size": [*NO_COUNT, 1, 4]},
    curvature.hk_labels: {
        "mean": no_map, "gaussian": no_map, "h_zero": THRESHOLD, "k_zero": [*THRESHOLD, [0.1, 0.2]],
    },
    curvature.region_table: {
        "labels": lambda valid: [*no_array(valid), [[1]]], "curvature": [None, (1, 2)],
    },
    curvature.surface_curvature: {
        "height": lambda valid: [*no_map(valid), np.zeros((8, 40)), np.full((40, 40), np.inf)],
        "size": [*NO_COUNT, 4], "noise": [*NO_NUMBER, -1], "pixel_size": [*BROKEN, 0, -1],
    },
}  # fmt: skip


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function], exact=("labels",))


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


def test_curvature_and_regions_follow_unit_and_origin_of_height():
    um, labels = 1.7, np.pad(LABELS, ((0, 6), (9, 5)))
    found = surface_curvature(um * (HEIGHT + 42.0), um * 2.3, noise=um * 0.04)
    # 42 µm of height lose four digits of a second derivative.
    by = {"mean": 1 / um, "gaussian": 1 / um**2}
    uncertainties = {"mean_uncertainty": 1 / um, "gaussian_uncertainty": 1 / um**2}
    hold_scaled(found, BENT, within=1e-8, **by, **uncertainties)
    by["mean_limit"] = 1 / um
    hold_scaled(region_table(labels, found), region_table(labels, BENT), within=1e-8, **by)
    wanted = curvature.hk_labels(BENT.mean, BENT.gaussian, 0.01, 2e-4)
    given = (found.mean, found.gaussian, 0.01 / um, 2e-4 / um**2)
    np.testing.assert_array_equal(curvature.hk_labels(*given), wanted)


def test_planar_region_states_the_smallest_curvature_that_would_be_seen():
    """A dome is planar in much noise, and its curvature is then below the limit of the table."""
    dome = np.sqrt(300.0**2 - X**2 - Y**2)
    for noise, label in ((0.05, 5), (1e-6, 1)):
        rough = dome + np.random.default_rng(0).normal(0, noise, dome.shape)
        found = surface_curvature(rough, 0.1, noise=noise)
        row = region_table(curvature.hk_labels(found), found).sort_values("area").iloc[-1]
        assert row["label"] == label
        assert (row["mean_limit"] > 1 / 300) == (label == 5)
        if label == 1:
            assert (row["mean"], row["gaussian"]) == pytest.approx((-1 / 300, 1 / 300**2), rel=0.01)
        # On flat ground, the limit is the same for all pixels.
        h_zero = np.where(np.isfinite(found.mean), row["mean_limit"], np.nan)
        labels = curvature.hk_labels(found, h_zero=h_zero)
        assert (labels == curvature.hk_labels(found)).mean() > 0.99


@each_view
def test_curvature_and_regions_follow_flips_and_rotations(view):
    holed = np.where((X > 3.2) & (Y < 0.4), np.nan, HEIGHT)
    plain, other = (surface_curvature(h, 2.3, noise=0.04) for h in (holed, view.image(holed)))
    for name in ("mean", "gaussian", "mean_uncertainty", "gaussian_uncertainty"):
        wanted = view.image(getattr(plain, name))
        np.testing.assert_allclose(getattr(other, name), wanted, rtol=1e-9, atol=1e-12)
    labels = np.pad(LABELS, ((0, 6), (9, 5)))
    table, turned = region_table(labels, plain), region_table(view.image(labels), other)
    table[["x", "y"]] = view.points(table[["x", "y"]], labels.shape)
    places = ["label", "area", "x", "y"]
    rows, wanted = (t.round({"x": 3, "y": 3}).sort_values(places) for t in (turned, table))
    columns = [*places, "mean", "gaussian"]
    np.testing.assert_allclose(rows[columns], wanted[columns], rtol=1e-9)
