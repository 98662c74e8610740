"""The two array types of the signatures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Image"]

#: Numbers that are computed with.
Array = NDArray[np.floating]

#: Grey levels of any type.
Image = NDArray
