"""Efficient second-order minimization (ESM) of the difference between a template and an image.

The warp is a matrix on homogeneous template coordinates, updated as ``G ← G exp(Σ xᵢ Bᵢ)`` with the
generators Bᵢ of its group: translation, affine, or the homographies through sl(3). Averaging the
gradients of the template and of the warped image gives the step second-order convergence at the
price of a first-order one (Malis 2004, Benhimane and Malis 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.tracking._loops import moved

#: Group of warps to the entries (row, column, value) of each of its generators.
_GENERATORS: dict[str, list[list[tuple[int, int, float]]]] = {
    "translation": [[(0, 2, 1)], [(1, 2, 1)]],
    "affine": [[(0, 2, 1)], [(1, 2, 1)], [(0, 0, 1)], [(0, 1, 1)], [(1, 0, 1)], [(1, 1, 1)]],
    "homography": [
        [(0, 2, 1)],
        [(1, 2, 1)],
        [(0, 1, 1)],
        [(1, 0, 1)],
        [(0, 0, 1), (1, 1, -1)],
        [(1, 1, -1), (2, 2, 1)],
        [(2, 0, 1)],
        [(2, 1, 1)],
    ],
}
MOTIONS = tuple(_GENERATORS)

#: Lagrange's interpolation half-way between six equidistant samples, exact for quintic polynomials.
_HALF_SAMPLE = np.array([[3, -25, 150, 150, -25, 3]], np.float32) / 256

#: Pixels beyond the template that its gradient needs: the differences span five pixels.
_MARGIN = 2

# What the following are worth is in the benchmark of tracking, table "Constants".

#: Relative damping of the normal equations: far below any information in an image, it keeps a
#: direction that the image does not determine (an aperture problem) at rest instead of dividing by
#: rounding errors. The same success from 0 to 10⁻⁶.
_DAMPING = 1e-9

#: Ratio of the norms of two columns of the design at which the smaller one counts as absent. The
#: same results at 10⁻⁹; at 10⁻³ the bias, whose column is the smallest, is taken for absent.
_VANISHING = 1e-6

#: A template whose area changes by more than this factor within one frame is not tracked any more,
#: nor one that is turned over. A guard: at 2 1 % fewer homographies are found, at 16 and without it
#: the results are the same.
_AREA_FACTOR = 4.0

#: A motion parameter that steps further, in half template sizes, has left the template. A guard
#: that keeps the exponential finite: the same results at 1, at 16, and without it.
_LARGEST_STEP = 4.0

#: Least share of the template's pixels that must lie inside the image for it to be in view. Where
#: the template stays inside, nothing depends on it.
_LEAST_VISIBLE = 0.25

#: Radius of the Gaussian in standard deviations; 0.3 % of its weight lies beyond along either axis.
#: The same results from 1 to 4.
_TRUNCATION = 3


def generators(motion: str) -> Array:
    """Return the generators of a group of warps, n×3×3."""
    basis = np.zeros((len(_GENERATORS[motion]), 3, 3))
    for matrix, entries in zip(basis, _GENERATORS[motion], strict=True):
        for row, column, value in entries:
            matrix[row, column] = value
    return basis


def apply_homography(matrix: Array, points: Array) -> Array:
    """Map N×2 points by a 3×3 homography."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def half_pixel(image: Image) -> Image:
    """Return the image sampled every half pixel; the even samples are the image itself.

    Bilinear interpolation between these samples has an eighth of the phase error of bilinear
    interpolation between the pixels, which is what limits the accuracy of a tracker on fine
    texture.
    """
    fine = np.empty((2 * image.shape[0], 2 * image.shape[1]), np.float32)
    rows = np.empty((image.shape[0], fine.shape[1]), np.float32)
    rows[:, ::2] = image
    rows[:, 1::2] = cv2.filter2D(image, -1, _HALF_SAMPLE, anchor=(2, 0))
    fine[::2] = rows
    fine[1::2] = cv2.filter2D(rows, -1, _HALF_SAMPLE.T, anchor=(0, 2))
    return fine


@dataclass(frozen=True)
class Alignment:
    """Where the minimization at one level left the warp.

    Attributes
    ----------
    pose : ndarray, shape (3, 3)
        Warp of normalized template coordinates to px of the image.
    failure : str
        Empty, or why the minimization gave up: ``"singular"``, ``"diverged"`` or ``"out of view"``;
        the pose is then the last good one.
    correlation : float
        Normalized correlation of template and warped image over the visible pixels.
    gain, bias : float
        Grey values of the image are ``gain``·template + ``bias``.
    visible : float
        Share of the template's pixels that the image shows.
    iterations : int
        Steps taken.
    design : ndarray, shape (n + 3, N)
        Derivatives of the grey values by the motion; template, one and image, less the mean of the
        template; all zero where the image shows nothing. Of the last step.
    """

    pose: Array
    failure: str = ""
    correlation: float = 0.0
    gain: float = 1.0
    bias: float = 0.0
    visible: float = 0.0
    iterations: int = 0
    design: Array | None = None


@dataclass(frozen=True)
class Level:
    """A level of the pyramid: the template at one resolution, with all that frames leave alone.

    Attributes
    ----------
    to_image : ndarray, shape (3, 3)
        Pixels of the frame to samples of this level's image.
    to_template : ndarray, shape (3, 3)
        Pixels of the padded patch to normalized template coordinates.
    padded : tuple of int
        Width and height of the patch with the padding that smoothing and gradients need.
    smoothing : float
        Standard deviation, in px of the patch, of the Gaussian applied in the template's frame:
        smoothing there, and not in the image, commutes with the warp.
    corners : ndarray, shape (4, 2)
        Corners of the template in normalized coordinates.
    basis : ndarray, shape (n, 3, 3)
        Generators of the motion.
    flow : ndarray, shape (2, n, N)
        Velocity (x and y, px of the patch) of each pixel for each generator.
    template, gradient : ndarray, shapes (N,) and (2, N)
        Grey values less `mean`, and their gradient in x and y per px of the patch.
    mean, contrast : float
        Mean and standard deviation of the template's grey values.
    mask : ndarray of uint8, shape (H, W), or None
        Pixels that count; all of them without one.
    """

    to_image: Array
    to_template: Array
    padded: tuple[int, int]
    smoothing: float
    corners: Array
    basis: Array
    flow: Image
    template: Image
    gradient: Image
    mean: float
    contrast: float
    mask: NDArray[np.uint8] | None = None

    def align(
        self, image: Image, pose: Array, *, tolerance: float, iterations: int, gain: float = 1.0
    ) -> Alignment:
        """Minimize over warp, gain and bias until the corners move by less than `tolerance` px."""
        n = len(self.basis)
        first = corners = apply_homography(pose, self.corners)
        for count in range(1, iterations + 1):
            rows, visible = self._design(image, pose, gain)
            if visible < _LEAST_VISIBLE:
                return Alignment(pose, failure="out of view", visible=visible, iterations=count)
            normal = rows @ rows.T
            scale = np.sqrt(np.diag(normal))
            if scale[:-1].min() <= _VANISHING * scale[:-1].max():
                return Alignment(pose, failure="singular", visible=visible, iterations=count)
            scale[-1] = scale[-1] or 1.0  # a frame that is flat at the mean of the template
            scaled = normal / np.outer(scale, scale)
            system = scaled[:-1, :-1].copy()
            system.flat[:: n + 3] += _DAMPING
            solution = np.linalg.solve(system, scaled[:-1, -1]) * scale[-1] / scale[:-1]
            step = -solution[:n]
            if not np.abs(step).max() < _LARGEST_STEP:  # also True for NaN
                return Alignment(pose, failure="diverged", visible=visible, iterations=count)
            after = moved(pose, step, self.basis)
            before, corners = corners, apply_homography(after, self.corners)
            if _degenerate(corners, first):
                return Alignment(pose, failure="diverged", visible=visible, iterations=count)
            pose, gain = after, float(solution[n])
            if np.abs(corners - before).max() < tolerance:
                break
        return Alignment(
            pose=pose,
            correlation=_correlation(normal[n:, n:]),
            gain=gain,
            bias=float(solution[n + 1]) + self.mean * (1.0 - gain),
            visible=visible,
            iterations=count,
            design=rows,
        )

    def correlate(self, image: Image, pose: Array, reach: int) -> Array:
        """Return the pose shifted, by up to `reach` px of the patch, to the best correlation."""
        # In px of the padded patch; smoothing takes the rest of the padding off again.
        first = _MARGIN - reach
        size = (self.padded[0] - 2 * first, self.padded[1] - 2 * first)
        to_window = np.array([[1.0, 0, first], [0, 1, first], [0, 0, 1]])
        warp = self.to_image @ pose @ self.to_template @ to_window
        window = _sample(image, warp, size, self.smoothing)
        width = self.padded[0] - 2 * _padding(self.smoothing)
        scores = cv2.matchTemplate(
            window, self.template.reshape(-1, width), cv2.TM_CCOEFF_NORMED, mask=self.mask
        )
        row, column = np.unravel_index(np.argmax(scores), scores.shape)
        shift = np.eye(3)
        shift[:2, 2] = self.to_template[0, 0] * (np.array([column, row]) - reach)
        return pose @ shift

    def places(self, image: Image, count: int) -> Array:
        """Return (x, y) of the template's middle, px of the frame, where it correlates best.

        `image` is the whole frame at this level's resolution.
        """
        width = self.padded[0] - 2 * _padding(self.smoothing)
        template = self.template.reshape(-1, width)
        if min(np.subtract(image.shape, template.shape)) < 0:
            return np.empty((0, 2))
        smooth = cv2.GaussianBlur(image, (0, 0), self.smoothing) if self.smoothing else image
        scores = cv2.matchTemplate(smooth, template, cv2.TM_CCOEFF_NORMED, mask=self.mask)
        apart = np.ones((2 * (len(template) // 4) + 1, 2 * (width // 4) + 1), np.uint8)
        peaks = (scores == cv2.dilate(scores, apart)) & np.isfinite(scores) & (scores > 0)
        rows, columns = np.nonzero(peaks)
        best = np.argsort(-scores[rows, columns])[:count]
        middle = np.array([width - 1, len(template) - 1]) / 2
        return (np.column_stack([columns[best], rows[best]]) + middle) / self.to_image[0, 0]

    def _design(self, image: Image, pose: Array, gain: float) -> tuple[Array, float]:
        """Return image Jacobian, template, one and image as rows, and the share of pixels in view.

        The product of these rows with themselves holds the whole of the normal equations. The
        Jacobian is the flow times the mean of the image's gradient and `gain` times the template's.
        """
        n = len(self.basis)
        warp = self.to_image @ pose @ self.to_template
        grey, gradient = _grey_and_gradient(_sample(image, warp, self.padded, self.smoothing))
        grey = grey - np.float32(self.mean)
        gradient = np.float32(0.5) * (gradient + np.float32(gain) * self.gradient)
        rows = np.empty((n + 3, grey.size), np.float32)
        np.multiply(self.flow[0], gradient[0], out=rows[:n])
        rows[:n] += self.flow[1] * gradient[1]
        rows[n], rows[n + 1], rows[n + 2] = self.template, 1.0, grey
        visible = _visible(image, warp, self.padded, _padding(self.smoothing))
        if self.mask is None:
            if visible is None:
                return rows.astype(np.float64), 1.0
            return (rows * visible).astype(np.float64), float(visible.mean())
        counts = self.mask.ravel().astype(np.float32)
        seen = counts if visible is None else counts * visible
        return (rows * seen).astype(np.float64), float(seen.sum() / counts.sum())


def make_level(
    image: Image,
    box: tuple[int, int, int, int],
    pose: Array,
    *,
    step: int,
    density: int,
    smoothing: float,
    motion: str,
    mask: NDArray[np.bool_] | None = None,
) -> Level:
    """Cut a template from an image of the pyramid.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The whole frame at this resolution, so that the template's gradients see what lies around
        it.
    box : tuple of int
        (x, y, width, height) in px of the frame.
    pose : ndarray, shape (3, 3)
        Normalized template coordinates to px of the frame.
    step : int
        Px of the frame between neighboring pixels of the template.
    density : int
        Samples of `image` for `step` px of the frame.
    smoothing : float
        Standard deviation of the Gaussian in px of the template.
    motion : str
        One of `MOTIONS`.
    mask : ndarray of bool, optional
        Pixels of the box that count.
    """
    x, y, width, height = box
    left, top = -(-x // step), -(-y // step)
    columns, rows = (x + width - 1) // step - left + 1, (y + height - 1) // step - top + 1
    pad = _padding(smoothing)
    padded = (columns + 2 * pad, rows + 2 * pad)
    to_frame = np.array(
        [[step, 0, step * (left - pad)], [0, step, step * (top - pad)], [0, 0, 1.0]]
    )
    to_image = np.diag([density / step, density / step, 1.0])
    to_template = np.linalg.inv(pose) @ to_frame
    template, gradient = _grey_and_gradient(_sample(image, to_image @ to_frame, padded, smoothing))
    counts = None
    if mask is not None:
        counts = mask[step * top - y :: step, step * left - x :: step].astype(np.uint8)
    counted = template if counts is None else template[counts.ravel() > 0]
    mean = float(counted.mean())
    column, row = np.meshgrid(np.arange(columns) + pad, np.arange(rows) + pad)
    grid = np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    points = to_template @ grid
    basis = generators(motion)
    velocity = basis @ points
    flow = (velocity[:, :2] - points[:2] * velocity[:, 2:]) / to_template[0, 0]
    edges = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [width - 1, height - 1] + [x, y]
    return Level(
        to_image=to_image,
        to_template=to_template,
        padded=padded,
        smoothing=smoothing,
        corners=apply_homography(np.linalg.inv(pose), edges),
        basis=basis,
        flow=np.ascontiguousarray(flow.transpose(1, 0, 2), np.float32),
        template=template - np.float32(mean),
        gradient=gradient,
        mean=mean,
        contrast=float(counted.std()),
        mask=counts,
    )


def _padding(smoothing: float) -> int:
    """Return the margin of a patch: the Gaussian's radius and two pixels for the gradient."""
    return int(np.ceil(_TRUNCATION * smoothing)) + _MARGIN


def _sample(image: Image, warp: Array, padded: tuple[int, int], smoothing: float) -> Image:
    """Warp a patch out of the image and smooth it, leaving the margin of the gradient."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    patch = cv2.warpPerspective(image, warp, padded, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    radius = _padding(smoothing) - _MARGIN
    if radius == 0:
        return patch
    size = (2 * radius + 1, 2 * radius + 1)
    return cv2.GaussianBlur(patch, size, smoothing)[radius:-radius, radius:-radius]


def _grey_and_gradient(patch: Image) -> tuple[Image, Image]:
    """Return the grey values inside the margin, and fourth-order central differences in x and y."""
    rows, columns = patch[2:-2], patch[:, 2:-2]
    inner = np.stack([rows[:, 3:-1] - rows[:, 1:-3], columns[3:-1] - columns[1:-3]])
    outer = np.stack([rows[:, 4:] - rows[:, :-4], columns[4:] - columns[:-4]])
    gradient = np.float32(2 / 3) * inner - np.float32(1 / 12) * outer
    return rows[:, 2:-2].ravel(), gradient.reshape(2, -1)


def _visible(image: Image, warp: Array, padded: tuple[int, int], pad: int) -> Image | None:
    """Return which pixels of the template the image shows, or None if it shows all of them."""
    last = np.array(image.shape[::-1]) - 1.0
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array(padded) - 1.0)
    mapped = apply_homography(warp, corners)
    if (mapped >= 0).all() and (mapped <= last).all():
        return None
    column, row = np.meshgrid(np.arange(pad, padded[0] - pad), np.arange(pad, padded[1] - pad))
    points = apply_homography(warp, np.column_stack([column.ravel(), row.ravel()]))
    inside = (points >= 0) & (points <= last)
    return (inside[:, 0] & inside[:, 1]).astype(np.float32)


def _correlation(normal: Array) -> float:
    """Return the correlation from the products of template, one and image with each other."""
    template, one, image = range(3)
    count = normal[one, one]
    covariance = normal - np.outer(normal[one], normal[one]) / count
    variances = covariance[template, template] * covariance[image, image]
    return float(covariance[template, image] / np.sqrt(variances)) if variances > 0 else 0.0


def _degenerate(corners: Array, first: Array) -> bool:
    """Return whether a warp tore the template: not finite, turned over, or of another area."""
    ratio = area(corners) / area(first)
    return not 1 / _AREA_FACTOR < ratio < _AREA_FACTOR  # also True for NaN


def area(corners: Array) -> float:
    """Return the signed area of a quadrilateral."""
    (ax, ay), (bx, by) = corners[2] - corners[0], corners[3] - corners[1]
    return 0.5 * float(ax * by - ay * bx)


def cut_around(image: NDArray, corners: Array, margin: float) -> tuple[NDArray, Array]:
    """Return the part of an image around some corners and where its first pixel was, (x, y)."""
    size = np.array(image.shape[::-1])
    first = np.clip(np.floor(corners.min(axis=0) - margin), 0, size).astype(int)
    last = np.clip(np.ceil(corners.max(axis=0) + margin) + 1, 0, size).astype(int)
    return image[first[1] : last[1], first[0] : last[0]], first.astype(np.float64)


def shifted(pose: Array, by: Array) -> Array:
    """Return the pose followed by a translation of the image."""
    shift = np.eye(3)
    shift[:2, 2] = by
    return shift @ pose


def halved(image: Image) -> Image:
    """Return the image at half its resolution; its pixels are the even ones of the image."""
    return cv2.pyrDown(image).astype(np.float32, copy=False)


def pyramid(image: Image, levels: int) -> list[Image]:
    """Return the image and its successive halves."""
    layers = [image]
    for _ in range(levels - 1):
        layers.append(halved(layers[-1]))
    return layers
