"""The types of the signatures."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Floating-point numbers.
Array = NDArray[np.floating]

#: Grey levels of any type.
Image = NDArray

#: Left column, top row, width and height of a part of an image, px.
Region = tuple[int, int, int, int]

#: A stack: an array, which may load its values when it is indexed, such as zarr's; a file, a folder
#: or a pattern of files; or an iterable of images or image files.
Frames = NDArray | str | PathLike[str] | Iterable[Any]
