"""Experiments of chapters 2, 3, 4 and 6 and of the page on uncertainty, against known truth."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from compendium import ledger
from compendium.experiments import chapter_2_tracking, chapter_3, chapter_6, imaging, uncertainty
from compendium.experiments.rendering import disc_blur


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_order_of_convergence_of_known_sequence_is_found(order):
    # From 3 px on each error is a power of the one before, over 8 times its scale.
    errors = [3.0]
    while errors[-1] >= 0.1:
        errors.append(errors[-1] * (errors[-1] / 4) ** (order - 1) * 0.5)
    assert len(errors) > 2
    found = chapter_2_tracking.order_of_convergence(np.array([*errors, 1e-3, 1e-3]))
    assert found == pytest.approx(order)


def test_depth_errors_are_in_frame_spacings():
    truth = np.full((40, 40), 30.0)
    frames, positions = np.zeros((9, 40, 40)), 10.0 * np.arange(9)
    texture = np.random.default_rng(0).uniform(0, 255, (40, 40))
    for k, position in enumerate(positions):  # sharpest at 30 µm
        frames[k] = 128 + (texture - 128) * np.exp(-(((position - 30) / 20) ** 2))
    _, table = chapter_3.depths(frames, positions, truth + 5.0, {"sml": {"measure": "sml"}})
    assert table.loc["sml", "RMS error (frame spacings)"] == pytest.approx(0.5, abs=0.01)
    assert table.loc["sml", "share above one spacing (%)"] == 0


def test_values_of_sentences_follow_from_printed_numbers():
    assert chapter_6.of_printed_numbers() == pytest.approx(
        {
            "section-4/contact-mechanics": 40.4066667,  # 121.22 over 3
            "section-4.1/small-slopes": pytest.approx(1.9876, abs=0.0005),  # at c/a = 0.29
            "section-5.4/settles-in-a-second": 0.80,
            # In px: 0.95, 1.24, 0.77 at 1X; 0.95, 1.01, 0.72 at 4X.
            "section-5.4/tracked-accurately": 4 / 6,
            # Of the standard deviations all, of the mean errors one step and four paths.
            "section-6/precise-and-accurate": 13 / 16,
        }
    )


def test_benchmark_gives_times_of_esm_over_ecc_in_its_row():
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "tracking.json"
    table = json.loads(path.read_text("utf-8"))["tables"]["Time of one frame"]
    ratios = pd.DataFrame(**table)["ESM / ECC"]
    stated = f"{ratios.min():.1f} to {ratios.max():.1f} times the processor time of ECC"
    assert stated in ledger.claim("section-5.3/frames").found


@pytest.mark.parametrize("std", [0.05, 0.2, 1.0])
def test_power_equals_share_of_detected_simulated_differences(std):
    first, second = np.random.default_rng(1).normal(0, std, (2, 100_000))
    differ = np.abs(first - second + np.log(1.66)) > 1.959964 * np.sqrt(2) * std
    # Four standard errors of a share of 100 000.
    assert float(chapter_6.power(std)) == pytest.approx(differ.mean(), abs=0.0065)
    assert chapter_6.power(chapter_6.needed_std()) == pytest.approx(0.95)


def test_prices_of_choices_are_those_of_their_label():
    modulus, calibration = imaging.of_modulus(), imaging.of_calibration()
    # Squares of independent errors add; that of the force, 2 % if not varied, is one of them.
    force, errors = np.square(modulus["error of the force (%)"])
    np.testing.assert_allclose(np.diff(errors), np.diff(force))
    length, errors = np.square(modulus["error of a length (µm)"])
    np.testing.assert_allclose((errors - 2.0**2) / length, (errors[0] - 2.0**2) / length[0])
    noise, errors = np.array(calibration["error of a point (px)"])
    np.testing.assert_allclose(errors / noise, errors[0] / noise[0], rtol=0.02)
    rest = modulus | calibration | imaging.of_focus() | imaging.of_tracking()
    falling = {label for label, (_, errors) in rest.items() if errors[0] > errors[-1]}
    assert {label.split(" (")[0] for label in falling} == {
        "contrast", "number", "tilt", "side of the box", "depth of the dimple",
    }  # fmt: skip


def test_coverage_of_normal_errors_is_the_level_and_ignores_missing_heights():
    error = np.random.default_rng(0).normal(0, 3.0, 40_000)
    std = np.full(error.shape, 3.0)
    found = uncertainty.coverage(np.r_[error, np.full(4000, np.nan)], np.r_[std, std[:4000]])
    np.testing.assert_allclose(found, found.index, atol=0.01)  # four binomial standard errors


@pytest.mark.parametrize("radius", [4.0, 7.3])
def test_disc_blur_keeps_the_sum_and_has_the_variance_of_a_disc(radius):
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1.0
    blurred = disc_blur(point, radius)
    x = np.arange(41.0) - 20
    assert blurred.sum() == pytest.approx(1, abs=1e-5)
    # A uniform disc has the variance r²/4 along each axis, and a pixel adds 1/12.
    assert (blurred.sum(axis=0) * x**2).sum() == pytest.approx(radius**2 / 4 + 1 / 12, rel=0.01)


def test_slope_is_sharpest_where_its_height_is_that_of_the_frame():
    name, height, stack = next(uncertainty.focal_stacks(1))
    assert name == "slope"
    for k in (8, 12):
        contrast = np.abs(np.diff(stack[k].astype(float), axis=1)).mean(axis=0)
        assert abs(height[80, contrast.argmax()] - k) < 1.0
