"""What a microscopist takes away: µm per pixel, the stage's axes, and files for other programs."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest

from microlib.calibration import Calibration, calibrate, stage_affine
from tests.checks import hold_coverage
from tests.scenes.calibration import MOVES, SCOPE, SENSOR, grid_in_view, seen_by_opencv


def turned(scale, angle, *, mirrored=False):
    cos, sin = np.cos(angle), np.sin(angle)
    return scale * np.array([[cos, -sin], [sin, cos]]) @ np.diag([1, -1 if mirrored else 1])


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("angle", [-3.0, -0.4, 0.02, 1.7])
def test_exact_stage_moves_give_the_exact_map(angle, mirrored):
    matrix = turned(1.6, angle, mirrored=mirrored)
    place = np.array([1e4, -3e3])  # where the stage was
    found = stage_affine(MOVES + place, MOVES @ matrix.T + [320, 240])
    np.testing.assert_allclose(found.matrix[:, :2], matrix, atol=1e-12)
    np.testing.assert_allclose(found.matrix @ [*place, 1], [320, 240], atol=1e-8)
    assert found.um_per_pixel.value == pytest.approx(1 / 1.6)
    assert found.angle == pytest.approx(angle)
    assert found.mirrored is mirrored
    a, b, tx, c, d, ty = map(float, found.micro_manager.split(";"))
    np.testing.assert_allclose(np.array([[a, b], [c, d]]) @ matrix, np.eye(2), atol=1e-7)
    assert tx == ty == 0


def test_intervals_of_a_stage_scale_contain_the_truth_as_often_as_stated():
    matrix, inside, scores = turned(1.6, 0.4) @ [[1, 0], [0.9, 0.5]], [], []
    # The two axes are determined with different uncertainty, far from the zero of the stage.
    moves = MOVES * [1, 0.2] + [1e4, -3e3]
    true = np.column_stack([matrix, -matrix @ [1e4, -3e3]])
    size = 1 / np.sqrt(np.linalg.det(matrix))
    for seed in range(400):
        seen = (
            moves @ matrix.T + true[:, 2] + np.random.default_rng(seed).normal(0, 0.3, moves.shape)
        )
        found = stage_affine(moves, seen)
        low, high = found.um_per_pixel.interval
        inside.append(low <= size <= high)
        error = (found.matrix - true).ravel()
        scores.append(error @ np.linalg.solve(found.covariance, error) / 6)
    left = seen - moves @ found.matrix[:, :2].T - found.matrix[:, 2]
    np.testing.assert_allclose(found.residuals, left, atol=1e-8)  # rounding of 1e4 µm
    assert found.um_per_pixel.unit == "µm/px"
    hold_coverage(inside, 0.95)
    # F with 6 and 8 degrees of freedom: mean 8/6, standard deviation 1.3.
    assert np.mean(scores) == pytest.approx(8 / 6, abs=0.2)


def test_three_stage_moves_have_nan_uncertainty_and_moves_on_one_line_are_rejected():
    found = stage_affine(MOVES[:3], MOVES[:3] * 2)
    assert np.isnan(found.covariance).all()
    assert np.isnan([found.um_per_pixel.uncertainty, *found.um_per_pixel.interval]).all()
    for name, moves in (("stage", MOVES * [1, 0]), ("image", MOVES * [0, 1])):
        with pytest.raises(ValueError, match=name):
            stage_affine(**{"stage": MOVES, "image": MOVES} | {name: moves})


NARROW = {"tube_length": 236.4, "focal_length": 2364.0, "distance": 23640.0}
ALL_TERMS = replace(SCOPE, principal_offset=(3.0, -2.0), distortion_k2=-3e-17)
WIDE = replace(SCOPE, **NARROW, distortion=7e-8, alpha=0.2, beta=0.1, gamma=0.1)
FAR = {"tube_length": 0.95 * SCOPE.tube_length, "distance": SCOPE.distance / 0.95, "alpha": -0.4}


@pytest.mark.parametrize(
    ("scope", "change", "pitch", "given", "error"),
    [
        (ALL_TERMS, {"alpha": -0.4, "beta": -0.25, "gamma": 0.1}, 280.0, {}, 0.01),
        # The corners are at 71° from the axis: five coefficients are wrong by some pixels.
        (WIDE, {"alpha": -0.2, "beta": -0.1}, 2500.0, {}, 0.3),
        # OpenCV has one camera matrix for two views whose T_op + f differ by their magnification:
        # the error is 12 px if each view kept its own distance.
        (SCOPE, FAR, 280.0, {"focal_length": SCOPE.focal_length}, 0.2),
    ],
    ids=["all terms", "wide angle", "two magnifications"],
)
def test_json_gives_opencv_the_same_image_points(scope, change, pitch, given, error):
    scopes = [scope, replace(scope, **change)]
    worlds = [grid_in_view(each, pitch) for each in scopes]
    images = [each.project(world) for each, world in zip(scopes, worlds, strict=True)]
    content = json.loads(calibrate(worlds, images, **SENSOR, **given).to_json())
    camera = content["opencv"]
    assert camera["distortion_model_error_px"] < error
    assert np.shape([camera["rotation_vectors"], camera["translation_vectors_um"]]) == (2, 2, 3)
    assert (camera["image_width"], camera["image_height"]) == scope.image_size
    for seen, image in zip(seen_by_opencv(camera, worlds), images, strict=True):
        assert np.abs(seen - image).max() < error
    assert scope is not WIDE or len(camera["distortion_coefficients"]) == 8


def test_json_gives_imagej_and_micro_manager_the_pixel_size():
    """Sensor pixels are not square; Micro-Manager takes the root of the area of a pixel."""
    world = grid_in_view(SCOPE)
    noise = np.random.default_rng(0).normal(0, 0.5, world.shape)
    found = calibrate(world, SCOPE.project(world) + noise, **SENSOR)
    content = json.loads(found.to_json())
    width, height = SCOPE.pitch / found.microscope.magnification
    pixel = content["imagej"]
    assert pixel["unit"] == "µm"
    assert (pixel["pixel_width"], pixel["pixel_height"]) == pytest.approx((width, height))
    mean = content["micro_manager"]["PixelSizeUm"]
    assert mean == pytest.approx(np.sqrt(width * height))
    relative = np.divide(found.um_per_pixel.interval, found.um_per_pixel.value)
    np.testing.assert_allclose(np.divide(content["pixel_size_interval_um"], mean), relative)


@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_calibration_survives_json_and_csv(tilt, tmp_path):
    """Also what is not finite: variances of what one view without tilt does not determine."""
    scope = replace(SCOPE, beta=tilt, gamma=0.0)
    world = grid_in_view(scope)
    seen = scope.project(world) + np.random.default_rng(0).normal(0, 0.02, world.shape)
    found = calibrate(world, seen, **SENSOR)
    assert ("focal_length" in found.undetermined) is (tilt == 0)
    found = replace(found, views=(*found.views, replace(found.microscope, gamma=0.1)))
    json.loads(found.to_json(), parse_constant=pytest.fail)  # no NaN, which JSON does not know
    again = Calibration.from_json(found.to_json())
    for field in fields(found):
        here, there = getattr(found, field.name), getattr(again, field.name)
        if isinstance(here, np.ndarray):
            np.testing.assert_array_equal(there, here)  # all digits are kept
        else:
            assert str(there) == str(here), field.name
    assert again.to_json() == found.to_json()
    assert repr(again) == repr(found)
    found.to_frame().to_csv(tmp_path / "found.csv")
    table = pd.read_csv(tmp_path / "found.csv", index_col="parameter")
    pd.testing.assert_frame_equal(table.fillna({"unit": ""}), found.to_frame())
    assert list(table.index) == list(found.parameters)
    np.testing.assert_allclose(table["uncertainty"] ** 2, np.diag(found.covariance))
    spans = np.array([each.interval for each in found.parameters.values()])
    np.testing.assert_allclose(table[["low", "high"]], spans)
    assert set(table.index[~table["determined"]]) == set(found.undetermined)


@pytest.mark.parametrize("text", ["", "{}", '{"calibration": {"views": []}}', "3"])
def test_json_of_another_kind_is_rejected(text):
    with pytest.raises(ValueError, match="text must be what to_json wrote"):
        Calibration.from_json(text)


def test_intervals_of_lengths_are_not_negative():
    """Points with an error of a tenth of the field: what has no upper end is not given one."""
    rng = np.random.default_rng(1)
    world = 1000.0 * np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.7], [0.8, 0.2]])
    scope = replace(SCOPE, beta=0.0, gamma=0.0)
    seen = np.clip(scope.project(world) + rng.normal(0, 15, world.shape), 0, [655, 490])
    found = calibrate(world, seen, focal_length=126e3, **SENSOR)
    low, high = calibrate(world, seen, **SENSOR).parameters["focal_length"].interval
    assert 0 <= low < high == np.inf
    scale = replace(found.parameters["magnification"], low=0.0)
    lost = replace(found, parameters=found.parameters | {"magnification": scale})
    assert 0 < lost.um_per_pixel.low < lost.um_per_pixel.value < lost.um_per_pixel.high == np.inf
    assert "to inf" in repr(lost)
    assert json.loads(lost.to_json())["pixel_size_interval_um"][1] is None
    moves = stage_affine(MOVES[:4], MOVES[:4] + rng.normal(0, 60, (4, 2)))
    pixel = moves.um_per_pixel
    assert 0 < pixel.low < pixel.value < pixel.high == np.inf
