"""Scenes for tests and benchmarks: planes, and frames of textures that move by known amounts."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from microlib.synthetic import mixed_texture


def tilted_plane(shape: tuple[int, int], rise_x: float, rise_y: float) -> NDArray[np.float64]:
    """Return a plane that rises from pixel to pixel along x and y, zero in the middle."""
    y, x = np.indices(shape)
    return rise_x * (x - (shape[1] - 1) / 2) + rise_y * (y - (shape[0] - 1) / 2)


def straight_step(shape: tuple[int, int], height: float) -> NDArray[np.float64]:
    """Return a plane with one straight step in the middle; the right part is higher."""
    return np.tile(np.where(np.arange(shape[1]) < shape[1] / 2, 0.0, height), (shape[0], 1))


def camera_frame(
    image: NDArray, rng: np.random.Generator, noise: float = 2.0, gain: float = 1.0
) -> NDArray[np.uint8]:
    """Return grey levels with the noise of a camera, rounded to eight bits."""
    noisy = gain * image + noise * rng.standard_normal(image.shape, np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def moving_square(
    corners: NDArray, rng: np.random.Generator, size: int = 50
) -> list[NDArray[np.uint8]]:
    """Return frames of a textured square over another texture; `corners` (x, y) are its first px.

    The square is moved by splines of the fifth order, and covers parts of pixels at its edges.
    """
    width, height = (np.ceil(np.max(corners, axis=0)) + 2 * size).astype(int)
    ground = mixed_texture((height, width), rng, std=45.0, scales=1.0)
    square = np.pad(mixed_texture((size, size), rng, std=45.0, scales=1.0), 8, mode="wrap")
    cover = np.pad(np.ones((size, size)), 8)
    frames = []
    for corner in np.asarray(corners):
        column, row = np.floor(corner).astype(int)
        part = (corner - [column, row])[::-1]
        moved, share = (ndimage.shift(a, part, order=n) for a, n in ((square, 5), (cover, 1)))
        image = ground.copy()
        below = image[row : row + size + 1, column : column + size + 1]
        inside = np.s_[8 : 9 + size, 8 : 9 + size]
        below += share[inside] * (moved[inside] - below)
        frames.append(camera_frame(image, rng))
    return frames


def translated(image: NDArray, by: NDArray) -> NDArray[np.float64]:
    """Return an image that is moved by (x, y) px with splines of the fifth order."""
    return ndimage.shift(image, (by[1], by[0]), order=5, mode="mirror")


class FilmOnGround(NamedTuple):
    """Frames of an object, its box (x, y, width, height), and where it moves from there, (x, y)."""

    frames: list[NDArray[np.uint8]]
    box: tuple[int, int, int, int]
    motion: NDArray[np.float64]


def film_on_ground(
    kind: str,
    share: float,
    seed: int,
    drift: tuple[float, float] = (0.0, 0.0),
    ground: NDArray | None = None,
) -> FilmOnGround:
    """Return a film of an object whose box of 60 px contains a share of ground.

    From frame to frame the object moves by 2 to 4 px, and the ground by `drift` px. Of the kinds of
    objects, only the gripper has ground in its middle and in the holes of its jaws.
    """
    side, rng = 60, np.random.default_rng(seed)
    y, x = np.mgrid[:180, :220] - np.array([90, 110])[:, None, None]
    texture = mixed_texture((180, 220), rng, scales=(2.0, 6.0), std=20.0)
    part = mixed_texture((180, 220), rng, scales=(1.5, 4.0), std=25.0) + 30
    ground = texture if ground is None else ground
    radius, distance = side * np.sqrt((1 - share) / np.pi), np.hypot(x, y)
    jaw = side * (1 - share) / 2
    jaws = np.minimum(side / 2 - np.maximum(abs(x), abs(y)), abs(x) - side / 2 + jaw)
    depth = {
        "bead": radius - distance,
        "cell": radius * (1 + 0.1 * np.cos(3 * np.arctan2(y, x))) - distance,
        "part": side * np.sqrt(1 - share) / 2 - np.maximum(abs(x), abs(y)),
        "gripper": np.minimum(jaws, np.hypot(abs(x) - (side - jaw) / 2, y) - jaw / 4),
    }[kind]
    alpha = 1 / (1 + np.exp(-depth))
    way = rng.uniform(2, 4) * np.array([[np.cos(seed), np.sin(seed)]]) * np.arange(9)[:, None]
    film = []
    for k, by in enumerate(way):
        cover = translated(alpha, by)
        image = (1 - cover) * translated(ground, np.multiply(drift, k))
        film.append(camera_frame(cover * translated(part, by) + image, rng))
    return FilmOnGround(film, (110 - side // 2, 90 - side // 2, side, side), way)


class WarpedPair(NamedTuple):
    """Two frames, the box (x, y, width, height) of a template, and its corners in the second."""

    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    box: tuple[int, int, int, int]
    corners: NDArray[np.float64]


def warped_pair(
    seed: int, distance: float, *, warp: str = "shift", size: int = 50, gain: float = 1.05
) -> WarpedPair:
    """Warp a texture so that the corners of the template move by `distance` px (RMS).

    `warp` is a shift in a random direction, or independent displacements of the corners through the
    nearest affine map or the homography.
    """
    rng, side = np.random.default_rng(seed), 3 * size
    texture = mixed_texture((side, side), rng, std=45.0, scales=1.0)
    unit = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    source = unit * (size - 1) + size
    moved = np.tile(rng.standard_normal(2), (4, 1)) if warp == "shift" else rng.normal(size=(4, 2))
    if warp == "affine":
        design = np.column_stack([unit, np.ones(4)])
        moved = design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    corners = source + moved * distance / np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    back = cv2.getPerspectiveTransform(corners.astype(np.float32), source.astype(np.float32))
    rows, columns = np.mgrid[:side, :side]
    x, y, w = back @ np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
    warped = ndimage.map_coordinates(texture, [y / w, x / w], order=5, mode="grid-wrap")
    second = camera_frame(warped.reshape(side, side), rng, gain=gain)
    return WarpedPair(camera_frame(texture, rng), second, (size, size, size, size), corners)
