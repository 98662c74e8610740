"""Results with a short `repr` and a flat row."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, ClassVar

import numpy as np

#: Labels of the numbers of a field along its last axis; others are labeled by their index.
_PARTS = {
    **dict.fromkeys(("bottom", "center", "drift", "rim", "tip"), ("x", "y")),
    **dict.fromkeys(("pixel_pitch", "principal_offset"), ("x", "y")),
    **dict.fromkeys(("image_size", "size"), ("width", "height")),
    "domain": ("low", "high"),
    "rim_curvatures": ("left", "right"),
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


class FlatResult(Result):
    """Give a frozen dataclass a flat row and a short `repr`."""

    #: Fields that `to_dict` leaves out: arrays with one number per sample or pixel, and objects.
    _large: ClassVar[tuple[str, ...]] = ()
    #: Fields of several axes, each with the labels of its numbers along each axis.
    _parts: ClassVar[tuple[tuple[Any, ...], ...]] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            Numbers, texts, Booleans and None by name, in the units of the fields. A field of
            several numbers has one entry for each, such as ``center_x`` and ``covariance_x_y``. A
            number that is not finite is None. Arrays with one number per sample or pixel are left
            out.
        """
        names = [f.name for f in fields(self) if f.name not in self._large]  # type: ignore[arg-type]
        own = {name: getattr(self, name) for name in names}
        return flat_row(own, {name: tuple(axes) for name, *axes in self._parts})


def flat_row(
    values: Mapping[str, Any],
    parts: Mapping[str, tuple[tuple[str, ...], ...]] | None = None,
    prefix: str = "",
) -> dict[str, Any]:
    """Return values as `FlatResult.to_dict` does."""
    row: dict[str, Any] = {}
    for name, value in values.items():
        # The field rim_radius of a dimple is not named dimple_rim_radius.
        known = name if prefix and name.startswith(prefix) else prefix + name
        if isinstance(value, FlatResult):
            value = value.to_dict()
        if isinstance(value, Mapping):
            row |= flat_row(value, prefix=f"{known}_")
        elif isinstance(value, (tuple, list)) and all(isinstance(v, str) for v in value):
            row[known] = ", ".join(value)
        elif isinstance(value, (tuple, list, np.ndarray)):
            array = np.asarray(value)
            axes = (parts or {}).get(name) or (_PARTS.get(name, ()),)
            axes = (*[()] * (array.ndim - len(axes)), *axes)
            for index, number in np.ndenumerate(array):
                labels = [a[i] if i < len(a) else str(i) for a, i in zip(axes, index, strict=False)]
                row["_".join([known, *labels])] = _plain(number)
        else:
            row[known] = _plain(value)
    return row


def _plain(value: Any) -> bool | int | float | str | None:
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
