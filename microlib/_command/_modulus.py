"""The command ``microlib modulus``."""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np

from microlib._command._shared import Files, add_scales, picture, settle, text
from microlib._common import home_path

_SIZES = ("dimple_radius", "dimple_depth")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(files=["table", "look.png"])
    outline = "table with columns x, y, or col, row, or with two columns; in px, or as named (y_um)"
    parser.add_argument("source", metavar="OUTLINE", help=outline)
    add_scales(parser, "force", "force_std", "pixel_size", "thickness", "thickness_std")
    add_scales(parser, "probe_half_width", "poisson_ratio")
    parser.add_argument("--y-down", action="store_true", help="y runs down, as an image's rows do")


def run(a: argparse.Namespace) -> Files:
    """Young's modulus of a membrane from the outline of its dimple, as in section 5.6.

    Example: microlib modulus outline.csv --force 150 --pixel-size 3.9 --thickness 3
    --probe-half-width 25 --poisson-ratio 0.5 -o modulus.csv
    """
    from microlib._plots import outline
    from microlib.embryo import dimple_from_outline, read_outline

    file = home_path(a.source)
    a.protect([file])
    table = read_outline(file)
    if table.pixel_size is not None and a.pixel_size not in (None, table.pixel_size):
        raise ValueError(f"{a.source} has its points in a unit of length: leave out --pixel-size")
    scales = "force", "pixel_size", "thickness", "probe_half_width", "poisson_ratio"
    values = settle(a, *scales, pixel_size=table.pixel_size)
    size = values.pop("pixel_size")
    stds = {"force": a.force_std or 0.0, "thickness": a.thickness_std or 0.0}
    down = a.y_down or table.y_down
    measured = dimple_from_outline(table.x, -table.y if down else table.y, pixel_size=size)
    if measured.y_down:
        if a.y_down:
            raise ValueError(f"{a.source} has its dimple where y runs up: leave out --y-down")
        a.note(f"{a.source}: y is taken to run {'up' if down else 'down'}, where its dimple is")
    result: dict[str, float] = {}
    points: dict[str, tuple[float, float]] = {}
    titles, intervals = [], []
    for rim, prefix, dimple in (
        ("left", "", measured.left),
        ("right", "right_rim_", measured.right),
    ):
        values |= {name: getattr(dimple, name) for name in _SIZES}
        stds |= zip(_SIZES, np.sqrt(np.diag(dimple.covariance)).tolist(), strict=True)
        told, found = _estimate(values, stds)
        result |= {prefix + name: value for name, value in found.items()}
        points |= {f"{rim} rim": dimple.rim, "bottom": dimple.bottom}
        titles.append(f"{rim} rim{', as in the thesis' * (rim == 'left')}: {told}")
        intervals.append((found["modulus_low95_MPa"], found["modulus_high95_MPa"]))
        a.say(titles[-1])
    if max(low for low, _ in intervals) > min(high for _, high in intervals):
        a.note(f"{a.source}: the moduli of the two rims differ by more than their intervals")
    lines = ["quantity,value", *(f"{name},{value:.10g}" for name, value in result.items()), ""]
    yield "table", text("\n".join(lines))
    drawn = partial(outline, measured.x, measured.y, measured.curve, points, "\n".join(titles))
    yield "look.png", picture(drawn)
    a.say("the modulus, its interval, and what it was computed from:")


def _estimate(values: dict[str, float], stds: dict[str, float]) -> tuple[str, dict[str, float]]:
    """Return the modulus of a dimple, in words and in numbers."""
    from microlib import membrane

    modulus = float(membrane.elastic_modulus(**values))
    finite = float(membrane.finite_slope_modulus(**values))
    samples = membrane.modulus_samples(values, stds, size=100_000, rng=1)
    low, high = np.quantile(samples, [0.025, 0.975]).tolist()
    a, depth = (f"{values[name]:.1f} ± {stds[name]:.1f} µm" for name in _SIZES)
    told = (
        f"E = {modulus:.4g} MPa, 95 % between {low:.4g} and {high:.4g} MPa\na = {a}, w_d = {depth}"
    )
    found = {"modulus_MPa": modulus, "finite_slope_modulus_MPa": finite}
    found |= {"modulus_low95_MPa": low, "modulus_high95_MPa": high} | values
    return told, found | {f"{name}_std": std for name, std in stds.items()}
