"""Pairs of frames from photographs: warped, partly hidden, in another light, or gone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tests.scenes import camera_frame
from tests.scenes.photographs import photograph

Array = NDArray[np.float64]

#: Photographs on which the tracker was developed, and others. OpenCV's gave some more for the fit
#: of the confidence.
DEVELOPMENT = ("camera", "astronaut", "chelsea", "brick", "coins", "immunohistochemistry", "moon")
HELD_OUT = ("coffee", "rocket", "grass", "gravel", "retina", "page", "clock", "cell")
CONDITIONS = (
    *("clean", "20 % hidden", "40 % hidden", "glare", "ramp", "gamma", "blur", "gone"),
    "other image",
)
ABSENT = ("gone", "other image")
#: Side of the template, of the frame, and least distance of the template from its border, px.
SIDE, FRAME, MARGIN = 50, 190, 60
#: Root mean square gradient (grey levels a px) that a template has at least in every direction.
LEAST_GRADIENT = 1.5


@dataclass(frozen=True)
class Pair:
    """Two frames, the template's box in the first and its corners in the second, if present."""

    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    box: tuple[int, int, int, int]
    corners: Array
    present: bool


@cache
def grey(name: str) -> Array:
    """Return a photograph in grey levels, at most 1000 px wide and high."""
    image = photograph(name)
    scale = min(1, 1000 / max(image.shape))
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


@lru_cache(maxsize=4)
def spline_of(name: str) -> Array:
    return ndimage.spline_filter(grey(name), order=5, mode="mirror")


def textured(names: tuple[str, ...], rng: np.random.Generator) -> tuple[str, int, int]:
    """Draw a photograph and (x, y) of a box in it with gradients in every direction."""
    while True:
        name = names[rng.integers(len(names))]
        x, y = (int(rng.integers(MARGIN, n - MARGIN - SIDE + 1)) for n in grey(name).shape[::-1])
        smooth = cv2.GaussianBlur(grey(name)[y : y + SIDE, x : x + SIDE], (0, 0), 1)
        gradient = np.stack(np.gradient(smooth)).reshape(2, -1)
        if np.linalg.eigvalsh(gradient @ gradient.T / SIDE**2)[0] > LEAST_GRADIENT**2:
            return name, x, y


def elsewhere(names: tuple[str, ...], rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Return a part of one of the photographs."""
    while True:
        name, x, y = textured(names, rng)
        part = grey(name)[y : y + shape[0], x : x + shape[1]]
        if part.shape == shape:
            return part


def seen_from(name: str, homography: Array, shape: tuple[int, int], corner: Array) -> Array:
    """Return what a frame shows of a photograph.

    The homography maps px of the first frame, which begins at a `corner` (x, y) of the photograph,
    to px of the frame.
    """
    rows, columns = np.indices(shape)
    points = np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
    x, y, w = np.linalg.inv(homography) @ points
    place = (y / w + corner[1], x / w + corner[0])
    seen = ndimage.map_coordinates(spline_of(name), place, order=5, prefilter=False, mode="mirror")
    return seen.reshape(shape)


def make_pair(seed: int, motion: str, condition: str, names: tuple[str, ...]) -> Pair:
    """Warp a photograph and do to the second frame what the condition says.

    Each corner coordinate of a homography moves by a normal deviate of 2 px; a translation is 12 px
    long.
    """
    rng = np.random.default_rng([seed, CONDITIONS.index(condition), motion == "homography"])
    name, x, y = textured(names, rng)
    left, top = (
        min(max(at - (FRAME - SIDE) // 2, 0), n - FRAME)
        for at, n in zip((x, y), grey(name).shape[::-1], strict=True)
    )
    box = (x - left, y - top, SIDE, SIDE)
    source = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * (SIDE - 1) + box[:2]
    if motion == "homography":
        corners = source + 2 * rng.standard_normal((4, 2)) + rng.uniform(-2, 2, 2)
    else:
        angle = rng.uniform(0, 2 * np.pi)
        corners = source + 12 * np.array([np.cos(angle), np.sin(angle)])
    points = [one.astype(np.float32) for one in (source, corners)]
    homography = cv2.getPerspectiveTransform(*points).astype(float)
    second = seen_from(name, homography, (FRAME, FRAME), np.array([left, top]))
    second = spoiled(second, condition, corners, name, names, rng)
    first = grey(name)[top : top + FRAME, left : left + FRAME]
    frames = [camera_frame(one, rng) for one in (first, second)]
    return Pair(*frames, box, corners, condition not in ABSENT)


def spoiled(
    image: Array,
    condition: str,
    corners: Array,
    own: str,
    names: tuple[str, ...],
    rng: np.random.Generator,
) -> Array:
    """Return a frame, whose template has these corners, under a condition."""
    others = tuple(name for name in names if name != own)
    rows, columns = np.indices(image.shape)
    low, high, middle = corners.min(axis=0), corners.max(axis=0), corners.mean(axis=0)
    if condition.endswith("hidden"):
        area = float(condition.split()[0]) / 100 * SIDE**2
        width = float(np.clip(np.sqrt(area * rng.uniform(0.5, 2)), area / SIDE, SIDE))
        size = np.array([width, area / width])
        x, y = np.rint(low + rng.uniform(0, 1, 2) * (SIDE - size)).astype(int)
        width, height = np.rint(size).astype(int)
        image[y : y + height, x : x + width] = elsewhere(others, rng, (height, width))
    elif condition == "glare":
        x, y = low + rng.uniform(0.15, 0.85, 2) * (high - low)
        square = (columns - x) ** 2 + (rows - y) ** 2
        image += rng.uniform(150, 260) * np.exp(-square / (2 * rng.uniform(8, 12) ** 2))
    elif condition == "ramp":
        angle = rng.uniform(0, 2 * np.pi)
        along = (columns - middle[0]) * np.cos(angle) + (rows - middle[1]) * np.sin(angle)
        image *= 1 + 0.12 * along / (SIDE / 2)
    elif condition == "gamma":
        image = 255 * np.sqrt(np.clip(image, 0, 255) / 255)
    elif condition == "blur":
        image = ndimage.gaussian_filter(image, 2)
    elif condition == "gone":
        x, y = np.floor(low - rng.integers(8, 16)).astype(int)
        width, height = np.ceil(high + rng.integers(8, 16)).astype(int) - (x, y)
        # Half of them with another place of the same photograph, turned upside down.
        same = rng.random() < 0.5
        part = elsewhere((own,) if same else others, rng, (height, width))
        image[y : y + height, x : x + width] = part[:: -1 if same else 1]
    elif condition == "other image":
        other = grey(others[rng.integers(len(others))])
        y, x = (int(rng.integers(0, n - FRAME + 1)) for n in other.shape)
        image = other[y : y + FRAME, x : x + FRAME]
    else:
        image *= rng.uniform(0.95, 1.05)
    return image
