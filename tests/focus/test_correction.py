"""Spike correction against a loop over (3.14), and smoothing on planes, steps and noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microlib.focus import correct_spikes, smooth_depth


def printed_correction(depth: np.ndarray, m: int, delta: float) -> np.ndarray:
    """(3.14) pixel by pixel, with the condition turned round, from the known depths alone."""
    padded = np.pad(depth, m // 2, mode="symmetric")
    result = depth.copy()
    for i, j in np.ndindex(depth.shape):
        window = padded[i : i + m, j : j + m]
        if not abs(depth[i, j] - np.nanmedian(window)) <= delta * np.nanstd(window):
            result[i, j] = np.nanmedian(window)
    return result


@pytest.mark.parametrize(
    ("m", "delta", "unknown"), [(9, 2.0, 0), (5, 1.0, 0), (3, 0.0, 0), (9, 2.0, 0.5)]
)
def test_correct_spikes_equals_equation_3_14_with_its_erratum(m, delta, unknown):
    """With half unknown, dividing by all would put the deviation √2 too low, or far too high."""
    rng = np.random.default_rng(m)
    depth = 500 + rng.standard_normal((20, 23))
    depth[rng.random(depth.shape) < 0.05] += 80
    depth[rng.random(depth.shape) < unknown] = np.nan
    ours = correct_spikes(depth, window=m, delta=delta)
    # Variances come from sums of squares about the mean: 1e-12 of the depths is their rounding.
    np.testing.assert_allclose(ours, printed_correction(depth, m, delta), rtol=1e-12)
    assert (ours != depth)[np.isfinite(depth)].any()


def planes(depth, mass, jump, radius):
    """The documented smoothing pixel by pixel, its planes by least squares with a weak prior."""
    stride = max(1, round(radius / 1.75))
    reach = stride * int(2 * radius / stride)
    steps = range(-reach, reach + 1, stride)
    offsets = [(i, j) for i in steps for j in steps if i * i + j * j <= 4 * radius**2]
    smooth, rest = np.zeros_like(depth), depth.copy()
    for _ in range(2):
        once = np.empty_like(depth)
        for (row, col), here in np.ndenumerate(rest):
            near = [
                (i, j, rest[row + i, col + j], mass[row + i, col + j])
                for i, j in offsets
                if 0 <= row + i < depth.shape[0] and 0 <= col + j < depth.shape[1]
            ]
            i, j, value, share = np.array(near).T
            difference = (value - here) / jump
            weight = share * np.clip(1 - difference**2, 0, None) ** 2
            weight *= np.exp(-(i**2 + j**2) / (2 * radius**2))
            design = np.column_stack([np.ones_like(i), i, j])
            normal = design.T @ (weight[:, None] * design)
            # Where there is hardly a neighbor.
            normal += np.diag([0, 1, 1]) * 0.001 * radius**2 * weight.sum()
            once[row, col] = here + np.linalg.solve(normal, design.T @ (weight * (value - here)))[0]
        smooth, rest = smooth + once, rest - once
    return smooth


@pytest.mark.parametrize("options", [{}, {"radius": 2.0}, {"radius": 4.4}])
def test_smooth_depth_equals_local_planes_by_least_squares(options):
    rng = np.random.default_rng(6)
    y, x = np.mgrid[:22, :25]
    depth = 0.02 * (x - 11) ** 2 + 0.3 * y + rng.standard_normal(x.shape)
    ours = smooth_depth(depth, jump=4.0, **options)
    wanted = planes(depth, np.ones_like(depth), 4.0, options.get("radius", 7.0))
    # Sums in single precision, of depths of some jumps.
    np.testing.assert_allclose(ours, wanted, atol=1e-4)


@settings(deadline=None, max_examples=20)
@given(
    rise_x=st.floats(-2, 2),
    rise_y=st.floats(-2, 2),
    scale=st.floats(0.1, 10),
    turn=st.integers(0, 3),
)
def test_smoothing_leaves_planes_and_turns_and_scales_with_them(rise_x, rise_y, scale, turn):
    y, x = np.mgrid[0:24, 0:30].astype(float)
    plane = scale * (rise_x * x + rise_y * y)
    smooth = smooth_depth(np.rot90(plane, turn), jump=5 * scale, radius=2.0)
    inner = np.s_[8:-8, 8:-8]  # twice the reach of 4 px
    np.testing.assert_allclose(
        smooth[inner], np.rot90(plane, turn)[inner], atol=2e-5 * scale * (1 + np.abs(plane).max())
    )


def test_smoothing_cuts_noise_and_keeps_a_step():
    rng = np.random.default_rng(1)
    truth = np.where(np.arange(64) < 32, 0.0, 5.0) + np.zeros((64, 1))
    noisy = truth + 0.1 * rng.standard_normal(truth.shape)
    error = (smooth_depth(noisy, jump=1.5) - truth)[8:-8, 8:-8]
    # 37 neighbors weighted by a Gaussian are worth some 20; twicing doubles the variance at most:
    # 0.1 sqrt(2 / 20) = 0.032 on open ground, a third more beside the step.
    assert error.std() < 0.042
    assert np.abs(error[:, 20:28]).max() < 0.2  # five times that, next to the step as well


def test_smooth_depth_ignores_and_keeps_nan():
    depth = np.tile(np.arange(30.0), (30, 1))
    depth[10:14, 10:14] = np.nan
    smooth = smooth_depth(depth, jump=100.0)
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(depth))
    known = ~np.isnan(depth)
    np.testing.assert_allclose(smooth[known], depth[known], atol=0.06)  # stiffness at the border


def test_map_of_nan_is_returned_as_a_copy():
    unknown = np.full((9, 9), np.nan)
    for found in (correct_spikes(unknown), smooth_depth(unknown, jump=1.0)):
        assert np.isnan(found).all()
        assert not np.shares_memory(found, unknown)
