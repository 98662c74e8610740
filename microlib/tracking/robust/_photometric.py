"""Alignment with a photometric model: smooth light, blur and a tone curve, fitted robustly.

The image under the warp is a sum of columns: the template, its products with the coordinates, its
change by a blur, its square and cube (a tone curve), and a bias interpolated between knots.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.interpolate import BSpline

from microlib._common import Array, Image
from microlib.tracking._esm import Alignment, Level
from microlib.tracking._geometry import TINY, degenerate, retract
from microlib.tracking.robust._blocks import Blocks, compare
from microlib.tracking.robust._normal_equations import weighted_least_squares

#: Columns whose derivative by the template's grey value is not zero come first; the first is the
#: template itself.
_GAINS = 6

#: Standard deviation (px of the finest level of the search) of the Gaussian window in which gain
#: and bias count as constant. With twice as much no more is found; the glare asks for little.
_WINDOW = 3.5

#: Most steps, and the motion of the corners (samples) that ends them.
_ITERATIONS, _TOLERANCE = 9, 0.02

#: Where Tukey's biweight ends, in standard deviations: 95 % efficient for normal noise.
_TUKEY = 4.685

#: Standard deviation of a normal variable over the median of its size.
_NORMAL = 1.4826


@dataclass(frozen=True, eq=False, kw_only=True)
class PhotometricFit(Alignment):
    """Where an alignment in smooth light ended; gain and bias are those at the middle.

    Attributes
    ----------
    blocks : Blocks
        Parts of the image beside those of the template in its light, blur and tone.
    noise : float
        Robust standard deviation of the residual over the noise.
    slope : ndarray, shape (H, W)
        Derivative of weight times residual by the residual.
    hidden : ndarray of bool, shape (H, W)
        Pixels whose residual is neither noise nor small beside the template.
    """

    blocks: Blocks
    noise: float
    slope: Image
    hidden: Image


@dataclass(frozen=True, eq=False)
class _Step:
    """Derivatives, residuals and weights of a step, and the scale of the residuals."""

    design: Image
    residual: Image
    weight: Image
    scale: float


@dataclass(frozen=True, eq=False)
class PhotometricLevel(Level):
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

    def align_photometric(
        self, image: Image, pose: Array, noise: float, saturation: float
    ) -> PhotometricFit | None:
        """Align from a pose, or return None where too little of the template is seen."""
        n, unit = len(self.basis), noise * self.noise
        first = corners = self.corners_of(pose)
        grey, slope, share = self.patch(image, pose, saturation)
        inliers = inlier_weight(self, grey, share, unit).ravel()
        response = weighted_least_squares(self.light, grey.ravel(), inliers)
        count, moved = 0, np.inf
        while count < _ITERATIONS and moved >= _TOLERANCE:
            gain = response[:_GAINS].astype(np.float32) @ self.tone
            slope = np.float32(0.5) * (slope + gain * self.slope)
            motion = self.flow[0] * slope[0] + self.flow[1] * slope[1]
            design = np.concatenate([motion, self.light])
            residual = grey.ravel() - response.astype(np.float32) @ self.light
            inside = share.ravel() * inliers
            sure = np.abs(residual[inside > 1 / 3])
            if sure.size < 3 * len(design):
                return None
            scale = max(_NORMAL * float(np.median(sure)), unit)
            weight = (inside * tukey(residual, scale)).astype(np.float32)
            change = weighted_least_squares(design, residual, weight, motions=n)
            response, pose = response + change[n:], retract(pose, -change[:n], self.basis)
            before, corners = corners, self.corners_of(pose)
            if degenerate(corners, first):
                return None
            count, moved = count + 1, float(np.abs(corners - before).max())
            grey, slope, share = self.patch(image, pose, saturation)
        shape, gain = self.grey.shape, float(response[0]) / self.contrast
        residual, weight = residual.reshape(shape), weight.reshape(shape)
        model = (response[:_GAINS] @ self.light[:_GAINS]).astype(np.float32).reshape(shape)
        middle = self.light[_GAINS:, self.grey.size // 2 + shape[1] // 2]
        return PhotometricFit(
            pose=pose,
            correlation=_explained(grey, residual, weight),
            gain=gain,
            bias=float(response[_GAINS:] @ middle) - gain * self.mean,
            visible=float(share.mean()),
            iterations=count,
            design=design,
            residual=residual,
            weight=weight,
            blocks=compare(grey, model, share, unit),
            noise=scale / unit,
            slope=_tukey_slope(weight, residual, scale),
            hidden=_hidden(residual, model, unit),
        )


def inlier_weight(level: Level, grey: Image, share: Image, noise: float) -> Image:
    """Return how well each pixel of a patch agrees with the template, 0 to 1.

    That is the correlation with the template in a window about the pixel, or, where there is little
    texture, how far their difference is noise, which may have 3 times its variance; the gain must
    be that of the rest, within a factor of 2. `share` says how far a pixel counts, and `noise` is
    its standard deviation, whose variance keeps what is flat from correlating by chance.
    """

    def window(image: Image) -> Image:
        return cv2.GaussianBlur(image, (0, 0), _WINDOW, borderType=cv2.BORDER_CONSTANT)

    count = np.maximum(window(share), np.float32(TINY))
    template = level.grey
    t, g = window(share * template) / count, window(share * grey) / count
    tt = np.maximum(window(share * template**2) / count - t * t, 0) + noise**2
    gg = np.maximum(window(share * grey**2) / count - g * g, 0) + noise**2
    tg = window(share * template * grey) / count - t * g
    gain, correlation = tg / tt, tg / np.sqrt(tt * gg)
    sure = correlation > 0.7
    usual = float(np.median(gain[sure])) if sure.any() else 1.0
    alike = np.where((gain > usual / 2) & (gain < 2 * usual), correlation, 0)
    rest = gg - 2 * usual * tg + usual**2 * tt - (1 + usual**2) * noise**2
    noisy = 6 * noise**2 / np.maximum(rest, 6 * noise**2)
    return np.maximum(np.maximum(alike, noisy), 0).astype(np.float32) * share


def tukey(residual: Array, scale: float) -> Array:
    """Return Tukey's weights."""
    return np.square(np.maximum(1 - np.square(residual / (_TUKEY * scale)), 0))


def _tukey_slope(weight: Image, residual: Image, scale: float) -> Image:
    """Return the derivative of the weighted residuals by the residuals, for Tukey's biweight."""
    square = (residual / (_TUKEY * scale)) ** 2
    # The weight is inliers·(1 − u²)², the slope inliers·(1 − u²)(1 − 5u²).
    return np.where(square < 1, weight * (1 - 5 * square) / np.maximum(1 - square, TINY), 0)


def _explained(grey: Image, residual: Image, weight: Image) -> float:
    """Return the weighted correlation of grey values with what is left without the residual."""
    share = weight / max(float(weight.sum()), TINY)
    spread = float((share * (grey - (share * grey).sum()) ** 2).sum())
    left = float((share * residual**2).sum())
    return float(np.sqrt(max(1.0 - left / max(spread, TINY), 0.0)))


def _hidden(residual: Image, model: Image, noise: float) -> Image:
    """Return the pixels whose residual is neither noise nor small beside the template.

    The mean square residual about them, over 1.5 px, exceeds nine times the noise's and a quarter
    of the template's variance about them.
    """
    square = cv2.GaussianBlur(residual**2, (0, 0), 1.5)
    mean = cv2.GaussianBlur(model, (0, 0), _WINDOW)
    variance = cv2.GaussianBlur(model**2, (0, 0), _WINDOW) - mean**2
    return np.asarray(square > (3 * noise) ** 2 + variance / 4)


def make_photometric(level: Level, blurred: Level, bias_splines: int) -> PhotometricLevel:
    """Return the columns of the light of a template, which is given a little `blurred`, too.

    The bias is a sum of so many splines along each side.
    """
    rows, columns = level.grey.shape
    contrast = max(level.contrast, TINY)
    t = (level.grey - level.mean) / contrast
    v, u = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    blur = blurred.grey - level.grey
    one, zero = np.ones_like(t), np.zeros_like(t)
    # A column, and its derivative by the template's grey value.
    gains = [
        (t, one),
        (u * t, u),
        (v * t, v),
        (blur / max(float(blur.std()), TINY), zero),
        (t * t, 2 * t),
        (t**3, 3 * t * t),
    ]
    across, down = (_splines(side, bias_splines) for side in (columns, rows))
    biases = [a * b[:, None] for a in across for b in down]
    light = np.array([column for column, _ in gains] + biases, np.float32)
    tone = np.array([slope for _, slope in gains], np.float32) / np.float32(contrast)
    own = {**vars(level), "contrast": contrast}
    return PhotometricLevel(
        **own, light=light.reshape(len(light), -1), tone=tone.reshape(len(tone), -1)
    )


def _splines(length: int, count: int) -> Array:
    """Return cubic B-splines with evenly spaced knots, count×length."""
    knots = np.concatenate([[-1.0] * 3, np.linspace(-1, 1, count - 2), [1.0] * 3])
    return BSpline.design_matrix(np.linspace(-1, 1, length), knots, 3).toarray().T
