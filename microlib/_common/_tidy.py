"""Results as flat rows: for JSON, and for tables with a row per file or per sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from microlib._common._kept import Kept

if TYPE_CHECKING:
    import pandas as pd

#: What the numbers of a short field are called, where not by their place.
_PARTS = {
    "interval": ("low", "high"),
    "domain": ("low", "high"),
    "rim_curvatures": ("left", "right"),
    "grid": ("i", "j"),
    "image_size": ("width", "height"),
    "region": ("x", "y", "width", "height"),
    "frame": ("x", "y", "width", "height"),
    "um_per_pixel": ("estimate", "low", "high"),
    **dict.fromkeys(("bottom", "center", "corners", "drift", "rim", "tip"), ("x", "y")),
    **dict.fromkeys(("feature", "measured", "points", "position"), ("x", "y")),
    **dict.fromkeys(("positions", "reference"), ("x", "y")),
    **dict.fromkeys(("command", "residuals", "plane_residuals", "pixel_size"), ("x", "y")),
}


class Tidy(Kept):
    """Give a frozen dataclass a flat row and a table, a short `repr`, and a file."""

    #: Fields with one entry a sample: the rows of `to_frame`, left out of `to_dict`.
    _samples: ClassVar[tuple[str, ...]] = ()
    #: Fields with a number a pixel, objects and whole tables: in neither.
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
        own = {
            f.name: getattr(self, f.name)
            for f in fields(self)  # type: ignore[arg-type]
            if f.name not in (*self._samples, *self._large)
        }
        return flat_row(own, {name: tuple(axes) for name, *axes in self._parts})

    def to_frame(self) -> pd.DataFrame:
        """Return the result as a table.

        Returns
        -------
        pandas.DataFrame
            One row a sample, a point for example, and a column for each number that is known of it;
            of a result without samples the one row of `to_dict`.
        """
        import pandas as pd  # here, for it takes a third of the time that importing a subject takes

        if not self._samples:
            return pd.DataFrame([self.to_dict()])
        columns: dict[str, Any] = {}
        for name in self._samples:
            values = np.asarray(getattr(self, name))
            if columns and len(values) != len(next(iter(columns.values()))):
                values = np.moveaxis(values, -1, 0)
            flat = values.reshape(len(values), -1)
            names = _names(name, values.shape[1:], _PARTS.get(name, ()))
            columns |= dict(zip(names, flat.T, strict=True))
        return pd.DataFrame(columns)


def flat_row(
    values: Mapping[str, Any], parts: Mapping[str, tuple[tuple[str, ...], ...]] | None = None
) -> dict[str, Any]:
    """Return values as `Tidy.to_dict` does."""
    return dict(_flat("", values, parts or {}))


def _flat(
    prefix: str, values: Mapping[str, Any], parts: Mapping[str, tuple[tuple[str, ...], ...]]
) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        # The radius of a dimple is not the dimple's dimple's.
        known = name if prefix and name.startswith(prefix) else prefix + name
        if isinstance(value, Tidy):
            yield from _flat(f"{known}_", value.to_dict(), {})
        elif isinstance(value, Mapping):
            yield from _flat(f"{known}_", value, {})
        elif isinstance(value, (tuple, list)) and all(isinstance(v, str) for v in value):
            yield known, ", ".join(value)
        elif isinstance(value, (tuple, list, np.ndarray)):
            array = np.asarray(value)
            texts = (_plain(number) for number in array.ravel())
            named = _PARTS.get(known) or _PARTS.get(name, ())
            yield from zip(_names(known, array.shape, named, parts.get(name)), texts, strict=True)
        else:
            yield known, _plain(value)


def _names(
    name: str,
    shape: tuple[int, ...],
    last: tuple[str, ...],
    axes: tuple[tuple[str, ...], ...] | None = None,
) -> list[str]:
    """Return a name for each number of an array: by the parts of each axis, or of the last one."""
    named = axes or ((),) * (len(shape) - 1) + (last,)
    return [
        "_".join([name, *(p[i] if i < len(p) else str(i) for p, i in zip(named, at, strict=False))])
        for at in np.ndindex(shape)
    ]


def _plain(value: Any) -> bool | int | float | str | None:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value)
