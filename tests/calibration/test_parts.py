"""The detectors' parts one by one: shapes, grey-level models, grid map, and what is left out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from microlib.calibration import _circles, _ellipses, _quads, _squares
from microlib.calibration._dark_regions import find_dark_regions
from microlib.calibration._detection import band_half_width, find_inliers
from microlib.calibration._grid_map import GridMap, fit_grid_map
from microlib.calibration._grid_order import _grow_from, order_grid
from microlib.calibration._outline_fit import OutlineFit, Patches

# Dark regions


def squares_image(sides, pitch=40, ground=200.0):
    """Dark squares in a row of a 100 px high image, drawn exactly, and their centers."""
    image = np.full((100, pitch * (len(sides) + 1)), ground)
    for k, side in enumerate(sides):
        left = pitch * (k + 1) - side // 2
        image[50 - side // 2 : 50 - side // 2 + side, left : left + side] = 50.0
    return image


def test_regions_have_the_moments_of_their_pixels():
    """Squares of 20 px: area 400, centroid between pixels, second moment 20²/12."""
    found = find_dark_regions(squares_image([20] * 4))
    # Blurred by 1 px, each corner loses a few pixels.
    np.testing.assert_allclose(found.areas, 400, atol=16)
    np.testing.assert_allclose(found.centers[:, 0], [39.5, 79.5, 119.5, 159.5], atol=0.01)
    np.testing.assert_allclose(found.centers[:, 1], 49.5, atol=0.01)
    np.testing.assert_allclose(found.moments[:, 0, 0], 400 / 12, rtol=0.03)
    np.testing.assert_allclose(found.moments[:, 1, 1], 400 / 12, rtol=0.03)
    np.testing.assert_allclose(found.moments[:, 0, 1], 0, atol=1e-9)
    np.testing.assert_allclose(found.fullness, 3 / np.pi, rtol=0.01)


def test_regions_slant_as_they_do():
    """The moments of an inclined ellipse against its axes: a²/4 along, b²/4 across."""
    image = np.full((120, 260), 200, np.uint8)
    for x in (40, 100, 160, 220):
        cv2.ellipse(image, (x, 60), (24, 12), 30.0, 0, 360, 50, -1)
    found = find_dark_regions(image)
    turn = np.deg2rad(30)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    expected = axes @ np.diag([24**2 / 4, 12**2 / 4]) @ axes.T
    # OpenCV's filled ellipse is half a pixel larger all round: 8 % of the smaller moment.
    np.testing.assert_allclose(found.moments, np.tile(expected, (4, 1, 1)), atol=12)
    np.testing.assert_allclose(found.fullness, 1, atol=0.01)


def test_regions_of_another_size_are_left_out():
    sides = [20, 20, 20, 20, 20, 7, 38, 12, 30]  # areas over the median's: 0.12, 3.6, 0.36, 2.25
    found = find_dark_regions(squares_image(sides))
    kept = [12, 20, 20, 20, 20, 20, 30, 38]
    np.testing.assert_allclose(np.sort(np.sqrt(found.areas)), kept, atol=0.6)
    sides[6] = 39  # blur takes from its corners as from the others'; 3.8 times
    sides[7] = 9  # 0.2 times
    assert len(find_dark_regions(squares_image(sides)).areas) == 7
    sides[6] = 42  # touches none: 61 px apart; 4.4 times
    assert len(find_dark_regions(squares_image(sides, pitch=60)).areas) == 6


def test_uneven_light_is_divided_out():
    """With the light a paraboloid, as the model has it, the ground comes out as one level."""
    image = squares_image([20] * 9)
    y, x = np.mgrid[-1:1:100j, -1 : 1 : image.shape[1] * 1j]
    light = 1 + 0.2 * x - 0.1 * y - 0.15 * x**2 + 0.1 * x * y - 0.1 * y**2
    found = find_dark_regions(image * light)
    flat = find_dark_regions(image)
    # A pixel more or less at a corner moves a centroid by 10 px / 400.
    np.testing.assert_allclose(found.centers, flat.centers, atol=0.06)
    ground = cv2.dilate((image < 200).astype(np.uint8), np.ones((9, 9))) == 0
    # Undivided, the ground varies by 45 %. The paraboloid is fitted to the blurred image, the
    # bright half of the squares' edges included.
    np.testing.assert_allclose(found.smooth[ground], 1, atol=0.04)


def test_specks_are_no_regions():
    """Four 3×3 px specks blur to less than 20 px each."""
    with pytest.raises(ValueError, match="got 0 dark regions"):
        find_dark_regions(squares_image([3] * 4))


# What is left out


def test_the_band_ends_half_way_to_the_neighbor():
    row = np.column_stack([np.arange(5) * 20.0, np.zeros(5)])
    assert band_half_width(row, 6.0) == pytest.approx(4.0)
    assert band_half_width(row, 9.0) == 2.0
    assert band_half_width(row, 1.0) == 7.0


@pytest.mark.parametrize(
    ("field", "kept", "dropped"),
    [("rms", 3.0, 3.01), ("contrast", 0.51, 0.5), ("sigma", 5.0, 5.01), ("rms", 0.1, np.nan)],
)
def test_outliers_are_those_beyond_the_stated_multiples(field, kept, dropped):
    for value, expected in ((kept, True), (dropped, False)):
        fields = {"rms": np.ones(6), "contrast": np.ones(6), "sigma": np.ones(6)}
        fields[field][5] = value
        low = np.full((6, 2), 5.0)
        found = find_inliers((20, 30), low, low + 4, **fields)
        assert found.tolist() == [True] * 5 + [expected]


def test_medians_are_those_of_outlines_that_can_be_judged():
    """A majority that leaves the image, however bad, must not set the scale."""
    low = np.array([[5.0, 5.0]] * 3 + [[-1.0, 5.0]] * 4)
    rms = np.array([1.0, 1.0, 4.0] + [100.0] * 4)
    found = find_inliers((20, 30), low, low + 4, rms, np.ones(7), np.ones(7))
    assert found.tolist() == [True, True] + [False] * 5


@pytest.mark.parametrize(
    ("low", "high", "inside"),
    [
        ((0, 0), (29, 19), True),
        ((-0.01, 0), (29, 19), False),
        ((0, -0.01), (29, 19), False),
        ((0, 0), (29.01, 19), False),
        ((0, 0), (29, 19.01), False),
    ],
)
def test_an_outline_must_lie_in_the_image(low, high, inside):
    one = np.ones(1)
    found = find_inliers((20, 30), np.array([low]), np.array([high]), one, one, one)
    assert found[0] == inside


# The grid map


def view(distortion):
    return GridMap(
        np.array([[0.2, 0.03, -0.8], [-0.02, 0.21, -0.6], [0.01, -0.02, 1.0]]),
        distortion,
        np.array([319.5, 239.5]),
        319.5,
        9,
    )


GRID = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0)), axis=-1).reshape(-1, 2)


def test_the_grid_map_is_found_from_exact_points():
    true = view(-0.05)
    found = fit_grid_map(true(GRID), GRID, (480, 640))
    np.testing.assert_allclose(found.middle, true.middle)
    assert found.unit == true.unit
    assert found.distortion == pytest.approx(-0.05, abs=1e-7)
    np.testing.assert_allclose(found.homography, true.homography, atol=1e-6)
    np.testing.assert_allclose(found(GRID), true(GRID), atol=1e-6)


def test_the_grid_map_scales_as_cells_do():
    """The cell around a point, from its corners by the shoelace formula."""
    true = view(-0.05)
    corners = true(GRID[:, None] + 0.01 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    x, y = np.moveaxis(corners, -1, 0)
    area = np.abs((x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1)) / 2
    np.testing.assert_allclose(true.scale(GRID), area / 0.02**2, rtol=1e-4)


@pytest.mark.parametrize(("count", "distorted"), [(4, False), (5, False), (6, True)])
def test_few_points_tell_no_distortion(count, distorted):
    chosen = np.array([[0, 0], [7, 0], [7, 5], [0, 5], [3, 2], [5, 1.0]])[:count]
    found = fit_grid_map(view(-0.05)(chosen), chosen, (480, 640))
    assert (found.distortion != 0) is distorted


# The lattice


def test_points_beyond_a_hole_keep_their_place():
    """Two blocks of a lattice with three empty columns between them."""
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(5)), axis=-1).reshape(-1, 2)
    grid = grid[(grid[:, 0] < 5) | (grid[:, 0] > 7)]
    points = 20.0 * grid + 0.02 * grid**2 + [30, 40]
    index, found = order_grid(points)
    assert len(index) == len(points)
    np.testing.assert_array_equal(found, grid[index])


def test_each_branch_of_a_lattice_goes_on_with_its_own_steps():
    """Steps that turn by some 60° along the rings of a fan, and grow by a third across them."""
    ring, along = np.meshgrid(np.arange(6), np.arange(16), indexing="ij")
    angle, radius = 1.2 * along.ravel() / 16, 100 * 1.06 ** ring.ravel()
    points = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    seed = 2 * 16 + 8
    steps = points[[seed + 1, seed + 16]] - points[seed]
    found = _grow_from(seed, points, cKDTree(points), steps)
    assert found == {(k % 16 - 8, k // 16 - 2): k for k in range(len(points))}


def test_a_point_off_the_lattice_is_left_out():
    points = 20.0 * np.stack(np.meshgrid(np.arange(6), np.arange(5)), axis=-1).reshape(-1, 2)
    points[13] += [6.0, 0.0]  # 0.3 of a step
    points[22] += [3.0, 3.0]  # 0.2 of a step
    index, _ = order_grid(points)
    assert set(range(30)) - set(index.tolist()) == {13}


# Grey levels


def patch(count=2):
    y, x = np.mgrid[-14:15, -14:15]
    x, y = (np.tile(axis.ravel().astype(float), (count, 1)) for axis in (x, y))
    return Patches(x, y, np.zeros(x.shape), np.ones(x.shape), np.zeros((count, 2)))


ELLIPSES = np.array(
    [
        [0.3, -0.2, 0.12, 0.02, 0.15, 1.3, 0.7, 200.0, 0.5, -0.3],
        [-0.4, 0.1, 0.10, -0.01, 0.11, 0.8, 0.6, 150.0, 0.0, 0.2],
    ]
)
SQUARES = np.array(
    [
        [0.1, 1.67, 3.25, 4.8, 7.3, 6.8, 7.1, 7.4, 1.3, 0.7, 200.0, 0.5, -0.3],
        [0.0, 1.57, 3.14, 4.7, 6.0, 6.1, 6.2, 6.3, 0.8, 0.6, 150.0, 0.0, 0.2],
    ]
)


@pytest.mark.parametrize(
    ("model", "parameters"),
    [(_ellipses._grey_levels, ELLIPSES), (_quads._grey_levels, SQUARES)],
)
def test_derivatives_of_the_grey_levels_agree_with_differences(model, parameters):
    patches = patch()
    analytic = model(parameters, patches)[1]
    exact = [k for k in range(parameters.shape[1]) if model is _quads._grey_levels or k > 4]
    for k in range(parameters.shape[1]):
        move = 1e-6 * np.eye(parameters.shape[1])[k]
        up, down = (model(parameters + s * move, patches)[0] for s in (1, -1))
        numeric = (up - down) / 2e-6
        # The distance to an ellipse is of first order, and so are its derivatives by place and
        # shape: exact on the outline, and off it by the distance over the radius.
        tolerance = 1e-6 if k in exact else 0.15
        np.testing.assert_allclose(
            analytic[..., k], numeric, atol=tolerance * np.abs(numeric).max()
        )


@pytest.mark.parametrize(
    ("model", "parameters", "area"),
    [
        (_ellipses._grey_levels, ELLIPSES[1:], np.pi / (0.10 * 0.11 - 0.01**2)),
        (_quads._grey_levels, [[0, np.pi / 2, np.pi, -np.pi / 2, 6, 7, 6.5, 5, 0.8, 0.6, 150.0,
                                  0, 0.2]], 12.5 * 12),
    ],
)  # fmt: skip
def test_the_dark_area_is_that_of_the_outline(model, parameters, area):
    parameters = np.array(parameters, dtype=float)
    parameters[:, -2:] = 0
    grey = model(parameters, patch(1))[0]
    # A blur of a tenth of the radius: the curved edge moves by half of its square, 0.5 %.
    assert ((150 - grey) / (150 * 0.6)).sum() == pytest.approx(area, rel=0.01)
    assert grey.min() == pytest.approx(150 * 0.4, rel=1e-3)
    assert grey.max() == pytest.approx(150)


@pytest.mark.parametrize(("pitch", "width"), [(60, 7.0), (29, 4.2), (22, 2.0)])
def test_a_patch_is_the_band_around_its_outline(pitch, width):
    """Half of the way to the neighbor, for shapes 20.6 px wide, from 2 to 7 px."""
    image = np.full((200, 200), 100, np.float32)
    centers = 70.0 + pitch * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    radius = np.zeros((4, 10))
    radius[:, [2, 4]] = 1 / 10.3  # the shape matrix of a circle
    square = np.zeros((4, 13))
    square[:, :4], square[:, 4:8] = np.arange(4) * np.pi / 2, 10.3
    for start, patches, distance in (
        (radius, _ellipses._patches(image, centers, radius), lambda x, y: 10.3 - np.hypot(x, y)),
        (
            square,
            _quads._patches(image, centers, square),
            lambda x, y: 10.3 - np.maximum(abs(x), abs(y)),
        ),
    ):
        y, x = np.mgrid[-20:21, -20:21]
        expected = (np.abs(distance(x, y)) <= width).sum()
        assert patches.weight.sum(axis=1).tolist() == [expected] * 4
        assert np.abs(distance(patches.x, patches.y)[patches.weight == 1]).max() <= width
        assert (start[:, -3] == 100).all()  # where the ground begins


# Shapes


def test_the_start_of_an_ellipse_follows_from_its_moments():
    axes = np.array([[0.8, -0.6], [0.6, 0.8]])
    half = np.array([9.0, 5.0])
    moments = axes @ np.diag(half**2 / 4) @ axes.T
    start = _ellipses._start(np.array([[20.3, 31.8]]), moments[None], 1.2)
    np.testing.assert_allclose(start[0, :2], [0.3, -0.2], atol=1e-12)
    turn = np.linspace(0, 6, 9)
    rim = (axes * half) @ [np.cos(turn), np.sin(turn)]
    np.testing.assert_allclose(
        np.linalg.norm(_ellipses.ellipse_shape(start)[0] @ rim, axis=0), 1, atol=1e-12
    )
    reach = _ellipses.ellipse_reach(start)[0]
    np.testing.assert_allclose(reach, np.hypot(*(axes * half).T), rtol=1e-12)


def test_the_centroid_is_that_of_the_area():
    """An L of three unit squares: the mean of their centers, whatever the corners are."""
    corners = np.add([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]], [50, -20])
    expected = np.add(np.mean([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]], axis=0), [50, -20])
    np.testing.assert_allclose(_circles._centroid(corners[None])[0], expected, rtol=1e-14)


def test_lines_cross_where_they_do_and_carry_their_errors_there():
    """Corners and their σ against Monte Carlo over correlated errors of the eight parameters."""
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(13, 13)) * 1e-3
    covariance = mixing @ mixing.T
    fit = OutlineFit(SQUARES[:1], covariance[None], np.ones(1))
    corners, sigma = _quads.quad_corners(fit, np.array([[100.0, 50.0]]))
    angle, offset = SQUARES[0, :4], SQUARES[0, 4:8]
    for k in range(4):
        for line in (k, (k + 1) % 4):
            normal = np.array([np.cos(angle[line]), np.sin(angle[line])])
            assert normal @ (corners[0, k] - [100, 50]) == pytest.approx(offset[line], abs=1e-12)
    drawn = SQUARES[:1] + rng.normal(size=(4000, 13)) @ mixing.T
    many = OutlineFit(drawn, np.tile(covariance, (4000, 1, 1)), np.ones(4000))
    spread = _quads.quad_corners(many, np.zeros((4000, 2)))[0].std(axis=0)
    # A standard deviation from 4000 is known to 1.1 %; four of them.
    np.testing.assert_allclose(sigma[0], np.sqrt((spread**2).mean(axis=1)), rtol=0.045)


def test_parallel_lines_have_no_corner():
    fit = OutlineFit(SQUARES[:1].copy(), np.tile(np.eye(13), (1, 1, 1)), np.ones(1))
    fit.parameters[0, 1] = fit.parameters[0, 0]
    corners, _ = _quads.quad_corners(fit, np.zeros((1, 2)))
    assert np.isnan(corners[0]).all(axis=1).tolist() == [True, False, False, False]


def test_sides_are_ordered_alike_whatever_side_came_first():
    turned = SQUARES[:1].copy()
    order = [2, 3, 0, 1]
    turned[0, :4] = SQUARES[0, order] + [0, 0, 2 * np.pi, 2 * np.pi]
    turned[0, 4:8] = SQUARES[0, 4:8][order]
    both = np.concatenate([SQUARES[:1], turned])
    places = np.concatenate([order, np.array(order) + 4, np.arange(8, 13)])
    covariance = np.diag(np.arange(1.0, 14.0))
    covariance[0, 5] = covariance[5, 0] = 0.5
    fit = OutlineFit(both, np.stack([covariance, covariance[np.ix_(places, places)]]), np.ones(2))
    found = _quads.untangle(fit)
    np.testing.assert_allclose(found.parameters[1], found.parameters[0], atol=1e-12)
    np.testing.assert_allclose(found.covariance[1], found.covariance[0], atol=1e-12)
    np.testing.assert_allclose(
        _quads.quad_corners(found, np.zeros((2, 2)))[0][0],
        _quads.quad_corners(
            OutlineFit(SQUARES[:1], covariance[None], np.ones(1)), np.zeros((1, 2))
        )[0][0],
        atol=1e-12,
    )


@pytest.mark.parametrize("field", ["rms", "contrast", "sigma"])
def test_every_measure_is_one_for_each_outline(field):
    fields = {"rms": np.ones(6), "contrast": np.ones(6), "sigma": np.ones(6)}
    low = np.full((6, 2), 5.0)
    for wrong in (np.ones(5), np.ones((6, 1)), 1.0):
        with pytest.raises(ValueError, match=f"{field} must hold one value for each of the 6"):
            find_inliers((20, 30), low, low + 4, **fields | {field: wrong})


def test_without_an_outline_that_can_be_judged_none_is_taken():
    low = np.full((3, 2), -5.0)
    assert find_inliers((20, 30), low, low + 4, *np.ones((3, 3))).tolist() == [False] * 3


def test_squares_in_one_row_have_no_grid_of_corners():
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    grid = np.array([[k, m] for m in range(2) for k in range(3)])
    corners = 10.0 * (2 * grid[:, None] + unit)
    np.testing.assert_array_equal(
        _squares._corner_grid(corners, grid), 2 * grid[:, None] + unit.astype(int)
    )
    row = grid[:3]
    with pytest.raises(ValueError, match="image must show a grid of squares, got them in one row"):
        _squares._corner_grid(corners[:3], row)
