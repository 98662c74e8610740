"""Argument checks, array types, least squares, image noise, files and results for all packages."""

from microlib._common._checks import (
    ArgumentError,
    as_array,
    as_map,
    generator,
    items,
    one_of,
    positive,
    reject_masks,
    same_length,
    scalar,
    whole,
)
from microlib._common._files import SOFTWARE, home_path, replace_file
from microlib._common._images import as_image, as_region, image_shape, luminance
from microlib._common._least_squares import (
    MAD_TO_STD,
    TUKEY_LIMIT,
    NormalEquations,
    gauss_newton,
    inverse_normal,
    inverse_symmetric,
    robust_std,
    tukey_weights,
)
from microlib._common._noise import image_noise, saturation_level
from microlib._common._quantities import MEASURED, MICROMETERS, measured, poisson
from microlib._common._results import Result, Tidy, flat_row
from microlib._common._types import Array, Frames, Image, Region
