"""Random textures with given mean and contrast."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from microlib._common import as_array, as_generator, as_image_shape, as_positive, as_scalar


def eight_bits(image: NDArray) -> NDArray[np.uint8]:
    """Return grey levels rounded and clipped to 8 bits."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def noise_source(rng: np.random.Generator | int | None, noise: float) -> np.random.Generator:
    """Return the random generator of a scene, which is required if there is noise."""
    if rng is None and noise > 0:
        raise ValueError("rng must be given if there is noise, got None")
    return as_generator("rng", 0 if rng is None else rng)


def mixed_texture(
    shape: tuple[int, int],
    rng: np.random.Generator | int,
    *,
    mean: float = 128.0,
    std: float = 38.0,
    scales: ArrayLike = (0.6, 1.2, 2.4, 4.8, 9.6),
) -> NDArray[np.float32]:
    """Return a random texture with detail at several scales, like paper or ground metal.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    rng : numpy.random.Generator or int
        Random generator, or its seed.
    mean, std : float
        Mean and standard deviation of the grey levels, exactly those of the result.
    scales : array_like
        Standard deviations of the Gaussians that smooth the noise, px; each has the same share of
        the variance.

    Returns
    -------
    ndarray of float32, shape `shape`
        Texture, not clipped: at the default values one pixel in 1200 lies outside 0 to 255.

    Raises
    ------
    ValueError
        If a side is below 2 px, a scale is not positive or `std` is negative.

    Examples
    --------
    >>> from microlib.synthetic import mixed_texture
    >>> texture = mixed_texture((64, 64), 0)
    >>> texture.shape, round(float(texture.mean())), round(float(texture.std()))
    ((64, 64), 128, 38)
    """
    rows, cols = as_image_shape("shape", shape, least=2)
    contrast = as_scalar("std", std, least=0)
    mean = as_scalar("mean", mean)
    sizes = as_array("scales", np.atleast_1d(as_positive("scales", scales)), shape=(None,))
    rng = as_generator("rng", rng)
    total = np.zeros((rows, cols))
    for scale in sizes:
        layer = gaussian_filter(rng.standard_normal((rows, cols)), scale, mode="wrap")
        total += layer / layer.std()
    total = mean + contrast * (total - total.mean()) / total.std()
    return total.astype(np.float32)
