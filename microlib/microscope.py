"""The parametric model of an optical microscope: pose, perspective, radial distortion (2.5–2.12).

A point of the world frame (µm) is turned and shifted into the objective frame, projected through
the objective onto the sensor (µm from the sensor's center), distorted, and sampled (px).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Tidy, as_array, positive, scalar

__all__ = ["Microscope", "distort", "euler_rotation", "undistort"]


def euler_rotation(alpha: float, beta: float, gamma: float) -> Array:
    """Rotation by γ about x, then β about y, then α about z: R = Rz(α) Ry(β) Rx(γ) (2.6, 2.7).

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
        If an angle is not a finite number within ±1e9.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.microscope import euler_rotation
    >>> euler_rotation(0.0, 0.0, np.pi).round(12) + 0.0  # a pattern seen from behind
    array([[ 1.,  0.,  0.],
           [ 0., -1.,  0.],
           [ 0.,  0., -1.]])
    """
    return _rotation(
        *(
            scalar(name, angle)
            for name, angle in (("alpha", alpha), ("beta", beta), ("gamma", gamma))
        )
    )


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


def undistort(points: ArrayLike, distortion: float) -> Array:
    """Take radial distortion off sensor points: (u', v') = (u, v)·(1 + κ r²), r² = u² + v² (2.10).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Distorted sensor points (u, v) in µm from the sensor's center.
    distortion : float
        κ in 1/µm².

    Returns
    -------
    ndarray, shape (..., 2)
        Undistorted points (u', v') in µm; NaN beyond the fold of (2.10), r² > −1/(3κ), where two
        distorted points would share one undistorted point. There is no fold when κ ≥ 0.

    See Also
    --------
    distort : the inverse.
    """
    points, distortion = _sensor_points(points), scalar("distortion", distortion)
    growth = distortion * (points * points).sum(axis=-1, keepdims=True)
    return points * np.where(growth < -1 / 3, np.nan, 1 + growth)


def distort(points: ArrayLike, distortion: float) -> Array:
    """Put radial distortion on sensor points: the exact inverse of (2.10).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Undistorted sensor points (u', v') in µm from the sensor's center.
    distortion : float
        κ in 1/µm².

    Returns
    -------
    ndarray, shape (..., 2)
        Distorted points (u, v) in µm; NaN where (2.10) reaches no such point, r'² > −4/(27κ) for κ
        < 0.

    Notes
    -----
    The scale s = r/r' is the root of q s³ + s − 1 = 0 with q = κ r'². Written as
    s = (3/t) sinh(asinh(t)/3), t = (3/2)√(3q), it is accurate to rounding for every q ≥ 0, the
    smallest included; for q < 0 the hyperbolic functions become circular ones. No iteration is
    needed.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.microscope import distort, undistort
    >>> corner = np.array([3247.2, 2430.5])
    >>> float(abs(undistort(distort(corner, -8.4e-10), -8.4e-10) - corner).max()) < 1e-11
    True
    """
    return _distorted(_sensor_points(points), scalar("distortion", distortion))


def _distorted(points: Array, distortion: float) -> Array:
    q = distortion * (points * points).sum(axis=-1, keepdims=True)
    t = 1.5 * np.sqrt(3 * np.abs(q))
    if distortion >= 0:
        root = np.sinh(np.arcsinh(t) / 3)
    else:
        root = np.sin(np.arcsin(np.where(t <= 1, t, np.nan)) / 3)
    return points * np.divide(3 * root, t, out=np.ones_like(t), where=t != 0)


@dataclass(frozen=True)
class Microscope(Tidy):
    """An optical microscope with its camera, looking at a pattern plane (2.5–2.12).

    Parameters
    ----------
    tube_length : float
        Optical tube length T_op, µm.
    focal_length : float
        Focal length f of the objective, µm.
    distance : float
        Distance d of the object plane from the front focal plane, µm. A plane in focus has d =
        f²/T_op (2.20).
    distortion : float
        Radial distortion κ, 1/µm², on the sensor.
    alpha, beta, gamma : float
        Euler angles of R = Rz(α) Ry(β) Rx(γ) from world to objective frame, rad.
    tx, ty : float
        World origin in the objective frame, µm; its third coordinate is T_z = f + d (2.8).
    pixel_pitch : float or (float, float)
        Distance of neighboring pixels on the sensor along x and y (pixel pitch), µm.
    image_size : (int, int)
        Width and height of the image, px. The optical axis meets its center.

    Raises
    ------
    ValueError
        If a length is not positive, a parameter is not finite, or `image_size` is not two whole
        numbers.

    Attributes
    ----------
    PARAMETERS : tuple of str
        Names of the nine parameters of the model, the fields above without those of the sensor, in
        the order of :meth:`jacobian`.

    Notes
    -----
    The points of a plane see only T_op + f and f + d, never the three lengths one by one: see
    :meth:`project_plane` and :func:`microlib.calibration.calibrate`.

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

    PARAMETERS: ClassVar[tuple[str, ...]] = (
        "tube_length",
        "focal_length",
        "distance",
        "distortion",
        "alpha",
        "beta",
        "gamma",
        "tx",
        "ty",
    )

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

    def __post_init__(self) -> None:
        for name in ("tube_length", "focal_length", "distance"):
            object.__setattr__(self, name, scalar(name, getattr(self, name), above=0))
        for name in ("distortion", "tx", "ty"):
            object.__setattr__(self, name, scalar(name, getattr(self, name)))
        for name in ("alpha", "beta", "gamma"):
            object.__setattr__(self, name, scalar(name, getattr(self, name)))
        pitch = positive("pixel_pitch", self.pixel_pitch)
        if pitch.ndim:
            pitch = as_array("pixel_pitch", pitch, shape=(2,))
        plain = tuple(pitch.tolist()) if pitch.ndim else pitch.item()
        object.__setattr__(self, "pixel_pitch", plain)
        size = positive("image_size", as_array("image_size", self.image_size, shape=(2,)))
        if (size != np.round(size)).any():
            raise ValueError(f"image_size must be whole numbers of pixels, got {self.image_size}")
        object.__setattr__(self, "image_size", tuple(map(int, size)))

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
        return np.broadcast_to(np.asarray(self.pixel_pitch, dtype=np.float64), 2)

    @property
    def principal_point(self) -> Array:
        """Where the optical axis meets the image, (x, y) px: the sensor's center."""
        return (np.asarray(self.image_size, dtype=np.float64) - 1) / 2

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
        x, y, z = self.to_objective(points).T
        z = np.where(z > 0, z, np.nan)
        sensor = (self.tube_length + self.focal_length) * np.column_stack([x / z, y / z])
        return _distorted(sensor, self.distortion) / self.pitch + self.principal_point

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
        sensor = undistort((pixels - self.principal_point) * self.pitch, self.distortion)
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

    def jacobian(self, world: ArrayLike, parameters: tuple[str, ...] = PARAMETERS) -> Array:
        """Derivatives of the image points of the pattern plane by the microscope's parameters.

        Parameters
        ----------
        world : array_like, shape (N, 2)
            Points of the pattern plane, µm.
        parameters : tuple of str
            Any of `PARAMETERS`; or "magnification" or "focus", which is f with the plane
            kept in focus at the same magnification, T_op = M f and d = f/M.

        Returns
        -------
        ndarray, shape (N, 2, p)
            px per unit of each parameter (µm, rad, 1/µm²).

        Raises
        ------
        ValueError
            If `world` has another shape, is empty or not finite, or a name is unknown.

        Examples
        --------
        A longer tube moves the points outwards, on the sensor by their share of the field:

        >>> from microlib.microscope import Microscope
        >>> scope = Microscope(200000, 126000, 79380, pixel_pitch=9.9, image_size=(656, 491))
        >>> scope.jacobian([[0.0, 0.0], [280.0, 0.0]], ("tube_length",))[..., 0].round(7)
        array([[0.      , 0.      ],
               [0.0001377, 0.      ]])
        """
        world = as_array("world", world, shape=(None, 2))
        if isinstance(parameters, str) or not isinstance(parameters, Sequence) or not parameters:
            raise ValueError(
                f"parameters must be a tuple of at least one name, got {type(parameters).__name__}"
            )
        if not all(isinstance(name, str) for name in parameters):
            raise ValueError("parameters must be names, got other values among them")
        depth = self.focal_length + self.distance
        pose = (self.distortion, self.alpha, self.beta, self.gamma, self.tx, self.ty)
        visible = np.array([self.magnification, 1 / depth, *pose])
        by = Microscope.project_plane(visible, world, self.pitch)[1]
        by_range = by[..., 0] / depth  # T_op + f, at constant f + d
        by_depth = -(self.magnification * by[..., 0] + by[..., 1] / depth) / depth  # f + d
        columns = {
            "tube_length": by_range,
            "focal_length": by_range + by_depth,
            "distance": by_depth,
            "magnification": by[..., 0],
            "focus": -by[..., 1] / (depth * self.focal_length),
            **{name: by[..., 2 + k] for k, name in enumerate(self.PARAMETERS[3:])},
        }
        unknown = [name for name in parameters if name not in columns]
        if unknown:
            raise ValueError(f"parameters must be among {', '.join(columns)}, got {unknown}")
        return np.stack([columns[name] for name in parameters], axis=-1)

    @staticmethod
    def project_plane(visible: Array, world: Array, pitch: Array) -> tuple[Array, Array]:
        """Image of points of the pattern plane from the numbers that they can see.

        Parameters
        ----------
        visible : ndarray, shape (8,)
            (M, h, κ, α, β, γ, T_x, T_y): the magnification, the convergence h = 1/(f + d) in 1/µm,
            then κ in 1/µm², angles in rad, T in µm.
        world : ndarray, shape (N, 2)
            (X_w, Y_w), µm.
        pitch : ndarray, shape (2,)
            Pixel pitch of the sensor, µm.

        Returns
        -------
        points : ndarray, shape (N, 2)
            (x, y) from the principal point, px.
        jacobian : ndarray, shape (N, 2, 8)
            Their derivatives by `visible`. Both are NaN beyond the reach of the distortion model
            and in the plane of the objective, 1 + h Z_r = 0.

        Raises
        ------
        ValueError
            If a shape does not fit, a value is not finite, a pitch is not positive, or a point lies
            on the fold of the distortion model, where derivatives are infinite.

        Notes
        -----
        The points see the three lengths only as the magnification M = (T_op + f)/(f + d) and the
        convergence h = 1/T_z = 1/(f + d), how fast the scale changes with depth:

            u' = M X / (1 + h Z_r),   Z_r = r31 X_w + r32 Y_w

        (2.9 divided through by T_z). This form stays smooth up to the telecentric limit h = 0 and
        beyond it, where no microscope is, but where a search for one may pass.
        """
        visible = as_array("visible", visible, shape=(8,))
        world = as_array("world", world, shape=(None, 2))
        pitch = positive("pitch", as_array("pitch", pitch, shape=(2,)))
        magnification, convergence, distortion, alpha, beta, gamma, tx, ty = visible
        rotation = _rotation(alpha, beta, gamma)
        # A row a component: the points of each lie side by side in memory, which is several times
        # faster here.
        turned = rotation[:, :2] @ world.T  # (3, N): X - T_x, Y - T_y, Z - T_z
        flat = turned[:2] + np.array([[tx], [ty]])
        distance = 1 + convergence * turned[2]
        shrink = 1 / np.where(distance != 0, distance, np.nan)
        undistorted = magnification * shrink * flat

        by = np.empty((8, 2, len(world)))
        by[0] = flat * shrink
        by[1] = -undistorted * (shrink * turned[2])
        # Rotating about the axis a changes a point by a × point.
        axes = np.array(
            [[0.0, 0.0, 1.0], [-np.sin(alpha), np.cos(alpha), 0.0], rotation[:, 0]]
        ).tolist()
        for row, (x, y, z) in enumerate(axes, 3):
            moved = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ turned
            by[row] = shrink * (magnification * moved[:2] - undistorted * (convergence * moved[2]))
        by[6:] = np.eye(2)[:, :, np.newaxis] * (magnification * shrink)

        sensor = _distorted(undistorted.T, distortion).T
        radius2 = (sensor**2).sum(axis=0)
        by[2] = -sensor * radius2
        # (2.10) differentiated: its left side depends on the distorted point, by (1 + κr²) I +
        # 2κ s sᵀ, which is a diagonal and one outer product, so that its inverse is, too.
        along, across = 1 + 3 * distortion * radius2, 1 + distortion * radius2
        if (along == 0).any() or (across == 0).any():
            raise ValueError(
                "world must keep off the fold of the distortion model, got a point on it"
            )
        radial = (by * sensor).sum(axis=1, keepdims=True)
        by -= radial * (2 * distortion * sensor / along)
        by /= across
        by /= pitch[:, np.newaxis]
        return sensor.T / pitch, by.transpose(2, 1, 0)
