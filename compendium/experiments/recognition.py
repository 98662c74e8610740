"""Beyond the thesis: parts recognized by the surface types of their heights from focus.

The renderer shares no formula with `depth_from_focus`: the blur is a disc, and a part hides the
ground behind it.
"""

from __future__ import annotations

import html
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial.distance import cdist
from scipy.stats import binomtest
from skimage.measure import label as connected

from compendium.experiments.rendering import blended, disc, expose
from microlib._common import MICROMETERS
from microlib.curvature import HK_NAMES, hk_labels, surface_curvature
from microlib.focus import correct_spikes, depth_from_focus
from microlib.synthetic import mixed_texture

SIDE, PIXEL = 96, 4.0  # of a frame, px, and of a pixel, µm
RADIUS = 26 * PIXEL  # of a part at scale 1, µm: the unit of the lengths in `PARTS`
POSITIONS = np.arange(-60.0, 301.0, 24.0)  # of the frames, µm
#: Radius of the blur's disc: in focus, px, and what each µm out of focus adds; and the radii in px
#: between which it is interpolated. Beyond the last the texture is gone.
SHARPEST, BLUR_RATE = 0.7, 0.05
RADII = np.array([SHARPEST, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0])
WINDOW, SMALLEST = 11, 20  # of the curvature, px, and the smallest region that is kept, px
TYPES = tuple(kind for kind in HK_NAMES if kind != 4)  # no surface has the fourth
PAIRS = tuple(combinations(TYPES, 2))
#: Features in each group of a description.
GROUPS = {"share": len(TYPES), "regions": len(TYPES), "border": len(PAIRS), "curvature": len(TYPES)}


Part = Callable[[NDArray, NDArray], NDArray]
#: Height above the ground at (u, v) on it, all in units of the part's radius.
PARTS: dict[str, Part] = {
    "solder ball": lambda u, v: (np.hypot(u, v) < 1) * (1 + _root(1 - u**2 - v**2)),
    "parabolic ridge": lambda u, v: np.maximum(0.9 - v**2 / 0.9, 0),
    "gripper jaw": lambda u, v: 0.8 * ((u < 0.9) & (abs(v) < 0.6 - 0.25 * np.maximum(u, -0.4))),
    "cone": lambda u, v: np.maximum(1.2 - 1.2 * np.hypot(u, v), 0),
    "saddle": lambda u, v: (np.maximum(abs(u), abs(v)) < 1) * (0.9 + 0.5 * (u**2 - v**2)),
    "step": lambda u, v: 0.9 * (u > 0),
    "cylinder end": lambda u, v: (u < 0.5) * _root(0.81 - v**2),
    "dimpled plate": lambda u, v: (
        (np.maximum(abs(u), abs(v)) < 1.25) * np.minimum(0.4 + 0.9 * (u**2 + v**2), 0.9)
    ),
}


def _root(square: NDArray) -> NDArray:
    return np.sqrt(np.maximum(square, 0))


@dataclass(frozen=True)
class Pose:
    """How a part lies: turned about the viewing axis, then tilted towards a direction (radians)."""

    turn: float = 0.0
    tilt: float = 0.0
    towards: float = 0.0
    scale: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)  # (x, y), px


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a pose of any turn, a tilt up to 15°, a scale of 0.8 to 1.2, a shift up to 3 px."""
    turn, towards = rng.uniform(0, 2 * np.pi, 2)
    tilt = np.deg2rad(15) * np.sqrt(rng.uniform())
    return Pose(turn, tilt, towards, rng.uniform(0.8, 1.2), tuple(rng.uniform(-3, 3, 2)))


def surface(part: Part, pose: Pose) -> tuple[NDArray, NDArray]:
    """Return heights of a part and of the ground alone, µm, as rays from above meet them."""
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    x, y = PIXEL * (x - pose.shift[0]), PIXEL * (y - pose.shift[1])
    axis = pose.tilt * np.array([-np.sin(pose.towards), np.cos(pose.towards), 0.0])
    u, v, normal = (cv2.Rodrigues(axis)[0] @ cv2.Rodrigues(np.array([0, 0, pose.turn]))[0]).T
    ground = -(normal[0] * x + normal[1] * y) / normal[2]
    radius = RADIUS * pose.scale

    def within(z: NDArray) -> NDArray[np.bool_]:
        across, along, above = ((e[0] * x + e[1] * y + e[2] * z) / radius for e in (u, v, normal))
        return above <= part(across, along)

    pace = 0.05 * radius / normal[2]  # 44 of them begin above every part
    low = ground.copy()
    for k in range(44, 0, -1):
        low = np.where((low == ground) & within(ground + k * pace), ground + k * pace, low)
    step = np.where(low > ground, pace, 0)
    for _ in range(10):
        step = step / 2
        low = np.where(within(low + step), low + step, low)
    return low, ground


DISCS = [disc(radius) for radius in RADII]


def blur(image: NDArray, height: NDArray) -> NDArray:
    """Return an image in each frame, each pixel blurred by the disc of its height's defocus."""
    ladder = np.stack([cv2.filter2D(image.astype(np.float32), -1, kernel) for kernel in DISCS])
    radii = (np.hypot(SHARPEST, BLUR_RATE * (height - position)) for position in POSITIONS)
    return np.stack([blended(ladder, RADII, radius) for radius in radii])


def render(part: Part, pose: Pose, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Return a part's true heights, µm, and its focal stack without noise, grey levels."""
    height, ground = surface(part, pose)
    body = height > ground
    nearest = distance_transform_edt(~body, return_distances=False, return_indices=True)
    beyond = height[tuple(nearest)]  # the part's edge, blurred over the ground, keeps its height
    below, above = (mixed_texture((SIDE, SIDE), rng) for _ in range(2))
    cover = blur(body, beyond)
    return height, blur(below, ground) * (1 - cover) + blur(above * body, beyond)


def reconstruct(clean: NDArray, noise: float, rng: np.random.Generator) -> tuple[NDArray, float]:
    """Return heights from frames with noise, and the median of their stated errors, µm."""
    found = depth_from_focus(expose(clean, rng, noise), POSITIONS, workers=1)
    return found.depth, float(np.nanmedian(found.uncertainty))


def level(height: NDArray) -> NDArray:
    """Return heights above their best plane."""
    y, x = np.indices(height.shape)
    terms, known = np.stack([np.ones(x.shape), x, y], axis=-1), np.isfinite(height)
    return height - terms @ np.linalg.lstsq(terms[known], height[known], rcond=None)[0]


def fill(height: NDArray) -> NDArray:
    """Give unknown heights the median of the known ones in 9 × 9 px, and keep the others."""
    return np.where(np.isnan(height), correct_spikes(height), height)


def surface_types(
    height: NDArray, noise: float, pixel_size: float = PIXEL, *, size: int = WINDOW
) -> tuple[NDArray[np.uint8], NDArray]:
    """Return surface types by thresholds from the noise, and H times the size of the part.

    The size is the standard deviation of the heights from their best plane. Regions below
    `SMALLEST` have the type 0, as unknown pixels do.
    """
    curvature = surface_curvature(height, pixel_size, size=size, noise=noise)
    labels = hk_labels(curvature)
    regions = connected(labels, background=0, connectivity=1)
    labels[np.bincount(regions.ravel())[regions] < SMALLEST] = 0
    return labels, curvature.mean * np.nanstd(level(height))


def describe(labels: NDArray[np.uint8], mean: NDArray) -> NDArray:
    """Return the features of `GROUPS`, which do not change when the map is turned or mirrored.

    Parameters
    ----------
    labels, mean : ndarray, shape (rows, cols)
        From `surface_types`, or a part of them.

    Returns
    -------
    ndarray, shape (52,)
        For each surface type its share of the known pixels; the logarithm of one more than its
        regions; for each pair of types its share of the borders between types; and for each type
        the mean of H on it, times its share.
    """
    known = max(np.count_nonzero(labels), 1)
    areas = [labels == kind for kind in TYPES]
    regions = [connected(area, connectivity=1).max() for area in areas]
    borders = np.zeros((10, 10))
    for one, other in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])):
        np.add.at(borders, (np.minimum(one, other), np.maximum(one, other)), 1)
    touching = np.array([borders[pair] for pair in PAIRS])
    return np.concatenate(
        [
            [area.sum() / known for area in areas],
            np.log1p(regions),
            touching / max(touching.sum(), 1),
            [mean[area].sum() / known for area in areas],
        ]
    )


def describe_part(height: NDArray, noise: float, pixel_size: float = PIXEL) -> NDArray:
    """Return the features of a height map, µm, whose unknown heights are filled in first."""
    return describe(*surface_types(fill(height), noise, pixel_size))


def describe_file(path: Path, noise: float, pixel_size: float | None) -> NDArray:
    """Return the features of a height map in a file, OME-TIFF or .npy, with heights in µm.

    The pixel size of an OME-TIFF is that of the file.
    """
    if path.suffix == ".npy":
        height = np.load(path)
    else:
        with tifffile.TiffFile(path) as file:
            height, text = file.asarray(), html.unescape(file.ome_metadata or "")
        if found := re.search(r'PhysicalSizeX="([^"]+)"', text):
            (unit,) = re.findall(r'PhysicalSizeXUnit="([^"]+)"', text) or ["µm"]
            if unit not in MICROMETERS:
                raise ValueError(f"pixel_size of {path.name} must be in µm, got {unit}")
            pixel_size = float(found[1]) * MICROMETERS[unit]
    if pixel_size is None:
        raise ValueError(f"pixel_size must be given, as {path.name} does not contain it")
    with warnings.catch_warnings():
        warnings.filterwarnings("default", "height has a median slope")
        return describe_part(height, noise, pixel_size)


def height_quantiles(height: NDArray) -> NDArray:
    """Return 16 quantiles of the heights from their best plane, µm: all that a histogram has."""
    return np.nanquantile(level(fill(height)), (np.arange(16) + 0.5) / 16)


def recognize(
    features: NDArray, training: NDArray, names: NDArray, groups: Sequence[int] | None = None
) -> pd.DataFrame:
    """Return the name of each row's nearest neighbor, and whether the row is like the training.

    Parameters
    ----------
    features, training : ndarray, shapes (n, m) and (k, m)
        What is to be named, and what has a name. Each group is scaled to a variance of 1.
    names : ndarray of str, shape (k,)
        Names of the training.
    groups : sequence of int, optional
        Features in each group; those of `GROUPS` by default.

    Returns
    -------
    pandas.DataFrame
        ``name``, ``distance``, and ``sure``: the nearest neighbor is no farther than 95 % of the
        training's are from others of their name, and nearer than 0.8 of the next name's.
    """
    variances = np.split(training.var(axis=0), np.cumsum(groups or list(GROUPS.values()))[:-1])
    scale = np.concatenate([np.full(len(each), each.sum() or 1.0) for each in variances]) ** -0.5
    among = cdist(training * scale, training * scale)
    alike = names[:, None] == names
    np.fill_diagonal(among, np.inf)
    usual = np.quantile(np.where(alike, among, np.inf).min(axis=1), 0.95)
    distances = cdist(features * scale, training * scale)
    name, distance = names[distances.argmin(axis=1)], distances.min(axis=1)
    next_name = np.where(name[:, None] == names, np.inf, distances).min(axis=1)
    sure = (distance <= usual) & (distance < 0.8 * next_name)
    return pd.DataFrame({"name": name, "distance": distance, "sure": sure})


def wilson(right: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return a share in per cent and the ends of its 95 % interval by Wilson."""
    result = binomtest(int(np.sum(right)), len(right))
    low, high = result.proportion_ci(method="wilson")
    return 100 * result.statistic, 100 * low, 100 * high


def sign_test(one: NDArray[np.bool_], two: NDArray[np.bool_]) -> tuple[float, int, int]:
    """Return the p-value of paired names, and how often only the first or the second are right.

    Examples
    --------
    >>> import numpy as np
    >>> from compendium.experiments.recognition import sign_test
    >>> first = np.array([True] * 5 + [False])
    >>> sign_test(first, np.zeros(6, bool))
    (0.0625, 5, 0)
    """
    only_one, only_two = int(np.sum(one & ~two)), int(np.sum(two & ~one))
    return float(binomtest(only_one, only_one + only_two).pvalue), only_one, only_two
