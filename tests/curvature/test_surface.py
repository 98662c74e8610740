"""H and K against surfaces of known curvature and convolutions, labels against Table 3.1."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.special import comb

from microlib import curvature
from microlib.curvature import hk_labels, surface_curvature

#: Half side of the maps and radius of curvature, px. The windows span 13 px.
HALF, RADIUS = 40, 150.0
#: Largest bias of the windows on these surfaces: 0.04 % of 1/R for H, 0.075 % of 1/R² for K.
BIAS = 8e-4
Y, X = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1].astype(float)
#: Pixels that are not square, as those of an interferometer.
SIDES = (1.07, 1.25)
#: Surface, mean and Gaussian curvature, label.
SURFACES = {
    "sphere": (np.sqrt(RADIUS**2 - X**2 - Y**2), -1 / RADIUS, 1 / RADIUS**2, 1),
    "bowl": (-np.sqrt(RADIUS**2 - X**2 - Y**2), 1 / RADIUS, 1 / RADIUS**2, 7),
    "cylinder": (np.sqrt(RADIUS**2 - X**2), -0.5 / RADIUS, 0.0, 2),
    "gutter": (-np.sqrt(RADIUS**2 - Y**2), 0.5 / RADIUS, 0.0, 8),
    "saddle": ((X**2 - Y**2) / (2 * RADIUS), 0.0, -1 / RADIUS**2, 6),
    "turned saddle": (X * Y / RADIUS, 0.0, -1 / RADIUS**2, 6),
    "plane": (0.3 * X - 0.2 * Y, 0.0, 0.0, 5),
}


@pytest.mark.parametrize("size", [3, 5, 7, 11])
def test_windows_match_least_squares_parabola(size):
    t = np.arange(size) - size // 2
    windows = curvature.curvature_windows(size)
    values = np.random.default_rng(size).random(size)
    quadratic, linear, _ = np.polyfit(t, values, 2)
    assert windows.second_derivative @ values == pytest.approx(2 * quadratic, abs=1e-12)
    assert windows.slope @ values == pytest.approx(linear, abs=1e-12)
    np.testing.assert_allclose(windows.smooth, comb(size - 1, np.arange(size)) / 2 ** (size - 1))
    np.testing.assert_allclose(windows.mean, 1 / size)


def test_separable_windows_match_two_dimensional_convolutions():
    """S and D are applied one after the other, as (3.20) and (3.21) say, on pixels of `SIDES`."""
    w = curvature.curvature_windows()
    z = 5 * np.random.default_rng(0).random((31, 29))
    smooth = ndimage.convolve(z, np.outer(w.smooth, w.smooth))
    x_side, y_side = SIDES
    zx, zy, zxx, zyy, zxy = (
        ndimage.correlate(smooth, np.outer(along_y, along_x)) / cell
        for along_y, along_x, cell in (
            (w.mean, w.slope, x_side),
            (w.slope, w.mean, y_side),
            (w.mean, w.second_derivative, x_side**2),
            (w.second_derivative, w.mean, y_side**2),
            (w.slope, w.slope, x_side * y_side),
        )
    )
    h = ((1 + zx**2) * zyy - 2 * zx * zy * zxy + (1 + zy**2) * zxx) / (
        2 * (1 + zx**2 + zy**2) ** 1.5
    )
    k = (zxx * zyy - zxy**2) / (1 + zx**2 + zy**2) ** 2
    found = surface_curvature(z, SIDES)
    inner = np.s_[6:-6, 6:-6]
    np.testing.assert_allclose(found.mean[inner], h[inner], atol=1e-12)
    np.testing.assert_allclose(found.gaussian[inner], k[inner], atol=1e-12)


def test_signs_of_h_and_k_give_labels_of_table_3_1():
    h, k = np.meshgrid([-1.0, 0.0, 1.0], [1.0, 0.0, -1.0], indexing="ij")
    assert hk_labels(h, k, 0.5, 0.5).tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert hk_labels([np.nan, 1.0], [1.0, np.nan], 0.5, 0.5).tolist() == [0, 0]
    assert hk_labels([0.5], [-0.5], 0.5, 0.5).tolist() == [5]  # |x| = threshold is zero (3.24)
    h, k = np.full((2, 2), -1.0), np.full((2, 2), 0.2)
    limit = np.array([[0.1, 2.0], [np.nan, 0.1]])  # a threshold of each pixel
    assert hk_labels(h, k, limit, 0.1).tolist() == [[1, 4], [0, 1]]
    assert hk_labels(h, k, 0.1, limit).tolist() == [[1, 2], [0, 1]]
    assert hk_labels(h, k, 0, 0).tolist() == [[1, 1], [1, 1]]


@pytest.mark.parametrize("size", [3, 5, 7])
def test_smallest_map_has_one_known_pixel(size):
    side = 2 * size - 1
    x, y = np.arange(side) - size + 1.0, np.arange(side + 1)[:, None] - size + 1.0
    bowl = (x**2 + y**2) / 400
    found = surface_curvature(bowl, 2.0, size=size, noise=0.1)
    known = np.zeros((side + 1, side), bool)
    known[size - 1 : size + 1, size - 1] = True
    for field in (found.mean, found.gaussian, found.mean_uncertainty, found.gaussian_uncertainty):
        np.testing.assert_array_equal(np.isfinite(field), known)
    # At the vertex, whose second derivatives are 1/200 in heights of 1 over pixels of 2 by 2.
    assert found.mean[size - 1, size - 1] == pytest.approx(1 / 800, rel=1e-9)
    assert found.gaussian[size - 1, size - 1] == pytest.approx(1 / 800**2, rel=1e-9)


def test_uncertainties_match_first_order_propagation():
    """The answer to a small error of one height has all weights: of K on a strong bowl or saddle,
    where the second order is 1e-6 of the first, and of H on a plane, where an error of the slope
    has no part."""
    bowls = (X**2 + Y**2) / 40, (X**2 - Y**2) / 40, X * Y / 20, X**2 / 20 + X * Y / 30
    cases = [("gaussian", bowl, 2e-3) for bowl in bowls] + [("mean", 0.8 * X + 0.5 * Y, 1e-4)]
    for field, surface, rel in cases:
        height = surface[HALF - 6 : HALF + 7, HALF - 6 : HALF + 7]  # within reach of the center
        found, push, squares = surface_curvature(height, SIDES, noise=1e-5), 1e-7, 0.0
        for at in np.ndindex(13, 13):
            pushed = height.copy()
            pushed[at] += push
            answer = getattr(surface_curvature(pushed, SIDES), field)
            squares += ((answer - getattr(found, field))[6, 6] / push) ** 2
        stated = getattr(found, f"{field}_uncertainty")[6, 6]
        assert stated == pytest.approx(1e-5 * squares**0.5, rel=rel)


def test_regions_are_connected_along_rows_and_columns():
    """Two pixels that touch at a corner are two regions; a region as large as asked for stays."""
    labels = np.full((12, 14), 5, np.uint8)
    labels[:, 9:], labels[0, 0] = 2, 0
    labels[1, 1] = labels[2, 2] = labels[4, 12] = 3
    labels[4:7, 2:5] = 8
    cleaned = labels.copy()
    cleaned[1, 1] = cleaned[2, 2] = 5  # the label of the nearest region
    cleaned[4, 12] = 2
    for smallest, wanted in ((1, labels), (9, cleaned), (1000, labels)):
        np.testing.assert_array_equal(curvature.clean_labels(labels, smallest), wanted)
    cleaned[4:7, 2:5] = 5
    np.testing.assert_array_equal(curvature.clean_labels(labels, 10), cleaned)
    flat = surface_curvature(np.zeros((13, 14)), 1.0)
    rows = np.zeros((13, 14), np.uint8)
    rows[2:4, 5:9], rows[7, 1], rows[8, 2] = 2, 9, 9
    table = curvature.region_table(rows, flat)
    assert table["area"].tolist() == [8, 1, 1]
    assert table["label"].tolist() == [2, 9, 9]
    assert table["name"].tolist() == ["convex cylindric", "saddle valley", "saddle valley"]
    assert table[["x", "y"]].to_numpy().tolist() == [[6.5, 2.5], [1.0, 7.0], [2.0, 8.0]]


@pytest.mark.parametrize("name", SURFACES)
def test_curvature_and_labels_match_known_surfaces(name):
    """H and K are the same everywhere but on the saddle, and noise leaves the labels."""
    pixel_size = 0.25
    height, mean, gaussian, label = SURFACES[name]
    found = surface_curvature(pixel_size * height, pixel_size)
    place = np.s_[HALF, HALF] if "saddle" in name else np.s_[6:-6, 6:-6]
    np.testing.assert_allclose(found.mean[place] * pixel_size, mean, atol=BIAS / RADIUS)
    np.testing.assert_allclose(
        found.gaussian[place] * pixel_size**2, gaussian, atol=BIAS / RADIUS**2
    )
    noise = 0.02
    rough = height + noise * np.random.default_rng(5).standard_normal(height.shape)
    labels = hk_labels(surface_curvature(pixel_size * rough, pixel_size, noise=pixel_size * noise))
    # Only the center of the saddle is a minimal surface.
    inner = (labels > 0) & (np.hypot(X, Y) < (30 if "saddle" in name else np.inf))
    assert (labels > 0).sum() == (2 * HALF + 1 - 12) ** 2
    assert np.mean(labels[inner] == label) >= 0.995


def test_unknown_noise_gives_no_uncertainties_and_needs_thresholds():
    found = surface_curvature(SURFACES["sphere"][0], 1.0)
    assert np.isnan(found.mean_uncertainty).all()
    assert np.isnan(found.gaussian_uncertainty).all()
    assert len(repr(found)) < 200
    for one in ({}, {"h_zero": 1e-4}, {"k_zero": 1e-6}):
        with pytest.raises(ValueError, match="must be given the noise of the heights"):
            hk_labels(found, **one)
    by_hand = hk_labels(found, h_zero=1e-4, k_zero=1e-6)
    np.testing.assert_array_equal(by_hand, hk_labels(found.mean, found.gaussian, 1e-4, 1e-6))
    with pytest.raises(ValueError, match="gaussian must not be given with a Curvature"):
        hk_labels(found, found.gaussian)
    # Of a map without any valid curvature the noise is no cause.
    nothing = surface_curvature(np.full((20, 20), np.nan), 1.0)
    assert not hk_labels(nothing).any()
    with pytest.raises(ValueError, match="must be given with an array"):
        hk_labels(found.mean, found.gaussian)


def test_default_thresholds_are_three_and_a_half_uncertainties():
    rough = SURFACES["sphere"][0] + np.random.default_rng(6).normal(0, 0.05, X.shape)
    found = surface_curvature(rough, SIDES, noise=0.05)
    given = {"h_zero": 3.5 * found.mean_uncertainty, "k_zero": 3.5 * found.gaussian_uncertainty}
    assert {1, 2, 5} <= set(np.unique(hk_labels(found)))
    for change in ({}, {"h_zero": 1.0}, {"k_zero": 1.0}):
        np.testing.assert_array_equal(
            hk_labels(found, **change), hk_labels(found, **given | change)
        )


def test_nan_spreads_over_windows_only():
    z = SURFACES["sphere"][0].copy()
    z[HALF, HALF] = np.nan
    found, whole = surface_curvature(z, 1.0), surface_curvature(SURFACES["sphere"][0], 1.0)
    hole = np.zeros(z.shape, bool)
    hole[HALF - 6 : HALF + 7, HALF - 6 : HALF + 7] = True
    np.testing.assert_array_equal(np.isnan(found.mean) & ~np.isnan(whole.mean), hole)
    # What lies beyond the windows' reach has no part: rounding alone, of heights of 150.
    np.testing.assert_allclose(found.mean[~hole], whole.mean[~hole], rtol=1e-9)


@pytest.mark.parametrize("name", ["plane", "flat"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_noiseless_plane_is_labeled_planar(name, dtype):
    """Rounding of the heights is no curvature."""
    height = {"plane": 0.3 * X - 0.2 * Y + 70.0, "flat": np.full(X.shape, 5.0)}[name].astype(dtype)
    labels = hk_labels(surface_curvature(height, 1.3, noise=0.0))
    assert (labels[labels > 0] == 5).all()
    ball = hk_labels(surface_curvature(SURFACES["sphere"][0].astype(dtype), 1.0, noise=0.0))
    assert (ball[ball > 0] == 1).all()


@pytest.mark.parametrize("size", [3, 5, 9])
def test_uncertainties_match_scatter_on_non_square_pixels(size):
    """H to first order, K to second."""
    maps = np.random.default_rng(size).normal(0, 0.02, (3, 400, 400))
    stated = surface_curvature(np.zeros((31, 31)), (1.3, 2.9), size=size, noise=0.02)
    found = [surface_curvature(z, (1.3, 2.9), size=size, noise=0.02) for z in maps]
    apart = np.s_[20 : -20 : 2 * size, 20 : -20 : 2 * size]
    for field in ("mean", "gaussian"):
        values = np.array([getattr(one, field)[apart] for one in found])
        # Independent windows. The products of K have tails like those of an exponential.
        freedom = values.size * (1.0 if field == "mean" else 0.3)
        error = 4 / np.sqrt(2 * freedom)
        assert getattr(stated, field + "_uncertainty")[15, 15] == pytest.approx(
            values.std(), rel=error
        )
        # On a noisy plane the measured derivatives are noise. √3 of it would count it twice.
        on_noise = [getattr(one, field + "_uncertainty")[apart] for one in found]
        assert 0.95 < np.sqrt(np.mean(np.square(on_noise))) / values.std() < 1.5


def test_heights_in_another_unit_than_pixels_warn():
    ball = SURFACES["sphere"][0]
    surface_curvature(ball, 1.0)  # a warning here would be an error (pyproject)
    for along in (X, Y):
        surface_curvature(3.9 * along, 1.0)  # 76° is a slope of 4
    for height, pixel_size in ((ball, 0.001), (4.1 * X, 1.0), (4.1 * Y, 1.0)):
        with pytest.warns(UserWarning, match="it must have the unit of pixel_size"):
            surface_curvature(height, pixel_size)
