"""Relief from the agreement of two directions, and the errors that are stated with it."""

import numpy as np
import pytest
from skimage import data

from microlib import synthetic
from microlib.focus import depth_from_focus
from tests.scenes import straight_step, tilted_plane
from tests.scenes.focus import inner, rms, stack_of

SHAPE = (150, 144)
POSITIONS = np.arange(15.0)
TILT = 4 + tilted_plane(SHAPE, 5 / 144, 2 / 144)


def waves(period: float, amplitude: float):
    y, x = np.indices(SHAPE)
    return amplitude * np.sin(2 * np.pi * x / period) * np.sin(2 * np.pi * y / period)


def deciles(error, stated):
    """RMS error over stated, in every tenth of the pixels, sorted by what is stated."""
    error, stated = error.ravel(), stated.ravel()
    parts = np.array_split(np.argsort(stated, kind="stable"), 10)
    return np.array([np.sqrt(np.mean(error[k] ** 2) / np.mean(stated[k] ** 2)) for k in parts])


@pytest.mark.parametrize(
    ("period", "amplitude", "least"), [(12, 0.3, 0.65), (12, 1, 0.75), (20, 1, 0.85)]
)
def test_fine_relief_is_kept_where_a_plain_measure_drowns_it_in_noise(period, amplitude, least):
    """The limits of benchmarks/focus_depth.py at another seed; before, a gain of 0.05 to 0.6."""
    height = 7.2 + waves(period, amplitude)
    stack = stack_of(height, POSITIONS, seed=11)
    found = inner(depth_from_focus(stack, POSITIONS).depth)
    plain = depth_from_focus(stack, POSITIONS, measure="sml", window=9).depth
    assert rms(found - inner(height)) < 0.9 * rms(inner(plain - height))
    assert np.polyfit(inner(waves(period, amplitude)).ravel(), found.ravel(), 1)[0] > least


def surfaces():
    texture = np.asarray(data.gravel()[: SHAPE[0], : SHAPE[1]], float)
    yield "tilt", TILT, None
    yield "dome of gravel", 4 + synthetic.paraboloid(SHAPE, 5.0), texture
    yield "relief", 7.2 + waves(12, 1.0), None
    yield "step", 4.2 + straight_step(SHAPE, 6.0), None
    yield "cone", 3.3 + synthetic.cone(SHAPE, 6.0, 60.0), None


@pytest.mark.parametrize(
    ("name", "height", "texture"), list(surfaces()), ids=lambda v: v if isinstance(v, str) else ""
)
def test_depth_errors_match_stated_uncertainty_in_every_decile(name, height, texture):
    """No tenth more than twice as wrong as it says; beside relief more is said.

    The tip and the foot of the cone were six times as wrong before bends were looked at.
    """
    found = depth_from_focus(stack_of(height, POSITIONS, seed=5, texture=texture), POSITIONS)
    error, stated = inner(found.depth - height), inner(found.uncertainty)
    known = np.isfinite(error)
    assert known.mean() > 0.999
    ratio = deciles(error[known], stated[known])
    assert ratio.min() > (0.5 if name in ("tilt", "dome of gravel") else 0.25)
    assert ratio.max() < (2.6 if name == "cone" else 2)


def test_depths_between_frames_are_not_biased_towards_the_frames():
    """On a gentle slope depths lean to the nearest frame: 0.035 at most where peaks are narrow."""
    height = 5 + tilted_plane(SHAPE, 3 / 144, 0.0)
    stack = stack_of(height, POSITIONS, rate=1.4, seed=4)
    error = inner(depth_from_focus(stack, POSITIONS).depth - height)
    assert abs(2 * np.mean(error * np.sin(2 * np.pi * inner(height)))) < 0.012


@pytest.mark.parametrize("drift", [False, True])
def test_errors_from_flicker_are_stated(drift):
    """Of 15 % a frame, or of a factor of two over the stack; else ratios of 4 to 8."""
    flicker = 1 + np.random.default_rng(3).uniform(-0.15, 0.15, 15)
    gains = 2 ** (POSITIONS / 14) if drift else flicker
    frames = 0.6 * gains[:, None, None] * stack_of(TILT, POSITIONS, seed=3)
    with pytest.warns(UserWarning, match="change in light .*register"):
        found = depth_from_focus(np.clip(frames, 0, 255).astype(np.uint8), POSITIONS)
    error = rms(inner(found.depth - TILT))
    assert error > 0.05
    assert 0.5 < error / rms(inner(found.uncertainty)) < 2
