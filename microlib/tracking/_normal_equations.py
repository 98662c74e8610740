"""Normal equations of least squares over the pixels of a template."""

from __future__ import annotations

import numpy as np

from microlib._common import Array, Image
from microlib.tracking._geometry import ROUNDING, TINY

#: Most terms of a matrix product that OpenBLAS computes without starting threads. Its threads wait
#: for one another: where other processes run, a frame takes up to ten times as long with them.
_MOST_TERMS = 2**18


def gram(rows: Array, columns: Array) -> Array:
    """Return ``rows @ columns.T`` in double precision, summed over blocks of pixels."""
    size = max(1, _MOST_TERMS // (len(rows) * len(columns)))
    whole = rows.shape[1] // size * size
    a, b = (each[:, :whole].reshape(len(each), -1, size) for each in (rows, columns))
    blocks = a.transpose(1, 0, 2) @ b.transpose(1, 2, 0)
    rest = rows[:, whole:] @ columns[:, whole:].T
    return np.asarray(blocks.sum(axis=0, dtype=np.float64) + rest)


def weighted_least_squares(design: Image, value: Image, weight: Image, motions: int = 0) -> Array:
    """Return the x that minimizes Σ weight·(value − x·design)².

    The first `motions` unknowns have no ridge. The others have one, so that a coefficient of the
    light that no pixel shows stays as it is.
    """
    weighted = design * weight
    return np.linalg.solve(
        ridged(gram(weighted, design), motions), gram(weighted, value[None])[:, 0]
    )


def ridged(normal: Array, first: int = 0) -> Array:
    """Return normal equations with a ridge, so that what no pixel shows stays as it is.

    The unknowns before the `first` one have none but for rounding.
    """
    diagonal = (ROUNDING * normal.diagonal() + TINY).astype(np.float64)
    diagonal[first:] += 1e-3
    return normal + np.diag(diagonal)
