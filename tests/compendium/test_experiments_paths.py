"""The geometry of the reference paths."""

import numpy as np
import pytest

from compendium.experiments.paths import circle_path, sinusoid_path, square_path


@pytest.mark.parametrize(
    ("path", "length"),
    [
        (circle_path(50.0, 40.0, 0.03), 2 * np.pi * 50),
        (square_path(80.0, 40.0, 0.03), 320.0),
    ],
)
def test_paths_run_their_length_at_constant_speed(path, length):
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    np.testing.assert_allclose(path[0], 0, atol=1e-12)
    assert len(path) == pytest.approx(length / 1.2, abs=1.0)
    # A chord is shorter than its arc: by 10⁻⁴ on the circle, more at the corners of the square.
    assert np.median(steps) == pytest.approx(1.2, rel=2e-3)
    assert steps.max() <= 1.2 + 1e-9


def test_the_sinusoid_advances_evenly_and_has_its_crests():
    path = sinusoid_path(100.0, 20.0, 10.0, 0.1)
    np.testing.assert_allclose(np.diff(path[:, 0]), 1.0)
    assert len(path) == 100
    # Crests a quarter of 50 px in, which falls between samples: 1 − cos(2π/100) = 0.2 % off.
    assert path[:, 1].max() == pytest.approx(20.0, rel=0.002)
    np.testing.assert_allclose(path[:50, 1], path[50:, 1], atol=1e-9)
