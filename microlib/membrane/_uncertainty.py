"""How errors of the inputs of (5.2) reach the elastic modulus: first order and Monte Carlo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, fields

import numpy as np

from microlib._common import Array, positive, whole
from microlib.membrane._point_load import ModulusSensitivity, elastic_modulus, modulus_sensitivity

__all__ = ["modulus_samples", "modulus_std"]


def modulus_std(values: Mapping[str, float], stds: Mapping[str, float]) -> float:
    """
    Standard deviation of the modulus to first order, for independent input errors.

    Parameters
    ----------
    values : mapping of str to float
        The six arguments of `elastic_modulus` by name, in their units.
    stds : mapping of str to float
        Standard deviations by the same names and in the same units; an input left out is exact.

    Returns
    -------
    float
        Standard deviation of E, in MPa.

    Raises
    ------
    ValueError
        If a name is missing or unknown, a standard deviation is negative, or a value is out of
        range.

    See Also
    --------
    modulus_samples : The whole distribution, which the power −3 of w_d makes skewed.

    Examples
    --------
    >>> values = dict(force=50.0, dimple_radius=250.0, dimple_depth=40.0, thickness=3.0,
    ...               probe_half_width=25.0, poisson_ratio=0.5)
    >>> print(f"{modulus_std(values, dict(dimple_depth=0.4)):.3f} MPa")  # 1 % of w_d, 3 % of E
    0.291 MPa
    """
    _check_names(values, stds)
    modulus = elastic_modulus(**values)
    exponents = modulus_sensitivity(
        values["dimple_radius"],
        probe_half_width=values["probe_half_width"],
        poisson_ratio=values["poisson_ratio"],
    )
    names = [field.name for field in fields(exponents)]
    # ν may be zero, where ∂ ln E / ∂ ln ν vanishes but ∂ ln E / ∂ν = −1/(1−ν) does not.
    relative = [
        stds.get(name, 0.0)
        * (-1 / (1 - values[name]) if name == "poisson_ratio" else exponent / values[name])
        for name, exponent in zip(names, astuple(exponents), strict=True)
    ]
    return float(modulus * np.linalg.norm(relative))


def modulus_samples(
    values: Mapping[str, float],
    stds: Mapping[str, float],
    *,
    size: int,
    rng: np.random.Generator,
) -> Array:
    """
    Draw moduli for normally distributed, independent input errors.

    Parameters
    ----------
    values, stds : mapping of str to float
        As for `modulus_std`.
    size : int
        How many samples.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (size,)
        Samples of E, in MPa.

    Raises
    ------
    ValueError
        As for `modulus_std`, or if an error is so large that a sampled input is impossible (a
        negative depth, say).

    Examples
    --------
    >>> values = dict(force=50.0, dimple_radius=250.0, dimple_depth=40.0, thickness=3.0,
    ...               probe_half_width=25.0, poisson_ratio=0.5)
    >>> samples = modulus_samples(values, dict(dimple_depth=0.4), size=20_000,
    ...                           rng=np.random.default_rng(1))
    >>> print(f"{samples.std():.2f} MPa")
    0.29 MPa
    """
    _check_names(values, stds)
    count = whole("size", size, least=1)
    # In the arguments' own order, so that the same seed gives the same samples for any mapping.
    drawn = {
        field.name: rng.normal(values[field.name], stds.get(field.name, 0.0), count)
        for field in fields(ModulusSensitivity)
    }
    return elastic_modulus(**drawn)


def _check_names(values: Mapping[str, float], stds: Mapping[str, float]) -> None:
    names = {field.name for field in fields(ModulusSensitivity)}
    if set(values) != names:
        raise ValueError(f"values must have the keys {sorted(names)}, got {sorted(values)}")
    if not set(stds) <= names:
        raise ValueError(f"stds must have keys among {sorted(names)}, got {sorted(stds)}")
    for name, std in stds.items():
        positive(f"stds[{name!r}]", std, zero=True)
