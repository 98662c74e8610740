"""Argument checks, array types, least squares, image noise, files and results for all packages."""

from microlib._common._checks import (
    ArgumentError,
    as_array,
    as_choice,
    as_generator,
    as_instance,
    as_integer,
    as_map,
    as_positive,
    as_scalar,
    as_symmetric,
    as_tuple,
    check_same_length,
    positive_scalars,
    reject_masks,
)
from microlib._common._files import SOFTWARE, home_path, replace_file
from microlib._common._images import as_image, as_image_shape, as_picture, as_region, luminance
from microlib._common._least_squares import (
    TUKEY_LIMIT,
    NormalEquations,
    gauss_newton,
    inverse_normal,
    inverse_symmetric,
    robust_std,
    tukey_weights,
)
from microlib._common._noise import image_noise, saturation_level
from microlib._common._quantities import (
    MICROMETERS,
    PHYSICAL_RANGES,
    PREFIXES,
    as_physical,
    as_poisson_ratio,
)
from microlib._common._results import FlatResult, Result, flat_row
from microlib._common._types import Array, Frames, Image, Region
