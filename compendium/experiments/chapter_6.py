"""Sentences of the abstract and of chapter 6, held against printed numbers, and how precise a
modulus must be to tell two stages of development apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from compendium import thesis
from compendium.experiments import chapter_4
from compendium.ledger import claim, claims

#: Modulus at the blastula stage over that before hatching: Kim et al. (2006), abstract.
STAGE_RATIO = 1.66
#: Risks of the comparison: of a difference that is none (two-sided), and of one that is missed.
FALSE_ALARM, MISS = 0.05, 0.05


def of_printed_numbers() -> dict[str, float]:
    """Return what decides each sentence that printed numbers alone decide, by its claim."""
    table = {name: entry.value for name, entry in claims().items() if entry.printed}
    in_pixels = {
        name: value / claim(f"section-5.4/pixel-{name.split('/')[1]}").value
        for name, value in table.items()
        if name.startswith(("table-5.3/", "table-5.4/")) and not name.endswith("settling-time")
    }
    on_paths = [
        px for name, px in in_pixels.items() if "table-5.4" in name and name.endswith("accuracy")
    ]
    every_width = np.linspace(0.01, 0.99, 981) * table["table-5.6/a"]
    settling = [table[f"table-5.3/{zoom}/settling-time"] for zoom in thesis.ZOOMS]
    thickness = thesis.MEMBRANE["thickness"]
    return {
        "section-4/contact-mechanics": table["table-5.6/w_d"] / thickness,
        "section-4.1/small-slopes": chapter_4.probe_sines(every_width).min(),
        "section-5.4/settles-in-a-second": max(settling),
        "section-5.4/tracked-accurately": float(np.mean([px <= 1 for px in on_paths])),
        "section-6/precise-and-accurate": float(np.mean([px <= 1 for px in in_pixels.values()])),
    }


def power(std: ArrayLike) -> NDArray:
    """Return how often one modulus of each of two stages differs significantly.

    Parameters
    ----------
    std : array_like
        Standard deviation of the logarithm of a modulus: its relative error, if that is small.

    Returns
    -------
    ndarray
        Probability that the two-sided test of the level `FALSE_ALARM` rejects equal moduli, if the
        true ratio is `STAGE_RATIO` and both logarithms have independent normal errors of that known
        standard deviation.
    """
    shift = np.log(STAGE_RATIO) / (np.sqrt(2) * np.asarray(std))
    limit = norm.ppf(1 - FALSE_ALARM / 2)
    return np.asarray(norm.cdf(shift - limit) + norm.cdf(-shift - limit))


def needed_std() -> float:
    """Return the largest standard deviation of ln E with which `power` is 1 − `MISS`.

    The term of the wrong sign, below 10⁻⁷ there, is left out.
    """
    both = norm.ppf(1 - FALSE_ALARM / 2) + norm.ppf(1 - MISS)
    return float(np.log(STAGE_RATIO) / (np.sqrt(2) * both))
