"""The parametric model of an optical microscope: pose, perspective, radial distortion (2.5–2.12).

A point of the world frame (µm) is turned and shifted into the objective frame, projected through
the objective onto the sensor (µm from the sensor's center), distorted, and sampled (px).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, FlatResult, as_array, as_positive, as_scalar

__all__ = ["Microscope", "distort", "euler_rotation", "undistort"]


def euler_rotation(alpha: float, beta: float, gamma: float) -> Array:
    """Return Rz(α) Ry(β) Rx(γ), which turns by γ about x, by β about y, by α about z (2.6, 2.7).

    Parameters
    ----------
    alpha, beta, gamma : float
        Angles in radians.

    Returns
    -------
    ndarray, shape (3, 3)

    Raises
    ------
    ValueError
        If an angle is not a finite number.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.microscope import euler_rotation
    >>> euler_rotation(0.0, 0.0, np.pi).round(12) + 0.0  # a pattern seen from behind
    array([[ 1.,  0.,  0.],
           [ 0., -1.,  0.],
           [ 0.,  0., -1.]])
    """
    return _rotation(as_scalar("alpha", alpha), as_scalar("beta", beta), as_scalar("gamma", gamma))


def _rotation(alpha: float, beta: float, gamma: float) -> Array:
    (ca, cb, cg), (sa, sb, sg) = np.cos([alpha, beta, gamma]), np.sin([alpha, beta, gamma])
    return np.array(
        [
            [ca * cb, ca * sb * sg - sa * cg, ca * sb * cg + sa * sg],
            [sa * cb, sa * sb * sg + ca * cg, sa * sb * cg - ca * sg],
            [-sb, cb * sg, cb * cg],
        ]
    )


def _sensor_points(points: ArrayLike) -> Array:
    array = as_array("points", points, finite=False)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ValueError(f"points must have shape (..., 2), got {array.shape}")
    if np.isinf(array).any():
        raise ValueError(f"points must be finite or NaN, got {int(np.isinf(array).sum())} infinite")
    return array


def pitch_pair(name: str, value: ArrayLike) -> Array:
    """A pitch along x and y, shape (2,), checked."""
    pitch = as_positive(name, value)
    return as_array(name, np.full(2, pitch) if pitch.ndim == 0 else pitch, shape=(2,))


def whole_size(image_size: Any) -> tuple[int, int]:
    """Width and height of an image, px, checked."""
    size = as_positive("image_size", as_array("image_size", image_size, shape=(2,)))
    if (size != np.round(size)).any():
        raise ValueError(f"image_size must be whole numbers of pixels, got {image_size}")
    width, height = map(int, size)
    return width, height


def _radial(radius: Array, coefficients: tuple[float, float]) -> tuple[Array, Array]:
    """Factor 1 + κ r² + κ₂ r⁴ of the radius in (2.10), and the derivative of the product by r."""
    (k1, k2), radius2 = coefficients, radius * radius
    return 1 + radius2 * (k1 + radius2 * k2), 1 + radius2 * (3 * k1 + radius2 * (5 * k2))


def _fold(coefficients: tuple[float, float]) -> float:
    """Radius where 1 + 3 κ r² + 5 κ₂ r⁴ first becomes zero; infinite if it never does."""
    k1, k2 = coefficients
    discriminant = 9 * k1**2 - 20 * k2
    if discriminant < 0:
        return np.inf
    denominator = np.sqrt(discriminant) - 3 * k1
    return (
        float(np.sqrt(2 / denominator)) if denominator > 1e-300 else np.inf
    )  # its square is finite


def _radial_at(wanted: Array, coefficients: tuple[float, float]) -> tuple[Array, Array]:
    """Factor and slope of `_radial` at the distorted radius of each undistorted radius.

    Newton's method within a bracket of the root. Up to the fold the factor is at least 4/9. Both
    are NaN where there is no such radius.
    """
    fold = _fold(coefficients)
    if fold < np.inf:
        reach = fold * _radial(np.array(fold), coefficients)[0]
        wanted = np.where(wanted <= reach, wanted, np.nan)
    low, high = np.zeros_like(wanted), np.minimum(9 / 4 * wanted, fold)
    radius = np.minimum(wanted / np.maximum(_radial(wanted, coefficients)[0], 4 / 9), high)
    for _ in range(60):
        factor, slope = _radial(radius, coefficients)
        excess = radius * factor - wanted
        low, high = np.where(excess < 0, radius, low), np.where(excess > 0, radius, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            better = radius - excess / slope
        better = np.where((low <= better) & (better <= high), better, (low + high) / 2)
        change, radius = np.abs(better - radius), better
        if not (change > 1e-8 * wanted).any():  # the next would be its square
            break
    return _radial(radius, coefficients)


def undistort(points: ArrayLike, distortion: float, distortion_k2: float = 0.0) -> Array:
    """Remove radial distortion from sensor points: u' = u (1 + κ r² + κ₂ r⁴), r = ‖u‖ (2.10).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Distorted sensor points u in µm from the principal point.
    distortion : float
        κ in 1/µm².
    distortion_k2 : float
        κ₂ in 1/µm⁴; zero in the thesis.

    Returns
    -------
    ndarray, shape (..., 2)
        Undistorted points u' in µm; NaN beyond the fold of (2.10), the smallest r with
        1 + 3 κ r² + 5 κ₂ r⁴ = 0, where two distorted points would share one undistorted point.
        There is no fold if neither coefficient is negative.

    See Also
    --------
    distort : the inverse.
    """
    points = _sensor_points(points)
    coefficients = as_scalar("distortion", distortion), as_scalar("distortion_k2", distortion_k2)
    radius = np.hypot(points[..., 0], points[..., 1])
    factor, _ = _radial(radius, coefficients)
    return points * np.where(radius > _fold(coefficients), np.nan, factor)[..., np.newaxis]


def distort(points: ArrayLike, distortion: float, distortion_k2: float = 0.0) -> Array:
    """Apply radial distortion to sensor points: the inverse of (2.10).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Undistorted sensor points u' in µm from the principal point.
    distortion : float
        κ in 1/µm².
    distortion_k2 : float
        κ₂ in 1/µm⁴; zero in the thesis.

    Returns
    -------
    ndarray, shape (..., 2)
        Distorted points u in µm; NaN where (2.10) reaches no such point. For κ < 0 and κ₂ = 0 this
        is r'² > −4/(27κ).

    Notes
    -----
    Newton's method finds the radius to rounding. A bracket of the root replaces a step that would
    leave it by the middle of the bracket.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.microscope import distort, undistort
    >>> corner = np.array([3247.2, 2430.5])
    >>> float(abs(undistort(distort(corner, -8.4e-10), -8.4e-10) - corner).max()) < 1e-11
    True
    """
    points = _sensor_points(points)
    coefficients = as_scalar("distortion", distortion), as_scalar("distortion_k2", distortion_k2)
    factor, _ = _radial_at(np.hypot(points[..., 0], points[..., 1]), coefficients)
    return points / factor[..., np.newaxis]


def project_points(
    world: Array, pitch: Array, view: Mapping[str, float], *, derivatives: bool = False
) -> tuple[Array, dict[str, Array]]:
    """Image of points from the numbers that determine the image of a plane.

    Parameters
    ----------
    world : ndarray, shape (N, 2) or (N, 3)
        World points, µm; with two columns they lie on the pattern plane, Z_w = 0.
    pitch : ndarray, shape (2,)
        Pixel pitch of the sensor, µm.
    view : mapping of str to float
        The parameters in :attr:`Microscope.view`, by name.
    derivatives : bool
        Whether to return the derivatives.

    Returns
    -------
    points : ndarray, shape (2, N)
        x and y from the middle of the image, px. NaN beyond the reach of the distortion model and
        in the plane of the objective, 1 + h Z_r = 0.
    by : dict of str to ndarray, shape (2, N)
        Derivatives of the points by each parameter in `view`; empty if they are not asked for.

    Notes
    -----
    A plane shows the three lengths only as the magnification M = (T_op + f)/(f + d) and the
    convergence h = 1/T_z = 1/(f + d), which states how fast the scale changes with depth:

        u' = M X / (1 + h Z_r),   Z_r = r31 X_w + r32 Y_w

    (2.9 divided through by T_z). This form stays smooth up to the telecentric limit h = 0 and
    beyond it, where no microscope is, but where a search for one may pass.
    """
    magnification, convergence = view["magnification"], view["convergence"]
    alpha, beta, gamma = view["alpha"], view["beta"], view["gamma"]
    rotation = _rotation(alpha, beta, gamma)
    # The points of each component lie side by side in memory, which is several times faster.
    turned = rotation[:, : world.shape[1]] @ world.T  # X − T_x, Y − T_y, Z − T_z
    flat = turned[:2] + np.array([[view["tx"]], [view["ty"]]])
    depth = 1 + convergence * turned[2]
    shrink = 1 / np.where(depth != 0, depth, np.nan)
    undistorted = magnification * shrink * flat
    coefficients = view["distortion"], view["distortion_k2"]
    factor, slope = _radial_at(np.hypot(*undistorted), coefficients)
    sensor, pitch = undistorted / factor, pitch[:, np.newaxis]
    points = sensor / pitch + np.array([[view["principal_x"]], [view["principal_y"]]])
    if not derivatives:
        return points, {}

    first, second = np.eye(2)[:, :, np.newaxis]
    by_undistorted = {
        "magnification": flat * shrink,
        "convergence": -undistorted * (shrink * turned[2]),
        "tx": first * (magnification * shrink),
        "ty": second * (magnification * shrink),
    }
    axes = {"alpha": (0.0, 0.0, 1.0), "beta": (-np.sin(alpha), np.cos(alpha), 0.0)}
    for name, (x, y, z) in (axes | {"gamma": tuple(rotation[:, 0])}).items():
        # Rotating about an axis moves a point by the cross product of the axis and the point.
        moved = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ turned
        toward = undistorted * (convergence * moved[2])
        by_undistorted[name] = shrink * (magnification * moved[:2] - toward)
    radius2 = (sensor * sensor).sum(axis=0)
    for power, name in enumerate(("distortion", "distortion_k2"), 1):
        by_undistorted[name] = -sensor * radius2**power  # (2.10) differentiated at a fixed u'
    # The derivative of u' by u is factor I + (slope − factor) u uᵀ/r², a multiple of the identity
    # and an outer product, and so is its inverse.
    with np.errstate(divide="ignore", invalid="ignore"):
        radial = sensor * np.where(radius2 > 0, (1 / slope - 1 / factor) / radius2, 0.0)
    changes = np.array(list(by_undistorted.values()))
    along = (changes * sensor).sum(axis=1, keepdims=True)
    by = dict(zip(by_undistorted, (changes / factor + along * radial) / pitch, strict=True))
    ones = np.ones(len(world))
    return points, by | {"principal_x": first * ones, "principal_y": second * ones}


@dataclass(frozen=True)
class Microscope(FlatResult):
    """Model (2.5–2.12) of a microscope and camera in front of a pattern plane.

    Parameters
    ----------
    tube_length : float
        Optical tube length T_op, µm.
    focal_length : float
        Focal length f of the objective, µm.
    distance : float
        Distance d of the object plane from the front focal plane, µm. A plane in focus has d =
        f²/T_op (2.20).
    distortion, distortion_k2 : float
        Radial distortion on the sensor: κ, 1/µm², and a second coefficient κ₂, 1/µm⁴, which the
        thesis does not have. See :func:`undistort`.
    alpha, beta, gamma : float
        Euler angles of R = Rz(α) Ry(β) Rx(γ) from world to objective frame, rad.
    tx, ty : float
        World origin in the objective frame, µm; its third coordinate is T_z = f + d (2.8).
    pixel_pitch : float or (float, float)
        Distance of neighboring pixels on the sensor along x and y (pixel pitch), µm.
    image_size : (int, int)
        Width and height of the image, px.
    principal_offset : (float, float)
        Where the optical axis meets the image, (x, y) in px from the middle of the image. In the
        thesis it is the middle.

    Raises
    ------
    ValueError
        If a length is not positive, a parameter is not finite, or `image_size` is not two whole
        numbers.

    Notes
    -----
    The points of a plane see only T_op + f and f + d, never the three lengths one by one: see
    :attr:`view` and :func:`microlib.calibration.calibrate`.

    Examples
    --------
    The 1X circle column of Table 5.1, and the sensor of the Basler camera:

    >>> import numpy as np
    >>> from microlib.microscope import Microscope
    >>> alpha, beta, gamma = np.deg2rad([90.7144, -2.7912, 175.9179])
    >>> scope = Microscope(
    ...     200490, 126150, 78750, distortion=-8.4e-10, alpha=alpha, beta=beta, gamma=gamma,
    ...     tx=-781.4, ty=-55.002, pixel_pitch=9.9, image_size=(656, 491))
    >>> scope.project([[0.0, 0.0], [280.0, 0.0]]).round(2)
    array([[201.51, 236.13],
           [200.94, 281.22]])
    >>> scope.back_project(scope.project([[280.0, 140.0]])).round(9)
    array([[280., 140.]])
    >>> round(scope.magnification, 4)
    1.5941
    """

    tube_length: float
    focal_length: float
    distance: float
    distortion: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0
    gamma: float = 0.0
    tx: float = 0.0
    ty: float = 0.0
    _: KW_ONLY
    pixel_pitch: float | tuple[float, float]
    image_size: tuple[int, int]
    distortion_k2: float = 0.0
    principal_offset: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("tube_length", "focal_length", "distance"):
            object.__setattr__(self, name, as_scalar(name, getattr(self, name), above=0))
        for name in ("distortion", "distortion_k2", "alpha", "beta", "gamma", "tx", "ty"):
            object.__setattr__(self, name, as_scalar(name, getattr(self, name)))
        object.__setattr__(
            self, "pixel_pitch", tuple(pitch_pair("pixel_pitch", self.pixel_pitch).tolist())
        )
        object.__setattr__(self, "image_size", whole_size(self.image_size))
        offset = as_array("principal_offset", self.principal_offset, shape=(2,))
        object.__setattr__(self, "principal_offset", tuple(offset.tolist()))

    @property
    def rotation(self) -> Array:
        """R from the world to the objective frame, 3×3 (2.6)."""
        return _rotation(self.alpha, self.beta, self.gamma)

    @property
    def translation(self) -> Array:
        """T = (T_x, T_y, f + d), µm (2.8)."""
        return np.array([self.tx, self.ty, self.focal_length + self.distance])

    @property
    def magnification(self) -> float:
        """M = (T_op + f)/(f + d), the scale that images have (2.12); equals T_op/f in focus, d =
        f²/T_op."""
        return (self.tube_length + self.focal_length) / (self.focal_length + self.distance)

    @property
    def tilt(self) -> float:
        """Angle between the pattern plane and the sensor plane, rad in [0, π/2]."""
        r = self.rotation
        # The arcsine keeps its digits near the parallel pose, where cos θ = r33 loses half of them.
        return float(np.arctan2(np.hypot(r[2, 0], r[2, 1]), abs(r[2, 2])))

    @property
    def pitch(self) -> Array:
        """Pixel pitch of the sensor along x and y, (s_x, s_y), µm."""
        return np.array(self.pixel_pitch)

    @property
    def principal_point(self) -> Array:
        """Where the optical axis meets the image, (x, y) px."""
        return (np.asarray(self.image_size) - 1) / 2 + self.principal_offset

    @property
    def principal_distance(self) -> Array:
        """(T_op + f)/s along x and y, px: the focal lengths f_x and f_y of OpenCV's camera."""
        return (self.tube_length + self.focal_length) / self.pitch

    @property
    def view(self) -> dict[str, float]:
        """The numbers that determine the image of a plane, by name.

        The magnification M, the convergence h = 1/(f + d) in 1/µm, κ and κ₂, the principal point
        from the middle of the image in px, the angles in rad, and T_x and T_y in µm.
        """
        own = ("distortion", "distortion_k2", "alpha", "beta", "gamma", "tx", "ty")
        principal = dict(zip(("principal_x", "principal_y"), self.principal_offset, strict=True))
        return {
            "magnification": self.magnification,
            "convergence": 1 / (self.focal_length + self.distance),
            **{name: getattr(self, name) for name in own},
            **principal,
        }

    def to_objective(self, points: ArrayLike) -> Array:
        """World points to the objective frame: R X_w + T (2.5).

        Parameters
        ----------
        points : array_like, shape (N, 2) or (N, 3)
            World points, µm; with two columns they lie on the pattern plane, Z_w = 0.

        Returns
        -------
        ndarray, shape (N, 3)
            µm.

        Raises
        ------
        ValueError
            If `points` is empty, not finite, or has another shape.
        """
        points = as_array("points", points)
        columns = points.shape[1] if points.ndim == 2 else None
        if columns not in (2, 3):
            raise ValueError(f"points must have shape (any, 2) or (any, 3), got {points.shape}")
        return points @ self.rotation[:, :columns].T + self.translation

    def project(self, points: ArrayLike) -> Array:
        """World points to the image (2.5, 2.9–2.11).

        Parameters
        ----------
        points : array_like, shape (N, 2) or (N, 3)
            World points, µm; with two columns they lie on the pattern plane, Z_w = 0.

        Returns
        -------
        ndarray, shape (N, 2)
            (x, y), px; NaN for a point behind the objective or beyond the reach of the distortion
            model. Points outside the image get their coordinates there.

        Raises
        ------
        ValueError
            If `points` is empty, not finite, or has another shape.
        """
        depth = self.to_objective(points)[:, 2:]
        image, _ = project_points(as_array("points", points), self.pitch, self.view)
        return np.where(depth > 0, image.T + (np.asarray(self.image_size) - 1) / 2, np.nan)

    def back_project(self, pixels: ArrayLike) -> Array:
        """Image points to the pattern plane Z_w = 0: the inverse of :meth:`project` there.

        Parameters
        ----------
        pixels : array_like, shape (N, 2)
            (x, y), px.

        Returns
        -------
        ndarray, shape (N, 2)
            (X_w, Y_w), µm; NaN where the line of sight misses the plane in front of the objective
            or the pixel lies beyond the fold of the distortion model.

        Raises
        ------
        ValueError
            If `pixels` is empty, not finite, or has another shape.
        """
        pixels = as_array("pixels", pixels, shape=(None, 2))
        distorted = (pixels - self.principal_point) * self.pitch
        sensor = undistort(distorted, self.distortion, self.distortion_k2)
        x, y = (sensor / (self.tube_length + self.focal_length)).T
        r, (tx, ty, tz) = self.rotation, self.translation
        # X − x Z = 0 and Y − y Z = 0 are two linear equations in X_w and Y_w.
        a, b = r[0, 0] - x * r[2, 0], r[0, 1] - x * r[2, 1]
        c, d = r[1, 0] - y * r[2, 0], r[1, 1] - y * r[2, 1]
        p, q = x * tz - tx, y * tz - ty
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.column_stack([d * p - b * q, a * q - c * p]) / (a * d - b * c)[:, None]
            in_front = plane @ r[2, :2] + tz > 0
        return np.where(in_front[:, None], plane, np.nan)
