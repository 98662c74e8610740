"""Bands of rows, in which a map is computed with less memory or by several threads."""

from __future__ import annotations

from typing import NamedTuple


class Band(NamedTuple):
    """Some rows of a map, and the rows beside them that influence their values."""

    rows: slice  # of the map
    padded: slice  # of the map, with the border on both sides
    own: slice  # the rows of the band among the padded ones


def bands(count: int, height: int, border: int) -> list[Band]:
    """Return the bands of a map of `count` rows, with a border of fewer rows at its edges."""
    parts = []
    for top in range(0, count, height):
        stop, start = min(top + height, count), max(top - border, 0)
        padded = slice(start, min(stop + border, count))
        parts.append(Band(slice(top, stop), padded, slice(top - start, stop - start)))
    return parts
