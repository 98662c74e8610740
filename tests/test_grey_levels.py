"""What an image shows does not depend on the unit of its grey levels.

A constant in grey levels breaks on the next camera: 8 bits, 16 bits, from 0 to 1, or a scale of its
own. Floats carry all of them; that whole numbers of 16 bits do, too, is seen where they are read.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from microlib import calibration, embryo, focus, synthetic, tracking
from tests import fuzz

POSITIONS = 2.5 * np.arange(11) - 3


@cache
def relief() -> np.ndarray:
    """A stack of a ridge on a slope, with noise and a part that is nearly saturated."""
    y, x = np.indices((56, 68))
    height = 8 * np.exp(-(((x - 30) / 9) ** 2) - ((y - 25) / 14) ** 2) + 0.12 * y + 2
    height[:, 50:] += 6
    texture = synthetic.mixed_texture((56, 68), 5)
    texture[40:50, 5:25] = 240
    return synthetic.focal_stack(texture, height, POSITIONS, blur_rate=0.6, noise=2.0, rng=6)


def texture_frame(k: int) -> np.ndarray:
    """Frames of a texture that moves, turns and gets brighter."""
    texture = synthetic.mixed_texture((70, 80), 40).astype(float)
    y, x = np.indices((70, 80), dtype=float) - [[[32 + 0.7 * k]], [[34 - 0.5 * k]]]
    cos, sin = np.cos(0.02 * k), np.sin(0.02 * k)
    place = [32 + cos * y - sin * x, 34 + sin * y + cos * x]
    moved = map_coordinates(texture, place, order=3, mode="nearest")
    noise = np.random.default_rng(50 + k).normal(0, 1.5, moved.shape)
    return np.clip(moved * (1 + 0.02 * k) + 3 * k + noise, 0, 255).astype(np.uint8)


def seen(image: np.ndarray, unit: float) -> np.ndarray:
    """Return what no function converts, read-only: one that draws in its input fails."""
    levels = (image * unit).astype(np.float32)
    levels.flags.writeable = False
    return levels


def followed(unit: float) -> np.ndarray:
    frames = [seen(texture_frame(k), unit) for k in range(4)]
    tracker = tracking.ESMTracker(frames[0], (18, 16, 30, 28))
    return np.array([tracker.track(frame).center for frame in frames[1:]])


def depth_by(measure: str) -> Callable[[float], np.ndarray]:
    return lambda unit: (
        focus.depth_from_focus(seen(relief(), unit), POSITIONS, measure=measure).depth
    )


#: What is read of an image whose levels are so many times those of 8 bits; px or µm.
READ: dict[str, Callable[[float], np.ndarray]] = {
    "circles": lambda unit: calibration.detect_circles(seen(fuzz.circles(), unit)).points,
    "squares": lambda unit: calibration.detect_squares(seen(fuzz.squares(), unit)).points,
    "ruler": lambda unit: np.array(
        calibration.detect_micrometer(seen(fuzz.lines(), unit)).um_per_pixel(10.0)
    ),
    "outline": lambda unit: embryo.extract_boundary(seen(fuzz.egg().image, unit)).points,
    "tracker": followed,
    "multiscale": depth_by("multiscale"),
    "sml": depth_by("sml"),
}


@pytest.mark.parametrize("unit", [1 / 255, 257.0, 1e6])
@pytest.mark.parametrize("name", READ)
def test_results_do_not_depend_on_unit_of_grey_levels(name: str, unit: float) -> None:
    expected, found = READ[name](1.0), READ[name](unit)
    # Single precision rounds the same levels otherwise; depths are fitted with weights of weights.
    np.testing.assert_allclose(found, expected, atol=3e-4 if found.ndim == 2 else 1e-5)


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e4, 2e7])
def test_template_of_very_low_or_high_contrast_is_tracked(unit: float) -> None:
    # OpenCV 4 rounds places to 1/32 px, so the last step depends on how the levels are rounded.
    within = 1e-4 if cv2.__version__ < "5" else 1e-5
    np.testing.assert_allclose(followed(unit), followed(1.0), atol=within)
