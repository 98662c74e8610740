"""The command ``microlib``: four tasks on files of one's own, each a few calls of the library."""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Mapping, Sequence
from math import ceil, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import microlib
from microlib._common import Array, replace_file

#: How a progress bar is shown: in a terminal only, and not kept.
_BAR: dict[str, Any] = {"disable": None, "leave": False}
#: Most corners of the mesh that `depth` writes.
_VERTICES = 250_000
#: Spans of LOESS whose dimples are compared; the middle one is that of the thesis.
_SPANS = (0.15, 0.25, 0.35)
#: Radii to either side of a dimple's bottom that eight Gaussians describe well.
_REACH = 2.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, 2 for what cannot work."""
    a = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: tqdm.write(f"note: {message}", sys.stderr)
        try:
            a.run(a)
        except (OSError, ValueError, ImportError) as error:
            file = getattr(error, "filename", None)
            text = f"{file}: {error.args[1]}" if file else str(error)
            print(f"microlib {a.task}: {text}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print(f"microlib {a.task}: stopped", file=sys.stderr)
            return 130
    return 0


def depth(a: argparse.Namespace) -> None:
    """Height of every pixel of a focal stack."""
    from microlib.focus import depth_from_focus
    from microlib.io import read_frames, write_height_tiff, write_ply

    part = {"region": a.region and tuple(a.region), "reduce": a.reduce}
    frames = read_frames(a.stack, **part)
    z, size = frames.positions, frames.pixel_size
    told = {
        "spacing": None if z is None or a.spacing else float(np.diff(z).mean()),
        "pixel_size": size and size / a.reduce,
    }
    scales = _settle(a.stack, {"spacing": a.spacing, "pixel_size": a.pixel_size}, told)
    given = {"positions": z} if a.spacing is None else {"spacing": a.spacing}
    with tqdm(unit=" frames", **_BAR) as bar:

        def progress(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        found = depth_from_focus(
            a.stack, **given, register=a.register, workers=a.workers, progress=progress, **part
        )
    size = scales["pixel_size"] * a.reduce
    a.out.mkdir(parents=True, exist_ok=True)
    maps = {
        "height": (found.depth, "heights in µm"),
        "uncertainty": (found.uncertainty, "error to be expected of each height, µm"),
        "frame": (found.index, "number of the frame nearest to focus, from 0; -1 where unknown"),
        "all_in_focus": (found.all_in_focus, "every pixel from that frame"),
    }
    for name, (values, what) in maps.items():
        write_height_tiff(a.out / f"{name}.ome.tif", values, pixel_size=size, what=what)
    if found.to_dict()["known"]:
        seen = found.all_in_focus.astype(np.float64)
        grey = np.uint8(255 * seen / max(seen.max(), 1))
        step = max(1, ceil(sqrt(found.depth.size / _VERTICES)))
        write_ply(a.out / "surface.ply", found.depth, pixel_size=size, image=grey, step=step)
    _write(a.out / "summary.json", json.dumps(found.to_dict() | scales, indent=2))
    print(f"{found}\n{a.out}: {', '.join(maps)} (OME-TIFF), surface.ply, summary.json")


def calibrate(a: argparse.Namespace) -> None:
    """Magnification, pose and distortion of a microscope from one photograph of a pattern."""
    from microlib import calibration
    from microlib.io import read_grey

    image = read_grey(a.photo)
    scales = _settle(a.photo, {"pitch": a.pitch, "cell": a.cell}, {})
    if a.marks == "squares":
        found = calibration.detect_squares(image)
    else:
        found = calibration.detect_circles(image, lattice=a.lattice)
    print(found)
    result = calibration.calibrate(
        found, pitch=scales["pitch"], pixel_size=scales["cell"], focal_length=a.focal_length
    )
    a.out.mkdir(parents=True, exist_ok=True)
    _write(a.out / "points.csv", found.to_frame())
    _write(a.out / "camera.csv", result.to_frame())
    _write(a.out / "camera.json", result.to_json())
    print(f"{result}\n{a.out}: camera.csv, camera.json (OpenCV, Micro-Manager, ImageJ), points.csv")


def track(a: argparse.Namespace) -> None:
    """Position of a part in every frame of a film."""
    from microlib.io import read_frames
    from microlib.tracking import track_all

    frames = read_frames(a.video, color=True)
    size = frames.pixel_size if a.pixel_size is None else a.pixel_size
    if size is not None:
        _settle(a.video, {"pixel_size": a.pixel_size}, {"pixel_size": frames.pixel_size})
    film = tqdm(frames, total=frames.count, unit=" frames", **_BAR)
    table = track_all(film, tuple(a.box), a.motion, rate=a.rate)
    if size is not None:
        for axis in "xy":
            table[f"{axis}_um"] = size * (table[f"center_{axis}"] - table[f"center_{axis}"].iloc[0])
    _write(a.out, table)
    print(f"lost in {int(table['lost'].sum())} of {len(table)} frames")
    units = ["px", *["µm"] * (size is not None), *["s"] * (a.rate is not None)]
    print(f"{a.out}: one row a frame, in {', '.join(units)}")


def modulus(a: argparse.Namespace) -> None:
    """Young's modulus of a membrane from the outline of its dimple, as section 5.6 finds it."""
    from microlib import membrane
    from microlib.embryo import dimple_geometry, fit_gaussians, loess

    x, y = _outline(a.outline)
    asked = ("force", "pixel_size", "thickness", "probe_half_width")
    scales = _settle(a.outline, {name: getattr(a, name) for name in asked}, {})
    size = scales.pop("pixel_size")
    curves = [fit_gaussians(x, loess(x, y, span=span)) for span in _SPANS]
    each = [dimple_geometry(curve, pixel_size=size) for curve in curves]
    sizes = np.array([(dimple.dimple_radius, dimple.dimple_depth) for dimple in each])
    radius, depth = sizes[1].tolist()
    # What the smoothing decides, and the noise of the points.
    std = np.sqrt(sizes.var(axis=0, ddof=1) + np.diag(each[1].covariance))
    values = scales | {"dimple_radius": radius, "dimple_depth": depth, "poisson_ratio": a.poisson}
    stds = {"dimple_radius": std[0], "dimple_depth": std[1], "force": a.force_std}
    stds |= {"thickness": a.thickness_std}
    result = {"modulus_MPa": float(membrane.elastic_modulus(**values))}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", membrane.SmallSlopeWarning)  # told once, above
        samples = membrane.modulus_samples(values, stds, size=100_000, rng=1)
        result["finite_slope_modulus_MPa"] = float(membrane.finite_slope_modulus(**values))
    low, high = np.quantile(samples, [0.025, 0.975]).tolist()
    result |= {"modulus_low95_MPa": low, "modulus_high95_MPa": high} | values
    result |= {f"{name}_std": float(value) for name, value in stds.items()}
    _write(a.out, "quantity,value\n" + "".join(f"{k},{v:.10g}\n" for k, v in result.items()))
    print(f"a = {radius:.1f} ± {std[0]:.1f} µm, w_d = {depth:.1f} ± {std[1]:.1f} µm")
    print(f"E = {result['modulus_MPa']:.4g} MPa, 95 % between {low:.4g} and {high:.4g} MPa")
    print(f"{a.out}: the modulus, its interval, and what it was computed from")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="microlib", description=microlib.__doc__.splitlines()[0])
    parser.add_argument("--version", action="version", version=microlib.__version__)
    tasks = parser.add_subparsers(dest="task", required=True, metavar="TASK")

    def task(run: Any, example: str, source: str, help: str, out: str) -> argparse.ArgumentParser:
        about = run.__doc__
        sub = tasks.add_parser(
            run.__name__, help=about, description=about, epilog=f"Example: microlib {example}"
        )
        sub.set_defaults(run=run)
        sub.add_argument(source, metavar=source.upper(), help=help)
        sub.add_argument("-o", "--out", required=True, type=Path, metavar="OUT", help=out)
        return sub

    def lengths(sub: argparse.ArgumentParser, **options: str) -> None:
        for name, help in options.items():
            sub.add_argument(f"--{name.replace('_', '-')}", type=float, metavar="VALUE", help=help)

    folder, pixel = "folder for the results", "µm/px in the object plane, if the file does not say"
    sub = task(
        depth,
        "depth scan.tif --spacing 25 --pixel-size 3.9 -o heights",
        "stack",
        "TIFF, OME-TIFF, zarr, video, folder or quoted pattern; one frame a focus position",
        folder,
    )
    lengths(sub, spacing="µm between frames, if the file does not say", pixel_size=pixel)
    sub.add_argument("--register", action="store_true", help="undo motion from frame to frame")
    sub.add_argument("--region", nargs=4, type=int, metavar=("X", "Y", "W", "H"), help="part, px")
    sub.add_argument("--reduce", type=int, default=1, metavar="N", help="N×N px become one")
    sub.add_argument("--workers", type=int, default=1, metavar="N", help="threads")

    example = "calibrate grid.png --pitch 200 --cell 4.8 --focal-length 126000 -o camera"
    sub = task(calibrate, example, "photo", "image of a grid of circles or squares", folder)
    lengths(
        sub,
        pitch="µm between the middles of neighboring marks",
        cell="µm, size of a cell of the camera's sensor",
        focal_length="µm, of the objective, from its maker; without it, it is estimated",
    )
    sub.add_argument("--marks", choices=["circles", "squares"], default="circles", help="of it")
    lattices = ["square", "hexagonal", "asymmetric"]
    sub.add_argument("--lattice", choices=lattices, default="square", help="of circles")

    example = "track film.avi --box 30 40 64 64 --rate 33 -o track.csv"
    sub = task(track, example, "video", "video, TIFF, folder or quoted pattern", "CSV file")
    box = "the part in the first frame, px"
    sub.add_argument(
        "--box", nargs=4, type=int, required=True, metavar=("X", "Y", "W", "H"), help=box
    )
    motions = ["translation", "affine", "homography"]
    sub.add_argument("--motion", choices=motions, default="translation", help="how the part moves")
    lengths(sub, rate="frames per second, for a column of times", pixel_size=pixel)

    example = (
        "modulus outline.csv --force 150 --pixel-size 3.9 --thickness 3 "
        "--probe-half-width 25 -o modulus.csv"
    )
    sub = task(modulus, example, "outline", "CSV file with columns x, y in px, y up", "CSV file")
    lengths(
        sub,
        force="µN",
        pixel_size="µm/px in the object plane",
        thickness="µm, of the membrane",
        probe_half_width="µm",
    )
    for name in ("force-std", "thickness-std"):
        sub.add_argument(f"--{name}", type=float, default=0.0, metavar="VALUE")
    sub.add_argument("--poisson", type=float, default=0.5, metavar="VALUE", help="ratio, 0.5")
    return parser


def _settle(
    path: str, given: Mapping[str, float | None], told: Mapping[str, float | None]
) -> dict[str, float]:
    """Return each scale, as given or told by the file, and print which; ask for the missing."""
    values = {name: told.get(name) if value is None else value for name, value in given.items()}
    missing = [f"--{name.replace('_', '-')} VALUE" for name in values if values[name] is None]
    if missing:
        raise ValueError(f"{path} does not tell its scale: give {', '.join(missing)}")
    for name, value in values.items():
        print(f"{name} {value:g} ({'the file' if given[name] is None else 'given'})")
    return {name: float(value) for name, value in values.items() if value is not None}


def _outline(path: str) -> tuple[Array, Array]:
    """Read an outline, and keep what is around its dimple: x ascending, the lowest point at 0."""
    import pandas as pd

    try:
        table = pd.read_csv(path, skipinitialspace=True)[["x", "y"]]
        x, y = table.sort_values("x", kind="stable").to_numpy(np.float64).T
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} must be a CSV file of numbers in columns x and y") from error
    if len(x):
        left, right = np.maximum.accumulate(y), np.maximum.accumulate(y[::-1])[::-1]
        bottom = int(np.argmax(np.minimum(left, right) - y))
        reach = _REACH * (x[bottom] - x[np.argmax(y[: bottom + 1])])
        near = np.abs(x - x[bottom]) <= (reach or np.inf)
        x, y = x[near], y[near]
    return x, y - y.min(initial=np.inf)


def _write(path: Path, content: Any) -> None:
    """Write a text, or a table as CSV, whole or not at all."""
    if not isinstance(content, str):
        content = content.to_csv(lineterminator="\n", index=content.index.name is not None)
    replace_file(path, lambda file: file.write_text(content, encoding="utf-8"))
