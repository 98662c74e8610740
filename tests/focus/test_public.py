"""The calls of every public function of focus: their units, their axes and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import (
    correct_spikes,
    depth_from_focus,
    smooth_depth,
    sum_modified_laplacian,
    three_point_peak,
)
from tests.checks import (
    NEGATIVE,
    NO_COUNT,
    each_view,
    follows_view,
    hold_call,
    hold_refused,
    hold_same_as_new,
    hold_scaled,
    no_array,
    no_map,
)
from tests.scenes import tilted_plane
from tests.scenes.focus import NAMES, inner, rms, stack_of

SHAPE = (44, 60)
#: Uneven positions that fall, and a slope beside a step, µm.
Z = 100 - np.array([0.0, 9, 20, 31, 39, 50, 62, 70, 81, 90])
TRUTH = 40 + tilted_plane(SHAPE, 0.3, 0.2)
TRUTH[:, 35:] += 22
TEXTURE = synthetic.mixed_texture(SHAPE, np.random.default_rng(4))
STACK = stack_of(TRUTH, Z, texture=TEXTURE, rate=0.1, noise=1.0, seed=5).astype(float)
HOLED = np.where(np.indices(SHAPE).sum(axis=0) % 11 == 3, np.nan, TRUTH)
WINDOW = np.random.default_rng(6).uniform(1, 2, (3, *SHAPE))
WINDOW[1] += 2
INDEX = np.random.default_rng(7).integers(0, len(Z), SHAPE)
SMALL = np.random.default_rng(1).integers(0, 255, (5, 24, 31)).astype(np.uint8)
#: A valid call of each function.
CALLS = {
    correct_spikes: lambda: {"depth": HOLED.copy(), "window": 5, "delta": 1.5},
    depth_from_focus: lambda: {
        "frames": SMALL.copy(), "positions": np.arange(5.0), "measure": "sml", "window": 5,
        "region": (0, 0, 20, 20), "reduce": 1, "workers": 2,
    },
    smooth_depth: lambda: {"depth": HOLED.copy(), "jump": 12.0, "sigma": 4.0},
    sum_modified_laplacian: lambda: {
        "image": STACK[3].copy(), "window": 5, "step": 2, "threshold": 9.5,
    },
    three_point_peak: lambda: {
        "window": WINDOW.copy(), "index": INDEX.copy(), "positions": 42.0 + Z,
    },
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__name__)
ODD = [*NO_COUNT, 4]
#: What is refused in place of each argument.
REFUSED = {
    correct_spikes: {
        "depth": lambda valid: [*no_map(valid), np.zeros(12), np.full((12, 12), np.inf)],
        "window": ODD, "delta": NEGATIVE,
    },
    depth_from_focus: {
        "frames": no_map,
        "positions": lambda valid: [*no_array(valid), [3.0] * 5, [0, 0, 1, 2, 3], [2, 1, 1, 0, -1]],
        "window": ODD, "progress": [5, "text"],
    },
    smooth_depth: {
        "depth": lambda valid: [*no_map(valid), np.full(valid.shape, -np.inf)], "sigma": NEGATIVE,
    },
    sum_modified_laplacian: {"window": ODD, "step": [*NO_COUNT, 99], "threshold": NEGATIVE},
    three_point_peak: {
        "window": lambda valid: [*no_array(valid), valid[:2], -valid],
        "index": lambda valid: [*no_array(valid), 0 * valid + len(Z), 0 * valid - 1],
        "positions": lambda valid: [*no_array(valid), np.arange(2.0), np.arange(10) // 2],
    },
}  # fmt: skip


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function], undecided=0.002)


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


@pytest.mark.parametrize("measure", ["multiscale", partial(sum_modified_laplacian, window=7)])
@pytest.mark.parametrize(("grey", "um", "z0"), [(1 / 255, 0.017, 0.0), (257.0, 1.0, -172.0)])
def test_depth_follows_units_of_grey_levels_and_positions(measure, grey, um, z0):
    found = depth_from_focus(grey * STACK, um * (Z + z0), measure=measure)
    plain = depth_from_focus(STACK, Z, measure=measure)
    by = {"depth": lambda z: um * (z + z0), "uncertainty": um, "all_in_focus": grey}
    # float32 grey levels, at a curvature of the peak of 0.1.
    hold_scaled(found, plain, within=1e-4, **by)
    known = np.isfinite(found.depth)
    depth, error = found.depth[known], found.uncertainty[known]
    assert found.to_dict() == pytest.approx({
        "rows": 44, "columns": 60, "known": known.mean(), "depth_least": depth.min(),
        "depth_median": np.median(depth), "depth_largest": depth.max(),
        "uncertainty_median": np.median(error), "uncertainty_largest": error.max(),
        "unit": "µm", "at_end": found.at_end[known].mean(), "registered": False,
    })  # fmt: skip


def test_share_at_the_ends_counts_only_pixels_with_a_height():
    """Half of the pixels are sharpest in an end frame, of those with a height a sixth."""
    found = depth_from_focus(STACK, Z)
    depth, ends = np.full(STACK[0].shape, 30.0, np.float32), np.zeros(STACK[0].shape, bool)
    ends[:, :30] = True
    depth[:, :24] = np.nan
    found = replace(found, depth=depth, uncertainty=depth, at_end=ends)
    assert found.to_dict()["at_end"] == pytest.approx(6 / 36)
    unknown = np.full_like(depth, np.nan)
    assert replace(found, depth=unknown, uncertainty=unknown).to_dict()["at_end"] is None


@pytest.mark.parametrize("measure", NAMES)
@pytest.mark.parametrize(("origin", "spacing"), [(1e4, 0.02), (-1e5, 0.02), (1e9, 1.0)])
def test_depth_far_from_zero_keeps_its_digits(measure, origin, spacing):
    """Positions of a stage that counts from afar: 1e9 + 0.001 has digits in float64 only."""
    scale = spacing / 10
    plain = depth_from_focus(STACK, scale * Z, measure=measure)
    found = depth_from_focus(STACK, origin + scale * Z, measure=measure)
    assert (plain.depth.dtype, found.depth.dtype) == (np.float32, np.float64)
    # Positions are rounded to 1e-7 µm at 1e9 µm, and depths to float32 of some µm.
    off = found.depth - origin - plain.depth
    assert np.nanmax(np.abs(off)) < spacing / 1000
    np.testing.assert_allclose(found.uncertainty, plain.uncertainty, rtol=1e-3)


@pytest.mark.parametrize(("um", "z0"), [(0.017, 0.0), (1.0, -172.0)])
def test_corrected_depths_and_peaks_follow_unit_and_origin(um, z0):
    def there(z):
        return um * (z + z0)

    spikes = partial(correct_spikes, window=5, delta=1.5)
    hold_scaled(spikes(there(HOLED)), spikes(HOLED), there)
    smooth = smooth_depth(there(HOLED), jump=12.0 * um, sigma=4.0)
    hold_scaled(smooth, smooth_depth(HOLED, jump=12.0, sigma=4.0), there, within=1e-4)
    found = three_point_peak(WINDOW / 255, INDEX, there(Z))
    hold_scaled(found, three_point_peak(WINDOW, INDEX, Z), there)


@each_view
def test_depth_follows_flips_and_rotations(view):
    """Of sides that are multiples of four, which the coarser grids leave whole."""
    for measure in NAMES:
        plain = depth_from_focus(STACK, Z, measure=measure).depth
        seen = [np.ascontiguousarray(view.image(frame)) for frame in STACK]
        off = np.abs(depth_from_focus(seen, Z, measure=measure).depth - view.image(plain))
        # Equal peaks of float32 and limits of rules decide otherwise on a few pixels.
        assert np.mean(off < 0.01) > 0.98
    follows_view(view, correct_spikes, HOLED, atol=1e-3)
    follows_view(view, lambda depth: smooth_depth(depth, jump=12.0), HOLED, atol=1e-3)


@pytest.mark.parametrize(
    ("count", "least", "most"), [(8, 0.4, 0.6), (11, 0.7, 1.5), (41, 0.7, 1.5)]
)
def test_depth_uncertainty_matches_error_for_few_and_many_frames(count, least, most):
    """Within the limits of benchmarks/focus_depth.py, a half more for few draws.

    Of 8 frames peaks are narrow: half of their peak locking is stated, twice what this texture has.
    """
    z = 100 - np.linspace(0, 40, count) ** 1.02
    height, ratios = 80 + tilted_plane((88, 108), 0.08, 0.05), []
    for seed in range(3):
        found = depth_from_focus(stack_of(height, z, rate=0.25, noise=4.0, seed=seed), z)
        ratios.append(rms(inner(found.depth - height)) / rms(inner(found.uncertainty)))
    assert least < np.mean(ratios) < most


def test_frames_can_be_used_again_after_interruption():
    def use(frames):
        return [depth_from_focus(frames, Z, **how).depth for how in ({}, {"register": True})]

    def interrupted(frames, last):
        calls = []

        def stop(done, count):
            calls.append(done)
            if done >= last:
                raise InterruptedError

        with pytest.raises(InterruptedError):
            depth_from_focus(frames, Z, progress=stop, workers=2)
        assert max(calls[:-1]) < last

    hold_same_as_new(
        lambda: STACK.astype(np.uint8),
        use,
        partial(interrupted, last=3),
        partial(interrupted, last=len(Z) + 1),
        lambda frames: depth_from_focus(frames, Z[:4]),
        use,
    )


@pytest.mark.parametrize(("levels", "kind"), [(1, "u1"), (200, "u2"), (1 / 255, "f4")])
def test_untextured_ground_has_no_depth_in_three_types_of_grey_levels(levels, kind):
    """Not from noise, and not from the rounding to whole grey levels where that is all there is."""
    texture = synthetic.mixed_texture((96, 160), np.random.default_rng(2))
    gradient = np.linspace(90, 110, 100)  # which rounds to terraces
    z = Z if kind != "u2" else np.linspace(0, 81, 60)
    for ground, noise in ((gradient, 0.0), (100.3, 0.2), (gradient, 0.15), (gradient, 2.0)):
        texture[:, 60:] = ground
        height = np.full(texture.shape, 41.0)
        frames = levels * stack_of(height, z, texture=texture, rate=0.04, noise=0.0).astype(float)
        frames += noise * levels * np.random.default_rng(3).standard_normal(frames.shape)
        frames = frames if kind == "f4" else np.rint(frames)
        depth = depth_from_focus(frames.clip(0).astype(kind), z).depth
        assert np.isfinite(depth[8:-8, 8:45]).mean() > 0.98
        assert np.isfinite(depth[:, 110:]).mean() < 0.01


def test_registration_of_large_frames_finds_their_transforms():
    """Frames of 1024 px are compared at a fourth; their pixels' centers must not move by that."""
    rows, cols = 976, 1064
    rng = np.random.default_rng(8)
    texture = sum(cv2.GaussianBlur(rng.normal(0, 30 * s, (rows, cols)), (0, 0), s) for s in (4, 12))
    true = [
        np.array([[1 + 0.04 * k, 0, 1.7 * k], [0, 1 + 0.04 * k, -2.4 * k]]) for k in range(-2, 3)
    ]
    frames = [cv2.warpAffine(120 + texture, pose, (cols, rows), borderMode=4) for pose in true]
    found = depth_from_focus(np.float32(frames), spacing=1.0, register=True, measure="sml").warps
    corners = np.array([[0, 0, 1], [cols - 1, 0, 1], [0, rows - 1, 1], [cols - 1, rows - 1, 1]]).T
    # 1.5 px of a small pixel's center, times a change of scale of 0.08, would be 0.12 px.
    assert np.abs((found - true) @ corners).max() < 0.1
