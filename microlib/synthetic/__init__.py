"""Scenes with known truth: what the algorithms are tested on. Nothing here imports an algorithm."""

from microlib.synthetic.cells import CellImage, cell_image
from microlib.synthetic.embryo import (
    SONY_PIXEL_SIZE,
    Embryo,
    EmbryoImage,
    embryo_image,
    embryo_sequence,
)

__all__ = [
    "SONY_PIXEL_SIZE",
    "CellImage",
    "Embryo",
    "EmbryoImage",
    "cell_image",
    "embryo_image",
    "embryo_sequence",
]
