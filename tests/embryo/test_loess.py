"""Local regression against statsmodels and against a direct fit."""

import numpy as np
import pytest
from statsmodels.nonparametric.smoothers_lowess import lowess

from microlib.embryo import loess

#: 100 points in random order. The span 0.29 is 29 of them, though 0.29 · 100 is 28.999… in doubles.
RNG = np.random.default_rng(3)
X = RNG.uniform(0.0, 10.0, 100)
Y = np.sin(X) + RNG.normal(0.0, 0.2, X.size)
SPANS = [0.1, 0.25, 0.29, 0.7, 1.0]


def parabola(at: float, span: float) -> float:
    """Return the value at `at` of a local parabola that numpy's polyfit fits."""
    k = round(span * X.size)
    distance = np.abs(X - at)
    near = np.argsort(distance, kind="stable")[:k]
    tricube = (1 - (distance[near] / distance[near].max()) ** 3) ** 3
    # polyfit takes the square roots of the weights.
    return np.polyfit(X[near] - at, Y[near], 2, w=np.sqrt(tricube))[-1]


@pytest.mark.parametrize("span", SPANS)
def test_degree_1_matches_statsmodels(span):
    peer = lowess(Y, X, frac=span, it=0, return_sorted=False)
    # The terms of the sums have another order, so only rounding differs.
    np.testing.assert_allclose(loess(X, Y, span=span, degree=1), peer, rtol=0, atol=1e-10)


@pytest.mark.parametrize("span", SPANS)
def test_degree_2_matches_polyfit_at_each_point(span):
    direct = [parabola(at, span) for at in X]
    np.testing.assert_allclose(
        loess(X, Y, **{} if span == 0.25 else {"span": span}), direct, atol=1e-9
    )
