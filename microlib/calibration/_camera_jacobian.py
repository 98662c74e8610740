"""Projection of the pattern plane in the parameters that its points can see, with derivatives.

The points see the three lengths of a :class:`~microlib.microscope.Microscope` only as the
magnification M = (T_op + f)/(f + d) and the convergence h = 1/T_z = 1/(f + d), how fast the scale
changes with depth:

    u' = M X / (1 + h Z_r),   Z_r = r31 X_w + r32 Y_w

(2.9 divided through by T_z). This form stays smooth up to the telecentric limit h = 0 and beyond
it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array
from microlib.microscope import Microscope, distort, euler_rotation

__all__ = ["PARAMETERS", "cramer_rao", "project_plane", "projection_jacobian"]


#: The parameters of a microscope, in the order of :func:`projection_jacobian`.
PARAMETERS = (
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


def project_plane(visible: Array, world: Array, cell: Array) -> tuple[Array, Array]:
    """Image of points of the pattern plane, and its derivatives.

    Parameters
    ----------
    visible : ndarray, shape (8,)
        (M, h, κ, α, β, γ, T_x, T_y); h in 1/µm, κ in 1/µm², angles in rad, T in µm.
    world : ndarray, shape (N, 2)
        (X_w, Y_w), µm.
    cell : ndarray, shape (2,)
        Pitch of the sensor cells, µm.

    Returns
    -------
    points : ndarray, shape (N, 2)
        (x, y) from the principal point, px.
    jacobian : ndarray, shape (N, 2, 8)
        Their derivatives by `visible`.
    """
    magnification, convergence, distortion, alpha, beta, gamma, tx, ty = visible
    rotation = euler_rotation(alpha, beta, gamma)
    turned = world @ rotation[:, :2].T  # (N, 3): X − T_x, Y − T_y, Z − T_z
    flat = turned[:, :2] + [tx, ty]
    shrink = 1 / (1 + convergence * turned[:, 2])
    undistorted = magnification * flat * shrink[:, None]

    by = np.empty((len(world), 2, 8))
    by[..., 0] = flat * shrink[:, None]
    by[..., 1] = -undistorted * (shrink * turned[:, 2])[:, None]
    # Rotating about the axis a changes a point by a × point.
    axes = {
        3: np.array([0.0, 0.0, 1.0]),
        4: np.array([-np.sin(alpha), np.cos(alpha), 0.0]),
        5: rotation[:, 0],
    }
    for column, axis in axes.items():
        moved = np.cross(axis, turned)
        depth = -undistorted * (convergence * shrink * moved[:, 2])[:, None]
        by[..., column] = magnification * moved[:, :2] * shrink[:, None] + depth
    by[..., 6:] = magnification * shrink[:, None, None] * np.eye(2)

    sensor = distort(undistorted, distortion)
    radius2 = (sensor**2).sum(axis=1)
    by[..., 2] = -sensor * radius2[:, None]
    # (2.10) differentiated: its left side depends on the distorted point.
    bend = (1 + distortion * radius2)[:, None, None] * np.eye(2)
    bend = bend + 2 * distortion * sensor[:, :, None] * sensor[:, None, :]
    return sensor / cell, np.linalg.solve(bend, by) / cell[:, None]


def projection_jacobian(
    microscope: Microscope, world: ArrayLike, parameters: tuple[str, ...] = PARAMETERS
) -> Array:
    """Derivatives of the image points by the parameters of the microscope.

    Parameters
    ----------
    microscope : Microscope
        Where the derivatives are taken.
    world : array_like, shape (N, 2)
        Points of the pattern plane, µm.
    parameters : tuple of str
        Names of fields of `microscope`, any of ``PARAMETERS``; or "magnification" or "focus",
        which is f with the plane kept in focus at the same magnification, T_op = M f and d = f/M.

    Returns
    -------
    ndarray, shape (N, 2, p)
        px per unit of each parameter (µm, rad, 1/µm²).

    Raises
    ------
    ValueError
        If `world` has another shape, is empty or not finite, or a name is unknown.
    """
    world = as_array("world", world, shape=(None, 2))
    m = microscope
    depth = m.focal_length + m.distance
    visible = np.array(
        [m.magnification, 1 / depth, m.distortion, m.alpha, m.beta, m.gamma, m.tx, m.ty]
    )
    by = project_plane(visible, world, m.cell)[1]
    by_range = by[..., 0] / depth  # T_op + f, at constant f + d
    by_depth = -(m.magnification * by[..., 0] + by[..., 1] / depth) / depth  # f + d
    columns = {
        "tube_length": by_range,
        "focal_length": by_range + by_depth,
        "distance": by_depth,
        "magnification": by[..., 0],
        "focus": -by[..., 1] / (depth * m.focal_length),
        **{name: by[..., 2 + k] for k, name in enumerate(PARAMETERS[3:])},
    }
    unknown = [name for name in parameters if name not in columns]
    if unknown:
        raise ValueError(f"parameters must be among {', '.join(columns)}, got {unknown}")
    return np.stack([columns[name] for name in parameters], axis=-1)


def cramer_rao(
    microscope: Microscope, world: ArrayLike, noise: float, parameters: tuple[str, ...]
) -> Array:
    """Smallest covariance any unbiased estimate of `parameters` can have.

    Parameters
    ----------
    microscope : Microscope
        The truth.
    world : array_like, shape (N, 2)
        Points of the pattern plane, µm.
    noise : float
        Standard deviation of each coordinate of the image points, px.
    parameters : tuple of str
        What is estimated together, see :func:`projection_jacobian`; the others are known.

    Returns
    -------
    ndarray, shape (p, p)
        (JᵀJ)⁻¹ σ²; infinite variances, and NaN beside them, for the parameters that take part in a
        direction the points do not determine.

    Examples
    --------
    No set of points on a plane determines the three lengths:

    >>> scope = Microscope(200490, 126150, 78750, beta=0.05)
    >>> x, y = np.meshgrid(np.linspace(-1500, 1500, 7), np.linspace(-1000, 1000, 5))
    >>> world = np.column_stack([x.ravel(), y.ravel()])
    >>> np.diag(cramer_rao(scope, world, 0.02, ("tube_length", "focal_length", "distance")))
    array([inf, inf, inf])
    """
    jacobian = projection_jacobian(microscope, world, parameters).reshape(-1, len(parameters))
    return noise**2 * information_inverse(jacobian)


def information_inverse(jacobian: Array) -> Array:
    """(JᵀJ)⁻¹, with infinite variance for the parameters of an undetermined direction and NaN
    beside it."""
    scale = np.linalg.norm(jacobian, axis=0)
    blind = scale == 0
    scale = np.where(blind, 1.0, scale)
    _, singular, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    lost = singular < 1e-9 * singular[0]
    kept = directions[~lost].T / singular[~lost]
    inverse = kept @ kept.T / np.outer(scale, scale)
    hidden = blind | (np.abs(directions[lost]) > 1e-6).any(axis=0)
    inverse[hidden] = inverse[:, hidden] = np.nan
    inverse[hidden, hidden] = np.inf
    return inverse
