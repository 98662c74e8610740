"""Detectors on photographed boards: drawn by sampling, seen through a homography and Brown's
distortion, none of which the library's renderer or models use."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import pytest
import skimage.data
from scipy.spatial import cKDTree

from microlib.calibration import detect_circles, detect_micrometer, detect_pattern, detect_squares
from microlib.calibration.detection import _patterns as patterns

SHAPE, FINE = (240, 320), 8
DETECT = {"circle": detect_circles, "square": detect_squares}
HEX = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
#: Places of a 7×5 grid, of a hexagonal one and of an asymmetric one, in pitches.
SQUARE = np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
HEXAGONAL = np.array([[i, j] for j in range(5) for i in range(-(j // 2), 7 - j // 2)]) @ HEX
ASYMMETRIC = np.array([[2 * i + j % 2, j] for j in range(7) for i in range(4)], dtype=float)


def outline(kind: str, size: float) -> np.ndarray:
    """Polygon around the origin: a circle of radius `size` or a square of side `size`."""
    if kind == "circle":
        turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        return size * np.column_stack([np.cos(turn), np.sin(turn)])
    return size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])


def camera(
    points: np.ndarray, pitch: float, turn: float, k1: float, shape: tuple[int, int] = SHAPE
) -> np.ndarray:
    """Points of the pattern, in pitches from its middle, as they are seen, px."""
    (height, width), cos, sin = shape, np.cos(turn), np.sin(turn)
    homography = np.array(
        [[pitch * cos, -pitch * sin, 0], [pitch * sin, pitch * cos, 0], [4e-3, -3e-3, 1]]
    )
    seen = cv2.perspectiveTransform(points.reshape(1, -1, 2), homography)[0] / (width / 2)
    seen = seen * (1 + k1 * (seen**2).sum(axis=1, keepdims=True))
    return (seen * width / 2 + [width / 2 + 3.3, height / 2 - 2.1]).reshape(points.shape)


def board(
    places: np.ndarray,
    kind: str = "circle",
    size: float = 0.25,
    *,
    pitch: float = 34.0,
    turn: float = 0.1,
    k1: float = 0.02,
    blur: float = 1.0,
    noise: float = 2.0,
    ink: float = 50.0,
    paper: float = 200.0,
    behind: np.ndarray | None = None,
    shape: tuple[int, int] = SHAPE,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """A photograph and the true points: centers of circles, corners of squares."""
    middle = (places.max(axis=0) + places.min(axis=0)) / 2
    shapes = (places - middle)[:, None] + outline(kind, size)
    dense = shapes if kind == "circle" else subdivided(shapes)
    lens = (pitch, turn, k1, shape)
    covered = covering(camera(dense, *lens), shape)
    ground = np.full(shape, paper)
    if behind is not None:
        low, high = middle - places.max(axis=0) - 0.6, places.max(axis=0) - middle + 0.6
        frame = camera(np.array([low, [high[0], low[1]], high, [low[0], high[1]]]), *lens)
        ground = cv2.resize(behind, shape[::-1]).astype(float)
        cv2.fillPoly(ground, [np.round(frame).astype(np.int32)], paper)
    image = cv2.GaussianBlur(ground + (ink - paper) * covered, (0, 0), blur)
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    marks = (places - middle)[:, None] if kind == "circle" else shapes
    truth = camera(marks, *lens).reshape(-1, 2)
    return np.clip(np.round(image), 0, 255).astype(np.uint8), truth


def covering(shapes: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The share of each pixel that polygons cover: along rows an eighth of a pixel apart, exact."""
    height, width = shape
    first, second = (np.reshape(each, (-1, 2)) for each in (shapes, np.roll(shapes, -1, axis=1)))
    rows = ((np.arange(height * FINE) + 0.5) / FINE - 0.5)[:, None]
    down = (first[:, 1] <= rows).astype(int) - (second[:, 1] <= rows)  # where an edge passes a row
    row, edge = np.nonzero(down)
    (x, y), (along, drop) = first[edge].T, (second - first)[edge].T
    place = np.clip(x + (rows[row, 0] - y) * along / drop + 0.5, 0, width)
    column, part = np.divmod(place, 1)
    begun = np.zeros((height * FINE, width + 2))
    for aside, share in ((0, 1 - part), (1, part)):
        np.add.at(begun, (row, column.astype(int) + aside), share * down[row, edge])
    # A turn the other way round counts the other way.
    return abs(begun.cumsum(axis=1)[:, :width]).reshape(height, FINE, width).mean(axis=1)


def subdivided(shapes: np.ndarray) -> np.ndarray:
    part = np.linspace(0, 1, 8, endpoint=False)[:, None]
    following = np.roll(shapes, -1, axis=1)
    return (shapes[:, :, None] * (1 - part) + following[:, :, None] * part).reshape(
        len(shapes), -1, 2
    )


def chessboard(columns=8, rows=6, **change):
    """A board of so many fields, and its inner corners in fields and as they are seen, px."""
    settings = {"pitch": 30.0, "turn": 0.15, "k1": 0.02, "shape": SHAPE} | change
    every = np.argwhere(np.ones((columns, rows))).astype(float)
    image, _ = board(every[every.sum(axis=1) % 2 == 0], "square", 1.0, **settings)
    corners = np.argwhere(np.ones((columns - 1, rows - 1))) + 0.5
    lens = (settings[name] for name in ("pitch", "turn", "k1", "shape"))
    return image, corners, camera(corners - [(columns - 1) / 2, (rows - 1) / 2], *lens)


def beside(found, truth: np.ndarray) -> np.ndarray:
    """Distances per coordinate to the nearest true points."""
    return found.points - truth[cKDTree(truth).query(found.points)[1]]


def held(found, truth: np.ndarray) -> float:
    """RMS error over the stated σ."""
    return float(np.sqrt((beside(found, truth) ** 2).mean() / (found.sigma**2).mean()))


# Side and gap


@pytest.mark.parametrize("side", [0.3, 0.6, 0.8, 0.9])
def test_side_and_gap_are_measured(side):
    blur = 1.0 if side < 0.5 else 0.7  # the gap of the last is 3.4 px
    image, truth = board(SQUARE, "square", side, blur=blur, noise=1.0)
    found = detect_squares(image)
    assert len(found.points) == len(truth)
    # Edges are drawn to an eighth of a pixel, which averages out along them; the corners' noise is
    # 0.005 px. With side and gap taken as equal the corners were 0.4 to 1.6 px off.
    assert np.sqrt((beside(found, truth) ** 2).mean()) < 0.015
    assert found.side == pytest.approx(side, abs=0.01)
    steps = found.positions - found.positions[0]
    flat = np.column_stack([found.grid // 2, found.grid % 2])
    np.testing.assert_allclose(
        steps, (flat[:, :2] - flat[0, :2]) + found.side * (flat[:, 2:] - flat[0, 2:]), atol=1e-12
    )


# What is shown


@pytest.mark.parametrize(
    ("kind", "size", "blur", "most"),
    [("square", 0.9, 1.0, 0.01), ("circle", 0.42, 2.0, 0.008)],
)
def test_overlapping_blur_of_neighbors_adds_no_bias(kind, size, blur, most):
    """A gap of 3.4 px at a blur of 1 px, and one of 5.4 px at 2 px."""
    image, truth = board(SQUARE, kind, size, blur=blur, noise=1.0)
    found = DETECT[kind](image)
    # The noise leaves 0.0054 and 0.0048 px; fitted each as if alone, 0.040 and 0.010.
    assert np.sqrt((beside(found, truth) ** 2).mean()) < most
    assert 0.8 < held(found, truth) < 1.3


@pytest.mark.parametrize(
    "change",
    [
        {"ink": 200.0, "paper": 50.0},
        {"ink": 110.0, "paper": 140.0},
        {"k1": -0.15},
        {"k1": 0.08},
        {"behind": skimage.data.camera()},
        {"behind": skimage.data.coins(), "ink": 220.0, "paper": 60.0},
        {"behind": skimage.data.brick()},
    ],
    ids=["bright", "faint", "barrel", "cushion", "camera", "bright, coins", "brick"],
)
@pytest.mark.parametrize(("kind", "size"), [("circle", 0.25), ("square", 0.5)])
def test_all_marks_are_detected_in_clutter_and_in_both_polarities(kind, size, change):
    image, truth = board(SQUARE, kind, size, **change)
    found = DETECT[kind](image)
    assert len(found.points) >= 0.97 * len(truth)
    assert np.abs(beside(found, truth)).max() < 0.2  # a wrong point is off by pixels
    # 35 centers tell the ratio to 8 %; the bias of circles and
    # bent sides is taken off with a distortion of one term, and drawing adds 0.003 px.
    assert 0.7 < held(found, truth) < 1.6


# What it lies on


def test_asymmetric_grid_is_a_square_lattice():
    """Turned by 45°, with √2 half steps from circle to circle."""
    image, truth = board(ASYMMETRIC, size=0.35, pitch=26.0)
    found = detect_circles(image)
    assert len(found.points) == len(truth)
    seen = ASYMMETRIC[cKDTree(truth).query(found.points)[1]]
    np.testing.assert_allclose(
        np.linalg.norm(found.positions - found.positions[0], axis=1) * np.sqrt(2),
        np.linalg.norm(seen - seen[0], axis=1),
    )


@pytest.mark.parametrize(
    ("kind", "places", "message"),
    [
        ("circle", SQUARE * [1.0, 1.3], "square lattice, got steps of 1 : 1.3"),
        ("circle", HEXAGONAL, "square lattice, got steps of 1 : 1.0. at (60|120)°"),
        ("square", SQUARE * [1.0, 1.3], "rectangles"),
    ],
)
def test_other_lattices_are_rejected(kind, places, message):
    with pytest.raises(ValueError, match=message):
        DETECT[kind](board(places, kind, 0.25, pitch=26.0)[0])


RULED = np.where(np.abs(np.arange(320) % 14 - 5) < 3, 60.0, 190.0) * np.ones((240, 1))
DETECTORS = {
    "circles": detect_circles,
    "squares": detect_squares,
    "chessboard": partial(detect_squares, pattern="chessboard"),
    "scale": detect_micrometer,
}


@pytest.mark.parametrize("asked", DETECTORS)
@pytest.mark.parametrize(
    ("shown", "image"),
    [
        ("circles", board(SQUARE)[0]),
        ("squares", board(SQUARE, "square", 0.5, ink=200.0, paper=50.0)[0]),
        ("chessboard", chessboard(blur=0.7)[0]),
        ("scale", cv2.GaussianBlur(RULED, (0, 0), 1.0)),
    ],
)
def test_a_detector_rejects_another_pattern(asked, shown, image):
    if asked == shown:
        assert len(DETECTORS[asked](image).points) >= 20
        return
    with pytest.raises(ValueError, match="image must show"):
        DETECTORS[asked](image)


@pytest.mark.parametrize(("size", "blur", "fewest"), [(0.46, 1.0, 35), (0.48, 1.0, 30)])
def test_circles_that_nearly_touch_are_detected(size, blur, fewest):
    """The places between them look as the fields of a chessboard do, for which they were taken."""
    image, truth = board(SQUARE, size=size, blur=blur)
    found = detect_circles(image)
    assert len(found.points) >= fewest
    assert np.abs(beside(found, truth)).max() < 0.2


def test_gaps_between_blurred_circles_are_no_circles():
    """They are round and bright, as the circles are round and dark."""
    image, truth = board(SQUARE, size=0.4, blur=5.0)
    found = detect_circles(image)
    assert len(found.points) >= 30
    assert np.abs(beside(found, truth)).max() < 0.3  # a gap is 24 px from the next center


def test_four_circles_are_rejected_in_clutter_only():
    """A homography leads to any four: alone in the image they are taken on trust."""
    four = SQUARE[(SQUARE < 2).all(axis=1)]
    assert len(detect_circles(board(four)[0]).points) == 4
    with pytest.raises(ValueError, match="image must show"):
        detect_circles(board(four, behind=skimage.data.camera())[0])


@pytest.mark.parametrize("kind", ["circle", "square"])
@pytest.mark.parametrize("seed", range(2))
def test_randomly_placed_marks_are_rejected(kind, seed):
    places = np.random.default_rng(seed).uniform([0, 0], [8.5, 6.0], (60, 2))
    apart = [
        k for k in range(60) if np.linalg.norm(places[:k] - places[k], axis=1).min(initial=9) > 0.6
    ]
    image, _ = board(places[apart], kind, 0.18 if kind == "circle" else 0.36)
    with pytest.raises(ValueError, match="image"):
        DETECT[kind](image)


# The final test


def test_sigma_is_that_of_the_residuals_if_larger():
    """A board whose circles were printed 0.1 px beside their places."""
    rng = np.random.default_rng(3)
    shifted = SQUARE + rng.normal(0, 0.1 / 34, SQUARE.shape)
    image, _ = board(shifted)
    _, truth = board(SQUARE)
    found = detect_circles(image)
    assert found.misfit > 5
    # 35 marks less 25 numbers of the map leave 45 residuals: σ to 11 %, and 15 % by the eight
    # that the fits' own σ counts for.
    assert held(found, truth) == pytest.approx(1.0, abs=0.3)
    assert detect_circles(board(SQUARE)[0]).misfit < 1.5


def test_marks_far_from_a_lattice_are_rejected():
    rng = np.random.default_rng(4)
    image, _ = board(SQUARE + rng.uniform(-0.08, 0.08, SQUARE.shape))
    with pytest.raises(ValueError, match="regular lattice"):
        detect_circles(image)


def test_displaced_mark_is_an_outlier():
    places = SQUARE.copy()
    places[17] += [0.12, 0.0]  # 4 px
    image, _ = board(places)
    found = detect_circles(image)
    assert len(found.points) == 34
    assert np.abs(beside(found, board(SQUARE)[1])).max() < 0.05


@pytest.mark.parametrize(("kind", "size"), [("circle", 0.25), ("square", 0.5)])
def test_displaced_mark_outside_the_grid_is_an_outlier(kind, size):
    """Alone in its column it bends the map towards itself and leaves hardly a residual."""
    beyond = np.array([[SQUARE[:, 0].max() + 1.1, 0.15]])
    image, every = board(np.vstack([SQUARE, beyond]), kind, size)
    found = DETECT[kind](image)
    truth = every[: -1 if kind == "circle" else -4]
    assert len(found.points) == len(truth)
    assert np.abs(beside(found, truth)).max() < 0.05
    assert found.misfit < 1.5  # with the stray the circles were 0.44 px beside any lattice


# Chessboards


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"blur": 2.5},
        {"noise": 8.0},
        {"turn": 0.7},
        {"k1": -0.05},
        {"ink": 200.0, "paper": 50.0},
        {"behind": skimage.data.camera()},
        # Here OpenCV's finder gave steps of (2, 1) and (0, 1) fields.
        {"columns": 16, "rows": 12, "pitch": 26.0, "turn": 0.0, "shape": (480, 640)},
        {"columns": 40, "rows": 28, "pitch": 20.0, "shape": (700, 900)},
        {"columns": 3, "rows": 3, "pitch": 60.0},
        {"columns": 12, "rows": 4, "pitch": 25.0, "k1": -0.15},
        {"columns": 12, "rows": 9, "pitch": 45.0, "turn": 0.3},
    ],
    ids=[
        "plain", "blurred", "noisy", "turned", "barrel", "negative", "clutter", "untilted",
        "many fields", "four corners", "few rows", "cropped",
    ],
)  # fmt: skip
def test_all_inner_corners_of_a_chessboard_are_detected(change):
    image, corners, truth = chessboard(**change)
    found = detect_squares(image, pattern="chessboard")
    whole = ((truth > 10) & (truth < np.array(image.shape[::-1]) - 10)).all(axis=1)
    assert whole.sum() <= len(found.points) <= len(truth)
    assert np.abs(beside(found, truth)).max() < 0.2
    # 35 corners tell the ratio to 8 %; edges bent by the distortion are taken as straight.
    assert len(truth) < 35 or 0.6 < held(found, truth) < 1.6
    seen = corners[cKDTree(truth).query(found.points)[1]]
    np.testing.assert_array_equal(found.grid - found.grid[0], seen - seen[0])
    np.testing.assert_array_equal(found.positions, found.grid)


@pytest.mark.parametrize(
    ("name", "image"),
    [
        ("chessboard", chessboard()[0]),
        ("squares", board(SQUARE, "square", 0.5)[0]),
        ("circles", board(SQUARE)[0]),
    ],
)
def test_detect_pattern_names_the_pattern(name, image):
    named, found = detect_pattern(image)
    assert named == name
    assert detect_pattern(image, name)[1].points.tolist() == found.points.tolist()
    with pytest.raises(ValueError, match="image must show"):
        detect_pattern(image, "squares" if name != "squares" else "circles")


def test_corners_of_a_sharpened_image_are_detected():
    """Cameras sharpen: an edge then is narrower than a pixel, where the model had no derivative."""
    image, _, truth = chessboard(blur=0.5)
    sharp = image + 0.7 * (image.astype(float) - cv2.GaussianBlur(image, (0, 0), 1.0))
    found = detect_squares(np.clip(sharp, 0, 255), pattern="chessboard")
    assert len(found.points) == len(truth)
    assert np.abs(beside(found, truth)).max() < 0.1


def test_sublattice_is_rejected_by_its_correlation(monkeypatch):
    """Had the growth skipped marks, the image would not correlate with the drawn pattern."""
    grown, turn = patterns.grow_lattices, np.array([[1, 1], [-1, 1]])

    def skipping(marks):
        pieces = [(m, g, g.sum(axis=1) % 2 == 0) for m, g in grown(marks)]
        return [(m[even], g[even] @ turn // 2) for m, g, even in pieces]

    monkeypatch.setattr(patterns, "grow_lattices", skipping)
    monkeypatch.setattr(patterns, "complete", lambda *piece: piece)
    with pytest.raises(ValueError, match="got a correlation of"):
        detect_circles(board(SQUARE)[0])
