"""Parts from which `microlib.curvature.recognize_part` learned: heights in sides of the map.

Each function draws one part of its kind from the documented range of sizes, places and turns. The
benchmark's parts are others, by other formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["KNOWN", "OTHERS", "Part", "draw"]

Rng = np.random.Generator

#: Half-widths, in sides of the map, that no part has: on these the benchmark tests.
GAP = (0.24, 0.30)


@dataclass(frozen=True)
class Part:
    """Heights in sides of the map, shape (n, n), and the part's own curvature |H|, 1/side."""

    height: NDArray
    bend: float


def _frame(n: int, rng: Rng, shift: float) -> tuple[NDArray, NDArray]:
    """Coordinates about the part's middle, turned at random, in sides of the map."""
    y, x = (np.indices((n, n)) + 0.5) / n - 0.5
    dx, dy = rng.uniform(-shift, shift, 2)
    turn = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    return c * (x - dx) + s * (y - dy), c * (y - dy) - s * (x - dx)


def _size(rng: Rng, low: float, high: float, gap: tuple[float, float] = GAP) -> float:
    """Draw a size outside the gap that is left for testing."""
    size = rng.uniform(low, high)
    while gap[0] < size < gap[1]:
        size = rng.uniform(low, high)
    return float(size)


def _arc(distance: NDArray, half: float, rise: float) -> NDArray:
    """Height of a circular arc of half-width `half` and rise `rise`; zero outside."""
    radius = (half**2 + rise**2) / (2 * rise)
    arc = np.sqrt(np.maximum(radius**2 - distance**2, 0)) - (radius - rise)
    return np.where(np.abs(distance) < half, arc, 0.0)


def sphere(n: int, rng: Rng) -> Part:
    """A cap, a ball on the ground with its wall hidden, a shallow dome, or a cap over the map."""
    form = rng.choice(4, p=(0.45, 0.25, 0.15, 0.15))
    half = rng.uniform(0.6, 1.1) if form == 3 else _size(rng, 0.14, 0.42)
    x, y = _frame(n, rng, 0.1 if form == 3 else max(0.45 - half, 0.02))
    r = np.hypot(x, y)
    if form == 1:
        height = np.where(r < half, half + np.sqrt(np.maximum(half**2 - r**2, 0)), 0.0)
        return Part(height, 1 / half)
    rise = half * rng.uniform(0.2, 0.6 if form in (2, 3) else 0.95)
    if form == 2:
        return Part(rise * np.maximum(1 - (r / half) ** 2, 0), 2 * rise / half**2)
    return Part(_arc(r, half, rise), 2 * rise / (half**2 + rise**2))


def cylinder(n: int, rng: Rng) -> Part:
    """A rod across the map, one that ends in it, one on the ground, a parabola, or a wide one."""
    narrow = (0.7 * GAP[0], 0.7 * GAP[1])  # the benchmark's cylinders are narrower than its balls
    form = rng.choice(5, p=(0.3, 0.2, 0.2, 0.15, 0.15))
    half = rng.uniform(0.55, 1.0) if form == 4 else _size(rng, 0.08, 0.36, narrow)
    if form == 1:
        half = _size(rng, 0.07, 0.19, narrow)
    x, y = _frame(n, rng, 0.1 if form in (1, 4) else 0.45 - half if half < 0.4 else 0.05)
    rise = half * rng.uniform(0.2, 0.6 if form == 4 else 0.95)
    bend = rise / (half**2 + rise**2)
    if form == 2:
        height = np.where(np.abs(x) < half, half + np.sqrt(np.maximum(half**2 - x**2, 0)), 0.0)
        bend = 1 / (2 * half)
    elif form == 3:
        height, bend = rise * np.maximum(1 - (x / half) ** 2, 0), rise / half**2
    else:
        height = _arc(x, half, rise)
    if form == 1:
        height = np.where(np.abs(y) < half * rng.uniform(2.2, 3.2), height, 0.0)
    return Part(height, bend)


def cone(n: int, rng: Rng) -> Part:
    half = _size(rng, 0.15, 0.45)
    x, y = _frame(n, rng, max(0.45 - half, 0.03))
    slope = rng.uniform(0.3, 1.5)
    blunt = half * rng.uniform(0.0, 0.08)
    # A tip is never sharper than its radius; a hyperbola blunts it.
    height = np.maximum(slope * (half - np.hypot(np.hypot(x, y), blunt)), 0)
    return Part(height, slope / (half * np.hypot(1, slope)))


def plane(n: int, rng: Rng) -> Part:
    """A plane; its curvature is that of a part against which noise is measured."""
    return Part(np.zeros((n, n)), 1 / rng.uniform(0.3, 1.5))


def saddle(n: int, rng: Rng) -> Part:
    x, y = _frame(n, rng, 0.2)
    bend = 10 ** rng.uniform(-0.4, 0.4)
    height = bend * (x**2 - np.exp(rng.uniform(-0.6, 0.6)) * y**2) / 2
    return Part(height, bend / 2)


def step(n: int, rng: Rng) -> Part:
    x, _ = _frame(n, rng, 0.2)
    rise = 10 ** rng.uniform(-1.5, -0.4)
    width = rng.uniform(0, 0.015)
    height = rise * np.clip(0.5 + x / (2 * width + 1e-9), 0, 1)
    # Half the second derivative that the windows of 7 px see of a jump, about rise / (5 px)².
    return Part(height, rise / (2 * (5 / n) ** 2) / (1 + (rise * n / 8) ** 2) ** 1.5 + 1.0)


KNOWN: dict[str, Callable[[int, Rng], Part]] = {
    "sphere": sphere,
    "cylinder": cylinder,
    "cone": cone,
    "plane": plane,
    "saddle": saddle,
    "step": step,
}


# --- Shapes that are none of these ---------------------------------------------------------------


def _random_relief(n: int, rng: Rng) -> NDArray:
    grain = rng.uniform(0.04, 0.16)
    field = gaussian_filter(rng.standard_normal((n, n)), grain * n)
    return rng.uniform(0.1, 0.7) * grain * field / field.std()


def _mesa(n: int, rng: Rng) -> NDArray:
    """A flat-topped block: a disc, a rectangle, a hexagon."""
    half = rng.uniform(0.14, 0.32)
    x, y = _frame(n, rng, 0.12)
    form = rng.integers(3)
    if form == 0:
        inside = np.hypot(x, y) < half
    elif form == 1:
        inside = (np.abs(x) < half) & (np.abs(y) < half * rng.uniform(0.6, 1.0))
    else:
        turns = np.arange(3) * np.pi / 3
        inside = np.max([np.abs(x * np.cos(t) + y * np.sin(t)) for t in turns], axis=0) < half
    return rng.uniform(0.05, 0.3) * inside


def _roof(n: int, rng: Rng) -> NDArray:
    half = rng.uniform(0.12, 0.4)
    x, _ = _frame(n, rng, 0.1)
    return rng.uniform(0.3, 1.2) * np.maximum(half - np.abs(x), 0)


def _tent(n: int, rng: Rng) -> NDArray:
    """A roof that ends in upright gables."""
    half = rng.uniform(0.12, 0.3)
    x, y = _frame(n, rng, 0.1)
    roof = rng.uniform(0.4, 1.2) * np.maximum(half - np.abs(x), 0)
    return np.where(np.abs(y) < half * rng.uniform(0.7, 1.5), roof, 0.0)


def _washer(n: int, rng: Rng) -> NDArray:
    """A flat disc with a hole."""
    half = rng.uniform(0.15, 0.4)
    r = np.hypot(*_frame(n, rng, max(0.45 - half, 0.02)))
    return rng.uniform(0.04, 0.2) * ((r < half) & (r > half * rng.uniform(0.2, 0.65)))


def _frustum(n: int, rng: Rng) -> NDArray:
    half = rng.uniform(0.2, 0.4)
    x, y = _frame(n, rng, 0.1)
    slope = rng.uniform(0.4, 1.2)
    return slope * np.clip(half - np.hypot(x, y), 0, half * rng.uniform(0.3, 0.6))


def _hollow(n: int, rng: Rng) -> NDArray:
    """The mirror image of a ball, a rod or a cone: a pit, a groove, a funnel."""
    kind = ("sphere", "cylinder", "cone")[rng.integers(3)]
    return -KNOWN[kind](n, rng).height


def _waves(n: int, rng: Rng) -> NDArray:
    x, y = _frame(n, rng, 0.2)
    length = rng.uniform(0.2, 0.5)
    across = x if rng.random() < 0.5 else np.hypot(x, y)
    return rng.uniform(0.05, 0.2) * length * np.cos(2 * np.pi * across / length)


def _lobes(n: int, rng: Rng) -> NDArray:
    """A dome with three to six lobes."""
    x, y = _frame(n, rng, 0.1)
    half, count = rng.uniform(0.2, 0.36), rng.integers(3, 7)
    foot = half * (1 + rng.uniform(0.15, 0.35) * np.cos(count * np.arctan2(y, x)))
    return rng.uniform(0.3, 0.8) * half * np.maximum(1 - (np.hypot(x, y) / foot) ** 2, 0)


def _two(n: int, rng: Rng) -> NDArray:
    """Two parts side by side."""
    x, y = _frame(n, rng, 0.05)
    total = np.zeros((n, n))
    for side in (-1, 1):
        half = rng.uniform(0.1, 0.19)
        r = np.hypot(x - 0.21 * side, y)
        dome = _arc(r, half, half * rng.uniform(0.4, 0.95))
        total += dome if rng.random() < 0.5 else np.maximum(half - r, 0) * rng.uniform(0.4, 1.3)
    return total


def _monkey(n: int, rng: Rng) -> NDArray:
    x, y = _frame(n, rng, 0.08)
    return 10 ** rng.uniform(0.2, 0.8) * (x**3 - 3 * x * y**2)


def _corner(n: int, rng: Rng) -> NDArray:
    """Three planes that meet in a point, or two in a crease, all across the map."""
    x, y = _frame(n, rng, 0.15)
    count = rng.integers(2, 4)
    turns = np.arange(count) * 2 * np.pi / count
    faces = [x * np.cos(t) + y * np.sin(t) for t in turns]
    return rng.choice((-1, 1)) * rng.uniform(0.3, 0.9) * np.max(faces, axis=0)


def _crossed(n: int, rng: Rng) -> NDArray:
    x, y = _frame(n, rng, 0.1)
    half = rng.uniform(0.08, 0.2)
    return np.maximum(_arc(x, half, half * 0.8), _arc(y, half, half * 0.8))


def _staircase(n: int, rng: Rng) -> NDArray:
    x, _ = _frame(n, rng, 0.1)
    width = rng.uniform(0.18, 0.35)
    count = rng.integers(2, 4)
    edges = (np.arange(count) - (count - 1) / 2) * width
    sign = 1 if rng.random() < 0.6 else -1
    risers = np.array([1, sign, 1])[:count, None, None] * (x > edges[:, None, None])
    return rng.uniform(0.05, 0.2) * risers.sum(axis=0)


OTHERS: dict[str, Callable[[int, Rng], NDArray]] = {
    "random relief": _random_relief,
    "mesa": _mesa,
    "roof": _roof,
    "tent": _tent,
    "washer": _washer,
    "frustum": _frustum,
    "hollow": _hollow,
    "waves": _waves,
    "lobes": _lobes,
    "two parts": _two,
    "monkey saddle": _monkey,
    "corner": _corner,
    "crossed rods": _crossed,
    "staircase": _staircase,
}


def draw(kind: str, n: int, rng: Rng) -> Part:
    """Draw a part or another shape, on a ground that is tilted a little."""
    if kind in KNOWN:
        part = KNOWN[kind](n, rng)
    else:
        part = Part(OTHERS[kind](n, rng), 1 / rng.uniform(0.3, 1.0))
    y, x = np.indices((n, n)) / n
    slope = rng.uniform(0, 0.5 if kind == "plane" else 0.12)
    turn = rng.uniform(0, 2 * np.pi)
    return Part(part.height + slope * (np.cos(turn) * x + np.sin(turn) * y), part.bend)
