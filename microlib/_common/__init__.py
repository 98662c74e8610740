"""What several subjects share: argument checks, types, covariance, files, threads, devices."""

from microlib._common._checks import (
    LARGEST,
    LARGEST_GREY,
    LEAST,
    are_small,
    as_array,
    as_image,
    between,
    check_callable,
    flag,
    generator,
    image_shape,
    items,
    of_kind,
    one_of,
    positive,
    refuse_masks,
    same_length,
    scalar,
    whole,
)
from microlib._common._covariance import OPEN, inverse_normal
from microlib._common._devices import Mover, Workstation, check_devices
from microlib._common._files import replace_file
from microlib._common._frames import Frames, is_in_memory
from microlib._common._guard import POLL, DeviceError, Ending, EndRun, Guard, RunInterrupt
from microlib._common._kept import Kept, load
from microlib._common._pipeline import pipeline
from microlib._common._processes import end_with_starter
from microlib._common._tidy import Tidy, flat_row
from microlib._common._types import Array, Image

__all__ = [
    "LARGEST",
    "LARGEST_GREY",
    "LEAST",
    "OPEN",
    "POLL",
    "Array",
    "DeviceError",
    "EndRun",
    "Ending",
    "Frames",
    "Guard",
    "Image",
    "Kept",
    "Mover",
    "RunInterrupt",
    "Tidy",
    "Workstation",
    "are_small",
    "as_array",
    "as_image",
    "between",
    "check_callable",
    "check_devices",
    "end_with_starter",
    "flag",
    "flat_row",
    "generator",
    "image_shape",
    "inverse_normal",
    "is_in_memory",
    "items",
    "load",
    "of_kind",
    "one_of",
    "pipeline",
    "positive",
    "refuse_masks",
    "replace_file",
    "same_length",
    "scalar",
    "whole",
]
