"""Alignment in a light that varies smoothly, through a blur and a tone curve, robustly.

The image under the warp is a sum of columns: the template, its products with the coordinates, its
change by a blur, its square and cube (a tone curve), and a bias interpolated between knots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microlib._common import Array, Image
from microlib.tracking._blocks import Agreement, agreement
from microlib.tracking._local import LocalLevel
from microlib.tracking._loops import TUKEY, align_lit

#: Px between the knots of the bias at least, and the most of them along a side. With 3 knots 67 %,
#: with 5 78 % of the templates behind a glare are found (development pairs).
_KNOT_DISTANCE, _MOST_KNOTS = 10, 5

#: Columns whose derivative by the template's grey value is not zero come first; the first is the
#: template itself.
_GAINS = 6


@dataclass(frozen=True)
class LitFit:
    """Where an alignment in smooth light ended.

    Attributes
    ----------
    pose : ndarray, shape (3, 3)
        The warp.
    agreement : Agreement
        What the blocks say of it, of the template in its light, blur and tone.
    noise : float
        Robust standard deviation of the residual over the noise.
    weight, residual, slope : ndarray, shape (H, W)
        Weight of each pixel, what it differs, in grey levels, and the derivative of their product
        by this difference.
    model : ndarray, shape (H, W)
        The template in the frame's gain, blur and tone.
    gain, bias : float
        Of the light at the middle of the template.
    normal : ndarray, shape (n + m, n + m)
        Normal matrix of motion and light.
    design : ndarray, shape (n + m, N)
        Derivatives of the residual by motion and light.
    bend : float
        Largest of blur and tone over the gain.
    correlation : float
        Weighted correlation of the image with the template in its light.
    visible : float
        Share of the template's pixels inside the image.
    iterations : int
        Steps taken.
    """

    pose: Array
    agreement: Agreement
    noise: float
    weight: Image
    residual: Image
    slope: Image
    model: Image
    gain: float
    bias: float
    normal: Array
    design: Image
    bend: float
    correlation: float
    visible: float
    iterations: int


@dataclass(frozen=True)
class LitLevel:
    """A template with the columns of its light.

    Attributes
    ----------
    local : LocalLevel
        The template, sampled at half pixels.
    light : ndarray, shape (m, N)
        Columns of the light.
    tone : ndarray, shape (6, N)
        Derivatives of the first of them by the template's grey value.
    contrast : float
        Grey levels of the template that one unit of the first column is.
    """

    local: LocalLevel
    light: Image
    tone: Image
    contrast: float

    def align(
        self,
        image: Image,
        pose: Array,
        trust: Image,
        *,
        noise: float,
        ceiling: float,
        iterations: int,
        tolerance: float,
    ) -> LitFit | None:
        """Align from a pose on an image of half pixels, trusting each pixel as far as told."""
        level, n, m = self.local, len(self.local.basis), len(self.light)
        size = level.grey.size
        weight, residual = np.empty(size, np.float32), np.empty(size, np.float32)
        design = np.empty((n + m, size), np.float32)
        normal, amounts = np.zeros((n + m, n + m)), np.zeros(m)
        warp, steps, scale = align_lit(
            image,
            level.warp(pose),
            level.basis,
            level.level.flow,
            level.grey,
            self.light,
            level.level.gradient,
            self.tone,
            trust,
            level.kernel,
            level.pad,
            noise * level.noise,
            ceiling,
            level.corners,
            iterations,
            tolerance,
            weight,
            residual,
            design,
            normal,
            amounts,
        )
        if not steps:
            return None
        shape = level.grey.shape
        model = (amounts[:_GAINS] @ self.light[:_GAINS]).astype(np.float32).reshape(shape)
        found = level.pose(warp)
        gain = float(amounts[0]) / self.contrast
        grey, seen = level.patch(image, found, ceiling)
        middle = float(amounts[_GAINS:] @ self.light[_GAINS:, size // 2 + shape[1] // 2])
        return LitFit(
            pose=found,
            agreement=agreement(grey, model, seen, noise * level.noise),
            noise=scale / (noise * level.noise),
            weight=weight.reshape(shape),
            residual=residual.reshape(shape),
            slope=_tukey_slope(weight, residual, scale).reshape(shape),
            model=model,
            gain=gain,
            bias=middle - gain * level.level.mean,
            normal=normal,
            design=design,
            correlation=_explained(grey.ravel(), residual, weight),
            visible=float(seen.sum() / level.mask.sum()),
            iterations=steps,
            bend=float(np.abs(amounts[3:_GAINS]).max() / max(abs(amounts[0]), 1e-9)),
        )


def _tukey_slope(weight: Image, residual: Image, scale: float) -> Image:
    """Return the derivative of the weighted residuals by the residuals, for Tukey's biweight."""
    square = (residual / (TUKEY * scale)) ** 2
    inside = square < 1
    # The weight is trust·(1 − u²)², the slope trust·(1 − u²)(1 − 5u²).
    return np.where(inside, weight * (1 - 5 * square) / np.where(inside, 1 - square, 1), 0)


def _explained(grey: Image, residual: Image, weight: Image) -> float:
    """Return the weighted correlation of grey values with what is left without the residual."""
    weight = weight / max(float(weight.sum()), 1e-9)
    spread = float(weight @ (grey - weight @ grey) ** 2)
    return float(np.sqrt(max(1.0 - float(weight @ residual**2) / max(spread, 1e-9), 0.0)))


def make_lit(level: LocalLevel, blurred: LocalLevel) -> LitLevel:
    """Return the columns of the light of a template, which is given a little `blurred`, too."""
    rows, columns = level.grey.shape
    contrast = max(level.level.contrast, 1e-9)
    t = (level.grey - level.level.mean) / contrast
    v, u = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    blur = blurred.grey - level.grey
    one, zero = np.ones_like(t), np.zeros_like(t)
    gains = [
        (t, one),
        (u * t, u),
        (v * t, v),
        (blur / max(float(blur.std()), 1e-9), zero),
        (t * t, 2 * t),
        (t**3, 3 * t * t),
    ]
    across, down = _knots(u, columns), _knots(v, rows)
    biases = [a * b for a in across for b in down]
    light = np.array([column for column, _ in gains] + biases)
    tone = np.array([slope for _, slope in gains]) / contrast
    return LitLevel(
        local=level,
        light=np.ascontiguousarray(light.reshape(len(light), -1), np.float32),
        tone=np.ascontiguousarray(tone.reshape(len(tone), -1), np.float32),
        contrast=contrast,
    )


def _knots(place: Array, length: int) -> list[Array]:
    """Return hats between evenly spaced knots over −1 … 1."""
    count = min(max(length // _KNOT_DISTANCE, 2), _MOST_KNOTS)
    knots = np.linspace(-1, 1, count)
    return [np.maximum(0.0, 1 - np.abs(place - knot) * (count - 1) / 2) for knot in knots]
