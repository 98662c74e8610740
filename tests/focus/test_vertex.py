"""The compiled fits of a peak beside NumPy's own least squares, in double precision."""

import numpy as np
import pytest

from microlib.focus._peaks import fit_limits, fit_peak
from microlib.focus._vertex import fit_near, places


def parabola(t, y, share, limits):
    """The documented fit of one pixel by `np.polyfit`: the second around the first's vertex."""
    least, most, width = limits
    vertex = 0.0
    for _ in range(2):
        weight = share * np.clip(1 - ((t - vertex) / width) ** 2, 0, None) ** 2
        square, linear, _ = np.polyfit(t, y, 2, w=np.sqrt(weight))
        vertex = np.clip(-linear / (2 * square), least, most)
    return vertex, square


def profiles(count, rng, pixels=60):
    """Peaks of many widths anywhere in a stack of uneven frames, best frames and positions."""
    steps = np.cumsum(1 + 0.2 * rng.uniform(-1, 1, count))
    place = rng.uniform(steps[0], steps[-1], pixels)
    width = rng.uniform(1.0, 2.5, pixels)
    shape = np.exp(-((steps[:, None] - place) ** 2) / (2 * width**2))
    volume = (100 * shape + 2 * rng.random(shape.shape)).astype(np.float32)
    return steps, volume


def around(volume, index, reach):
    """Measures from `reach` frames before to `reach` after; anything beyond the stack."""
    padded = np.pad(volume, ((reach, reach), (0, 0)), constant_values=7.0)
    return np.stack([padded[index + k, np.arange(len(index))] for k in range(2 * reach + 1)])


@pytest.mark.parametrize(("count", "reach"), [(3, 3), (5, 2), (8, 3), (21, 2), (21, 3), (30, 9)])
def test_peaks_are_fitted_as_by_polyfit(count, reach):
    steps, volume = profiles(count, np.random.default_rng(count + reach))
    spacing = np.median(np.diff(steps))
    index = volume.argmax(axis=0)
    depth, certainty = fit_peak(
        around(volume, index, reach)[:, None], index[None].astype(np.uint16), steps
    )
    limits = fit_limits(steps / spacing, reach, (steps[0] / spacing, steps[-1] / spacing))
    for x, best in enumerate(index):
        near = slice(max(best - reach, 0), best + reach + 1)
        share = volume[near, x].astype(float) / volume[best, x]
        t = (steps[near] - steps[best]) / spacing
        vertex, square = parabola(t, np.log(share), share, limits[:, best])
        # Single precision has seven digits; shares of neighbors are close to one.
        assert depth[0, x] == pytest.approx(steps[best] + vertex * spacing, abs=2e-5)
        assert certainty[0, x] == pytest.approx(-square * volume[best, x], rel=1e-3, abs=1e-3)


def test_flat_profiles_have_no_depth_but_at_the_ends_of_the_stack():
    window = np.full((7, 1, 4), 3, np.float32)
    window[:, 0, 3] = 0
    index = np.array([[0, 4, 8, 4]], np.uint16)
    depth, certainty = fit_peak(window, index, np.arange(9.0))
    assert np.isnan(depth).all()
    assert (certainty == 0).all()
    # Its logarithm opens upwards: only the ends are left to be taken.
    window = np.array([9.9, 9.9, 4, 10, 4, 9.9, 9.9], np.float32)[:, None, None].repeat(3, axis=2)
    index = np.array([[0, 4, 8]], np.uint16)
    depth, _ = fit_peak(window, index, np.arange(9.0))
    np.testing.assert_array_equal(depth, [[0, np.nan, 8]])


def test_near_a_known_frame_the_highest_of_three_is_fitted():
    rng = np.random.default_rng(4)
    steps, along = profiles(21, rng)
    down = along[:, ::-1].copy()
    spacing = np.median(np.diff(steps))
    steps = steps / spacing
    center = np.clip(along.argmax(axis=0) + rng.integers(-2, 3, along.shape[1]), 0, 20)
    depth = steps[center] + 0.1
    depth[:3] = np.nan
    windows = np.stack([around(part, center, 4) for part in (along, down)])
    limits = fit_limits(steps, 3, (steps[0], steps[-1]))
    offsets, weights = np.ones((2, 3, along.shape[1]), np.float32)
    fit_near(
        windows,
        center.astype(np.int32),
        depth,
        places(steps, 3),
        limits.astype(np.float32),
        steps,
        offsets,
        weights,
    )
    assert (offsets[:, :3] == 0).all()
    assert (weights[:, :3] == 0).all()
    for kind, volume in enumerate((along + down, along, down)):
        for x in range(3, along.shape[1]):
            first = max(center[x] - 1, 0)
            best = first + int(np.argmax(volume[first : center[x] + 2, x]))
            near = slice(max(best - 3, 0), best + 4)
            share = volume[near, x].astype(float) / volume[best, x]
            vertex, square = parabola(
                steps[near] - steps[best], np.log(share), share, limits[:, best]
            )
            if square < -1e-3:
                assert weights[kind, x] ** 2 == pytest.approx(-square * volume[best, x], rel=2e-3)
                assert offsets[kind, x] == pytest.approx(steps[best] + vertex - depth[x], abs=2e-5)
