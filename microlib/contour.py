r"""From an outline y(x) to a dimple: the Gaussian sum of (5.1), its extrema, and (5.3).

Outlines are in pixels with x to the right and y *up*, so that the rim of a dimple is a maximum and
its bottom a minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, least_squares

from microlib._checks import as_array, positive, same_length, whole

__all__ = ["DimpleGeometry", "GaussianSum", "dimple_geometry", "fit_gaussians"]


@dataclass(frozen=True)
class GaussianSum:
    r"""
    A sum of Gaussians as in equation (5.1).

    .. math:: f_m(x) = \sum_i a_i \exp\left(-\left(\frac{x-b_i}{c_i}\right)^2\right)

    Calling it with x in px gives y in px.

    Parameters
    ----------
    amplitudes, centers, widths : array_like, shape (n,)
        :math:`a_i`, :math:`b_i` and :math:`c_i`, in px. The width is not a standard deviation: it
        is √2 of one.
    domain : tuple of float
        Range of x over which the sum describes the outline, in px.

    Raises
    ------
    ValueError
        If the three arrays differ in length, a width is not positive, or the domain is empty.

    Examples
    --------
    >>> curve = GaussianSum([10.0, 10.0], [0.0, 30.0], [12.0, 12.0], domain=(-5.0, 35.0))
    >>> print(f"{curve(15.0):.3f}")
    4.192
    >>> maxima, minima = curve.extrema()
    >>> minima.round(6).tolist()
    [15.0]
    """

    amplitudes: NDArray[np.float64]
    centers: NDArray[np.float64]
    widths: NDArray[np.float64]
    domain: tuple[float, float]

    def __post_init__(self) -> None:
        amplitudes = as_array("amplitudes", self.amplitudes, shape=(None,))
        centers = as_array("centers", self.centers, shape=(None,))
        widths = positive("widths", as_array("widths", self.widths, shape=(None,)))
        same_length(("amplitudes", "centers"), amplitudes, centers)
        same_length(("amplitudes", "widths"), amplitudes, widths)
        low, high = as_array("domain", self.domain, shape=(2,))
        if low >= high:
            raise ValueError(f"domain must run from a smaller to a larger x, got {self.domain}")
        object.__setattr__(self, "amplitudes", amplitudes)
        object.__setattr__(self, "centers", centers)
        object.__setattr__(self, "widths", widths)
        object.__setattr__(self, "domain", (float(low), float(high)))

    def __call__(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return y at `x`, both in px; any shape."""
        _, terms = self._terms(x)
        return terms.sum(axis=-1)

    def slope(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return dy/dx at `x`, without unit; any shape."""
        scaled, terms = self._terms(x)
        return np.sum(-2 * scaled / self.widths * terms, axis=-1)

    def extrema(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """
        Find where the slope vanishes inside the domain.

        Returns
        -------
        maxima, minima : ndarray
            Positions x, in px, ascending.

        Notes
        -----
        The analytic slope is bracketed on a grid 40 times finer than the narrowest term, which
        cannot hide two roots, and each root is then polished to 1e-10 px (Brent).
        """
        low, high = self.domain
        samples = int(np.ceil((high - low) / self.widths.min() * 40)) + 2
        grid = np.linspace(low, high, samples)
        slope = self.slope(grid)
        maxima: list[float] = []
        minima: list[float] = []
        for k in np.flatnonzero(slope[:-1] * slope[1:] < 0):
            root = brentq(self.slope, grid[k], grid[k + 1], xtol=1e-10)
            (maxima if slope[k] > 0 else minima).append(root)
        return np.array(maxima), np.array(minima)

    def _terms(self, x: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scaled = (as_array("x", x)[..., np.newaxis] - self.centers) / self.widths
        return scaled, self.amplitudes * np.exp(-(scaled**2))


def fit_gaussians(
    x: ArrayLike, y: ArrayLike, *, terms: int = 8, max_iterations: int = 1500
) -> GaussianSum:
    """
    Fit a sum of Gaussians to an outline by least squares, equation (5.1).

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Outline, in px, with y up.
    terms : int
        Number of Gaussians; the thesis uses eight.
    max_iterations : int
        Most evaluations of the sum that the solver may spend.

    Returns
    -------
    GaussianSum
        The best sum, with the range of `x` as its domain.

    Raises
    ------
    ValueError
        If x and y differ in length or hold NaN, there are fewer points than the 3 × `terms`
        parameters, or x has no extent.

    Notes
    -----
    The solver is scipy's trust-region reflective Newton method, as the thesis names it, with the
    analytic Jacobian. It starts from evenly spaced terms whose amplitudes are solved for linearly.
    The sum of eight Gaussians is a flexible curve, not a model: neighbouring terms trade off
    against each other, and only the curve and its extrema mean something.

    Examples
    --------
    >>> x = np.linspace(0, 100, 60)
    >>> truth = GaussianSum([40.0, 45.0], [25.0, 75.0], [22.0, 25.0], domain=(0, 100))
    >>> fit = fit_gaussians(x, truth(x), terms=2)
    >>> fit.centers.round(3).tolist()
    [25.0, 75.0]
    """
    x = as_array("x", x, shape=(None,))
    y = as_array("y", y, shape=(None,))
    same_length(("x", "y"), x, y)
    n = whole("terms", terms, least=1)
    if len(x) < 3 * n:
        raise ValueError(
            f"x must hold at least {3 * n} points for {n} terms of three parameters, got {len(x)}"
        )
    low, span = x.min(), np.ptp(x)
    if span == 0:
        raise ValueError(f"x must have an extent, got {len(x)} points at {low:g}")
    centers = low + span * (np.arange(n) + 0.5) / n
    widths = np.full(n, 1.2 * span / n)
    basis = np.exp(-(((x[:, np.newaxis] - centers) / widths) ** 2))
    amplitudes = np.linalg.lstsq(basis, y, rcond=None)[0]

    def residuals(parameters: NDArray) -> NDArray:
        a, b, c = parameters.reshape(3, n)
        return np.exp(-(((x[:, np.newaxis] - b) / c) ** 2)) @ a - y

    def jacobian(parameters: NDArray) -> NDArray:
        a, b, c = parameters.reshape(3, n)
        scaled = (x[:, np.newaxis] - b) / c
        bell = np.exp(-(scaled**2))
        by_center = a * bell * 2 * scaled / c
        return np.hstack([bell, by_center, by_center * scaled])

    lower = np.repeat([-np.inf, low - span, span / 100], n)
    upper = np.repeat([np.inf, low + 2 * span, 2 * span], n)
    solution = least_squares(
        residuals,
        np.concatenate([amplitudes, centers, widths]),
        jac=jacobian,
        bounds=(lower, upper),
        x_scale="jac",
        max_nfev=whole("max_iterations", max_iterations, least=1),
    )
    a, b, c = solution.x.reshape(3, n)
    order = np.argsort(b)
    return GaussianSum(a[order], b[order], c[order], domain=(float(low), float(low + span)))


@dataclass(frozen=True)
class DimpleGeometry:
    """
    Size of a dimple and the two points of the outline that define it.

    Attributes
    ----------
    dimple_radius, dimple_depth : float
        a and w_d of (5.3), in µm.
    rim, bottom : tuple of float
        The maximum left of the dimple and its lowest point, (x, y) in px with y up.
    """

    dimple_radius: float
    dimple_depth: float
    rim: tuple[float, float]
    bottom: tuple[float, float]


def dimple_geometry(curve: GaussianSum, *, pixel_size: float) -> DimpleGeometry:
    """
    Measure the dimple of an outline from its left rim and its bottom, equation (5.3).

    Parameters
    ----------
    curve : GaussianSum
        Outline, in px, with y up.
    pixel_size : float
        Size of a pixel in the object plane, cell size over magnification CS/M, in µm/px.

    Returns
    -------
    DimpleGeometry
        Radius and depth in µm, and the two points in px.

    Raises
    ------
    ValueError
        If the outline has no minimum with a maximum to its left, so that there is no dimple, or
        `pixel_size` is not positive.

    Notes
    -----
    The bottom is the lowest minimum that has a maximum on either side, and the rim the nearest
    maximum to its left. The text of the thesis speaks of two local maxima; the printed coefficients
    of Table 5.5 have three, and this rule picks the pair that the thesis used.

    Examples
    --------
    >>> curve = GaussianSum([10.0, 10.0], [0.0, 30.0], [12.0, 12.0], domain=(-5.0, 35.0))
    >>> dimple = dimple_geometry(curve, pixel_size=2.0)
    >>> print(f"a = {dimple.dimple_radius:.3f} µm, w_d = {dimple.dimple_depth:.3f} µm")
    a = 29.882 µm, w_d = 11.655 µm
    """
    size = float(positive("pixel_size", as_array("pixel_size", pixel_size, shape=())))
    maxima, minima = curve.extrema()
    between_maxima = [x for x in minima if (maxima < x).any() and (maxima > x).any()]
    if not between_maxima:
        raise ValueError(
            "curve must have a minimum between two maxima (a dimple), "
            f"got {len(maxima)} maxima and {len(minima)} minima"
        )
    bottom = min(between_maxima, key=curve)
    rim = maxima[maxima < bottom].max()
    return DimpleGeometry(
        dimple_radius=size * float(bottom - rim),
        dimple_depth=size * float(curve(rim) - curve(bottom)),
        rim=(float(rim), float(curve(rim))),
        bottom=(float(bottom), float(curve(bottom))),
    )
