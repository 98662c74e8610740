"""The covariance of a least-squares fit, also where the data leave a direction open."""

from __future__ import annotations

import numpy as np

from microlib._common._types import Array

__all__ = ["inverse_normal"]


def inverse_normal(jacobian: Array) -> Array:
    """
    Return (JᵀJ)⁻¹, or its pseudo-inverse in parameters of equal effect if it is singular.

    Scaling each parameter by its own effect keeps a direction that the data leave open from
    swamping the combinations that they determine.
    """
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
    scaled = jacobian / scale
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))
