"""The Kalman filter against OpenCV's, and on a motion that its model describes."""

import cv2
import numpy as np

from microlib.tracking import ESMTracker, KalmanFilter
from tests.scenes import moving_square

INTERVAL, ACCELERATION, NOISE = 0.03, 300.0, 0.2


def peer(position: np.ndarray, covariance: np.ndarray) -> cv2.KalmanFilter:
    """OpenCV's general filter with the same model."""
    kalman = cv2.KalmanFilter(4, 2, 0, cv2.CV_64F)
    kalman.transitionMatrix = np.kron([[1.0, INTERVAL], [0, 1]], np.eye(2))
    kalman.measurementMatrix = np.eye(2, 4)
    drive = np.array([INTERVAL**2 / 2, INTERVAL])
    kalman.processNoiseCov = np.kron(ACCELERATION**2 * np.outer(drive, drive), np.eye(2))
    kalman.measurementNoiseCov = NOISE**2 * np.eye(2)
    kalman.errorCovPost = np.kron(covariance, np.eye(2))
    kalman.statePost = np.append(position, [0.0, 0.0])[:, None]
    return kalman


def test_kalman_filter_agrees_with_opencv():
    rng = np.random.default_rng(3)
    first = np.array([3.0, -2.0])
    ours = KalmanFilter(first, interval=INTERVAL, acceleration=ACCELERATION, noise=NOISE)
    theirs = peer(ours.position, ours.covariance)
    predicted, wanted = [], []
    for measured in rng.normal(0, 5, (30, 2)):
        predicted.append(ours.predict())
        wanted.append(theirs.predict()[:2, 0].copy())
        theirs.correct(measured[:, None])
        ours.update(measured)
        np.testing.assert_allclose(ours.velocity, theirs.statePost[2:, 0], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(
            ours.covariance, theirs.errorCovPost[::2, ::2], rtol=1e-7, atol=1e-12
        )
    # Two implementations in double precision: rounding only. What was predicted stays as it was.
    np.testing.assert_allclose(predicted, wanted, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(first, [3.0, -2.0])


def test_lost_template_is_searched_where_the_filter_predicts_it():
    way = np.array([20.3, 30.6]) + np.outer(np.arange(12), [7.0, 4.0])
    frames = moving_square(way, np.random.default_rng(0), size=40)
    middle = way[0] + 19.5
    filtered = KalmanFilter(middle, interval=INTERVAL, acceleration=ACCELERATION, noise=NOISE)
    tracker = ESMTracker(frames[0], (20, 31, 40, 40), "translation", kalman=filtered)
    assert not any(tracker.track(frame).lost for frame in frames[1:9])
    blank = np.full_like(frames[0], 128)
    for k in (9, 10):
        track = tracker.track(blank)
        assert track.lost
        # Eight looks to some hundredths of a px know the speed to a tenth of a px a frame.
        assert np.abs(track.center - (way[k] - way[0] + (39.5, 50.5))).max() < 0.5
    assert not tracker.track(frames[11]).lost
