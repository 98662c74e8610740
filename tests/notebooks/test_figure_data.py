"""The data that the book offers beside its figures, held against what is known otherwise.

Each number here comes from the thesis, from a formula written out anew, or from what cannot be
otherwise; none is read from a run.
"""

from math import sqrt
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from compendium import ledger

# Table 5.6 and its section: µm, µN, MPa.
RADIUS, DEPTH, FORCE, HALF_WIDTH = 246.95, 121.22, 197.24, 25.0


@pytest.fixture
def figures(claims_folder: Path) -> Path:
    return claims_folder.parent / "figures"


def series(figures: Path, name: str) -> dict[tuple[int, str], np.ndarray]:
    """Return the points of each series of a figure, by panel and name."""
    table = pd.read_csv(figures / f"{name}.csv")
    groups = table.groupby(["panel", "series"], sort=False)
    return {key: group[["x", "y"]].to_numpy(np.float64) for key, group in groups}


def test_largest_part_that_sticks_follows_from_its_weight(claims_folder: Path) -> None:
    """4πRγ = 4/3 πR³ρg: water on silicon, at its diameter in mm; five digits are stored."""
    found = ledger.read_records(claims_folder)["section-2.1/part-size"].value
    assert found == pytest.approx(2e3 * sqrt(3 * 0.073 / (2330 * 9.81)), abs=1e-4)


def test_adhesion_forces_scale_with_power_of_diameter(figures: Path) -> None:
    """Figure 2.2: weight goes with the cube of the diameter, surface tension with itself."""
    found = {name: points for (_, name), points in series(figures, "fig-2-2").items()}
    for name, power in {"weight": 3, "surface tension": 1}.items():
        x, y = found[name].T
        np.testing.assert_allclose(np.diff(np.log(y)) / np.diff(np.log(x)), power, atol=1e-3)


def test_error_decays_with_cosine_of_camera_rotation(figures: Path) -> None:
    """(2.4): e(t) = exp(−λ R t) e(0), of length exp(−λ cos θ t), turned by λ sin θ t."""
    found = series(figures, "fig-ch2-rotation")
    t, length = found[1, "0°"].T
    rate = -np.log(length[-1] / length[0]) / t[-1]
    for k, degrees in enumerate((0, 30, 60, 85, 95)):
        angle = np.deg2rad(degrees)
        expected = 50 * np.exp(-rate * np.cos(angle) * t)
        x, y = found[2, f"_child{k}"].T
        for drawn in (found[1, f"{degrees}°"][:, 1], np.hypot(x, y)):
            np.testing.assert_allclose(drawn, expected, rtol=1e-4, atol=1e-3)
        # Of a length below 1 px the digits that are kept leave no angle.
        clear = expected > 1
        turn = np.unwrap(np.arctan2(y, x))[clear]
        np.testing.assert_allclose(abs(turn - turn[0]), rate * np.sin(angle) * t[clear], atol=2e-3)


def test_drawn_rays_meet_by_lens_equation(figures: Path) -> None:
    """Figure 3.1: f = 40 mm, the sensor at 100 mm, and a lens with a radius of 14 mm."""
    found = series(figures, "fig-3-1")
    (object_x, _), at_lens, (image_x, image_y) = found[1, "in focus"]
    assert 1 / -object_x + 1 / image_x == pytest.approx(1 / 40, rel=1e-5)
    assert (at_lens.tolist(), image_y) == ([0, 14], pytest.approx(0, abs=1e-6))
    (object_x, _), _, (_, image_y) = found[1, "too near"]
    assert image_y == pytest.approx(1400 * (1 / -object_x + 1 / 100 - 1 / 40), rel=1e-5)  # (3.4)


def test_drawn_dimple_has_lengths_of_table_5_6(figures: Path) -> None:
    points = np.concatenate([p for (_, name), p in series(figures, "fig-4-3").items()])
    assert points[:, 1].min() == pytest.approx(-DEPTH, abs=1e-3)
    bottom = points[np.isclose(points[:, 1], -DEPTH, atol=1e-3), 0]
    assert {HALF_WIDTH, -HALF_WIDTH} <= set(np.round(bottom, 3))
    rim = points[np.isclose(points[:, 1], 0, atol=1e-3), 0]
    assert {RADIUS, -RADIUS} <= set(np.round(rim, 3))


def test_drawn_outline_has_radius_and_depth_of_table_5_6(figures: Path) -> None:
    found = {name.split(" ")[0]: p for (_, name), p in series(figures, "fig-5-18").items()}
    (x1, y1), (x2, y2) = found["rim"][0], found["bottom"][0]
    assert x2 - x1 == pytest.approx(RADIUS, abs=0.5)
    assert y1 - y2 == pytest.approx(DEPTH, abs=0.5)
