"""The order of image files by the numbers in their names."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from math import prod
from pathlib import Path
from statistics import mode

#: Whole numbers, whatever stands between them; numbers that may have a sign and decimals.
_WHOLE, _DECIMAL = r"(\d+)", r"([+-]?\d+(?:[.,]\d+)?)"

#: The numbers that vary in the names of files, and the files; sorted.
Reading = list[tuple[tuple[Decimal, ...], Path]]


def in_order(files: Sequence[Path]) -> list[Path]:
    """Return image files in the order of the numbers in their names.

    Parameters
    ----------
    files : sequence of Path
        Files of one stack.

    Returns
    -------
    list of Path
        In the order of their whole numbers, such as 2 before 10. Where signs, decimals or a counter
        that begins again at 0 or 1 give another order, in that with evenly spaced numbers.

    Raises
    ------
    ValueError
        If two files differ only in their format, or two orders are as good.

    Warns
    -----
    UserWarning
        If numbers are missing in an otherwise even sequence.
    """
    names = [file.stem for file in files]
    if twice := sorted(file.name for file in files if names.count(file.stem) > 1):
        raise ValueError(f"frames must be one file each, got {twice[0]} and {twice[1]}")
    parts = {file: re.split(_WHOLE, file.stem) for file in files}
    natural = sorted(files, key=lambda f: [int(p) if k % 2 else p for k, p in enumerate(parts[f])])
    whole, decimal = _read(files, _WHOLE), _read(files, _DECIMAL)
    readings = [reading for reading in (whole, decimal, _rolled_over(whole)) if reading]
    even = [reading for reading in readings if _is_even(reading)]
    orders = [[file for _, file in reading] for reading in even or readings]
    if not even:
        orders.insert(0, natural)
    # Two axes, such as channels and positions, have all pairs of their numbers.
    if decimal and not even and len(decimal[0][0]) > 1:
        columns = zip(*(numbers for numbers, _ in decimal), strict=True)
        if prod(len(set(column)) for column in columns) == len(files):
            orders.append([file for _, file in sorted(decimal, key=lambda each: each[0][::-1])])
    for other in orders[1:]:
        if other != orders[0]:
            first, second = (", ".join(f.name for f in order[:4]) for order in (orders[0], other))
            raise ValueError(
                f"frames must have one order, their names give two: {first}, … or {second}, …; "
                "rename them, give a pattern of some, or pass a list of files"
            )
    if readings:
        _warn_of_gaps((even or readings)[0])
    return orders[0]


def _read(files: Sequence[Path], pattern: str) -> Reading | None:
    """Read the numbers in names; None if the text around them differs, or two have the same."""
    parts = [re.split(pattern, file.stem) for file in files]
    if len({tuple(each[::2]) for each in parts}) != 1:
        return None
    columns = [c for c in zip(*(each[1::2] for each in parts), strict=True) if len(set(c)) > 1]
    numbers = []
    for column in columns:
        # A hyphen before every number separates it.
        cut = all(text[0] == "-" for text in column)
        numbers.append([Decimal(text[cut:].replace(",", ".")) for text in column])
    values: list[tuple[Decimal, ...]] = list(zip(*numbers, strict=True))
    return sorted(zip(values, files, strict=True)) if len(set(values)) == len(files) else None


def _rolled_over(reading: Reading | None) -> Reading | None:
    """Return the order of a counter of fixed width that begins again at 0 or at 1."""
    if not reading or not (gaps := _gaps(reading)):
        return None
    low, high = reading[0][0][0], reading[-1][0][0]
    first, top = gaps.index(max(gaps)) + 1, 10 ** len(str(high))
    fixed = len({len(file.stem) for _, file in reading}) == 1
    if not fixed or max(gaps) < top / 2 or high < top - 2 * len(reading):
        return None
    period = Decimal(top if low == 0 else top - 1)
    return reading[first:] + [((value + period,), file) for (value,), file in reading[:first]]


def _gaps(reading: Reading) -> list[Decimal]:
    """Return the differences of successive numbers; none where several numbers vary."""
    if len(reading[0][0]) != 1 or len(reading) < 3:
        return []
    return [after[0] - before[0] for (before, _), (after, _) in pairwise(reading)]


def _is_even(reading: Reading) -> bool:
    """Return whether the numbers rise by one step, or by multiples of it that leave few out."""
    steps = [gap / min(gaps) for gap in gaps] if (gaps := _gaps(reading)) else []
    return bool(steps) and all(step % 1 == 0 for step in steps) and sum(steps) < 2 * len(reading)


def _warn_of_gaps(reading: Reading) -> None:
    gaps = _gaps(reading)
    usual = mode(gaps) if gaps else Decimal(0)
    for gap, ((_, before), (_, after)) in zip(gaps, pairwise(reading), strict=False):
        if gap > usual and 2 * gaps.count(usual) > len(gaps):
            warnings.warn(f"no frame between {before.name} and {after.name}", stacklevel=2)
