"""Without its distortion a lens images planes by homographies, whoever computes it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from microlib.calibration import calibrate, detect_circles
from tests.calibration.test_calibrate import CAMERA, lens_views

#: Views through Brown's distortion with two terms, an axis aside, and hardly any noise.
WORLD, SEEN = lens_views(4, aside=(9.0, -6.0), second=0.08, noise=1e-4)


@pytest.fixture(scope="module")
def found():
    return calibrate(WORLD, SEEN, **CAMERA)


def beside_homography(world: np.ndarray, points: np.ndarray) -> float:
    matrix, _ = cv2.findHomography(world, points)
    return float(np.abs(cv2.perspectiveTransform(world[None], matrix)[0] - points).max())


def test_points_of_a_plane_lie_on_its_homography(found):
    assert {"distortion_2", "principal_x"} <= set(found.parameters)
    for world, seen in zip(WORLD, SEEN, strict=True):
        assert beside_homography(world, seen) > 1.5
        # Two models of two terms each part in the third: 0.001 px here.
        assert beside_homography(world, found.undistort(seen)) < 0.01
    np.testing.assert_allclose(found.undistort([found.principal_point]), [found.principal_point])


def test_a_point_beyond_the_fold_is_unknown(found):
    scope = found.microscope
    edge = 1 / np.sqrt(3 * abs(scope.distortion)) / scope.cell[0]
    inside, beyond = found.principal_point + np.array([[0.5 * edge, 0], [1.1 * edge, 0]])
    if scope.distortion < 0:
        straight = found.undistort([inside, beyond])
        assert np.isfinite(straight[0]).all()
        assert np.isnan(straight[1]).all()


def test_an_image_is_straightened_as_its_points_are(found):
    """Discs at undistorted places of a lattice, drawn where the lens shows them."""
    lattice = 34.0 * np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-6, 7)), -1).reshape(-1, 2)
    y, x = np.mgrid[:480, :640].astype(float)
    straight = found.undistort(np.column_stack([x.ravel(), y.ravel()]))
    beside = straight[:, None] - (found.principal_point + lattice)
    distance = np.hypot(*np.moveaxis(beside, -1, 0)).min(axis=1).reshape(480, 640)
    image = np.round(200 - 150 / (1 + np.exp((distance - 9) / 0.6))).astype(np.uint8)
    bent = detect_circles(image)
    flat = detect_circles(found.undistort_image(image))
    assert found.undistort_image(image).dtype == np.uint8
    assert beside_homography(bent.positions, bent.points) > 1
    # Resampling moves centers by some hundredths of a pixel.
    assert beside_homography(flat.positions, flat.points) < 0.1
    step = np.linalg.norm(flat.points[1] - flat.points[0])
    assert step == pytest.approx(34.0, abs=0.1)


def test_colors_and_types_stay_what_they_are(found):
    rng = np.random.default_rng(0)
    colored = rng.integers(0, 65535, (480, 640, 3)).astype(np.uint16)
    straight = found.undistort_image(colored)
    assert straight.dtype == np.uint16
    assert straight.shape == colored.shape
    np.testing.assert_array_equal(straight[..., 1], found.undistort_image(colored[..., 1]))
    assert found.undistort_image(np.ones((480, 640))).dtype == np.float32


@pytest.mark.parametrize("image", [np.zeros((640, 480)), np.zeros(5), np.zeros((480, 640, 1, 1))])
def test_an_image_of_another_size_is_refused(found, image):
    with pytest.raises(ValueError, match="image must have the size"):
        found.undistort_image(image)


def test_points_are_pairs(found):
    with pytest.raises(ValueError, match="points"):
        found.undistort([1.0, 2.0, 3.0])
