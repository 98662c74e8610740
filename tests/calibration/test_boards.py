"""Detectors on photographed boards that the library's renderer did not draw."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
import skimage.data
from scipy.spatial import cKDTree

from microlib.calibration import detect_circles, detect_micrometer, detect_pattern, detect_squares
from microlib.calibration.detection import _lattice as lattice
from microlib.calibration.detection import _pattern as patterns
from microlib.calibration.detection._boards import Chessboard
from microlib.calibration.detection._circles import Circles
from microlib.calibration.detection._image import GreyImage
from microlib.calibration.detection._settings import DetectionSettings
from microlib.calibration.detection._squares import Squares
from tests.scenes.calibration import PHOTOGRAPHS, SQUARE, board, camera, chessboard, outline

DETECT = {"circle": detect_circles, "square": detect_squares}
DETECTORS = {
    "circles": detect_circles,
    "squares": detect_squares,
    "chessboard": partial(detect_squares, pattern="chessboard"),
    "scale": detect_micrometer,
}
#: Places of a hexagonal and of an asymmetric grid, in pitches; displaced and random ones.
HEX = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
HEXAGONAL = np.array([[i, j] for j in range(5) for i in range(-(j // 2), 7 - j // 2)]) @ HEX
ASYMMETRIC = np.array([[2 * i + j % 2, j] for j in range(7) for i in range(4)], dtype=float)
SCATTERED = SQUARE + np.random.default_rng(4).uniform(-0.08, 0.08, SQUARE.shape)
RANDOM = SQUARE * 1.2 + np.random.default_rng(0).uniform(-0.35, 0.35, SQUARE.shape)


NO_PATTERN = {
    "saturated": np.full((100, 120), 255.0), "black": np.zeros((100, 120)),
    "color": np.zeros((50, 50, 3)), "noise": np.random.default_rng(8).normal(128, 10, (200, 200)),
    "ramp": np.add.outer(np.arange(100.0), np.arange(120.0)),
    "columns": np.tile([0, 255], (40, 40)), "one line": np.eye(60) * 255,
}  # fmt: skip


def errors(found, truth: np.ndarray) -> np.ndarray:
    """Distances per coordinate to the nearest true points."""
    return found.points - truth[cKDTree(truth).query(found.points)[1]]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def over_sigma(found, truth: np.ndarray) -> float:
    """RMS error over the stated standard deviation."""
    return rms(errors(found, truth)) / rms(found.uncertainty)


# Accuracy


@pytest.mark.parametrize(
    ("kind", "size", "blur", "noise", "most"),
    [
        # The noise leaves 0.005 px. If the side were assumed equal to the gap, the corners would be
        # 0.4 px off.
        ("square", 0.3, 1.0, 1, 0.015),
        ("square", 0.6, 0.7, 1, 0.015),
        ("square", 0.9, 0.7, 1, 0.015),
        # Gaps of 3.4 and 5.4 px. A fit that ignores the neighbors has errors of 0.040 px (squares)
        # and 0.010 px (circles).
        ("square", 0.9, 1.0, 1, 0.010),
        ("circle", 0.42, 2.0, 1, 0.008),
        # Limits of benchmarks/calibration.py, set by the errors of OpenCV's detectors.
        ("circle", 0.25, 0.7, 2, 0.010),
        ("circle", 0.25, 1.5, 8, 0.034),
        ("circle", 0.25, 3.0, 2, 0.016),
        ("square", 0.5, 0.7, 2, 0.025),
        ("square", 0.5, 1.5, 8, 0.052),
        ("square", 0.5, 3.0, 2, 0.033),
    ],
)
def test_points_are_accurate_over_sizes_blurs_and_noise(kind, size, blur, noise, most):
    image, truth = board(SQUARE, kind, size, blur=blur, noise=noise)
    found = DETECT[kind](image)
    assert len(found.points) == len(truth)
    assert rms(errors(found, truth)) < most
    # Marks are numbered row by row, and each point has its own position.
    corners = outline(kind, size)[::16] + size / 2 if kind == "square" else np.zeros((1, 2))
    places, nearest = SQUARE[:, None] + corners, cKDTree(truth).query(found.points)[1]
    np.testing.assert_array_equal(found.group, nearest // len(corners))
    np.testing.assert_allclose(found.positions, places.reshape(-1, 2)[nearest], atol=0.01)
    # 35 independent centers give the ratio to ±8 %, corners of shared lines less. Edges are drawn
    # to an eighth of a pixel, which adds to the noise where they are sharp.
    assert blur < 1 or 0.8 < over_sigma(found, truth) < 1.3
    if kind == "square":
        assert found.side == pytest.approx(size, abs=0.01)
        places = found.grid // 2 + found.side * (found.grid % 2)
        np.testing.assert_allclose(found.positions, places, atol=1e-12)


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
def test_most_marks_are_detected_in_clutter_and_in_both_polarities(kind, size, change):
    image, truth = board(SQUARE, kind, size, **change)
    found = DETECT[kind](image)
    assert len(found.points) >= 0.97 * len(truth)
    assert np.abs(errors(found, truth)).max() < 0.2  # a wrong point is off by pixels
    # 35 centers determine the ratio to 8 %. The correction of the bias has one distortion term, and
    # drawing adds 0.003 px.
    assert 0.7 < over_sigma(found, truth) < 1.6


@pytest.mark.parametrize(("kind", "size", "corners"), [("circle", 0.3, 1), ("square", 0.6, 4)])
def test_whole_marks_are_detected_and_those_that_the_border_cuts_are_not(kind, size, corners):
    image, truth = board(np.argwhere(np.ones((14, 10))).astype(float), kind, size)
    found = DETECT[kind](image)
    assert np.abs(errors(found, truth)).max() < 0.2
    assert (np.unique(found.group, return_counts=True)[1] == corners).all()
    for margin, one, other in ((1.5, "found", "true"), (-1.5, "true", "found")):
        # Perspective changes the radius of 10 px by up to 1 px.
        reach = margin + (34 * size if kind == "circle" else 0)
        within = (truth > reach) & (truth < np.array(image.shape[::-1]) - 1 - reach)
        whole = np.repeat(within.reshape(-1, 2 * corners).all(axis=1), corners)
        points = {"found": found.points, "true": truth[whole]}
        assert cKDTree(points[one]).query(points[other])[0].max() < 0.2


def test_dirt_is_not_detected_as_a_circle():
    image, truth = board(SQUARE)
    image = image.copy()
    cv2.circle(image, np.int_(truth[[9, 17]].mean(axis=0)), 6, 60.0, -1)  # between four circles
    cv2.rectangle(image, np.int_(truth[10] + 2), np.int_(truth[10] + 11), 50.0, -1)  # on a circle
    found = detect_circles(image)
    assert np.abs(errors(found, truth)).max() < 0.1
    assert len(found.points) >= len(truth) - 3
    assert np.hypot(*(found.points - truth[10]).T).min() > 10


@pytest.mark.parametrize(
    ("size", "blur", "fewest", "most"),
    [
        (0.46, 1.0, 35, 0.2),
        (0.48, 1.0, 30, 0.2),
        (0.4, 5.0, 30, 0.3),  # bright gaps are as round as the circles, 24 px from a center
    ],
)
def test_circles_that_nearly_touch_are_detected(size, blur, fewest, most):
    """The gaps look like fields of a chessboard; the detector once took them for one."""
    image, truth = board(SQUARE, size=size, blur=blur)
    found = detect_circles(image)
    assert len(found.points) >= fewest
    assert np.abs(errors(found, truth)).max() < most


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
        # A camera that sharpens makes edges narrower than a pixel.
        {"blur": 0.5, "sharpening": 0.7},
        # Here OpenCV's finder gave steps of (2, 1) and (0, 1) fields.
        {"columns": 16, "rows": 12, "pitch": 26.0, "turn": 0.0, "shape": (480, 640)},
        {"columns": 29, "rows": 20, "pitch": 20.0, "shape": (500, 660)},
        {"columns": 3, "rows": 3, "pitch": 60.0},
        {"columns": 12, "rows": 4, "pitch": 25.0, "k1": -0.15},
        {"columns": 12, "rows": 9, "pitch": 45.0, "turn": 0.3},
    ],
    ids=[
        "plain", "blurred", "noisy", "turned", "barrel", "negative", "clutter", "sharpened",
        "untilted", "many fields", "four corners", "few rows", "cropped",
    ],
)  # fmt: skip
def test_all_inner_corners_of_a_chessboard_are_detected(change):
    image, corners, truth = chessboard(**change)
    found = detect_squares(image, pattern="chessboard")
    whole = ((truth > 10) & (truth < np.array(image.shape[::-1]) - 10)).all(axis=1)
    assert whole.sum() <= len(found.points) <= len(truth)
    assert np.abs(errors(found, truth)).max() < 0.2
    # 35 corners determine the ratio to 8 %. The model has straight edges, which distortion bends,
    # and white noise, which sharpening correlates.
    assert len(truth) < 35 or "sharpening" in change or 0.6 < over_sigma(found, truth) < 1.6
    seen = corners[cKDTree(truth).query(found.points)[1]]
    np.testing.assert_array_equal(found.grid - found.grid[0], seen - seen[0])
    np.testing.assert_array_equal(found.positions, found.grid)


def test_all_corners_of_an_unblurred_chessboard_are_detected():
    """The fit of a corner converges slowly where its blur is zero, and ended before."""
    fields = np.indices((9, 10)).sum(axis=0) % 2
    for side in (8, 12, 20, 32):
        drawing = np.pad(np.kron(255.0 * fields, np.ones((side, side))), side, constant_values=128)
        assert len(detect_squares(drawing, pattern="chessboard").points) == 72


def test_asymmetric_grid_is_a_square_lattice():
    """The lattice is turned by 45°, and its pitch is √2 units of `ASYMMETRIC`."""
    image, truth = board(ASYMMETRIC, size=0.35, pitch=26.0)
    found = detect_circles(image)
    assert len(found.points) == len(truth)
    seen = ASYMMETRIC[cKDTree(truth).query(found.points)[1]]
    np.testing.assert_allclose(
        np.linalg.norm(found.positions - found.positions[0], axis=1) * np.sqrt(2),
        np.linalg.norm(seen - seen[0], axis=1),
    )


@pytest.mark.parametrize("turn", [0.3, np.pi / 4, 0.86])
def test_all_circles_of_a_turned_grid_are_detected_from_three_first_circles(turn, monkeypatch):
    """A circle at the edge of the image lacks a neighbor. A lattice that was grown from such a
    circle had a diagonal as a step, and was rejected or lost a tenth of its circles."""
    every = np.argwhere(np.ones((19, 19))).astype(float)
    places = every[np.hypot(*(every - 9).T) < 9.3]
    image, truth = board(places, size=0.33, pitch=25.0, turn=turn, blur=1.5, noise=4.0)
    inside = ((truth > 10) & (truth < np.array(image.shape[::-1]) - 11)).all(axis=1)
    search = lattice.dark_regions
    for corner in ([0, 0], [320, 0], [160, 240]):

        def nearest_first(*given, corner=corner):
            marks = search(*given)
            return marks[np.argsort(np.hypot(*(marks.centers - corner).T))]

        monkeypatch.setattr(lattice, "dark_regions", nearest_first)
        found = detect_circles(image)
        assert np.abs(errors(found, truth)).max() < 0.2
        assert cKDTree(found.points).query(truth[inside])[0].max() < 0.2
        # Steps of the result are steps of the pattern.
        seen = places[cKDTree(truth).query(found.points)[1]]
        steps = np.linalg.lstsq(found.positions - found.positions[0], seen - seen[0])[0]
        np.testing.assert_allclose(steps @ steps.T, np.eye(2), atol=1e-9)


@pytest.mark.parametrize("factor", [2, 3])
@pytest.mark.parametrize("shown", ["circles", "squares", "chessboard"])
def test_points_do_not_depend_on_the_size_at_which_marks_are_searched(shown, factor):
    """The squares are bright: they are searched in the negative of the image."""
    kinds = {"circles": Circles, "squares": Squares, "chessboard": Chessboard}
    image = GreyImage.from_levels(PHOTOGRAPHS[shown].astype(np.float32))
    settings = DetectionSettings()
    reduced = replace(settings, max_pixels=image.grey.size / (factor - 0.5) ** 2)
    (_, found), (_, other) = (
        patterns.find_pattern(image, [kinds[shown](s)]) for s in (settings, reduced)
    )
    np.testing.assert_array_equal(other.grid, found.grid)
    # A mark whose center is rounded the other way has other pixels around it.
    np.testing.assert_allclose(other.points, found.points, atol=0.02)


@pytest.mark.parametrize(
    ("polarity", "pitch", "radius", "reduction"),
    [("dark", 40, 10, 2), ("bright", 40, 10, 2), ("dark", 12, 4, 3)],
)
def test_dense_turned_circles_of_large_image_are_all_found(polarity, pitch, radius, reduction):
    """At half size, many circles of 20 px are lost, and at a third, all circles of 8 px; the image
    is searched at full size."""
    turn, count = np.array([[0.866, 0.5], [-0.5, 0.866]]), 600 // pitch
    places = np.stack(np.meshgrid(*2 * [np.arange(-count, count + 1)]), axis=-1).reshape(-1, 2)
    centers = pitch * places @ turn + (300, 240)
    centers = centers[((centers > 25) & (centers < (575, 455))).all(axis=1)]
    grey = np.zeros((480, 600), np.uint8)
    for x, y in np.round(16 * centers).astype(int).tolist():  # 1/16 px
        cv2.circle(grey, (x, y), 16 * radius, 1, cv2.FILLED, cv2.LINE_8, shift=4)
    levels = (200, -160) if polarity == "dark" else (40, 160)
    blurred = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), radius / 7)
    image = levels[0] + levels[1] * blurred
    image += np.random.default_rng(0).normal(0, 2, image.shape)
    many = {"max_pixels": image.size / (reduction - 0.5) ** 2, "many_marks": 16}
    settings = replace(DetectionSettings(), **many)
    shown = GreyImage.from_levels(image.astype(np.float32))
    _, found = patterns.find_pattern(shown, [Circles(settings)])
    assert len(found.points) == len(centers)


# The kind of pattern


@pytest.mark.parametrize("asked", DETECTORS)
@pytest.mark.parametrize("shown", PHOTOGRAPHS)
def test_detector_rejects_another_pattern(shown, asked):
    image = PHOTOGRAPHS[shown]
    if asked == shown:
        assert len(DETECTORS[asked](image).points) >= 15
        return
    with pytest.raises(ValueError, match="image must show"):
        DETECTORS[asked](image)


@pytest.mark.parametrize("detect", [*DETECTORS.values(), detect_pattern], ids=[*DETECTORS, "any"])
@pytest.mark.parametrize("shown", NO_PATTERN)
def test_images_without_a_pattern_are_rejected(shown, detect):
    with pytest.raises(ValueError, match="image"):
        detect(NO_PATTERN[shown])


def test_message_of_detect_pattern_has_the_reason_for_each_kind():
    with pytest.raises(
        ValueError, match=r"a chessboard, .*; .* a ChArUco board, .*; .* whole squares"
    ):
        detect_pattern(NO_PATTERN["noise"])


@pytest.mark.parametrize("shown", ["circles", "squares", "chessboard"])
def test_detect_pattern_names_the_pattern(shown):
    name, found = detect_pattern(PHOTOGRAPHS[shown])
    assert name == shown
    assert detect_pattern(PHOTOGRAPHS[shown], shown)[1].points.tolist() == found.points.tolist()


@pytest.mark.parametrize(
    ("kind", "places", "message"),
    [
        ("circle", SQUARE * [1.0, 1.3], "square lattice, got steps of 1 : 1.3"),
        ("circle", HEXAGONAL, "square lattice, got steps of 1 : 1.0. at (60|120)°"),
        ("circle", SCATTERED, "regular lattice"),
        ("circle", RANDOM, "image"),
        ("square", SQUARE * [1.0, 1.3], "rectangles"),
        ("square", RANDOM, "image"),
    ],
)
def test_marks_that_form_no_square_lattice_are_rejected(kind, places, message):
    with pytest.raises(ValueError, match=message):
        DETECT[kind](board(places, kind, 0.25, pitch=26.0)[0])


def test_uneven_holes_of_a_grating_are_rejected_though_noise_could_explain_them():
    """A board has smaller errors than 1.5 % of its pitch, however uncertain its marks are."""
    holes = np.argwhere(np.ones((13, 9))) + np.random.default_rng(4).normal(0, 0.035, (117, 2))
    image, _ = board(holes, "square", 0.67, pitch=10.5, ink=35.0, paper=75.0, blur=0.9)
    with pytest.raises(ValueError, match="regular lattice"):
        detect_squares(image)


FOUR = SQUARE[(SQUARE < 2).all(axis=1)]
STRAY = [[3.6, 0.2], [5.3, 1.5], [4.2, 3.3]]


@pytest.mark.parametrize(
    "image",
    [
        board(np.vstack([FOUR, STRAY]))[0],
        board(FOUR, behind=skimage.data.clock(), ink=220.0, paper=60.0)[0],
    ],
    ids=["three more circles", "clock"],
)
def test_four_circles_are_detected_only_if_the_image_shows_nothing_else(image):
    """Any four points fit a 2 × 2 grid."""
    assert len(detect_circles(board(FOUR)[0]).points) == 4
    with pytest.raises(ValueError, match="more circles or nothing else, got 4"):
        detect_circles(image)


def test_sublattice_is_rejected_by_its_correlation(monkeypatch):
    """A lattice of every second mark (simulated here) is refused, since the image differs from the
    drawn pattern."""
    grow, turn = lattice.grow_lattices, np.array([[1, 1], [-1, 1]])

    def skipping(*given):
        for piece in grow(*given):
            even = piece.grid.sum(axis=1) % 2 == 0
            yield piece._replace(marks=piece.marks[even], grid=piece.grid[even] @ turn // 2)

    monkeypatch.setattr(lattice, "grow_lattices", lambda *given: list(skipping(*given)))
    with pytest.raises(ValueError, match="got a correlation of"):
        detect_circles(PHOTOGRAPHS["circles"])


# Displaced marks


def test_corners_that_coincide_are_no_board():
    """A cell between them has no area; a photograph of a board led to a division by it."""
    grey = np.random.default_rng(0).normal(100, 20, (80, 100)).astype(np.float32)
    centers, grid = np.repeat([[10.0, 10], [20, 20]], 2, axis=0), np.indices((2, 2)).reshape(2, 4).T
    board = Chessboard(DetectionSettings())
    with pytest.raises(ValueError, match="no corner of a board is left"):
        board._correlated(GreyImage.from_levels(grey), centers, grid)


def test_uncertainty_of_marks_is_that_of_their_residuals_if_larger():
    """The circles of a board are displaced by 0.1 px along each axis."""
    shifted = SQUARE + np.random.default_rng(3).normal(0, 0.1 / 34, SQUARE.shape)
    found = detect_circles(board(shifted)[0])
    assert found.normalized_rms > 5
    # `board` puts the middle of the extreme marks at the middle of the image.
    truth = camera(SQUARE - (shifted.max(axis=0) + shifted.min(axis=0)) / 2)
    # 70 coordinates − 25 parameters = 45 degrees of freedom: σ to 11 %. The prior weight of 8
    # residuals lowers it by 8 %.
    assert over_sigma(found, truth) == pytest.approx(1.0, abs=0.2)
    assert detect_circles(board(SQUARE)[0]).normalized_rms < 1.5


def test_corners_in_the_noisier_half_of_an_image_are_stated_as_less_certain():
    image, _ = board(SQUARE, "square", 0.5, noise=1.0)
    rough = np.random.default_rng(2).normal(0, 2, image.shape) * (np.arange(320) > 160)
    found = detect_squares(image + rough)
    left, right = found.points[:, 0] < 150, found.points[:, 0] > 170
    assert found.uncertainty[left].max() < found.uncertainty[right].min()


@pytest.mark.parametrize("kind", DETECT)
@pytest.mark.parametrize(
    "stray",
    [[3.12, 2.0], [SQUARE[:, 0].max() + 1.1, 0.15]],
    ids=["4 px from its place", "alone in a new column"],
)
def test_displaced_mark_is_an_outlier(kind, stray):
    """A mark alone in its column pulls the fit, so its residual is small."""
    places = np.vstack([SQUARE[np.abs(SQUARE - stray).max(axis=1) > 0.5], stray])
    image, every = board(places, kind, 0.25 if kind == "circle" else 0.5)
    found = DETECT[kind](image)
    truth = every[: -1 if kind == "circle" else -4]
    assert len(found.points) == len(truth)
    assert np.abs(errors(found, truth)).max() < 0.05
    assert found.normalized_rms < 1.5


def test_outliers_that_the_last_round_finds_are_left_out():
    """Eight marks are displaced by 3.4 to 0.09 px and mask each other, so that three rounds do not
    find them all."""
    rng, places = np.random.default_rng(2027), SQUARE.copy()
    which, turn = rng.permutation(35)[:8], rng.uniform(0, 2 * np.pi, 8)
    size = np.geomspace(10**-1.0, 10**-2.6, 8)
    places[which] += size[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    found = detect_circles(board(places)[0])
    # The largest error is 0.4 px, and 0.9 px without the outliers that the last round finds.
    assert np.abs(errors(found, board(SQUARE)[1])).max() < 0.6
