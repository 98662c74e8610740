"""Polynomials of two coordinates, for smooth displacements over an image."""

from __future__ import annotations

import numpy as np

from microlib._common import Array


def polynomial_basis(
    places: Array, points_per_term: int, max_degree: int = 4
) -> tuple[Array, Array]:
    """Monomials xⁱ yʲ of places (..., 2), (..., terms), and their degrees i + j, (terms,).

    Places are taken from their mean, in units of their extent. The highest degree d, at most
    `max_degree`, is the highest with `points_per_term` places for each of the (d + 1)(d + 2)/2
    terms.
    """
    scaled = (places - places.reshape(-1, 2).mean(axis=0)) / np.ptp(places)
    x, y = np.moveaxis(scaled, -1, 0)
    terms = [(d + 1) * (d + 2) // 2 for d in range(1, max_degree + 1)]
    degree = sum(len(places) >= points_per_term * count for count in terms)
    powers = np.array([(i, total - i) for total in range(degree + 1) for i in range(total + 1)])
    return np.stack([x**i * y**j for i, j in powers], axis=-1), powers.sum(axis=1)
