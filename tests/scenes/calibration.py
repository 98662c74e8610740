"""Scenes of the tests: points that a known microscope sees, and drawn photographs of patterns.

The photographs are drawn by exact areas of polygons and seen through a homography and Brown's
distortion. Neither the library's renderer nor its models are used.
"""

from __future__ import annotations

import cv2
import numpy as np

from microlib.calibration import Detection
from microlib.microscope import Microscope

#: Sensor pixels and an image that are not square; a tilted and turned pattern, in focus.
SENSOR = {"pixel_pitch": (9.9, 8.3), "image_size": (656, 491)}
SCOPE = Microscope(2e5, 126e3, 79380, -8e-10, 0.3, 0.2, -0.15, -900, -700, **SENSOR)
#: Positions of a stage, µm.
MOVES = np.array([[0.0, 0], [40, 0], [0, 55], [-40, 0], [0, -40], [35, 40], [-40, 30]])
#: Rows and columns of a photograph, and samples of each pixel along y.
SHAPE, FINE = (240, 320), 8
#: Places of a grid of 7 × 5 marks, in pitches.
SQUARE = np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), axis=-1).reshape(-1, 2)


def grid_in_view(scope, pitch=280.0):
    """Points of a lattice that a microscope sees, µm."""
    world = pitch * (np.argwhere(np.ones((81, 81))) - 40.0)
    seen = scope.project(world)
    return world[((seen > 9) & (seen < np.array(scope.image_size) - 10)).all(axis=1)]


def imperfect_projection(scope, world, *, bend=0.0, aside=(0.0, 0.0), k2=0.0):
    """Image of a pattern on a bent plane, a principal point aside, and a second distortion term."""
    bent = np.column_stack([world, bend * (world[:, 0] / 2000) ** 2])
    points = scope.project(bent) - scope.principal_point
    r2 = ((points * scope.pitch) ** 2).sum(axis=1, keepdims=True)
    return points * (1 + k2 * r2**2) + scope.principal_point + aside


def covering(polygons: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Part of each pixel that polygons cover: exact along rows an eighth of a pixel apart."""
    height, width = shape
    first = polygons.reshape(-1, 2)
    second = np.roll(polygons, -1, axis=1).reshape(-1, 2)
    rows = ((np.arange(height * FINE) + 0.5) / FINE - 0.5)[:, None]
    # +1 where an edge passes a row downwards, −1 where it passes it upwards.
    down = (first[:, 1] <= rows).astype(int) - (second[:, 1] <= rows)
    row, edge = np.nonzero(down)
    (x, y), (along, drop) = first[edge].T, (second - first)[edge].T
    place = np.clip(x + (rows[row, 0] - y) * along / drop + 0.5, 0, width)
    column, part = np.divmod(place, 1)
    begun = np.zeros((height * FINE, width + 2))
    for aside, share in ((0, 1 - part), (1, part)):
        np.add.at(begun, (row, column.astype(int) + aside), share * down[row, edge])
    # The sum is negative for polygons that turn the other way.
    return abs(begun.cumsum(axis=1)[:, :width]).reshape(height, FINE, width).mean(axis=1)


def photograph(ideal: np.ndarray, blur: float, noise: float, seed: int = 0) -> np.ndarray:
    """Grey levels of eight bits with the blur and the noise of a camera."""
    image = cv2.GaussianBlur(ideal, (0, 0), blur)
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def outline(kind: str, size: float) -> np.ndarray:
    """Polygon of 64 points: a circle of radius `size`, or a square of side `size`, corner first."""
    if kind == "circle":
        turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        return size * np.column_stack([np.cos(turn), np.sin(turn)])
    part = np.arange(16) / 16 - 0.5
    sides = [(part, -0.5), (0.5, part), (-part, 0.5), (-0.5, -part)]
    return size * np.concatenate([np.column_stack(np.broadcast_arrays(*side)) for side in sides])


def camera(points: np.ndarray, *, pitch=34.0, turn=0.1, k1=0.02, shape=SHAPE) -> np.ndarray:
    """Points of the pattern, in pitches from its middle, as they are seen, px."""
    (height, width), cos, sin = shape, np.cos(turn), np.sin(turn)
    homography = np.array(
        [[pitch * cos, -pitch * sin, 0], [pitch * sin, pitch * cos, 0], [4e-3, -3e-3, 1]]
    )
    seen = cv2.perspectiveTransform(points.reshape(1, -1, 2), homography)[0] / (width / 2)
    seen = seen * (1 + k1 * (seen**2).sum(axis=1, keepdims=True))
    return (seen * width / 2 + [width / 2 + 3.3, height / 2 - 2.1]).reshape(points.shape)


def board(
    places: np.ndarray,
    kind: str = "circle",
    size: float = 0.25,
    *,
    blur: float = 1.0,
    noise: float = 2.0,
    ink: float = 50.0,
    paper: float = 200.0,
    behind: np.ndarray | None = None,
    shape: tuple[int, int] = SHAPE,
    **lens: float,
) -> tuple[np.ndarray, np.ndarray]:
    """A photograph and the true points: centers of circles, corners of squares, px."""
    middle = (places.max(axis=0) + places.min(axis=0)) / 2
    marks = (places - middle)[:, None]
    seen = camera(marks + outline(kind, size), shape=shape, **lens)
    ground = np.full(shape, paper)
    if behind is not None:
        ground = cv2.resize(behind, shape[::-1]).astype(float)
        sheet = camera(outline("square", 1.0) * (np.ptp(places, axis=0) + 1.2), shape=shape, **lens)
        cv2.fillPoly(ground, [np.round(sheet).astype(np.int32)], paper)
    truth = camera(marks, shape=shape, **lens) if kind == "circle" else seen[:, ::16]
    image = photograph(ground + (ink - paper) * covering(seen, shape), blur, noise)
    return image, truth.reshape(-1, 2)


def chessboard(columns=8, rows=6, *, sharpening=0.0, shape=SHAPE, **change):
    """A board of so many fields, its inner corners in fields, and as they are seen, px."""
    lens = {"pitch": 30.0, "turn": 0.15, "k1": 0.02}
    lens |= {name: change.pop(name) for name in lens if name in change}
    fields = np.argwhere(np.ones((columns, rows))).astype(float)
    dark = fields[fields.sum(axis=1) % 2 == 0]
    image, _ = board(dark, "square", 1.0, shape=shape, **lens, **change)
    image = image + sharpening * (image.astype(float) - cv2.GaussianBlur(image, (0, 0), 1.0))
    corners = np.argwhere(np.ones((columns - 1, rows - 1))) + 0.5
    seen = camera(corners - [(columns - 1) / 2, (rows - 1) / 2], shape=shape, **lens)
    return np.clip(image, 0, 255), corners, seen


def ruled(
    places: np.ndarray,
    lengths: np.ndarray | float = 30.0,
    width: float = 3.0,
    *,
    angle: float = 0.2,
    k1: float = 0.0,
    tilt: float = 0.0,
    blur: float = 1.2,
    noise: float = 2.0,
    ink: float = 60.0,
    paper: float = 190.0,
    seed: int = 0,
    numerals: bool = False,
    shape: tuple[int, int] = SHAPE,
) -> np.ndarray:
    """Lines across a direction, at places from the image's middle and from a base line on, px.

    Every tenth line may have a numeral. The distortion and the tilt are relative at the side of
    the image.
    """
    half = np.array(shape[::-1]) / 2
    middle = half + np.random.default_rng(seed).uniform(-3, 3, 2)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def seen(points):
        points = points / (1 + tilt * points[..., :1] / half[0]) / half[0]
        return half[0] * points * (1 + k1 * (points**2).sum(axis=-1, keepdims=True)) @ turn + middle

    size = np.column_stack(np.broadcast_arrays(width, lengths, places))[:, :2]
    corners = np.column_stack([places, size[:, 1] / 2])[:, None]
    corners = seen(corners + outline("square", 1.0) * size[:, None])
    image = paper + (ink - paper) * np.minimum(covering(corners, shape), 1)
    written = np.zeros(shape, np.uint8)
    for ten in range(0, len(places), 10) if numerals else ():
        place = seen(np.array([places[ten], size[:, 1].max() + 18]))
        font = cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 1
        cv2.putText(written, str(ten // 10), place.astype(int).tolist(), *font)
    image[written > 0] = ink
    return photograph(image, blur, noise, seed)


def scale(
    seed: int = 0, *, spacing=12.3, lines=17, width=0.25, length=30.0, numerals=True, **change
) -> np.ndarray:
    """A ruler whose every tenth line is longer and has a numeral."""
    number = np.arange(lines)
    places = (number - (lines - 1) / 2) * spacing
    lengths = length * (1 + (number % 10 == 0))
    return ruled(places, lengths, width * spacing, numerals=numerals, seed=seed, **change)


#: A photograph of each pattern, one of them bright on dark.
PHOTOGRAPHS = {
    "circles": board(SQUARE)[0],
    "squares": board(SQUARE, "square", 0.5, ink=200.0, paper=50.0)[0],
    "chessboard": chessboard(blur=0.7)[0],
    "scale": scale(spacing=14.0, angle=0.0),
}


def detection_of(positions, points, *, groups=None, image_size=(640, 480)) -> Detection:
    """The detection of marks at positions, in pitches, whose points are known exactly."""
    groups = np.arange(len(points)) if groups is None else groups
    first = np.array([positions[groups == group].min(axis=0) for group in groups])
    ends = positions > first + 0.1  # of the sides of a square, which `detect_squares` counts, too
    grid = (1 + ends.any()) * np.round(first - first.min(axis=0)).astype(int) + ends
    return Detection(
        points=points, grid=grid, uncertainty=np.ones(len(points)), group=groups,
        positions=positions, side=np.nan, normalized_rms=1.0, image_size=image_size,
    )  # fmt: skip


def seen_by_opencv(camera: dict, worlds: list[np.ndarray]) -> list[np.ndarray]:
    """Image points of each view of a plane, by OpenCV from what `Calibration.to_json` describes."""
    lens = [np.array(camera[name]) for name in ("camera_matrix", "distortion_coefficients")]
    poses = zip(camera["rotation_vectors"], camera["translation_vectors_um"], strict=True)
    flat = [np.column_stack([world, 0 * world[:, 0]]) for world in worlds]
    return [
        cv2.projectPoints(world, *map(np.array, pose), *lens)[0][:, 0]
        for world, pose in zip(flat, poses, strict=True)
    ]
