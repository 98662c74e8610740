"""Cultured cells as a phase-contrast microscope shows them: stand-ins for lost photographs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Result, generator, image_shape, one_of, scalar, whole
from microlib.synthetic._textures import eight_bits

#: Radius (µm), irregularity of the outline, and how many harmonics it has.
_KINDS = {"293T": (9.0, 0.16, 6), "Jurkat": (5.5, 0.02, 3)}


@dataclass(frozen=True)
class _Look:
    """What such cells look like, a choice of the scene: no method depends on it.

    Attributes
    ----------
    ground, halo, body, nucleus, grain, noise : float
        Grey levels of 255: the ground, how far the halo rises above it and the body and the nucleus
        fall below, the grain of the body, and the noise.
    fade : float
        µm over which the bright halo and the body's edge fade.
    reach, gap : float
        Largest radius of an outline, and half of the least gap between two, in radii of the cell.
    core, core_fade : float
        Radius of the nucleus in radii of the cell; over which part of that its edge fades.
    grain_blur, blur : float
        Standard deviations of the grain's and the optics' blur, px.
    """

    ground: float = 128.0
    halo: float = 70.0
    body: float = 38.0
    nucleus: float = 18.0
    grain: float = 14.0
    noise: float = 2.0
    fade: float = 2.2
    reach: float = 1.1
    gap: float = 0.05
    core: float = 0.4
    core_fade: float = 0.15
    grain_blur: float = 1.5
    blur: float = 0.9


_LOOK = _Look()


@dataclass(frozen=True, eq=False, repr=False)
class CellImage(Result):
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
    wanted = whole("count", count, least=1, most=1000)  # each is held against all others
    rows, columns = image_shape("shape", shape, least=64)
    pixel_size = scalar("pixel_size", pixel_size, above=0)
    most = min(rows, columns) / 2
    if not 2 <= radius / pixel_size <= most:  # a lesser one is a speck
        raise ValueError(
            f"pixel_size must show a cell's radius of {radius:g} µm by 2 to {most:g} px, "
            f"got {pixel_size:g} µm"
        )
    radius /= pixel_size
    rng = generator("rng", rng)
    outlines: list[Array] = []
    centers: list[Array] = []
    for _ in range(60 * wanted):  # then the image counts as full
        center = rng.uniform([radius, radius], [columns - radius, rows - radius])
        # Two outlines of the largest reach do not touch.
        apart = 2 * (_LOOK.reach + _LOOK.gap) * radius
        if any(np.hypot(*(center - other)) < apart for other in centers):
            continue
        centers.append(center)
        outlines.append(center + _shape(radius, irregularity, harmonics, rng))
        if len(outlines) == wanted:
            break

    scene = np.full((rows, columns), _LOOK.ground, dtype=np.float32)
    white = rng.standard_normal(scene.shape, dtype=np.float32)
    speckle = cv2.GaussianBlur(white, (0, 0), _LOOK.grain_blur)
    grain = np.asarray(speckle * np.float32(_LOOK.grain / np.std(speckle)), dtype=np.float32)
    for place, outline in zip(centers, outlines, strict=True):
        _draw(scene, outline, place, _LOOK.core * radius, _LOOK.fade / pixel_size, grain)
    blurred = np.asarray(cv2.GaussianBlur(scene, (0, 0), _LOOK.blur))
    image = eight_bits(blurred + rng.normal(0.0, _LOOK.noise, scene.shape))
    return CellImage(image, tuple(outlines), pixel_size)


def _shape(radius: float, irregularity: float, harmonics: int, rng: np.random.Generator) -> Array:
    """A closed, star-shaped outline around the origin."""
    angle = np.linspace(0.0, 2 * np.pi, 180, endpoint=False)  # a side is about a pixel
    length = np.full(angle.size, radius)
    for k in range(2, harmonics + 1):
        swing = radius * irregularity * rng.normal() / np.sqrt(k)
        length += swing * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    length = np.clip(length, 0.5 * radius, _LOOK.reach * radius)
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
    cv2.fillPoly(mask, [np.rint(outline * 2**4).astype(np.int32)], 1, shift=4)
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_5)
    outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, cv2.DIST_MASK_5)
    body = mask * (1 - np.exp(-inside / halo))
    scene += _LOOK.halo * (np.exp(-((outside / halo) ** 2)) * (1 - mask) + mask - body)
    scene += body * (grain - _LOOK.body)
    y, x = np.indices(scene.shape)
    disc = np.hypot(x - center[0], y - center[1])
    with np.errstate(over="ignore"):  # far outside, where there is nothing of the nucleus
        scene -= _LOOK.nucleus * mask / (1 + np.exp((disc - nucleus) / (_LOOK.core_fade * nucleus)))
