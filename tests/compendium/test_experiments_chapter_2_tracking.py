"""One step of ESM and of the Kalman filter, against the truth, the library and the formulas."""

import numpy as np
import pytest

from compendium.experiments import chapter_2_tracking as tracking


def test_rendered_target_shows_template_under_true_warp():
    target = tracking.render_target(3, noise=0.0)
    inside = np.s_[4:-4, 4:-4]  # off the rim, where the ground shines through
    shown = tracking.warped(target.image, target.warp)
    # Sampled twice by cubic splines.
    np.testing.assert_allclose(shown[inside], target.template[inside], atol=1.5)
    assert np.abs(tracking.warped(target.image, np.eye(3)) - target.template).max() > 30
    # Somewhere else altogether at the start.
    start = tracking.corners(np.eye(3))
    assert np.linalg.norm(start - tracking.corners(target.warp), axis=1).mean() > 5


def test_kalman_estimate_is_variance_weighted_mean():
    track, _ = tracking.kalman_track(4, interval=1 / 33, acceleration=300.0, noise=1.0)
    weight = track["predicted_std"] ** 2 / (track["predicted_std"] ** 2 + 1)
    expected = track["predicted"] + weight * (track["measured"] - track["predicted"])
    np.testing.assert_allclose(track["estimated"], expected, atol=1e-9)
    np.testing.assert_allclose(track["estimated_std"] ** -2, track["predicted_std"] ** -2 + 1)
    assert track["true"].iloc[-1] == pytest.approx(40 * 8 / 33 + 300 * (8 / 33) ** 2 / 2)


def test_order_of_convergence_of_known_sequence_is_found():
    for order in (1.0, 1.5, 2.0, 3.0):
        # From 3 px on each error is a power of the one before, over 8 times its scale.
        errors = [3.0]
        while errors[-1] >= 0.1:
            errors.append(errors[-1] * (errors[-1] / 4) ** (order - 1) * 0.5)
        if len(errors) < 3:
            continue
        found = tracking.order_of_convergence(np.array([*errors, 1e-3, 1e-3]))
        assert found == pytest.approx(order)
