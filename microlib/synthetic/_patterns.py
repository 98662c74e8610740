"""Render calibration targets through a :class:`~microlib.microscope.Microscope`.

Each pixel is cut into cells, each cell is projected back to the pattern plane, and the area of it
that the pattern covers is computed, not sampled. Blur by the point-spread function, uneven light
and noise follow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, as_array, as_image_shape, as_scalar
from microlib.microscope import Microscope
from microlib.synthetic._textures import noise_source

#: Cells along a side of a pixel; the edges inside a cell are straight to within its curvature, an
#: error of 1/(24·9 r²) of a circle's area, 2e-5 for a radius of 16 px.
_CELLS = 3
#: Prevents 0/0 for directions and lengths of zero, µm.
_TINY = 1e-12

Counts = tuple[int, int] | None
Coverage = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class ImagingConditions:
    """Illumination, blur and noise of a rendered pattern.

    Parameters
    ----------
    blur : float
        Standard deviation of the Gaussian point-spread function, px.
    dark, bright : float
        Grey levels of the pattern and of its background in full light, 0 to 255.
    vignetting : float
        Relative loss of light in the corners of the image, proportional to the squared radius.
    gradient : (float, float)
        Relative change of the light from the left edge to the right and from the top to the bottom.
    noise : float
        Standard deviation of the additive Gaussian noise, grey levels.
    """

    blur: float = 1.0
    dark: float = 50.0
    bright: float = 200.0
    vignetting: float = 0.0
    gradient: tuple[float, float] = (0.0, 0.0)
    noise: float = 0.0

    def __post_init__(self) -> None:
        for name in ("blur", "noise"):
            object.__setattr__(self, name, as_scalar(name, getattr(self, name), least=0))
        for name in ("dark", "bright"):
            level = as_scalar(name, getattr(self, name), least=0, most=255)
            object.__setattr__(self, name, level)
        loss = as_scalar("vignetting", self.vignetting, least=0, most=1)
        object.__setattr__(self, "vignetting", loss)
        as_array("gradient", self.gradient, shape=(2,), least=-1, most=1)


def render_circles(
    microscope: Microscope,
    *,
    radius: float = 70.0,
    pitch: float = 280.0,
    counts: Counts = None,
    imaging: ImagingConditions | None = None,
    rng: np.random.Generator | int | None = None,
) -> NDArray[np.float32]:
    """Render a grid of dark circles; the center of circle (i, j) is the world point (i, j)·pitch.

    Parameters
    ----------
    microscope : Microscope
        The camera with its tilt and distortion.
    radius, pitch : float
        Radius of the circles and distance of their centers, µm. Circles must not touch.
    counts : (int, int), optional
        Number of circles along x and y, from the world origin on; without it they fill the plane.
    imaging : ImagingConditions, optional
        Blur, light and noise.
    rng : numpy.random.Generator or int, optional
        Random generator of the noise, or its seed; required if there is noise.

    Returns
    -------
    ndarray of float32, shape (height, width)
        Grey levels, clipped to [0, 255] and not rounded.

    Raises
    ------
    ValueError
        If the circles touch or a parameter is out of range, or if there is noise but no `rng`.

    Examples
    --------
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> scope = Microscope(
    ...     200000, 126000, 79380, tx=-140, ty=-140, pixel_pitch=9.9, image_size=(120, 90))
    >>> image = render_circles(scope)
    >>> image.shape, float(image.min().round()), float(image.max().round())
    ((90, 120), 50.0, 200.0)
    """
    radius = as_scalar("radius", radius, above=0)
    pitch = as_scalar("pitch", pitch, above=0)
    if not 2 * radius < pitch:
        raise ValueError(f"pitch must exceed the diameter {2 * radius:g} µm, got {pitch:g}")

    def covered(plane: Array, jacobian: Array) -> Array:
        offset = plane - pitch * _nearest(plane / pitch, counts)
        distance = np.hypot(*offset.T)
        normal = offset / np.maximum(distance, _TINY)[:, None]
        return _half_plane(radius - distance, normal, jacobian)

    def depth(plane: Array) -> Array:
        offset = plane - pitch * _nearest(plane / pitch, counts)
        return radius - np.hypot(offset[..., 0], offset[..., 1])

    return _render(microscope, depth, covered, counts, imaging, rng)


def render_squares(
    microscope: Microscope,
    *,
    side: float = 200.0,
    counts: Counts = None,
    imaging: ImagingConditions | None = None,
    rng: np.random.Generator | int | None = None,
) -> NDArray[np.float32]:
    """Render dark squares with gaps of one side; their corners are the points (i, j)·side.

    Square (m, n) has its corners at (2m, 2n), (2m+1, 2n), (2m+1, 2n+1) and (2m, 2n+1) times `side`,
    so the corners of all squares form one regular grid.

    Parameters
    ----------
    microscope : Microscope
        The camera with its tilt and distortion.
    side : float
        Side of the squares and width of the gaps, µm.
    counts : (int, int), optional
        Number of squares along x and y, from the world origin on; without it they fill the plane.
    imaging : ImagingConditions, optional
        Blur, light and noise.
    rng : numpy.random.Generator or int, optional
        Random generator of the noise, or its seed; required if there is noise.

    Returns
    -------
    ndarray of float32, shape (height, width)
        Grey levels, clipped to [0, 255] and not rounded.

    Raises
    ------
    ValueError
        If a parameter is out of range, or if there is noise but no `rng`.

    Examples
    --------
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_squares
    >>> scope = Microscope(
    ...     200000, 126000, 79380, tx=-100, ty=-100, pixel_pitch=9.9, image_size=(120, 90))
    >>> image = render_squares(scope, counts=(1, 1))
    >>> area = ((200 - image) / 150).sum() * (9.9 / scope.magnification) ** 2  # µm²
    >>> round(float(area) ** 0.5, 1)
    200.0
    """
    side = as_scalar("side", side, above=0)
    half = side / 2

    def offset(plane: Array) -> Array:
        return plane - half - 2 * side * _nearest((plane - half) / (2 * side), counts)

    def sides(o: Array, jacobian: Array) -> Array:
        # The center cell is as far from either side.
        normals = np.where(o < 0, -1.0, 1.0)[:, :, None] * np.eye(2)
        inside = half - np.abs(o)
        return np.stack([_half_plane(inside[:, k], normals[:, k], jacobian) for k in (0, 1)])

    def covered(plane: Array, jacobian: Array) -> Array:
        # The product of two half-planes is exact except for a cell that contains a corner and is
        # rotated against it: such a cell is cut again.
        o = offset(plane)
        both = sides(o, jacobian)
        area = both.prod(axis=0)
        corner = ((both > 0) & (both < 1)).all(axis=0)
        parts = 8  # along a side: to 1/24 px
        steps = (np.arange(parts) + 0.5) / parts - 0.5
        shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        fine = o[corner, None] + shifts @ jacobian[corner].transpose(0, 2, 1)
        small = jacobian[corner].repeat(len(shifts), axis=0) / parts
        pieces = sides(fine.reshape(-1, 2), small).prod(axis=0)
        area[corner] = pieces.reshape(-1, len(shifts)).mean(axis=1)
        return area

    def depth(plane: Array) -> Array:
        return half - np.abs(offset(plane)).max(axis=-1)

    return _render(microscope, depth, covered, counts, imaging, rng)


def _nearest(lattice: Array, counts: Counts) -> Array:
    """Return the index of the nearest point of the finite lattice."""
    index = np.round(lattice)
    if counts is None:
        return index
    return np.clip(index, 0, np.array(counts) - 1)


def _half_plane(inside: Array, normal: Array, jacobian: Array) -> Array:
    """Return the area of each unit cell on the inner side of a straight edge.

    `inside` is the distance of the cell's center from the edge (µm, positive inside) and `normal`
    the edge's unit normal, both on the pattern plane; `jacobian` maps steps of a cell to µm. The
    area is the distribution function of the trapezoid that the cell's projection on the normal
    makes.
    """
    step = np.abs(np.einsum("nij,ni->nj", jacobian, normal))
    length = np.maximum(np.hypot(*step.T), _TINY)
    a, b = np.sort(step / length[:, None], axis=1).T
    # Along the cells the trapezoid becomes a box, and its sloping sides must not vanish.
    a = np.maximum(a, 1e-4)
    wide, narrow = (b + a) / 2, (b - a) / 2
    d = np.clip(inside / length, -wide, wide)
    ramps = [np.maximum(d + s, 0) ** 2 for s in (wide, narrow, -narrow, -wide)]
    area = (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / (2 * a * b)
    return np.where(d == wide, 1.0, np.where(d == -wide, 0.0, area))


def _render(
    microscope: Microscope,
    depth: Callable[[Array], Array],
    covered: Coverage,
    counts: Counts,
    imaging: ImagingConditions | None,
    rng: np.random.Generator | int | None,
) -> NDArray[np.float32]:
    """Render the pattern; `depth` returns the signed distance to its outline, µm."""
    imaging = ImagingConditions() if imaging is None else imaging
    if counts is not None:
        as_image_shape("counts", counts)
    source = noise_source(rng, imaging.noise)
    width, height = microscope.image_size
    margin = int(np.ceil(4 * imaging.blur)) + 1  # 6e-5 of the point spread lie beyond
    rows, columns = np.arange(height + 2 * margin) - margin, np.arange(width + 2 * margin) - margin
    shape = (len(rows), len(columns))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)
    plane = microscope.back_project(pixels).reshape(*shape, 2)
    jacobian = np.stack([np.gradient(plane, axis=1), np.gradient(plane, axis=0)], axis=-1)

    # Only pixels that an outline may cross are cut into cells.
    inside = depth(plane)  # NaN, so not covered, where no line of sight meets the plane
    area: NDArray = np.kron(inside > 0, np.ones((_CELLS, _CELLS), dtype=np.float32))
    row, column = np.nonzero(np.abs(inside) < np.abs(jacobian).sum(axis=(2, 3)))
    step = (np.arange(_CELLS) + 0.5) / _CELLS - 0.5
    for i, dy in enumerate(step if len(row) else ()):
        for j, dx in enumerate(step):
            cells = np.column_stack([columns[column] + dx, rows[row] + dy])
            cell = covered(microscope.back_project(cells), jacobian[row, column] / _CELLS)
            area[_CELLS * row + i, _CELLS * column + j] = cell

    if imaging.blur > 0:
        area = cv2.GaussianBlur(area, (0, 0), _CELLS * imaging.blur)
    area = cv2.resize(area, shape[::-1], interpolation=cv2.INTER_AREA)[
        margin:-margin, margin:-margin
    ]

    x = np.linspace(-0.5, 0.5, width)
    y = np.linspace(-0.5, 0.5, height)[:, None]
    light = (1 + imaging.gradient[0] * x + imaging.gradient[1] * y) * (
        1 - imaging.vignetting * 2 * (x**2 + y**2)
    )
    image = light * (imaging.bright - (imaging.bright - imaging.dark) * area)
    if rng is not None:
        image = image + source.normal(0, imaging.noise, image.shape)
    return np.clip(image, 0, 255).astype(np.float32)
