"""Local regression: smooth y(x) without assuming a shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import (
    Array,
    as_array,
    same_length,
    scalar,
    whole,
)


def loess(x: ArrayLike, y: ArrayLike, *, span: float = 0.25, degree: int = 2) -> Array:
    r"""Smooth y(x) by polynomials fitted locally (Cleveland 1979).

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Data, in any order and unit.
    span : float
        Share of the data used around each point, in (0, 1]. The thesis uses 0.25.
    degree : int
        Degree of the local polynomials, 1 or 2. The thesis uses 2.

    Returns
    -------
    ndarray, shape (n,)
        Smoothed y at each x, in the order of `x`.

    Raises
    ------
    ValueError
        If the arrays differ in length or hold NaN, `span` or `degree` is out of range, or a
        neighborhood has too few different x for its polynomial.

    Notes
    -----
    A neighborhood is the :math:`k = \lfloor \text{span} \cdot n \rfloor` nearest points, weighted
    by the tricube :math:`(1 - |u|^3)^3` of the distance over that of the furthest. All local
    normal equations are solved together.

    The smoothing is not free: where y(x) bends within a neighborhood, as at the bottom of a
    dimple, the result is flatter than the data.

    References
    ----------
    W. S. Cleveland, *Robust locally weighted regression and smoothing scatterplots*, J. American
    Statistical Association 74, 1979.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.embryo import loess
    >>> x = np.linspace(0, 1, 9)
    >>> loess(x, x**2, span=0.6).round(6).tolist()  # a parabola passes unchanged
    [0.0, 0.015625, 0.0625, 0.140625, 0.25, 0.390625, 0.5625, 0.765625, 1.0]
    """
    x = as_array("x", x, shape=(None,))
    y = as_array("y", y, shape=(None,))
    same_length(("x", "y"), x, y)
    share = scalar("span", span, above=0, most=1)
    whole("degree", degree, least=1, most=2)
    # So that a product such as 0.29 × 100 loses no neighbor to rounding.
    k = int(share * len(x) * (1 + 4 * np.finfo(float).eps))
    if k < degree + 1:
        raise ValueError(
            f"span must hold at least {degree + 1} points for degree {degree}, got {k} of {len(x)}"
        )

    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    # Moving a neighborhood on by one point swaps its first for the next; it pays as long as the
    # two lie symmetrically left of x. The sums rise, so that the place is a binary search.
    first = np.searchsorted(x[: len(x) - k] + x[k:], 2 * x)
    smooth = np.empty_like(x)
    # What fits into a processor's cache, 256 kB an array; the result is the same for any.
    block = max(1, 2**15 // k)
    for start in range(0, len(x), block):
        rows = slice(start, start + block)
        members = first[rows, np.newaxis] + np.arange(k)
        u = x[members] - x[rows, np.newaxis]
        reach = np.abs(u).max(axis=1, keepdims=True)
        u /= np.where(reach > 0, reach, 1.0)
        cube = 1 - np.abs(u * u * u)
        smooth[rows] = _local_fits(u, y[members], cube * cube * cube, degree)
    if np.isnan(smooth).any():
        raise ValueError(
            f"x must hold {degree + 1} different values in each neighborhood of {k} points, got "
            "fewer"
        )
    return smooth[np.argsort(order)]


def _local_fits(u: Array, y: Array, weights: Array, degree: int) -> Array:
    """Value at u = 0 of the weighted polynomial of each row; NaN where it is not determined."""
    # The normal equations: on |u| ≤ 1 their condition stays below about 1e5, which leaves ten
    # digits.
    powers = u[..., np.newaxis] ** np.arange(degree + 1)
    weighted = (weights[..., np.newaxis] * powers).swapaxes(1, 2)
    normal, right = weighted @ powers, weighted @ y[..., np.newaxis]
    # What the sums' roundings leave; evenly spaced points give 1e-4 or more.
    least = 4 * u.shape[1] * np.finfo(float).eps
    poor = np.linalg.det(normal) <= least * normal[:, 0, 0] ** (degree + 1)
    normal[poor] = np.eye(degree + 1)
    return np.where(poor, np.nan, np.linalg.solve(normal, right)[:, 0, 0])
