"""Focal stacks of surfaces of known height."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_array, as_image, as_scalar
from microlib.optics import BlurLadder
from microlib.synthetic._textures import eight_bits, noise_source


def focal_stack(
    texture: ArrayLike,
    height: ArrayLike,
    positions: ArrayLike,
    *,
    blur_rate: float,
    noise: float = 0.0,
    rng: np.random.Generator | int | None = None,
) -> NDArray[np.uint8]:
    """Return a focal stack whose frames are blurred by their distance to the surface.

    Parameters
    ----------
    texture : array_like, shape (rows, cols)
        Grey levels of the surface in focus.
    height : array_like, shape (rows, cols)
        Height of the surface, µm.
    positions : array_like, shape (n,)
        Height in focus in each frame, µm.
    blur_rate : float
        Increase of the blur's standard deviation with the distance from focus, px/µm.
    noise : float
        Standard deviation of the camera's noise, grey levels.
    rng : numpy.random.Generator or int, optional
        Random generator of the noise, or its seed; required if there is noise.

    Returns
    -------
    ndarray of uint8, shape (n, rows, cols)
        Frames with the blur :math:`\\sigma^2 = \\sigma_0^2 + (b\\,|z - z_k|)^2`, where σ₀ is
        0.5 px, with noise, rounded and clipped to 8 bits.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite, a length or the noise negative, or there is
        noise but no `rng`.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.synthetic import focal_stack
    >>> texture = np.random.default_rng(0).uniform(0, 255, (32, 32))
    >>> stack = focal_stack(texture, np.zeros((32, 32)), [0.0, 10.0], blur_rate=0.2)
    >>> stack.shape, bool(stack[0].std() > stack[1].std())
    ((2, 32, 32), True)
    """
    image = as_image("texture", texture)
    z = as_array("height", height, shape=image.shape)
    focus = as_array("positions", positions, shape=(None,))
    rate = as_scalar("blur_rate", blur_rate, above=0)
    in_focus = 0.5  # px
    sigma = as_scalar("noise", noise, least=0)
    rng = noise_source(rng, sigma)
    furthest = max(focus.max() - z.min(), z.max() - focus.min())
    # The ladder must contain the largest blur in spite of rounding.
    largest = float(np.hypot(in_focus, rate * furthest)) * (1 + 1e-9)
    if largest > (width := max(image.shape)):
        raise ValueError(
            f"blur_rate must give less blur than the width of the texture, {width} px, "
            f"over the heights and positions given, got {largest:g} px"
        )
    ladder = BlurLadder(image, largest)
    frames = np.empty((focus.size, *image.shape), dtype=np.uint8)
    for k, position in enumerate(focus):
        frame: NDArray = ladder.at(np.hypot(in_focus, rate * (z - position)))
        if sigma > 0:
            frame = frame + sigma * rng.standard_normal(frame.shape)
        frames[k] = eight_bits(frame)
    return frames
