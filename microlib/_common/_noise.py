"""Noise and saturation of an image, estimated from its grey levels."""

from __future__ import annotations

import numpy as np

from microlib._common._types import Image

#: Second differences along both axes; white noise keeps its variance, and a plane, or an edge along
#: an axis, vanishes (Immerkær 1996).
_SECOND_DIFFERENCE = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6

#: Root mean square of the flattest tenth of tiles of 8 px, of white noise: simulated on 100 images
#: of 180×180 px, 0.792 ± 0.001.
_QUANTILE_OF_WHITE = 0.792


def image_noise(image: Image) -> float:
    """Return the standard deviation of the noise of an image, from its smoothest tiles.

    It is zero for an image of less than 16 px on a side, or with saturated pixels in every tile.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib._common import image_noise
    >>> grey = 100 + np.random.default_rng(0).normal(0, 2, (120, 120))
    >>> abs(image_noise(grey.astype(np.float32)) - 2) < 0.1
    True
    """
    import cv2  # here, as formulas do without it

    side = 8
    if min(image.shape) < 2 * side:
        return 0.0
    square = cv2.filter2D(image, -1, _SECOND_DIFFERENCE) ** 2
    saturated = (image >= saturation_level(image, 0.0)).astype(np.float32)
    means = [cv2.blur(one, (side, side))[6:-4:side, 6:-4:side] for one in (square, saturated)]
    tiles = means[0][means[1] == 0]
    if not tiles.size:
        return 0.0
    return float(np.sqrt(max(np.quantile(tiles, 1 / 10), 0.0))) / _QUANTILE_OF_WHITE


def saturation_level(image: Image, noise: float) -> float:
    """Return the grey value from which on pixels count as saturated; infinite if none is.

    The sensor's limit is a largest value of 25 px or more; less noise may have been cut off there.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib._common import saturation_level
    >>> saturation_level(np.minimum(np.arange(400.0), 255).reshape(20, 20), 2.0)
    250.0
    >>> saturation_level(np.arange(400.0).reshape(20, 20), 2.0)
    inf
    """
    largest = float(image.max())
    plateau = np.count_nonzero(image == largest) >= 25
    return largest - 2.5 * noise if plateau else np.inf
