"""The mark of a pattern that tells where its coordinates begin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array

#: A mark is of another size if its area is so many times that of the others, or so many times less.
#: Fitted areas of equal circles differ by less than a tenth; origin marks are made to be seen, by
#: half a diameter or more.
_ODD = 1.4
#: A place inside the grid has a mark on every one of these sides.
_SIDES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])


def find_origin(grid: NDArray[np.intp], sizes: Array) -> NDArray[np.intp]:
    """Place of the one mark that is unlike the others in size, or missing.

    Parameters
    ----------
    grid : ndarray of int, shape (N, 2)
        Places of the marks.
    sizes : ndarray, shape (N,)
        Their areas, in those of a cell of the grid.

    Returns
    -------
    ndarray of int, shape (2,)

    Raises
    ------
    ValueError
        If there is none such place inside the grid, or more than one.

    Examples
    --------
    >>> places = np.stack(np.meshgrid(np.arange(4), np.arange(3)), axis=-1).reshape(-1, 2)
    >>> find_origin(places, np.where((places == [2, 1]).all(axis=1), 2.0, 1.0))
    array([2, 1])
    """
    ratio = sizes / np.median(sizes)
    odd = {tuple(place) for place in grid[np.maximum(ratio, 1 / ratio) > _ODD].tolist()}
    taken = {tuple(place) for place in grid.tolist()}
    around = {tuple(place) for place in (grid[:, None] + _SIDES).reshape(-1, 2).tolist()}
    missing = {
        place
        for place in around - taken
        if all(tuple(beside) in taken for beside in (np.array(place) + _SIDES).tolist())
    }
    if len(odd | missing) != 1:
        raise ValueError(
            "image must show one circle of another size, or one place inside the grid without any, "
            f"for origin='odd', got {len(odd)} and {len(missing)}"
        )
    return np.array(next(iter(odd | missing)))
