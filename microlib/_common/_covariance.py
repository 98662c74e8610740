"""The covariance of a least-squares fit, also where a direction is undetermined."""

from __future__ import annotations

import numpy as np

from microlib._common._types import Array

#: A direction of the scaled parameters is undetermined if its singular value is below this part of
#: the largest. Rounding leaves it at 1e-16 to 1e-15. The weakest determined directions of the
#: tests, two nearly equal terms of a Gaussian sum, reach down to 1e-7.
_UNDETERMINED = 1e-9


def inverse_normal(jacobian: Array) -> Array:
    """Invert JᵀJ, the normal matrix of a least-squares problem: its covariance for unit errors.

    Parameters
    ----------
    jacobian : ndarray, shape (m, p)
        J, the derivatives of m residuals by p parameters, in any units.

    Returns
    -------
    ndarray, shape (p, p)
        (JᵀJ)⁻¹. Each parameter that takes part in an undetermined direction has an infinite
        variance and NaN covariances: it could have any value. The block of the other parameters is
        their covariance whatever the values of the undetermined ones.

    Notes
    -----
    The singular values are those of J with each column divided by its length, so that the answer
    does not depend on the parameters' units. J itself is decomposed, not JᵀJ, whose rounding would
    hide directions 10⁸ times weaker than the strongest.

    Examples
    --------
    A line through one place: neither slope nor height is known there, but the third number is.

    >>> import numpy as np
    >>> from microlib._common._covariance import inverse_normal
    >>> inverse_normal(np.array([[2.0, 1.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 2.0]]))
    array([[ inf,  nan,  nan],
           [ nan,  inf,  nan],
           [ nan,  nan, 0.25]])
    """
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale == 0, 1.0, scale)
    # The triangle has the singular values and the directions of all rows. With fewer residuals than
    # parameters the full decomposition has the undetermined directions, too.
    _, singular, directions = np.linalg.svd(np.linalg.qr(jacobian / scale, mode="r"))
    determined = np.count_nonzero(singular > _UNDETERMINED * singular[0])
    kept = directions[:determined].T / singular[:determined]
    inverse = kept @ kept.T / np.outer(scale, scale)
    # Where a parameter takes no part, rounding leaves components of 1e-16/_UNDETERMINED at most.
    hidden = (np.abs(directions[determined:]) > 1e-6).any(axis=0)
    inverse[hidden] = inverse[:, hidden] = np.nan
    inverse[hidden, hidden] = np.inf
    return inverse
