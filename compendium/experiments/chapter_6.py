"""Sentences of the abstract and of chapter 6, held against printed numbers and against records, and
how precise a modulus must be to tell two stages of development apart."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from compendium import thesis
from compendium.experiments.section_5_6 import printed_dimple
from compendium.ledger import Record, claim, claims
from microlib.membrane import SmallSlopeWarning, elastic_modulus

#: Modulus at the blastula stage over that before hatching: Kim et al. (2006), abstract.
STAGE_RATIO = 1.66
#: Risks of the comparison: of a difference that is none (two-sided), and of one that is missed.
FALSE_ALARM, MISS = 0.05, 0.05


def of_printed_numbers() -> dict[str, float]:
    """Return what decides each sentence that printed numbers alone decide, by its claim."""
    table = {name: entry.value for name, entry in claims().items() if entry.printed}
    errors = {name: value for name, value in table.items() if name.endswith("/accuracy")}
    on_paths = [
        errors[f"table-5.4/{zoom}/{path}/accuracy"] / claim(f"section-5.4/pixel-{zoom}").value
        for zoom in thesis.ZOOMS
        for path in ("square", "circle", "sinusoid")
    ]
    settling = [table[f"table-5.3/{zoom}/settling-time"] for zoom in thesis.ZOOMS]
    return {
        "section-4.1/small-slopes": table["table-5.6/w_d"] / table["table-5.6/a"],
        "section-5.4/settles-in-a-second": max(settling),
        "section-5.4/tracked-accurately": sum(px <= 1 for px in on_paths) / len(on_paths),
        "section-6/precise-and-accurate": min(errors.values()),
    }


def of_records(records: Mapping[str, Record]) -> dict[str, float]:
    """Return what decides each sentence that the simulations of section 5.5 decide, by its claim.

    Parameters
    ----------
    records : mapping of str to Record
        What chapter 5 recorded.
    """
    error = records["5.5/ridge-thesis"].value / thesis.RIDGE_STEP
    return {"section-6/reconstruction-synthetic": error}


def log_sensitivities() -> dict[str, float]:
    """Return by what percentage the modulus of Table 5.6 changes for 1 % of each measured input.

    The derivatives of the logarithm of (5.2) by the logarithms of its inputs, by central
    differences. An error of the result by the step, 10⁻⁴, is of the order 10⁻⁸.
    """
    radius, depth = printed_dimple()
    values = {"force": thesis.FORCE, "rim_radius": radius, "dimple_depth": depth}
    values |= thesis.MEMBRANE
    found, step = {}, np.array([1 - 1e-4, 1 + 1e-4])
    for name in [one for one in values if one != "poisson_ratio"]:
        with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
            moduli = elastic_modulus(**(values | {name: values[name] * step}))
        found[name] = float(np.diff(np.log(moduli))[0] / np.diff(np.log(step))[0])
    return found


def power(std: ArrayLike, ratio: float = STAGE_RATIO) -> NDArray:
    """Return how often one modulus of each of two stages differs significantly.

    Parameters
    ----------
    std : array_like
        Standard deviation of the logarithm of a modulus: its relative error, if that is small.
    ratio : float
        True ratio of the two moduli.

    Returns
    -------
    ndarray
        Probability that the two-sided test of the level `FALSE_ALARM` rejects equal moduli, if both
        logarithms have independent normal errors of that known standard deviation.
    """
    shift = np.log(ratio) / (np.sqrt(2) * np.asarray(std))
    limit = norm.ppf(1 - FALSE_ALARM / 2)
    return np.asarray(norm.cdf(shift - limit) + norm.cdf(-shift - limit))


def needed_std(ratio: float = STAGE_RATIO) -> float:
    """Return the largest standard deviation of ln E with which `power` is 1 − `MISS`.

    The term of the wrong sign, below 10⁻⁷ there, is left out.
    """
    both = norm.ppf(1 - FALSE_ALARM / 2) + norm.ppf(1 - MISS)
    return float(np.log(ratio) / (np.sqrt(2) * both))
