"""Images of a pressed capsule, drawn by none of the library's formulas but `indent_capsule`.

The renderer of `microlib.synthetic` draws the profile (4.2), which the chain then fits. This one
draws the capsule, with what real images have: a wall of two dark lines, granules, the near rim out
of focus before the dimple, debris, a neighbor, a holder, uneven light, a scale bar and JPEG.

Run as ``python -m benchmarks.capsule_embryo``; about a quarter of an hour.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.report import must_hold, publish
from microlib.embryo import modulus_from_image
from microlib.membrane import indent_capsule

#: Images of each kind of probe.
EMBRYOS = 50
PROBES = ("rod", "glass", "tapered", "blunt")
#: Pixel of the Sony camera behind 1.2×, µm, and samples of a pixel's side.
PIXEL, FINE = 4.65 / 1.2, 4
_COLUMNS = ["seed", "probe", "error", "std", "holds", "models hold", "reason"]
#: Fractional bits of OpenCV's drawing.
_SHIFT = 4


@dataclass(frozen=True)
class Scene:
    """An image with its truth: modulus and inflation, force (µN), sizes (µm), pixel (µm)."""

    image: NDArray[np.uint8]
    modulus: float
    inflation: float
    force: float
    radius: float
    thickness: float
    probe_half_width: float
    depth: float
    rim_radius: float
    pixel_size: float


def draw_scene(rng: np.random.Generator, probe: str, *, shrink: int = 1) -> Scene:
    """Draw one embryo of random stiffness, inflation, size, force, light and surroundings.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random.
    probe : str
        One of `PROBES`.
    shrink : int
        Reduce the image: 2 for half the resolution, 4 for a quarter.
    """
    c = rng.uniform(38, 50) if probe == "blunt" else rng.uniform(18, 32)
    while True:
        radius, inflation = rng.uniform(520, 680), rng.uniform(1.01, 1.08)
        modulus, force = rng.uniform(0.5, 2.0), rng.uniform(40, 220)
        try:
            state = indent_capsule(
                force,
                modulus=modulus,
                radius=radius,
                thickness=3.0,
                probe_half_width=c,
                inflation=inflation,
            )
        except ValueError:
            continue
        if 30 < state.depth < 140:
            break
    half = np.stack([state.r, state.z], axis=1)
    outline = np.concatenate([half[::-1] * [-1, 1], half])
    image = _draw(rng, outline, state, c, probe)
    if shrink > 1:
        size = (image.shape[1] // shrink, image.shape[0] // shrink)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    noisy = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    jpeg = cv2.imdecode(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], 0)
    return Scene(
        jpeg,
        modulus,
        inflation,
        force,
        radius,
        3.0,
        c,
        state.depth,
        state.rim_radius,
        PIXEL * shrink,
    )


def _draw(rng, outline: NDArray, state, c: float, probe: str) -> NDArray[np.float32]:
    """Draw the scene at the camera's full resolution, before noise."""
    rows, columns = 480, 640
    axis = (columns / 2 + rng.uniform(-30, 30)) * FINE
    floor = (rows - 40) * FINE
    scale = FINE / PIXEL

    def place(points: NDArray) -> NDArray[np.int32]:
        across, up = np.asarray(points, float).T
        fine = np.stack([axis + scale * across, floor - scale * up], axis=1)
        return np.rint((fine - 0.5) * 2**_SHIFT).astype(np.int32)

    def line(points: NDArray, grey: float, width: float, closed: bool = False) -> None:
        thick = max(1, round(width * scale))
        cv2.polylines(picture, [place(points)], closed, grey, thick, cv2.LINE_AA, _SHIFT)

    picture = np.full((rows * FINE, columns * FINE), 190.0, np.float32)
    side = rng.choice((-1, 1))
    neighbor = 2.15 * np.abs(outline[:, 0]).max() * side
    turn = np.linspace(0, 2 * np.pi, 400)
    other = np.stack([neighbor + 450 * np.cos(turn), 460 + 450 * np.sin(turn)], axis=1)
    line(other, 110.0, 5.0, closed=True)
    cv2.fillPoly(picture, [place(outline)], 172.0, cv2.LINE_AA, _SHIFT)
    _draw_yolk(rng, picture, place, state)
    normal = np.gradient(outline, axis=0)[:, ::-1] * [-1, 1]
    normal /= np.maximum(np.hypot(*normal.T), 1e-9)[:, np.newaxis]
    for shift, grey in ((2.2, 90.0), (-2.2, 105.0), (0.0, 140.0)):
        line(outline + shift * normal, grey, 2.0)
    rim = np.zeros_like(picture)
    level = float(outline[:, 1].max())
    ends = np.array([[-state.rim_radius, level], [state.rim_radius, level]])
    cv2.polylines(rim, [place(ends)], False, 1.0, round(12 * scale), cv2.LINE_AA, _SHIFT)
    picture -= rng.uniform(5, 15) * cv2.GaussianBlur(rim, (0, 0), 4.0 * FINE)
    holder = np.array([[-90, 0], [90, 0], [90, -300], [-90, -300]])
    cv2.fillPoly(picture, [place(holder)], 70.0, cv2.LINE_AA, _SHIFT)
    _draw_probe(picture, place, float(state.z[0]), c, probe)
    for _ in range(rng.integers(3, 9)):
        spot = place(np.array([[rng.uniform(-1200, 1200), rng.uniform(-100, 1600)]]))[0]
        across = abs(spot[0] / 2**_SHIFT - axis) / scale
        if across > 1.3 * np.abs(outline[:, 0]).max():
            cv2.circle(picture, spot.tolist(), int(FINE * 2**_SHIFT), 120.0, -1, 16, _SHIFT)
    blurred = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.7, 1.2) * FINE)
    small = cv2.resize(blurred, (columns, rows), interpolation=cv2.INTER_AREA)
    slope = rng.uniform(-0.1, 0.1, 2)
    down, right = np.linspace(-1, 1, rows), np.linspace(-1, 1, columns)
    small *= 1 + slope[0] * down[:, np.newaxis] + slope[1] * right
    cv2.line(small, (30, rows - 12), (90, rows - 12), 20.0, 3)
    return small


def _draw_yolk(rng, picture: NDArray, place, state) -> None:
    """Draw granules in a round yolk below the dimple."""
    reach = 0.35 * float(state.z[0])
    for _ in range(900):
        distance, angle = reach * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        spot = np.array([[distance * np.cos(angle), reach * 1.1 + distance * np.sin(angle)]])
        grey, size = rng.uniform(90, 160), rng.uniform(5, 14) * FINE / PIXEL
        cv2.circle(picture, place(spot)[0].tolist(), int(size * 2**_SHIFT), grey, -1, 16, _SHIFT)


def _draw_probe(picture: NDArray, place, end: float, c: float, probe: str) -> None:
    """Draw the probe from above, its flat end on the wall at the height `end` (µm)."""
    top, low = end + 1500.0, end + 2.0
    wide = c + (0.08 * (top - low) if probe == "tapered" else 0.0)
    body = np.array([[-c, low], [c, low], [wide, top], [-wide, top]])
    if probe == "glass":
        cv2.fillPoly(picture, [place(body)], 195.0, cv2.LINE_AA, _SHIFT)
        wall = round(8.0 * FINE / PIXEL)
        inner = body + np.array([[4, 4], [-4, 4], [-4, 0], [4, 0]])
        cv2.polylines(picture, [place(inner)], True, 60.0, wall, cv2.LINE_AA, _SHIFT)
    else:
        cv2.fillPoly(picture, [place(body)], 45.0, cv2.LINE_AA, _SHIFT)


def measure(seeds: range, probe: str, shrink: int = 1) -> pd.DataFrame:
    """Measure one embryo a seed as a capsule, neo-Hookean as it was drawn, of unknown radius."""
    rows = []
    for seed in seeds:
        scene = draw_scene(np.random.default_rng(seed), probe, shrink=shrink)
        try:
            found = modulus_from_image(
                scene.image,
                scene.force,
                pixel_size=scene.pixel_size,
                thickness=scene.thickness,
                probe_half_width=scene.probe_half_width,
                poisson_ratio=0.5,
                method="capsule",
            )
        except ValueError as reason:
            rows.append({"seed": seed, "probe": probe, "reason": str(reason)})
            continue
        error, std = float(np.log(found.modulus / scene.modulus)), found.relative_std
        low, high = found.model_interval
        rows.append(
            {
                "seed": seed,
                "probe": probe,
                "error": error,
                "std": std,
                "holds": abs(error) < 1.96 * std,
                "models hold": low < scene.modulus < high,
            }
        )
    return pd.DataFrame(rows, columns=_COLUMNS)


def summarize(runs: pd.DataFrame) -> pd.DataFrame:
    """One row a kind of probe: failures, bias, spread, worst error and coverage."""
    rows = []
    for probe, group in runs.groupby("probe", sort=False):
        error = group["error"].dropna()
        rows.append(
            {
                "probe": probe,
                "images": len(group),
                "failures": int(group["error"].isna().sum()),
                "bias of E (%)": 100 * error.mean(),
                "spread of E (%)": 100 * error.std(),
                "worst (%)": 100 * error.abs().max(),
                "95 % intervals that hold (%)": 100 * group["holds"].dropna().mean(),
                "intervals over the models that hold (%)": (
                    100 * group["models hold"].dropna().mean()
                ),
            }
        )
    return pd.DataFrame(rows).round(2)


def main() -> None:
    cv2.setNumThreads(1)
    runs = pd.concat([measure(range(EMBRYOS), probe) for probe in PROBES])
    half = measure(range(EMBRYOS), "rod", 2).assign(probe="rod, half resolution")
    publish(
        "capsule_embryo",
        {"Modulus of rendered capsules, by probe": summarize(pd.concat([runs, half]))},
        limits=must_hold(
            [
                ("failures of all images, %", 100 * runs["error"].isna().mean(), "≤", 4),
                ("bias of E, %", 100 * abs(runs["error"].mean()), "≤", 3),
                ("worst error of E, %", 100 * runs["error"].abs().max(), "≤", 20),
                ("95 % intervals that hold, %", 100 * runs["holds"].mean(), "≥", 90),
                ("95 % intervals that hold, %", 100 * runs["holds"].mean(), "≤", 98),
            ]
        ),
        note="Drawn from indent_capsule, neo-Hooke: E 0.5–2 MPa, radius 520–680 µm, inflated by "
        "1–8 %, dimples 30–140 µm deep. The chain knows force, thickness, pixel and probe width.",
    )


if __name__ == "__main__":
    main()
