"""Section 5.2: the chain from pixels to microscope gives back the microscope that rendered them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from compendium import thesis
from compendium.experiments import section_5_2
from compendium.ledger import claim


@pytest.fixture(scope="module")
def draws() -> dict[str, list[section_5_2.CalibrationDraw]]:
    return section_5_2.calibration_draws(seed=11, draws=2)


def test_every_image_gives_its_microscope_back(draws) -> None:
    assert list(draws) == list(thesis.COLUMNS)
    for column, both in draws.items():
        truth = thesis.microscope(column)
        assert not np.array_equal(both[0].errors, both[1].errors)
        for draw in both:
            assert len(draw.world) >= 6
            assert np.abs(draw.errors).max() < 0.2  # px
            fit = draw.with_f
            assert fit.microscope.focal_length == pytest.approx(truth.focal_length)
            # Five stated standard deviations.
            for name in ("magnification", "alpha", "beta", "gamma", "tx", "ty"):
                off = getattr(fit.microscope, name) - getattr(truth, name)
                assert abs(off) < 5 * fit.sigma[name], (column, name)


def test_a_draw_is_that_of_its_seed(draws) -> None:
    alone = section_5_2.calibration_draw("circle-4X", [11, 1, 0])
    np.testing.assert_array_equal(alone.errors, draws["circle-4X"][0].errors)
    np.testing.assert_array_equal(alone.with_f.estimate, draws["circle-4X"][0].with_f.estimate)


def test_the_recovered_table_holds_the_truth(draws) -> None:
    table = section_5_2.recovered_parameters(draws)
    assert len(table) == 4 * 8
    truth = [thesis.table_5_1(row.column, row.parameter) for row in table.itertuples()]
    # 32 intervals, each of which misses in one of twenty cases; more than four in 2 %.
    assert ((table["low"] <= truth) & (truth <= table["high"])).sum() >= 28
    np.testing.assert_allclose(table["low"] + table["high"], 2 * table["mean"])
    angles = table[table["parameter"].isin(["alpha", "gamma"])]
    assert angles["mean"].between(0, 360).all()


def test_one_more_draw_falls_into_its_interval() -> None:
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(2000):
        *seen, after = rng.normal(5.0, 2.0, 6)
        mean, (low, high) = section_5_2.over_draws(seen)
        assert mean == pytest.approx(np.mean(seen))
        inside.append(low <= after <= high)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 2000))


def test_the_errors_on_the_pattern_are_far_below_the_printed_ones(draws) -> None:
    errors = section_5_2.pattern_errors(draws)
    table = section_5_2.beside_print(errors).set_index("column")
    assert list(table.index) == list(thesis.COLUMNS.values())
    first = draws["square-4X"]
    expected = np.mean([np.linalg.norm(d.with_f.plane_residuals, axis=1).mean() for d in first])
    assert table.loc["squares, 4X", "mean, ours"] == pytest.approx(expected)
    assert table.loc["circles, 1X", "max, printed"] == claim("table-5.2/circle-1X/max").value
    assert (table["mean, ours"] < table["mean, printed"]).all()
    # Distances are never spread wider than their mean and maximum allow; two printed ones are.
    assert (table["std, ours"] <= np.sqrt(table["mean, ours"] * table["max, ours"])).all()
    impossible = table["std, printed"] > table["largest std possible"]
    assert impossible.to_list() == [False, False, True, True]


def test_the_intervals_cover_the_truth(draws) -> None:
    found = section_5_2.coverage(draws, seed=3, runs=20)
    # 7 parameters in 20 runs and 4 columns: four standard errors of 560 coins, were they apart.
    assert found["all"].mean() == pytest.approx(95, abs=4)
    assert found["points"].to_list() == [len(both[0].world) for both in draws.values()]
    np.testing.assert_allclose(
        found["noise (px)"], [both[0].errors.std() for both in draws.values()]
    )
    shares = found[list(section_5_2.COVERED.values())]
    np.testing.assert_allclose(shares.mean(axis=1), found["all"])
    assert ((shares * 20 / 100) % 1 == 0).all(axis=None)


def test_blur_misleads_a_local_corner_detector_most() -> None:
    found = section_5_2.blur_study(1, [0.8, 2.5])
    assert isinstance(found, pd.DataFrame)
    assert (found["squares, cornerSubPix"] > 3 * found["squares"]).all()
    assert (found["circles"] < found["squares"]).all()
    assert (found.loc[2.5] > found.loc[0.8]).all()
    assert found["squares"].max() < 0.1  # px


def test_distortion_moves_a_corner_by_its_formula() -> None:
    for column in thesis.COLUMNS:
        corner = np.hypot(*np.array(thesis.BASLER_IMAGE_SIZE)) * thesis.BASLER_CELL / 2  # µm
        expected = abs(thesis.table_5_1(column, "kappa")) * corner**3 / thesis.BASLER_CELL
        assert section_5_2.corner_shift(column) == pytest.approx(expected, rel=1e-6)


def test_examples_show_every_column() -> None:
    shown = section_5_2.examples(2)
    assert list(shown) == list(thesis.COLUMNS)
    for column, (image, found) in shown.items():
        assert image.shape == thesis.BASLER_IMAGE_SIZE[::-1]
        true = thesis.microscope(column).project(section_5_2.world_points(column, found))
        assert np.abs(found.points - true).max() < 0.2  # px
