"""One step of ESM and of the Kalman filter, against the truth, the library and the formulas."""

import numpy as np
import pytest

from compendium.experiments import chapter_2_tracking as tracking
from microlib.tracking import ESMTracker


def test_the_image_shows_the_template_under_the_true_warp():
    target = tracking.render_target(3, noise=0.0)
    inside = np.s_[4:-4, 4:-4]  # off the rim, where the ground shines through
    shown = tracking.warped(target.image, target.warp)
    # Sampled twice by cubic splines.
    np.testing.assert_allclose(shown[inside], target.template[inside], atol=1.5)
    assert np.abs(tracking.warped(target.image, np.eye(3)) - target.template).max() > 30
    # Somewhere else altogether at the start.
    start = tracking.corners(np.eye(3))
    assert np.linalg.norm(start - tracking.corners(target.warp), axis=1).mean() > 5


@pytest.mark.parametrize("seed", [1, 6, 7])
def test_the_mean_of_both_gradients_leads_to_the_square_first(seed):
    errors = tracking.errors_by_gradient(tracking.render_target(seed), 12)
    assert list(errors) == [*tracking.GRADIENTS]
    # 2 grey levels of noise on 3249 pixels leave some hundredths of a pixel.
    assert (errors["mean of both (ESM)"].iloc[5:] < 0.1).all()
    steps = (errors < 0.1).idxmax().where((errors < 0.1).any(), np.inf)  # some never arrive
    assert steps["mean of both (ESM)"] < steps[["template", "image"]].min()


def test_the_library_finds_the_same_warp():
    target = tracking.render_target(2)
    first = np.full(target.image.shape, 60.0)
    x, y = (tracking.MIDDLE - tracking.HALF).astype(int)
    side = 2 * tracking.HALF + 1
    first[y : y + side, x : x + side] = target.template
    rim = 4
    box = (int(x) + rim, int(y) + rim, side - 2 * rim, side - 2 * rim)
    tracker = ESMTracker(np.uint8(np.clip(first, 0, 255)), box, "affine")
    found = tracker.track(np.uint8(np.clip(np.rint(target.image), 0, 255)))
    # Its corners are those of the box, in the frame of the square's coordinates.
    ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (box[2] - 1) + [box[0], box[1]]
    unit = (ends - tracking.MIDDLE) / tracking.HALF
    warp = tracking.align(target, (0.5, 0.5), 8)[-1]
    expected = tracking.MIDDLE + tracking.HALF * (unit @ warp[:2, :2].T + warp[:2, 2])
    assert not found.lost
    # Both have the noise of the image, but not of the same pixels and filters.
    np.testing.assert_allclose(found.corners, expected, atol=0.15)


def test_the_estimate_lies_between_prediction_and_measurement_by_their_variances():
    step = tracking.kalman_step(4, interval=1 / 33, acceleration=300.0, noise=1.0)
    weight = step.predicted_std**2 / (step.predicted_std**2 + step.measured_std**2)
    expected = step.predicted + weight * (step.measured - step.predicted)
    assert step.estimated == pytest.approx(expected, abs=1e-9)
    assert step.estimated_std**-2 == pytest.approx(step.predicted_std**-2 + step.measured_std**-2)
    last = step.track.iloc[-1]
    assert (last["measured"], last["predicted"]) == (step.measured, step.predicted)
    assert last["true"] == pytest.approx(40 * 8 / 33 + 300 * (8 / 33) ** 2 / 2)
