"""Chapter 4: what the modulus depends on, and where the assumptions of the model end."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from compendium import thesis
from compendium.ledger import claim
from microlib.membrane import (
    SmallSlopeWarning,
    elastic_modulus,
    finite_slope_modulus,
    mean_strain,
    membrane_stress,
    steepest_depth,
)

#: Every input of (5.2), from Table 5.6 and for c from chapter 5.
INPUTS = {
    "force": thesis.FORCE,
    "rim_radius": claim("table-5.6/a").value,
    "dimple_depth": claim("table-5.6/w_d").value,
    **thesis.MEMBRANE,
}


def exponents(change: float = 1e-6) -> pd.Series:
    """Return ∂ ln E / ∂ ln of each input of (5.2), from a change down: ν = 0.5 is the most.

    The error by the size of the change is of the order of the change.
    """
    exponents = {}
    # A derivative of (5.2) is asked for, whether or not the dimple is too deep for (5.2).
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        modulus = float(elastic_modulus(**INPUTS))
        for name, value in INPUTS.items():
            lower = float(elastic_modulus(**INPUTS | {name: (1 - change) * value}))
            exponents[name] = float(np.log(lower / modulus) / np.log(1 - change))
    return pd.Series(exponents)


def probe_sines(half_widths: ArrayLike) -> NDArray:
    """Return the sin θ that (4.1) with the stress of (4.3) needs at the edge of a probe.

    Radius and depth are those of Table 5.6. Force and thickness cancel. The half-widths are in µm.
    """
    a, c = INPUTS["rim_radius"], np.asarray(half_widths)
    sizes = {"thickness": INPUTS["thickness"], "probe_half_width": c}
    stress = membrane_stress(thesis.FORCE, a, INPUTS["dimple_depth"], **sizes)
    carried = thesis.FORCE * (1 - (c / a) ** 2)  # by the membrane; the pressure carries the rest
    return carried / (2 * np.pi * c * INPUTS["thickness"] * stress)


def slope_corrections(depths: Sequence[float] | NDArray) -> pd.DataFrame:
    """Return the modulus without small slopes over (5.2), by relative depth w_d/a.

    It is NaN where no uniform stress has such a dimple.
    """
    a, c = INPUTS["rim_radius"], INPUTS["probe_half_width"]
    w_d = a * np.asarray(depths)
    strains = [mean_strain(a, w_d, probe_half_width=c, small_slopes=s) for s in (True, False)]
    # The error of (5.2) beyond small slopes is what is computed here.
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        small = elastic_modulus(thesis.FORCE, a, w_d, **thesis.MEMBRANE)
    steepest = steepest_depth(a, probe_half_width=c)
    whole = [
        finite_slope_modulus(thesis.FORCE, a, depth, **thesis.MEMBRANE)
        if depth <= steepest
        else np.nan
        for depth in w_d
    ]
    table = {
        "strain (4.4) exact": strains[0] / strains[1],
        "and balance (4.1) exact": whole / small,
    }
    return pd.DataFrame(
        table, pd.Index(np.asarray(depths), name="depth of the dimple / its radius")
    )
