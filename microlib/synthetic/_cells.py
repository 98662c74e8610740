"""Cultured cells as a phase-contrast microscope shows them: stand-ins for lost photographs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Kept, generator, image_shape, one_of, scalar, whole

# What such cells look like is a choice of the scene; no method depends on it.
#: Radius (µm), irregularity of the outline, and how many harmonics it has.
_KINDS = {"293T": (9.0, 0.16, 6), "Jurkat": (5.5, 0.02, 3)}
#: Grey levels of 255: the ground, how far the halo rises above it and the body and the nucleus fall
#: below, the grain of the body, and the noise.
_BACKGROUND, _HALO, _BODY, _NUCLEUS, _GRAIN, _NOISE = 128.0, 70.0, 38.0, 18.0, 14.0, 2.0
#: µm over which the bright halo and the body's edge fade.
_HALO_WIDTH = 2.2
#: Radius of the nucleus in radii of the cell, and over which share of that its edge fades.
_NUCLEUS_SIZE, _NUCLEUS_FADE = 0.4, 0.15
#: Least and largest distance of an outline from its center, in radii of the cell.
_LEAST_REACH, _MOST_REACH = 0.5, 1.1
#: Least distance of two centers in radii: two outlines of the largest reach, and a gap of 0.1.
_APART = 2.3
#: Places tried for each cell before the image counts as full.
_TRIES = 60
#: Standard deviations of the grain's and the optics' blur, px.
_GRAIN_BLUR, _BLUR = 1.5, 0.9
#: Corners of an outline: a side of 0.3 µm, about a pixel.
_CORNERS = 180
#: Least side of an image, px: a few cells.
_SMALLEST = 64
#: A cell of a lesser radius, px, is a speck.
_LEAST_RADIUS = 2.0
#: Cells that are tried at most; each is held against all others.
_MOST_CELLS = 1000
#: Bits of a fraction of a pixel to which an outline is drawn.
_SHIFT = 4


@dataclass(frozen=True, eq=False, repr=False)
class CellImage(Kept):
    """A rendered sample of cells.

    Attributes
    ----------
    image : ndarray of uint8, shape (rows, columns)
        Grey levels.
    outlines : tuple of ndarray, each of shape (n, 2)
        Outline of each cell, image points (x, y) in px.
    pixel_size : float
        Pixel in the object, in µm.
    """

    image: NDArray[np.uint8]
    outlines: tuple[Array, ...]
    pixel_size: float


def cell_image(
    kind: str,
    *,
    rng: np.random.Generator | int,
    count: int = 14,
    pixel_size: float = 0.25,
    shape: tuple[int, int] = (360, 480),
) -> CellImage:
    """Render a sample of cells that do not overlap.

    Parameters
    ----------
    kind : {"293T", "Jurkat"}
        Human kidney cells that lie spread on the glass, or round cancer cells in suspension.
    rng : numpy.random.Generator or int
        Source of places, shapes and noise, or its seed.
    count : int
        Number of cells; fewer where the image has no room for more.
    pixel_size : float
        Pixel in the object, in µm.
    shape : tuple of int
        Rows and columns.

    Returns
    -------
    CellImage
        The `image`, the `outlines` in it and its `pixel_size`.

    Raises
    ------
    ValueError
        If `kind` is unknown or a number is out of range.

    Examples
    --------
    >>> from microlib.synthetic import cell_image
    >>> sample = cell_image("Jurkat", rng=0, count=5)
    >>> sample.image.shape, len(sample.outlines)
    ((360, 480), 5)
    """
    radius, irregularity, harmonics = _KINDS[one_of("kind", kind, tuple(_KINDS))]
    wanted = whole("count", count, least=1, most=_MOST_CELLS)
    rows, columns = image_shape("shape", shape, least=_SMALLEST)
    pixel_size = scalar("pixel_size", pixel_size, above=0)
    most = min(rows, columns) / 2
    if not _LEAST_RADIUS <= radius / pixel_size <= most:
        raise ValueError(
            f"pixel_size must show a cell's radius of {radius:g} µm by {_LEAST_RADIUS:g} to "
            f"{most:g} px, got {pixel_size:g} µm"
        )
    radius /= pixel_size
    rng = generator("rng", rng)
    outlines: list[Array] = []
    centers: list[Array] = []
    for _ in range(_TRIES * wanted):
        center = rng.uniform([radius, radius], [columns - radius, rows - radius])
        if any(np.hypot(*(center - other)) < _APART * radius for other in centers):
            continue
        centers.append(center)
        outlines.append(center + _shape(radius, irregularity, harmonics, rng))
        if len(outlines) == wanted:
            break

    scene = np.full((rows, columns), _BACKGROUND, dtype=np.float32)
    speckle = cv2.GaussianBlur(
        rng.standard_normal(scene.shape, dtype=np.float32), (0, 0), _GRAIN_BLUR
    )
    grain = np.asarray(speckle * np.float32(_GRAIN / np.std(speckle)), dtype=np.float32)
    for place, outline in zip(centers, outlines, strict=True):
        _draw(scene, outline, place, _NUCLEUS_SIZE * radius, _HALO_WIDTH / pixel_size, grain)
    blurred = np.asarray(cv2.GaussianBlur(scene, (0, 0), _BLUR))
    noisy = blurred + rng.normal(0.0, _NOISE, scene.shape)
    image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return CellImage(image, tuple(outlines), pixel_size)


def _shape(radius: float, irregularity: float, harmonics: int, rng: np.random.Generator) -> Array:
    """A closed, star-shaped outline around the origin."""
    angle = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    length = np.full(angle.size, radius)
    for k in range(2, harmonics + 1):
        swing = radius * irregularity * rng.normal() / np.sqrt(k)
        length += swing * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    length = np.clip(length, _LEAST_REACH * radius, _MOST_REACH * radius)
    return length[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _draw(
    scene: NDArray[np.float32],
    outline: Array,
    center: Array,
    nucleus: float,
    halo: float,
    grain: NDArray[np.float32],
) -> None:
    """Add one cell: a bright halo outside, a dark grainy body, a darker nucleus."""
    mask = np.zeros(scene.shape, dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(outline * 2**_SHIFT).astype(np.int32)], 1, shift=_SHIFT)
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5)
    body = mask * (1 - np.exp(-inside / halo))
    scene += _HALO * np.exp(-((outside / halo) ** 2)) * (1 - mask) + _HALO * (mask - body)
    scene += body * (grain - _BODY)
    y, x = np.indices(scene.shape)
    disc = np.hypot(x - center[0], y - center[1])
    with np.errstate(over="ignore"):  # far outside, where there is nothing of the nucleus
        scene -= _NUCLEUS * mask / (1 + np.exp((disc - nucleus) / (_NUCLEUS_FADE * nucleus)))
