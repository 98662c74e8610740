"""The elastic energy of a state, integrated from its stretches by formulas of the tests' own."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import simpson


def density(law: str, stretches: NDArray, nu: float = 0.5) -> NDArray:
    """Energy per undeformed volume of a modulus of 1, least over what wrinkles take up."""
    first, second = np.maximum(np.nan_to_num(stretches, nan=1.0), 1e-9)
    large, small = np.maximum(first, second), np.minimum(first, second)
    large = np.maximum(large, 1.0)
    if law == "hooke":
        small = np.maximum(small, 1 - nu * (large - 1))
        e1, e2 = large - 1, small - 1
        return (e1**2 + e2**2 + 2 * nu * e1 * e2) / (2 * (1 - nu**2))
    small = np.maximum(small, large**-0.5)
    third, ratio = 1 / (large * small), 0.2 if law == "mooney-rivlin" else 0.0
    one = large**2 + small**2 + third**2 - 3
    two = large**-2 + small**-2 + third**-2 - 3
    return (one + ratio * two) / (6 * (1 + ratio))


def stresses(law: str, stretches: NDArray, nu: float = 0.5) -> NDArray:
    """Nominal stresses of a modulus of 1: differences of the energy, which err by 3e-9."""
    steps = 1e-6 * np.eye(2)[:, :, None]
    up, down = (
        np.array([density(law, stretches + by * each, nu) for each in steps]) for by in (1, -1)
    )
    return (up - down) / 2e-6


def stored(state: Any, law: str, modulus: float, thickness: float, nu: float = 0.5) -> float:
    """Energy of the meridian, without what lies below the probe, in pJ."""
    first, second = np.nan_to_num(state.stretches, nan=1.0)
    rho = state.r / second
    arc = np.hypot(np.diff(state.r), np.diff(state.z))
    steps = arc * 2 / (first[1:] + first[:-1])
    along = np.append(0.0, np.cumsum(steps))
    per_arc = 2 * np.pi * rho * density(law, np.array([first, second]), nu)
    return modulus * thickness * float(simpson(per_arc, x=along))
