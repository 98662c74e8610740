"""What an image shows does not depend on the unit of its grey levels.

A constant in grey levels breaks on the next camera: 8 bits, 16 bits, from 0 to 1, or a scale of its
own. Floats carry all of them; that whole numbers of 16 bits do, too, is seen where they are read.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from microlib import automation, calibration, embryo, focus, tracking
from tests import fuzz
from tests.result_variants import POSITIONS, board, relief, texture_frame


def followed(unit: float) -> np.ndarray:
    frames = [texture_frame(k) * unit for k in range(4)]
    tracker = tracking.ESMTracker(frames[0], (18, 16, 30, 28))
    return np.array([tracker.track(frame).center for frame in frames[1:]])


def scanned(unit: float) -> np.ndarray:
    live = automation.LiveDepth()
    for frame, z in zip(relief(), POSITIONS, strict=True):
        live.push(frame * unit, z)
    return live.depth


def depth_by(measure: str) -> Callable[[float], np.ndarray]:
    return lambda unit: focus.depth_from_focus(relief() * unit, POSITIONS, measure=measure).depth


#: What is read of an image whose levels are so many times those of 8 bits; px or µm.
READ: dict[str, Callable[[float], np.ndarray]] = {
    "circles": lambda unit: calibration.detect_circles(board("dirty") * unit).points,
    "squares": lambda unit: calibration.detect_squares(board("squares") * unit).points,
    "ruler": lambda unit: np.array(
        calibration.detect_micrometer(fuzz.lines() * unit).um_per_pixel(10.0)
    ),
    "outline": lambda unit: embryo.extract_boundary(fuzz.egg().image * unit).points,
    "tracker": followed,
    "scan": scanned,
    "multiscale": depth_by("multiscale"),
    "tenengrad": depth_by("tenengrad"),
    "variance": depth_by("variance"),
}


@pytest.mark.parametrize("unit", [1 / 255, 257.0, 1e6])
@pytest.mark.parametrize("name", READ)
def test_the_unit_of_grey_levels_is_free(name: str, unit: float) -> None:
    expected, found = READ[name](1.0), READ[name](unit)
    # Single precision rounds the same levels otherwise; depths are fitted with weights of weights.
    np.testing.assert_allclose(found, expected, atol=3e-4 if found.ndim == 2 else 1e-5)


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e4, 2e7])
def test_a_template_of_hardly_any_or_vast_contrast_is_followed(unit: float) -> None:
    np.testing.assert_allclose(followed(unit), followed(1.0), atol=1e-5)
