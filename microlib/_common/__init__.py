"""What several subjects share: argument checks, types, covariance, files, a pipeline."""

from microlib._common._checks import (
    as_array,
    as_image,
    between,
    one_of,
    positive,
    same_length,
    whole,
)
from microlib._common._covariance import inverse_normal
from microlib._common._files import replace_file
from microlib._common._frames import Frames, is_in_memory
from microlib._common._pipeline import pipeline
from microlib._common._types import Array, Image

__all__ = [
    "Array",
    "Frames",
    "Image",
    "as_array",
    "as_image",
    "between",
    "inverse_normal",
    "is_in_memory",
    "one_of",
    "pipeline",
    "positive",
    "replace_file",
    "same_length",
    "whole",
]
