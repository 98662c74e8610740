"""Nonlinear fit of all views of one pattern through one lens (bundle adjustment).

The views share the lens: the principal distance T_op + f, the distortion and, where several views
determine them, a second distortion coefficient and the principal point. Each view has its own
magnification and pose. The fit starts from the closed form of (2.13)–(2.19): the pose by radial
alignment, then magnification and distortion by linear least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from microlib._common import Array, as_array, same_length
from microlib.microscope import Microscope, euler_rotation

#: Parameters of the lens: 1/(T_op + f) in 1/µm, κ in 1/µm², the second distortion coefficient κ₂ in
#: 1/µm⁴, and the principal point from the middle of the image, px. The first one is reported as the
#: focal length of the first view.
LENS = ("focal_length", "distortion", "distortion_k2", "principal_x", "principal_y")
#: Parameters of a view: M, α, β, γ in rad, and T_x, T_y in µm.
POSE = ("magnification", "alpha", "beta", "gamma", "tx", "ty")
#: Relative rounding error of an image point: one operation makes 1e-16, another order of the same
#: sums up to 1e-15. No decision depends on a smaller difference.
_ROUNDING = 1e-13
#: Singular values below this part of the largest are rounding errors: the points then do not
#: determine a pose, or their depths do not determine 1/T_z.
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Views:
    """Corresponding points of the pattern and of its images.

    Parameters
    ----------
    world : list of ndarray, shape (N_v, 2)
        Points of the pattern in each view, µm.
    image : list of ndarray, shape (N_v, 2)
        Their images, px from the middle of the image.
    frame : Microscope
        A microscope with the sensor of all views. Its lengths are not used.
    focal_length : float or None
        Focal length, µm, if it is given.
    """

    world: list[Array]
    image: list[Array]
    frame: Microscope
    focal_length: float | None

    @property
    def refusal(self) -> ValueError:
        """The error for points that no microscope fits."""
        if self.focal_length is None:
            return ValueError(
                "world and image must fit one microscope, none was found: "
                "leave out the outlying views"
            )
        return ValueError(
            f"focal_length must fit each view in focus, got {self.focal_length:g} µm: "
            "better leave it out"
        )

    def subset(self, which: ArrayLike) -> Views:
        """The views with the given indices."""
        world, image = ([each[v] for v in np.asarray(which)] for each in (self.world, self.image))
        return replace(self, world=world, image=image)

    def rounding_variance(self, poses: Array) -> float:
        """Variance of a coordinate by rounding alone, px²: a floor for every stated variance."""
        scaled = [
            pose[0] * world / self.frame.pitch
            for pose, world in zip(poses, self.world, strict=True)
        ]
        return float((_ROUNDING * max(np.abs(at).max() for at in (*scaled, *self.image))) ** 2)

    def residual_variance(self, fit: Fit) -> float:
        """Variance of a coordinate estimated from the residuals of a fit, px²."""
        return fit.rss / max(fit.dof, 1) + self.rounding_variance(fit.poses)

    def predict(self, lens: Array, poses: Array) -> tuple[Array, Array]:
        """Image points of all views, (N, 2), and their derivatives, (N, 2, 5 + 6 V).

        The first five derivatives are those by `LENS`; then follow six by the pose of each view.
        """
        points, jacobians = [], []
        for v, (pose, world) in enumerate(zip(poses, self.world, strict=True)):
            projected, by = self._project(lens, pose, world)
            first = len(LENS) + v * len(POSE)
            jacobian = np.zeros((len(world), 2, len(LENS) + poses.size))
            jacobian[..., : len(LENS)] = by[..., : len(LENS)]
            jacobian[..., first : first + len(POSE)] = by[..., len(LENS) :]
            points.append(projected)
            jacobians.append(jacobian)
        return np.concatenate(points), np.concatenate(jacobians)

    def _project(self, lens: Array, pose: Array, world: Array) -> tuple[Array, Array]:
        """Image points of one view, and their derivatives by `LENS` and `POSE`, (N, 2, 5 + 6)."""
        # The camera: h = 1/(f + d) = M/(T_op + f), and T_op + f = f (1 + M) in focus.
        inverse_principal, distortion, distortion_k2, *principal_point = lens
        magnification, h_by_inverse_principal = pose[0], pose[0]
        h_by_magnification = inverse_principal
        if self.focal_length is not None:
            inverse_principal = 1 / (self.focal_length * (1 + magnification))
            h_by_inverse_principal = 0.0
            h_by_magnification = inverse_principal / (1 + magnification)
        inverse_depth = magnification * inverse_principal
        camera = np.array([magnification, inverse_depth, distortion, *pose[1:]])
        points, by_camera = Microscope.project_plane(camera, world, self.frame.pitch)
        m = len(LENS)  # the column of the magnification; α to T_y follow
        camera_by = np.zeros((len(camera), m + len(POSE)))  # (M, h, κ, α … T_y) by all parameters
        camera_by[0, m] = 1.0
        camera_by[1, 0], camera_by[1, m] = h_by_inverse_principal, h_by_magnification
        camera_by[2, 1] = 1.0
        camera_by[3:, m + 1 :] = np.eye(len(pose) - 1)

        # The other terms of the lens: p (1 + κ₂ r⁴) + c, with r in µm of a point p that κ has
        # distorted. Its derivative by p is (1 + κ₂ r⁴) I + 2 κ₂ r² p (dr²/dp)ᵀ.
        sensor = points * self.frame.pitch
        r2 = (sensor**2).sum(axis=1)[:, np.newaxis]
        stretch = 1 + distortion_k2 * r2**2
        r2_by_points = 2 * sensor * self.frame.pitch
        by_points = stretch[..., np.newaxis] * np.eye(2)
        by_points += (2 * distortion_k2 * r2 * points)[:, :, np.newaxis] * r2_by_points[
            :, np.newaxis
        ]
        jacobian = by_points @ (by_camera @ camera_by)
        jacobian[..., 2] = r2**2 * points
        jacobian[..., 3:5] = np.eye(2)
        return points * stretch + principal_point, jacobian


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit of views.

    Parameters
    ----------
    lens : ndarray, shape (5,)
        Parameters of the lens as in `LENS`, the first as 1/(T_op + f).
    poses : ndarray, shape (V, 6)
        Parameters of the views as in `POSE`.
    free : list of int
        Indices of the fitted parameters in `lens` and `poses`, flat and joined. The first is that
        of the first view's magnification.
    residuals : ndarray, shape (2 N,)
        Projection minus image points, px.
    jacobian : ndarray, shape (2 N, p)
        Derivatives of the residuals by the fitted parameters.
    """

    lens: Array
    poses: Array
    free: list[int]
    residuals: Array
    jacobian: Array

    @property
    def rss(self) -> float:
        """Residual sum of squares, px²."""
        return float(self.residuals @ self.residuals)

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return len(self.residuals) - len(self.free)

    @property
    def estimate(self) -> Array:
        """Values of the fitted parameters, of the focal length 1/(T_op + f)."""
        return np.concatenate([self.lens, self.poses.ravel()])[self.free]

    @property
    def names(self) -> list[str]:
        """Names of the fitted parameters; from the second view on they end in its number."""
        each = [n if v == 0 else f"{n}_{v + 1}" for v in range(len(self.poses)) for n in POSE]
        return [[*LENS, *each][k] for k in self.free]


def fit_views(views: Views) -> tuple[Fit, list[list[Fit]]]:
    """Fit all views together, and each view alone from both signs of its tilt.

    Of the two fits of each view the better one comes first.
    """
    base = [1] if views.focal_length is not None else [0, 1]
    every = [views.subset([v]) for v in range(len(views.world))]
    fits = [[least_squares_fit(one, *start, base) for start in _starts(one)] for one in every]
    alone = [sorted(pair, key=lambda fit: fit.rss) for pair in fits]
    if len(every) == 1:
        return alone[0][0], alone
    lens = np.median([pair[0].lens for pair in alone], axis=0)
    best = least_squares_fit(views, lens, np.concatenate([pair[0].poses for pair in alone]), base)
    return best, alone


def least_squares_fit(views: Views, lens: Array, poses: Array, lens_free: list[int]) -> Fit:
    """Fit all poses and the given parameters of the lens by Levenberg–Marquardt from a start."""
    start = np.concatenate([lens, poses.ravel()])
    first = len(LENS)
    free = [first, *sorted(lens_free), *range(first + 1, len(start))]
    image = np.concatenate(views.image)

    def split(values: Array) -> tuple[Array, Array]:
        full = start.copy()
        full[free] = values
        return full[: len(LENS)], full[len(LENS) :].reshape(poses.shape)

    @lru_cache(maxsize=1)  # SciPy asks for the derivatives where it has asked for the residuals
    def evaluate(values: bytes) -> tuple[Array, Array]:
        points, jacobian = views.predict(*split(np.frombuffer(values)))
        return (points - image).ravel(), jacobian.reshape(-1, len(start))[:, free]

    if not np.isfinite(evaluate(start[free].tobytes())[0]).all():
        start[1] = 0.0  # the linear κ of a wide-angle lens may lie outside the domain of distort
    if not np.isfinite(evaluate(start[free].tobytes())[0]).all():
        raise views.refusal
    found = least_squares(
        lambda values: evaluate(values.tobytes())[0],
        start[free],
        lambda values: evaluate(values.tobytes())[1],
        method="lm",
        x_scale="jac",
        ftol=_ROUNDING,
        xtol=_ROUNDING,
        gtol=_ROUNDING,
        max_nfev=200,
    )
    # Parallel views determine no focal length: the search does not end in the flat valley of their
    # minimum, where its residuals are those of the noise. Here they are above a pixel, rms.
    if found.status == 0 and len(poses) > 1 and found.cost > len(image):
        raise views.refusal
    residuals, jacobian = evaluate(found.x.tobytes())
    lens, _ = split(found.x)
    # The images are equal with −1/(T_op + f) and the opposite tilts (β, γ).
    signs = np.ones(len(start))
    if lens[0] < 0:
        signs[0] = -1
        signs[first:].reshape(poses.shape)[:, 2:4] = -1
    lens, poses = split(found.x * signs[free])
    poses[:, 1:4] = np.angle(np.exp(1j * poses[:, 1:4]))  # to (−π, π]
    return Fit(lens, poses, free, residuals, jacobian * signs[free])


def _starts(one: Views) -> list[tuple[Array, Array]]:
    """Lens and pose of one view in closed form, for each sign of the tilt."""
    world, sensor = one.world[0], one.image[0] * one.frame.pitch
    alpha, beta, gamma, tx, ty = radial_alignment(world, sensor)
    starts = []
    for sign in (1, -1):
        rotation = euler_rotation(alpha, sign * beta, sign * gamma)
        turned = world @ rotation[:, :2].T
        depth = turned[:, 2] if one.focal_length is None else np.zeros(len(world))
        flat = turned[:, :2] + [tx, ty]
        magnification, distortion, inverse_depth = linear_intrinsics(flat, depth, sensor).tolist()
        lens = np.array([abs(inverse_depth / magnification), distortion, 0.0, 0.0, 0.0])
        starts.append((lens, np.array([[magnification, alpha, sign * beta, sign * gamma, tx, ty]])))
    return starts


def radial_alignment(world: ArrayLike, sensor: ArrayLike) -> Array:
    """Pose of a plane pattern from directions in the image alone.

    Perspective and radial distortion move an image point along its radius only, so that (u, v)
    stays parallel to (X, Y) whatever M, h and κ are (2.13).

    Parameters
    ----------
    world : array_like, shape (N, 2)
        Points of the pattern, µm.
    sensor : array_like, shape (N, 2)
        Their images (u, v), distorted, in µm from the principal point.

    Returns
    -------
    ndarray, shape (5,)
        (α, β, γ, T_x, T_y), rad and µm. (α, −β, −γ, T_x, T_y) explains the directions equally well.

    Raises
    ------
    ValueError
        If shapes disagree, or the points do not determine the pose.

    Notes
    -----
    From (2.13) and (2.5) with Z_w = 0, each point gives (2.14),

        u (r21 X_w + r22 Y_w + T_y) − v (r11 X_w + r12 Y_w + T_x) = 0.

    The thesis divides by T_y, as Tsai (1987) does; its printed row (2.15) should then read
    [v X_w, v Y_w, v, −u X_w, −u Y_w]. Here the six unknowns are kept and found up to scale by a
    singular value decomposition, which also serves when T_y is zero. The scale follows from the
    upper left block of a rotation having the singular values 1 and the absolute cosine of the tilt,
    the same condition that Tsai solves as a quadratic equation.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import radial_alignment
    >>> world = np.array([[0.0, 0], [300, 0], [0, 300], [300, 300], [150, -200]])
    >>> radial_alignment(world, 2 * (world + [50, -20])).round(6) + 0.0
    array([  0.,   0.,   0.,  50., -20.])
    """
    world = as_array("world", world, shape=(None, 2))
    sensor = as_array("sensor", sensor, shape=(None, 2))
    same_length(("world", "sensor"), world, sensor)
    center = world.mean(axis=0)
    scale = np.abs(world - center).max() or 1.0
    (x, y), (u, v) = ((world - center) / scale).T, (sensor / (np.abs(sensor).max() or 1.0)).T
    rows = np.column_stack([-v * x, -v * y, -v, u * x, u * y, u])
    # Of five points the sixth direction is in the full decomposition only.
    triangle = np.linalg.qr(rows, mode="r")
    singular, directions = np.linalg.svd(triangle)[1:]
    if len(world) < 5 or not singular[4] > _RANK_TOLERANCE * singular[0]:
        raise ValueError(
            f"world and sensor must determine a pose, got {len(world)} degenerate points"
        )
    r11, r12, tx, r21, r22, ty = directions[5]
    block, shift = np.array([[r11, r12], [r21, r22]]), scale * np.array([tx, ty])
    size = np.linalg.svd(block, compute_uv=False)[0]
    outward = ((block @ np.stack([x, y]) + [[tx], [ty]]) * np.stack([u, v])).sum()
    block, shift = block / np.copysign(size, outward), shift / np.copysign(size, outward)

    return np.concatenate([_euler_angles(block), shift - block @ center])


def _euler_angles(block: Array) -> Array:
    """(α, β, γ) of the rotation that is nearest to one with this upper left block, (2, 2)."""
    below = np.sqrt(np.maximum(1 - (block**2).sum(axis=0), 0))  # |r31|, |r32|
    below[1] = np.copysign(below[1], -(block[:, 0] @ block[:, 1]))
    columns = np.vstack([block, below])
    matrix = np.column_stack([columns, np.cross(*columns.T)])
    return Rotation.from_matrix(matrix).as_euler("ZYX")


def linear_intrinsics(flat: ArrayLike, depth: ArrayLike, sensor: ArrayLike) -> Array:
    """Magnification, distortion and inverse depth from a known pose, by linear least squares.

    Parameters
    ----------
    flat : array_like, shape (N, 2)
        (p, q) of (2.17): the points in the objective frame, X and Y, µm.
    depth : array_like, shape (N,)
        Z − T_z of the points, µm.
    sensor : array_like, shape (N, 2)
        (u, v), distorted, in µm from the principal point.

    Returns
    -------
    ndarray, shape (3,)
        M, κ in 1/µm², and h = 1/T_z in 1/µm; h is zero if all depths are.

    Raises
    ------
    ValueError
        If shapes disagree.

    Notes
    -----
    The thesis neglects the depth, (2.16), and adds the rows of u and v:
    M (p + q) − κ (u + v) r² = u + v (2.18), which makes the row of (2.19) [p + q, −(u + v) r²]:
    the κ printed in it is the unknown, and the sign is lost. A sum loses the points near the line
    p + q = 0, so here u and v keep their own rows; h adds a third column, −u (Z − T_z); its product
    with κ, a thousandth of either, is neglected.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import linear_intrinsics
    >>> flat = np.array([[100.0, 0], [0, 200], [-300, 50]])
    >>> linear_intrinsics(flat, np.zeros(3), 1.6 * flat).round(6) + 0.0
    array([1.6, 0. , 0. ])
    """
    flat = as_array("flat", flat, shape=(None, 2))
    depth = as_array("depth", depth, shape=(None,))
    sensor = as_array("sensor", sensor, shape=(None, 2))
    same_length(("flat", "sensor"), flat, sensor)
    same_length(("flat", "depth"), flat, depth)
    radius2 = (sensor**2).sum(axis=1, keepdims=True)
    rows = np.stack([flat, -sensor * radius2, -sensor * depth[:, None]], axis=-1).reshape(-1, 3)
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    return np.linalg.lstsq(rows / scale, sensor.ravel(), rcond=_RANK_TOLERANCE)[0] / scale
