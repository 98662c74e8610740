"""From an outline to the radius and depth of its dimple: by extrema, and by the model's profile.

The thesis reads the dimple off the extrema of a smooth curve, (5.3): `dimple_geometry`. The bottom
of a dimple is no smooth minimum, though. The profile (4.2) falls like a logarithm until the probe
cuts it off, just where the probe hides it, and every smooth curve rounds that corner. `fit_dimple`
fits (4.2) itself, to the flanks, which are seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.optimize import OptimizeResult, least_squares

from microlib._common import Array, Tidy, as_array, inverse_normal, of_kind, one_of, scalar
from microlib.embryo._boundary import Boundary
from microlib.embryo._gaussian_sum import GaussianSum
from microlib.embryo._probe import MAD_TO_STD
from microlib.membrane import dimple_profile

#: Radii up to which the outline enters the fit. What lies beyond the rim fixes it, as an arc of a
#: circle, which it is only nearby: 1.15 changes E by up to 0.8 of its deviation, 1.6 by up to 3.7.
_BEYOND_RIM = 1.3
#: An outline that departs from the profile by more than this share of the depth (root mean square)
#: has no dimple of that depth: E goes with its third power, so that one error of a sixth makes a
#: factor of √e. Of nine embryos one is refused at 0.03, and up to 0.3 none changes.
_LARGEST_MISFIT = 1 / 6


@dataclass(frozen=True, eq=False, repr=False)
class DimpleGeometry(Tidy):
    """Size of a dimple and the two points of the outline that define it.

    Attributes
    ----------
    dimple_radius, dimple_depth : float
        a and w_d of (5.3), in µm.
    covariance : ndarray, shape (2, 2)
        Of (a, w_d), in µm²; NaN where that of the curve is not known.
    rim, bottom : tuple of float
        The maximum on the side that was measured and the lowest point, (x, y) in px with y up.
    """

    _parts = (("covariance", ("radius", "depth"), ("radius", "depth")),)

    dimple_radius: float
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
        Size of a pixel in the object plane, cell size over magnification CS/M, in µm/px.
    rim : {"left", "right"}
        The side of the dimple that is measured. The thesis has the left one. An outline whose rims
        differ has another radius, depth and modulus on its right: measure both.

    Returns
    -------
    DimpleGeometry
        Radius and depth in µm, and the two points in px.

    Raises
    ------
    ValueError
        If the outline has no minimum between two maxima, so that there is no dimple, `pixel_size`
        is not positive, or `rim` is neither side.

    See Also
    --------
    fit_dimple : Without the bias of a smooth curve at the bottom of a dimple.

    Notes
    -----
    The bottom is the lowest minimum that has a maximum on either side, and the rim the nearest
    maximum on the measured side in the upper half of the dimple: a sum of Gaussians may ripple at
    the bottom. The text of the thesis speaks of two local maxima; the coefficients of Table 5.5
    have three, and this rule picks the pair that the thesis used.

    The covariance is that of the curve's coefficients, to first order: an extremum moves by
    −(∂f'/∂p)/f'' for a change of a coefficient p, its height by ∂f/∂p.

    Examples
    --------
    >>> from microlib.embryo import GaussianSum, dimple_geometry
    >>> curve = GaussianSum([10.0, 10.0], [0.0, 30.0], [12.0, 12.0], domain=(-5.0, 35.0))
    >>> dimple = dimple_geometry(curve, pixel_size=2.0)
    >>> print(f"a = {dimple.dimple_radius:.3f} µm, w_d = {dimple.dimple_depth:.3f} µm")
    a = 29.882 µm, w_d = 11.655 µm
    """
    of_kind("curve", curve, GaussianSum)
    size = scalar("pixel_size", pixel_size, above=0)
    way = {"left": -1, "right": 1}[one_of("rim", rim, ("left", "right"))]
    maxima, minima = curve.extrema()
    between_maxima = [x for x in minima if (maxima < x).any() and (maxima > x).any()]
    if not between_maxima:
        raise ValueError(
            "curve must have a minimum between two maxima (a dimple, y up), "
            f"got {len(maxima)} maxima and {len(minima)} minima"
        )
    bottom = min(between_maxima, key=curve)
    beside = maxima[way * maxima > way * bottom]
    half_way = (curve(beside).max() + curve(bottom)) / 2
    crest = min(beside[curve(beside) > half_way], key=lambda x: abs(x - bottom))
    covariance = np.full((2, 2), np.nan)
    if curve.covariance is not None:
        step = np.cbrt(np.finfo(float).eps) * curve.widths.min()
        moved = [
            (curve.gradient(x - step) - curve.gradient(x + step))
            / (2 * step * curve.second_derivative(x))
            for x in (bottom, crest)
        ]
        change = size * np.stack(
            [way * (moved[1] - moved[0]), curve.gradient(crest) - curve.gradient(bottom)]
        )
        covariance = change @ curve.covariance @ change.T
    return DimpleGeometry(
        dimple_radius=size * float(abs(crest - bottom)),
        dimple_depth=size * float(curve(crest) - curve(bottom)),
        covariance=covariance,
        rim=(float(crest), float(curve(crest))),
        bottom=(float(bottom), float(curve(bottom))),
    )


@dataclass(frozen=True, eq=False, repr=False)
class DimpleFit(Tidy):
    """A dimple of the form (4.2) fitted to an outline; calling it with x in px gives y in px.

    Attributes
    ----------
    dimple_radius, dimple_depth : float
        a and w_d, in µm.
    covariance : ndarray, shape (2, 2)
        Of (a, w_d), in µm².
    center : tuple of float
        Where the dimple's axis crosses the height of the rim, (x, y) in px, y up.
    tilt : float
        Angle by which the dimple is turned counterclockwise, in radians.
    rim_curvatures : tuple of float
        Curvature of the outline just outside the rim, left and right, in 1/µm.
    misfit : float
        Root mean square distance of the outline from the fit, in px. Beside the deviation of the
        outline's points it tells whether (4.2) draws this outline.
    pixel_size, probe_half_width : float
        As given, in µm.
    """

    _parts = (("covariance", ("radius", "depth"), ("radius", "depth")),)

    dimple_radius: float
    dimple_depth: float
    covariance: Array
    center: tuple[float, float]
    tilt: float
    rim_curvatures: tuple[float, float]
    misfit: float
    pixel_size: float
    probe_half_width: float

    def __call__(self, x: ArrayLike) -> Array:
        """Return the height y of the fitted outline at `x`, both in px.

        NaN further from the axis than ten of the dimple's radii, where there is no embryo.
        """
        along = as_array("x", x) - self.center[0]
        near = np.abs(along) < 10 * self.dimple_radius / self.pixel_size
        along = np.where(near, along, 0.0)
        lengths = np.array([self.dimple_radius, self.dimple_depth, self.probe_half_width])
        curvatures = np.array(self.rim_curvatures) * self.pixel_size
        upright = (*(lengths / self.pixel_size).tolist(), *curvatures.tolist())
        # A point of the upright dimple moves sideways when it is turned: a few steps of a fixed
        # point find the one that comes to lie at x, to 0.2 px for a tilt of 0.3 (measured).
        cos, sin = np.cos(self.tilt), np.sin(self.tilt)
        u = along / cos
        for _ in range(8):
            u = (along + sin * _profile(u, *upright)[0]) / cos
        return np.where(near, self.center[1] + sin * u + cos * _profile(u, *upright)[0], np.nan)


def fit_dimple(boundary: Boundary, *, pixel_size: float, probe_half_width: float) -> DimpleFit:
    r"""Fit the membrane's profile (4.2) to an outline.

    Parameters
    ----------
    boundary : Boundary
        Outline from `microlib.embryo.extract_boundary`.
    pixel_size : float
        Pixel in the object plane, in µm.
    probe_half_width : float
        Half-width c of the probe, in µm.

    Returns
    -------
    DimpleFit
        Radius and depth with their covariance.

    Raises
    ------
    ValueError
        If an argument is not positive, the probe is wider than the dimple or of another width than
        the one that is seen, its end is a third of the depth from the fitted bottom, or the outline
        departs from (4.2) by more than a sixth of the depth (root mean square): it has no dimple of
        that depth.

    Notes
    -----
    Between probe and rim the outline is (4.2), beyond the rim an arc on each side, as the model
    draws it; the dimple may be shifted and turned. Shift, turn, radius, depth and the two
    curvatures, seven numbers, are fitted by least squares of the distances across the outline, each
    weighted by its standard deviation; points further than four deviations off are left out and the
    fit repeated, unless they are so many that they must be the outline. Points under the probe do
    not enter: the depth is that of the flanks, continued to r = c.

    The covariance is scaled to the residuals and to how far they are correlated along the outline.
    Noise is for a few px; an outline of another shape leaves arcs, which widen the covariance by
    their number of points. Such an outline also has its bottom elsewhere: what the probe's end is
    off, beyond the 1 px to which it is seen, counts as a deviation of the depth. Whether (4.7)
    holds for another shape is not in the covariance.

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
    of_kind("boundary", boundary, Boundary)
    size = scalar("pixel_size", pixel_size, above=0)
    c = scalar("probe_half_width", probe_half_width, above=0) / size
    check_probe_width(boundary, c, size)
    outline = np.stack([boundary.x, boundary.y, boundary.std])[:, ~boundary.under_probe]
    start = _start(outline[0], outline[1], boundary)
    outline = outline[:, np.abs(outline[0] - boundary.probe.tip[0]) > c]
    near = outline[:, np.abs(outline[0] - start[0]) < _BEYOND_RIM * start[3]]
    first = _least_squares(near, start, c)
    near = outline[:, np.abs(outline[0] - first.x[0]) < _BEYOND_RIM * first.x[3]]
    off = np.abs(_normal_distance(first.x, near[0], near[1], c) / near[2])
    # One point in 16 000 lies beyond four standard deviations by chance; 3 to 6 change E by up to
    # 0.4 of its deviation. Within its own deviation no point is an outlier.
    usual = off < max(4 * MAD_TO_STD * np.median(off), 1.0)
    # Strays are few; more are the outline.
    kept = near[:, usual] if usual.mean() >= 3 / 4 else near
    fit = _least_squares(kept, first.x, c)

    x0, y0, tilt, a, depth, *curvatures = fit.x.tolist()
    misfit = float(np.sqrt(np.mean(_normal_distance(fit.x, kept[0], kept[1], c) ** 2)))
    if misfit > _LARGEST_MISFIT * depth:
        raise ValueError(
            "boundary must follow the membrane's profile (4.2) to within a sixth of the dimple's "
            f"depth, got {misfit:.2f} px of {depth:.1f} px"
        )
    off_axis = abs(float(boundary.probe.axis(boundary.image_height - 1 - y0)) - x0)
    tip_off = abs(y0 - depth - (boundary.image_height - 1 - boundary.probe.tip[1]))
    # The end is seen to 1 px, as the middle of the wall below it. A third of the depth would leave
    # a factor of e of the modulus open.
    beyond = float(np.sqrt(max(tip_off**2 - 1, 0.0)))
    if off_axis > c or beyond > depth / 3:
        raise ValueError(
            "boundary must have the probe's end at the bottom of the dimple, for this "
            f"probe_half_width, got it {off_axis:.1f} px beside the axis and {tip_off:.1f} px off "
            "in height"
        )
    covariance = inverse_normal(fit.jac) * residual_variance(fit.fun, len(fit.x))
    covariance[4, 4] += beyond**2
    return DimpleFit(
        dimple_radius=a * size,
        dimple_depth=depth * size,
        covariance=covariance[3:-2, 3:-2] * size**2,
        center=(x0, y0),
        tilt=tilt,
        rim_curvatures=(curvatures[0] / size, curvatures[1] / size),
        misfit=misfit,
        pixel_size=size,
        probe_half_width=c * size,
    )


def check_probe_width(boundary: Boundary, half_width: float, pixel_size: float) -> None:
    """Refuse a half-width (px) that is not that of the probe in the image."""
    seen = boundary.probe.half_width
    factor = max(half_width / seen, seen / half_width)
    # The walls of glass, and the taper of a needle's end.
    if abs(half_width - seen) > 2 and factor > 3 / 2:
        raise ValueError(
            "probe_half_width must be that of the probe in the image, got "
            f"{half_width * pixel_size:g} µm where {seen * pixel_size:.3g} µm are seen with this "
            "pixel_size"
        )


def _start(x: NDArray, y: NDArray, boundary: Boundary) -> Array:
    """Axis, rim height, tilt, radius, depth and curvatures from the outline's highest points."""
    axis = boundary.probe.tip[0]
    left = x < axis
    # A running median keeps a stray point from passing for the rim.
    smooth = median_filter(y, 9, mode="nearest")
    rims = [(x[side][smooth[side].argmax()], smooth[side].max()) for side in (left, ~left)]
    (x0, height), (wide, rise) = np.mean(rims, axis=0), np.diff(rims, axis=0)[0]
    bottom = boundary.image_height - 1 - boundary.probe.tip[1]
    bend = 1 / (2 * wide)
    return np.array([x0, height, rise / wide, wide / 2, height - bottom, bend, bend])


def _least_squares(outline: Array, start: Array, c: float) -> OptimizeResult:
    """Fit the seven numbers to the rows x, y, std of `outline`."""
    x, y, std = outline
    # In rad, four times the largest tilt of the probe: nothing changes from 0.1 to 0.6.
    far, turn, sharpest = np.inf, 1 / 4, 1 / start[3]
    lower = [-far, -far, -turn, c + 1, 0.0, 0.0, 0.0]
    bounds = lower, [far, far, turn, far, far, sharpest, sharpest]
    return least_squares(
        lambda p: _normal_distance(p, x, y, c) / std,
        np.clip(start, *bounds),
        bounds=bounds,
        x_scale="jac",
    )


def _profile(
    u: NDArray, a: float, depth: float, c: float, left: float, right: float
) -> tuple[Array, Array]:
    """Height above the rim and slope of an upright dimple at the distance `u` right of its axis."""
    distance = np.abs(u)
    r = np.clip(distance, c, a)
    zeta2 = (c / a) ** 2
    scale = depth / (zeta2 - 1 - np.log(zeta2))
    beyond = np.maximum(distance - a, 0.0)
    curvature = np.where(u < 0, left, right)
    # An arc of a circle; its root stays real where a search tries too strong a curvature.
    root = np.sqrt(np.maximum(1 - (curvature * beyond) ** 2, 1 / 4**2))
    height = -dimple_profile(r, a, depth, probe_half_width=c) - curvature * beyond**2 / (1 + root)
    slope = 2 * scale * (1 / r - r / a**2) * (distance > c) - curvature * beyond / root
    return height, np.sign(u) * slope


def _normal_distance(p: NDArray, x: NDArray, y: NDArray, c: float) -> Array:
    """Distance of points across the outline, to first order, in px."""
    x0, y0, tilt, a, depth, left, right = p
    cos, sin = np.cos(tilt), np.sin(tilt)
    u = cos * (x - x0) + sin * (y - y0)
    v = -sin * (x - x0) + cos * (y - y0)
    height, slope = _profile(u, a, depth, c, left, right)
    return (v - height) / np.hypot(1.0, slope)


def residual_variance(residuals: Array, parameters: int) -> float:
    """Return the variance of residuals, times how far they are correlated along the outline."""
    count = residuals.size
    products = np.correlate(residuals, residuals, "full")[count - 1 :]
    # The fit itself makes residuals look less correlated, by about its number of parameters over
    # that of points.
    correlation = products[1 : count // 4] / products[0] + parameters / count
    # Less than chance leaves of points that share nothing: further ones share nothing, either.
    last = np.append(correlation < 2 / np.sqrt(count), True).argmax()
    return float(products[0] / (count - parameters) * (1 + 2 * correlation[:last].sum()))
