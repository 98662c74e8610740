r"""The point-load model with its slopes kept whole: how far (4.1)–(4.7) may be trusted.

The thesis replaces :math:`\sin\theta` by the slope in the force balance (4.1) and
:math:`1/\cos\theta - 1` by
:math:`\theta^2/2` in the strain (4.4). Here both stay as they are; all other assumptions, a uniform
stress among them, are the model's own. It is this stress, the same at every radius and in both
directions, that cannot balance a dimple beyond `steepest_depth`; one that varies along the radius,
as in `microlib.membrane._disc`, can.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from microlib._common import poisson, scalar
from microlib.membrane._point_load import GAUSS


def steepest_depth(dimple_radius: float, *, probe_half_width: float) -> float:
    r"""Depth at which the membrane would stand upright at the probe, under a uniform stress.

    Parameters
    ----------
    dimple_radius, probe_half_width : float
        a and c, in µm.

    Returns
    -------
    float
        The largest depth w_d that the force balance allows a uniform isotropic stress, in µm. A
        deeper dimple needs a stress that varies along the radius.

    Raises
    ------
    ValueError
        If a length is not positive or `probe_half_width` is not below `dimple_radius`.

    Notes
    -----
    (4.1) without its small angle reads :math:`\sin\theta = k(1/r - r/a^2)` with :math:`k =
    F/(2\pi\sigma_d h)`. The sine is largest at the probe and reaches 1 there for :math:`k = 1/(1/c
    - c/a^2)`. A smaller uniform stress, a larger k, has no solution.

    Examples
    --------
    >>> from microlib.membrane import steepest_depth
    >>> print(f"{steepest_depth(250.0, probe_half_width=25.0):.1f} µm")
    62.1 µm
    """
    a, c = _geometry(dimple_radius, probe_half_width)
    return _depth(1.0, a, c)


def finite_slope_modulus(
    force: float,
    dimple_radius: float,
    dimple_depth: float,
    *,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
) -> float:
    r"""Elastic modulus from one indentation without the small-slope steps of (4.1) and (4.4).

    Parameters
    ----------
    force, dimple_radius, dimple_depth, thickness, probe_half_width, poisson_ratio : float
        As for `microlib.membrane.elastic_modulus`: µN, µm, and no unit for the last.

    Returns
    -------
    float
        Modulus, in MPa; NaN if `dimple_depth` is beyond `steepest_depth`, where no uniform
        isotropic stress balances the force.

    Raises
    ------
    ValueError
        If an argument is out of its range or is not a single number.

    Notes
    -----
    With :math:`\sin\theta = k(1/r - r/a^2)`, the depth :math:`\int_c^a \tan\theta\,dr` fixes k,
    which gives the stress
    :math:`F/(2\pi k h)`; the strain is half the mean of :math:`1/\cos\theta - 1` over the annulus,
    as in (4.5).

    Examples
    --------
    >>> from microlib.membrane import finite_slope_modulus
    >>> modulus = finite_slope_modulus(
    ...     50.0, 250.0, 40.0, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{modulus:.2f} MPa")
    11.09 MPa
    """
    a, c = _geometry(dimple_radius, probe_half_width)
    load, depth = scalar("force", force, above=0), scalar("dimple_depth", dimple_depth, above=0)
    h = scalar("thickness", thickness, above=0)
    nu = poisson(poisson_ratio)
    if depth > _depth(1.0, a, c):
        return float("nan")
    # The sine at the probe stands for k: it runs over (0, 1].
    steepest = brentq(lambda sine: _depth(sine, a, c) - depth, 0.0, 1.0, xtol=np.finfo(float).eps)
    stress = load * (1 / c - c / a**2) / (2 * np.pi * steepest * h)
    r, dr, sine = _profile(steepest, a, c)
    cosine = np.sqrt((1 - sine) * (1 + sine))
    # 1/cos − 1 without cancellation.
    stretch = sine**2 / (cosine * (1 + cosine))
    strain = np.sum(stretch * r * dr) / (a**2 - c**2)
    return float(stress * (1 - nu) / strain)


def _geometry(dimple_radius: float, probe_half_width: float) -> tuple[float, float]:
    a = scalar("dimple_radius", dimple_radius, above=0)
    return a, scalar("probe_half_width", probe_half_width, above=0, below=a)


def _profile(steepest: float, a: float, c: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return radii, quadrature weights and sin θ; `steepest` is the sine at the probe."""
    # r = c + (a − c) t² takes the root singularity of an upright membrane out of the integrand.
    nodes, weights = GAUSS
    t = (nodes + 1) / 2
    r = c + (a - c) * t**2
    sine = steepest * (1 / r - r / a**2) / (1 / c - c / a**2)
    return r, weights * (a - c) * t, sine


def _depth(steepest: float, a: float, c: float) -> float:
    _, dr, sine = _profile(steepest, a, c)
    return float(np.sum(sine / np.sqrt((1 - sine) * (1 + sine)) * dr))
