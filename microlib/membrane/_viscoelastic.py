"""Force of a wall that relaxes, from the force that its shape would have at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, as_array


def viscoelastic_force(
    time: ArrayLike, elastic_force: ArrayLike, *, shares: ArrayLike, relaxation_times: ArrayLike
) -> Array:
    r"""Force over time of a membrane whose stress relaxes while its shape is held.

    Parameters
    ----------
    time : array_like, shape (n,)
        Times, ascending, in s.
    elastic_force : array_like, shape (..., n)
        Force :math:`F_e` that the shape at each time would have if nothing had relaxed, as any
        function of this package gives it with the instantaneous modulus, in µN or any other unit.
        It is taken as straight between the times, and as applied at once at the first.
    shares : array_like, shape (k,)
        Share :math:`g_i` of the force that relaxes with each time; their sum is at most 1. One
        share is the standard linear solid.
    relaxation_times : array_like, shape (k,)
        :math:`\tau_i`, in s.

    Returns
    -------
    ndarray, shape (..., n)
        Force, in the unit of `elastic_force`.

    Raises
    ------
    ValueError
        If the times do not ascend, the lengths differ, a share is negative or their sum above 1, or
        a relaxation time is not positive.

    Notes
    -----
    The law is quasi-linear (Fung): every force relaxes by the same function of time, however large
    the dimple, and the elastic force may depend on the shape in any way,

    .. math::

        F(t) = \int_{-\infty}^t g(t - s)\, \dot F_e(s)\, ds, \qquad
        g(t) = 1 - \sum_i g_i \left(1 - e^{-t/\tau_i}\right).

    Each exponential needs only its own last value, so that the integral is exact for a force that
    is straight between the times:
    :math:`q_i(t + \Delta) = e^{-\Delta/\tau_i} q_i(t) + g_i\, \Delta F_e\,
    (1 - e^{-\Delta/\tau_i})\, \tau_i/\Delta`.

    Examples
    --------
    >>> from microlib.membrane import viscoelastic_force
    >>> time = [0.0, 1.0, 2.0, 20.0]  # pressed within a second, and held
    >>> force = viscoelastic_force(
    ...     time, [0.0, 100.0, 100.0, 100.0], shares=[0.4], relaxation_times=[2.0]
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
            f"elastic_force must have a value for each of {t.size} times, got the shape "
            f"{elastic.shape}"
        )
    share = as_array("shares", shares, shape=(None,))
    tau = as_array("relaxation_times", relaxation_times, shape=share.shape)
    if (share < 0).any() or share.sum() > 1:
        raise ValueError(f"shares must be at least 0 and sum to at most 1, got {share.tolist()}")
    if (tau <= 0).any():
        raise ValueError(f"relaxation_times must be positive, got {tau.tolist()}")
    force = np.empty_like(elastic)
    held = elastic[..., :1] * share  # (..., k)
    force[..., 0] = elastic[..., 0]
    for k in range(1, t.size):
        x = (t[k] - t[k - 1]) / tau
        change = (elastic[..., k] - elastic[..., k - 1])[..., np.newaxis]
        held = np.exp(-x) * held - share * change * np.expm1(-x) / x
        force[..., k] = (1 - share.sum()) * elastic[..., k] + held.sum(axis=-1)
    return force
