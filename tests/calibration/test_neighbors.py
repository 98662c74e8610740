"""What neighbors take of the light, and the parts of a micrometer and of an origin mark."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.calibration import _micrometer
from microlib.calibration._micrometer import (
    Micrometer,
    _alike,
    _bar,
    _profile,
    _profile_lines,
    _regress,
    _regular,
    _spacing,
    _turned,
    _Unlike,
)
from microlib.calibration._neighbors import _neighbors, _taken, fit_among_neighbors
from microlib.calibration._origin import find_origin
from microlib.calibration._outline_fit import OutlineFit, Patches, cut_patches

# --- neighbors ---


def test_neighbors_are_the_square_around_a_mark():
    places = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    neighbors, closest = _neighbors(7.0 * places)
    assert neighbors.shape == (20, 8)
    for own, row in enumerate(neighbors):
        around = np.abs(places - places[own]).max(axis=1) == 1
        assert set(row.tolist()) - {own} == set(np.flatnonzero(around).tolist())
    assert len(closest) == 8
    # A lattice 1.69 times as far along one axis has neighbors along it, at 1.71 times none.
    for stretch, count in ((1.69, 2), (1.71, 0)):
        row = _neighbors(places * [1.0, stretch])[0][7]
        along = (places[row] - places[7] == [0, 1]).all(1) | (
            places[row] - places[7] == [0, -1]
        ).all(1)
        assert along.sum() == count


def test_the_closest_marks_are_asked_first():
    x = np.cumsum(np.linspace(10.0, 5.0, 30))
    closest = _neighbors(np.column_stack([x, 0 * x]))[1]
    assert set(closest.tolist()) == set(range(22, 30))
    alone, asked = _neighbors(np.array([[3.0, 4.0]]))
    assert alone.shape == (1, 0)
    assert asked.tolist() == [0]


def bump(parameters: np.ndarray, patches: Patches) -> tuple[np.ndarray, np.ndarray]:
    """A mark that takes `d` exp(−r²/8) of a ground: parameters x, y, d, ground and its slopes."""
    x0, y0, depth = (parameters[:, k, None] for k in range(3))
    dx, dy = patches.x - x0, patches.y - y0
    bell = np.exp(-(dx**2 + dy**2) / 8)
    basis = np.stack([np.ones_like(dx), patches.x, patches.y], axis=-1)
    grey = np.einsum("nkj,nj->nk", basis, parameters[:, 3:6]) - depth * bell
    slopes = [-depth * bell * dx / 4, -depth * bell * dy / 4, -bell]
    return grey, np.concatenate([np.stack(slopes, axis=-1), basis], axis=-1)


#: Three marks in a row, 6.5 px apart and the first cut off, and one that no neighbor reaches.
MARKS = np.array([[2.3, 20.0, 80.0], [8.8, 20.4, 60.0], [15.2, 19.8, 90.0], [60.0, 45.0, 70.0]])


@pytest.fixture(scope="module")
def row() -> tuple[Patches, np.ndarray]:
    y, x = np.mgrid[:70, :90].astype(float)
    image = np.full((70, 90), 200.0)
    for x0, y0, depth in MARKS:
        image -= depth * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 8)
    patches = cut_patches(
        image.astype(np.float32), MARKS[:, :2], 5, lambda dx, dy: np.hypot(dx, dy) <= 4.0
    )
    own = np.column_stack([MARKS[:, :2] - patches.centers, MARKS[:, 2], np.full(4, 200.0)])
    return patches, np.column_stack([own, np.zeros((4, 2))])


def test_neighbors_take_what_their_models_say(row):
    patches, truth = row
    fit = OutlineFit(truth, np.zeros((4, 6, 6)), np.array([1.0, 1.0, np.nan, 1.0]))
    neighbors = np.array([[1, 0], [0, 2], [1, 2], [3, 3]])
    taken = _taken(bump, fit, patches, slice(3, 6), neighbors, np.array([0, 1, 3]))
    for own, other in ((0, 1), (1, 0)):
        x, y = patches.x[own] + patches.centers[own, 0], patches.y[own] + patches.centers[own, 1]
        x0, y0, depth = MARKS[other]
        light = depth * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 8)
        # The third failed and takes nothing that is known; nothing is taken from padding.
        np.testing.assert_allclose(taken[own], light * patches.weight[own], atol=1e-9)
    assert (patches.weight[0] == 0).any()
    assert not taken[2].any()  # it has no neighbor but itself


def test_close_marks_are_fitted_to_what_the_others_leave(row):
    patches, truth = row
    noisy = Patches(
        patches.x, patches.y,
        patches.grey + np.random.default_rng(0).normal(0, 0.2, patches.grey.shape),
        patches.weight, patches.centers,
    )  # fmt: skip
    start = truth + np.array([0.3, -0.3, 5.0, -2.0, 0.0, 0.0])
    found = fit_among_neighbors(bump, start, noisy, slice(3, 6))
    assert np.abs(found.parameters[:, :2] - truth[:, :2]).max() < 0.05
    # Alone the outer ones are drawn by a tenth of a pixel and more.
    alone = _micrometer.fit_outlines(lambda p: bump(p, noisy), start, noisy)
    assert np.abs(alone.parameters[:3, 0] - truth[:3, 0]).max() > 0.1
    np.testing.assert_allclose(alone.parameters[3], found.parameters[3], atol=1e-3)


# --- origin ---


def test_the_odd_mark_is_two_fifths_larger_or_smaller():
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    sizes = np.full(20, 0.2)
    for factor, odd in ((1.39, False), (1.41, True), (1 / 1.39, False), (1 / 1.41, True)):
        changed = sizes.copy()
        changed[13] *= factor
        if odd:
            assert find_origin(grid, changed).tolist() == grid[13].tolist() == [3, 2]
        else:
            with pytest.raises(ValueError, match="got 0 and 0"):
                find_origin(grid, changed)
    changed = sizes.copy()
    changed[[3, 13]] *= 2
    with pytest.raises(ValueError, match="got 2 and 0"):
        find_origin(grid, changed)


def test_a_place_is_missing_inside_the_grid_alone():
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    for gone, found in (([2, 1], True), ([3, 2], True), ([0, 1], False), ([2, 3], False)):
        kept = grid[(grid != gone).any(axis=1)]
        if found:
            assert find_origin(kept, np.ones(19)).tolist() == gone
        else:
            with pytest.raises(ValueError, match="got 0 and 0"):
                find_origin(kept, np.ones(19))
    kept = grid[(grid != [2, 1]).any(axis=1)]
    sizes = np.where((kept == [1, 1]).all(axis=1), 2.0, 1.0)
    with pytest.raises(ValueError, match="got 1 and 1"):
        find_origin(kept, sizes)


# --- micrometer ---


def test_gaps_within_a_quarter_of_the_median_are_one_division():
    gaps = np.array([10.0, 12.4, 12.6, 7.6, 7.4, 10.0, 10.0, 20.0])
    assert _alike(gaps).tolist() == [True, True, False, True, False, True, True, False]
    places = np.cumsum(np.concatenate([[3.0], gaps]))
    assert _spacing(places) == pytest.approx(gaps[_alike(gaps)].mean())
    assert _regular(np.array([0.0, 10, 20, 30, 40]))
    assert not _regular(np.array([0.0, 10, 20, 30]))
    assert _regular(np.cumsum([0.0, 10, 10, 10, 10, 20]))  # four of five
    assert not _regular(np.cumsum([0.0, 10, 10, 10, 20, 20, 10, 10, 20]))  # five of eight


def test_a_profile_is_the_mean_where_half_is_known():
    band = np.array([[1.0, np.nan, 3.0, np.nan], [2.0, 4.0, np.nan, np.nan],
                     [6.0, 6.0, np.nan, np.nan]], np.float32)  # fmt: skip
    np.testing.assert_allclose(_profile(band), [3.0, 5.0, np.nan, np.nan])


@pytest.mark.parametrize("angle", [0.4, -1.2])
def test_a_turned_image_has_all_of_it_and_says_where(angle):
    image = np.zeros((60, 90), np.float32)
    y, x = np.mgrid[:60, :90]
    image += np.exp(-((x - 70.0) ** 2 + (y - 12.0) ** 2) / 18)
    upright, matrix = _turned(image, angle)
    known = np.nan_to_num(upright)
    rows, columns = np.indices(upright.shape)
    found = np.array([(columns * known).sum(), (rows * known).sum()]) / known.sum()
    np.testing.assert_allclose(found, matrix @ [70.0, 12.0, 1.0], atol=0.05)
    turn = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    np.testing.assert_allclose(matrix[:, :2], turn)
    corners = matrix[:, :2] @ np.array([[0, 89, 0, 89], [0, 0, 59, 59]]) + matrix[:, 2:]
    assert (corners > -1).all()
    assert (corners.max(axis=1) < np.array(upright.shape[::-1])).all()
    assert (corners.max(axis=1) > np.array(upright.shape[::-1]) - 4).all()
    assert np.isnan(upright[0, 0])


def test_lines_are_found_in_the_band_that_shows_most():
    y, x = np.mgrid[:120, :200].astype(float)
    lines = sum(np.exp(-((x - 20 - 16.0 * k) ** 2) / 2) for k in range(11))
    image = (200 - 100 * lines * ((y >= 40) & (y < 80))).astype(np.float32)
    places, along, width = _profile_lines(image, 0.0)
    np.testing.assert_allclose(places, 20 + 16.0 * np.arange(11), atol=0.5)
    assert 38 <= along[0] < along[1] <= 82
    assert width == pytest.approx(2 * np.sqrt(2 * np.log(2)), rel=0.1)
    # What is less than 0.3 as deep is dirt.
    faint = sum(np.exp(-((x - 28 - 16.0 * k) ** 2) / 2) for k in range(10))
    for depth, count in ((29.0, 11), (31.0, 21)):
        other = image - (depth * faint * ((y >= 40) & (y < 80))).astype(np.float32)
        assert len(_profile_lines(other, 0.0)[0]) == count


@pytest.mark.parametrize("blur", [0.9, -0.9])
def test_derivatives_of_a_bar_agree_with_differences(blur):
    grid = np.arange(-6.0, 7.0)
    x, y = (axis.ravel()[None] for axis in np.meshgrid(grid, grid))
    patches = Patches(x, y, 0 * x, np.ones_like(x), np.zeros((1, 2)))
    at = np.array([[0.3, 0.4, blur, 0.6, 180.0, 0.5, -0.3]])
    grey, slopes = _bar(at, 1.7, patches)
    for k in range(7):
        step = np.zeros(7)
        step[k] = 1e-5
        up, down = (_bar(at + s * step, 1.7, patches)[0] for s in (1, -1))
        np.testing.assert_allclose(slopes[0, :, k], ((up - down) / 2e-5)[0], atol=1e-4)
    # In the middle of a wide bar the ground less its contrast; a long way off the ground.
    across = np.cos(0.3) * x + np.sin(0.3) * y - 0.4
    ground = 180.0 + 0.5 * x - 0.3 * y
    far = np.abs(across) > 1.7 + 4.5
    np.testing.assert_allclose(grey[far], ground[far], rtol=1e-5)
    wide = _bar(at, 5.0, patches)[0]
    near = np.abs(across) < 0.4
    np.testing.assert_allclose(wide[near], 0.4 * ground[near], rtol=1e-4)


def regressed(errors, divisions=None, sigma=0.02) -> Micrometer:
    """Lines 12.5 px apart at an angle of 0.3, off by `errors` px, in any order."""
    divisions = np.arange(len(errors)) if divisions is None else np.asarray(divisions)
    normal = np.array([np.cos(0.3), np.sin(0.3)])
    place = 40.0 + 12.5 * divisions + np.asarray(errors)
    order = np.random.default_rng(0).permutation(len(place))
    middle = place[order, None] * normal
    origins = np.round(middle)
    parameters = np.zeros((len(place), 7))
    parameters[:, 0], parameters[:, 1] = 0.3, (middle - origins) @ normal
    covariance = np.zeros((len(place), 7, 7))
    covariance[:, 1, 1] = np.broadcast_to(sigma, len(place))[order] ** 2
    fit = OutlineFit(parameters, covariance, np.ones(len(place)))
    return _regress(fit, origins, 12.4)


def test_lines_are_counted_and_regressed_by_their_errors():
    rng = np.random.default_rng(1)
    errors, sigma = rng.normal(0, 0.02, 12), rng.uniform(0.01, 0.04, 12)
    divisions = np.array([0, 1, 2, 3, 5, 6, 7, 8, 10, 11, 12, 13])
    found = regressed(errors, divisions, sigma)
    np.testing.assert_array_equal(found.divisions, divisions)
    np.testing.assert_allclose(found.sigma, sigma)
    place = 40.0 + 12.5 * divisions + errors
    best, covariance = np.polyfit(divisions, place, 1, w=1 / sigma, cov="unscaled")
    misfit = np.sqrt((((place - np.polyval(best, divisions)) / sigma) ** 2).sum() / 10)
    assert found.spacing == pytest.approx(best[0])
    assert found.misfit == pytest.approx(misfit)
    assert found.spacing_sigma == pytest.approx(np.sqrt(covariance[0, 0]) * max(misfit, 1.0))
    assert found.angle == pytest.approx(0.3)
    np.testing.assert_allclose(found.points @ [np.cos(0.3), np.sin(0.3)], place)
    exact = regressed(np.zeros(12))
    assert exact.spacing_sigma == pytest.approx(0.02 / np.sqrt(143.0))  # Σ(k − 5.5)² = 143


def test_lines_beside_their_places_or_missing_are_no_scale():
    wave = np.tile([1.0, -1.0], 10)
    straight = np.column_stack([np.ones(20), np.arange(20)])
    residual = wave - straight @ np.linalg.lstsq(straight, wave, rcond=None)[0]
    rms = np.sqrt((residual**2).sum() / 18)
    for share, fine in ((0.0118, True), (0.0122, False)):  # of a division
        errors = share * 12.5 / rms * residual
        if fine:
            assert regressed(errors).misfit > 1
        else:
            with pytest.raises(_Unlike, match="divisions beside equal ones"):
                regressed(errors)
    # As much as the fits state explains more.
    regressed(0.49 / rms * 1.5 * residual / 1.5, sigma=0.33)
    with pytest.raises(_Unlike, match="divisions beside"):
        regressed(0.51 / rms * residual, sigma=0.33)
    # Eight of ten places, counted from the first to the last.
    assert len(regressed(np.zeros(8), [0, 1, 2, 3, 5, 6, 8, 10]).points) == 8
    with pytest.raises(_Unlike, match="8 lines on 12 places"):
        regressed(np.zeros(8), [0, 1, 2, 3, 5, 6, 8, 11])
