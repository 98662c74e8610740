"""What a focal stack may come as."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any, Protocol

from numpy.typing import NDArray

__all__ = ["Frames"]


class LazyArray(Protocol):
    """An array whose values are loaded as it is indexed, such as one of zarr or dask."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, key: int, /) -> Any: ...


#: What a stack may come as: an array, a file, a folder or pattern of files, or an iterable of
#: images or image files.
Frames = NDArray | LazyArray | str | PathLike[str] | Iterable[NDArray | str | PathLike[str]]
