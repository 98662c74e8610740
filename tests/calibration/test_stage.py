"""What a microscopist takes away: µm per pixel, the stage's axes, and files for other programs."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import cv2
import numpy as np
import pandas as pd
import pytest

from microlib.calibration import Calibration, calibrate, stage_affine
from microlib.microscope import Microscope

MOVES = np.array([[0.0, 0], [40, 0], [0, 40], [-40, 0], [0, -40], [40, 40], [-40, 30]])


def turned(scale, angle, *, mirrored=False):
    cos, sin = np.cos(angle), np.sin(angle)
    return scale * np.array([[cos, -sin], [sin, cos]]) @ np.diag([1, -1 if mirrored else 1])


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("angle", [-3.0, -0.4, 0.02, 1.7])
def test_exact_moves_give_the_exact_map(angle, mirrored):
    matrix = turned(1.6, angle, mirrored=mirrored)
    found = stage_affine(MOVES + np.array([1e4, -3e3]), MOVES @ matrix.T + [320, 240])
    np.testing.assert_allclose(found.matrix[:, :2], matrix, atol=1e-12)
    np.testing.assert_allclose(
        found.matrix @ [1e4, -3e3, 1], [320, 240], atol=1e-8
    )  # where the stage was
    assert found.um_per_pixel[0] == pytest.approx(1 / 1.6)
    assert found.angle == pytest.approx(angle)
    assert found.mirrored is mirrored
    a, b, tx, c, d, ty = map(float, found.micro_manager.split(";"))
    np.testing.assert_allclose(np.array([[a, b], [c, d]]) @ matrix, np.eye(2), atol=1e-7)
    assert tx == ty == 0


def test_stage_intervals_cover():
    matrix, inside, scores = turned(1.6, 0.4) @ [[1, 0], [0.9, 0.5]], [], []
    moves = MOVES * [1, 0.2]  # the two axes are determined with different uncertainty
    size = 1 / np.sqrt(np.linalg.det(matrix))
    for seed in range(400):
        seen = moves @ matrix.T + np.random.default_rng(seed).normal(0, 0.3, moves.shape)
        found = stage_affine(moves, seen)
        _, low, high = found.um_per_pixel
        inside.append(low <= size <= high)
        error = (found.matrix - np.column_stack([matrix, [0, 0]])).ravel()
        scores.append(error @ np.linalg.solve(found.covariance, error) / 6)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.033)  # three standard errors
    # F with 6 and 8 degrees of freedom: mean 8/6, standard deviation 1.3.
    assert np.mean(scores) == pytest.approx(8 / 6, abs=0.2)


def test_three_moves_have_nan_uncertainty():
    found = stage_affine(MOVES[:3], MOVES[:3] * 2)
    assert np.isnan(found.covariance).all()
    assert np.isnan(found.um_per_pixel[1])


@pytest.mark.parametrize(
    ("stage", "image", "word"),
    [
        (MOVES[:2], MOVES[:2], "stage"),
        (MOVES * [1, 0], MOVES, "stage"),
        (MOVES, MOVES * [0, 1], "image"),
    ],
)
def test_degenerate_moves_are_rejected(stage, image, word):
    with pytest.raises(ValueError, match=word):
        stage_affine(stage, image)


SCOPE = Microscope(2e5, 126000, 79380, -8e-10, 0.3, 0.2, -0.15, -900, -700)


def in_view(scope):
    """Points of a lattice that a microscope sees, µm."""
    world = 280.0 * np.stack(np.meshgrid(np.arange(-4, 14), np.arange(-4, 12)), -1).reshape(-1, 2)
    seen = scope.project(world)
    return world[((seen > 5) & (seen < [650, 485])).all(axis=1)]


WORLD = in_view(SCOPE)


def test_opencv_projection_from_json_equals_the_model():
    found = calibrate(WORLD, SCOPE.project(WORLD), pixel_size=9.9, image_size=(656, 491))
    content = json.loads(found.to_json())
    camera = content["opencv"]
    seen, _ = cv2.projectPoints(
        np.column_stack([WORLD, np.zeros(len(WORLD))]),
        np.array(camera["rotation_vectors"][0]),
        np.array(camera["translation_vectors_um"][0]),
        np.array(camera["camera_matrix"]),
        np.array(camera["distortion_coefficients"]),
    )
    error = np.abs(seen[:, 0] - SCOPE.project(WORLD)).max()
    assert error < camera["distortion_model_error_px"] + 1e-4
    assert camera["distortion_model_error_px"] < 1e-3
    assert content["imagej"]["pixel_width"] == pytest.approx(9.9 / SCOPE.magnification)
    assert content["micro_manager"]["PixelSizeUm"] == content["imagej"]["pixel_width"]


@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_calibration_survives_json_and_csv(tilt, tmp_path):
    """Also what is not finite: variances of what one view without tilt does not determine."""
    scope = Microscope(2e5, 126000, 79380, -8e-10, 0.3, tilt, 0, -900, -700)
    world = in_view(scope)
    noise = np.random.default_rng(0).normal(0, 0.02, world.shape)
    found = calibrate(
        world, scope.project(world) + noise, pixel_size=(9.9, 9.8), image_size=(656, 491)
    )
    assert ("focal_length" in found.undetermined) is (tilt == 0)
    found = replace(found, views=(*found.views, replace(found.microscope, gamma=0.1)))
    json.loads(found.to_json(), parse_constant=pytest.fail)  # no NaN, which JSON does not know
    again = Calibration.from_json(found.to_json())
    for field in fields(found):
        here, there = getattr(found, field.name), getattr(again, field.name)
        if isinstance(here, np.ndarray):
            np.testing.assert_array_equal(there, here)  # all digits are kept
        else:
            assert there == here, field.name
    assert again.to_json() == found.to_json()
    assert repr(again) == repr(found)
    found.to_frame().to_csv(tmp_path / "found.csv")
    table = pd.read_csv(tmp_path / "found.csv", index_col="parameter")
    pd.testing.assert_frame_equal(table, found.to_frame())
    for wrong in ("", "{}", '{"calibration": {"views": []}}', "3"):
        with pytest.raises(ValueError, match="text must be what to_json wrote"):
            Calibration.from_json(wrong)


def test_table_has_every_parameter_with_its_sigma():
    noise = np.random.default_rng(0).normal(0, 0.02, WORLD.shape)
    seen = SCOPE.project(WORLD) + noise
    found = calibrate(WORLD, seen, pixel_size=9.9, image_size=(656, 491))
    np.testing.assert_allclose(
        found.plane_residuals, found.microscope.back_project(seen) - WORLD, atol=1e-6
    )
    table = found.to_frame()
    assert tuple(table.index) == found.parameters
    np.testing.assert_allclose(table["sigma"] ** 2, np.diag(found.covariance))
    assert (table["low"] < table["estimate"]).all()
    assert table["determined"].all()
    assert len(repr(found).splitlines()) <= 10


def test_pixel_height_follows_sensor_pixels():
    """ImageJ and Micro-Manager are told sizes by which a step of the pattern has its length."""
    sensor = {"pixel_size": (8.6, 8.3), "image_size": (656, 491)}
    scope = Microscope(2e5, 126e3, 79380, tx=-900, ty=-700, **sensor)
    world = in_view(scope)
    found = calibrate(world, scope.project(world), focal_length=126e3, **sensor)
    content = json.loads(found.to_json())
    across, along = scope.project([[500.0, 0.0], [0.0, 700.0]]) - scope.project([[0.0, 0.0]])
    assert across[0] * content["imagej"]["pixel_width"] == pytest.approx(500)
    assert found.um_per_pixel()[0] == content["imagej"]["pixel_width"]
    assert along[1] * content["imagej"]["pixel_height"] == pytest.approx(700)
    area = content["micro_manager"]["PixelSizeUm"] ** 2  # as Micro-Manager has it of an affine map
    assert across[0] * along[1] * area == pytest.approx(500 * 700)


def test_intervals_of_lengths_are_not_negative():
    """Points with an error of a tenth of the field: what has no upper end is not given one."""
    rng = np.random.default_rng(1)
    world = 1000.0 * np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.7], [0.8, 0.2]])
    scope = replace(SCOPE, beta=0.0, gamma=0.0)
    seen = scope.project(world) + rng.normal(0, 15, world.shape)
    seen = np.clip(seen, 0, [655, 490])
    found = calibrate(world, seen, pixel_size=9.9, image_size=(656, 491), focal_length=126e3)
    wide = 1 - 1e-9
    low, high = found.interval("magnification", wide)
    assert 0 == low < high
    value, low, high = found.um_per_pixel(wide)
    assert 0 < low < value < high == np.inf
    free = calibrate(world, seen, pixel_size=9.9, image_size=(656, 491))
    low, high = free.interval("focal_length", wide)
    assert 0 <= low < high == np.inf
    lost = replace(found, covariance=1e6 * found.covariance)
    assert "95 % above" in repr(lost)
    assert json.loads(lost.to_json())["pixel_size_interval_um"][1] is None
    moves = stage_affine(MOVES[:4], MOVES[:4] + rng.normal(0, 60, (4, 2)))
    assert 0 < moves.um_per_pixel[1] < moves.um_per_pixel[0] < moves.um_per_pixel[2] == np.inf
