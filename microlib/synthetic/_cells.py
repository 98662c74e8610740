"""Cultured cells as a phase-contrast microscope shows them: stand-ins for lost photographs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, one_of, positive, whole

__all__ = ["CellImage", "cell_image"]

# Radius (µm), irregularity of the outline, and how many harmonics it has.
_KINDS = {"293T": (9.0, 0.16, 6), "Jurkat": (5.5, 0.02, 3)}
_BACKGROUND = 128.0
_HALO = 2.2  # µm over which the bright halo and the body's edge fade


@dataclass(frozen=True)
class CellImage:
    """
    A rendered sample of cells.

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
    rng: np.random.Generator,
    count: int = 14,
    pixel_size: float = 0.25,
    shape: tuple[int, int] = (360, 480),
) -> CellImage:
    """
    Render a sample of cells that do not overlap.

    Parameters
    ----------
    kind : {"293T", "Jurkat"}
        Human kidney cells that lie spread on the glass, or round cancer cells in suspension.
    rng : numpy.random.Generator
        Source of places, shapes and noise.
    count : int
        Number of cells; fewer where the image has no room for more.
    pixel_size : float
        Pixel in the object, in µm.
    shape : tuple of int
        Rows and columns.

    Returns
    -------
    CellImage
        The image and the outlines in it.

    Raises
    ------
    ValueError
        If `kind` is unknown or a number is out of range.

    Examples
    --------
    >>> sample = cell_image("Jurkat", rng=np.random.default_rng(0), count=5)
    >>> sample.image.shape, len(sample.outlines)
    ((360, 480), 5)
    """
    radius, irregularity, harmonics = _KINDS[one_of("kind", kind, tuple(_KINDS))]
    wanted = whole("count", count, least=1)
    positive("pixel_size", pixel_size)
    rows, columns = (whole("shape", n, least=64) for n in shape)
    radius /= pixel_size
    outlines: list[Array] = []
    centres: list[Array] = []
    for _ in range(60 * wanted):
        centre = rng.uniform([radius, radius], [columns - radius, rows - radius])
        if any(np.hypot(*(centre - other)) < 2.3 * radius for other in centres):
            continue
        centres.append(centre)
        outlines.append(centre + _shape(radius, irregularity, harmonics, rng))
        if len(outlines) == wanted:
            break

    scene = np.full((rows, columns), _BACKGROUND, dtype=np.float32)
    speckle = cv2.GaussianBlur(rng.standard_normal(scene.shape, dtype=np.float32), (0, 0), 1.5)
    grain = np.asarray(speckle * np.float32(14.0 / np.std(speckle)), dtype=np.float32)
    for place, outline in zip(centres, outlines, strict=True):
        _draw(scene, outline, place, 0.4 * radius, _HALO / pixel_size, grain)
    noisy = np.asarray(cv2.GaussianBlur(scene, (0, 0), 0.9)) + rng.normal(0.0, 2.0, scene.shape)
    image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return CellImage(image, tuple(outlines), pixel_size)


def _shape(radius: float, irregularity: float, harmonics: int, rng: np.random.Generator) -> Array:
    """A closed, star-shaped outline around the origin."""
    angle = np.linspace(0.0, 2 * np.pi, 180, endpoint=False)
    length = np.full(angle.size, radius)
    for k in range(2, harmonics + 1):
        swing = radius * irregularity * rng.normal() / np.sqrt(k)
        length += swing * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    length = np.clip(length, 0.5 * radius, 1.1 * radius)
    return length[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _draw(
    scene: NDArray[np.float32],
    outline: Array,
    centre: Array,
    nucleus: float,
    halo: float,
    grain: NDArray[np.float32],
) -> None:
    """Add one cell: a bright halo outside, a dark grainy body, a darker nucleus."""
    mask = np.zeros(scene.shape, dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(outline * 16).astype(np.int32)], 1, shift=4)
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5)
    body = mask * (1 - np.exp(-inside / halo))
    scene += 70.0 * np.exp(-((outside / halo) ** 2)) * (1 - mask) + 70.0 * (mask - body)
    scene += body * (grain - 38.0)
    y, x = np.indices(scene.shape)
    disc = np.hypot(x - centre[0], y - centre[1])
    scene -= 18.0 * mask / (1 + np.exp((disc - nucleus) / (0.15 * nucleus)))
