"""Alignment in a light that varies smoothly, through a blur and a tone curve, robustly.

The image under the warp is a sum of columns: the template, its products with the coordinates, its
change by a blur, its square and cube (a tone curve), and a bias interpolated between knots.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._blocks import Agreement, agreement
from microlib.tracking._esm import Alignment
from microlib.tracking._geometry import moved, torn
from microlib.tracking._local import NORMAL, TRUSTED, TUKEY, LocalLevel, tukey

#: Px between the knots of the bias at least, and the most of them along a side. With 3 knots 67 %,
#: with 5 78 % of the templates behind a glare are found (development pairs).
_KNOT_DISTANCE, _MOST_KNOTS = 10, 5

#: Columns whose derivative by the template's grey value is not zero come first; the first is the
#: template itself.
_GAINS = 6

#: Relative and absolute ridge of the light: knots that no pixel shows stay as they are.
_RIDGE, _LEAST_RIDGE = 1e-6, 1e-3

#: Rounds of reweighting before the first step in smooth light.
_ROUNDS = 5

#: A pixel is hidden where the mean square residual about it, over 1.5 px, exceeds nine times the
#: noise's and a quarter of the template's variance about it, over 3.5 px.
_HIDDEN, _HIDDEN_SHARE, _ABOUT, _ABOUT_TEMPLATE = 9.0, 0.25, 1.5, 3.5


@dataclass(frozen=True, eq=False, kw_only=True)
class LitFit(Alignment):
    """Where an alignment in smooth light ended; gain and bias are those at the middle.

    Attributes
    ----------
    agreement : Agreement
        What the blocks say of it, of the template in its light, blur and tone.
    noise : float
        Robust standard deviation of the residual over the noise.
    slope : ndarray, shape (H, W)
        Derivative of weight times residual by the residual.
    bend : float
        Largest of blur and tone over the gain.
    hidden : ndarray of bool, shape (H, W)
        Pixels whose residual is neither noise nor small beside the template.
    """

    agreement: Agreement
    noise: float
    slope: Image
    bend: float
    hidden: Image


@dataclass(frozen=True, eq=False)
class LitLevel(LocalLevel):
    """A template, sampled at half pixels, with the columns of its light.

    Attributes
    ----------
    light : ndarray, shape (m, N)
        Columns of the light.
    tone : ndarray, shape (6, N)
        Derivatives of the first of them by the template's grey value.
    """

    light: Image
    tone: Image

    def align_lit(
        self,
        image: Image,
        pose: Array,
        *,
        noise: float,
        ceiling: float,
        iterations: int,
        tolerance: float,
    ) -> LitFit | None:
        """Align from a pose, or return None where too little of the template is seen."""
        n, m, unit = len(self.basis), len(self.light), noise * self.noise
        start = before = self.corners_of(pose)
        grey, slope, share = self.patch(image, pose, ceiling)
        trust = self.trust(grey, share, noise).ravel()
        amounts = self._first_light(grey.ravel(), trust, unit)
        if amounts is None:
            return None
        steps, way = 0, np.inf
        while steps < iterations and way >= tolerance:
            residual = grey.ravel() - amounts.astype(np.float32) @ self.light
            gain = amounts[:_GAINS].astype(np.float32) @ self.tone
            slope = np.float32(0.5) * (slope + gain * self.slope)
            design = np.concatenate([self.flow[0] * slope[0] + self.flow[1] * slope[1], self.light])
            weight = share.ravel() * trust
            scale = _scale(residual, weight, unit, n + m)
            if not scale:
                return None
            weight = (weight * tukey(residual, scale)).astype(np.float32)
            step = _solved(design, residual, weight, motions=n)
            amounts, pose = amounts + step[n:], moved(pose, -step[:n], self.basis)
            after = self.corners_of(pose)
            if torn(after, start):
                return None
            steps, way, before = steps + 1, float(np.abs(after - before).max()), after
            grey, slope, share = self.patch(image, pose, ceiling)
        shape = self.grey.shape
        residual, weight = residual.reshape(shape), weight.reshape(shape)
        model = (amounts[:_GAINS] @ self.light[:_GAINS]).astype(np.float32).reshape(shape)
        gain = float(amounts[0]) / self.contrast
        middle = self.light[_GAINS:, self.grey.size // 2 + shape[1] // 2]
        return LitFit(
            pose=pose,
            correlation=_explained(grey, residual, weight),
            gain=gain,
            bias=float(amounts[_GAINS:] @ middle) - gain * self.mean,
            visible=float(share.mean()),
            iterations=steps,
            design=design,
            residual=residual,
            weight=weight,
            agreement=agreement(grey, model, share, unit),
            noise=scale / unit,
            slope=_tukey_slope(weight, residual, scale),
            bend=float(np.abs(amounts[3:_GAINS]).max() / max(abs(amounts[0]), 1e-9)),
            hidden=_hidden(residual, model, unit),
        )

    def _first_light(self, grey: Image, share: Image, noise: float) -> Array | None:
        """Fit the light alone, robustly, at the pose as it is; None if there is too little."""
        weight = share
        for _ in range(_ROUNDS):
            amounts = _solved(self.light, grey, weight)
            residual = grey - amounts.astype(np.float32) @ self.light
            scale = _scale(residual, share, noise, len(self.light))
            if not scale:
                return None
            weight = (share * tukey(residual, scale)).astype(np.float32)
        return amounts


def _scale(residual: Image, share: Image, least: float, count: int) -> float:
    """Return the standard deviation of the trusted residuals, 0 if they are too few."""
    kept = np.abs(residual[share > TRUSTED])
    if kept.size < 3 * count:
        return 0.0
    return max(NORMAL * float(np.median(kept)), least)


def _solved(design: Image, value: Image, weight: Image, motions: int = 0) -> Array:
    """Return the weighted least squares, of which all but the first unknowns have a ridge."""
    weighted = design * weight
    normal = (weighted @ design.T).astype(np.float64)
    normal.flat[:: len(normal) + 1] = normal.diagonal() * (1 + _RIDGE) + 1e-12
    normal.flat[motions * (len(normal) + 1) :: len(normal) + 1] += _LEAST_RIDGE
    return np.linalg.solve(normal, (weighted @ value).astype(np.float64))


def _tukey_slope(weight: Image, residual: Image, scale: float) -> Image:
    """Return the derivative of the weighted residuals by the residuals, for Tukey's biweight."""
    square = (residual / (TUKEY * scale)) ** 2
    # The weight is trust·(1 − u²)², the slope trust·(1 − u²)(1 − 5u²).
    return np.where(square < 1, weight * (1 - 5 * square) / np.maximum(1 - square, 1e-6), 0)


def _explained(grey: Image, residual: Image, weight: Image) -> float:
    """Return the weighted correlation of grey values with what is left without the residual."""
    share = weight / max(float(weight.sum()), 1e-9)
    spread = float((share * (grey - (share * grey).sum()) ** 2).sum())
    left = float((share * residual**2).sum())
    return float(np.sqrt(max(1.0 - left / max(spread, 1e-9), 0.0)))


def _hidden(residual: Image, model: Image, noise: float) -> Image:
    """Return the pixels whose residual is neither noise nor small beside the template."""
    square = cv2.GaussianBlur(residual**2, (0, 0), _ABOUT)
    mean = cv2.GaussianBlur(model, (0, 0), _ABOUT_TEMPLATE)
    variance = cv2.GaussianBlur(model**2, (0, 0), _ABOUT_TEMPLATE) - mean**2
    return np.asarray(square > _HIDDEN * noise**2 + _HIDDEN_SHARE * variance)


def make_lit(level: LocalLevel, blurred: LocalLevel) -> LitLevel:
    """Return the columns of the light of a template, which is given a little `blurred`, too."""
    rows, columns = level.grey.shape
    contrast = max(level.contrast, 1e-9)
    t = (level.grey - level.mean) / contrast
    v, u = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    blur = blurred.grey - level.grey
    one, zero = np.ones_like(t), np.zeros_like(t)
    # A column, and its derivative by the template's grey value.
    gains = [
        (t, one),
        (u * t, u),
        (v * t, v),
        (blur / max(float(blur.std()), 1e-9), zero),
        (t * t, 2 * t),
        (t**3, 3 * t * t),
    ]
    biases = [a * b for a in _knots(u, columns) for b in _knots(v, rows)]
    light = np.array([column for column, _ in gains] + biases, np.float32)
    tone = np.array([slope for _, slope in gains], np.float32) / np.float32(contrast)
    own = {**vars(level), "contrast": contrast}
    return LitLevel(**own, light=light.reshape(len(light), -1), tone=tone.reshape(len(tone), -1))


def _knots(place: Array, length: int) -> list[Array]:
    """Return hats between evenly spaced knots over −1 … 1."""
    count = min(max(length // _KNOT_DISTANCE, 2), _MOST_KNOTS)
    knots = np.linspace(-1, 1, count)
    return [np.maximum(0.0, 1 - np.abs(place - knot) * (count - 1) / 2) for knot in knots]
