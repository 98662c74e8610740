"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""

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
    speckle_texture,
    texture_sequence,
    warped_pair,
)

__all__ = [
    "SONY_PIXEL_SIZE",
    "Embryo",
    "EmbryoImage",
    "GripperScene",
    "WarpedPair",
    "camera_frame",
    "embryo_image",
    "embryo_sequence",
    "gripper_scene",
    "speckle_texture",
    "texture_sequence",
    "warped_pair",
]
