"""The parametric model of an optical microscope: pose, perspective, radial distortion (2.5–2.12).

A point of the world frame (µm) is turned and shifted into the objective frame, projected through
the objective onto the sensor (µm from the sensor's centre), distorted, and sampled (px).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array, positive

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

    Examples
    --------
    >>> euler_rotation(0.0, 0.0, np.pi).round(12) + 0.0  # a pattern seen from behind
    array([[ 1.,  0.,  0.],
           [ 0., -1.,  0.],
           [ 0.,  0., -1.]])
    """
    (ca, cb, cg), (sa, sb, sg) = np.cos([alpha, beta, gamma]), np.sin([alpha, beta, gamma])
    return np.array(
        [
            [ca * cb, ca * sb * sg - sa * cg, ca * sb * cg + sa * sg],
            [sa * cb, sa * sb * sg + ca * cg, sa * sb * cg - ca * sg],
            [-sb, cb * sg, cb * cg],
        ]
    )


def undistort(points: ArrayLike, distortion: float) -> Array:
    """Take radial distortion off sensor points: (u', v') = (u, v)·(1 + κ r²), r² = u² + v² (2.10).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Distorted sensor points (u, v) in µm from the sensor's centre.
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
    points = np.asarray(points, dtype=np.float64)
    bending = distortion * (points * points).sum(axis=-1, keepdims=True)
    return points * np.where(bending < -1 / 3, np.nan, 1 + bending)


def distort(points: ArrayLike, distortion: float) -> Array:
    """Put radial distortion on sensor points: the exact inverse of (2.10).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Undistorted sensor points (u', v') in µm from the sensor's centre.
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
    >>> corner = np.array([3247.2, 2430.5])
    >>> float(abs(undistort(distort(corner, -8.4e-10), -8.4e-10) - corner).max()) < 1e-11
    True
    """
    points = np.asarray(points, dtype=np.float64)
    q = distortion * (points * points).sum(axis=-1, keepdims=True)
    t = 1.5 * np.sqrt(3 * np.abs(q))
    if distortion >= 0:
        root = np.sinh(np.arcsinh(t) / 3)
    else:
        root = np.sin(np.arcsin(np.where(t <= 1, t, np.nan)) / 3)
    return points * np.divide(3 * root, t, out=np.ones_like(t), where=t != 0)


@dataclass(frozen=True)
class Microscope:
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
    pixel_size : float or (float, float)
        Pitch of the sensor cells along x and y, µm.
    image_size : (int, int)
        Width and height of the image, px. The optical axis meets its centre.

    Raises
    ------
    ValueError
        If a length is not positive, a parameter is not finite, or `image_size` is not two whole
        numbers.

    Notes
    -----
    The points see only T_op + f and f + d, never the three lengths one by one: see
    :func:`microlib.calibration.calibrate`.

    Examples
    --------
    The 1X circle column of Table 5.1, and the sensor of the Basler camera:

    >>> alpha, beta, gamma = np.deg2rad([90.7144, -2.7912, 175.9179])
    >>> scope = Microscope(
    ...     200490, 126150, 78750, distortion=-8.4e-10, alpha=alpha, beta=beta, gamma=gamma,
    ...     tx=-781.4, ty=-55.002, pixel_size=9.9, image_size=(656, 491))
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
    pixel_size: float | tuple[float, float] = 9.9
    image_size: tuple[int, int] = (656, 491)

    def __post_init__(self) -> None:
        for name in ("tube_length", "focal_length", "distance"):
            positive(name, as_array(name, getattr(self, name), shape=()))
        for name in ("distortion", "alpha", "beta", "gamma", "tx", "ty"):
            as_array(name, getattr(self, name), shape=())
        if np.ndim(self.pixel_size):
            as_array("pixel_size", self.pixel_size, shape=(2,))
        positive("pixel_size", self.pixel_size)
        size = positive("image_size", as_array("image_size", self.image_size, shape=(2,)))
        if (size != np.round(size)).any():
            raise ValueError(f"image_size must be whole numbers of pixels, got {self.image_size}")

    @property
    def rotation(self) -> Array:
        """R from the world to the objective frame, 3×3 (2.6)."""
        return euler_rotation(self.alpha, self.beta, self.gamma)

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
    def cell(self) -> Array:
        """Pitch of the sensor cells (s_x, s_y), µm."""
        return np.broadcast_to(np.asarray(self.pixel_size, dtype=np.float64), 2)

    @property
    def principal_point(self) -> Array:
        """Where the optical axis meets the image, (x, y) px: the sensor's centre."""
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
        columns = np.shape(points)[1] if np.ndim(points) == 2 else None
        if columns not in (2, 3):
            raise ValueError(f"points must have shape (any, 2) or (any, 3), got {np.shape(points)}")
        points = as_array("points", points)
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
        return distort(sensor, self.distortion) / self.cell + self.principal_point

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
        sensor = undistort((pixels - self.principal_point) * self.cell, self.distortion)
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
