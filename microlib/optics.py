"""The thin lens, and the blur in an image that is out of focus: equations 3.1 to 3.9.

Lengths are in µm unless a name says px. The Gaussian blur of an image is given in px; divide a
length on the sensor by the pixel pitch to get it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    as_array,
    as_image,
    as_integer,
    as_positive,
    as_scalar,
)
from microlib._common._opencv import cv2

__all__ = [
    "BlurLadder",
    "blur_radius",
    "defocus",
    "gaussian_kernel",
    "gaussian_transfer",
    "image_distance",
]

#: Ratio of the standard deviations of neighboring blur levels. With cubic interpolation between
#: them the error stays below 0.05 grey levels rms on white noise of 38 grey levels, the hardest
#: texture there is; with 1.25 it is 0.25.
_LEVEL_RATIO = 1.15
#: Smallest blurred level in px; below it an image hardly changes (a neighbor weighs exp(-1/(2 *
#: 0.2²)) < 4e-6). With 0.1 the error above is the same, with 0.3 it is ten times as large.
_FIRST_LEVEL = 0.2
#: Where a Gaussian is cut off, in standard deviations: it is exp(-5²/2) = 4e-6 of its peak there.
_CUT_OFF = 5.0


def image_distance(object_distance: ArrayLike, focal_length: float) -> Array:
    """Return where a thin lens forms the image of a point.

    Parameters
    ----------
    object_distance : array_like
        Distance :math:`d_o` from the point to the lens, µm, greater than the focal length.
    focal_length : float
        Focal length f, µm.

    Returns
    -------
    ndarray of float64
        Image distance :math:`d_i`, µm, from :math:`1/d_o + 1/d_i = 1/f` (3.1).

    Raises
    ------
    ValueError
        If a length is not positive, or the point lies within the focal length and has no real
        image.

    Notes
    -----
    A thin lens is symmetric: of the distance :math:`d_s` to the sensor this is the working distance
    :math:`w_d = 1/(1/f - 1/d_s)` of (3.5), at which a point is in focus.

    Examples
    --------
    >>> from microlib.optics import image_distance
    >>> float(image_distance(300.0, 100.0)), float(image_distance(150.0, 100.0))
    (150.0, 300.0)
    """
    return _conjugate("object_distance", object_distance, focal_length)


def _conjugate(name: str, distance: ArrayLike, focal_length: float) -> Array:
    """Return the distance on the lens' other side that is in focus with that of the given name."""
    given = as_positive(name, distance)
    f = as_scalar("focal_length", focal_length, above=0)
    if (given <= f).any():
        raise ValueError(f"{name} must exceed the focal length of {f:g}, got {given.min():g}")
    return np.asarray(given * f / (given - f))


def blur_radius(
    object_distance: ArrayLike,
    *,
    focal_length: float,
    sensor_distance: float,
    aperture_radius: float,
) -> Array:
    """Return the radius of the blur circle of points at given distances.

    Parameters
    ----------
    object_distance : array_like
        Distance :math:`d_o` from the points to the lens, µm.
    focal_length : float
        Focal length f, µm.
    sensor_distance : float
        Distance :math:`d_s` from the lens to the sensor, µm, greater than the focal length.
    aperture_radius : float
        Radius R of the lens' aperture, µm.

    Returns
    -------
    ndarray of float64
        :math:`r_b = R\\,d_s\\,(1/d_o - 1/w_d)` (3.5), µm on the sensor. Zero in focus, positive
        for a point nearer than the working distance :math:`w_d`, negative beyond it.

    Raises
    ------
    ValueError
        If a length is not positive or the sensor stands within the focal length.

    Notes
    -----
    The same as (3.2), :math:`R\\,\\lambda/d_i` with the sensor's displacement
    :math:`\\lambda = d_i - d_s` (3.3), and (3.4), but without a division by zero for a point in the
    focal plane. A blurred image is the same for both signs; only the magnitude enters a kernel.

    Examples
    --------
    >>> from microlib.optics import blur_radius
    >>> lens = {"focal_length": 100.0, "sensor_distance": 150.0, "aperture_radius": 20.0}
    >>> blur_radius([200.0, 300.0, 600.0], **lens)
    array([ 5.,  0., -5.])
    """
    distance = as_positive("object_distance", object_distance)
    radius = as_scalar("aperture_radius", aperture_radius, above=0)
    focused = float(_conjugate("sensor_distance", sensor_distance, focal_length))
    return np.asarray(radius * float(sensor_distance) * (1.0 / distance - 1.0 / focused))


def gaussian_kernel(sigma: float, size: int) -> Array:
    """Return the Gaussian point spread function of a defocused lens, sampled and of unit sum.

    Parameters
    ----------
    sigma : float
        Standard deviation :math:`\\sigma_g`, px.
    size : int
        Side of the square kernel, px, odd.

    Returns
    -------
    ndarray of float64, shape (size, size)
        :math:`g \\propto e^{-(x^2+y^2)/(2\\sigma_g^2)}`.

    Raises
    ------
    ValueError
        If `sigma` is not positive or `size` is not an odd whole number.

    Notes
    -----
    (3.7) divides the exponent by :math:`2\\sigma_g`, which has the wrong unit and is not the
    transform of (3.9); the square is what (3.9) and section 5.5.1 need. The samples are scaled to
    unit sum, so that a kernel cut off at `size` keeps the brightness.

    Examples
    --------
    >>> from microlib.optics import gaussian_kernel
    >>> gaussian_kernel(1.0, 3).round(4)
    array([[0.0751, 0.1238, 0.0751],
           [0.1238, 0.2042, 0.1238],
           [0.0751, 0.1238, 0.0751]])
    """
    s = as_scalar("sigma", sigma, above=0)
    n = as_integer("size", size, least=1, odd=True)
    t = np.arange(n) - n // 2
    with np.errstate(over="ignore"):  # of a kernel much narrower than a pixel
        profile = np.exp(-((t / s) ** 2) / 2)
    kernel = np.outer(profile, profile)
    return kernel / kernel.sum()


def gaussian_transfer(u: ArrayLike, v: ArrayLike, sigma: float) -> Array:
    """Return the transfer function of Gaussian defocus, the Fourier transform of its kernel.

    Parameters
    ----------
    u, v : array_like
        Angular frequencies along x and y, rad/px, of shapes that broadcast.
    sigma : float
        Standard deviation of the blur, px.

    Returns
    -------
    ndarray of float64
        :math:`G(u, v) = e^{-(u^2+v^2)\\sigma_g^2/2}` (3.9).

    Raises
    ------
    ValueError
        If a value is not finite or `sigma` is negative.

    Examples
    --------
    >>> from microlib.optics import gaussian_transfer
    >>> gaussian_transfer([0.0, 1.0], 0.0, 1.0).round(4)
    array([1.    , 0.6065])
    """
    s = as_scalar("sigma", sigma, least=0)
    return np.exp(-(as_array("u", u) ** 2 + as_array("v", v) ** 2) * s**2 / 2)


def _blurred(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Convolve with a Gaussian, cut off far out, mirrored at the border."""
    if sigma < 0.025:  # exp(−1/(2σ²)), beside the middle, is zero in double precision
        return image
    half = int(np.ceil(_CUT_OFF * sigma))
    t = np.arange(-half, half + 1)
    profile = np.exp(-(t**2) / (2 * sigma**2))
    profile /= profile.sum()
    return np.asarray(
        cv2.sepFilter2D(image, cv2.CV_32F, profile, profile, borderType=cv2.BORDER_REFLECT),
        np.float32,
    )


class BlurLadder:
    """Copies of an image with increasing blur, to interpolate an image with any map of blur.

    It is faster than `defocus` if one image is defocused many times, as in a focal stack.

    Parameters
    ----------
    image : array_like, shape (rows, cols)
        The focused image.
    largest : float
        Largest blur that will be asked for, px.

    Raises
    ------
    ValueError
        If the image is not finite, or `largest` is negative or above the image's longest side.

    Notes
    -----
    Between levels each pixel is interpolated by a cubic in :math:`\\sigma^2`, the variable in
    which Gaussian blur is a diffusion and nearly linear. The ladder costs 16 images for a blur of
    1 px and a further one for each factor of 1.15.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.optics import BlurLadder
    >>> ladder = BlurLadder(np.eye(8), largest=3.0)
    >>> ladder.at(np.full((8, 8), 1.0)).shape
    (8, 8)
    """

    def __init__(self, image: ArrayLike, largest: float) -> None:
        focused = as_image("image", image)
        self.largest = as_scalar("largest", largest, least=0, most=max(focused.shape))
        span = np.log(max(self.largest, _FIRST_LEVEL) / _FIRST_LEVEL) / np.log(_LEVEL_RATIO)
        levels = _FIRST_LEVEL * _LEVEL_RATIO ** np.arange(int(np.ceil(span)) + 3)
        self._levels = np.concatenate([[0.0], levels])
        self._images = np.stack([_blurred(focused, level) for level in self._levels])

    def at(self, sigma: ArrayLike) -> NDArray[np.float32]:
        """Return the image blurred by `sigma`, px, one number or one for every pixel."""
        shape = self._images.shape[1:]
        blur = as_array("sigma", sigma, least=0)
        if blur.shape not in ((), shape):
            raise ValueError(
                f"sigma must be one number or have the image's shape {shape}, got {blur.shape}"
            )
        if blur.max() > self.largest:
            raise ValueError(f"sigma must be at most {self.largest:g} px, got {blur.max():g}")
        blur = np.broadcast_to(blur, shape)
        above = np.searchsorted(self._levels, blur, side="right")
        first = np.clip(above - 2, 0, len(self._levels) - 4)
        t = blur**2
        nodes = self._levels[first[None] + np.arange(4)[:, None, None]] ** 2
        images = np.take_along_axis(self._images, first[None] + np.arange(4)[:, None, None], axis=0)
        result = np.zeros(shape)
        for i in range(4):
            weight = np.ones(shape)
            for j in range(4):
                if j != i:
                    weight *= (t - nodes[j]) / (nodes[i] - nodes[j])
            result += weight * images[i]
        return result.astype(np.float32)


def defocus(image: ArrayLike, sigma: ArrayLike) -> NDArray[np.float32]:
    """Blur an image as an out-of-focus lens does; the blur may differ from pixel to pixel.

    Parameters
    ----------
    image : array_like, shape (rows, cols)
        The focused image I.
    sigma : float or array_like, shape (rows, cols)
        Standard deviation :math:`\\sigma_g` of the blur at each pixel, px, zero or positive.

    Returns
    -------
    ndarray of float32, shape (rows, cols)
        :math:`I_d(p) = \\sum_q g_{\\sigma(p)}(p - q)\\,I(q)`, which is (3.6) where `sigma` is
        constant, and a product of spectra (3.8). The image is mirrored at its border.

    Raises
    ------
    ValueError
        If the image or `sigma` is not finite, `sigma` is negative or above the longest side of the
        image, which leaves no more than its mean, or the shapes differ.

    Notes
    -----
    Each pixel sees the kernel of its own blur (a gather), so a step in height does not occlude
    what lies behind it. A map of blur is applied by cubic interpolation in
    :math:`\\sigma^2` between images with constant blurs, each 1.15 times the previous one.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.optics import defocus
    >>> image = np.zeros((9, 9)); image[4, 4] = 1.0
    >>> sigma = np.full((9, 9), 1.0); sigma[:, 5:] = 2.0
    >>> blurred = defocus(image, sigma)
    >>> [round(float(blurred[4, x]), 3) for x in (3, 5)]
    [0.097, 0.035]
    """
    focused = as_image("image", image)
    blur = as_array("sigma", sigma, least=0, most=max(focused.shape))
    if blur.ndim == 0:
        return _blurred(focused, float(blur)).copy()
    return BlurLadder(image, float(blur.max())).at(blur)
