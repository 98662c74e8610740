"""Results that show themselves in a few lines and are kept in one file."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, Self
from zipfile import BadZipFile

import numpy as np

from microlib._common._files import replace_file

#: Numbers of an array that are shown, and lines of a result.
_SHOWN, _LINES = 6, 10


class Kept:
    """Give a frozen dataclass a short `repr`, `save` and `load`."""

    def __repr__(self) -> str:
        shown = (f"{f.name}={_short(getattr(self, f.name))}" for f in fields(self))  # type: ignore[arg-type]
        return textwrap.fill(
            f"{type(self).__name__}({', '.join(shown)})",
            100,
            subsequent_indent="    ",
            max_lines=_LINES,
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Keep the result in one file.

        Parameters
        ----------
        path : path-like
            File to write, a NumPy archive (``.npz``) of the arrays with all else as JSON; an old
            one is replaced only once the new one is whole.

        Raises
        ------
        ValueError
            If the folder does not exist, or the result holds an object that is no data.
        """
        arrays: dict[str, Any] = {}
        text = json.dumps(_packed(self, arrays))

        def write(file: Path) -> None:
            with file.open("wb") as stream:
                np.savez_compressed(stream, header=np.array(text), **arrays)

        replace_file(path, write)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read what `save` has kept.

        Raises
        ------
        ValueError
            If the file holds no such result.
        """
        result = load(path)
        if not isinstance(result, cls):
            raise ValueError(f"path must hold a {cls.__name__}, got a {type(result).__name__}")
        return result


def load(path: str | PathLike[str]) -> Any:
    """Read a result of any kind that its `save` has kept.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    object
        The result, with the class, the numbers and the types that it had.

    Raises
    ------
    ValueError
        If there is no such file, or it holds no result of this library.

    Examples
    --------
    >>> import tempfile
    >>> import microlib
    >>> from microlib.servoing import path_metrics
    >>> found = path_metrics([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.1], [1.0, 0.1]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found.save(f"{folder}/found.npz")
    ...     microlib.load(f"{folder}/found.npz") == found
    True
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return _unpacked(json.loads(str(archive["header"])), lambda key: archive[key])
    except (
        OSError,
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        EOFError,
        BadZipFile,
    ) as error:
        raise ValueError(f"path must name a saved result, got {path}: {error}") from None


def _short(value: Any) -> str:
    if hasattr(value, "shape") and value.shape:
        if not isinstance(value, np.ndarray) or value.size > _SHOWN:
            return f"{value.dtype if hasattr(value, 'dtype') else 'table'} of shape {value.shape}"
        return np.array2string(value, precision=4, separator=", ").replace("\n", "")
    if isinstance(value, (float, np.floating)):
        return f"{value:.5g}"
    if isinstance(value, (tuple, list)):
        return f"({', '.join(map(_short, value[:_SHOWN]))}{', …' if len(value) > _SHOWN else ''})"
    return type(value).__name__ if is_dataclass(value) else f"{value!r:.60}"


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    """Return a value as JSON can hold it, arrays by the key under which they are added."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, BaseException):
        return {"error": f"{type(value).__name__}: {value}"}
    if type(value).__name__ == "DataFrame":
        columns = {name: value[name].to_numpy() for name in value.columns}
        return {"table": _packed(columns, arrays)}
    if isinstance(value, dict):
        return {"dict": {str(key): _packed(part, arrays) for key, part in value.items()}}
    if isinstance(value, (tuple, list)):
        return {type(value).__name__: [_packed(part, arrays) for part in value]}
    if is_dataclass(value):
        room = ".".join(type(value).__module__.split(".")[:2])
        own = {f.name: _packed(getattr(value, f.name), arrays) for f in fields(value)}
        return {"result": [room, type(value).__name__], "fields": own}
    array = np.asarray(value)  # also of dask, which is computed here
    if array.dtype == object and all(isinstance(part, str) for part in array.ravel()):
        array = array.astype(str)
    if array.dtype == object:
        raise ValueError(f"a result with a {type(value).__name__} cannot be kept")
    key = f"array_{len(arrays)}"
    arrays[key] = array
    return {"array": key}


def _unpacked(value: Any, array: Callable[[str], Any]) -> Any:
    if not isinstance(value, dict):
        return value
    ((kind, content), *rest) = value.items()
    if kind == "array":
        return array(content)
    if kind == "error":
        return RuntimeError(content)
    if kind == "dict":
        return {key: _unpacked(part, array) for key, part in content.items()}
    if kind in ("tuple", "list"):
        parts = [_unpacked(part, array) for part in content]
        return tuple(parts) if kind == "tuple" else parts
    if kind == "table":
        import pandas as pd  # here, as it takes long to import

        return pd.DataFrame(_unpacked(content, array))
    own = {name: _unpacked(part, array) for name, part in rest[0][1].items()}
    return _class(*content)(**own)


def _class(room: str, name: str) -> type:
    """Return the result class of that name in a room: no other object is made from a file."""
    if not room.startswith("microlib."):
        raise ValueError(f"{room} is no subject of this library")
    import_module(room)
    classes = [Kept]
    for known in classes:  # which grows
        classes += known.__subclasses__()
        if known.__name__ == name and known.__module__.startswith(room):
            return known
    raise ValueError(f"{room} has no result {name}")
