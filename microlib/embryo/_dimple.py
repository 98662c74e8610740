"""Radius and depth of the dimple of an outline, from extrema or from a fit of the profile (4.2).

`dimple_geometry` measures the extrema of a smooth curve, as the thesis does (5.3). The profile
(4.2) has a corner at the edge of the probe, which the probe hides and which every smooth curve
rounds. `fit_dimple` fits (4.2) itself to the visible flanks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import OptimizeResult, least_squares

from microlib._common import (
    Array,
    FlatResult,
    as_choice,
    as_instance,
    as_scalar,
    inverse_normal,
    robust_std,
)
from microlib.embryo._boundary import Boundary
from microlib.embryo._gaussian_sum import GaussianSum
from microlib.membrane import dimple_profile

#: Radii up to which the outline is fitted. The outline beyond the rim determines the rim, but it is
#: an arc of a circle only nearby: 1.15 changes E by up to 0.8 of its standard deviation, 1.6 by up
#: to 3.7.
_BEYOND_RIM = 1.3
#: Largest root mean square distance from the profile, as a fraction of the depth. E is proportional
#: to depth⁻³, so that an error of a sixth of the depth is a factor of √e. A limit of 0.03 rejects
#: one of nine embryos, and limits up to 0.3 change nothing.
_MAX_RMS = 1 / 6
#: Distance from the first fit, as a fraction of the depth, beyond which a point gains no
#: influence. With 10 % outliers of 20 px, one of eight outlines is lost at 1/12 and none at 1/20;
#: 1/50 changes the radius of an outline of another shape by up to 0.8 %.
_INFLUENCE = 1 / 20


@dataclass(frozen=True, eq=False, repr=False)
class DimpleGeometry(FlatResult):
    """Size of a dimple and the two points of the outline that define it.

    Attributes
    ----------
    rim_radius, dimple_depth : float
        a and w_d of (5.3), in µm.
    covariance : ndarray, shape (2, 2)
        Covariance of (a, w_d), in µm²; NaN from `dimple_geometry`, which has no points of the
        outline.
    rim, bottom : tuple of float
        Maximum on the measured side, and minimum, (x, y) in px with y up.
    """

    _parts = (("covariance", ("radius", "depth"), ("radius", "depth")),)

    rim_radius: float
    dimple_depth: float
    covariance: Array
    rim: tuple[float, float]
    bottom: tuple[float, float]


def dimple_geometry(curve: GaussianSum, *, pixel_size: float, rim: str = "left") -> DimpleGeometry:
    """Measure the dimple of an outline from one rim and its bottom, equation (5.3).

    Parameters
    ----------
    curve : GaussianSum
        Outline, in px, with y up.
    pixel_size : float
        Size of a pixel in the object plane, pixel pitch over magnification CS/M, in µm/px.
    rim : {"left", "right"}
        Side of the dimple that is measured. The thesis measures the left side. An asymmetric
        outline has another radius, depth and modulus on its right side.

    Returns
    -------
    DimpleGeometry
        Radius and depth in µm, and the two points in px.

    Raises
    ------
    ValueError
        If the outline has no minimum between two maxima, `pixel_size` is not positive, or `rim` is
        not one of the sides.

    See Also
    --------
    dimple_from_outline : Smooths an outline, and returns the uncertainty of its dimple.
    fit_dimple : Fits (4.2), without the bias of a smooth curve at the bottom of a dimple.

    Notes
    -----
    The bottom is the lowest minimum with maxima on both sides. The rim is the nearest maximum on
    the measured side in the upper half of the dimple, because a sum of Gaussians may have ripples
    at the bottom. The thesis mentions two maxima, and the coefficients of Table 5.5 have three.
    This rule selects the two extrema that the thesis used.

    Examples
    --------
    >>> from microlib.embryo import GaussianSum, dimple_geometry
    >>> curve = GaussianSum([10.0, 10.0], [0.0, 30.0], [12.0, 12.0], domain=(-5.0, 35.0))
    >>> dimple = dimple_geometry(curve, pixel_size=2.0)
    >>> print(f"a = {dimple.rim_radius:.3f} µm, w_d = {dimple.dimple_depth:.3f} µm")
    a = 29.882 µm, w_d = 11.655 µm
    """
    size = as_scalar("pixel_size", pixel_size, above=0)
    sign = {"left": -1, "right": 1}[as_choice("rim", rim, ("left", "right"))]
    maxima, minima = as_instance("curve", curve, GaussianSum).extrema()
    between_maxima = [x for x in minima if (maxima < x).any() and (maxima > x).any()]
    if not between_maxima:
        raise ValueError(
            "curve must have a minimum between two maxima (a dimple, y up), "
            f"got {len(maxima)} maxima and {len(minima)} minima"
        )
    bottom = min(between_maxima, key=curve)
    beside = maxima[sign * maxima > sign * bottom]
    half_height = (curve(beside).max() + curve(bottom)) / 2
    crest = min(beside[curve(beside) > half_height], key=lambda x: abs(x - bottom))
    return DimpleGeometry(
        rim_radius=size * float(abs(crest - bottom)),
        dimple_depth=size * float(curve(crest) - curve(bottom)),
        covariance=np.full((2, 2), np.nan),
        rim=(float(crest), float(curve(crest))),
        bottom=(float(bottom), float(curve(bottom))),
    )


@dataclass(frozen=True, eq=False, repr=False)
class DimpleFit(FlatResult):
    """Dimple with the profile (4.2) fitted to an outline, from `fit_dimple`.

    Attributes
    ----------
    rim_radius, dimple_depth : float
        a and w_d, in µm.
    covariance : ndarray, shape (2, 2)
        Covariance of (a, w_d), in µm².
    center : tuple of float
        Point of the axis at the height of the rim, (x, y) in px, y up.
    tilt : float
        Angle of the axis counterclockwise from the vertical, in radians.
    rim_curvatures : tuple of float
        Curvature of the outline just outside the rim, left and right, in 1/µm.
    rms_px : float
        Root mean square distance of the outline from the fit, in px, of the points that were kept.
        If it is well above the uncertainty of the points, the outline has not the profile (4.2).
    pixel_size, probe_half_width : float
        As given, in µm.
    """

    _parts = (("covariance", ("radius", "depth"), ("radius", "depth")),)

    rim_radius: float
    dimple_depth: float
    covariance: Array
    center: tuple[float, float]
    tilt: float
    rim_curvatures: tuple[float, float]
    rms_px: float
    pixel_size: float
    probe_half_width: float

    @property
    def curve(self) -> Array:
        """Fitted outline to just beyond the rims, rows x and y in px, y up; shape (2, 401)."""
        left, right = (curvature * self.pixel_size for curvature in self.rim_curvatures)
        radius, depth = self.rim_radius / self.pixel_size, self.dimple_depth / self.pixel_size
        dimple = _Dimple(*self.center, self.tilt, radius, depth, left, right)
        u = np.linspace(-_BEYOND_RIM, _BEYOND_RIM, 401) * radius
        v, _ = _profile(u, dimple, self.probe_half_width / self.pixel_size)
        cos, sin = np.cos(self.tilt), np.sin(self.tilt)
        return np.array(self.center)[:, np.newaxis] + [cos * u - sin * v, sin * u + cos * v]


def fit_dimple(boundary: Boundary, *, pixel_size: float, probe_half_width: float) -> DimpleFit:
    r"""Fit the membrane's profile (4.2) to an outline.

    Parameters
    ----------
    boundary : Boundary
        Outline from `microlib.embryo.extract_boundary`.
    pixel_size : float
        Size of a pixel in the object plane, in µm.
    probe_half_width : float
        Half-width c of the probe, in µm.

    Returns
    -------
    DimpleFit
        Radius and depth with their covariance, and the position of the dimple.

    Raises
    ------
    ValueError
        If an argument is not positive, `probe_half_width` disagrees with the image, the end of the
        probe is more than a third of the depth from the fitted bottom, the end of the probe is more
        than c off the fitted axis, or the root mean square distance of the outline from the model
        is more than a sixth of the depth.

    Notes
    -----
    The model is the profile (4.2) between probe and rim, and an arc of a circle beyond the
    rim on each side. Position, tilt, radius, depth and two curvatures are fitted by weighted least
    squares of the distances normal to the outline. Outliers beyond four standard deviations are
    removed once, if they are at most a quarter of the points. Points under the probe are not used:
    the depth is that of the flanks, extrapolated to r = c.

    The covariance is scaled to the residuals and to their correlation along the outline, so that an
    outline of another shape has a larger covariance. The part of the distance between the end of
    the probe and the fitted bottom that an uncertainty of 1 px does not explain is added in
    quadrature to the standard deviation of the depth. The covariance does not cover the error of
    (4.2) for a membrane of another kind.

    Examples
    --------
    >>> from microlib.embryo import extract_boundary, fit_dimple
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo.pressed(150.0, modulus=1.0)
    >>> scene = embryo_image(embryo, rng=3, shape=(480, 640))
    >>> outline = extract_boundary(scene.image)
    >>> dimple = fit_dimple(outline, pixel_size=scene.pixel_size, probe_half_width=25.0)
    >>> print(f"{dimple.dimple_depth:.0f} µm, truth {scene.embryo.dimple_depth:.0f} µm")
    121 µm, truth 121 µm
    """
    size = as_scalar("pixel_size", pixel_size, above=0)
    c = as_scalar("probe_half_width", probe_half_width, above=0) / size
    _check_probe_width(as_instance("boundary", boundary, Boundary), c, size)
    outline = np.stack([boundary.x, boundary.y, boundary.uncertainty])[:, ~boundary.under_probe]
    start = _initial_dimple(outline[0], outline[1], boundary)
    outline = outline[:, np.abs(outline[0] - boundary.probe.tip[0]) > c]
    # The first fit is robust, so that outliers do not spoil it before they are removed.
    limit = _INFLUENCE * max(start.depth, 1.0)
    first, _ = _fit(_near(outline, start), start, c, limit)
    near = _near(outline, first)
    distance = np.abs(_normal_distance(first, near[0], near[1], c) / near[2])
    # One of 16 000 normal errors is beyond four standard deviations; 3 to 6 change E by up to 0.4
    # of its standard deviation. A point within its own standard deviation is no outlier.
    inlier = distance < max(4 * robust_std(distance), 1.0)
    # More than a quarter of the points are not outliers but an outline of another shape.
    kept = near[:, inlier] if inlier.mean() >= 3 / 4 else near
    final, result = _fit(kept, first, c)
    rms = float(np.sqrt(np.mean(_normal_distance(final, kept[0], kept[1], c) ** 2)))
    if rms > _MAX_RMS * final.depth:
        raise ValueError(
            "boundary must follow the membrane's profile (4.2) to within a sixth of the dimple's "
            f"depth, got {rms:.2f} px of {final.depth:.1f} px"
        )
    beyond = _check_probe_end(boundary, final, c)
    covariance = inverse_normal(result.jac) * residual_variance(result.fun, len(result.x))
    sizes = [_Dimple._fields.index(name) for name in ("radius", "depth")]
    covariance = covariance[np.ix_(sizes, sizes)] * size**2
    covariance[1, 1] += (beyond * size) ** 2
    return DimpleFit(
        rim_radius=final.radius * size,
        dimple_depth=final.depth * size,
        covariance=covariance,
        center=(final.x, final.y),
        tilt=final.tilt,
        rim_curvatures=(final.left_curvature / size, final.right_curvature / size),
        rms_px=rms,
        pixel_size=size,
        probe_half_width=c * size,
    )


def _check_probe_end(boundary: Boundary, dimple: _Dimple, c: float) -> float:
    """Return by how much more than 1 px the probe's end is above or below the bottom, in px.

    Raise for an end that is too far from the bottom.
    """
    height = boundary.image_height - 1
    off_axis = abs(float(boundary.probe.axis(height - dimple.y)) - dimple.x)
    off_bottom = abs(dimple.y - dimple.depth - (height - boundary.probe.tip[1]))
    # The end of the probe is known to 1 px. A third of the depth would change the modulus by a
    # factor of e.
    beyond = float(np.sqrt(max(off_bottom**2 - 1, 0.0)))
    if off_axis > c or beyond > dimple.depth / 3:
        raise ValueError(
            "boundary must have the probe's end at the bottom of the dimple, for this "
            f"probe_half_width, got it {off_axis:.1f} px beside the axis and {off_bottom:.1f} px "
            "off in height"
        )
    return beyond


def _check_probe_width(boundary: Boundary, half_width: float, pixel_size: float) -> None:
    """Raise for a half-width (px) that differs from that of the probe in the image."""
    measured = boundary.probe.half_width
    factor = max(half_width / measured, measured / half_width)
    # The difference may be the walls of glass, or the taper of a needle's end.
    if abs(half_width - measured) > 2 and factor > 3 / 2:
        raise ValueError(
            "probe_half_width must be that of the probe in the image, got "
            f"{half_width * pixel_size:g} µm where {measured * pixel_size:.3g} µm are seen with "
            "this pixel_size"
        )


class _Dimple(NamedTuple):
    """Parameters of a dimple with its profile (4.2), in px and radians."""

    x: float  # of the axis at the height of the rim
    y: float  # height of the rim
    tilt: float
    radius: float
    depth: float
    left_curvature: float  # of the outline beyond the rim
    right_curvature: float


def _initial_dimple(x: NDArray, y: NDArray, boundary: Boundary) -> _Dimple:
    """Return a dimple from the highest points of the outline on both sides."""
    axis = boundary.probe.tip[0]
    left = x < axis
    # A running median keeps an outlier from being the rim.
    smooth = median_filter(y, 9, mode="nearest")
    rims = [(x[side][smooth[side].argmax()], smooth[side].max()) for side in (left, ~left)]
    (x0, height), (width, rise) = np.mean(rims, axis=0), np.diff(rims, axis=0)[0]
    bottom = boundary.image_height - 1 - boundary.probe.tip[1]
    curvature = 1 / (2 * width)
    return _Dimple(x0, height, rise / width, width / 2, height - bottom, curvature, curvature)


def _near(outline: Array, dimple: _Dimple) -> Array:
    """Return the rows x, y, uncertainty of an outline out to just beyond the rim."""
    return outline[:, np.abs(outline[0] - dimple.x) < _BEYOND_RIM * dimple.radius]


def _fit(
    outline: Array, start: _Dimple, c: float, limit: float | None = None
) -> tuple[_Dimple, OptimizeResult]:
    """Fit a dimple to the rows x, y, uncertainty of an outline by least squares.

    The influence of a point does not grow any more beyond the distance `limit`, px.
    """
    x, y, uncertainty = outline
    robust: dict[str, Any] = {}
    if limit is not None:
        robust = {"loss": "soft_l1", "f_scale": limit / float(np.median(uncertainty))}
    # The tilt, in radians, is limited to four times that of a probe; 0.1 to 0.6 change nothing.
    far, tilt, sharpest = np.inf, 1 / 4, 1 / start.radius
    lower = [-far, -far, -tilt, c + 1, 0.0, 0.0, 0.0]
    bounds = lower, [far, far, tilt, far, far, sharpest, sharpest]
    result = least_squares(
        lambda p: _normal_distance(_Dimple(*p), x, y, c) / uncertainty,
        np.clip(start, *bounds),
        bounds=bounds,
        x_scale="jac",
        **robust,
    )
    return _Dimple(*result.x.tolist()), result


def _profile(u: NDArray, dimple: _Dimple, c: float) -> tuple[Array, Array]:
    """Return height above the rim and slope of an upright dimple at `u` right of its axis."""
    a, distance = dimple.radius, np.abs(u)
    r = np.clip(distance, c, a)
    zeta2 = (c / a) ** 2
    scale = dimple.depth / (zeta2 - 1 - np.log(zeta2))
    beyond = np.maximum(distance - a, 0.0)
    curvature = np.where(u < 0, dimple.left_curvature, dimple.right_curvature)
    # An arc of a circle, whose root stays real for a curvature that is too large.
    root = np.sqrt(np.maximum(1 - (curvature * beyond) ** 2, 1 / 4**2))
    arc = -curvature * beyond**2 / (1 + root)
    height = -dimple_profile(r, a, dimple.depth, probe_half_width=c) + arc
    slope = 2 * scale * (1 / r - r / a**2) * (distance > c) - curvature * beyond / root
    return height, np.sign(u) * slope


def _normal_distance(dimple: _Dimple, x: NDArray, y: NDArray, c: float) -> Array:
    """Return the distance of points across the outline, to first order, in px."""
    cos, sin = np.cos(dimple.tilt), np.sin(dimple.tilt)
    u = cos * (x - dimple.x) + sin * (y - dimple.y)
    v = -sin * (x - dimple.x) + cos * (y - dimple.y)
    height, slope = _profile(u, dimple, c)
    return (v - height) / np.hypot(1.0, slope)


def residual_variance(residuals: Array, parameters: int) -> float:
    """Return the variance of residuals times their correlation length, in points."""
    count = residuals.size
    products = np.correlate(residuals, residuals, "full")[count - 1 :]
    # The fit reduces the correlation of residuals by about parameters/count.
    correlation = products[1 : count // 4] / products[0] + parameters / count
    # Correlations below the noise of independent points, and all after them, count as zero.
    last = np.append(correlation < 2 / np.sqrt(count), True).argmax()
    return float(products[0] / (count - parameters) * (1 + 2 * correlation[:last].sum()))
