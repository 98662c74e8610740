"""Results with a short `repr` and a flat row."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, ClassVar

import numpy as np

#: What the numbers of a short field are called along its last axis, where not by their place.
_PARTS = {
    **dict.fromkeys(("bottom", "center", "drift", "rim", "tip", "pixel_size"), ("x", "y")),
    **dict.fromkeys(("interval", "domain"), ("low", "high")),
    **dict.fromkeys(("region", "frame"), ("x", "y", "width", "height")),
    **dict.fromkeys(("image_size", "size"), ("width", "height")),
    "rim_curvatures": ("left", "right"),
    "um_per_pixel": ("estimate", "low", "high"),
}


class Result:
    """Give a frozen dataclass a short `repr`."""

    def __repr__(self) -> str:
        shown = (f"{f.name}={_short(getattr(self, f.name))}" for f in fields(self))  # type: ignore[arg-type]
        text = f"{type(self).__name__}({', '.join(shown)})"
        return textwrap.fill(text, 100, subsequent_indent="    ", max_lines=10)


def _short(value: Any) -> str:
    """Show a value, of an array or a sequence at most six numbers."""
    if getattr(value, "shape", ()):
        if not isinstance(value, np.ndarray) or value.size > 6:
            return f"{getattr(value, 'dtype', 'table')} of shape {value.shape}"
        return np.array2string(value, precision=4, separator=", ").replace("\n", "")
    if isinstance(value, (float, np.floating)):
        return f"{value:.5g}"
    if isinstance(value, (tuple, list)):
        return f"({', '.join(map(_short, value[:6]))}{', …' if len(value) > 6 else ''})"
    return type(value).__name__ if is_dataclass(value) else f"{value!r:.60}"


class Tidy(Result):
    """Give a frozen dataclass a flat row and a short `repr`."""

    #: Fields that `to_dict` leaves out: those with a number a sample or a pixel, and objects.
    _large: ClassVar[tuple[str, ...]] = ()
    #: Fields of several axes, each with what its numbers are called along each of them.
    _parts: ClassVar[tuple[tuple[Any, ...], ...]] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            Numbers, texts, truth values and None by name, in the units of the fields. What has
            several numbers gets a name for each, such as ``center_x`` and ``covariance_x_y``; what
            is not finite is None. Fields with a number a sample or a pixel are left out.
        """
        names = [f.name for f in fields(self) if f.name not in self._large]  # type: ignore[arg-type]
        own = {name: getattr(self, name) for name in names}
        return flat_row(own, {name: tuple(axes) for name, *axes in self._parts})


def flat_row(
    values: Mapping[str, Any],
    parts: Mapping[str, tuple[tuple[str, ...], ...]] | None = None,
    prefix: str = "",
) -> dict[str, Any]:
    """Return values as `Tidy.to_dict` does."""
    row: dict[str, Any] = {}
    for name, value in values.items():
        # The radius of a dimple is not the dimple's dimple's.
        known = name if prefix and name.startswith(prefix) else prefix + name
        if isinstance(value, Tidy):
            value = value.to_dict()
        if isinstance(value, Mapping):
            row |= flat_row(value, prefix=f"{known}_")
        elif isinstance(value, (tuple, list)) and all(isinstance(v, str) for v in value):
            row[known] = ", ".join(value)
        elif isinstance(value, (tuple, list, np.ndarray)):
            array = np.asarray(value)
            axes = (parts or {}).get(name) or (_PARTS.get(name, ()),)
            names = _names(known, array.shape, axes)
            row |= zip(names, map(_plain, array.flat), strict=True)
        else:
            row[known] = _plain(value)
    return row


def _names(name: str, shape: tuple[int, ...], axes: Sequence[Sequence[str]]) -> list[str]:
    """Return a name for each number of an array, from the names of its last axes."""
    axes = [*[()] * (len(shape) - len(axes)), *axes]
    return [
        "_".join([name, *(p[i] if i < len(p) else str(i) for p, i in zip(axes, at, strict=False))])
        for at in np.ndindex(shape)
    ]


def _plain(value: Any) -> bool | int | float | str | None:
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
