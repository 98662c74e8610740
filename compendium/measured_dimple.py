"""A dimple for the guide to a modulus: from an outline, the thesis' way, or from two lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib.embryo import dimple_geometry, fit_gaussians, loess
from microlib.membrane import dimple_profile, disc_modulus

#: Spans of LOESS whose results are compared. The middle one is that of section 5.6; a smaller one
#: follows the corners at the bottom more closely and the noise as well.
SPANS = (0.15, 0.25, 0.35)

#: Points that eight Gaussians of three numbers each need.
LEAST = 24
#: Radii to either side of the bottom that eight Gaussians describe well.
REACH = 2.0

Points = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredDimple:
    """
    Radius and depth of a dimple with their standard deviations, and what to draw of it.

    Attributes
    ----------
    radius, depth : float
        a and w_d, in µm.
    radius_std, depth_std : float
        Their standard deviations, in µm.
    points : ndarray, shape (n, 2)
        The outline, (x, y) in µm, y up; empty if there is none.
    curve : ndarray, shape (m, 2)
        The curve that radius and depth were read off, or that they make.
    rim, bottom : tuple of float
        The two points between which they lie, (x, y) in µm.
    """

    radius: float
    depth: float
    radius_std: float
    depth_std: float
    points: Points
    curve: Points
    rim: tuple[float, float]
    bottom: tuple[float, float]


def dimple_of_outline(x: ArrayLike, y: ArrayLike, *, pixel_size: float) -> MeasuredDimple:
    """
    Measure a dimple as section 5.6 does, and how much the smoothing decides of it.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Outline, in px, y up.
    pixel_size : float
        Size of a pixel in the object plane, in µm/px.

    Returns
    -------
    MeasuredDimple
        Radius and depth with the span of section 5.6.

    Raises
    ------
    ValueError
        If the outline is too short or holds no dimple, or `pixel_size` is not positive.

    Notes
    -----
    The outline counts to `REACH` radii from the bottom. LOESS of the second degree, eight Gaussians
    (5.1) and their extrema (5.3). The covariance of the Gaussians knows nothing of the smoothing,
    which fills the corners at the bottom; how much shows in the results with other spans. The
    standard deviations are those of the results over `SPANS` and of the fit together.

    Examples
    --------
    >>> x = np.arange(121.0)
    >>> y = 40 * np.exp(-(((x - 30) / 20) ** 2)) + 40 * np.exp(-(((x - 90) / 20) ** 2))
    >>> dimple = dimple_of_outline(x, y, pixel_size=2.0)
    >>> print(f"a = {dimple.radius:.0f} µm, w_d = {dimple.depth:.0f} µm")
    a = 60 µm, w_d = 63 µm
    """
    across, height = _side(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    if across.size < LEAST:
        raise ValueError(
            f"outline must hold at least {LEAST} points around its dimple, got {across.size}"
        )
    curves = [fit_gaussians(across, loess(across, height, span=span)) for span in SPANS]
    found = [dimple_geometry(curve, pixel_size=pixel_size) for curve in curves]
    spread = np.std([(g.dimple_radius, g.dimple_depth) for g in found], axis=0, ddof=1)
    curve, middle = curves[1], found[1]
    stds = np.sqrt(spread**2 + np.diag(middle.covariance)).tolist()
    fine = np.linspace(*curve.domain, 600)
    drawn = (np.stack([across, height], axis=1), np.stack([fine, curve(fine)], axis=1))
    lengths = (middle.dimple_radius, middle.dimple_depth, *stds)
    ends = ((pixel_size * x, pixel_size * y) for x, y in (middle.rim, middle.bottom))
    return MeasuredDimple(*lengths, *(pixel_size * p for p in drawn), *ends)


def dimple_of_numbers(
    radius: float | None,
    depth: float | None,
    *,
    radius_std: float,
    depth_std: float,
    probe_half_width: float,
) -> MeasuredDimple:
    """
    Take radius and depth as they are given; the curve is the membrane's, (4.2).

    Parameters
    ----------
    radius, depth : float
        a and w_d, in µm.
    radius_std, depth_std : float
        Their standard deviations, in µm.
    probe_half_width : float
        Half-width c of the probe, in µm.

    Returns
    -------
    MeasuredDimple

    Raises
    ------
    ValueError
        If one of the lengths is missing or no dimple can have them.

    Examples
    --------
    >>> dimple = dimple_of_numbers(
    ...     246.95, 121.22, radius_std=2.0, depth_std=1.0, probe_half_width=25.0
    ... )
    >>> dimple.rim, dimple.bottom
    ((-246.95, 0.0), (0.0, -121.22))
    """
    if radius is None or depth is None:
        raise ValueError(
            f"dimple_radius and dimple_depth must be given together, got {radius} and {depth}"
        )
    r = np.linspace(-radius, radius, 401)
    under = np.maximum(np.abs(r), probe_half_width)  # the probe holds the membrane flat
    y = -dimple_profile(under, radius, depth, probe_half_width=probe_half_width)
    lengths = (float(radius), float(depth), float(radius_std), float(depth_std))
    curve, ends = np.stack([r, y], axis=1), ((-lengths[0], 0.0), (0.0, -lengths[1]))
    return MeasuredDimple(*lengths, np.empty((0, 2)), curve, *ends)


def disc_moduli(
    force: float, dimple: MeasuredDimple, poisson_ratio: float, **sizes: float
) -> dict[str, float]:
    """
    Return the modulus that a flat disc in equilibrium has with a dimple, by its law.

    Parameters
    ----------
    force : float
        In µN.
    dimple : MeasuredDimple
        Its radius and depth.
    poisson_ratio : float
        Of Hooke's law; rubber is incompressible.
    **sizes : float
        ``thickness`` and ``probe_half_width``, in µm.

    Returns
    -------
    dict of str to float
        Moduli in MPa, NaN where no such disc has this dimple.
    """
    found = {}
    for law, ratio in (("neo-hooke", 0.5), ("hooke", poisson_ratio)):
        try:
            settings = sizes | {"poisson_ratio": ratio}
            found[law] = disc_modulus(force, dimple.radius, dimple.depth, law=law, **settings)
        except ValueError:
            found[law] = float("nan")
    return found


def _side(x: Points, y: Points) -> tuple[Points, Points]:
    """Return the outline around its dimple, x ascending, heights above its lowest point."""
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    if y.size:
        # How deep a point lies below the lower of the highest points on its two sides.
        left, right = np.maximum.accumulate(y), np.maximum.accumulate(y[::-1])[::-1]
        bottom = int(np.argmax(np.minimum(left, right) - y))
        reach = REACH * (x[bottom] - x[np.argmax(y[: bottom + 1])])
        near = np.abs(x - x[bottom]) <= reach
        if reach > 0:  # else there is no dimple, which the fit will say
            x, y = x[near], y[near]
        # Gaussians die away to zero.
        y = y - y.min()
    return x, y
