"""The focus measures of the default depth: second derivatives at two scales, and at an edge."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Image
from microlib.focus.common import blur, halved
from microlib.focus.multiscale._settings import FocusSettings


@dataclass(frozen=True)
class NoiseFloor:
    """Mean of each measure on noise alone, at half size.

    It is added to the measure. Then a measure that contains only noise is nearly constant over the
    frames, and the other factor of the product decides.

    Attributes
    ----------
    fine, coarse, edge : float
        Of the second derivatives of the frame, of those of the frame at half its size, and of the
        deviation from a local mean.
    """

    fine: float
    coarse: float
    edge: float

    @classmethod
    def of(cls, noise: float, settings: FocusSettings) -> NoiseFloor:
        """Return the floor for noise of a standard deviation in grey levels, white in the frame."""
        coarse = (
            0.5 * noise * noise_gain(settings.coarse_sigma)
        )  # half size: the mean of four pixels
        return cls(noise * noise_gain(settings.fine_sigma), coarse, 0.4 * noise)


@dataclass(frozen=True)
class Measures:
    """Focus measures of one frame, each of half its rows and columns.

    Attributes
    ----------
    product : ndarray
        Fine times coarse modified Laplacian: narrow where the fine one has its peak, and free of
        the noise that only one of both has.
    along, down : ndarray
        Fine second derivatives along rows and down columns.
    edge : ndarray
        Deviation from a local mean, which places a step more sharply.
    coarse_along, coarse_down : ndarray
        Coarse second derivatives along rows and down columns.
    """

    product: NDArray[np.float32]
    along: NDArray[np.float32]
    down: NDArray[np.float32]
    edge: NDArray[np.float32]
    coarse_along: NDArray[np.float32]
    coarse_down: NDArray[np.float32]


def measure(frame: Image, settings: FocusSettings, floor: NoiseFloor) -> Measures:
    """Return the focus measures of a frame at every second pixel."""
    half = halved(frame.astype(np.float32, copy=False))
    seconds = abs_second_derivatives(frame, settings.fine_sigma)
    along, down = (blur(halved(second), settings.fine_window_sigma) for second in seconds)
    coarse_along, coarse_down = abs_second_derivatives(half, settings.coarse_sigma)
    coarse = blur(coarse_along + coarse_down, settings.coarse_window_sigma)
    detail = cv2.absdiff(half, blur(half, settings.edge_sigma))
    edge_floor = np.float32(floor.edge)
    return Measures(
        product=(along + down + np.float32(floor.fine)) * (coarse + np.float32(floor.coarse)),
        along=along,
        down=down,
        edge=np.multiply(detail + edge_floor, blur(detail, 1.0) + edge_floor, dtype=np.float32),
        coarse_along=coarse_along,
        coarse_down=coarse_down,
    )


def abs_second_derivatives(image: NDArray, sigma: float) -> tuple[NDArray, NDArray]:
    """Return |second difference| along rows and down columns of an image smoothed by `sigma` px.

    Smoothing and difference are one separable filter; the Gaussian is cut off at 3 sigma.
    """
    smooth = cv2.getGaussianKernel(2 * round(3 * sigma) + 1, sigma, cv2.CV_32F).ravel()
    second = np.convolve(smooth, np.array([1, -2, 1], np.float32))
    along = cv2.sepFilter2D(image, cv2.CV_32F, second, smooth)
    down = cv2.sepFilter2D(image, cv2.CV_32F, smooth, second)
    return np.abs(along, out=along), np.abs(down, out=down)


def noise_gain(sigma: float) -> float:
    """Return the mean of the sum of both `abs_second_derivatives` on white noise of unit variance.

    The noise that the filters transmit, times √(2/π), the mean modulus of a normal variate.
    """
    smooth = cv2.getGaussianKernel(31, sigma).ravel()
    second = np.convolve(smooth, [-1.0, 2.0, -1.0])
    return float(2 * np.sqrt(2 / np.pi) * np.sqrt(np.sum(second**2) * np.sum(smooth**2)))
