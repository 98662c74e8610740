"""The model without small slopes, against adaptive quadrature and its small-slope limit."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from microlib.membrane import finite_slope_modulus, steepest_depth

DATA = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}


def modulus_by_quadrature(force: float, a: float, depth: float) -> float:
    c, h, nu = DATA["probe_half_width"], DATA["thickness"], DATA["poisson_ratio"]

    def load(r: float) -> float:
        return 1 / r - r / a**2

    def depth_for(k: float) -> float:
        return quad(lambda r: k * load(r) / np.sqrt(1 - (k * load(r)) ** 2), c, a, limit=200)[0]

    k = brentq(lambda k: depth_for(k) - depth, 1e-6, (1 - 1e-9) / load(c))
    mean = quad(lambda r: (1 / np.sqrt(1 - (k * load(r)) ** 2) - 1) * r, c, a, limit=200)[0]
    strain = 0.5 * mean / ((a**2 - c**2) / 2)
    return force / (2 * np.pi * k * h) * (1 - nu) / strain


@pytest.mark.parametrize("depth", [6.5, 20.0, 49.0, 60.0])
def test_finite_slope_modulus_matches_adaptive_quadrature(depth: float) -> None:
    got = finite_slope_modulus(197.24, 246.95, depth, **DATA)
    # brentq's default tolerance on k and quad's 1.5e-8 near the root singularity.
    assert got == pytest.approx(modulus_by_quadrature(197.24, 246.95, depth), rel=1e-6)


def test_depth_above_steepest_raises() -> None:
    end = steepest_depth(246.95, probe_half_width=25.0)
    assert end == pytest.approx(61.74, abs=0.01)  # by quadrature, 61.738 µm
    assert np.isfinite(finite_slope_modulus(1.0, 246.95, end * 0.999, **DATA))
    # The thesis' own dimple is beyond the end.
    for depth in (end * 1.001, 121.22):
        with pytest.raises(ValueError, match=r"dimple_depth must be at most 61\.74 µm"):
            finite_slope_modulus(1.0, 246.95, depth, **DATA)
