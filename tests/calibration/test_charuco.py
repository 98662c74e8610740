"""ChArUco boards against what was drawn."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from microlib.calibration import detect_charuco, detect_pattern, detect_squares
from tests.scenes.calibration import photograph

FIELD = 60  # px of a field of the drawn board


def charuco(columns=7, rows=5, name="4X4_50", ratio=0.7, *, old=False, left=0):
    """Draw a board seen from aside; return it and where corner (i, j) of the board is, px."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, ratio, markers)
    board.setLegacyPattern(old)
    flat = board.generateImage((FIELD * columns, FIELD * rows))
    size = (FIELD * columns + 80, FIELD * rows + 60)
    view = np.array([[0.93, 0.08, 30.0], [-0.05, 0.97, 40.0], [2e-4, 1e-4, 1.0]])
    view = np.array([[1, 0, -left], [0, 1, 0], [0, 0, 1.0]]) @ view
    image = cv2.warpPerspective(flat, view, size, borderValue=255, flags=cv2.INTER_AREA)
    # A pixel's middle is a whole number, and the board begins at its edge.
    corners = FIELD * np.argwhere(np.ones((columns - 1, rows - 1))) + FIELD - 0.5
    truth = cv2.perspectiveTransform(corners[None].astype(float), view)[0]
    return photograph(image * 0.7 + 20, 1.0, 2.0), truth


@pytest.mark.parametrize(
    "drawn",
    [
        {},
        {"columns": 6, "rows": 8, "name": "6X6_250", "ratio": 0.8, "old": True},
        {"columns": 9, "rows": 6, "name": "5X5_100", "ratio": 0.6, "left": 170},
        {"columns": 8, "rows": 6, "name": "APRILTAG_36h11", "ratio": 0.75},
        {"columns": 8, "rows": 6, "name": "ARUCO_MIP_36h12", "ratio": 0.75},
        {"columns": 22, "rows": 10, "name": "4X4_1000"},
    ],
)
def test_charuco_corners_are_accurate_and_named(drawn):
    image, truth = charuco(**drawn)
    named, found = detect_pattern(image)
    assert named == "charuco"
    grid = np.argwhere(np.ones((drawn.get("columns", 7) - 1, drawn.get("rows", 5) - 1)))
    grid -= [grid[:, 0].max() - found.grid[:, 0].max(), 0]  # what is cut off lies to the left
    np.testing.assert_array_equal(found.positions, found.grid)
    at = [int(np.flatnonzero((grid == place).all(axis=1))[0]) for place in found.grid]
    assert len(at) >= 0.6 * len(grid)
    off = found.points - truth[at]
    assert np.sqrt((off**2).mean()) < 0.1  # OpenCV's corners, of fields of 60 px with noise
    assert found.uncertainty[0] == pytest.approx(np.sqrt((off**2).mean()), abs=0.05)


def test_inverted_charuco_board_has_the_same_corners():
    image, _ = charuco()
    plain, inverted = (detect_charuco(each) for each in (image, 255 - image))
    np.testing.assert_array_equal(inverted.grid, plain.grid)
    # The noise of 2 levels moves a corner by 0.05 px, and weighs otherwise on a bright ground.
    np.testing.assert_allclose(inverted.points, plain.points, atol=0.1)


@pytest.mark.parametrize("seed", [1, 9])
def test_small_inverted_board_is_detected_before_a_busy_ground(seed):
    """The saddle points of the ground form lattices of 54 points; the board has 12 corners."""
    rng = np.random.default_rng(seed)
    normal = [rng.normal(0, 1, (720, 1280)) for _ in range(3)]
    ground = sum(
        blur * cv2.GaussianBlur(layer, (0, 0), blur)
        for blur, layer in zip((1.2, 3, 9), normal, strict=True)
    )
    ground = 90 + 45 * ground / ground.std()
    view = np.array([[0.95, -0.1, 190], [0.08, 1, 275], [1e-4, 2e-4, 1]])
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    flat = 255 - cv2.aruco.CharucoBoard((4, 5), 1.0, 0.75, markers).generateImage((320, 400))
    board, sheet = (cv2.warpPerspective(each, view, (1280, 720)) for each in (flat, 0 * flat + 255))
    image = np.where(sheet > 127, 40 + 0.6 * board, ground)
    found = detect_charuco(photograph(image, 1.0, 2.0, seed))
    corners = 80.0 * np.argwhere(np.ones((3, 4))) + 79.5
    truth = cv2.perspectiveTransform(corners[None], view)[0]
    assert len(found.points) == 12
    distance = np.linalg.norm(found.points[:, None] - truth, axis=2)
    assert distance.min(axis=0).max() < 0.3


@pytest.mark.parametrize("noise", [2.0, 15.0])
@pytest.mark.parametrize("blur", [0.3, 1.5])
def test_chessboard_without_markers_is_not_named_charuco(noise, blur):
    """In one photograph the blur of a chessboard hid it from its own detector."""
    board = np.kron(np.indices((6, 7)).sum(axis=0) % 2, np.ones((20, 20)))
    image = photograph(40 + 160 * np.pad(board, 20, constant_values=0.5), blur, noise)
    assert detect_pattern(image)[0] == "chessboard"
    with pytest.raises(ValueError, match="no markers in its fields"):
        detect_charuco(image)


def test_charuco_board_is_rejected_as_a_chessboard():
    """The corners that are farthest from markers were 12 of 24."""
    with pytest.raises(ValueError, match="with markers in its fields"):
        detect_squares(charuco()[0], pattern="chessboard")
