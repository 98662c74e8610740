"""Membranes with the printed radius and depth: their outlines and their moduli.

The thesis computes the modulus of Table 5.6 from one radius and one depth by one formula. This
module solves other membranes with the same radius and depth. The quantities that the thesis does
not print are drawn from priors.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.optimize import least_squares
from scipy.stats import qmc

from compendium import thesis
from compendium.experiments.chapter_4 import INPUTS
from compendium.experiments.section_5_6 import printed_dimple, right_dimple
from microlib.embryo import GaussianSum, dimple_geometry
from microlib.membrane import (
    SmallSlopeWarning,
    capsule_modulus,
    dimple_profile,
    disc_modulus,
    elastic_modulus,
    indent_capsule,
    indent_disc,
    indentation_force,
)

#: Flat discs with a clamped rim. Their pressure is F/(π a²), as in the thesis, unless it is given.
#: The stretch of 2 % is an example and was not measured.
DISCS: dict[str, dict[str, Any]] = {
    "neo-Hooke": {},
    "Hooke": {"law": "hooke"},
    "neo-Hooke, no pressure": {"pressure": 0.0},
    "Hooke, no pressure": {"law": "hooke", "pressure": 0.0},
    "stretched by 2 % before": {"pretension": 0.02},
}
#: Assumed width and thickness of the end of a cantilever, µm.
BLADE = (thesis.PROBE_WIDTH, 2.0)
#: Radius of the chorion where a single value is needed: the middle of the prior, µm.
EGG = 600.0
LAWS = ("neo-hooke", "hooke", "mooney-rivlin")
#: Priors of the quantities that the thesis does not print. Each is uniform between two limits:
#: lengths in µm, the stretch as in `microlib.membrane`.
#: The laws have equal probabilities, ln E is uniform, and the place of the crest is uniform over
#: `crest_reach`.
PRIORS: dict[str, tuple[float, float]] = {
    "thickness": (0.8 * INPUTS["thickness"], 1.2 * INPUTS["thickness"]),
    "probe_half_width": (0.85 * INPUTS["probe_half_width"], 1.15 * INPUTS["probe_half_width"]),
    "capsule_radius": (500.0, 700.0),
    "inflation": (1.0, 1.1),
}
#: Height in px within which a crest is level, the resolution of the image.
_LEVEL = 1.0
#: Number of solved states of each law. With 36 and 48 states the printed quantiles are the same.
_STATES = 24
#: Force in modulus × thickness × capsule radius that makes a dimple of about a fifth of the radius:
#: 0.05 + 1.1 (λ − 1) for the inflation λ, determined by trial. The logarithm of the force is drawn
#: within the reach on either side.
_USUAL_LOAD, _LOAD_REACH = (0.05, 1.1), 0.7


def modulus_ratios(disc: str, depths: Sequence[float] | NDArray) -> pd.Series:
    """Return a disc's modulus over that of (4.7), by relative depth w_d/a."""
    a, ratios = INPUTS["rim_radius"], {}
    for depth in depths:
        settings = thesis.MEMBRANE | DISCS[disc]
        modulus = disc_modulus(thesis.FORCE, a, depth * a, **settings)
        with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
            ratios[depth] = modulus / thesis.modulus(a, depth * a)
    return pd.Series(ratios)


def shallow_disc(pressure: float | str = "balance", **other: float) -> tuple[float, float]:
    """Return the stress of the meridian at the probe over that at the rim, and E over (4.7).

    The disc obeys Hooke's law and is so stiff that its depth is 0.002 of its radius. In the limit
    of small slopes both ratios are the same at any depth. Other values of the inputs of (4.7) may
    be given, lengths in µm.
    """
    a, membrane = INPUTS["rim_radius"], thesis.MEMBRANE | other
    settings: dict[str, Any] = membrane | {"law": "hooke", "pressure": pressure}
    state = indent_disc(thesis.FORCE, a, modulus=1e7, **settings)
    along = state.stresses[0]
    by_formula = indentation_force(1e7, a, state.depth, **membrane)
    return float(along[0] / along[-1]), float(by_formula / thesis.FORCE)


def readings() -> pd.DataFrame:
    """Return E (MPa) by (5.2) of the outline of Table 5.5 for other readings of a, w_d, c (µm)."""
    curve, pixel, c = thesis.outline_curve(), thesis.EMBRYO_PIXEL, INPUTS["probe_half_width"]
    left = dimple_geometry(curve, pixel_size=pixel)
    (x0, y0), a, w_d = left.bottom, left.rim_radius, left.dimple_depth
    beside_pit = float(min(x for x in curve.extrema()[0] if x > x0))
    right_a, right_depth = right_dimple()
    rows = {
        "left-rim": (a, w_d, c),
        "right-rim": (right_a, right_depth, c),
        "pit-rim": (pixel * (beside_pit - x0), pixel * (float(curve(beside_pit)) - y0), c),
        "half-distance": ((a + right_a) / 2, w_d, c),
        "edge-depth": (a, pixel * (left.rim[1] - float(curve(x0 - c / pixel))), c),
        "thin-probe": (a, w_d, thesis.PROBE_WIDTH_ENDS[0] / 2),
        "wide-probe": (a, w_d, thesis.PROBE_WIDTH_ENDS[1] / 2),
        "blade-thickness": (a, w_d, BLADE[1] / 2),
        "blade-area": (a, w_d, np.sqrt(BLADE[0] * BLADE[1] / np.pi)),
        "blade-perimeter": (a, w_d, sum(BLADE) / np.pi),
    }
    table = pd.DataFrame(rows, index=["a", "w_d", "c"]).T
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        of_lengths = thesis.MEMBRANE | {"probe_half_width": table["c"]}
        table["E"] = elastic_modulus(thesis.FORCE, table["a"], table["w_d"], **of_lengths)
    return table


def left_half(curve: GaussianSum) -> tuple[NDArray, NDArray, NDArray]:
    """Return distances from the axis, and heights above the rim of the left half of an outline and
    of the profile (4.2) with its radius and depth, µm."""
    dimple, c = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL), INPUTS["probe_half_width"]
    r = np.linspace(c, dimple.rim_radius, 400)
    z = curve(dimple.bottom[0] - r / thesis.EMBRYO_PIXEL) - dimple.rim[1]
    profile = dimple_profile(r, dimple.rim_radius, dimple.dimple_depth, probe_half_width=c)
    return r, thesis.EMBRYO_PIXEL * z, -profile


def shapes(radius: float, depth: float) -> dict[str, tuple[float, NDArray, NDArray]]:
    """Return modulus (MPa) and meridian (r, z, µm) of membranes with that radius and depth."""
    c = INPUTS["probe_half_width"]
    r = np.linspace(c, radius, 400)
    profile = dimple_profile(r, radius, depth, probe_half_width=c)
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        models = {"profile (4.2)": (thesis.modulus(radius, depth), r, -profile)}
    discs = {"disc, neo-Hooke": {}, "disc, Hooke": {"law": "hooke"}}
    for name, how in (discs | {"disc, taut by 100 %": {"pretension": 1.0}}).items():
        settings: dict[str, Any] = thesis.MEMBRANE | how
        modulus = disc_modulus(thesis.FORCE, radius, depth, **settings)
        state = indent_disc(thesis.FORCE, radius, modulus=modulus, **settings)
        models[name] = modulus, state.r, state.z - state.z[-1]
    for law in LAWS[:2]:
        egg = capsule_modulus(
            thesis.FORCE, radius, depth, capsule_radius=EGG, law=law, **thesis.MEMBRANE
        )
        crest = int(np.argmax(egg.state.z)) + 1
        meridian = egg.state.r[:crest], egg.state.z[:crest] - egg.state.z[crest - 1]
        models[f"capsule, {law.title()}"] = egg.modulus, *meridian
    return models


def fit_shoulder(r: NDArray, z: NDArray) -> tuple[float, float, float, float]:
    """Return radius and depth of the best (4.2) with a level shoulder, and its rms and largest
    deviation, all in µm."""
    c = INPUTS["probe_half_width"]

    def off(values: NDArray) -> NDArray:
        radius, depth, top = values
        return z - top + dimple_profile(np.clip(r, c, radius), radius, depth, probe_half_width=c)

    start = [r.max() / 2, np.ptp(z), z.max()]
    fit = least_squares(off, start, bounds=([1.1 * c, 1.0, -np.inf], np.inf))
    radius, depth, _ = fit.x.tolist()
    return radius, depth, float(np.sqrt(np.mean(fit.fun**2))), float(np.abs(fit.fun).max())


def crest_reach(curve: GaussianSum) -> tuple[float, float]:
    """Return the limits of the radius of the left crest, µm, within which it is level to 1 px."""
    dimple = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL)
    x = np.linspace(curve.domain[0], dimple.bottom[0], 4000)
    below = np.flatnonzero(curve(x) < dimple.rim[1] - _LEVEL)
    crest = int(np.searchsorted(x, dimple.rim[0]))
    outer, inner = x[below[below < crest].max()], x[below[below > crest].min()]
    bottom, pixel = dimple.bottom[0], thesis.EMBRYO_PIXEL
    return pixel * float(bottom - inner), pixel * float(bottom - outer)


def modulus_posterior(
    rng: np.random.Generator, crest: tuple[float, float], draws: int = 20_000
) -> pd.DataFrame:
    """Draw moduli of closed capsules on a plate with the printed radius and depth, over the priors.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the draws.
    crest : tuple of float
        Least and largest radius of the crest, from `crest_reach`, µm.
    draws : int
        Number of draws.

    Returns
    -------
    pandas.DataFrame
        A row each draw: modulus E (MPa), law, inflation, and thickness, probe_half_width,
        rim_radius and capsule_radius (µm).

    Notes
    -----
    The ratios w_d/R and a/R to the radius R of the capsule depend on F/(E h R), c/R and the
    inflation alone. States are solved for a quasi-random set of these arguments, and the logarithms
    of w_d/R and a/R are interpolated between the states. A draw of the arguments has the printed
    depth at a single radius R. Its weight is the prior of R, of c and of a, times R² from the
    change of variables from (R, c) to (w_d, c/R). A uniform prior of ln E is a uniform prior of
    F/(E h R) in its logarithm.
    """
    _, depth = printed_dimple()
    limits = PRIORS | {"rim_radius": crest}
    parts = []
    for law in LAWS:
        places, logs = _solved_states(law)
        unit = rng.random((draws, places.shape[1]))
        unit[:, 0] = np.sqrt(unit[:, 0])  # the inflation is uniform, see _inputs
        shape = np.exp(RBFInterpolator(places, logs, kernel="quintic", degree=2)(unit))
        size = depth / shape[:, 0]
        candidates = pd.DataFrame(_inputs(unit)).assign(law=law, capsule_radius=size)
        candidates["probe_half_width"] = candidates.pop("slenderness") * size
        candidates["rim_radius"] = shape[:, 1] * size
        drawn = ["rim_radius", "probe_half_width", "capsule_radius"]
        inside = [candidates[name].between(*limits[name]) for name in drawn]
        parts.append(candidates.assign(weight=np.all(inside, axis=0) * size**2))
    every = pd.concat(parts, ignore_index=True)
    picked = rng.choice(len(every), draws, p=every["weight"] / every["weight"].sum())
    chosen = every.drop(columns="weight").iloc[picked].reset_index(drop=True)
    chosen["thickness"] = rng.uniform(*PRIORS["thickness"], draws)
    scale = chosen.pop("load") * chosen["thickness"] * chosen["capsule_radius"]
    return chosen.assign(E=thesis.FORCE / scale)


def _solved_states(law: str) -> tuple[NDArray, NDArray]:
    """Return points of the unit cube with a solved state, and ln w_d/R and ln a/R of the states."""
    unit = qmc.Halton(3, seed=0).random(_STATES)
    lengths = np.array(
        [_lengths(law, row) for row in pd.DataFrame(_inputs(unit)).to_dict("records")]
    )
    solved = np.isfinite(lengths[:, 0])
    return unit[solved], np.log(lengths[solved])


def _inputs(unit: NDArray) -> dict[str, NDArray]:
    """Return the arguments of states at points of the unit cube, with lengths in units of R."""
    stretch, swing, width = unit.T
    # States change fastest where a capsule is nearly slack, so there are more of them there.
    inflation = _between(PRIORS["inflation"], stretch**2)
    base, rise = _USUAL_LOAD
    load = (base + rise * (inflation - 1)) * np.exp(_LOAD_REACH * (2 * swing - 1))
    (low, high), (least, most) = PRIORS["probe_half_width"], PRIORS["capsule_radius"]
    slenderness = _between((low / most, high / least), width)
    return {"inflation": inflation, "load": load, "slenderness": slenderness}


def _between(ends: tuple[float, ...], share: NDArray) -> NDArray:
    return ends[0] + (ends[1] - ends[0]) * share


def _lengths(law: str, inputs: dict[Any, Any]) -> tuple[float, float]:
    """Return depth and rim radius of a capsule of radius, thickness and modulus 1, or NaN."""
    try:
        state = indent_capsule(
            inputs["load"],
            capsule_radius=1.0,
            modulus=1.0,
            thickness=1.0,
            probe_half_width=inputs["slenderness"],
            poisson_ratio=0.5,
            inflation=inputs["inflation"],
            law=law,
        )
    except ValueError:
        return np.nan, np.nan  # draws near a load without a state have no state either
    return state.depth, state.rim_radius
