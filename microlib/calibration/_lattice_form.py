"""Tell what lattice marks lie on, from the shapes in which they are seen.

Round marks are seen as ellipses. Sent back through the derivatives of the map from the lattice's
coordinates to the image they all are one ellipse, and that ellipse is the metric of the
coordinates: it tells a square lattice from a tilted hexagonal one, which points alone cannot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from microlib._common import Array
from microlib.calibration._grid_order import mean_steps

#: Lattices by name, and the coordinates of their steps in the pattern's plane, in pitches.
STEPS = {
    "square": np.eye(2),
    "hexagonal": np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]]),
    "asymmetric": np.eye(2),
}
LATTICES = tuple(STEPS)
#: Most scatter of the shapes: photographed boards have up to 0.033 (development images), marks of
#: chance mostly more than 0.2.
_MOST_SCATTER = 0.08
#: Longer over shorter step of a lattice of equal steps, at most, and how far the cosine between
#: them may lie from 0 or ½. Every second place of every second row of a square lattice is nearest
#: to a hexagonal one, with a ratio of 1.118 and a cosine of 0.447.
_MOST_RATIO, _MOST_COSINE = 1.1, 0.1
#: Least part of the lattice's places inside the marks' convex hull that hold one. False lattices
#: of the development images hold a fifth to a half.
LEAST_FULL = 0.6


@dataclass(frozen=True)
class Form:
    """Reduced form of a lattice.

    Parameters
    ----------
    name : str
        "square", "hexagonal", or what it is in words.
    gram : ndarray, shape (2, 2)
        Inner products of the two steps of the grid's coordinates, up to a factor.
    """

    name: str
    gram: Array


def lattice_form(shapes: Array, steps: Array) -> Form:
    """Find the lattice's form from the marks' shapes.

    Parameters
    ----------
    shapes : ndarray, shape (N, 2, 2)
        Second moments of each mark in the image, up to one factor, px².
    steps : ndarray, shape (N, 2, 2)
        Derivatives of the image by the grid's coordinates there, px.

    Returns
    -------
    Form

    Raises
    ------
    ValueError
        If the marks are not of one shape.

    Examples
    --------
    >>> lattice_form(np.tile(np.eye(2), (4, 1, 1)), np.tile(10 * np.eye(2), (4, 1, 1))).name
    'square'
    """
    inverse = np.linalg.inv(steps)
    metrics = inverse @ shapes @ inverse.transpose(0, 2, 1)
    metric = np.median(metrics, axis=0)
    values, vectors = np.linalg.eigh(metric)
    if not values[0] > 0:
        raise ValueError("image must show marks of one shape, got some that have none in common")
    white = (vectors / np.sqrt(values)) @ vectors.T
    beside = np.linalg.norm(white @ metrics @ white - np.eye(2), axis=(1, 2)) / np.sqrt(2)
    scatter = float(np.median(beside))
    if scatter > _MOST_SCATTER:
        raise ValueError(
            f"image must show marks of one shape and size, got some that scatter by "
            f"{100 * scatter:.0f} %"
        )
    gram = np.linalg.inv(metric)
    return Form(_name(gram), gram)


def refuse_other(marks: str, form: Form, lattice: str) -> None:
    """Refuse a lattice of another form than the one that was asked for."""
    wanted = "hexagonal" if lattice == "hexagonal" else "square"
    if form.name != wanted:
        hint = f": lattice={form.name!r} takes it" if form.name in STEPS else ""
        raise ValueError(
            f"image must show {marks} on a {wanted} lattice, got a {form.name} one{hint}"
        )


def _name(gram: Array) -> str:
    first, second, between = _reduced(gram)
    ratio, cosine = np.sqrt(second / first), between / np.sqrt(first * second)
    if cosine < _MOST_COSINE:
        return "square" if ratio < _MOST_RATIO else f"rectangular (1 : {ratio:.2f})"
    if ratio < _MOST_RATIO and abs(cosine - 0.5) < _MOST_COSINE:
        return "hexagonal"
    angle = np.rad2deg(np.arccos(cosine))
    return f"oblique (1 : {ratio:.2f} at {angle:.0f}°)"


def _reduced(gram: Array) -> tuple[float, float, float]:
    """Squares of the two shortest steps of a lattice, and their inner product, not negative."""
    (a, b), (_, c) = gram
    while True:
        if c < a:
            a, c = c, a
        turns = np.round(b / a)
        if turns == 0:
            return float(a), float(c), float(abs(b))
        b, c = b - turns * a, c - 2 * turns * b + turns**2 * a


def fill(grid: NDArray[np.intp]) -> float:
    """Part of a lattice's places inside the convex hull of the marks that hold one.

    Parameters
    ----------
    grid : ndarray of int, shape (N, 2)
        Coordinates of the marks.

    Returns
    -------
    float
        Zero for marks in one row.

    Examples
    --------
    >>> fill(np.array([[0, 0], [2, 0], [0, 2], [2, 2]]))
    0.4444444444444444
    """
    if np.linalg.matrix_rank(grid - grid[0]) < 2:
        return 0.0
    hull = ConvexHull(grid)
    corners = grid[hull.vertices]
    border = np.gcd(*np.abs(corners - np.roll(corners, 1, axis=0)).T).sum()
    # Pick's theorem; a hull's volume in the plane is its area.
    return float(len(grid) / (hull.volume + border / 2 + 1))


def refuse_gaps(marks: str, grid: NDArray[np.intp]) -> None:
    """Refuse a lattice of which many marks are missing, as chance puts it together."""
    share = fill(grid)
    if share < LEAST_FULL:
        raise ValueError(
            f"image must show a grid of {marks}, got {len(grid)} that fill {100 * share:.0f} % of "
            "the places of one"
        )


def orient(
    points: Array,
    grid: NDArray[np.intp],
    form: Form,
    lattice: str,
    *,
    direction: float,
    mirrored: bool,
) -> NDArray[np.intp]:
    """Count the lattice along its shortest steps, the first of them in the wanted direction.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Image points, px.
    grid : ndarray of int, shape (N, 2)
        Any integer coordinates of the lattice.
    form : Form
        Of these coordinates.
    lattice : str
        One of `LATTICES`.
    direction : float
        Direction of the pattern's x axis in the image, rad.
    mirrored : bool
        True if the pattern is seen from behind.

    Returns
    -------
    ndarray of int, shape (N, 2)
        Coordinates, from zero on.
    """
    if lattice == "asymmetric":  # its square lattice stands on a corner
        direction += -np.pi / 4 if mirrored else np.pi / 4
    along = mean_steps(points, grid)
    index = np.arange(-2, 3)
    every = np.stack(np.meshgrid(index, index), axis=-1).reshape(-1, 2)
    length = np.sqrt(np.einsum("ni,ij,nj->n", every, form.gram, every))
    shortest = length[length > 0].min()
    axes = every[(length > 0) & (length < _MOST_RATIO * shortest)]
    seen = axes @ along
    size = np.hypot(*seen.T)
    if not (size > 0).all():
        raise ValueError(f"image must show a plane grid, got {len(points)} points in one row")
    heading = seen / size[:, None] @ [np.cos(direction), np.sin(direction)]
    first = int(np.argmax(heading))
    turn = seen[first, 0] * seen[:, 1] - seen[first, 1] * seen[:, 0]
    cosine = axes[first] @ form.gram @ axes.T / shortest**2
    wanted = 0.5 if lattice == "hexagonal" else 0.0
    wrong = np.abs(cosine - wanted) + 10.0 * ((turn > 0) == mirrored)
    basis = np.stack([axes[first], axes[int(np.argmin(wrong))]])
    counted = np.round(grid @ np.linalg.inv(basis)).astype(np.intp)
    if lattice == "asymmetric":
        counted = counted @ np.array([[1, 1], [-1, 1]])
    return counted - counted.min(axis=0)
