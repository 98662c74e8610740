"""Images of a pressed capsule, drawn by none of the library's formulas but `indent_capsule`.

The renderer of `microlib.synthetic` draws the profile (4.2), which the chain then fits. This one
draws the capsule, with what real images have: a wall of two dark lines, granules, the near rim out
of focus before the dimple, debris, a neighbor, a holder, uneven light, color, a scale bar and
writing, JPEG, and a probe of any kind from any side.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib.embryo import Boundary, extract_boundary
from microlib.io import read_grey
from microlib.membrane import indent_capsule
from microlib.synthetic import Embryo, EmbryoImage, embryo_image

PROBES = ("rod", "needle", "tapered", "blunt")
#: Half-width of the end, µm, and what it grows by for each µm away from it.
_WIDTHS = {"needle": (8.0, 14.0), "blunt": (38.0, 50.0)}
_TAPERS = {"needle": 0.08, "tapered": 0.08}
#: Largest angle of the probe against the image's edge.
_TILT = np.deg2rad(3.0)
#: Pixel size, µm, of a camera of 4.65 µm pixel pitch behind 2.4×, its image, and samples of a
#: pixel's side.
PIXEL, ROWS, COLUMNS, FINE = 4.65 / 2.4, 960, 1280, 2
#: Fractional bits of OpenCV's drawing.
_SHIFT = 4

Place = Callable[[NDArray], NDArray]


def draw_scene(rng: np.random.Generator, probe: str) -> SimpleNamespace:
    """Draw one embryo of random stiffness, inflation, size, force, light and surroundings.

    Its image comes with its truth: modulus (MPa) and inflation, force (µN) and sizes (µm).

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random: among it whether the image is kept as it is, or at half or a
        quarter of its resolution, and the side that the probe comes from.
    probe : str
        One of `PROBES`.
    """
    shrink = int(rng.choice((1, 2, 4)))
    c = rng.uniform(*_WIDTHS.get(probe, (18.0, 32.0)))
    while True:
        radius, inflation = rng.uniform(520, 680), rng.uniform(1.01, 1.08)
        modulus, force = rng.uniform(0.5, 2.0), rng.uniform(40, 220)
        try:
            egg = {"modulus": modulus, "capsule_radius": radius, "inflation": inflation}
            state = indent_capsule(
                force, **egg, thickness=3.0, probe_half_width=c, poisson_ratio=0.5
            )
        except ValueError:
            continue
        # At a quarter of the resolution 45 µm are 6 px, twice the least that is measured.
        if (45 if shrink == 4 else 30) < state.depth < 140:
            break
    image = _photograph(rng, _draw(rng, state, c, probe), shrink)
    turns = int(rng.integers(4))
    return SimpleNamespace(
        image=np.ascontiguousarray(np.rot90(image, turns)),
        **egg,
        force=force,
        thickness=3.0,
        probe_half_width=c,
        depth=state.depth,
        rim_radius=state.rim_radius,
        pixel_size=PIXEL * shrink,
        shrink=shrink,
    )


def _photograph(
    rng: np.random.Generator, picture: NDArray[np.float32], shrink: int
) -> NDArray[np.uint8]:
    """Return grey levels of the drawing as a camera and a file of colors leave them."""
    # The optics' blur is that of the object, whatever the camera's pixel pitch is.
    blurred = cv2.GaussianBlur(picture, (0, 0), rng.uniform(1.4, 2.4) * FINE)
    size = (COLUMNS // shrink, ROWS // shrink)
    small = cv2.resize(blurred, size, interpolation=cv2.INTER_AREA)
    slope = rng.uniform(-0.1, 0.1, 2)
    down, right = (np.linspace(-1, 1, n) for n in small.shape)
    small *= 1 + slope[0] * down[:, np.newaxis] + slope[1] * right
    tint = np.array([rng.uniform(0.85, 1.0), 1.0, rng.uniform(0.9, 1.08)], np.float32)
    colored = small[..., np.newaxis] * tint
    colored += rng.normal(0, 2, colored.shape)
    sharp = np.clip(colored, 0, 255).astype(np.uint8)
    rows = len(small)
    bar, edge = 100.0 / (PIXEL * shrink), 8
    cv2.line(sharp, (edge, rows - edge), (edge + round(bar), rows - edge), (20, 20, 20), 2)
    written = {"thickness": 1, "lineType": cv2.LINE_AA}
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(sharp, "100 um", (edge, rows - 2 * edge), font, 0.4, (20, 20, 20), **written)
    cv2.putText(sharp, "t = 12.5 s", (edge, 2 * edge), font, 0.4, (40, 220, 250), **written)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "embryo.jpg"
        cv2.imwrite(str(path), sharp, [cv2.IMWRITE_JPEG_QUALITY, 90])
        return read_grey(path)


def _draw(rng: np.random.Generator, state: Any, c: float, probe: str) -> NDArray[np.float32]:
    """Draw the scene on a grid finer than the camera's pixels, before any blur."""
    half = np.stack([state.r, state.z], axis=1)
    outline = np.concatenate([half[::-1] * [-1, 1], half])
    width, height = float(np.abs(outline[:, 0]).max()), float(outline[:, 1].max())
    scale = FINE / PIXEL
    angle = rng.uniform(-_TILT, _TILT)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([COLUMNS / 2, ROWS / 2]) * FINE + rng.uniform(-40, 40, 2) * [FINE, 1]

    def place(points: NDArray) -> NDArray:
        along = (np.asarray(points, float) - [0, height / 2]) @ turn.T
        fine = middle + scale * along * [1, -1]
        return np.rint((fine - 0.5) * 2**_SHIFT).astype(np.int32)

    def line(points: NDArray, grey: float, wide: float) -> None:
        thick = max(1, round(wide * scale))
        cv2.polylines(picture, [place(points)], False, grey, thick, cv2.LINE_AA, _SHIFT)

    picture = np.full((ROWS * FINE, COLUMNS * FINE), 190.0, np.float32)
    neighbor = 2.15 * width * rng.choice((-1, 1))
    around = np.linspace(0, 2 * np.pi, 400)
    circle = 450 * np.stack([np.cos(around), np.sin(around)], axis=1)
    line(np.add(circle, [neighbor, 460]), 110.0, 5.0)
    cv2.fillPoly(picture, [place(outline)], 172.0, cv2.LINE_AA, _SHIFT)
    _draw_yolk(rng, picture, place, state)
    normal = np.gradient(outline, axis=0)[:, ::-1] * [-1, 1]
    normal /= np.maximum(np.hypot(*normal.T), 1e-9)[:, np.newaxis]
    for shift, grey in ((2.2, 90.0), (-2.2, 105.0), (0.0, 140.0)):
        line(outline + shift * normal, grey, 2.0)
    rim = np.zeros_like(picture)
    ends = np.array([[-state.rim_radius, height], [state.rim_radius, height]])
    cv2.polylines(rim, [place(ends)], False, 1.0, round(12 * scale), cv2.LINE_AA, _SHIFT)
    picture -= rng.uniform(5, 15) * cv2.GaussianBlur(rim, (0, 0), 8.0 * FINE)
    holder = np.array([[-90, 0], [90, 0], [90, -600], [-90, -600]])
    cv2.fillPoly(picture, [place(holder)], 70.0, cv2.LINE_AA, _SHIFT)
    _draw_probe(picture, place, float(state.z[0]), c, probe)
    for _ in range(rng.integers(3, 9)):
        spot = np.array([[rng.uniform(-1200, 1200), rng.uniform(-100, 1600)]])
        if abs(spot[0, 0]) > 1.3 * width:
            size = round(4 * scale * 2**_SHIFT)
            cv2.circle(picture, place(spot)[0].tolist(), size, 120.0, -1, 16, _SHIFT)
    return picture


def _draw_yolk(rng: np.random.Generator, picture: NDArray, place: Place, state: Any) -> None:
    """Draw granules in a round yolk below the dimple."""
    reach = 0.35 * float(state.z[0])
    for _ in range(900):
        distance, angle = reach * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        spot = np.array([[distance * np.cos(angle), reach * 1.1 + distance * np.sin(angle)]])
        grey, size = rng.uniform(90, 160), rng.uniform(5, 14) * FINE / PIXEL
        cv2.circle(picture, place(spot)[0].tolist(), int(size * 2**_SHIFT), grey, -1, 16, _SHIFT)


def _draw_probe(picture: NDArray, place: Place, end: float, c: float, probe: str) -> None:
    """Draw the probe from above, its flat end on the wall at the height `end` (µm)."""
    top, low = end + 2200.0, end + 2.0
    wide = c + _TAPERS.get(probe, 0.0) * (top - low)
    body = np.array([[-c, low], [c, low], [wide, top], [-wide, top]])
    cv2.fillPoly(picture, [place(body)], 45.0, cv2.LINE_AA, _SHIFT)


@cache
def small_egg() -> EmbryoImage:
    """Return an embryo that obeys (4.2), of few pixels."""
    pressed = Embryo.pressed(150.0, modulus=1.0)
    return embryo_image(pressed, rng=0, pixel_size=7.75, shape=(256, 320))


@cache
def small_outline() -> Boundary:
    return extract_boundary(small_egg().image)
