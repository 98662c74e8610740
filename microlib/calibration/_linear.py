"""Pose, magnification and distortion of one view in closed form (2.13)–(2.19)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from microlib._common import Array, as_array, check_same_length

#: Singular values below this part of the largest are rounding errors: the points then do not
#: determine a pose, or their depths do not determine 1/T_z.
_RANK_TOLERANCE = 1e-9


def radial_alignment(world: ArrayLike, sensor: ArrayLike) -> Array:
    """Return the pose of a plane pattern from the directions of its points in the image.

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
    check_same_length(("world", "sensor"), world, sensor)
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
    # (X, Y) and (u, v) point the same way: M > 0.
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
    """Return the magnification, distortion and 1/distance of a plane from its known pose.

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
    check_same_length(("flat", "sensor"), flat, sensor)
    check_same_length(("flat", "depth"), flat, depth)
    radius2 = (sensor**2).sum(axis=1, keepdims=True)
    rows = np.stack([flat, -sensor * radius2, -sensor * depth[:, None]], axis=-1).reshape(-1, 3)
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    return np.linalg.lstsq(rows / scale, sensor.ravel(), rcond=_RANK_TOLERANCE)[0] / scale
