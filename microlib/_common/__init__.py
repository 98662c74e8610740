"""Argument checks, array types, covariances, files and results for all packages."""

from microlib._common._checks import (
    MEASURED,
    MICROMETERS,
    ArgumentError,
    as_array,
    as_image,
    as_map,
    as_region,
    find_scales,
    generator,
    image_shape,
    items,
    luminance,
    measured,
    one_of,
    poisson,
    positive,
    reject_masks,
    same_length,
    scalar,
    whole,
)
from microlib._common._covariance import inverse_normal
from microlib._common._files import SOFTWARE, home_path, replace_file
from microlib._common._results import Result, Tidy, flat_row
from microlib._common._types import Array, Frames, Image, Region
