"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""

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
    "GripperScene",
    "WarpedPair",
    "camera_frame",
    "gripper_scene",
    "speckle_texture",
    "texture_sequence",
    "warped_pair",
]
