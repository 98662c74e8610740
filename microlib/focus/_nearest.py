"""The nearest pixel at which something is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["nearest_known"]


def nearest_known(unknown: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of the nearest known pixel of each; some must be known.

    Examples
    --------
    >>> nearest_known(np.array([[False, True, True, True, False]]))[1].tolist()
    [[0, 0, 0, 4, 4]]
    """
    # A third of the time of importing the package, for what many depths have no need of.
    from scipy import ndimage

    rows, cols = ndimage.distance_transform_edt(
        unknown, return_distances=False, return_indices=True
    )
    return rows, cols
