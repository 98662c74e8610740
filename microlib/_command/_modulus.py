"""The command ``microlib modulus``."""

from __future__ import annotations

import argparse
import re
import warnings
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from microlib._command._options import add_scales, resolve_scales
from microlib._command._session import End, Session, picture, text
from microlib._common import as_physical, as_scalar, home_path

#: Names of the files that it writes.
FILES = ("table", "look.png")
#: Moduli between which none is noted, MPa: those of a gel and of a metal.
_LEAST_MODULUS, _LARGEST_MODULUS = 0.01, 1e4


def add_options(parser: argparse.ArgumentParser) -> None:
    outline = "table with columns x and y, or col and row, or two columns; px, or µm (x_um, y_um)"
    parser.add_argument("source", metavar="OUTLINE", help=outline)
    add_scales(parser, "force", "force_uncertainty", "pixel_size")
    add_scales(parser, "thickness", "thickness_uncertainty", "probe_half_width", "poisson_ratio")
    parser.add_argument(
        "--y-down", action="store_true", help="y increases downwards, as in an image"
    )


def run(a: argparse.Namespace, session: Session) -> End:
    """Young's modulus of a membrane from the outline of its dimple, by several models.

    The range over the models is the result. The interval of one model covers only the errors of the
    inputs. The guide 07_guide_modulus says which model suits which dimple.

    Example: microlib modulus outline.csv --force 150 --pixel-size 3.9 --thickness 3
    --probe-half-width 25 --poisson-ratio 0.5 -o modulus.csv
    """
    from microlib import membrane
    from microlib._plots import outline
    from microlib.embryo import dimple_from_outline, read_outline

    file = home_path(a.source)
    session.protect([file])
    table = read_outline(file)
    if table.pixel_size is not None and a.pixel_size not in (None, table.pixel_size):
        raise ValueError(f"{a.source} has its points in a unit of length: leave out --pixel-size")
    scales = "force", "pixel_size", "thickness", "probe_half_width", "poisson_ratio"
    values = resolve_scales(a, session, *scales, pixel_size=table.pixel_size)
    size = values.pop("pixel_size")
    uncertainties = {}
    for name, unit in (("force", "µN"), ("thickness", "µm")):
        option = f"{name}_uncertainty"
        given = getattr(a, option)
        uncertainties[name] = as_scalar(option, given or 0.0, least=0)
        if given is not None:
            session.say(f"{option} {given:g} {unit} (given)")
    down = a.y_down or table.y_down
    measured = dimple_from_outline(table.x, -table.y if down else table.y, pixel_size=size)
    if measured.y_down:
        if a.y_down:
            raise ValueError(f"{a.source} has its dimple where y runs up: leave out --y-down")
        seen = "up" if down else "down"
        session.note(f"{a.source}: read with y pointing {seen}, because only so it has one dimple")
    sides = measured.left, measured.right
    shapes = {n: [getattr(side, n) for side in sides] for n in ("rim_radius", "dimple_depth")}
    moduli = membrane.elastic_modulus(**values, **shapes)  # warns once for both rims
    (left, left_text), (right, right_text) = (
        _estimate(side, as_physical("modulus", value), values, uncertainties)
        for side, value in zip(sides, moduli, strict=True)
    )
    if not _LEAST_MODULUS < moduli[0] < _LARGEST_MODULUS:
        session.note(
            f"{moduli[0]:.2g} MPa is seldom that of a membrane: is the unit of --force right, as "
            "in 0.2mN?"
        )
    low, high = "modulus_low_MPa", "modulus_high_MPa"
    if max(left[low], right[low]) > min(left[high], right[high]):
        session.note(
            f"{a.source}: the moduli of the two rims differ by more than their intervals; "
            "is the outline tilted?"
        )
    least, most = (f"modulus_{end}_over_models_MPa" for end in ("low", "high"))
    ends = min(left[least], right[least]), max(left[most], right[most])
    headline = f"E = {ends[0]:.2g} to {ends[1]:.2g} MPa over all models and both rims"
    session.say(f"{headline}\nleft rim, as in the thesis: {left_text}\nright rim: {right_text}")
    result = left | {f"right_{name}": value for name, value in right.items()}
    lines = [f"{name},{value:.5g},{_unit(name)}" for name, value in result.items()]
    session.write("table", text("\n".join(["quantity,value,unit", *lines, ""])))
    points = {"left rim": measured.left.rim, "bottom": measured.left.bottom}
    points["right rim"] = measured.right.rim
    dense = np.linspace(*measured.curve.domain, 1000)
    curve = np.stack([dense, measured.curve(dense)])
    drawn = partial(outline, measured.x, measured.y, curve, points, headline)
    session.write("look.png", picture(drawn))
    session.say("The guide 07_guide_modulus says which model suits which dimple.")
    return End()


def _unit(quantity: str) -> str:
    """Return the unit of a row of the table."""
    if quantity.endswith("_MPa"):
        return "MPa"
    base = quantity.removeprefix("right_").removesuffix("_uncertainty")
    return {"force": "µN", "poisson_ratio": ""}.get(base, "µm")


def _estimate(
    dimple: Any, value: float, values: dict[str, float], uncertainties: dict[str, float]
) -> tuple[dict[str, float], str]:
    """Return a modulus with its uncertainty, its inputs and other models, and a summary."""
    from microlib import membrane
    from microlib.estimate import Estimate

    values = values | {"rim_radius": dimple.rim_radius, "dimple_depth": dimple.dimple_depth}
    radius, depth = np.sqrt(np.diag(dimple.covariance)).tolist()
    uncertainties = uncertainties | {"rim_radius": radius, "dimple_depth": depth}
    samples = membrane.modulus_samples(values, uncertainties, size=100_000, rng=1)
    low, high = np.quantile(samples, [0.025, 0.975]).tolist()
    uncertainty = membrane.modulus_uncertainty(values, uncertainties)
    modulus = Estimate(value, uncertainty, low, high, "MPa")
    row = {
        "modulus_MPa": modulus.value,
        "modulus_uncertainty_MPa": modulus.uncertainty,
        "modulus_low_MPa": modulus.low,
        "modulus_high_MPa": modulus.high,
        "finite_slope_modulus_MPa": np.nan,
    }
    with warnings.catch_warnings(action="ignore"):  # elastic_modulus has given the same warnings
        with suppress(ValueError):  # no uniform stress has a dimple as deep as this
            row["finite_slope_modulus_MPa"] = membrane.finite_slope_modulus(**values)
        moduli = membrane.model_moduli(**values)
    # Errors of the inputs change every model by nearly the same factor.
    row["modulus_low_over_models_MPa"] = min(moduli.values()) * low / value
    row["modulus_high_over_models_MPa"] = max(moduli.values()) * high / value
    del moduli["point load"]
    row |= {f"{re.sub('[^a-z]+', '_', model)}_MPa": other for model, other in moduli.items()}
    row |= values | {f"{name}_uncertainty": number for name, number in uncertainties.items()}
    least, most = min(moduli.values(), default=np.nan), max(moduli.values(), default=np.nan)
    others = f", {least:.2g} to {most:.2g} MPa by {len(moduli)} others" if moduli else ""
    return row, (
        f"{modulus} by (5.2){others}\n"
        f"a = {dimple.rim_radius:.1f} ± {radius:.1f} µm, "
        f"w_d = {dimple.dimple_depth:.1f} ± {depth:.1f} µm"
    )
