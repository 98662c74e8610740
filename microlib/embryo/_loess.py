"""Local polynomial regression (LOESS)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array, as_integer, as_scalar, check_same_length


def loess(x: ArrayLike, y: ArrayLike, *, span: float = 0.25, degree: int = 2) -> Array:
    r"""Smooth y(x) by local polynomial regression, LOESS (Cleveland 1979).

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Data, in any order and unit.
    span : float
        Fraction of the data in the neighborhood of each point, in (0, 1]. The thesis uses 0.25.
    degree : int
        Degree of the local polynomials, 1 or 2. The thesis uses 2.

    Returns
    -------
    ndarray, shape (n,)
        Smoothed y at each x, in the order of `x`.

    Raises
    ------
    ValueError
        If the arrays differ in length or contain NaN, `span` or `degree` is out of range, or a
        neighborhood has too few different x for its polynomial.

    Notes
    -----
    A neighborhood contains the :math:`k = \lfloor \text{span} \cdot n \rfloor` nearest points. Its
    weights are the tricube :math:`(1 - |u|^3)^3`, where u is the distance divided by that of the
    furthest point.

    The smoothing has a bias. Where y(x) bends within a neighborhood, as at the bottom of a dimple,
    the result is flatter than the data.

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
    check_same_length(("x", "y"), x, y)
    fraction = as_scalar("span", span, above=0, most=1)
    as_integer("degree", degree, least=1, most=2)
    # A product such as 0.29 × 100 must not lose a neighbor to rounding.
    k = int(fraction * len(x) * (1 + 4 * np.finfo(float).eps))
    if k < degree + 1:
        raise ValueError(
            f"span must give {degree + 1} points or more for degree {degree}, got {k} of {len(x)}"
        )

    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    # The neighborhood of k points begins at the first place from which its first point is not
    # further from x than the point behind its last.
    first = np.searchsorted(x[: len(x) - k] + x[k:], 2 * x)
    members = first[:, np.newaxis] + np.arange(k)
    distance = x[members] - x[:, np.newaxis]
    furthest = np.abs(distance).max(axis=1, keepdims=True)
    u = distance / np.where(furthest > 0, furthest, 1.0)
    weights = (1 - np.abs(u) ** 3) ** 3
    # The weighted normal equations of all points. Their condition is below about 1e5 for |u| ≤ 1.
    powers = u[..., np.newaxis] ** np.arange(degree + 1)
    weighted = (weights[..., np.newaxis] * powers).swapaxes(1, 2)
    normal, right = weighted @ powers, weighted @ y[members][..., np.newaxis]
    # The limit is the rounding of the sums. Evenly spaced points have 1e-4 or more.
    least = 4 * k * np.finfo(float).eps * normal[:, 0, 0] ** (degree + 1)
    if (np.linalg.det(normal) <= least).any():
        raise ValueError(
            f"x must have {degree + 1} different values in each neighborhood of {k} points"
        )
    return np.linalg.solve(normal, right)[np.argsort(order), 0, 0]
