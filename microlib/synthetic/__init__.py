"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""

from microlib.synthetic.stacks import focal_frames, focal_stack, thesis_stack
from microlib.synthetic.surfaces import (
    cone,
    parabolic_cylinder,
    paraboloid,
    quadric_patch,
    sphere_on_plane,
    step,
    tilted_plane,
)
from microlib.synthetic.textures import mixed_texture, patchy_texture

__all__ = [
    "cone",
    "focal_frames",
    "focal_stack",
    "mixed_texture",
    "parabolic_cylinder",
    "paraboloid",
    "patchy_texture",
    "quadric_patch",
    "sphere_on_plane",
    "step",
    "thesis_stack",
    "tilted_plane",
]
