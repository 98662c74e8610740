"""The laws of every public name of curvature."""

import numpy as np
import pytest

from microlib.curvature import Curvature, region_table, surface_curvature
from tests.laws import NUMBER, SAME, VIEWS, Row, laws_of, um

Y, X = np.mgrid[0:31, 0:38] / 10.0
#: A map without a symmetry, µm on pixels of 2.3 µm.
HEIGHT = 3.0 * np.sin(X) * np.cos(0.7 * Y) + 0.4 * X * Y + 0.2 * Y**2
LABELS = np.random.default_rng(2).integers(0, 10, (5, 6)).repeat(5, axis=0).repeat(4, axis=1)
FIELDS = {
    **dict.fromkeys(("mean", "mean_uncertainty"), 1 / um),
    **dict.fromkeys(("gaussian", "gaussian_uncertainty"), 1 / um**2),
}


def bent(u) -> Curvature:
    return surface_curvature(u.z0 + HEIGHT * u.um, 2.3 * u.um, noise=0.04 * u.um)


LAWS = {
    "curvature.clean_labels": Row(lambda u: {"labels": LABELS, "smallest": 25}, NUMBER),
    "curvature.curvature_windows": Row(lambda u: {"size": 7},
        dict.fromkeys(("smooth", "mean", "slope", "second_derivative"), NUMBER)),
    "curvature.hk_labels": Row(lambda u: {"mean": bent(u).mean, "gaussian": bent(u).gaussian,
        "h_zero": 0.01 / u.um, "k_zero": 2e-4 / u.um**2}, NUMBER),
    "curvature.region_table": Row(lambda u: {"labels": np.pad(LABELS, ((0, 6), (9, 5))),
        "curvature": bent(u)}, {**dict.fromkeys(("label", "name"), SAME),
        # 42 µm of height lose four digits of a second derivative
        **dict.fromkeys(("area", "x", "y"), NUMBER), **FIELDS}, within=1e-8),
    "curvature.surface_curvature": Row(lambda u: {"height": u.z0 + HEIGHT * u.um,
        "pixel_size": 2.3 * u.um, "size": 5, "noise": 0.04 * u.um}, FIELDS, within=1e-8),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_curvature_and_regions_follow_flips_and_rotations(view):
    holed = np.where((X > 3.2) & (Y < 0.4), np.nan, HEIGHT)
    plain, other = (surface_curvature(h, 2.3, noise=0.04) for h in (holed, view.image(holed)))
    for name in FIELDS:
        wanted = view.image(getattr(plain, name))
        np.testing.assert_allclose(getattr(other, name), wanted, rtol=1e-9, atol=1e-12)
    labels = np.pad(LABELS, ((0, 6), (9, 5)))
    table, turned = region_table(labels, plain), region_table(view.image(labels), other)
    table[["x", "y"]] = view.points(table[["x", "y"]], labels.shape)
    places = ["label", "area", "x", "y"]
    rows, wanted = (t.round({"x": 3, "y": 3}).sort_values(places) for t in (turned, table))
    columns = [*places, "mean", "gaussian"]
    np.testing.assert_allclose(rows[columns], wanted[columns], rtol=1e-9)
