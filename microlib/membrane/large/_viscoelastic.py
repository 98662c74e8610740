"""Force of a viscoelastic wall from the elastic force of its shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array


def viscoelastic_force(
    time: ArrayLike,
    elastic_force: ArrayLike,
    *,
    prony_coefficients: ArrayLike,
    relaxation_times: ArrayLike,
) -> Array:
    r"""Force over time of a viscoelastic membrane, by Fung's quasi-linear law.

    Parameters
    ----------
    time : array_like, shape (n,)
        Times, ascending, in s.
    elastic_force : array_like, shape (..., n)
        Elastic force :math:`F_e` of the shape at each time, in µN or any other unit. Any function
        of this package computes it from the instantaneous modulus. The force is interpolated
        linearly between the times, and the force at the first time is applied instantaneously.
    prony_coefficients : array_like, shape (k,)
        Coefficients :math:`g_i` of the Prony series: the fraction of the force that relaxes with
        each relaxation time. Their sum is at most 1. One coefficient is the standard linear solid.
    relaxation_times : array_like, shape (k,)
        Relaxation times :math:`\tau_i`, in s.

    Returns
    -------
    ndarray, shape (..., n)
        Force, in the unit of `elastic_force`.

    Raises
    ------
    ValueError
        If the times do not ascend, the lengths differ, a coefficient is negative, the sum of the
        coefficients is above 1, or a relaxation time is not positive.

    Notes
    -----
    The quasi-linear law assumes that every force relaxes by the same function of time, whatever the
    depth of the dimple. The elastic force may be any function of the shape:

    .. math::

        F(t) = \int_{-\infty}^t g(t - s)\, \dot F_e(s)\, ds, \qquad
        g(t) = 1 - \sum_i g_i \left(1 - e^{-t/\tau_i}\right).

    The integral is exact for a force that is linear between the times. The relaxing part of each
    term is :math:`q_i(t + \Delta) = e^{-\Delta/\tau_i} q_i(t) + g_i\, \Delta F_e\,
    (1 - e^{-\Delta/\tau_i})\, \tau_i/\Delta`.

    Examples
    --------
    >>> from microlib.membrane import viscoelastic_force
    >>> time = [0.0, 1.0, 2.0, 20.0]  # pressed within a second, and held
    >>> force = viscoelastic_force(
    ...     time, [0.0, 100.0, 100.0, 100.0], prony_coefficients=[0.4], relaxation_times=[2.0]
    ... )
    >>> print(force.round(1))
    [ 0.  91.5 79.1 60. ]
    """
    t = as_array("time", time, shape=(None,))
    if not (np.diff(t) > 0).all():
        raise ValueError(f"time must ascend, got {t.tolist()[:4]}")
    elastic = as_array("elastic_force", elastic_force)
    if elastic.ndim == 0 or elastic.shape[-1] != t.size:
        raise ValueError(
            f"elastic_force must have one value for each of {t.size} times, got shape "
            f"{elastic.shape}"
        )
    g = as_array("prony_coefficients", prony_coefficients, shape=(None,))
    tau = as_array("relaxation_times", relaxation_times, shape=g.shape)
    if (g < 0).any() or g.sum() > 1:
        raise ValueError(f"prony_coefficients must be >= 0 and sum to at most 1, got {g.tolist()}")
    if (tau <= 0).any():
        raise ValueError(f"relaxation_times must be positive, got {tau.tolist()}")
    force = np.empty_like(elastic)
    relaxing = elastic[..., :1] * g  # (..., k)
    force[..., 0] = elastic[..., 0]
    for k in range(1, t.size):
        x = (t[k] - t[k - 1]) / tau
        change = (elastic[..., k] - elastic[..., k - 1])[..., np.newaxis]
        relaxing = np.exp(-x) * relaxing - g * change * np.expm1(-x) / x
        force[..., k] = (1 - g.sum()) * elastic[..., k] + relaxing.sum(axis=-1)
    return force
