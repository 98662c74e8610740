"""The calls of every public function of tracking: their units, their axes and what they refuse."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage

from microlib.synthetic import mixed_texture
from microlib.tracking import ESMTracker, KalmanFilter, Track, track_all, track_each
from tests.checks import (
    BROKEN,
    NO_TEXT,
    NOT_POSITIVE,
    Wrong,
    each_view,
    hold_call,
    hold_refused,
    hold_same_as_new,
    hold_scaled,
    no_array,
    no_map,
)

BOX = (38, 26, 52, 41)
#: Its standard deviation of 28 grey levels makes the tracker's scale change with the unit.
SCENE = mixed_texture((110, 140), np.random.default_rng(4), scales=(2.0, 5.0), mean=90.0, std=28.0)
BY, GAIN = np.array([2.6, -1.8]), 0.8
MOVED = GAIN * ndimage.shift(SCENE, BY[::-1], order=5, mode="mirror") + 30
NOISE = np.random.default_rng(5).normal(0, 0.3, (2, 110, 140))


#: A frame, and one of the moved scene with another gain and bias.
FRAMES = [SCENE + NOISE[0], MOVED + NOISE[1]]
START = np.array([12.0, -5.0])


def filtered(px: float = 1.0, s: float = 1.0, start: np.ndarray = START) -> dict:
    motion = {"interval": 0.04 * s, "acceleration": 300.0 * px / s**2, "noise": 0.2 * px}
    return {"position": start * px, **motion}


def used(px: float = 1.0, s: float = 1.0, start: np.ndarray = START) -> KalmanFilter:
    """Return a filter that has seen two frames."""
    kalman = KalmanFilter(**filtered(px, s, start))
    for k in (1, 2):
        kalman.predict()
        kalman.update((start + k * np.array([3.0, -2.0])) * px)
    return kalman


def steps(kalman: KalmanFilter, position: object = None) -> tuple:
    expected = kalman.predict()
    if position is not None:
        kalman.update(position)
    return expected, kalman.position, kalman.velocity, kalman.covariance


def film(grey: float = 1.0) -> dict:
    frames = [grey * frame for frame in FRAMES]
    return {"frames": frames, "box": BOX, "motion": "affine", "rate": 0.25, "pixel_size": 0.15}


#: The result for a frame.
FOUND = {
    "corners": np.zeros((4, 2)), "lost": False, "reason": "", "correlation": 1.0,
    "homography": np.eye(3), "gain": 1.0, "bias": 0.0, "visible": 1.0, "iterations": 3,
    "covariance": np.eye(2), "confidence": 1.0, "hidden": np.zeros((6, 6), bool),
}  # fmt: skip
#: A valid call of each function.
CALLS = {
    ESMTracker: lambda: {"image": FRAMES[0].copy(), "box": BOX, "motion": "affine"},
    ESMTracker.track: lambda: {
        "self": ESMTracker(FRAMES[0], BOX, "affine"), "frame": FRAMES[1].copy(),
    },
    KalmanFilter: filtered, KalmanFilter.predict: lambda: {"self": used()},
    KalmanFilter.update: lambda: {"self": used(), "position": START + np.array([8.7, -6.2])},
    track_all: film, track_each: film,
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)
FILM = {
    "frames": no_map, "box": no_array, "motion": NO_TEXT, "rate": NOT_POSITIVE,
    "pixel_size": [*BROKEN, 0, -1], "kalman": [5, "kalman"],
}  # fmt: skip
#: What is refused in place of each argument.
REFUSED = {
    ESMTracker: {
        "mask": [
            *(np.ones((20, 30)), np.full(SCENE.shape, np.nan)),
            Wrong(0 * SCENE, "mask must hold at least 36 px of the box, got 0"),
        ]
    },
    ESMTracker.track: {"frame": lambda valid: [*no_array(valid), np.zeros((20, 30))]},
    track_all: FILM, track_each: FILM,
}  # fmt: skip


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function], undecided=0.002)


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


@pytest.mark.parametrize("grey", [1 / 255, 257.0])
def test_track_follows_unit_of_grey_levels(grey):
    """The tracker scales them by a power of two, and ends its iteration at 0.05 px."""
    first, second = (grey * frame for frame in FRAMES)
    plain = ESMTracker(FRAMES[0], BOX, "affine").track(FRAMES[1])
    found = ESMTracker(first, BOX, "affine").track(second)
    hold_scaled(found, plain, within=2e-3, bias=grey)
    hold_scaled(found.to_dict(), plain.to_dict(), within=2e-3, bias=grey)


@pytest.mark.parametrize(("px", "s", "start"), [(0.006, 2.3, START), (1.0, 1.0, START + 31.0)])
def test_kalman_filter_follows_units_and_origin(px, s, start):
    measured = np.array([8.7, -6.2])
    found = steps(used(px, s, start), (start + measured) * px)
    plain = steps(used(), START + measured)
    scale = np.outer([px, px / s], [px, px / s])
    shift = px * (start - START)
    wanted = (px * plain[0] + shift, px * plain[1] + shift, px / s * plain[2], scale * plain[3])
    hold_scaled(found, wanted)


@pytest.mark.parametrize("grey", [1e-9, 1e-6, 1.0, 257.0, 2e7])
@pytest.mark.parametrize("ramp", [0.0, 0.5])  # grey levels a px
@pytest.mark.parametrize("box", [BOX, (38, 26, 51, 40)])
def test_gain_and_bias_are_those_at_the_middle_of_the_template(grey, ramp, box):
    scene = 2 * SCENE
    right = np.arange(140) - (box[0] + (box[2] - 1) / 2)
    track = ESMTracker(scene * grey, box, "translation").track(
        (GAIN * scene + 30 + ramp * right) * grey
    )
    # Float32 rounding, and an iteration that ends at 0.05 px; with a ramp, also half a px from the
    # middle of an even side to the next pixel.
    assert track.gain == pytest.approx(GAIN, abs=2e-3)
    assert track.bias == pytest.approx(30 * grey, abs=(0.1 + 0.5 * ramp) * grey)


@each_view
def test_track_follows_flips_and_rotations(view):
    one, other = SCENE + NOISE[0], MOVED + NOISE[1]
    first = ESMTracker(one, BOX, "affine").track(other)
    box = view.box(BOX, SCENE.shape)
    seen = ESMTracker(view.image(one), box, "affine").track(view.image(other))
    # Sums in another order may end the iteration one step earlier, which moves it by 0.05² px.
    np.testing.assert_allclose(
        seen.center, view.points(first.center[None], SCENE.shape)[0], atol=2.5e-3
    )
    np.testing.assert_allclose(seen.covariance, view.covariance(first.covariance), rtol=0.05)
    moved = view.points(first.corners, SCENE.shape)
    at = np.linalg.norm(seen.corners[:, None] - moved, axis=2)
    assert at.min(axis=0).max() < 5e-3
    assert (seen.gain, seen.bias) == pytest.approx((first.gain, first.bias), rel=1e-3)


def test_track_follows_cropped_frames():
    one, other = SCENE + NOISE[0], MOVED + NOISE[1]
    whole = ESMTracker(one, BOX).track(other)
    part = ESMTracker(one[5:, 12:], (BOX[0] - 12, BOX[1] - 5, *BOX[2:])).track(other[5:, 12:])
    np.testing.assert_allclose(part.corners, whole.corners - [12, 5], atol=5e-3)


def test_arrays_of_the_kalman_filter_are_copies():
    kalman = used()
    for copy in (kalman.predict(), kalman.position, kalman.velocity, kalman.covariance):
        copy[:] = np.nan
    assert np.isfinite([*kalman.position, *kalman.velocity, *kalman.covariance.ravel()]).all()


def test_arrays_of_a_track_are_copies():
    tracker = ESMTracker(SCENE + NOISE[0], BOX, "affine")
    for _ in range(2):
        track = tracker.track(np.random.default_rng(0).normal(0, 28, SCENE.shape))
        assert track.lost
        assert track.hidden.all()
        track.corners[:], track.hidden[:] = np.nan, False


def test_refused_input_leaves_state_unchanged():
    refused = [lambda kalman: kalman.update((np.nan, 0)), lambda kalman: kalman.update((1, 2, 3))]
    hold_same_as_new(lambda: used(), lambda kalman: steps(kalman, (15.0, 3.0)), *refused)
    refused = [
        lambda tracker: tracker.track(MOVED[:-1]),
        lambda tracker: tracker.track(MOVED * np.inf),
    ]
    new = lambda: ESMTracker(SCENE + NOISE[0], BOX, "affine")  # noqa: E731
    hold_same_as_new(new, lambda tracker: tracker.track(MOVED + NOISE[1]), *refused)


def test_track_of_a_frame_does_not_depend_on_earlier_frames():
    one, other = SCENE + NOISE[0], MOVED + NOISE[1]
    absent = np.random.default_rng(0).normal(0, 28, one.shape)
    new = ESMTracker(one, BOX, "affine").track(other)
    tracker = ESMTracker(one, BOX, "affine")
    for earlier in ([other], [other, other], [absent], [one, absent, absent, one]):
        for frame in earlier:
            tracker.track(frame)
        again = tracker.track(other)
        assert not again.lost
        # The alignments start from different poses and end within 0.05 px.
        np.testing.assert_allclose(again.corners, new.corners, atol=0.01)
        assert again.gain == pytest.approx(new.gain, rel=0.01)
        np.testing.assert_array_equal(again.hidden, new.hidden)
        # OpenCV 4 rounds positions to 1/32 px, which here changes the residuals by a third.
        within = 0.4 if cv2.__version__ < "5" else 0.2
        np.testing.assert_allclose(again.covariance, new.covariance, rtol=within)


def test_row_of_a_track_names_each_number():
    corners = np.array([[1.0, 2], [30, 4], [31, 25], [3, 26]])
    numbers = {"corners": corners, "homography": np.arange(9.0).reshape(3, 3)}
    row = Track(**FOUND | numbers | {"hidden": np.arange(12).reshape(3, 4) < 3}).to_dict()
    assert row.items() >= {
        "corners_top_left_y": 2.0, "corners_top_right_x": 30.0, "corners_bottom_right_x": 31.0,
        "corners_bottom_left_y": 26.0, "center_x": 16.25, "center_y": 14.25, "hidden": 0.25,
        "homography_x_y": 1.0, "homography_y_shift": 5.0, "homography_scale_x": 6.0,
    }.items()  # fmt: skip
