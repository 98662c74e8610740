"""The natural order of image files by the numbers in their names."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from math import prod
from pathlib import Path
from statistics import mode

from natsort import natsorted, ns


def in_order(files: Sequence[Path]) -> list[Path]:
    """Return image files in the natural order of their names, such as 2 before 10.

    Raises
    ------
    ValueError
        If two files differ only in their format, if minus signs or decimals give another order, or
        if two numbers count independently, such as those of channels and positions.

    Warns
    -----
    UserWarning
        If the names differ in more than numbers, if none of several numbers differs in all names,
        or if the one number in which they differ is not evenly spaced, as where a file is missing.
    """
    stems = [file.stem for file in files]
    if twice := sorted(file.name for file in files if stems.count(file.stem) > 1):
        raise ValueError(f"frames must be one file each, got {twice[0]} and {twice[1]}")
    # If the names have different numbers of hyphens, a hyphen is a minus sign. Otherwise a hyphen
    # after a letter or digit is a separator.
    signed = len({stem.count("-") for stem in stems}) > 1
    separator = r"(?<!\d)\." if signed else r"(?<!\d)\.|(?<=[^\W_])-"
    texts = {file: re.sub(separator, "_", file.stem.casefold()) for file in files}
    keys = {file: re.sub(r"(?<=\d),(?=\d)", ".", text) for file, text in texts.items()}
    kinds = (ns.REAL | ns.NOEXP, ns.REAL | ns.NOEXP if signed else ns.INT)
    order, other = (natsorted(files, key=keys.__getitem__, alg=kind) for kind in kinds)
    if order != other:
        first, second = (", ".join(file.name for file in some[:4]) for some in (other, order))
        raise ValueError(
            f"frames must have one order, their names give two: {first}, … or {second}, …; "
            "rename them, or pass a list of files"
        )
    number = r"([+-]?\d+(?:\.\d+)?)" if signed else r"(\d+(?:\.\d+)?)"
    _check_numbers(order, [re.split(number, keys[file]) for file in order])
    return order


def _check_numbers(files: Sequence[Path], parts: Sequence[Sequence[str]]) -> None:
    """Reject files of several axes; warn of files that may be missing or of another series."""
    first, *_, last = (file.name for file in (*files, files[-1]))
    texts = [tuple(each[::2]) for each in parts]
    usual = mode(texts)
    odd = [f"{file.name} is frame {k}" for k, file in enumerate(files) if texts[k] != usual]
    if odd:
        shown = f" ({', '.join(odd[:9])})" if 2 * len(odd) < len(files) else ""
        warnings.warn(
            f"names differ in more than numbers{shown}, frames are read from {first} to {last}",
            stacklevel=3,
        )
        return
    columns = [
        column
        for text in zip(*(each[1::2] for each in parts), strict=True)
        if len(set(column := [Decimal(number) for number in text])) > 1
    ]
    if len(columns) > 1 and prod(len(set(column)) for column in columns) == len(files):
        raise ValueError(
            f"frames must lie along one axis, the names from {first} to {last} have "
            f"{len(columns)}: give a pattern of some, or pass a list of files"
        )
    if len(columns) > 1 and all(len(set(column)) < len(files) for column in columns):
        warnings.warn(
            f"names count by {len(columns)} numbers, as along several axes of which files are "
            f"missing, frames are read from {first} to {last}",
            stacklevel=3,
        )
    if len(columns) == 1:
        gaps = [after - before for before, after in pairwise(columns[0])]
        for gap, (before, after) in zip(gaps, pairwise(files), strict=True):
            if gap > min(gaps):
                warnings.warn(
                    f"no frame between {before.name} and {after.name}: if one is missing, all "
                    "positions and times after it are wrong",
                    stacklevel=3,
                )
                break
