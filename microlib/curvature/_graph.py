"""Regions of one surface type and which of them touch: the graph by which a part is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.measure import label as connected

from microlib._common import Array

#: The four families of Table 3.1 by label (0 and the empty label 4 count as flat): flat, convex,
#: saddle, concave. The saddles with H ≠ 0 go with the sign of H, as on the sides of a torus.
FLAT, CONVEX, SADDLE, CONCAVE = range(4)
FAMILY_NAMES = ("flat", "convex", "saddle", "concave")
_FAMILY = np.array([FLAT, CONVEX, CONVEX, CONVEX, FLAT, FLAT, SADDLE, CONCAVE, CONCAVE, CONCAVE])


@dataclass(frozen=True)
class Graph:
    """Regions and the borders between them.

    Attributes
    ----------
    regions : ndarray of int, shape (rows, cols)
        Number of the region of each pixel from 1; 0 where nothing is labeled.
    family : ndarray of int, shape (n,)
        Family of each region.
    area : ndarray of float64, shape (n,)
        Area, px.
    edges : ndarray of int, shape (m, 3)
        Pairs of regions that touch (numbered from 1, the smaller first), and the length of their
        border, px.
    """

    regions: NDArray[np.intp]
    family: NDArray[np.intp]
    area: Array
    edges: NDArray[np.intp]


def families(labels: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Return the family of each pixel."""
    return np.asarray(_FAMILY[labels], np.intp)


def region_graph(labels: NDArray[np.uint8]) -> Graph:
    """Return the regions of one family and their borders, by neighbors along rows and columns."""
    family = families(labels)
    regions = connected(np.where(labels > 0, family + 1, 0), background=0, connectivity=1)
    count = int(regions.max())
    first = np.zeros(count + 1, np.intp)
    first[regions.ravel()[::-1]] = family.ravel()[::-1]
    pairs = np.concatenate(
        [
            np.stack([one.ravel(), two.ravel()], axis=1)
            for one, two in ((regions[1:], regions[:-1]), (regions[:, 1:], regions[:, :-1]))
        ]
    )
    pairs = np.sort(pairs[(pairs.min(axis=1) > 0) & (pairs[:, 0] != pairs[:, 1])], axis=1)
    if len(pairs):
        touching, length = np.unique(pairs, axis=0, return_counts=True)
        edges = np.column_stack([touching, length])
    else:
        edges = np.zeros((0, 3), np.intp)
    area = np.bincount(regions.ravel(), minlength=count + 1)[1:].astype(float)
    return Graph(regions, first[1:], area, edges)
