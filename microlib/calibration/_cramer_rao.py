"""The Cramér–Rao bound of a calibration: how well any method could know the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, inverse_normal, of_kind, scalar
from microlib.microscope import Microscope

#: Largest noise, px: beyond any sensor's rows.
_MOST_NOISE = 1e9


def cramer_rao(
    microscope: Microscope, world: ArrayLike, noise: float, parameters: tuple[str, ...]
) -> Array:
    """Smallest covariance any unbiased estimate of `parameters` can have.

    Parameters
    ----------
    microscope : Microscope
        The truth.
    world : array_like, shape (N, 2)
        Points of the pattern plane, µm.
    noise : float
        Standard deviation of each coordinate of the image points, px.
    parameters : tuple of str
        What is estimated together, see :meth:`microlib.microscope.Microscope.jacobian`; the others
        are known.

    Returns
    -------
    ndarray, shape (p, p)
        (JᵀJ)⁻¹ σ²; infinite variances, and NaN beside them, for the parameters that take part in a
        direction the points do not determine.

    Raises
    ------
    ValueError
        If `world` or `noise` is not what it should be, or a name is unknown.

    Examples
    --------
    No set of points on a plane determines the three lengths:

    >>> import numpy as np
    >>> scope = Microscope(200490, 126150, 78750, beta=0.05)
    >>> x, y = np.meshgrid(np.linspace(-1500, 1500, 7), np.linspace(-1000, 1000, 5))
    >>> world = np.column_stack([x.ravel(), y.ravel()])
    >>> np.diag(cramer_rao(scope, world, 0.02, ("tube_length", "focal_length", "distance")))
    array([inf, inf, inf])
    """
    of_kind("microscope", microscope, Microscope)
    noise = scalar("noise", noise, least=0, most=_MOST_NOISE)
    jacobian = microscope.jacobian(world, parameters).reshape(-1, len(parameters))
    inverse = inverse_normal(jacobian)
    with np.errstate(invalid="ignore"):  # what is open stays so without noise, too
        return np.where(np.isinf(inverse), np.inf, noise**2 * inverse)
