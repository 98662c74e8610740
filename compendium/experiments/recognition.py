"""Chapter 6: parts measured through focus and named by their surface types."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compendium import part_shapes
from microlib.curvature import PART_KINDS, recognize_part
from microlib.curvature._recognition import PartRecognition
from microlib.focus import depth_from_focus
from microlib.synthetic import focal_stack, mixed_texture

__all__ = ["Recognized", "through_focus"]

#: Side of the maps, px on parts of 1 µm; frames over the relief; noise of the frames, grey levels.
_SIDE, _FRAMES, _NOISE = 128, 12, 2.0
#: Slope of the pyramid, and its half-width, px.
_PYRAMID = (0.8, 40)


@dataclass(frozen=True)
class Recognized:
    """What a part is, the depth from focus that shows it, µm, and the verdict."""

    name: str
    depth: NDArray
    found: PartRecognition


def through_focus(seed: int) -> list[Recognized]:
    """Render one part of each kind and a pyramid, measure them through focus, and name them."""
    shapes = {}
    for kind in PART_KINDS:
        rng = np.random.default_rng([seed, PART_KINDS.index(kind)])
        shapes[kind] = _SIDE * part_shapes.draw(kind, _SIDE, rng).height
    slope, half = _PYRAMID
    y, x = np.indices((_SIDE, _SIDE)) - _SIDE / 2
    shapes["pyramid"] = slope * np.maximum(half - np.maximum(abs(x + y), abs(x - y)) / 2**0.5, 0)
    return [_measured(name, z, seed) for name, z in shapes.items()]


def _measured(name: str, z: NDArray, seed: int) -> Recognized:
    rng = np.random.default_rng(seed)
    # A plane without relief is looked for in steps of a fair size all the same.
    step = max(np.ptp(z) / _FRAMES, 0.006 * _SIDE)
    positions = np.arange(z.min() - 3 * step, z.max() + 3 * step, step)
    texture = mixed_texture(z.shape, rng)
    frames = focal_stack(texture, z, positions, blur_rate=1 / step, noise=_NOISE, rng=rng)
    depth = depth_from_focus(frames, positions).depth
    return Recognized(name, depth, recognize_part(depth, 1.0))
