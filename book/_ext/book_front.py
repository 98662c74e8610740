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

HALF_WIDTHS = np.arange(10.0, 51.0, 2.5)  # µm, about the 25 µm of the catalogue
MODELS = {"small": "small slopes", "capsule": "closed capsule"}
PROFILES = {"small": "small-slope model", "capsule": "closed capsule"}
# The drawing, in its own units: as wide as 680 µm, the bottom of the dimple at (280, 130).
WIDTH, HEIGHT, SCALE, BOTTOM = 480, 305, 480 / 680, (282.0, 130.0)
REACH = (-400.0, 280.0)  # µm, what is drawn on both sides of the bottom
# The logarithmic axis: its height, and where 0.01 MPa and ten times as much stand.
AXIS, FIRST, DECADE = 235, 30, 140


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


def solve(model: str, radius: float, depth: float, c: float) -> tuple[float, NDArray, NDArray]:
    """Return the modulus (MPa) and half the section of a model with that dimple, µm.

    Raises
    ------
    ValueError
        If no capsule has such a dimple.
    """
    if model == "small":
        with warnings.catch_warnings(action="ignore"):
            modulus = thesis.modulus(radius, depth, probe_half_width=c)
        r = np.linspace(c, radius, 40)
        return modulus, r, depth - dimple_profile(r, radius, depth, probe_half_width=c)
    walls = {"thickness": thesis.MEMBRANE["thickness"], "probe_half_width": c}
    egg = capsule_modulus(thesis.FORCE, radius, depth, radius=EGG, **walls)
    seen = (egg.state.r < -REACH[0]) & (egg.state.z > egg.state.z[0] - 1)
    r, z = egg.state.r[seen], egg.state.z[seen] - egg.state.z[0]
    return egg.modulus, r[::5], z[::5]


def deviation(rim: str, radius: float, r: NDArray, z: NDArray) -> float:
    """Return the largest distance in height of a model from the printed outline, µm.

    It is taken on the side of the chosen rim, from the probe to the rim.
    """
    across, height = outline()
    side = -1 if rim == "left" else 1
    return np.abs(z - np.interp(side * r, across, height))[r <= radius].max()


def attempt(
    model: str, radius: float, depth: float, c: float
) -> tuple[float, NDArray, NDArray] | None:
    """Return what `solve` does, or None where no capsule has such a dimple."""
    try:
        return solve(model, radius, depth, c)
    except ValueError:
        return None


def band_of(model: str, radius: float, depth: float) -> dict[str, object] | None:
    """Return the moduli at both ends of the specified width of the probe, or None without them."""
    thin, wide = (attempt(model, radius, depth, width / 2) for width in thesis.PROBE_WIDTH_ENDS)
    if thin is None or wide is None:
        return None
    left, right = on_axis(wide[0]), on_axis(thin[0])
    text = f"probe 42.5–57.5 µm: {wide[0]:.2f} to {thin[0]:.2f} MPa"
    return {"x": left, "width": round(right - left, 1), "text": text}


@cache
def states() -> dict[str, dict[str, object]]:
    """Return what the figure shows for each choice, by ``rim model half-width``."""
    found: dict[str, dict[str, object]] = {}
    for rim, size in dimples().items():
        bands = {model: band_of(model, *size) for model in MODELS}
        for c in HALF_WIDTHS:
            solved = {model: attempt(model, *size, c) for model in MODELS}
            texts = [
                f"The {PROFILES[model]} deviates from the outline by up to "
                f"{deviation(rim, size[0], *one[1:]):.0f} µm."
                if one
                else f"No closed capsule has a dimple with the radius and depth of the {rim} rim."
                for model, one in solved.items()
            ]
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


def draw(state: dict) -> str:
    """Return the drawing of one choice; the script changes what has a ``data-part``."""
    printed = ledger.claim("table-5.6/E")
    at, band = on_axis(printed.value), state["band"]
    ticks = "".join(
        f'<path d="M{at},{AXIS - 5}v10"/><text x="{at}" y="{AXIS + 22}">{modulus:g}</text>'
        for modulus in (0.01, 0.1, 1.0, 10.0)
        for at in (on_axis(modulus),)
    )
    rims = ""
    for rim, (radius, depth) in dimples().items():
        across = BOTTOM[0] + SCALE * (-radius if rim == "left" else radius)
        up = BOTTOM[1] - SCALE * depth
        taken = " taken" if rim == state["rim"] else ""
        rims += f'<path class="rim{taken}" data-part="{rim}" d="M{across:.1f},{up - 6:.1f}v30"/>'
        rims += f'<text x="{across:.1f}" y="{up - 12:.1f}">{rim} rim</text>'
    low_end = f'y="{AXIS + 58}"'
    return f"""<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-labelledby="front-title">
<title id="front-title">The printed outline of the dimple, its two rims, the probe and the profile
of a model. Below, the modulus on a logarithmic axis, the printed number, and the range of the
modulus for widths of the probe from 42.5 to 57.5 µm.</title>
<rect class="probe" data-part="probe" x="{state["x"]}" y="8" width="{state["width"]}"
 height="{BOTTOM[1] - 8}"/><path class="outline" d="{path(*outline())}"/>
<path class="model" data-part="model" d="{state["path"]}"/>{rims}
<g class="key"><path class="outline" d="M5,150h30"/><text x="40" y="155">printed outline</text>
<path class="model" d="M170,150h30"/><text x="206" y="155">model</text>
<rect class="probe" x="275" y="142" width="30" height="14"/>
<text x="311" y="155">probe, 2c wide</text></g>
<g data-part="band">
<rect class="band" x="{band["x"]}" y="{AXIS - 22}" width="{band["width"]}" height="44"/>
<text x="{WIDTH / 2}" y="{AXIS - 30}">{band["text"]}</text></g>
<g class="axis"><path d="M{FIRST},{AXIS}H{FIRST + 3 * DECADE}"/>{ticks}</g>
<path class="printed" d="M{at},{AXIS - 22}v65"/>
<text x="{at}" {low_end}>printed {printed.printed} MPa</text>
<text class="key" x="5" {low_end}>modulus E (MPa)</text>
<circle class="found" data-part="found" cx="{state["at"]}" cy="{AXIS}" r="8"/></svg>"""


class FrontFigure(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        def choices(legend: str, name: str, words: dict[str, str]) -> str:
            buttons = "".join(
                f'<label><input type="radio" name="{name}" value="{value}"'
                f"{' checked' if value == next(iter(words)) else ''}> {word}</label>"
                for value, word in words.items()
            )
            return f"<fieldset><legend>{legend}</legend>{buttons}</fieldset>"

        first = f"left small {thesis.MEMBRANE['probe_half_width']:g}"
        ends = f'min="{HALF_WIDTHS[0]}" max="{HALF_WIDTHS[-1]}" step="{np.diff(HALF_WIDTHS)[0]}"'
        rims = {rim: f"{rim}, a = {size[0]:.0f} µm" for rim, size in dimples().items()}
        state, text = states()[first], script_json(states())
        html = f"""<figure class="front-figure">{draw(state)}
<p class="told" role="status">{state["text"]}</p>
<form hidden>{choices("Rim", "rim", rims)}{choices("Model", "model", MODELS)}
<label class="width">Half-width of the probe, c = <output>25</output> µm
<input type="range" name="width" {ends} value="{first.split()[-1]}"></label></form>
<script type="application/json">{text}</script></figure>"""
        return [raw_html(html)]


def setup(app: Sphinx) -> None:
    app.add_directive("front-figure", FrontFigure)
