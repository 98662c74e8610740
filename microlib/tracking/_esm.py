"""Efficient second-order minimization (ESM) of the difference between a template and an image.

Averaging the gradients of the template and of the warped image gives the step second-order
convergence at the price of a first-order one (Malis 2004, Benhimane and Malis 2004).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import cv2
import numpy as np

from microlib._common import Array, Image
from microlib.tracking._geometry import (
    GENERATORS,
    ROUNDING,
    TINY,
    advance,
    apply_homography,
    cut_around,
    translate,
)
from microlib.tracking._normal_equations import gram
from microlib.tracking._sampling import cut_out, half_pixel, noise_gain, padding, sample
from microlib.tracking._settings import TrackerSettings

#: Margin (px) of the part of a frame that is sampled at half pixels: three pixels of interpolation,
#: and one by which the alignment may move.
_MARGIN = 4.0


def _nothing() -> Image:
    return np.empty((0, 0))


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of a minimization over the warp.

    Attributes
    ----------
    pose : ndarray, shape (3, 3)
        Warp of normalized template coordinates to px of the image.
    reason : str
        Empty, or why the alignment does not count as the template: ``"singular"``, ``"diverged"``
        or ``"out of view"`` if the minimization failed, and ``"low correlation"``. After a failure
        the pose is the last one before it.
    correlation : float
        Normalized correlation of template and warped image, weighted; 0 after a failure.
    gain, bias : float
        Grey values of the image are ``gain``·template + ``bias``.
    visible : float
        Share of the template's pixels that the image shows.
    iterations : int
        Steps taken.
    design : ndarray, shape (n + m, N)
        Derivatives of the grey values by the motion and the photometric parameters, of the last
        step.
    grey, residual, weight : ndarray, shape (H, W)
        Image under the warp before the last step, its residual, and the weights of the pixels;
        empty after a failure. A `PhotometricFit` has no `grey`.
    """

    pose: Array
    reason: str = ""
    correlation: float = 0.0
    gain: float = 1.0
    bias: float = 0.0
    visible: float = 0.0
    iterations: int = 0
    design: Array = field(default_factory=_nothing)
    grey: Image = field(default_factory=_nothing)
    residual: Image = field(default_factory=_nothing)
    weight: Image = field(default_factory=_nothing)


@dataclass(frozen=True, eq=False)
class Level:
    """The template at one resolution, with all that does not depend on the frame.

    Attributes
    ----------
    settings : TrackerSettings
        Settings of the alignment.
    halvings : int
        How often the frame is halved for this level.
    to_image : ndarray, shape (3, 3)
        Pixels of the frame to samples of this level's image.
    to_template : ndarray, shape (3, 3)
        Pixels of the padded patch to normalized template coordinates.
    smoothing : float
        Standard deviation, in px of the patch, of the Gaussian applied in the template's frame.
    corners : ndarray, shape (4, 2)
        Corners of the template in normalized coordinates.
    basis : ndarray, shape (n, 3, 3)
        Generators of the motion.
    grey, gradient : ndarray, shapes (H, W) and (2, N)
        Grey values, and their gradient in x and y per px of the patch.
    mean, contrast : float
        Mean and standard deviation of the grey values.
    noise_gain : float
        Standard deviation that white noise of unit variance has at this level.
    mask : ndarray or None
        Share of each pixel of the padded patch that shows the object; None if all of it does.
    size : float
        Number of the template's pixels that show the object.
    """

    settings: TrackerSettings
    halvings: int
    to_image: Array
    to_template: Array
    smoothing: float
    corners: Array
    basis: Array
    grey: Image
    gradient: Image
    mean: float
    contrast: float
    noise_gain: float
    mask: Image | None
    size: float

    @cached_property
    def flow(self) -> Image:
        """Velocity (x and y, px of the patch) of each pixel for each generator, 2×n×N."""
        rows, columns = self.grey.shape
        pad = padding(self.smoothing)
        column, row = np.meshgrid(np.arange(columns) + pad, np.arange(rows) + pad)
        points = self.to_template @ np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
        velocity = self.basis @ points
        flow = (velocity[:, :2] - points[:2] * velocity[:, 2:]) / self.to_template[0, 0]
        return np.ascontiguousarray(flow.transpose(1, 0, 2), np.float32)

    @cached_property
    def weight(self) -> Image:
        """Share of each pixel that shows the object, H×W."""
        if self.mask is None:
            return np.ones_like(self.grey)
        pad = padding(self.smoothing)
        return self.mask[pad:-pad, pad:-pad]

    def visible(self, weight: Image) -> float:
        """Return the share of the template whose pixels have a weight."""
        return float(weight.sum()) / self.size

    @cached_property
    def centered(self) -> Image:
        """The grey values about their mean."""
        return (self.grey - np.float32(self.mean)).ravel()

    def patch(
        self, image: Image, pose: Array, saturation: float = np.inf
    ) -> tuple[Image, Image, Image]:
        """Return the image under a pose, its gradient, and the weight of each pixel.

        A saturated pixel has no weight, unless the template is saturated there, too.
        """
        warp = self.to_image @ pose @ self.to_template
        grey, gradient, inside = cut_out(image, warp, self.grey.shape, self.smoothing, self.mask)
        if saturation < np.inf:
            inside = inside & ((grey < saturation) | (self.grey >= saturation))
        return grey, gradient, inside * self.weight

    def align(self, image: Image, pose: Array, *, tolerance: float, gain: float = 1.0) -> Alignment:
        """Minimize over warp, gain and bias until the corners move by less than `tolerance` px."""
        n, settings, start = len(self.basis), self.settings, pose
        for count in range(1, settings.max_iterations + 1):
            grey, gradient, weight = self.patch(image, pose)
            visible = self.visible(weight)
            failed = partial(Alignment, pose, visible=visible, iterations=count)
            if visible < settings.min_visible:
                return failed(reason="out of view")
            rows = self._rows(grey, gradient, weight, gain)
            normal = gram(rows, rows)
            solution = _solved(normal)
            if not solution.size:
                return failed(reason="singular")
            pose, distance = advance(pose, -solution[:n], start, self.basis, self.corners)
            if np.isnan(distance):
                return failed(reason="diverged")
            gain = float(solution[n])
            if distance < tolerance:
                break
        correlation = _correlation(normal[n:, n:])
        return Alignment(
            pose=pose,
            reason="" if correlation >= settings.min_correlation else "low correlation",
            correlation=correlation,
            gain=gain,
            bias=float(solution[n + 1]) + self.mean * (1.0 - gain),
            visible=visible,
            iterations=count,
            design=rows[: n + 2],
            grey=grey,
            residual=(rows[n + 2] - solution[n:] @ rows[n : n + 2]).reshape(grey.shape),
            weight=weight,
        )

    def _rows(self, grey: Image, gradient: Image, weight: Image, gain: float) -> Array:
        """Return the rows of the least squares: for each motion, template, one, and the image.

        Their products with each other are the whole of the normal equations. The gradient is the
        mean of those of the image and of the template, which makes the step one of second order:
        (J(e) + J(x))/2 of Benhimane and Malis (2004).
        """
        n = len(self.basis)
        rows = np.empty((n + 3, grey.size), np.float32)
        gradient = gradient + np.float32(gain) * self.gradient
        gradient *= weight.ravel() * np.float32(0.5)
        np.multiply(self.flow[0], gradient[0], out=rows[:n])
        rows[:n] += self.flow[1] * gradient[1]
        rows[n], rows[n + 1], rows[n + 2] = self.centered, 1.0, grey.ravel()
        rows[n + 2] -= self.mean
        rows[n:] *= weight.ravel()
        return rows


@dataclass(frozen=True, eq=False)
class Template:
    """A template at its two levels: smoothed, and not smoothed but sampled at half pixels."""

    smooth: Level
    sharp: Level

    def corners_of(self, pose: Array) -> Array:
        """Return the corners of the template at a pose, 4×2 px."""
        return apply_homography(pose, self.sharp.corners)

    def align(self, image: Image, pose: Array) -> Alignment:
        """Align from a pose with the smoothed level, and then with the one of half pixels."""
        settings = self.sharp.settings
        rough = self.smooth.align(image, pose, tolerance=settings.rough_tolerance)
        if rough.reason:
            return rough
        near, offset = cut_around(image, self.corners_of(rough.pose), _MARGIN)
        start = translate(rough.pose, -offset)
        fine = self.sharp.align(
            half_pixel(near), start, tolerance=settings.tolerance, gain=rough.gain
        )
        steps = rough.iterations + fine.iterations
        return replace(fine, pose=translate(fine.pose, offset), iterations=steps)


def _solved(normal: Array) -> Array:
    """Return the solution of normal equations, whose last row is the right side.

    They are scaled and damped by far less than any information in an image, so that a direction
    that it does not determine (an aperture problem) stays at rest. Nothing if a column vanishes.
    """
    scale = np.sqrt(normal.diagonal())
    if scale[:-1].min() <= ROUNDING * scale[:-1].max():
        return np.empty(0)
    scale[-1] = scale[-1] or 1.0  # a frame that is flat at the mean of the template
    scaled = normal / (scale[:, None] * scale)
    system = scaled[:-1, :-1] + TINY * np.eye(len(scale) - 1)
    return np.linalg.solve(system, scaled[:-1, -1]) * scale[-1] / scale[:-1]


def _correlation(normal: Array) -> float:
    """Return the correlation from the products of template, one and image with each other."""
    (tt, t, tg), (_, one, g), (_, _, gg) = normal
    variances = (tt - t * t / one) * (gg - g * g / one)
    return float((tg - t * g / one) / np.sqrt(variances)) if variances > 0 else 0.0


def make_level(
    image: Image,
    box: tuple[int, int, int, int],
    pose: Array,
    *,
    halvings: int = 0,
    density: int = 1,
    smoothing: float,
    motion: str,
    settings: TrackerSettings,
    mask: Image | None = None,
) -> Level:
    """Cut a template from a frame at one resolution.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The whole frame at this resolution, so that the template's gradients see what lies around
        it.
    box : tuple of int
        (x, y, width, height) in px of the frame.
    pose : ndarray, shape (3, 3)
        Normalized template coordinates to px of the frame.
    halvings, density : int
        How often the frame was halved, and samples of `image` for a px of that.
    smoothing : float
        Standard deviation of the Gaussian in px of the template.
    motion : str
        One of `GENERATORS`.
    settings : TrackerSettings
        Settings of the alignment.
    mask : ndarray, shape (H, W), optional
        1 where the frame shows the object, and 0 elsewhere.
    """
    x, y, width, height = box
    step = 2**halvings
    left, top = -(-x // step), -(-y // step)
    columns, rows = (x + width - 1) // step - left + 1, (y + height - 1) // step - top + 1
    pad = padding(smoothing)
    to_frame = np.array(
        [[step, 0, step * (left - pad)], [0, step, step * (top - pad)], [0, 0, 1.0]]
    )
    to_image = np.diag([density / step, density / step, 1.0])
    to_template = np.linalg.inv(pose) @ to_frame
    if mask is not None:
        share = cv2.blur(mask, (2 * step - 1,) * 2)
        share, _ = sample(share, to_frame, (columns + 2 * pad, rows + 2 * pad))
        mask = np.where(share > 0.5, share, np.float32(0))  # most of it is the object
    grey, gradient, _ = cut_out(image, to_image @ to_frame, (rows, columns), smoothing, mask)
    weight = np.ones(grey.shape) if mask is None else mask[pad:-pad, pad:-pad].astype(np.float64)
    edges = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [width - 1, height - 1] + [x, y]
    mean = float(np.average(grey, weights=weight))
    return Level(
        settings=settings,
        halvings=halvings,
        to_image=to_image,
        to_template=to_template,
        smoothing=smoothing,
        corners=apply_homography(np.linalg.inv(pose), edges),
        basis=GENERATORS[motion],
        grey=grey,
        gradient=gradient,
        mean=mean,
        contrast=float(np.sqrt(np.average((grey - mean) ** 2, weights=weight))),
        noise_gain=noise_gain(halvings, density, smoothing),
        mask=mask,
        size=float(weight.sum()),
    )


def check_texture(template: Template) -> None:
    """Raise if the template is flat, or a translation leaves it unchanged in some direction."""
    smooth, sharp = template.smooth, template.sharp
    if smooth.contrast < 0.01 * sharp.contrast:
        raise ValueError(
            f"box must hold texture coarser than 1 px, got a contrast of {sharp.contrast:.3g} of "
            f"which a blur of {smooth.smoothing:g} px leaves {smooth.contrast:.3g}"
        )
    gradient = sharp.gradient.astype(np.float64) * sharp.weight.ravel()
    weak, strong = np.linalg.eigvalsh(gradient @ gradient.T)  # of the structure tensor
    # The gradient that rounding to single precision gives a flat template.
    if strong <= (ROUNDING * np.abs(sharp.grey).max()) ** 2 * sharp.grey.size:
        raise ValueError("box must hold a textured template, got a flat one")
    # A straight edge whose noise is 0.5 % of its height has a ratio of 0.002.
    if weak < 1e-4 * strong:
        raise ValueError(
            "box must hold gradients in two directions, got a template that slides along its edges"
        )
