"""The figure of the front page: the printed outline over a model, and the modulus by that model.

``{front-figure}`` computes the modulus for each choice of rim, model and half-width of the probe.
It writes all results beside a drawing of the first choice; ``_static/front.js`` shows the others.
"""

from __future__ import annotations

import math
import warnings
from functools import cache

import numpy as np
from book_tables import raw_html, script_json
from docutils import nodes
from numpy.typing import NDArray
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from compendium import ledger, thesis
from compendium.experiments.membranes import EGG
from compendium.experiments.section_5_6 import printed_dimple, right_dimple
from microlib.embryo import dimple_geometry
from microlib.membrane import capsule_modulus, dimple_profile

HALF_WIDTHS = np.arange(10.0, 51.0, 2.5)  # µm, about 25 µm
MODELS = {"small": "point load (the thesis)", "capsule": "closed capsule"}
PROFILES = {"small": "point-load model", "capsule": "closed capsule"}
# The drawing has 480 units for 680 µm, and the bottom of the dimple at (282, 130).
SCALE, BOTTOM = 480 / 680, (282.0, 130.0)
REACH = (-400.0, 280.0)  # µm, what is drawn on both sides of the bottom
# The logarithmic axis: where 0.01 MPa stands, and how far away ten times as much.
FIRST, DECADE = 30, 140


def on_axis(modulus: float) -> float:
    """Return where a modulus in MPa stands on the axis."""
    return round(FIRST + DECADE * (math.log10(modulus) + 2), 1)


def path(x: NDArray, z: NDArray) -> str:
    """Return the drawing's path through points, µm from the bottom."""
    points = zip(BOTTOM[0] + SCALE * x, BOTTOM[1] - SCALE * z, strict=True)
    return "M" + " ".join(f"{across:.1f},{down:.1f}" for across, down in points)


def outline() -> tuple[NDArray, NDArray]:
    """Return the outline that Table 5.5 prints, µm from its bottom."""
    curve, pixel = thesis.outline_curve(), thesis.EMBRYO_PIXEL
    x0, y0 = dimple_geometry(curve, pixel_size=pixel).bottom
    x = np.linspace(*REACH, 171)
    return x, pixel * (curve(x0 + x / pixel) - y0)


def dimples() -> dict[str, tuple[float, float]]:
    """Return radius and depth, µm, by the rim that they are read from."""
    return {"left": printed_dimple(), "right": right_dimple()}


def solve(
    model: str, radius: float, depth: float, c: float
) -> tuple[float, NDArray, NDArray] | None:
    """Return the modulus (MPa) and half the section of a model with that dimple, µm.

    It is None where no capsule has such a dimple.
    """
    if model == "small":
        with warnings.catch_warnings(action="ignore"):
            modulus = thesis.modulus(radius, depth, probe_half_width=c)
        r = np.linspace(c, radius, 40)
        return modulus, r, depth - dimple_profile(r, radius, depth, probe_half_width=c)
    walls = thesis.MEMBRANE | {"probe_half_width": c}
    try:
        egg = capsule_modulus(thesis.FORCE, radius, depth, capsule_radius=EGG, **walls)
    except ValueError:
        return None
    seen = (egg.state.r < -REACH[0]) & (egg.state.z > egg.state.z[0] - 1)
    r, z = egg.state.r[seen], egg.state.z[seen] - egg.state.z[0]
    return egg.modulus, r[::5], z[::5]


def deviation(r: NDArray, z: NDArray) -> float:
    """Return the largest distance in height of a model from the printed outline, µm.

    It is taken between both rims, as far as the model is drawn.
    """
    across, height = outline()
    (left, _), (right, _) = dimples().values()
    between = (across >= -min(left, r[-1])) & (across <= min(right, r[-1]))
    return np.abs(np.interp(np.abs(across), r, z) - height)[between].max()


def band_of(model: str, radius: float, depth: float) -> dict[str, object] | None:
    """Return the moduli at both ends of the assumed width of the probe, or None without them."""
    thin, wide = (solve(model, radius, depth, width / 2) for width in thesis.PROBE_WIDTH_ENDS)
    if thin is None or wide is None:
        return None
    left, right = on_axis(wide[0]), on_axis(thin[0])
    text = f"c = 21.25–28.75 µm: {wide[0]:.2f} to {thin[0]:.2f} MPa"
    return {"x": left, "width": round(right - left, 1), "text": text}


@cache
def states() -> dict[str, dict[str, object]]:
    """Return what the figure shows for each choice, by ``rim model half-width``."""
    found: dict[str, dict[str, object]] = {}
    for rim, size in dimples().items():
        bands = {model: band_of(model, *size) for model in MODELS}
        for c in HALF_WIDTHS:
            solved = {model: solve(model, *size, c) for model in MODELS}
            apart = [
                f"the {PROFILES[model]} by up to {deviation(*one[1:]):.0f} µm"
                for model, one in solved.items()
                if one
            ]
            texts = [f"Between the rims, the outline deviates from {' and from '.join(apart)}."]
            if None in solved.values():
                texts += [f"No closed capsule has the radius and depth of the {rim} rim."]
            probe = {"x": BOTTOM[0] - SCALE * c, "width": 2 * SCALE * c}
            for model, one in solved.items():
                state: dict[str, object] = {"path": "", "at": None, "band": None}
                text = " ".join(texts)
                if one:
                    modulus, r, z = one
                    line = path(np.r_[-r[::-1], r], np.r_[z[::-1], z])
                    state = {"path": line, "at": on_axis(modulus), "band": bands[model]}
                    text = f"E = {modulus:.4g} MPa by the {PROFILES[model]}. {text}"
                found[f"{rim} {model} {c:g}"] = {**state, "rim": rim, "text": text, **probe}
    return found


class FrontFigure(SphinxDirective):
    """The figure, by ``_templates/front_figure.html``."""

    def run(self) -> list[nodes.Node]:
        printed, half_width = ledger.claim("table-5.6/E"), thesis.MEMBRANE["probe_half_width"]
        sizes = dimples()
        rims = [
            {"name": name, "x": BOTTOM[0] + SCALE * side * radius, "y": BOTTOM[1] - SCALE * depth}
            for side, (name, (radius, depth)) in zip((-1, 1), sizes.items(), strict=True)
        ]
        context = {
            "ticks": [(on_axis(modulus), f"{modulus:g}") for modulus in (0.01, 0.1, 1.0, 10.0)],
            "printed": printed.printed,
            "printed_at": on_axis(printed.value),
            "outline": path(*outline()),
            "rims": rims,
            "buttons": {rim: f"{rim}, a = {size[0]:.0f} µm" for rim, size in sizes.items()},
            "models": MODELS,
            "half_width": f"{half_width:g}",
            "half_widths": HALF_WIDTHS,
            "state": states()[f"left small {half_width:g}"],
            "states": script_json(states()),
        }
        return [raw_html(self.env.app.builder.templates.render("front_figure.html", context))]


def setup(app: Sphinx) -> None:
    app.add_directive("front-figure", FrontFigure)
