"""The dimple of the guide to a modulus: found in any outline that holds one, with honest errors."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.guides import find_input, manifest, read_outline
from compendium.measured_dimple import (
    MeasuredDimple,
    dimple_of_numbers,
    dimple_of_outline,
    disc_moduli,
)
from microlib.membrane import indent_disc

PIXEL = manifest()["outline.csv"]["settings"]["pixel_size"]
X, Y = read_outline(find_input("outline.csv"))


@pytest.fixture(scope="module")
def dimple() -> MeasuredDimple:
    return dimple_of_outline(X, Y, pixel_size=PIXEL)


def test_the_outline_gives_its_dimple_back(dimple: MeasuredDimple) -> None:
    truth = manifest()["outline.csv"]["truth"]
    assert abs(dimple.radius - truth["dimple_radius_um"]) < 2 * dimple.radius_std
    assert abs(dimple.depth - truth["dimple_depth_um"]) < 2 * dimple.depth_std
    # No more than the rounding of the corners: a pixel, half a pixel.
    assert dimple.radius_std < PIXEL
    assert dimple.depth_std < PIXEL / 2
    assert dimple.bottom[0] - dimple.rim[0] == pytest.approx(dimple.radius)
    assert dimple.rim[1] - dimple.bottom[1] == pytest.approx(dimple.depth)


def test_order_and_origin_of_the_points_do_not_matter(dimple: MeasuredDimple) -> None:
    shuffled = np.random.default_rng(0).permutation(X.size)
    moved = dimple_of_outline(X[shuffled] + 700.0, Y[shuffled] - 300.0, pixel_size=PIXEL)
    assert moved.radius == pytest.approx(dimple.radius, rel=1e-4)
    assert moved.depth == pytest.approx(dimple.depth, rel=1e-4)


def test_without_a_dimple_there_is_no_number() -> None:
    with pytest.raises(ValueError, match="minimum between two maxima"):
        dimple_of_outline(X, -(((X - 100) / 20) ** 2), pixel_size=PIXEL)
    for few in (0, 20):
        with pytest.raises(ValueError, match="outline must hold at least 24 points around"):
            dimple_of_outline(X[:few], Y[:few], pixel_size=PIXEL)


@pytest.mark.parametrize(("radius", "depth"), [(250.0, None), (None, 40.0)])
def test_one_number_is_not_enough(radius: float | None, depth: float | None) -> None:
    with pytest.raises(ValueError, match="must be given together"):
        dimple_of_numbers(radius, depth, radius_std=0, depth_std=0, probe_half_width=25.0)


def test_discs_have_the_dimple_that_is_given() -> None:
    sizes = {"thickness": 3.0, "probe_half_width": 25.0}
    shape = {"radius_std": 0.0, "depth_std": 0.0, "probe_half_width": 25.0}
    found = disc_moduli(50.0, dimple_of_numbers(250.0, 60.58, **shape), 0.4, **sizes)
    for law, ratio in (("neo-hooke", 0.5), ("hooke", 0.4)):
        options = {"law": law, "poisson_ratio": ratio, "radius": 250.0, **sizes}
        assert indent_disc(50.0, modulus=found[law], **options).depth == pytest.approx(60.58)
    steep = disc_moduli(50.0, dimple_of_numbers(100.0, 3000.0, **shape), 0.5, **sizes)
    assert np.isnan(list(steep.values())).all()
