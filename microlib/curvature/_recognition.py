"""Which part a height map shows, by the graph of its surface types; or that it is none."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Tidy, as_array, scalar
from microlib.curvature._descriptor import WIDE, Description, describe
from microlib.curvature._graph import FAMILY_NAMES
from microlib.curvature._grid import on_grid

#: In the order of the networks' outputs; a last output stands for all other shapes.
PART_KINDS = ("sphere", "cylinder", "cone", "plane", "saddle", "step")

#: Learned with maps of 64 px and more; below, the wide window sees less than half of the map.
_SMALLEST_SIDE = 64
#: Lengths of sides that one grid serves.
_MOST_LONG = 2.0
#: Share of unknown pixels beyond which holes would be guessed and not closed.
_MOST_UNKNOWN = 0.25
#: As in `surface_curvature`: curvatures and their squares within the range of floating point.
_FARTHEST = 1e12


@dataclass(frozen=True)
class PartRecognition(Tidy):
    """What part a map shows, and why.

    Attributes
    ----------
    kind : str or None
        One of `PART_KINDS`; None if the map was refused.
    confidence : float
        Probability of the most likely kind, 0 to 1, if the map shows one of them or one of the
        other shapes that were learned.
    reason : str
        Why the map was refused; empty if it was not.
    probabilities : dict of str to float
        Probability of each kind, and of ``"other"``.
    distance : float
        Distance of the map's description from the examples of its kind, in that within which 998 of
        1000 examples lie; above 1 the map is refused.
    features : dict of str to float
        The description: shares, borders, directions and forms of the surface types, without unit.
    labels : ndarray of uint8, shape (rows, cols)
        Surface types of Table 3.1 as they were used; 0 along the border.
    regions : pandas.DataFrame
        The nodes of the graph, one row a region of one ``family`` (flat, convex, saddle, concave):
        ``area`` as share of the map, ``mean`` (H, 1/µm), ``gaussian`` (K, 1/µm²), and the centroid
        ``x``, ``y`` (px of the given map).
    borders : pandas.DataFrame
        The edges of the graph: the rows ``one`` and ``two`` of `regions` that touch, and the
        ``length`` of their border, µm.
    """

    _large = ("labels", "regions", "borders")

    kind: str | None
    confidence: float
    reason: str
    probabilities: dict[str, float]
    distance: float
    features: dict[str, float]
    labels: NDArray[np.uint8]
    regions: pd.DataFrame
    borders: pd.DataFrame


def recognize_part(
    height: ArrayLike, pixel_size: float, *, noise: float | None = None
) -> PartRecognition:
    """Tell which part a height map shows, or that it shows none that is known.

    Parameters
    ----------
    height : array_like, shape (rows, cols)
        Heights, µm, towards the viewer, of one part: wholly in the map, or, for a rod, a step and a
        saddle, across it. At least 64 px a side, no side more than twice the other; the part at
        least a third of the shorter side wide (a rod a quarter). NaN marks what is unknown, up to
        a quarter of the map.
    pixel_size : float
        Distance between neighboring pixels on the object, µm.
    noise : float, optional
        Standard deviation of the heights, µm, independent from pixel to pixel; what is white in the
        map by default.

    Returns
    -------
    PartRecognition
        The ``kind`` (None if refused, with the ``reason``), its ``confidence`` (0 to 1), the
        ``probabilities`` of all kinds, and the ``distance`` from the examples of the kind (1 is
        their reach). As evidence the ``features``, the ``labels`` of the map, the ``regions`` (a
        table with family, share of the map, H in 1/µm, K in 1/µm² and middle in px) and their
        ``borders`` (a table with two rows of `regions` and a length in µm).

    Raises
    ------
    ValueError
        If the map is too small or too long or holds an infinity, `pixel_size` is not positive, or
        `noise` is negative.

    Notes
    -----
    H and K are taken with windows of 7 and 11 px on a grid of at most 96 px a side, labeled as in
    (3.25), and joined to regions and their borders. What is zero is the greater of 3.5 standard
    errors and a quarter of the map's strongest bends. Numbers that neither shift, turn nor mirror
    image changes go into a small network that was fitted to rendered parts and to other shapes;
    learned parts rise by a fifth to about once their half-width (a ball on the ground by twice),
    cones have slopes of 0.3 to 1.5, and the two curvatures of a saddle differ by a factor of 1.8 at
    most. A map is refused if *other* is likelier than any kind, or if it
    lies far from all examples of its kind. A shape that resembles none of either may still be
    misnamed: the benchmark says how often.

    Examples
    --------
    >>> y, x = np.mgrid[-48:48, -48:48] + 0.5
    >>> ball = np.sqrt(np.maximum(30.0**2 - x**2 - y**2, 0))
    >>> found = recognize_part(ball, pixel_size=1.0, noise=0.01)
    >>> found.kind, round(found.confidence, 1)
    ('sphere', 1.0)
    >>> recognize_part(np.maximum(30 - np.maximum(abs(x), abs(y)), 0), 1.0).kind is None
    True
    """
    pitch = scalar("pixel_size", pixel_size, above=0, least=1 / _FARTHEST, most=_FARTHEST)
    sigma = None if noise is None else scalar("noise", noise, least=0, most=_FARTHEST)
    z = as_array("height", height, shape=(None, None), finite=False, largest=_FARTHEST)
    if np.isinf(z).any():
        raise ValueError(f"height must be finite or NaN, got {int(np.isinf(z).sum())} infinite")
    if min(z.shape) < _SMALLEST_SIDE or max(z.shape) > _MOST_LONG * min(z.shape):
        raise ValueError(
            f"height must be at least {_SMALLEST_SIDE} px on each side and no side more than "
            f"{_MOST_LONG:g} times the other, got {z.shape}"
        )
    unknown = float(np.isnan(z).mean())
    grid = on_grid(np.zeros_like(z) if unknown == 1 else z, pitch, sigma)
    description = describe(grid.height, grid.pixel_size, grid.noise)
    verdict = _judge(description.features)
    if unknown > _MOST_UNKNOWN:
        why = f"{unknown:.0%} of the heights are unknown, at most {_MOST_UNKNOWN:.0%} may be"
        verdict |= {"kind": None, "reason": why}
    evidence = _evidence(description, z.shape, grid.pixel_size)
    return PartRecognition(**verdict, features=description.features, **evidence)


@cache
def _learned() -> dict[str, Any]:
    """Return the coefficients that ``make parts`` writes, as arrays."""
    text = (files("microlib.curvature") / "_part_classes.json").read_text(encoding="utf-8")
    read = json.loads(text)
    nets = [{name: np.array(value) for name, value in net.items()} for net in read["nets"]]
    arrays = {
        name: np.array(read[name]) for name in ("middle", "spread", "axes", "centers", "whiteners")
    }
    return {"features": read["features"], "nets": nets, **arrays}


def probabilities(unit: Array, nets: list[dict[str, Array]]) -> Array:
    """Return the mean over networks of the probabilities of each kind and of other shapes."""
    total = 0.0
    for net in nets:
        score = np.tanh(unit @ net["inner"] + net["inner_bias"]) @ net["outer"] + net["outer_bias"]
        score = np.exp(score - score.max(axis=-1, keepdims=True))
        total = total + score / score.sum(axis=-1, keepdims=True)
    return np.asarray(total / len(nets))


def standardized(features: Array, middle: Array, spread: Array) -> Array:
    """Return features in their spreads over all examples; beyond five, all is equally far."""
    return np.clip((features - middle) / spread, -5.0, 5.0)


def _judge(features: dict[str, float]) -> dict[str, Any]:
    learned = _learned()
    given = np.array([features[name] for name in learned["features"]])
    unit = standardized(given, learned["middle"], learned["spread"])
    likely = probabilities(unit, learned["nets"])
    best = int(np.argmax(likely[:-1]))
    kind = PART_KINDS[best]
    offset = unit @ learned["axes"] - learned["centers"][best]
    distance = float(np.linalg.norm(offset @ learned["whiteners"][best]))
    reason = ""
    if likely[-1] >= likely[best]:
        reason = "resembles other shapes more than any known part"
    elif distance > 1:
        reason = f"nearest to a {kind}, but {distance:.3g} times as far as its examples reach"
    return {
        "kind": None if reason else kind,
        "confidence": float(likely[best]),
        "reason": reason,
        "probabilities": dict(zip((*PART_KINDS, "other"), likely.tolist(), strict=True)),
        "distance": distance,
    }


def _evidence(found: Description, shape: tuple[int, ...], pitch: float) -> dict[str, Any]:
    """Return labels in the shape of the given map, and the graph as two tables."""
    graph, bends = found.graph, found.bends
    rows, cols = (int(n) for n in shape)
    padded = np.pad(found.labels, WIDE - 1)
    labels = cv2.resize(padded, (cols, rows), interpolation=cv2.INTER_NEAREST_EXACT)
    count = len(graph.area)
    numbers = graph.regions.ravel()
    gaussian = bends.mean**2 - bends.deviator**2
    y, x = np.indices(graph.regions.shape) + WIDE - 1 + 0.5
    means = [
        np.bincount(numbers, values.ravel(), count + 1)[1:] / graph.area
        for values in (bends.mean, gaussian, x * cols / padded.shape[1], y * rows / padded.shape[0])
    ]
    names = np.array(FAMILY_NAMES)[graph.family]
    regions = pd.DataFrame({"family": names, "area": graph.area / graph.regions.size})
    for name, values, less in zip(
        ("mean", "gaussian", "x", "y"), means, (0, 0, 0.5, 0.5), strict=True
    ):
        regions[name] = values - less
    one, two, length = graph.edges.T
    borders = pd.DataFrame({"one": one - 1, "two": two - 1, "length": pitch * length})
    return {"labels": np.asarray(labels, np.uint8), "regions": regions, "borders": borders}
