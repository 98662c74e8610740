"""Rendered scenes with ground truth, independent of the algorithms that are tested on them."""

import microlib._common._opencv  # noqa: F401 – says how to install it
from microlib.synthetic._embryo import Embryo, EmbryoImage, embryo_image
from microlib.synthetic._gripper import GripperScene, gripper_scene
from microlib.synthetic._patterns import ImagingConditions, render_circles, render_squares
from microlib.synthetic._stacks import focal_stack
from microlib.synthetic._surfaces import (
    cone,
    parabolic_cylinder,
    paraboloid,
    sphere_on_plane,
)
from microlib.synthetic._textures import mixed_texture

__all__ = [
    "Embryo",
    "EmbryoImage",
    "GripperScene",
    "ImagingConditions",
    "cone",
    "embryo_image",
    "focal_stack",
    "gripper_scene",
    "mixed_texture",
    "parabolic_cylinder",
    "paraboloid",
    "render_circles",
    "render_squares",
    "sphere_on_plane",
]
