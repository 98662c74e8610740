"""Section 5.6: which membrane draws the printed outline, and what modulus it supports.

Table 5.6 reads one radius and one depth off the outline and puts them into one formula. Here the
same two lengths meet every membrane that `microlib.membrane` solves, with what the thesis does not
print drawn from priors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.optimize import least_squares, minimize_scalar
from scipy.stats import qmc

from compendium import thesis
from compendium.experiments._processes import in_processes
from compendium.experiments.section_5_6 import printed_dimple
from microlib.embryo import GaussianSum, dimple_geometry
from microlib.membrane import (
    capsule_modulus,
    dimple_profile,
    disc_modulus,
    indent_capsule,
    indent_disc,
)

LAWS = ("neo-hooke", "hooke", "mooney-rivlin")
_H, _C = thesis.MEMBRANE["thickness"], thesis.MEMBRANE["probe_half_width"]
#: Radius of an egg's chorion where one value is wanted, the middle of the prior, in µm.
_EGG = 600.0

#: Shapes with the printed radius and depth: a name, and how its membrane is solved.
SHAPES: dict[str, tuple[str, dict[str, Any]]] = {
    "profile (4.2)": ("formula", {}),
    "disc, neo-Hooke": ("disc", {}),
    "disc, Hooke": ("disc", {"law": "hooke"}),
    "disc, Mooney–Rivlin": ("disc", {"law": "mooney-rivlin"}),
    "disc, neo-Hooke, no pressure": ("disc", {"pressure": 0.0}),
    "disc, neo-Hooke, rim drawn in by 5 %": ("disc", {"rim_inset": 0.05}),
    "disc, neo-Hooke, taut by 5 %": ("disc", {"pretension": 0.05}),
    "disc, neo-Hooke, taut by 100 %": ("disc", {"pretension": 1.0}),
    "capsule, neo-Hooke": ("capsule", {"radius": _EGG}),
    "capsule, Hooke": ("capsule", {"radius": _EGG, "law": "hooke"}),
    "capsule, Mooney–Rivlin": ("capsule", {"radius": _EGG, "law": "mooney-rivlin"}),
    "capsule, neo-Hooke, sliding on the probe": (
        "capsule",
        {"radius": _EGG, "punch": "frictionless"},
    ),
    "capsule, neo-Hooke, radius 900 µm": ("capsule", {"radius": 900.0}),
}

#: What the thesis does not print, each drawn evenly between two ends. Thickness (Table 5.6) and
#: half-width (µm), radius of the egg (µm), stretches and inset as in `microlib.membrane`, pressure
#: below a disc in F/(π a²). The laws are alike, E is even in its logarithm, and the crest's place
#: is even over `crest_reach`.
PRIORS: dict[str, tuple[float, float]] = {
    "thickness": (0.8 * _H, 1.2 * _H),
    "probe_half_width": (0.85 * _C, 1.15 * _C),
    "radius": (500.0, 700.0),
    "inflation": (1.0, 1.1),
    "pressure": (0.0, 1.0),
    "pretension": (0.0, 0.05),
    "rim_inset": (0.0, 0.05),
}
#: The same for readers, with the crest's place.
_READ = {
    "thickness": "thickness (µm)",
    "probe_half_width": "half-width of the probe (µm)",
    "radius": "capsule: radius, inflated (µm)",
    "inflation": "capsule: stretch when inflated",
    "pressure": "disc: pressure below it, over F/(π a²)",
    "pretension": "disc: strain before the test",
    "rim_inset": "disc: share by which the rim is drawn in",
    "rim_radius": "crest of the rim (µm)",
}
#: Height in px within which a crest is level: the finest that the image shows.
_LEVEL = 1.0
#: Solved states behind each law of a capsule and of a disc. Left out one by one, they are
#: interpolated to a median of 0.7 % of the depth (tests).
_CAPSULES, _DISCS = 36, 48
#: Force in modulus × thickness × egg radius that dents a capsule by about a fifth of its radius,
#: for the inflation λ: 0.05 + 1.1 (λ − 1), found by trial; and how far the logarithm of the force
#: is drawn to either side. For a disc, the ends of the force in modulus × thickness × rim radius.
_USUAL_LOAD, _LOAD_REACH = (0.05, 1.1), 0.7
_DISC_LOADS = (0.06, 0.9)
_UNIT: dict[str, Any] = {"modulus": 1.0, "radius": 1.0, "thickness": 1.0}
#: Widths to which a shape may be stretched: from a probe's width at the rim to one beyond the egg.
_WIDENING = (0.2, 3.0)


def shape_misfits(curve: GaussianSum) -> pd.DataFrame:
    """Hold the left half of the printed outline against the shape of every membrane.

    Parameters
    ----------
    curve : GaussianSum
        The outline, px.

    Returns
    -------
    pandas.DataFrame
        A row each of `SHAPES`: modulus E (MPa) of the membrane with the outline's radius and depth,
        and as shares of the depth its ``largest`` departure, its ``rms`` departure, and the rms
        that is left (``stretched``) if the shape may be widened, deepened and raised at will, with
        a level shoulder outside.
    """
    r, z, dimple = _left_half(curve)
    radius, depth = dimple.dimple_radius, dimple.dimple_depth
    shapes = in_processes(_shape, [(name, radius, depth) for name in SHAPES])
    rows = []
    for name, (modulus, shape_r, shape_z) in zip(SHAPES, shapes, strict=True):
        off = (z - np.interp(r, shape_r, shape_z)) / depth
        left = _stretched_misfit(r, z, shape_r, shape_z) / depth
        rows.append((name, modulus, np.abs(off).max(), np.sqrt(np.mean(off**2)), left))
    return pd.DataFrame(rows, columns=["shape", "E", "largest", "rms", "stretched"])


@dataclass(frozen=True)
class ShoulderFit:
    """The profile (4.2) with a level shoulder outside, fitted to the printed outline.

    Attributes
    ----------
    radius, depth : float
        a and w_d of the profile, µm.
    misfit : float
        Root mean square distance over the depth.
    modulus : float
        E by (5.2), MPa.
    """

    radius: float
    depth: float
    misfit: float
    modulus: float


def fit_shoulder(curve: GaussianSum) -> ShoulderFit:
    """Fit (4.2) to the left half of the outline with a radius and a depth of its own.

    Parameters
    ----------
    curve : GaussianSum
        The outline, px.

    Returns
    -------
    ShoulderFit
        The nearest profile.
    """
    r, z, dimple = _left_half(curve)
    radius, depth, misfit = _nearest_profile(r, z)
    return ShoulderFit(radius, depth, misfit / dimple.dimple_depth, thesis.modulus(radius, depth))


def crest_reach(curve: GaussianSum) -> tuple[float, float]:
    """Return the least and largest radius of the left crest, µm: where it is level to a pixel.

    Parameters
    ----------
    curve : GaussianSum
        The outline, px.
    """
    dimple = dimple_geometry(curve, pixel_size=thesis.EMBRYO_PIXEL)
    x = np.linspace(curve.domain[0], dimple.bottom[0], 4000)
    below = np.flatnonzero(curve(x) < dimple.rim[1] - _LEVEL)
    crest = int(np.searchsorted(x, dimple.rim[0]))
    outer, inner = x[below[below < crest].max()], x[below[below > crest].min()]
    to_radius = thesis.EMBRYO_PIXEL
    return to_radius * float(dimple.bottom[0] - inner), to_radius * float(dimple.bottom[0] - outer)


def prior_table(crest: tuple[float, float]) -> pd.DataFrame:
    """Return the ends between which each number is drawn, in words, with a crest's."""
    ends = {_READ[name]: reach for name, reach in (PRIORS | {"rim_radius": crest}).items()}
    return pd.DataFrame(ends, index=["from", "to"]).T


def single_readings(crest: tuple[float, float]) -> pd.DataFrame:
    """Change one input of a capsule's modulus at a time, from the middle of each prior.

    Parameters
    ----------
    crest : tuple of float
        From `crest_reach`, µm.

    Returns
    -------
    pandas.DataFrame
        A row each input: its name, and E in MPa at one and at the other end of it, NaN where no
        capsule has this dimple; the first row is the middle itself.
    """
    a, _ = printed_dimple()
    middle = {"rim_radius": a, "radius": _EGG, "thickness": _H, "probe_half_width": _C}
    ends: dict[str, Iterable[dict[str, Any]]] = {
        "middle": [{}, {}],
        "crest of the rim": [{"rim_radius": reach} for reach in crest],
        "radius of the egg": [{"radius": end} for end in PRIORS["radius"]],
        "thickness": [{"thickness": end} for end in PRIORS["thickness"]],
        "width of the probe": [{"probe_half_width": end} for end in PRIORS["probe_half_width"]],
        "law": [{"law": "hooke"}, {"law": "mooney-rivlin"}],
        "grip of the probe": [{"punch": "bonded"}, {"punch": "frictionless"}],
    }
    tasks = [(middle | change,) for changes in ends.values() for change in changes]
    found = np.reshape(in_processes(_capsule_reading, tasks), (-1, 2))
    return pd.DataFrame({"input": list(ends), "one": found[:, 0], "other": found[:, 1]})


def _capsule_reading(settings: dict[str, Any]) -> float:
    _, depth = printed_dimple()
    try:
        return capsule_modulus(thesis.FORCE, depth=depth, **settings).modulus
    except ValueError:
        return float("nan")  # no capsule has this dimple


def modulus_posterior(
    rng: np.random.Generator, membrane: str, crest: tuple[float, float], draws: int = 20_000
) -> pd.DataFrame:
    """Draw what modulus the printed radius and depth support, over all that is not printed.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the draws.
    membrane : {"capsule", "disc"}
        A closed capsule of constant volume on a plate, or a disc with a clamped rim.
    crest : tuple of float
        Least and largest radius of the crest, from `crest_reach`, µm.
    draws : int
        How many.

    Returns
    -------
    pandas.DataFrame
        A row each draw: modulus E (MPa), law, thickness and probe_half_width (µm), rim_radius (µm),
        and radius (µm) and inflation of a capsule, or pressure, pretension and rim_inset of a disc.

    Notes
    -----
    Lengths over the size L of the membrane, R or a, depend on F/(E h L), c/L and the stretches
    alone. States are solved on a quasi-random set of these, and the logarithms of w_d/L and a/L
    interpolated between them. A draw of them has the printed depth at one L only, w_d over w_d/L;
    given that, its weight is the prior of L, of c and of a, times L² from the change of (L, c) to
    (w_d, c/L). A prior of E that is even in ln E is one that is even in ln F/(E h L).
    """
    _, depth = printed_dimple()
    kinds = ("rim_radius", "probe_half_width") + (("radius",) if membrane == "capsule" else ())
    limits = {name: crest if name == "rim_radius" else PRIORS[name] for name in kinds}
    parts = []
    for law, (places, logs) in _solved_states(membrane, crest).items():
        unit = rng.random((draws, places.shape[1]))
        if membrane == "capsule":
            unit[:, 0] = np.sqrt(unit[:, 0])  # even in the inflation, see _inputs
        shape = np.exp(RBFInterpolator(places, logs, kernel="quintic", degree=2)(unit))
        size = depth / shape[:, 0]
        found = pd.DataFrame(_inputs(membrane, unit, crest)).assign(law=law, size=size)
        found["probe_half_width"] = found.pop("slenderness") * size
        found["rim_radius"] = shape[:, -1] * size if membrane == "capsule" else size
        if membrane == "capsule":
            found["radius"] = size
        inside = [found[name].between(*ends) for name, ends in limits.items()]
        parts.append(found.assign(weight=np.all(inside, axis=0) * size**2))
    every = pd.concat(parts, ignore_index=True)
    picked = rng.choice(len(every), draws, p=every["weight"] / every["weight"].sum())
    chosen = every.drop(columns="weight").iloc[picked].reset_index(drop=True)
    chosen["thickness"] = rng.uniform(*PRIORS["thickness"], draws)
    scale = chosen.pop("load") * chosen["thickness"] * chosen.pop("size")
    return chosen.assign(E=thesis.FORCE / scale)


def _solved_states(membrane: str, crest: tuple[float, float]) -> dict[str, tuple[NDArray, NDArray]]:
    """Return by law where in the unit cube states were solved, and ln w_d/L (and ln a/L) there."""
    dimensions, count = (3, _CAPSULES) if membrane == "capsule" else (5, _DISCS)
    unit = qmc.Halton(dimensions, seed=0).random(count)
    columns = _inputs(membrane, unit, crest)
    names = list(columns)
    rows = [dict(zip(names, row, strict=True)) for row in np.transpose(list(columns.values()))]
    lengths = in_processes(_lengths, [(membrane, law, row) for law in LAWS for row in rows])
    found = {}
    for law, part in zip(LAWS, np.reshape(lengths, (len(LAWS), count, 2)), strict=True):
        solved = np.isfinite(part[:, 0])
        found[law] = unit[solved], np.log(part[solved])
    return found


def _inputs(membrane: str, unit: NDArray, crest: tuple[float, float]) -> dict[str, NDArray]:
    """Return what a state is solved from, lengths in its size, at points of the unit cube."""
    low, high = PRIORS["probe_half_width"]
    if membrane == "capsule":
        stretch, swing, width = unit.T
        # States change fastest where a capsule is nearly slack: the root packs them there.
        inflation = _between(PRIORS["inflation"], stretch**2)
        base, rise = _USUAL_LOAD
        load = (base + rise * (inflation - 1)) * np.exp(_LOAD_REACH * (2 * swing - 1))
        least, most = PRIORS["radius"]
        names = {"inflation": inflation, "load": load}
    else:
        swing, below, stretch, inset, width = unit.T
        least, most = crest
        names = {
            "load": np.exp(_between(tuple(np.log(_DISC_LOADS)), swing)),
            "pressure": _between(PRIORS["pressure"], below),
            "pretension": _between(PRIORS["pretension"], stretch),
            "rim_inset": _between(PRIORS["rim_inset"], inset),
        }
    return names | {"slenderness": _between((low / most, high / least), width)}


def _between(ends: tuple[float, ...], share: NDArray) -> NDArray:
    return ends[0] + (ends[1] - ends[0]) * share


def _lengths(membrane: str, law: str, inputs: dict[str, float]) -> tuple[float, float]:
    """Return depth and radius of the rim of a membrane of size, thickness and modulus 1, or NaN."""
    settings: dict[str, Any] = dict(inputs)
    load, half_width = settings.pop("load"), settings.pop("slenderness")
    try:
        if membrane == "capsule":
            state = indent_capsule(load, **_UNIT, probe_half_width=half_width, law=law, **settings)
        else:
            settings["pressure"] *= load / np.pi
            state = indent_disc(load, **_UNIT, probe_half_width=half_width, law=law, **settings)
    except ValueError:
        return float("nan"), float("nan")  # no such state: the draws around it have none either
    return state.depth, state.rim_radius


def _left_half(curve: GaussianSum) -> tuple[NDArray, NDArray, Any]:
    """Return distances from the axis, heights above the rim (both µm), and the dimple."""
    pixel = thesis.EMBRYO_PIXEL
    dimple = dimple_geometry(curve, pixel_size=pixel)
    r = np.linspace(_C, dimple.dimple_radius, 400)
    return r, pixel * (curve(dimple.bottom[0] - r / pixel) - dimple.rim[1]), dimple


def _shape(name: str, radius: float, depth: float) -> tuple[float, NDArray, NDArray]:
    """Return modulus and meridian, from the probe to the rim, of one of `SHAPES`."""
    kind, settings = SHAPES[name]
    if kind == "formula":
        r = np.linspace(_C, radius, 400)
        profile = dimple_profile(r, radius, depth, probe_half_width=_C)
        return thesis.modulus(radius, depth), r, -profile
    sizes = {"thickness": _H, "probe_half_width": _C} | settings
    if kind == "disc":
        modulus = disc_modulus(thesis.FORCE, radius, depth, **sizes)
        state = indent_disc(thesis.FORCE, modulus=modulus, radius=radius, **sizes)
    else:
        found = capsule_modulus(thesis.FORCE, radius, depth, **sizes)
        modulus, state = found.modulus, found.state
    crest = int(np.argmax(state.z)) + 1
    # A wall that slides has points on the probe's face, too.
    outside = state.r[:crest] > (1 - 1e-9) * _C
    z = state.z[:crest][outside]
    return modulus, state.r[:crest][outside], z - z[-1]


def _nearest_profile(r: NDArray, z: NDArray) -> tuple[float, float, float]:
    """Return radius, depth and rms distance (µm) of the profile (4.2), level outside."""

    def off(values: NDArray) -> NDArray:
        radius, depth, top = values
        inside = np.clip(r, _C, radius)
        return z - top + dimple_profile(inside, radius, depth, probe_half_width=_C)

    start = [r.max() / 2, np.ptp(z), z.max()]
    found = least_squares(off, start, bounds=([1.1 * _C, 1.0, -np.inf], np.inf))
    radius, depth, _ = found.x.tolist()
    return radius, depth, float(np.sqrt(np.mean(found.fun**2)))


def _stretched_misfit(r: NDArray, z: NDArray, shape_r: NDArray, shape_z: NDArray) -> float:
    """Return the rms distance in µm of an outline from a shape that may be stretched and raised."""

    def misfit(widening: float) -> float:
        # Beyond its rim the shape goes on level.
        height = np.interp(r, widening * shape_r, shape_z)
        basis = np.stack([np.ones_like(r), height], axis=1)
        left = z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]
        return float(np.sqrt(np.mean(left**2)))

    return float(minimize_scalar(misfit, bounds=_WIDENING, method="bounded").fun)
