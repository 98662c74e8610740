"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""

from microlib.synthetic.cells import CellImage, cell_image
from microlib.synthetic.embryo import (
    SONY_PIXEL_SIZE,
    Embryo,
    EmbryoImage,
    embryo_image,
    embryo_sequence,
)
from microlib.synthetic.gripper import (
    GripperScene,
    WarpedPair,
    camera_frame,
    gripper_scene,
    texture_sequence,
    warped_pair,
)
from microlib.synthetic.stacks import (
    focal_frames,
    focal_stack,
    thesis_stack,
)
from microlib.synthetic.surfaces import (
    cone,
    parabolic_cylinder,
    paraboloid,
    quadric_patch,
    sphere_on_plane,
    step,
    tilted_plane,
)
from microlib.synthetic.textures import (
    mixed_texture,
    patchy_texture,
)

__all__ = [
    "SONY_PIXEL_SIZE",
    "CellImage",
    "Embryo",
    "EmbryoImage",
    "GripperScene",
    "WarpedPair",
    "camera_frame",
    "cell_image",
    "cone",
    "embryo_image",
    "embryo_sequence",
    "focal_frames",
    "focal_stack",
    "gripper_scene",
    "mixed_texture",
    "parabolic_cylinder",
    "paraboloid",
    "patchy_texture",
    "quadric_patch",
    "sphere_on_plane",
    "step",
    "texture_sequence",
    "thesis_stack",
    "tilted_plane",
    "warped_pair",
]
