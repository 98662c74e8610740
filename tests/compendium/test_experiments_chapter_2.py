"""Chapter 2's experiments: what they draw from known truth, and what they must find in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import chapter_2

NOISE = 0.02


@pytest.fixture(scope="module")
def scope():
    printed = thesis.microscope("circle-1X")
    focal = printed.focal_length
    return replace(printed, tube_length=1.59 * focal, distance=focal / 1.59)


def test_noise_free_calibration_recovers_parameters(scope):
    steps = chapter_2.calibration_steps(scope, 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(steps["refined"], steps["truth"], rtol=1e-5)
    printed = {"α (°)": 90.7144, "γ (°)": 175.9179, "κ (10⁻¹⁰ µm⁻²)": -8.4, "T_x (µm)": -781.4}
    assert steps["truth"][list(printed)].to_dict() == pytest.approx(printed)
    assert steps.loc["M", "start"] == pytest.approx(steps.loc["M", "truth"], rel=0.01)


def test_jacobian_models_differ_by_perspective_only(scope):
    plain = replace(scope, distortion=0.0, alpha=0.0, beta=0.0, gamma=np.pi)
    x, y, depth = 700.0, 400.0, plain.translation[2]
    found = chapter_2.jacobian_comparison(plain, (x, y, depth)).set_index("motion")
    scale = plain.magnification / plain.cell[0]
    full = found[["x, full model", "y, full model"]]
    np.testing.assert_allclose(full.loc["V_x"], [scale, 0], atol=1e-6)
    np.testing.assert_allclose(full.loc["V_z"], [-scale * x / depth, -scale * y / depth], rtol=1e-3)
    np.testing.assert_allclose(full.loc["ω_z"], [-scale * y, scale * x], rtol=1e-5)
    assert found.loc["V_x", "difference"] < 1e-6
    far = scale * np.hypot(x, y) / depth
    assert found.loc["V_z", "difference"] == pytest.approx(far, rel=1e-3)
