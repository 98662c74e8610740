"""Results as flat rows: for JSON, and for tables with a row per file or per sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

#: What the numbers of a short field are called, where not by their place.
_PARTS = {
    "interval": ("low", "high"),
    "domain": ("low", "high"),
    "rim_curvatures": ("left", "right"),
    "image_size": ("width", "height"),
    "um_per_pixel": ("estimate", "low", "high"),
    **dict.fromkeys(("bottom", "center", "corners", "drift", "rim", "tip"), ("x", "y")),
    **dict.fromkeys(("feature", "measured", "points", "position", "reference"), ("x", "y")),
    **dict.fromkeys(("command", "residuals", "plane_residuals", "pixel_size"), ("x", "y")),
}


class Tidy:
    """Give a frozen dataclass a flat row and a table."""

    #: Fields with one entry a sample: the rows of `to_frame`, left out of `to_dict`.
    _samples: ClassVar[tuple[str, ...]] = ()
    #: Fields with a number a pixel, objects and whole tables: in neither.
    _large: ClassVar[tuple[str, ...]] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            Numbers, texts, truth values and None by name, in the units of the fields. What has
            several numbers gets a name for each, such as ``center_x`` and ``covariance_0_1``; what
            is not finite is None. Fields with a number a sample or a pixel are left out.
        """
        own = {
            f.name: getattr(self, f.name)
            for f in fields(self)  # type: ignore[arg-type]
            if f.name not in (*self._samples, *self._large)
        }
        return flat_row(own)

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
            columns |= dict(zip(_names(name, values.shape[1:]), flat.T, strict=True))
        return pd.DataFrame(columns)


def flat_row(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values as `Tidy.to_dict` does."""
    return dict(_flat("", values))


def _flat(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        # The radius of a dimple is not the dimple's dimple's.
        known = name if prefix and name.startswith(prefix) else prefix + name
        if isinstance(value, Tidy):
            yield from _flat(f"{known}_", value.to_dict())
        elif isinstance(value, Mapping):
            yield from _flat(f"{known}_", value)
        elif isinstance(value, (tuple, list)) and all(isinstance(v, str) for v in value):
            yield known, ", ".join(value)
        elif isinstance(value, (tuple, list, np.ndarray)):
            array = np.asarray(value)
            texts = (_plain(number) for number in array.ravel())
            yield from zip(_names(known, array.shape, name), texts, strict=True)
        else:
            yield known, _plain(value)


def _names(name: str, shape: tuple[int, ...], known: str | None = None) -> list[str]:
    parts = _PARTS.get(known or name, ())
    ends = [
        [
            parts[i] if k == len(index) - 1 and i < len(parts) else str(i)
            for k, i in enumerate(index)
        ]
        for index in np.ndindex(shape)
    ]
    return ["_".join([name, *end]) for end in ends]


def _plain(value: Any) -> bool | int | float | str | None:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value)
