"""Write the small canonical inputs of ``data/synthetic`` and their manifest: ``make data``.

Each is a rendered scene with known truth, for trying the guides and the library without a
microscope. The manifest holds what each file is, its truth, and its SHA-256.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

import cv2
import numpy as np
import tifffile

from compendium import thesis
from microlib.microscope import Microscope
from microlib.synthetic import (
    Embryo,
    ImagingConditions,
    embryo_image,
    focal_stack,
    mixed_texture,
    render_circles,
    sphere_on_plane,
    texture_sequence,
)

FOLDER = Path(__file__).resolve().parent.parent / "data" / "synthetic"
SEED = 2008


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    entries = [write(folder) for write in (write_stack, write_pattern, write_frames, write_embryo)]
    lines = ["# Made by `make data`; the same versions write the same bytes."]
    for name, truth in entries:
        digest = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        lines += ["", f'["{name}"]', f'truth = "{truth}"', f'sha256 = "{digest}"']
    (folder / "MANIFEST.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_stack(folder: Path) -> tuple[str, str]:
    rng = np.random.default_rng(SEED)
    height = sphere_on_plane((120, 140), 150.0, 3.9)
    positions = -50.0 + 25.0 * np.arange(17)
    frames = focal_stack(
        mixed_texture(height.shape, rng), height, positions, blur_rate=1 / 25, noise=2.0, rng=rng
    )
    tifffile.imwrite(folder / "focal_stack.tif", frames, photometric="minisblack", software=False)
    return (
        "focal_stack.tif",
        "a ball of 150 µm radius on a plane; 3.9 µm/px, 17 frames 25 µm apart from -50 µm on",
    )


def write_pattern(folder: Path) -> tuple[str, str]:
    # The lengths of Table 5.1 in focus, and a pose of our own without distortion.
    t_op, f = (thesis.table_5_1("circle-1X", name) for name in ("T_op", "f"))
    scope = Microscope(t_op, f, 79374.6, alpha=0.03, beta=-0.02, tx=-1900.0, ty=-1400.0)
    image = render_circles(
        scope, pitch=280.0, imaging=ImagingConditions(noise=2.0), rng=np.random.default_rng(SEED)
    )
    cv2.imwrite(str(folder / "circles.png"), image.round().astype(np.uint8))
    return (
        "circles.png",
        "circles of 70 µm radius, 280 µm apart; cells of 9.9 µm, f = 126150 µm, M = 1.5893",
    )


def write_frames(folder: Path) -> tuple[str, str]:
    t = np.arange(20) / 33.0
    path = np.column_stack([30 + 60 * t, 25 + 10 * np.sin(10 * t)])
    frames = np.stack(texture_sequence(path, np.random.default_rng(SEED), size=40))
    tifffile.imwrite(folder / "frames.tif", frames, photometric="minisblack", software=False)
    return (
        "frames.tif",
        "a square of 40 px at x = 30 + 60 t, y = 25 + 10 sin(10 t) px; 20 frames, 33 a second",
    )


def write_embryo(folder: Path) -> tuple[str, str]:
    embryo = Embryo.dented(90.0, modulus=1.3)
    scene = embryo_image(embryo, rng=np.random.default_rng(SEED))
    grey = np.clip(scene.image, 0, 255).round().astype(np.uint8)
    cv2.imwrite(str(folder / "embryo.png"), grey)
    return (
        "embryo.png",
        f"E = 1.3 MPa, F = {embryo.force:.2f} µN, w_d = 90 µm, a = {embryo.dimple_radius:.2f} µm; "
        f"{scene.pixel_size:g} µm/px",
    )


if __name__ == "__main__":
    main()
