"""Relief from the agreement of two directions, and the errors that are stated with it."""

from contextlib import nullcontext

import numpy as np
import pytest
from skimage import data

from microlib import synthetic
from microlib.focus import depth_from_focus
from tests.scenes import straight_step, tilted_plane

SHAPE = (144, 144)
POSITIONS = np.arange(15.0)


def stack_of(height, *, seed=0, noise=2.0, texture=None):
    """A stack with steps of 1 µm that add 1 px of blur each."""
    rng = np.random.default_rng(seed)
    if texture is None:
        texture = synthetic.mixed_texture(height.shape, rng)
    return synthetic.focal_stack(texture, height, POSITIONS, blur_rate=1.0, noise=noise, rng=rng)


def waves(period: float, amplitude: float, shape=SHAPE):
    y, x = np.indices(shape)
    return amplitude * np.sin(2 * np.pi * x / period) * np.sin(2 * np.pi * y / period)


def inner(image, border=10):
    return image[border:-border, border:-border]


def rms(error):
    return float(np.sqrt(np.mean(inner(error) ** 2)))


def gain(found, relief):
    found, relief = inner(found), inner(relief)
    return np.sum((found - found.mean()) * relief) / np.sum(relief**2)


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
    stack = stack_of(height, seed=11)
    found = depth_from_focus(stack, POSITIONS)
    plain = min(
        rms(depth_from_focus(stack, POSITIONS, measure="sml", window=w).depth - height)
        for w in (5, 9)
    )
    assert rms(found.depth - height) < 0.9 * plain
    assert gain(found.depth, waves(period, amplitude)) > least


def surfaces():
    texture = np.asarray(data.gravel()[:144, :144], float)
    yield "tilt", 4 + tilted_plane(SHAPE, 5 / 144, 2 / 144), None
    yield "dome of gravel", 4 + synthetic.paraboloid(SHAPE, 5.0), texture
    yield "relief", 7.2 + waves(12, 1.0), None
    yield "step", 4.2 + straight_step(SHAPE, 6.0), None
    yield "cone", 3.3 + synthetic.cone(SHAPE, 6.0, 60.0), None


@pytest.mark.parametrize(
    ("name", "height", "texture"), list(surfaces()), ids=lambda v: v if isinstance(v, str) else ""
)
def test_errors_are_as_stated_in_every_decile(name, height, texture):
    """No tenth more than twice as wrong as it says; beside relief more is said.

    The tip and the foot of the cone were six times as wrong before bends were looked at, and a step
    was stated twice as wrong as it is before it was looked for at full size.
    """
    found = depth_from_focus(stack_of(height, seed=5, texture=texture), POSITIONS)
    ratio = deciles(inner(found.depth - height), inner(found.uncertainty))
    assert ratio.min() > (0.5 if name in ("tilt", "dome of gravel") else 0.25)
    assert ratio.max() < (2.6 if name == "cone" else 2)


def test_frames_do_not_pull_the_depths_between_them():
    """On a gentle slope depths lean to the nearest frame: 0.035 at most where peaks are narrow."""
    height = 5 + tilted_plane(SHAPE, 3 / 144, 0.0)
    rng = np.random.default_rng(4)
    texture = synthetic.mixed_texture(SHAPE, rng)
    stack = synthetic.focal_stack(texture, height, POSITIONS, blur_rate=1.4, noise=2.0, rng=rng)
    error = inner(depth_from_focus(stack, POSITIONS).depth - height)
    assert abs(2 * np.mean(error * np.sin(2 * np.pi * inner(height)))) < 0.012


@pytest.mark.parametrize("drift", [False, True])
def test_errors_from_flicker_are_stated(drift):
    """Of 15 % a frame, or of a factor of two over the stack; else ratios of 4 to 8."""
    height = 4 + tilted_plane(SHAPE, 5 / 144, 2 / 144)
    gains = 2 ** (POSITIONS / 14)
    if not drift:
        gains = 1 + np.random.default_rng(3).uniform(-0.15, 0.15, 15)
    shown = 0.6 * gains[:, None, None] * stack_of(height, seed=3)
    with nullcontext() if drift else pytest.warns(UserWarning, match="change in light .*register"):
        found = depth_from_focus(np.clip(shown, 0, 255).astype(np.uint8), POSITIONS)
    error = rms(found.depth - height)
    assert error > 0.05
    assert 0.5 < error / np.sqrt(np.mean(inner(found.uncertainty) ** 2)) < 2
