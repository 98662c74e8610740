"""Chapter 4: what modulus a dimple has where the stress may vary along the radius."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pandas as pd

from compendium import thesis
from compendium.ledger import claim
from microlib.membrane import SmallSlopeWarning, disc_modulus, elastic_modulus, indent_disc

#: Flat discs with a clamped rim, under the thesis' pressure F/(π a²) unless they say otherwise. Two
#: per cent of stretch and five of the rim are examples; nobody measured either.
DISCS: dict[str, dict[str, Any]] = {
    "neo-Hooke": {},
    "Hooke": {"law": "hooke"},
    "neo-Hooke, no pressure": {"pressure": 0.0},
    "Hooke, no pressure": {"law": "hooke", "pressure": 0.0},
    "stretched by 2 % before": {"pretension": 0.02},
    "rim drawn in by 5 %": {"rim_inset": 0.05},
}
#: Forces of a curve in modulus × thickness × radius: dimples a tenth to a half of the radius deep.
_LOADS = np.geomspace(2e-3, 0.5, 16)
_RADIUS = claim("table-5.6/a").value


def modulus_ratio(disc: str, relative_depth: float) -> float:
    """Return a disc's modulus over that of (4.7) from the same dimple and force.

    Parameters
    ----------
    disc : str
        One of `DISCS`.
    relative_depth : float
        w_d/a of the dimple, whose radius is that of Table 5.6.

    Returns
    -------
    float
        The ratio, whatever the force is: both moduli are proportional to it.

    Raises
    ------
    ValueError
        If no modulus gives the disc this depth.
    """
    depth = relative_depth * _RADIUS
    found = disc_modulus(thesis.FORCE, _RADIUS, depth, **thesis.MEMBRANE, **DISCS[disc])
    return found / _small_slope_modulus(thesis.FORCE, depth)


def modulus_ratio_curve(disc: str) -> pd.DataFrame:
    """Return the ratio of `modulus_ratio` over the depths that a range of forces makes.

    Parameters
    ----------
    disc : str
        One of `DISCS`.

    Returns
    -------
    pandas.DataFrame
        A row each force: depth (w_d/a) and ratio.
    """
    rows = []
    for load in _LOADS * thesis.MEMBRANE["thickness"] * _RADIUS:  # µN, for a modulus of 1 MPa
        state = indent_disc(load, modulus=1.0, radius=_RADIUS, **thesis.MEMBRANE, **DISCS[disc])
        rows.append((state.depth / _RADIUS, 1 / _small_slope_modulus(load, state.depth)))
    return pd.DataFrame(rows, columns=["depth", "ratio"])


def _small_slope_modulus(force: float, depth: float) -> float:
    with warnings.catch_warnings():
        # How much it is worth beyond small slopes is the question here.
        warnings.simplefilter("ignore", SmallSlopeWarning)
        return float(elastic_modulus(force, _RADIUS, depth, **thesis.MEMBRANE))
