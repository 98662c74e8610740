"""Alignment with a photometric model: smooth light, blur and a tone curve, fitted robustly.

The image under the warp is a sum of columns: the template, its products with the coordinates, its
change by a blur, its square and cube (a tone curve), and a bias that is a sum of cubic splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from scipy.interpolate import BSpline

from microlib._common import TUKEY_LIMIT, Array, Image, robust_std, tukey_weights
from microlib.tracking._esm import Alignment, Level
from microlib.tracking._geometry import TINY, advance
from microlib.tracking._normal_equations import weighted_least_squares
from microlib.tracking.robust._blocks import Blocks, compare

#: The columns that depend on the template come first, those of the bias behind.
_TEMPLATE, _BIAS = slice(0, 6), slice(6, None)


@dataclass(frozen=True, eq=False, kw_only=True)
class PhotometricFit(Alignment):
    """Result of an alignment with the photometric model; gain and bias are those at the middle.

    The correlation is the multiple correlation of the grey values with all columns of the model.

    Attributes
    ----------
    blocks : Blocks
        Parts of the image beside those of the template in the fitted light, blur and tone.
    noise_ratio : float
        Robust standard deviation of the residual over the noise.
    psi_slope : ndarray, shape (H, W)
        Derivative of the M-estimator's ψ, weight times residual, by the residual.
    hidden : ndarray of bool, shape (H, W)
        Pixels whose residual is neither noise nor small beside the template.
    blur : int
        Number of the blur of the template.
    """

    blur: int = 0
    blocks: Blocks
    noise_ratio: float
    psi_slope: Image
    hidden: Image


@dataclass(frozen=True, eq=False)
class PhotometricLevel(Level):
    """A template with the columns of the photometric model.

    Attributes
    ----------
    blurred : ndarray, shape (H, W)
        Grey values after a small blur.
    """

    blurred: Image

    @cached_property
    def columns(self) -> tuple[Image, Image]:
        """Grey values that the model sums up, and derivatives by the template's, m×N and 6×N.

        Only the first columns depend on the template.
        """
        contrast = max(self.contrast, TINY)
        rows, columns = self.grey.shape
        t = (self.grey - self.mean) / contrast
        v, u = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
        blur = self.blurred - self.grey
        blur /= max(float(blur.std()), TINY)
        # Gain, gain along x and along y, blur, and the square and cube of a tone curve.
        values = np.stack([t, u * t, v * t, blur, t**2, t**3]).astype(np.float32)
        slopes = np.stack([np.ones_like(t), u, v, 0 * t, 2 * t, 3 * t**2]) / contrast
        bias = _bias_columns(rows, columns, self.settings.bias_splines)
        values = np.concatenate([values.reshape(6, -1), bias])
        return values, slopes.reshape(6, -1).astype(np.float32)

    def align_photometric(
        self, image: Image, pose: Array, noise: float, saturation: float
    ) -> PhotometricFit | None:
        """Align from a pose, or return None where too little of the template is seen.

        Each iteration is a step of ESM on the motion and the coefficients of all columns, by
        iteratively reweighted least squares with Tukey's biweight.
        """
        n, noise, settings, start = len(self.basis), noise * self.noise_gain, self.settings, pose
        tolerance = settings.robust_tolerance * 2**self.halvings
        grey, gradient, weight = self.patch(image, pose, saturation)
        inliers = inlier_weight(self, grey, weight, noise).ravel()
        columns, slopes = self.columns
        coefficients = weighted_least_squares(columns, grey.ravel(), inliers)
        steps = 0
        while steps < settings.robust_iterations:
            steps += 1
            gain = coefficients[_TEMPLATE].astype(np.float32) @ slopes
            mean = np.float32(0.5) * (gradient + gain * self.gradient)  # of ESM, as in `_rows`
            motion = self.flow[0] * mean[0] + self.flow[1] * mean[1]
            design = np.concatenate([motion, columns])
            residual = grey.ravel() - coefficients.astype(np.float32) @ columns
            prior = weight.ravel() * inliers
            of_inliers = residual[prior > 1 / 3]
            if of_inliers.size < 3 * len(design):
                return None
            scale = max(robust_std(of_inliers), noise)
            robust = (prior * tukey_weights(residual, TUKEY_LIMIT * scale)).astype(np.float32)
            step = weighted_least_squares(design, residual, robust, motions=n)
            coefficients = coefficients + step[n:]
            pose, distance = advance(pose, -step[:n], start, self.basis, self.corners)
            if np.isnan(distance):
                return None
            grey, gradient, weight = self.patch(image, pose, saturation)
            if distance < tolerance:
                break
        shape = self.grey.shape
        residual, robust = residual.reshape(shape), robust.reshape(shape)
        model = (coefficients[_TEMPLATE] @ columns[_TEMPLATE]).astype(np.float32)
        middle = columns[_BIAS, (shape[0] // 2) * shape[1] + shape[1] // 2]
        gain_of_middle = float(coefficients[0]) / max(self.contrast, TINY)
        correlation = _multiple_correlation(grey, residual, robust)
        return PhotometricFit(
            pose=pose,
            reason="" if correlation >= settings.min_correlation else "low correlation",
            correlation=correlation,
            gain=gain_of_middle,
            bias=float(coefficients[_BIAS] @ middle) - gain_of_middle * self.mean,
            visible=self.visible(weight),
            iterations=steps,
            design=design,
            residual=residual,
            weight=robust,
            blocks=compare(grey, model.reshape(shape), weight, noise, settings),
            noise_ratio=scale / noise,
            psi_slope=_tukey_slope(robust, residual, TUKEY_LIMIT * scale),
            hidden=_hidden(
                np.where(self.weight > 0, residual, 0), model.reshape(shape), noise, settings.window
            ),
        )


def inlier_weight(level: Level, grey: Image, weight: Image, noise: float) -> Image:
    """Return how well each pixel of a patch agrees with the template, 0 to 1.

    That is the correlation with the template in a window about the pixel, or, where there is little
    texture, how far their difference is noise, which may have 3 times its variance; the gain must
    be within a factor of 2 of its median. `weight` is that of the pixels, and `noise` their
    standard deviation, whose variance keeps what is flat from correlating by chance.
    """

    def window(image: Image) -> Image:
        sigma = level.settings.window
        return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)

    count = np.maximum(window(weight), np.float32(TINY))
    template = level.grey
    t, g = window(weight * template) / count, window(weight * grey) / count
    tt = np.maximum(window(weight * template**2) / count - t * t, 0) + noise**2
    gg = np.maximum(window(weight * grey**2) / count - g * g, 0) + noise**2
    tg = window(weight * template * grey) / count - t * g
    gain, correlation = tg / tt, tg / np.sqrt(tt * gg)
    correlated = correlation > 0.7
    median = float(np.median(gain[correlated])) if correlated.any() else 1.0
    by_texture = np.where((gain > median / 2) & (gain < 2 * median), correlation, 0)
    # Variance of g − median·t. Of noise alone in both images it is 2 noise² at a gain of 1.
    difference = gg - 2 * median * tg + median**2 * tt - (1 + median**2) * noise**2
    by_noise = 6 * noise**2 / np.maximum(difference, 6 * noise**2)
    return np.maximum(np.maximum(by_texture, by_noise), 0).astype(np.float32) * weight


def _tukey_slope(weight: Image, residual: Image, limit: float) -> Image:
    """Return the derivative of the weighted residuals by the residuals, for Tukey's biweight.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib._common import tukey_weights
    >>> from microlib.tracking.robust._photometric import _tukey_slope
    >>> residual = np.linspace(-6, 6, 9)
    >>> near = residual + [[-1e-6], [1e-6]]
    >>> difference = np.diff(near * tukey_weights(near, 5.0), axis=0)[0] / 2e-6
    >>> slope = _tukey_slope(tukey_weights(residual, 5.0), residual, 5.0)
    >>> np.allclose(slope, difference, atol=1e-8)
    True
    """
    square = (residual / limit) ** 2
    # The weight is inliers·(1 − u²)², the slope inliers·(1 − u²)(1 − 5u²).
    return np.where(square < 1, weight * (1 - 5 * square) / np.maximum(1 - square, TINY), 0)


def _multiple_correlation(grey: Image, residual: Image, weight: Image) -> float:
    """Return the weighted correlation of grey values with their fit, R = √(1 − RSS/TSS)."""
    unit = weight / max(float(weight.sum()), TINY)
    total = float((unit * (grey - (unit * grey).sum()) ** 2).sum())
    unexplained = float((unit * residual**2).sum())
    return float(np.sqrt(max(1.0 - unexplained / max(total, TINY), 0.0)))


def _hidden(residual: Image, model: Image, noise: float, window: float) -> Image:
    """Return the pixels whose residual is neither noise nor small beside the template.

    The mean square residual about them, over 1.5 px, exceeds the sum of nine times the noise's and
    a quarter of the template's variance about them.
    """
    square = cv2.GaussianBlur(residual**2, (0, 0), 1.5)
    mean = cv2.GaussianBlur(model, (0, 0), window)
    variance = cv2.GaussianBlur(model**2, (0, 0), window) - mean**2
    return np.asarray(square > (3 * noise) ** 2 + variance / 4)


@lru_cache(maxsize=8)
def _bias_columns(rows: int, columns: int, count: int) -> Image:
    """Return the products of cubic B-splines with evenly spaced knots along both sides."""
    knots = np.concatenate([[-1.0] * 3, np.linspace(-1, 1, count - 2), [1.0] * 3])
    down, across = (
        BSpline.design_matrix(np.linspace(-1, 1, side), knots, 3).toarray().T
        for side in (rows, columns)
    )
    return (across[:, None, None] * down[:, :, None]).reshape(count**2, -1).astype(np.float32)
