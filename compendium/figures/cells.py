"""Cultured cells as a phase-contrast microscope shows them, in place of lost photographs."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

#: Side of a pixel, µm.
PIXEL_SIZE = 0.25
#: Radius (µm), irregularity of the outline, and how many harmonics it has, for human kidney cells
#: that lie spread on glass and round cancer cells in suspension.
_KINDS = {"293T": (9.0, 0.16, 6), "Jurkat": (5.5, 0.02, 3)}
#: Grey levels: ground; how far the halo rises above it, and body and nucleus fall below; grain.
_GROUND, _HALO, _BODY, _NUCLEUS, _GRAIN, _NOISE = 128, 70, 38, 18, 14, 2


def render_cells(
    kind: str, rng: np.random.Generator, shape: tuple[int, int] = (360, 480), count: int = 14
) -> tuple[NDArray[np.uint8], list[NDArray[np.float64]]]:
    """Return an image of cells that do not overlap, and their outlines.

    Parameters
    ----------
    kind : str
        ``293T`` or ``Jurkat``.
    rng : numpy.random.Generator
        Source of places, shapes and noise.
    shape : tuple of int
        Rows and columns.
    count : int
        Largest number of cells.

    Returns
    -------
    image : ndarray of uint8, shape (rows, columns)
        Grey levels.
    outlines : list of ndarray, shape (n, 2)
        Outline of each cell, (x, y) in px.

    Examples
    --------
    >>> import numpy as np
    >>> image, outlines = render_cells("Jurkat", np.random.default_rng(0), count=5)
    >>> image.shape, len(outlines)
    ((360, 480), 5)
    """
    radius, irregularity, harmonics = _KINDS[kind]
    radius /= PIXEL_SIZE
    centers: list[NDArray[np.float64]] = []
    outlines: list[NDArray[np.float64]] = []
    for center in rng.uniform(radius, np.array(shape[::-1]) - radius, (60 * count, 2)):
        # An outline reaches to 1.1 radii at most.
        if len(centers) < count and all(np.hypot(*(center - c)) > 2.3 * radius for c in centers):
            centers.append(center)
            outlines.append(center + _outline(radius, irregularity, harmonics, rng))
    scene = np.full(shape, _GROUND, np.float32)
    speckle = cv2.GaussianBlur(rng.standard_normal(shape, np.float32), (0, 0), 1.5)
    y, x = np.indices(shape)
    fade = 2.2 / PIXEL_SIZE  # of the halo and the edge of the body, px
    for center, outline in zip(centers, outlines, strict=True):
        mask = np.zeros(shape, np.uint8)
        cv2.fillPoly(mask, [np.rint(outline * 16).astype(np.int32)], 1, shift=4)
        inside = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_5)
        outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, cv2.DIST_MASK_5)
        body = mask * (1 - np.exp(-inside / fade))
        scene += _HALO * (np.exp(-((outside / fade) ** 2)) * (1 - mask) + mask - body)
        scene += body * (_GRAIN / speckle.std() * speckle - _BODY)
        core = np.hypot(x - center[0], y - center[1]) / radius
        scene -= _NUCLEUS * mask / (1 + np.exp((core - 0.4) / 0.06))
    noisy = cv2.GaussianBlur(scene, (0, 0), 0.9) + rng.normal(0, _NOISE, shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), outlines


def _outline(
    radius: float, irregularity: float, harmonics: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return a closed, star-shaped outline around the origin, px."""
    angle = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    length = np.full(angle.size, radius)
    for k in range(2, harmonics + 1):
        swing = radius * irregularity * rng.normal() / np.sqrt(k)
        length += swing * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    length = np.clip(length, 0.5 * radius, 1.1 * radius)
    return length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
