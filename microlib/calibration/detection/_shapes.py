"""Models of blurred ellipses, quadrilaterals and crossings of edges, and their fit to marks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from microlib._common import Array
from microlib.calibration._detection import MIN_MARKS
from microlib.calibration.detection._image import GreyImage
from microlib.calibration.detection._marks import Marks
from microlib.calibration.detection._outlines import (
    BLUR,
    OutlineFit,
    band,
    cut_patches,
    fit_shapes,
)
from microlib.calibration.detection._settings import DetectionSettings

# Parameters of an ellipse: its center, the shape matrix A with |A·(x − center)| = 1 on the ellipse,
# then the parameters that all outlines have.
CENTER, _SHAPE = slice(0, 2), slice(2, 5)
#: Least divisor, at the center of an ellipse, where no fitted pixel is.
_MIN_DIVISOR = 1e-9

# Parameters of lines, the four of a quadrilateral or the two at a corner of a board: angles of the
# (outward) normals, distances from the origin of the patch, then the common parameters.
#: Corners of a square about its middle, in sides, along the lattice's two steps; line k leads from
#: the corner before to corner k.
CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


class MarkPoints(NamedTuple):
    """Points of n fitted marks: the centers of circles, or the corners of squares and boards.

    Attributes
    ----------
    points : ndarray, shape (n, k, 2)
        The k points of each mark, px.
    uncertainty : ndarray, shape (n, k)
        Standard deviation of a coordinate of each point, px.
    extent : ndarray, shape (n, 1, 2)
        Distances along x and y from the points within which the mark lies, px.
    """

    points: Array
    uncertainty: Array
    extent: Array


def are_round(image: GreyImage, marks: Marks, steps: Array, settings: DetectionSettings) -> bool:
    """Whether ellipses fit the grey levels of the marks better than quadrilaterals."""
    # A few marks suffice, as each has hundreds of pixels. The first marks of a lattice are
    # neighbors, so that their bands do not overlap.
    first = slice(2 * MIN_MARKS)
    short = replace(settings, max_iterations=settings.shape_iterations)
    quads = fit_quads(image, marks[first], steps[first], short)
    ellipses = fit_ellipses(image, marks[first], short)
    of_quads, of_ellipses = (float(np.nanmedian(fit.rms)) for fit in (quads, ellipses))
    if min(of_quads, of_ellipses) > settings.max_round_rms * np.ptp(image.smooth):
        raise ValueError("image must show marks on a ground, got ones that no outline fits")
    return of_ellipses < of_quads


def fit_ellipses(image: GreyImage, marks: Marks, settings: DetectionSettings) -> OutlineFit:
    """Fit an ellipse to each mark, from its moments."""
    values, vectors = np.linalg.eigh(marks.moments)  # a filled ellipse has A = ½ Σ^(−½)
    shape = (vectors / (2 * np.sqrt(values))[:, None, :]) @ vectors.transpose(0, 2, 1)
    own = np.hstack([marks.centers - np.round(marks.centers), shape[:, [0, 0, 1], [0, 1, 1]]])
    start = np.pad(own, [(0, 0), (0, -BLUR)])
    radius = float(1 / np.sqrt(np.linalg.det(shape).min()))
    near, gap = band(marks.centers, radius, settings)
    half = 3 / 2 * radius - near[0]  # the longer axis is 1.5 mean radii at a tilt of 64°
    patches = cut_patches(
        image.grey, marks.centers, half, lambda x, y: _to_ellipse(start, x, y)[0], near
    )
    return fit_shapes(_ellipse, start, patches, gap, settings)


def ellipse_matrices(fit: OutlineFit) -> Array:
    """Symmetric matrices A⁻¹ from the unit circle to each ellipse, (n, 2, 2), px."""
    return np.linalg.inv(fit.parameters[:, _SHAPE][:, [[0, 1], [1, 2]]])


def ellipse_centers(fit: OutlineFit) -> MarkPoints:
    """Center of each ellipse."""
    variance = np.einsum("nii->ni", fit.covariance[:, CENTER, CENTER]).mean(axis=1)
    return MarkPoints(
        points=(fit.parameters[:, CENTER] + fit.centers)[:, None],
        uncertainty=np.sqrt(variance)[:, None],
        # The lengths of the rows of A⁻¹ are half the width and height of the ellipse.
        extent=np.linalg.norm(ellipse_matrices(fit), axis=2)[:, None],
    )


def fit_quads(
    image: GreyImage, marks: Marks, steps: Array, settings: DetectionSettings
) -> OutlineFit:
    """Fit four lines to each mark, from a square along the lattice's steps."""
    origin = np.round(marks.centers)
    side = np.sqrt(marks.areas / np.abs(np.linalg.det(steps)))[:, None, None]
    corners = side * (CORNERS @ steps.transpose(0, 2, 1)) + (marks.centers - origin)[:, None]
    before = np.roll(corners, 1, axis=1)
    outward = np.sign(np.linalg.det(steps))[:, None, None]
    start = _start_lines(outward * (corners - before), (corners + before) / 2)
    width = float(np.median(line_offsets(start).sum(axis=1)) / 2)
    near, gap = band(marks.centers, width / 2, settings)
    half = width - near[0]  # half a diagonal and some for the tilt
    patches = cut_patches(
        image.grey, marks.centers, half, lambda x, y: _to_lines(start, x, y).min(axis=-1), near
    )
    return fit_shapes(_quad, start, patches, gap, settings)


def fit_crossings(
    image: GreyImage, marks: Marks, steps: Array, half_width: float, settings: DetectionSettings
) -> OutlineFit:
    """Fit two lines to each corner of a board, along the lattice's steps, in patches of
    `half_width` fields."""
    side = np.abs(np.linalg.det(steps)) / np.linalg.norm(steps, axis=1).max(axis=1)
    radius = np.clip(half_width * side, 3, settings.max_patch)[:, None]
    patches = cut_patches(
        image.grey,
        marks.centers,
        radius.max(),
        lambda x, y: np.hypot(x, y) / radius,
        (0.0, 1.0),
    )
    start = _start_lines(steps.transpose(0, 2, 1), (marks.centers - patches.centers)[:, None])
    start[:, BLUR] = settings.initial_blur
    dark = _crossing(start, patches.x, patches.y)[0] - 0.5
    bright = (dark * (patches.grey - patches.grey.mean()) * patches.weight).sum(axis=1) > 0
    start[bright, 0] += np.pi  # the dark fields are the other two
    start[bright, 2] *= -1
    return fit_shapes(_crossing, start, patches, np.inf, settings)


def line_offsets(parameters: Array) -> Array:
    """Distances of the lines from the patch's origin, (n, lines), px."""
    return parameters[:, (parameters.shape[1] + BLUR) // 2 : BLUR]


def _start_lines(along: Array, on: Array) -> Array:
    """Parameters of lines by their directions and points on them, (n, lines, 2)."""
    angle = np.unwrap(np.arctan2(-along[..., 0], along[..., 1]), axis=0)
    offset = np.cos(angle) * on[..., 0] + np.sin(angle) * on[..., 1]
    return np.pad(np.hstack([angle, offset]), [(0, 0), (0, -BLUR)])


def line_crossings(fit: OutlineFit) -> MarkPoints:
    """Intersections of consecutive lines: four of four lines, one of two."""
    offset = line_offsets(fit.parameters)
    lines = offset.shape[1]
    first = np.arange(4 if lines == 4 else 1)
    pair = np.column_stack([first, (first + 1) % lines])  # (corners, 2)
    angle = fit.parameters[:, pair]
    cos, sin = np.cos(angle), np.sin(angle)
    inverse = np.linalg.inv(np.stack([cos, sin], axis=-1))
    corners = (inverse @ offset[:, pair][..., None])[..., 0]
    # Turning a line by dθ moves it at the corner by (sin θ x − cos θ y) dθ along its normal.
    slide = sin * corners[..., :1] - cos * corners[..., 1:]
    by = np.concatenate([inverse * slide[..., None, :], inverse], axis=-1)
    places = np.hstack([pair, lines + pair])
    part = fit.covariance[:, places[:, :, None], places[:, None, :]]
    return MarkPoints(
        points=corners + fit.centers[:, None],
        uncertainty=np.sqrt(np.einsum("ncij,ncjk,ncik->nc", by, part, by) / 2),
        extent=np.zeros((len(corners), 1, 2)),
    )


def _to_ellipse(parameters: Array, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Distance to the ellipse, positive inside, px: (1 − ρ)/|∇ρ| with ρ = |A (x − center)|.

    Also the unit normal ∇ρ/|∇ρ| (two arrays) and ∂ρ/∂A divided by |∇ρ|, (n, k, 3).
    """
    a, b, d = (p[:, None] for p in parameters[:, _SHAPE].T)
    dx, dy = x - parameters[:, :1], y - parameters[:, 1:2]
    qx, qy = a * dx + b * dy, b * dx + d * dy
    rho = np.maximum(np.hypot(qx, qy), _MIN_DIVISOR)
    gx, gy = (a * qx + b * qy) / rho, (b * qx + d * qy) / rho
    steep = np.maximum(np.hypot(gx, gy), _MIN_DIVISOR)
    by_shape = np.stack([qx * dx, qx * dy + qy * dx, qy * dy], axis=-1) / (rho * steep)[..., None]
    return (1 - rho) / steep, gx / steep, gy / steep, by_shape


def _ellipse(parameters: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The coverage of pixels by a blurred ellipse, and its derivatives."""
    distance, nx, ny, by_shape = _to_ellipse(parameters, x, y)
    edge, by_blur = _edge(parameters)
    z = distance / edge
    slope = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * edge)
    by = np.stack([nx, ny, *np.moveaxis(-by_shape, -1, 0), -z * by_blur], axis=-1)
    return ndtr(z), slope[..., None] * by


def _to_lines(parameters: Array, x: Array, y: Array) -> Array:
    """Distances to the lines, positive inside, (n, k, lines), px."""
    offset = line_offsets(parameters)[:, None]
    angle = parameters[:, None, : offset.shape[-1]]
    return offset - np.cos(angle) * x[..., None] - np.sin(angle) * y[..., None]


def _quad(parameters: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The coverage of pixels by a blurred quadrilateral, and its derivatives.

    It is the product of four half-planes, exact for a right angle and a Gaussian blur.
    """
    z, of_lines = _lines(parameters, x, y)
    a, b, c, d = np.moveaxis(ndtr(z), -1, 0)
    return a * b * c * d, of_lines(np.stack([b * c * d, a * c * d, a * b * d, a * b * c], axis=-1))


def _crossing(parameters: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The coverage of pixels by two fields that touch at the crossing of two lines, and its
    derivatives."""
    z, of_lines = _lines(parameters, x, y)
    a, b = np.moveaxis(ndtr(z), -1, 0)
    return a * b + (1 - a) * (1 - b), of_lines(np.stack([2 * b - 1, 2 * a - 1], axis=-1))


def _lines(parameters: Array, x: Array, y: Array) -> tuple[Array, Callable[[Array], Array]]:
    """Distances to the lines over the width of their edge, and the function from derivatives by the
    coverage of each half-plane to derivatives by the parameters."""
    edge, edge_by_blur = (each[..., None] for each in _edge(parameters))
    z = _to_lines(parameters, x, y) / edge
    angle = parameters[:, None, : z.shape[-1]]

    def of_lines(by_part: Array) -> Array:
        by_distance = by_part * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * edge)
        turning = np.sin(angle) * x[..., None] - np.cos(angle) * y[..., None]
        by_blur = -(by_distance * z * edge_by_blur).sum(axis=-1, keepdims=True)
        return np.concatenate([by_distance * turning, by_distance, by_blur], axis=-1)

    return z, of_lines


def _edge(parameters: Array) -> tuple[Array, Array]:
    """Standard deviation of the edge of each outline, from blur and pixel width, and its derivative
    by the blur."""
    blur = parameters[:, BLUR, None]
    edge = np.sqrt(blur**2 + 1 / 12)
    return edge, blur / edge
