"""What of a height map tells a part: shares, borders and directions of its surface types.

All numbers are free of units and of the place, turn and mirror image of the part.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from microlib._common import Array
from microlib.curvature._graph import CONVEX, FAMILY_NAMES, FLAT, Graph, region_graph
from microlib.curvature._labels import clean_labels, hk_labels
from microlib.curvature._surface import derivatives, surface_curvature

#: Longest side to which a map is reduced, px: four windows of the wider size across a part that
#: fills the map. Larger maps are averaged, which costs nothing and lowers the noise.
GRID = 96
#: Windows, px: the narrow one of the thesis, and one of which the noise is a fifth, (7/11)³.
NARROW, WIDE = 7, 11
#: Standard errors, and share of the map's strongest bends, below which H counts as zero. The first
#: is chapter 3's; the second keeps smooth errors, which no standard error tells, out of the labels.
_ERRORS, _SHARE = 3.5, 0.25
#: Percentile of the curvedness that stands for the strongest bends: a crease of one window's width
#: across the map is a tenth of it.
_STRONGEST = 95.0
#: Regions below this share of the map are given to their neighbors.
_SMALLEST = 0.004
_BINS = 8
_HARMONICS = np.arange(1, 7)


@dataclass(frozen=True)
class Bends:
    """Curvature of a map at one window: H, the deviator D ≥ 0 with κ = H ± D, and directions.

    Attributes
    ----------
    mean, deviator : ndarray of float64, shape (rows, cols)
        H and the root of H² − K, 1/µm.
    direction : ndarray of float64, shape (rows, cols)
        Direction of the greater second derivative, rad, modulo π.
    error : float
        Standard error of H from white noise, 1/µm.
    strongest : float
        Strong bends of the map, 1/µm: a high percentile of the curvedness.
    """

    mean: Array
    deviator: Array
    direction: Array
    error: float
    strongest: float

    @property
    def curvedness(self) -> Array:
        """Root mean square of the principal curvatures, 1/µm."""
        return np.hypot(self.mean, self.deviator)

    @property
    def limit(self) -> float:
        """Magnitude below which a curvature counts as zero, 1/µm."""
        return max(_ERRORS * self.error, _SHARE * self.strongest)


@dataclass(frozen=True)
class Description:
    """Numbers by which a part is recognized, and the labels from which they come."""

    features: dict[str, float]
    labels: NDArray[np.uint8]
    graph: Graph
    bends: Bends


def bends(z: Array, pitch: float, noise: float, size: int) -> Bends:
    """Return curvature without the border that the window of `size` pixels does not see."""
    curvature = surface_curvature(z, pitch, size=size, noise=noise)
    inner = (slice(size - 1, 1 - size),) * 2
    h, k = curvature.mean[inner], curvature.gaussian[inner]
    _, _, zxx, zyy, zxy = (d[inner] for d in derivatives(z, pitch, size))
    deviator = np.sqrt(np.maximum(h**2 - k, 0.0))
    return Bends(
        mean=h,
        deviator=deviator,
        direction=0.5 * np.arctan2(2 * zxy, zxx - zyy),
        # Where the map is steep the error is smaller; the labels use what holds on the flat.
        error=float(np.max(curvature.mean_error[inner])),
        strongest=float(np.percentile(np.hypot(h, deviator), _STRONGEST)),
    )


def describe(z: Array, pitch: float, noise: float) -> Description:
    """Describe a map of heights without NaN on the working grid."""
    narrow, wide = (bends(z, pitch, noise, size) for size in (NARROW, WIDE))
    limit = wide.limit
    labels = hk_labels(
        wide.mean,
        wide.mean**2 - wide.deviator**2,
        limit,
        # K is the product of two curvatures: it is zero where the smaller one is.
        limit * (np.abs(wide.mean) + wide.deviator),
    )
    labels = clean_labels(labels, max(1, round(_SMALLEST * labels.size)))
    graph = region_graph(labels)
    extent = pitch * float(np.sqrt(wide.mean.size))
    features = {
        **_prefixed("narrow", _shape_index(narrow)),
        **_prefixed("wide", _shape_index(wide)),
        "bend": _log(wide.strongest * extent),
        "significance": _log(wide.strongest / max(wide.error, 1e-9 / extent)),
        "narrow to wide": _log(narrow.strongest / max(wide.strongest, 1e-9 / extent)),
        **_label_shares(labels),
        **_graph_features(graph),
        **_rays(wide),
        **_main_region(wide, graph),
        **_heights(z, pitch, noise),
    }
    return Description(features, labels, graph, wide)


def _prefixed(prefix: str, values: dict[str, float]) -> dict[str, float]:
    return {f"{prefix} {name}": value for name, value in values.items()}


def _log(ratio: float) -> float:
    """Logarithm of a positive ratio within 1/e⁹ to e⁹: beyond, all is the same."""
    return float(np.clip(np.log(max(ratio, 1e-9)), -9.0, 9.0))


def _weights(bend: Bends) -> Array:
    """Curvedness where it is no noise, of unit sum; zero everywhere if nothing is bent."""
    strong = bend.curvedness
    weight = np.where(strong > bend.limit, strong, 0.0)
    return weight / max(weight.sum(), np.finfo(float).tiny)


def _shape_index(bend: Bends) -> dict[str, float]:
    """Shares of Koenderink's shape index, dome −1 to bowl 1, by curvedness and by area."""
    index = np.arctan2(bend.mean, bend.deviator) * 2 / np.pi
    weight = _weights(bend)
    # Linear shares between neighboring bins, so that noise moves them little.
    place = (index + 1) / 2 * (_BINS - 1)
    low = np.clip(place.astype(int), 0, _BINS - 2)
    part = place - low
    total = np.bincount(low.ravel(), (weight * (1 - part)).ravel(), _BINS)
    total += np.bincount(low.ravel() + 1, (weight * part).ravel(), _BINS)
    shares = {f"index {n}": float(value) for n, value in enumerate(total)}
    return {**shares, "bent": float(np.mean(weight > 0))}


def _label_shares(labels: NDArray[np.uint8]) -> dict[str, float]:
    counts = np.bincount(labels.ravel(), minlength=10) / labels.size
    return {f"label {n}": float(counts[n]) for n in range(1, 10) if n != 4}


def _graph_features(graph: Graph) -> dict[str, float]:
    """Number and largest region of each family, and the shares of the borders between them."""
    total = graph.regions.size
    found = {}
    for family, name in enumerate(FAMILY_NAMES):
        areas = graph.area[graph.family == family]
        found[f"{name} regions"] = float(np.log1p(len(areas)))
        found[f"{name} largest"] = float(areas.max() / total) if len(areas) else 0.0
        if family in (CONVEX, FLAT):
            found[f"{name} second"] = float(np.sort(areas)[-2] / total) if len(areas) > 1 else 0.0
    length = np.zeros((4, 4))
    one, two = (graph.family[graph.edges[:, n] - 1] for n in (0, 1))
    np.add.at(length, (np.minimum(one, two), np.maximum(one, two)), graph.edges[:, 2])
    length /= np.sqrt(total)
    for first in range(4):
        for second in range(first + 1, 4):
            found[f"border {first}-{second}"] = float(np.log1p(length[first, second]))
    return found


def _rays(bend: Bends) -> dict[str, float]:
    """How the bends lie about the middle of what is bent, for convex and for concave ones."""
    weight = _weights(bend)
    y, x = np.indices(weight.shape, dtype=float)
    signed = {"convex": weight * (bend.mean < 0), "concave": weight * (bend.mean > 0)}
    side = float(np.sqrt(weight.size))
    lean = bend.mean / np.maximum(bend.curvedness, np.finfo(float).tiny)
    found = {"balance": float(np.sum(weight * lean))}
    middle = _middle(signed["convex"] if signed["convex"].any() else weight, x, y)
    spread = {}
    for name, part in signed.items():
        total = max(float(part.sum()), np.finfo(float).tiny)
        u, v = x - middle[0], y - middle[1]
        r, angle = np.hypot(u, v), np.arctan2(v, u)
        # The angle of a pixel near the middle says nothing: it counts by its distance.
        moment = part * r
        full = max(float(moment.sum()), np.finfo(float).tiny)
        for m in _HARMONICS:
            turned = abs(np.sum(moment * np.exp(1j * m * angle))) / full
            found[f"{name} ray {m}"] = float(turned)
        anisotropy = part * bend.deviator / np.maximum(bend.curvedness, np.finfo(float).tiny)
        for fold in (2, 4):
            aligned = abs(np.sum(anisotropy * np.exp(1j * fold * bend.direction))) / total
            found[f"{name} aligned {fold}"] = float(aligned)
        radial = np.sum(anisotropy * np.cos(2 * (bend.direction - angle))) / total
        found[f"{name} radial"] = float(radial)
        mean_r = float(np.sum(part * r)) / total
        spread[name] = float(np.sqrt(np.sum(part * r**2) / total))
        variance = max(float(np.sum(part * r**2)) / total - mean_r**2, 0.0)
        found[f"{name} ring"] = float(np.sqrt(variance) / max(mean_r, 1.0)) if total > 1e-9 else 0.0
        found[f"{name} spread"] = spread[name] / side
        found[f"{name} weight"] = float(part.sum())
    found["nested"] = _log((spread["concave"] + 1) / (spread["convex"] + 1))
    return found


def _middle(weight: Array, x: Array, y: Array) -> tuple[float, float]:
    total = float(weight.sum())
    if total <= 0:
        return float(x.mean()), float(y.mean())
    return float(np.sum(weight * x) / total), float(np.sum(weight * y) / total)


_MAIN = (
    "area",
    "elongation",
    "solidity",
    "holes",
    "border",
    "level",
    "spread of H",
    "K/H²",
    "spread of K/H²",
    "fall of H",
    "aligned",
    "crossed",
    "radial",
    "flat inside",
)


def _main_region(bend: Bends, graph: Graph) -> dict[str, float]:
    """Form and curvature of the largest convex region; zeros if there is none."""
    convex = np.flatnonzero(graph.family == CONVEX)
    if len(convex) == 0:
        return {f"main {name}": 0.0 for name in _MAIN}
    mask = graph.regions == convex[np.argmax(graph.area[convex])] + 1
    y, x = (c.astype(float) for c in np.nonzero(mask))
    area = float(mask.sum())
    (vxx, vxy), (_, vyy) = np.cov(np.stack([x, y]), bias=True) + np.eye(2) / 12
    half, root = (vxx + vyy) / 2, np.hypot((vxx - vyy) / 2, vxy)
    hull, inside = _hull(mask)
    filled = ndimage.binary_fill_holes(mask)
    rim = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    h, d = bend.mean[mask], bend.deviator[mask]
    ratio = 1 - (d / np.minimum(h, -bend.limit)) ** 2
    r = np.hypot(x - x.mean(), y - y.mean()) + 1.0
    share = d / np.maximum(np.hypot(h, d), np.finfo(float).tiny)
    angle = bend.direction[mask]
    toward = np.arctan2(y - y.mean(), x - x.mean())
    flat = _flat_share(bend, inside)
    values = (
        area / mask.size,
        _log(np.sqrt((half + root) / max(half - root, 1 / 12))),
        area / hull,
        float(np.log1p((filled.sum() - area) / area)),
        float(rim.mean()),
        _log(-float(h.mean()) / bend.strongest) if h.mean() < 0 else -9.0,
        float(np.clip(h.std() / max(abs(h.mean()), bend.limit), 0, 3)),
        float(np.clip(np.median(ratio), -3, 1)),
        float(np.clip(np.subtract(*np.percentile(ratio, [75, 25])), 0, 3)),
        _slope(np.log(r), np.log(np.maximum(-h, bend.limit / 2))),
        float(abs(np.mean(share * np.exp(2j * angle)))),
        float(abs(np.mean(share * np.exp(4j * angle)))),
        float(np.mean(share * np.cos(2 * (angle - toward)))),
        flat,
    )
    return {f"main {name}": float(v) for name, v in zip(_MAIN, values, strict=True)}


def _flat_share(bend: Bends, inside: NDArray[np.bool_]) -> float:
    """Share of the pixels inside that are not bent."""
    return float(np.mean(bend.curvedness[inside] < bend.limit)) if inside.any() else 0.0


def _hull(mask: NDArray[np.bool_]) -> tuple[float, NDArray[np.bool_]]:
    """Area of the convex hull of a mask, pixels whole, and its pixels."""
    points = np.argwhere(mask)[:, ::-1].astype(np.int32)
    corners = cv2.convexHull(points)
    drawn = np.zeros(mask.shape, np.uint8)
    cv2.fillConvexPoly(drawn, corners, 1)
    inside = drawn > 0
    return float(max(inside.sum(), mask.sum())), inside


def _slope(x: Array, y: Array) -> float:
    dx = x - x.mean()
    return float(np.clip(np.sum(dx * (y - y.mean())) / max(np.sum(dx**2), 1e-9), -3, 3))


def _heights(z: Array, pitch: float, noise: float) -> dict[str, float]:
    """Relief above the best plane: its size in the map and in the noise, and its distribution."""
    y, x = np.indices(z.shape, dtype=float)
    base = np.stack([x.ravel(), y.ravel(), np.ones(z.size)], axis=1)
    rest = z.ravel() - base @ np.linalg.lstsq(base, z.ravel(), rcond=None)[0]
    spread = float(rest.std())
    side = pitch * float(np.sqrt(z.size))
    unit = rest / max(spread, 1e-12 * side)
    return {
        "relief": _log(spread / side),
        "relief in noise": _log(spread / max(noise, 1e-6 * side)),
        "skew": float(np.clip(np.mean(unit**3), -4, 4)),
        "tails": float(np.clip(np.mean(unit**4), 0, 8)),
    }
