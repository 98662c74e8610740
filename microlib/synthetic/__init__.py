"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""

from microlib.synthetic.embryo import (
    SONY_PIXEL_SIZE,
    Embryo,
    EmbryoImage,
    embryo_image,
    embryo_sequence,
)

__all__ = ["SONY_PIXEL_SIZE", "Embryo", "EmbryoImage", "embryo_image", "embryo_sequence"]
