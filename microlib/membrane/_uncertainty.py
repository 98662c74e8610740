"""Uncertainty of the modulus (5.2) from the errors of its inputs: first order and Monte Carlo."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_generator, as_integer, as_scalar, as_symmetric
from microlib.membrane._point_load import (
    annulus,
    check_inputs,
    elastic_modulus,
    force_per_modulus,
    log_remainder,
)

#: The arguments of `elastic_modulus` in its order. A seed draws the same samples for mappings of
#: any order.
_INPUTS = tuple(signature(elastic_modulus).parameters)


def modulus_uncertainty(
    values: Mapping[str, float],
    uncertainties: Mapping[str, float],
    *,
    dimple_covariance: ArrayLike | None = None,
) -> float:
    r"""Return the standard deviation of the modulus (5.2) by first-order error propagation.

    Parameters
    ----------
    values : mapping of str to float
        The six arguments of `elastic_modulus` by name, in their units.
    uncertainties : mapping of str to float
        Standard deviations of independent errors by the same names and in the same units. An input
        that is left out is exact.
    dimple_covariance : array_like, shape (2, 2), optional
        Covariance of radius and depth, in µm², such as that of `microlib.embryo.fit_dimple`. It
        takes the place of their standard deviations. NaN where it is unknown.

    Returns
    -------
    float
        Standard deviation of E, in MPa; NaN if `dimple_covariance` is.

    Raises
    ------
    ValueError
        If a name is missing or unknown, a standard deviation is negative, a value is out of range,
        `dimple_covariance` is not symmetric or has a negative eigenvalue, or the errors of radius
        and depth are given twice.

    See Also
    --------
    modulus_samples : The whole distribution, which is skewed.

    Notes
    -----
    The standard deviation covers the errors of the inputs. It does not cover the error of the
    model, which the table of `microlib.membrane` gives.

    The logarithmic derivatives of (5.2) are 1 for the force, −1 for the thickness, −3 for the depth
    and −ν/(1−ν) for the Poisson ratio. Let N be the numerator of S in (4.7), D the base of its cube
    and :math:`x = 1-\zeta^2`. The logarithmic derivative of S by :math:`\zeta = c/a` is
    :math:`s = 4x^2/N + 2(1-x)/x - 6x/D`. The derivative of (5.2) is :math:`-s` for the half-width
    of the probe and :math:`2 + s` for the radius of the dimple.

    Examples
    --------
    >>> from microlib.membrane import modulus_uncertainty
    >>> values = dict(force=1.0, rim_radius=250.0, dimple_depth=20.0, thickness=3.0,
    ...               probe_half_width=25.0, poisson_ratio=0.5)
    >>> of_depth = modulus_uncertainty(values, dict(dimple_depth=0.2))  # 1 % of w_d, 3 % of E
    >>> print(f"{of_depth:.3f} MPa")
    0.047 MPa
    >>> together = [[1.0, 0.18], [0.18, 0.04]]  # radius to 1 µm, correlated with the depth by 0.9
    >>> print(f"{modulus_uncertainty(values, {}, dimple_covariance=together):.3f} MPa")
    0.031 MPa
    """
    inputs, covariance = _check_errors(values, uncertainties, dimple_covariance)
    zeta = inputs["probe_half_width"] / inputs["rim_radius"]
    x = annulus(zeta)
    by_zeta = 2 * x**2 / log_remainder(zeta, 3) + 2 * zeta**2 / x - 6 * x / log_remainder(zeta, 2)
    exponents: dict[str, Any] = {
        "force": 1.0,
        "rim_radius": 2 + by_zeta,
        "dimple_depth": -3,
        "thickness": -1,
        "probe_half_width": -by_zeta,
    }
    gradient = {name: float(by) / values[name] for name, by in exponents.items()}
    # ν may be zero, where ∂ ln E / ∂ ln ν vanishes but ∂ ln E / ∂ν = −1/(1−ν) does not.
    gradient["poisson_ratio"] = -1 / (1 - values["poisson_ratio"])
    by_input = np.array([gradient[name] for name in _INPUTS])
    # Rounding may leave a negative variance.
    relative = np.sqrt(np.maximum(by_input @ covariance @ by_input, 0.0))
    return float(inputs["force"] / force_per_modulus(inputs) * relative)


def modulus_samples(
    values: Mapping[str, float],
    uncertainties: Mapping[str, float],
    *,
    size: int,
    rng: np.random.Generator | int,
) -> Array:
    r"""Return random samples of the modulus (5.2), from random errors of its inputs.

    Parameters
    ----------
    values, uncertainties : mapping of str to float
        As for `modulus_uncertainty`.
    size : int
        Number of samples.
    rng : numpy.random.Generator or int
        Source of randomness, or its seed.

    Returns
    -------
    ndarray, shape (size,)
        Samples of E, in MPa.

    Raises
    ------
    ValueError
        As for `modulus_uncertainty`, or if nearly all draws have a probe wider than the dimple.

    Notes
    -----
    Force and lengths are log-normal with the given means :math:`m_i` and standard deviations
    :math:`\sigma_i`. Their logarithms have the variances :math:`\ln(1 + \sigma_i^2/m_i^2)`. For
    small errors the distribution is nearly normal. The Poisson ratio is normal. Draws with
    :math:`c \ge a` or ν outside (−1, 0.5] are rejected and drawn again, so that ν = 0.5 ± 0.02 is
    half a normal distribution below 0.5.

    Examples
    --------
    >>> from microlib.membrane import modulus_samples
    >>> values = dict(force=1.0, rim_radius=250.0, dimple_depth=20.0, thickness=3.0,
    ...               probe_half_width=25.0, poisson_ratio=0.5)
    >>> samples = modulus_samples(values, dict(dimple_depth=0.2), size=20_000, rng=1)
    >>> print(f"{samples.std():.2f} MPa")
    0.05 MPa
    """
    _, covariance = _check_errors(values, uncertainties)
    missing = as_integer("size", size, least=1)
    rng = as_generator("rng", rng)
    means, sigmas = np.array([values[name] for name in _INPUTS]), np.sqrt(np.diag(covariance))
    # The Poisson ratio is the last input and is not log-normal.
    log_variances = np.log1p((sigmas / means)[:-1] ** 2)
    accepted = []
    for _ in range(200):
        scatter = np.exp(
            rng.normal(-log_variances / 2, np.sqrt(log_variances), (missing, means.size - 1))
        )
        ratio = rng.normal(means[-1], sigmas[-1], missing)
        drawn = dict(zip(_INPUTS, [*(means[:-1] * scatter).T, ratio], strict=True))
        possible = (drawn["probe_half_width"] < drawn["rim_radius"]) & (ratio > -1)
        possible &= ratio <= 0.5
        drawn = {name: each[possible] for name, each in drawn.items()}
        accepted.append(drawn["force"] / force_per_modulus(drawn))
        missing -= accepted[-1].size
        if missing == 0:
            return np.concatenate(accepted)
    raise ValueError(
        "uncertainties must allow draws with a probe narrower than the dimple and poisson_ratio in "
        f"(-1, 0.5], got {dict(uncertainties)}"
    )


def _check_errors(
    values: Mapping[str, float],
    uncertainties: Mapping[str, float],
    dimple_covariance: ArrayLike | None = None,
) -> tuple[dict[str, Array], Array]:
    """Return the inputs of (5.2) and their covariance, in the order of `_INPUTS`."""
    if set(values) != set(_INPUTS):
        raise ValueError(f"values must have the keys {sorted(_INPUTS)}, got {sorted(values)}")
    if not set(uncertainties) <= set(_INPUTS):
        raise ValueError(
            f"uncertainties must have keys among {sorted(_INPUTS)}, got {sorted(uncertainties)}"
        )
    inputs = check_inputs(**{name: as_scalar(f"values[{name!r}]", values[name]) for name in values})
    stds = {
        name: as_scalar(f"uncertainties[{name!r}]", uncertainties[name], least=0)
        for name in uncertainties
    }
    covariance = np.diag([stds.get(name, 0.0) ** 2 for name in _INPUTS])
    if dimple_covariance is not None:
        if twice := [name for name in _INPUTS[1:3] if name in uncertainties]:
            raise ValueError(
                f"uncertainties must not repeat what dimple_covariance contains, got {twice}"
            )
        covariance[1:3, 1:3] = as_symmetric("dimple_covariance", dimple_covariance, 2)
    return inputs, covariance
