"""Height maps of known shape, µm towards the viewer, on a grid of square pixels."""

from __future__ import annotations

import numpy as np

from microlib._common import Array, as_image_shape, as_scalar


def _centered(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Return x and y from the center of the image, px."""
    rows, cols = as_image_shape("shape", shape, least=2)
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float64)
    return x - (cols - 1) / 2, y - (rows - 1) / 2


def parabolic_cylinder(
    shape: tuple[int, int], height: float, *, width: float | None = None
) -> Array:
    """Return the parabolic profile of section 5.5.1, the same in every row.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    height : float
        Height of the crest above the base, µm.
    width : float, optional
        Width of the parabola at its base, px; the width of the image by default. Outside, the
        surface is flat.

    Returns
    -------
    ndarray of float64, shape `shape`
        :math:`h\\,(1 - (2x/w)^2)`, zero outside, µm.

    Raises
    ------
    ValueError
        If a side is below 2 px or a length not positive.

    Examples
    --------
    >>> from microlib.synthetic import parabolic_cylinder
    >>> parabolic_cylinder((2, 5), 500.0, width=4.0)[0].tolist()
    [0.0, 375.0, 500.0, 375.0, 0.0]
    """
    x, _ = _centered(shape)
    half = as_scalar("width", shape[1] - 1 if width is None else width, above=0) / 2
    return as_scalar("height", height, above=0) * np.maximum(1 - (x / half) ** 2, 0)


def paraboloid(shape: tuple[int, int], height: float) -> Array:
    """Return a paraboloid whose base passes through the corners of the image.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    height : float
        Height of the center above the corners, µm.

    Returns
    -------
    ndarray of float64, shape `shape`
        Heights, µm; zero in the corners.

    Raises
    ------
    ValueError
        If a side is below 2 px or `height` not positive.

    Examples
    --------
    >>> from microlib.synthetic import paraboloid
    >>> paraboloid((3, 3), 10.0).tolist()
    [[0.0, 5.0, 0.0], [5.0, 10.0, 5.0], [0.0, 5.0, 0.0]]
    """
    x, y = _centered(shape)
    square = x**2 + y**2
    return as_scalar("height", height, above=0) * (1 - square / square.max())


def sphere_on_plane(shape: tuple[int, int], radius: float, pixel_size: float) -> Array:
    """Return the visible height of a ball on a plane, such as a solder ball, from above.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    radius : float
        Radius of the ball, µm; its top is at twice the radius.
    pixel_size : float
        Distance between pixels on the object, µm.

    Returns
    -------
    ndarray of float64, shape `shape`
        Heights above the plane, µm. The lower half of the ball is hidden, so that the map jumps by
        `radius` at the ball's edge.

    Raises
    ------
    ValueError
        If a side is below 2 px or a length not positive.

    Examples
    --------
    >>> from microlib.synthetic import sphere_on_plane
    >>> sphere_on_plane((3, 5), radius=10.0, pixel_size=8.0)[1].round(1).tolist()
    [0.0, 16.0, 20.0, 16.0, 0.0]
    """
    x, y = _centered(shape)
    r = as_scalar("radius", radius, above=0)
    square = (x**2 + y**2) * as_scalar("pixel_size", pixel_size, above=0) ** 2
    return np.where(square <= r**2, r + np.sqrt(np.maximum(r**2 - square, 0)), 0.0)


def cone(shape: tuple[int, int], height: float, radius: float) -> Array:
    """Return a cone on a plane.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    height : float
        Height of the apex, µm.
    radius : float
        Radius of the base, px.

    Returns
    -------
    ndarray of float64, shape `shape`
        Heights, µm.

    Raises
    ------
    ValueError
        If a side is below 2 px or a length not positive.

    Examples
    --------
    >>> from microlib.synthetic import cone
    >>> cone((3, 5), 10.0, 2.0)[1].tolist()
    [0.0, 5.0, 10.0, 5.0, 0.0]
    """
    x, y = _centered(shape)
    base = as_scalar("radius", radius, above=0)
    return as_scalar("height", height, above=0) * np.maximum(1 - np.hypot(x, y) / base, 0)
