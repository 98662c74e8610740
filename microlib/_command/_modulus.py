"""The command ``microlib modulus``."""

from __future__ import annotations

import argparse
import re
from functools import partial

import numpy as np

from microlib._command._shared import Files, add_scales, picture, settle, text
from microlib._common import Array, as_array, home_path

#: Spans of LOESS whose dimples are compared; the middle one is that of the thesis.
_SPANS = (0.15, 0.25, 0.35)
_SIZES = ("dimple_radius", "dimple_depth")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(files=["table", "look.png"])
    outline = "CSV file with columns x, y in px, or with two columns"
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
    from microlib.embryo import dimple_geometry, fit_gaussians, loess

    a.protect([home_path(a.source)])
    x, y = _outline(a)
    values = settle(a, "force", "pixel_size", "thickness", "probe_half_width", "poisson_ratio")
    size = values.pop("pixel_size")
    stds = {"force": a.force_std or 0.0, "thickness": a.thickness_std or 0.0}
    curves = [fit_gaussians(x, loess(x, y, span=span)) for span in _SPANS]
    result: dict[str, float] = {}
    points: dict[str, tuple[float, float]] = {}
    titles = []
    for rim, prefix in (("left", ""), ("right", "right_rim_")):
        each = [dimple_geometry(curve, pixel_size=size, rim=rim) for curve in curves]
        sizes = np.array([[getattr(dimple, name) for name in _SIZES] for dimple in each])
        # What the smoothing decides, and the noise of the points.
        spread = np.sqrt(sizes.var(axis=0, ddof=1) + np.diag(each[1].covariance))
        values |= zip(_SIZES, sizes[1].tolist(), strict=True)
        stds |= zip(_SIZES, spread.tolist(), strict=True)
        told, found = _estimate(values, stds)
        result |= {prefix + name: value for name, value in found.items()}
        points |= {f"{rim} rim": each[1].rim, "bottom": each[1].bottom}
        titles.append(f"{rim} rim{', as in the thesis' * (rim == 'left')}: {told}")
        a.say(titles[-1])
    lines = ["quantity,value", *(f"{name},{value:.10g}" for name, value in result.items()), ""]
    yield "table", text("\n".join(lines))
    yield "look.png", picture(partial(outline, x, y, curves[1], points, "\n".join(titles)))
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


def _outline(a: argparse.Namespace) -> tuple[Array, Array]:
    """Read an outline, and keep what is around its dimple: x ascending, the lowest point at 0."""
    x, y = _points(a.source)
    y = -y if a.y_down else y
    (bottom, rim, _, inside), upside_down = _dip(y), _dip(-y)
    # An egg's outline upside down is deepest beside its dimple, up to where the outline ends.
    if upside_down[3] and not inside and upside_down[2] > 0.1 * np.ptp(y):
        if a.y_down:
            raise ValueError(f"{a.source} has its dimple where y runs up: leave out --y-down")
        a.note(f"{a.source}: y is taken to run down, where its dimple is")
        y, (bottom, rim, *_) = -y, upside_down
    # Eight Gaussians describe well what is within two radii of the bottom.
    near = np.abs(x - x[bottom]) <= (2 * (x[bottom] - x[rim]) or np.inf)
    return x[near], y[near] - y[near].min()


def _dip(y: Array) -> tuple[int, int, float, bool]:
    """Return where a curve lies deepest between higher parts, and where the left one is, how deep,
    and whether both are more than where the outline begins and ends."""
    left, right = np.maximum.accumulate(y), np.maximum.accumulate(y[::-1])[::-1]
    depths = np.minimum(left, right) - y
    bottom = int(np.argmax(depths))
    rims = int(np.argmax(y[: bottom + 1])), bottom + int(np.argmax(y[bottom:]))
    inside = min(rims[0], len(y) - 1 - rims[1]) > len(y) // 20
    return bottom, rims[0], float(depths[bottom]), inside


def _points(path: str) -> tuple[Array, Array]:
    """Read two columns of numbers: comma, semicolon, tab or spaces between; decimal point or comma;
    a line of names, among them x and y or col and row, or none; comments behind #."""
    data = home_path(path).read_bytes()
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    if re.search(r"[;\t]|\d,\d+ +[-+.\d]", text):  # then a comma is a decimal one
        text = text.replace(",", ".")
    # A unit in brackets belongs to the name before it.
    lines = [re.sub(r'["]|\s*[([].*?[])]|#.*', "", line).strip() for line in text.splitlines()]
    rows = {k: re.split(r"[;,\s]\s*", line.lower()) for k, line in enumerate(lines, 1) if line}
    columns = [0, 1]
    if rows and re.match(r"[^\W\d]", (names := next(iter(rows.values())))[-1]):
        del rows[next(iter(rows))]
        if re.search("[uµm]m", " ".join(names)):
            raise ValueError(f"{path} must hold x and y in px, got {', '.join(names)}")
        for k, known in enumerate(("x|col", "y|row")):
            columns[k] = next(
                (i for i, name in enumerate(names) if re.match(known, name)), len(names)
            )
    points = []
    need = f"{path} must be a table of numbers in columns x and y"
    for k, row in rows.items():
        try:
            points.append([float(row[column]) for column in columns])
        except (LookupError, ValueError):
            raise ValueError(f"{need}, got line {k}: {lines[k - 1]!r}") from None
    if not points:
        raise ValueError(f"{need}, got none")
    x, y = np.transpose(sorted(points, key=lambda point: point[0]))
    return as_array(path, x), as_array(path, y)
