"""Write the small canonical inputs of this folder and their manifest: ``make data``.

Each is a rendered scene with known truth, for trying the guides and the library without a
microscope; the guides hold themselves against them. The manifest holds what each file is, what a
guide must be told of it, and its truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import tifffile

from compendium import thesis
from compendium.experiments.section_5_3 import texture_sequence
from compendium.guides import FOLDER
from microlib.io import write_height_tiff
from microlib.microscope import Microscope
from microlib.synthetic import (
    Embryo,
    ImagingConditions,
    embryo_image,
    focal_stack,
    mixed_texture,
    render_circles,
    sphere_on_plane,
)

SEED = 2008
MEMBRANE = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}  # µm, µm, no unit


#: What the manifest says of a file: ``what`` it is, a ``truth_file`` with a truth that is an array,
#: the ``settings`` of a guide that go with it, and the ``truth``: numbers that it should find.
Entry = dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    writers = (write_stack, write_pattern, write_frames, write_embryo, write_outline)
    text = ["# Made by `make data`; on another processor a pixel may differ by one grey level."]
    for write in writers:
        for name, entry in write(folder).items():
            lines = [f'["{name}"]']
            for key, value in entry.items():
                pairs = value.items() if isinstance(value, dict) else ()
                table = ", ".join(f"{part} = {number!r}" for part, number in pairs)
                lines.append(f"{key} = {{ {table} }}" if table else f'{key} = "{value}"')
            text.append("\n".join(lines))
    (folder / "MANIFEST.toml").write_text("\n\n".join(text) + "\n", encoding="utf-8")


def write_stack(folder: Path) -> dict[str, Entry]:
    rng = np.random.default_rng(SEED)
    start, spacing, pixel_size = -50.0, 25.0, 3.9
    height = sphere_on_plane((200, 240), 300.0, pixel_size)
    texture, positions = mixed_texture(height.shape, rng), start + spacing * np.arange(29)
    look: dict[str, Any] = {"blur_rate": 1 / spacing, "noise": 2.0, "rng": rng}
    frames = focal_stack(texture, height, positions, **look)
    tifffile.imwrite(folder / "focal_stack.tif", frames, photometric="minisblack", software=False)
    write_height_tiff(folder / "height_um.tif", height, pixel_size=pixel_size)
    ball = "a ball of 300 µm radius on a plane"
    return {
        "focal_stack.tif": {
            "what": f"a rendered focal stack: {ball}, 29 frames 25 µm apart",
            "truth_file": "height_um.tif",
            "settings": {"start": start, "spacing": spacing, "pixel_size": pixel_size},
            "truth": {"known_share": 1.0},
        },
        "height_um.tif": {"what": f"the heights of focal_stack.tif in µm: {ball}"},
    }


def write_pattern(folder: Path) -> dict[str, Entry]:
    pitch, pixel_pitch = 280.0, 9.9
    # The lengths of Table 5.1 in focus, and a pose of our own without distortion.
    t_op, f = (thesis.table_5_1("circle-1X", name) for name in ("T_op", "f"))
    pose = {"alpha": 0.03, "beta": -0.02, "tx": -1900.0, "ty": -1400.0}
    sensor: dict[str, Any] = {"pixel_pitch": pixel_pitch, "image_size": (656, 491)}
    scope = Microscope(t_op, f, 79374.6, **pose, **sensor)
    look: dict[str, Any] = {"imaging": ImagingConditions(noise=2.0), "rng": SEED}
    image = render_circles(scope, pitch=pitch, **look)
    cv2.imwrite(str(folder / "circles.png"), image.round().astype(np.uint8))
    known = {name: getattr(scope, name) for name in ("distortion", "alpha", "beta", "gamma")}
    what = "a rendered photograph: a tilted plane with circles of 70 µm radius, 280 µm apart"
    settings = {"pitch": pitch, "pixel_pitch": pixel_pitch, "focal_length": scope.focal_length}
    truth = {"magnification": round(scope.magnification, 7)} | known
    return {"circles.png": {"what": what, "settings": settings, "truth": truth}}


def write_frames(folder: Path) -> dict[str, Entry]:
    rate, size = 33.0, 40  # 1/s, px
    t = np.arange(40) / rate
    corner = np.column_stack([30 + 60 * t, 40 + 20 * np.sin(2 * np.pi * t / 1.2)])
    frames = np.stack(texture_sequence(corner, np.random.default_rng(SEED), size=size))
    tifffile.imwrite(folder / "frames.tif", frames, photometric="minisblack", software=False)
    middle = pd.DataFrame(corner + (size - 1) / 2, columns=["x_px", "y_px"])
    middle.to_csv(folder / "frames_path.csv", index=False, float_format="%.5f")
    box = [*corner[0].astype(int).tolist(), size, size]
    return {
        "frames.tif": {
            "what": "40 rendered frames at 33 a second: a textured square of 40 px on a wavy path "
            "over another texture",
            "truth_file": "frames_path.csv",
            "settings": {"box": box, "rate": rate, "pixel_size": 6.23},
            "truth": {"lost_frames": 0},
        },
        "frames_path.csv": {"what": "the middle of the square in each frame of frames.tif, in px"},
    }


def write_embryo(folder: Path) -> dict[str, Entry]:
    embryo = Embryo.dented(90.0, modulus=1.3, **MEMBRANE)
    scene = embryo_image(embryo, rng=np.random.default_rng(SEED))
    grey = np.clip(scene.image, 0, 255).round().astype(np.uint8)
    cv2.imwrite(str(folder / "embryo.png"), grey)
    what = "a rendered image: an embryo of 1.3 MPa under a probe"
    return {"embryo.png": _dimple_entry(what, round(embryo.force, 2), scene.pixel_size, embryo)}


def write_outline(folder: Path) -> dict[str, Entry]:
    embryo = Embryo(modulus=1.3, force=10.0, rim_radius=250.0, **MEMBRANE)
    pixel_size, noise = 3.875, 0.1  # µm, px
    x, y = embryo.outline(spacing=0.5).T / pixel_size
    # The dimple's side of the closed outline, to half a radius beyond the rim.
    reach = 1.5 * embryo.rim_radius / pixel_size
    side = (np.abs(x) < reach) & (y > -embryo.radius / pixel_size)
    order = np.argsort(x[side])
    column = np.arange(np.ceil(-reach), np.floor(reach) + 1)
    height = np.interp(column, x[side][order], y[side][order])
    height += np.random.default_rng(SEED).normal(0.0, noise, height.size)
    points = pd.DataFrame({"x": column - column[0], "y": height + 30.0})
    points.to_csv(folder / "outline.csv", index=False, float_format="%.3f")
    what = "the outline of a dimple in a membrane of 1.3 MPa"
    what += ", one point a column of pixels, noise of 0.1 px"
    return {"outline.csv": _dimple_entry(what, embryo.force, pixel_size, embryo)}


def _dimple_entry(what: str, force: float, pixel_size: float, embryo: Embryo) -> Entry:
    truth = {
        "modulus_MPa": embryo.modulus,
        "rim_radius_um": round(embryo.rim_radius, 3),
        "dimple_depth_um": round(embryo.dimple_depth, 3),
    }
    settings = {"force": force, "pixel_size": round(pixel_size, 6), **MEMBRANE}
    return {"what": what, "settings": settings, "truth": truth}


if __name__ == "__main__":
    main()
