"""The Jacobian of point features and the control laws of image-based visual servoing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    as_array,
    as_integer,
    as_positive,
    as_scalar,
    as_symmetric,
    check_same_length,
)


def point_jacobian(
    points: ArrayLike, *, depth: ArrayLike, magnification: float, pixel_pitch: ArrayLike
) -> Array:
    r"""Return the image Jacobian of points rigidly attached to the end effector (2.25).

    With weak perspective, :math:`x_s = M X / s_x` (2.21)–(2.22), its rate (2.23) and
    :math:`\dot P = V + Ω × P` (2.24),

    .. math::

        \begin{pmatrix} \dot x_s \\ \dot y_s \end{pmatrix} =
        \begin{pmatrix}
        \frac{M}{s_x} & 0 & 0 & 0 & \frac{M}{s_x} Z & -\frac{s_y}{s_x} y_s \\
        0 & \frac{M}{s_y} & 0 & -\frac{M}{s_y} Z & 0 & \frac{s_x}{s_y} x_s
        \end{pmatrix} (V_x, V_y, V_z, ω_x, ω_y, ω_z)^T .

    Parameters
    ----------
    points : array_like, shape (N, 2) or (2,)
        (x_s, y_s) in px from the image center.
    depth : array_like, shape (N,) or ()
        Z of the points in the objective's frame, µm.
    magnification : float
        Total magnification M.
    pixel_pitch : array_like, shape (2,) or ()
        Pixel pitch of the sensor along x and y, (s_x, s_y), µm; not the pixel size in the object
        plane.

    Returns
    -------
    ndarray, shape (2N, 6)
        Two rows (x, y) a point; px/µm for the translations and px/rad for the rotations.

    Raises
    ------
    ValueError
        If a shape does not fit, a value is not finite, or the magnification or a pixel pitch is not
        positive.

    Notes
    -----
    The thesis calls s_x and s_y effective pixel sizes, the name that §5.4 gives to s/M.
    Equation (2.22) holds for the pixel pitch of the sensor; with s/M the magnification would count
    twice.

    Examples
    --------
    >>> from microlib.servoing import point_jacobian
    >>> point_jacobian((10, 20), depth=0.0, magnification=1.6, pixel_pitch=8.0)
    array([[  0.2,   0. ,   0. ,   0. ,   0. , -20. ],
           [  0. ,   0.2,   0. ,  -0. ,   0. ,  10. ]])
    """
    xy = as_array("points", np.atleast_2d(as_array("points", points)), shape=(None, 2))
    z = as_array("depth", depth)
    z = as_array("depth", np.full(len(xy), z) if z.ndim == 0 else z, shape=(None,))
    check_same_length(("points", "depth"), xy, z)
    pitch = of_two_axes("pixel_pitch", pixel_pitch)
    scale_x, scale_y = as_scalar("magnification", magnification, above=0) / pitch
    aspect = pitch[1] / pitch[0]
    jacobian = np.zeros((len(xy), 2, 6))
    jacobian[:, 0, 0] = scale_x
    jacobian[:, 0, 4] = scale_x * z
    jacobian[:, 0, 5] = -aspect * xy[:, 1]
    jacobian[:, 1, 1] = scale_y
    jacobian[:, 1, 3] = -scale_y * z
    jacobian[:, 1, 5] = xy[:, 0] / aspect
    return jacobian.reshape(-1, 6)


def optimal_control(
    jacobian: ArrayLike,
    feature: ArrayLike,
    target: ArrayLike,
    *,
    interval: float,
    feature_weight: ArrayLike,
    control_weight: ArrayLike,
) -> Array:
    r"""Return the velocity (2.28), which minimizes the one-step cost (2.27).

    The features follow f(k+1) = f(k) + T J u(k) (2.26).

    .. math:: u(k) = -(T J^T Q T J + L)^{-1}\, T J^T Q\, (f(k) - f^*(k+1))

    Parameters
    ----------
    jacobian : array_like, shape (m, n)
        Image Jacobian at f(k).
    feature : array_like, shape (m,)
        f(k), the features as measured.
    target : array_like, shape (m,)
        f*(k+1), the features wanted at the *next* sample.
    interval : float
        Sampling time T in s.
    feature_weight : array_like, shape (m, m) or (m,)
        Q, symmetric and positive definite, or its diagonal.
    control_weight : array_like, shape (n, n) or (n,)
        L, likewise.

    Returns
    -------
    ndarray, shape (n,)
        Velocity u(k), in the unit of length of the Jacobian per second.

    Raises
    ------
    ValueError
        If a shape does not fit, the interval is not positive, a weight is not symmetric and
        positive definite, or the Jacobian is singular.

    Notes
    -----
    L has the unit px²·s²/length², so that its number means nothing without the Jacobian's
    unit of length: the weights of §5.4 make a nearly dead-beat loop with px/mm and one of minutes
    with px/µm.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.servoing import optimal_control
    >>> optimal_control(np.eye(2), (0, 0), (1, -2), interval=1.0,
    ...                 feature_weight=(1, 1), control_weight=(1, 3))
    array([ 0.5, -0.5])
    """
    gain = OptimalController(
        jacobian, interval=interval, feature_weight=feature_weight, control_weight=control_weight
    ).gain
    now = as_array("feature", feature, shape=(gain.shape[1],))
    goal = as_array("target", target, shape=(gain.shape[1],))
    return gain @ (goal - now)


def ibvs_control(
    jacobian: ArrayLike, error: ArrayLike, *, gain: float, drift: ArrayLike | None = None
) -> Array:
    r"""Return the classical proportional law (2.3), which makes the error decay as exp(−λt).

    The error e = f − f* (2.1) changes as J r + ∂e/∂t (2.2); with an exact Jacobian the law cancels
    the drift and leaves the decay, with an estimated one (2.4) holds.

    .. math:: \dot r = -λ J^+ e - J^+ \widehat{\partial e / \partial t}

    Parameters
    ----------
    jacobian : array_like, shape (m, n)
        Image Jacobian.
    error : array_like, shape (m,)
        e = f − f* in px.
    gain : float
        λ in 1/s.
    drift : array_like, shape (m,), optional
        ∂e/∂t in px/s: how the error changes while the end effector rests; none by default.

    Returns
    -------
    ndarray, shape (n,)
        Velocity, in the unit of length of the Jacobian per second.

    Raises
    ------
    ValueError
        If a shape does not fit, the gain is not positive, or the Jacobian is singular.

    Examples
    --------
    >>> from microlib.servoing import ibvs_control
    >>> ibvs_control([[0.5, 0.0], [0.0, 0.5]], (1.0, -1.0), gain=2.0)
    array([-4.,  4.])
    """
    matrix = full_rank(jacobian)
    rate = -as_scalar("gain", gain, above=0) * as_array("error", error, shape=(len(matrix),))
    if drift is not None:
        rate = rate - as_array("drift", drift, shape=(len(matrix),))
    return np.linalg.pinv(matrix) @ rate


def loop_poles(gain: float, delay: float = 0.0) -> NDArray[np.complex128]:
    """Return the closed-loop poles of an integrator under delayed proportional control.

    A command that takes effect `delay` = n + θ samples late moves the feature by
    f(k+1) = f(k) + (1 − θ) u(k−n) + θ u(k−n−1); with u = −g f the poles solve

        z^(n+1) (z − 1) + g ((1 − θ) z + θ) = 0.

    Without delay that is z (z − 1 + g), with one sample z (z² − z + g), stable for g < 1.

    Parameters
    ----------
    gain : float
        Loop gain g: share of the error that one sample takes away without delay.
    delay : float, optional
        Delay in samples.

    Returns
    -------
    ndarray of complex
        Poles, largest modulus first; the loop is stable if it is below 1.

    Raises
    ------
    ValueError
        If the gain is not positive or the delay is negative.

    Examples
    --------
    >>> from microlib.servoing import loop_poles
    >>> abs(loop_poles(0.81, 1.0)).round(3)
    array([0.9, 0.9, 0. ])
    """
    g = as_scalar("gain", gain, above=0)
    # A longer delay is one in ms: the poles of a thousand samples take ten seconds.
    samples, part = divmod(as_scalar("delay", delay, least=0, most=200), 1.0)
    polynomial = np.zeros(int(samples) + 3)
    polynomial[:2] = 1.0, -1.0
    polynomial[-2:] += g * (1.0 - part), g * part
    poles = np.roots(polynomial)
    return poles[np.argsort(-np.abs(poles))].astype(np.complex128)


class OptimalController:
    """Controller (2.28) with a constant Jacobian, which steers to the reference of the next sample.

    Parameters
    ----------
    jacobian : array_like, shape (m, n)
        px/µm, as calibrated.
    interval, feature_weight, control_weight
        As in `optimal_control`, with the Jacobian's µm as the unit of length.

    Attributes
    ----------
    gain : ndarray, shape (n, m)
        K of (2.28), which turns a feature error into a velocity, u = −K e, µm/s per px. The gain of
        the loop is T·J·K: the share of the error that one sample takes away.

    Raises
    ------
    ValueError
        If a shape does not fit, the interval is not positive, a weight is not symmetric and
        positive definite, or the Jacobian is singular.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.servoing import OptimalController
    >>> control = OptimalController(
    ...     np.eye(2), interval=0.5, feature_weight=(1, 1), control_weight=(0.25, 0.25)
    ... )
    >>> control(0, np.zeros(2), np.array([[0.0, 0.0], [1.0, 2.0]]))
    array([1., 2.])
    >>> control.gain
    array([[1., 0.],
           [0., 1.]])
    """

    def __init__(
        self,
        jacobian: ArrayLike,
        *,
        interval: float,
        feature_weight: ArrayLike,
        control_weight: ArrayLike,
    ) -> None:
        matrix = full_rank(jacobian)
        step = as_scalar("interval", interval, above=0) * matrix
        q = _weight("feature_weight", feature_weight, matrix.shape[0])
        weight = _weight("control_weight", control_weight, matrix.shape[1])
        self.gain = np.linalg.solve(step.T @ q @ step + weight, step.T @ q)

    def __call__(self, k: int, measured: Array, reference: Array) -> Array:
        """Return the velocity for sample `k`, µm/s; zero if the feature is lost.

        `measured` has the shape (m,), or (N, m) for N runs at once, which gives N velocities.
        """
        features = self.gain.shape[1]
        measured = as_array("measured", measured, finite=False)
        shape = (*measured.shape[:-1], features)
        measured = as_array("measured", measured, shape=shape, finite=False)
        reference = as_array("reference", reference, shape=(None, features))
        error = reference[min(as_integer("k", k, least=0) + 1, len(reference) - 1)] - measured
        seen = np.isfinite(measured).all(axis=-1, keepdims=True)
        return np.where(seen, error, 0.0) @ self.gain.T


def of_two_axes(name: str, value: ArrayLike) -> Array:
    """Return two positive numbers, given as such or as one for both axes."""
    numbers = as_positive(name, value)
    return as_array(name, np.full(2, numbers) if numbers.ndim == 0 else numbers, shape=(2,))


def full_rank(jacobian: ArrayLike, shape: tuple[int | None, ...] = (None, None)) -> Array:
    """Return a Jacobian of full rank, or a stack of them."""
    matrix = as_array("jacobian", jacobian, shape=shape).copy()  # it is kept
    values = np.linalg.svd(matrix, compute_uv=False)
    # The rounding of a double is a millionth of what the weakest direction then does.
    if (values[..., -1] * 1e10 <= values[..., 0]).any():
        raise ValueError(
            "jacobian must have full rank without the motions that the features do not show, "
            f"got singular values from {values.min():.3g} to {values.max():.3g}"
        )
    return matrix


def _weight(name: str, value: ArrayLike, size: int) -> Array:
    weight = as_array(name, value)
    return as_symmetric(name, np.diag(weight) if weight.ndim == 1 else weight, size, definite=True)
