"""Local regression against statsmodels, against a direct fit, and its laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from statsmodels.nonparametric.smoothers_lowess import lowess

from microlib.embryo import loess

# Sums of a few hundred products in another order: rounding alone. The issue asks for 1e-8.
SAME = 1e-10


def noisy(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0.0, 10.0, n))
    return x, np.sin(x) + rng.normal(0.0, 0.2, n)


def directly(x: np.ndarray, y: np.ndarray, span: float) -> np.ndarray:
    """Local parabolas by numpy's polyfit, one point at a time."""
    k = int(span * len(x) + 1e-10)
    smooth = []
    for at in x:
        distance = np.abs(x - at)
        near = np.argsort(distance, kind="stable")[:k]
        tricube = (1 - (distance[near] / distance[near].max()) ** 3) ** 3
        # The furthest point has the weight 0 and polyfit wants the root of the weight.
        fit = np.polyfit(x[near] - at, y[near], 2, w=np.sqrt(tricube))
        smooth.append(fit[-1])
    return np.array(smooth)


@settings(deadline=None, max_examples=30)
@given(
    n=st.integers(20, 200),
    seed=st.integers(0, 10_000),
    span=st.floats(0.25, 1.0),
)
def test_degree_1_matches_statsmodels(n, seed, span):
    x, y = noisy(n, seed)
    peer = lowess(y, x, frac=span, it=0, return_sorted=False)
    ours = loess(x, y, span=span, degree=1)
    np.testing.assert_allclose(ours, peer, rtol=0, atol=SAME)


@pytest.mark.parametrize("span", [0.1, 0.25, 0.7, 1.0])
def test_degree_2_matches_polyfit_at_each_point(span):
    x, y = noisy(150, 3)
    np.testing.assert_allclose(loess(x, y, span=span), directly(x, y, span), atol=1e-9)
