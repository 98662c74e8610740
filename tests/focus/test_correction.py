"""Spike correction against a loop over (3.14), and smoothing against fitted planes."""

import numpy as np
import pytest

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
    depth = 5e7 + rng.standard_normal((20, 23))  # squares of the depths themselves are rounded
    depth[rng.random(depth.shape) < 0.05] += 80
    depth[rng.random(depth.shape) < unknown] = np.nan
    ours = correct_spikes(depth, **({} if m == 9 else {"window": m, "delta": delta}))
    # Variances come from sums of squares about the mean: 1e-12 of the depths is their rounding.
    np.testing.assert_allclose(ours, printed_correction(depth, m, delta), rtol=1e-12)
    assert (ours != depth)[np.isfinite(depth)].any()


def planes(depth, mass, jump, sigma):
    """The documented smoothing pixel by pixel, its planes by least squares with a weak prior."""
    stride = max(1, round(sigma / 1.75))
    reach = stride * int(2 * sigma / stride)
    steps = range(-reach, reach + 1, stride)
    offsets = [(i, j) for i in steps for j in steps if i * i + j * j <= 4 * sigma**2]
    smooth, rest = np.zeros_like(depth), depth.copy()
    for _ in range(2):
        once = rest.copy()
        for row, col in np.argwhere(mass):
            here = rest[row, col]
            near = [
                (i, j, rest[row + i, col + j], mass[row + i, col + j])
                for i, j in offsets
                if 0 <= row + i < depth.shape[0] and 0 <= col + j < depth.shape[1]
            ]
            i, j, value, share = np.array(near).T
            difference = (value - here) / jump
            weight = share * np.clip(1 - difference**2, 0, None) ** 2
            weight *= np.exp(-(i**2 + j**2) / (2 * sigma**2))
            design = np.column_stack([np.ones_like(i), i, j])
            normal = design.T @ (weight[:, None] * design)
            # Where there is hardly a neighbor.
            normal += np.diag([0, 1, 1]) * 0.001 * sigma**2 * weight.sum()
            once[row, col] = here + np.linalg.solve(normal, design.T @ (weight * (value - here)))[0]
        smooth, rest = smooth + once, rest - once
    return smooth


@pytest.mark.parametrize("options", [{}, {"sigma": 0.9}, {"sigma": 4.4}])
def test_smooth_depth_equals_local_planes_of_known_depths_by_least_squares(options):
    """On a curved slope with a step of two jumps and a hole."""
    rng = np.random.default_rng(6)
    y, x = np.mgrid[:22, :25]
    depth = 0.02 * (x - 11) ** 2 + 0.3 * y + rng.standard_normal(x.shape) + 8.0 * (x + y > 30)
    depth[12:16, 3:8] = np.nan
    known = np.isfinite(depth)
    ours = smooth_depth(depth, jump=4.0, **options)
    wanted = planes(np.nan_to_num(depth), known.astype(float), 4.0, options.get("sigma", 7.0))
    np.testing.assert_array_equal(np.isfinite(ours), known)
    # Sums in single precision, of depths of some jumps.
    np.testing.assert_allclose(ours[known], wanted[known], atol=1e-4)


def test_map_of_nan_is_returned_as_a_copy():
    unknown = np.full((9, 9), np.nan)
    for found in (correct_spikes(unknown), smooth_depth(unknown, jump=1.0)):
        assert np.isnan(found).all()
        assert not np.shares_memory(found, unknown)
