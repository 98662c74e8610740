"""Section 5.2: the chain from pixels to microscope gives back the microscope that rendered them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from compendium import thesis
from compendium.experiments import section_5_2
from compendium.ledger import claim
from microlib.calibration import calibrate, detect_circles


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
    # Narrow enough to say something: 1 % where neither the tilt nor the distortion is asked for.
    firm = table[table["parameter"].isin(["alpha", "T_x", "T_y"])]
    assert (firm["high"] - firm["low"] < 0.01 * firm["mean"].abs()).all()
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
    each = [np.linalg.norm(d.with_f.plane_residuals, axis=1).mean() for d in first]
    expected = np.exp(np.mean(np.log(each)))
    assert table.loc["squares, 4X", "mean, ours"] == pytest.approx(expected)
    assert table.loc["circles, 1X", "max, printed"] == claim("table-5.2/circle-1X/max").value
    assert (table["mean, ours"] < table["mean, printed"]).all()
    # Distances are never spread wider than their mean and maximum allow; two printed ones are.
    assert (table["std, ours"] <= np.sqrt(table["mean, ours"] * table["max, ours"])).all()
    impossible = table["std, printed"] > table["largest std possible"]
    assert impossible.to_list() == [False, False, True, True]


def test_distances_have_positive_intervals(draws) -> None:
    errors = section_5_2.pattern_errors(draws)
    assert (errors["low"] > 0).all()
    assert ((errors["low"] < errors["value"]) & (errors["value"] < errors["high"])).all()
    # As far below as above, in factors.
    np.testing.assert_allclose(errors["low"] * errors["high"], errors["value"] ** 2)


def test_one_more_positive_draw_falls_into_its_interval() -> None:
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(2000):
        *seen, after = rng.lognormal(0.0, 1.0, 6)
        value, (low, high) = section_5_2.over_positive_draws(seen)
        assert 0 < low < value < high
        inside.append(low <= after <= high)
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 2000))


@pytest.mark.parametrize("column", ["circle-4X", "square-4X"])
def test_all_labels_of_an_unmarked_pattern_fit_alike(column: str) -> None:
    """A quarter turn, a step and a look from behind change the pose, and not the residuals."""
    found = section_5_2.find(column, section_5_2.photograph(column, np.random.default_rng(4)))
    truth = thesis.microscope(column)
    step = 2 * thesis.pattern_pitch(column)
    rms = []
    for quarter in range(4):
        for behind in (0, np.pi):
            like = replace(
                truth, alpha=truth.alpha + quarter * np.pi / 2, gamma=truth.gamma + behind
            )
            like = replace(like, tx=like.tx + step * quarter)
            world = section_5_2.printed_labels(column, found, like)
            fit = calibrate(
                world, found.points, focal_length=truth.focal_length, **section_5_2.SENSOR
            )
            # The nearest of all labels: a step away at most, and turned by less than 45°.
            assert abs(fit.microscope.tx - like.tx) < step
            turn = fit.microscope.rotation @ like.rotation.T
            assert np.trace(turn) > 1 + 2 * np.cos(np.pi / 4)
            rms.append(fit.reprojection.rms)
    # The model is in focus at its origin, which a step moves by some 10 µm in 40 000.
    np.testing.assert_allclose(rms, rms[0], rtol=1e-3)


def test_the_print_enters_by_its_labels_only() -> None:
    """Another pose by far more than the fit's error, but with the same nearest labels."""
    for column in thesis.COLUMNS:
        found = section_5_2.find(column, section_5_2.photograph(column, np.random.default_rng(6)))
        truth = thesis.microscope(column)
        aside = 0.3 * thesis.pattern_pitch(column)
        other = replace(
            truth,
            alpha=truth.alpha + 0.5,
            beta=-truth.beta,
            tx=truth.tx + aside,
            ty=truth.ty - aside,
        )
        labels = section_5_2.printed_labels(column, found)
        np.testing.assert_array_equal(labels, section_5_2.printed_labels(column, found, other))
        np.testing.assert_allclose(truth.project(labels), found.points, atol=0.2)


def test_labels_ask_for_no_truth() -> None:
    """The detector is told nothing: it returns the same points whatever Table 5.1 says."""
    image = section_5_2.photograph("circle-4X", np.random.default_rng(3))
    found = section_5_2.find("circle-4X", image)
    np.testing.assert_array_equal(found.points, detect_circles(image).points)
    np.testing.assert_array_equal(found.grid.min(axis=0), 0)


def test_a_pattern_seen_from_behind_has_another_gamma() -> None:
    found = section_5_2.find(
        "circle-4X", section_5_2.photograph("circle-4X", np.random.default_rng(8))
    )
    gamma, residual = section_5_2.turned_over("circle-4X", found)
    assert gamma == pytest.approx(thesis.table_5_1("circle-4X", "gamma") + 180, abs=0.2)
    assert residual == pytest.approx(1, abs=1e-6)


def test_the_rest_of_table_5_1_follows_from_its_lengths() -> None:
    """By a thin lens at the printed f: an object at T_z has its image at T_op + f, M times as
    large."""
    for column in thesis.COLUMNS:
        t_op, f = (thesis.table_5_1(column, name) for name in ("T_op", "f"))
        found = section_5_2.dependent_entries(column)
        assert 1 / (f + found["d"]) + 1 / (t_op + f) == pytest.approx(1 / f)
        assert (t_op + f) / (f + found["d"]) == pytest.approx(found["M"])
        assert found["T_z"] - f == thesis.table_5_1(column, "d")


def test_the_zoom_with_the_least_gain_decides() -> None:
    means = {"circle-1X": 2.0, "square-1X": 3.0, "circle-4X": 1.0, "square-4X": 4.0}
    assert section_5_2.squares_over_circles(means) == 1.5
    assert section_5_2.squares_over_circles(means | {"square-4X": 0.5}) == 0.5


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


def test_the_printed_means_are_those_of_table_5_2() -> None:
    means = section_5_2.printed_means()
    assert list(means.values()) == [0.2202, 0.0639, 0.4618, 0.0920]
    assert section_5_2.squares_over_circles(means) == pytest.approx(0.0920 / 0.0639)


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
        true = thesis.microscope(column).project(section_5_2.printed_labels(column, found))
        assert np.abs(found.points - true).max() < 0.2  # px
