"""How errors of the inputs of (5.2) reach the elastic modulus: first order and Monte Carlo."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array, generator, of_kind, scalar, whole
from microlib.membrane._point_load import (
    annulus,
    checked,
    elastic_modulus,
    force_per_modulus,
    log_remainder,
)

#: The arguments of `elastic_modulus` in its order, so that the same seed draws the same samples for
#: any mapping.
_INPUTS = tuple(signature(elastic_modulus).parameters)


def modulus_std(
    values: Mapping[str, float],
    stds: Mapping[str, float],
    *,
    dimple_covariance: ArrayLike | None = None,
) -> float:
    r"""Standard deviation of the modulus to first order.

    Parameters
    ----------
    values : mapping of str to float
        The six arguments of `elastic_modulus` by name, in their units.
    stds : mapping of str to float
        Standard deviations of independent errors by the same names and in the same units; an input
        left out is exact.
    dimple_covariance : array_like, shape (2, 2), optional
        Covariance of radius and depth, in µm², in place of their standard deviations: an image
        gives the two together, as `microlib.embryo.fit_dimple` does. NaN where it is not known.

    Returns
    -------
    float
        Standard deviation of E, in MPa; NaN if `dimple_covariance` is.

    Raises
    ------
    ValueError
        If a name is missing or unknown, a standard deviation is negative, a value is out of range,
        or the dimple's errors are given twice.

    See Also
    --------
    modulus_samples : The whole distribution, which the power −3 of w_d makes skewed.

    Notes
    -----
    The logarithmic derivatives of (5.2) are 1 for the force, −1 for the thickness, −3 for the depth
    and −ν/(1−ν) for the Poisson ratio. The probe's width enters through the bracket S of (4.7)
    alone. With :math:`x = 1-\zeta^2`, :math:`N` the bracket's numerator and :math:`D` the base of
    its cube the exponent of :math:`\zeta = c/a` in S is :math:`4x^2/N + 2(1-x)/x - 6x/D`; that of
    the width is its negative, and the radius has this one and 2 more.

    Examples
    --------
    >>> from microlib.membrane import modulus_std
    >>> values = dict(force=1.0, dimple_radius=250.0, dimple_depth=20.0, thickness=3.0,
    ...               probe_half_width=25.0, poisson_ratio=0.5)
    >>> print(f"{modulus_std(values, dict(dimple_depth=0.2)):.3f} MPa")  # 1 % of w_d, 3 % of E
    0.047 MPa
    >>> together = [[1.0, 0.18], [0.18, 0.04]]  # radius to 1 µm, correlated with the depth by 0.9
    >>> print(f"{modulus_std(values, {}, dimple_covariance=together):.3f} MPa")
    0.031 MPa
    """
    inputs, covariance = _checked(values, stds, dimple_covariance)
    zeta = inputs["probe_half_width"] / inputs["dimple_radius"]
    x = annulus(zeta)
    by_zeta = 2 * x**2 / log_remainder(zeta, 3) + 2 * zeta**2 / x - 6 * x / log_remainder(zeta, 2)
    exponents: dict[str, Any] = {
        "force": 1.0,
        "dimple_radius": 2 + by_zeta,
        "dimple_depth": -3,
        "thickness": -1,
        "probe_half_width": -by_zeta,
    }
    gradient = {name: float(by) / values[name] for name, by in exponents.items()}
    # ν may be zero, where ∂ ln E / ∂ ln ν vanishes but ∂ ln E / ∂ν = −1/(1−ν) does not.
    gradient["poisson_ratio"] = -1 / (1 - values["poisson_ratio"])
    by_input = np.array([gradient[name] for name in _INPUTS])
    # Rounding may leave less than nothing.
    relative = np.sqrt(np.maximum(by_input @ covariance @ by_input, 0.0))
    return float(inputs["force"] / force_per_modulus(inputs) * relative)


def modulus_samples(
    values: Mapping[str, float],
    stds: Mapping[str, float],
    *,
    size: int,
    rng: np.random.Generator | int,
) -> Array:
    r"""Draw moduli for errors of the inputs, each drawn from what it can be.

    Parameters
    ----------
    values, stds : mapping of str to float
        As for `modulus_std`.
    size : int
        How many samples.
    rng : numpy.random.Generator or int
        Source of randomness, or its seed.

    Returns
    -------
    ndarray, shape (size,)
        Samples of E, in MPa.

    Raises
    ------
    ValueError
        As for `modulus_std`, or if the errors leave hardly a draw with the probe narrower than the
        dimple.

    Notes
    -----
    Force and lengths are positive, so they are log-normal, with the given means and deviations: the
    logarithms have the variances :math:`\ln(1 + \sigma_i^2/m_i^2)`. For small errors that is the
    normal distribution, and the moduli's mean and standard deviation are the same to second order
    in the relative errors. All powers of a log-normal quantity have a mean, :math:`w_d^{-3}` too.
    ν is normal. What no dimple has, :math:`c \ge a` or ν outside (−1, 0.5], is drawn again, so that
    ν = 0.5 ± 0.02 lies below 0.5 throughout.

    Examples
    --------
    >>> from microlib.membrane import modulus_samples
    >>> values = dict(force=1.0, dimple_radius=250.0, dimple_depth=20.0, thickness=3.0,
    ...               probe_half_width=25.0, poisson_ratio=0.5)
    >>> samples = modulus_samples(values, dict(dimple_depth=0.2), size=20_000, rng=1)
    >>> print(f"{samples.std():.2f} MPa")
    0.05 MPa
    """
    _, covariance = _checked(values, stds)
    left = whole("size", size, least=1)
    rng = generator("rng", rng)
    means, deviations = np.array([values[name] for name in _INPUTS]), np.sqrt(np.diag(covariance))
    # ν is last, and is not drawn by its logarithm.
    logarithms = np.log1p((deviations / means)[:-1] ** 2)
    found = []
    for _ in range(200):
        scatter = np.exp(rng.normal(-logarithms / 2, np.sqrt(logarithms), (left, means.size - 1)))
        ratio = rng.normal(means[-1], deviations[-1], left)
        drawn = dict(zip(_INPUTS, [*(means[:-1] * scatter).T, ratio], strict=True))
        possible = (drawn["probe_half_width"] < drawn["dimple_radius"]) & (ratio > -1)
        possible &= ratio <= 0.5
        drawn = {name: each[possible] for name, each in drawn.items()}
        found.append(drawn["force"] / force_per_modulus(drawn))
        left -= found[-1].size
        if left == 0:
            return np.concatenate(found)
    raise ValueError(
        "stds must leave draws in which the probe is narrower than the dimple and poisson_ratio in "
        f"(-1, 0.5], got {dict(stds)}"
    )


def _checked(
    values: Mapping[str, float],
    stds: Mapping[str, float],
    dimple_covariance: ArrayLike | None = None,
) -> tuple[dict[str, Array], Array]:
    """Return the inputs of (5.2) and their covariance, in the order of `_INPUTS`."""
    of_kind("values", values, Mapping)
    of_kind("stds", stds, Mapping)
    if set(values) != set(_INPUTS):
        raise ValueError(f"values must have the keys {sorted(_INPUTS)}, got {sorted(values)}")
    if not set(stds) <= set(_INPUTS):
        raise ValueError(f"stds must have keys among {sorted(_INPUTS)}, got {sorted(stds)}")
    inputs = checked(**{name: scalar(f"values[{name!r}]", values[name]) for name in values})
    known_stds = {name: scalar(f"stds[{name!r}]", stds[name], least=0) for name in stds}
    covariance = np.diag([known_stds.get(name, 0.0) ** 2 for name in _INPUTS])
    if dimple_covariance is not None:
        if twice := [name for name in _INPUTS[1:3] if name in stds]:
            raise ValueError(f"stds must leave out what dimple_covariance holds, got {twice}")
        both = as_array("dimple_covariance", dimple_covariance, shape=(2, 2), finite=False)
        covariance[1:3, 1:3] = both
    return inputs, covariance
