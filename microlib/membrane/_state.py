"""What every solved membrane has in common: the result, and the proof that it is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from microlib._common import Array, Tidy

__all__ = ["MembraneState", "gauss_points", "reintegration_error"]

Slopes = Callable[[Array, Array], Array]

_SUBSTEPS = 4
_GAUSS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, eq=False)
class MembraneState(Tidy):
    r"""
    A membrane in equilibrium under a probe, from `indent_disc` or `indent_capsule`.

    Attributes
    ----------
    depth : float
        Depth of the probe's edge below the rim, in µm.
    approach : float
        How far the probe has moved since it touched, in µm.
    rim_radius : float
        Radius a of the rim, in µm: the clamped edge of a disc, the crest of a capsule's dimple.
    r, z : (N,) ndarray
        The meridian from the probe's edge to the disc's rim or to the middle of the plate: distance
        from the axis, and height above the rim's plane or the plate, in µm.
    stretches : (2, N) ndarray
        Along the meridian and around the axis, from the stress-free membrane; NaN where slack.
    stresses : (2, N) ndarray
        Nominal stresses in the same directions, force over undeformed section, in MPa; zero around
        the axis where the membrane is wrinkled.
    pressure : float
        Pressure below the disc, or inside the capsule above that outside, in MPa.
    contact_radius : float
        Radius on which the membrane touches its support: the disc's rim, or the capsule's flat
        circle on the plate, in µm.
    energy : float
        Elastic energy stored since the membrane was free of stress, in pJ (µN·µm).
    volume : float
        Volume between a disc and its rim's plane, or inside the capsule, in µm³.

    Notes
    -----
    The true stress is :math:`\lambda_i` times the nominal one in an incompressible membrane.
    """

    _samples = ("r", "z", "stretches", "stresses")

    depth: float
    approach: float
    rim_radius: float
    r: Array
    z: Array
    stretches: Array
    stresses: Array
    pressure: float
    contact_radius: float
    energy: float
    volume: float


def gauss_points(mesh: Array) -> tuple[Array, Array]:
    """Return five abscissae in every interval of `mesh`, and their weights."""
    nodes, weights = _GAUSS
    half = np.diff(mesh)[:, None] / 2
    points = (mesh[:-1, None] + half) + half * nodes
    return points.ravel(), (half * weights).ravel()


def reintegration_error(slopes: Slopes, mesh: Array, values: Array) -> float:
    """Return how far Runge–Kutta, started at every node, misses the next node; relative."""
    step = np.diff(mesh) / _SUBSTEPS
    x, y = mesh[:-1].copy(), values[:, :-1].copy()
    for _ in range(_SUBSTEPS):
        k1 = slopes(x, y)
        k2 = slopes(x + step / 2, y + step / 2 * k1)
        k3 = slopes(x + step / 2, y + step / 2 * k2)
        k4 = slopes(x + step, y + step * k3)
        x, y = x + step, y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    # The states are scaled to about 1; one that is zero throughout has no size of its own.
    size = np.maximum(np.abs(values).max(axis=1, keepdims=True), 0.1)
    # Summed over the intervals: errors of one sign would pile up so far.
    return float((np.abs(y - values[:, 1:]) / size).sum(axis=1).max())
