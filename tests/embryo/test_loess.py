"""Local regression against statsmodels and against a direct fit."""

import numpy as np
import pytest
from statsmodels.nonparametric.smoothers_lowess import lowess

from microlib.embryo import loess

#: 100 points in no order; 0.29 of them are 29, but 28.999… by rounding.
RNG = np.random.default_rng(3)
X = RNG.uniform(0.0, 10.0, 100)
Y = np.sin(X) + RNG.normal(0.0, 0.2, X.size)
SPANS = [0.1, 0.25, 0.29, 0.7, 1.0]


def parabola(at: float, span: float) -> float:
    """The value of a local parabola by numpy's polyfit."""
    k = round(span * X.size)
    distance = np.abs(X - at)
    near = np.argsort(distance, kind="stable")[:k]
    tricube = (1 - (distance[near] / distance[near].max()) ** 3) ** 3
    # The furthest point has the weight 0 and polyfit wants the root of the weight.
    return np.polyfit(X[near] - at, Y[near], 2, w=np.sqrt(tricube))[-1]


@pytest.mark.parametrize("span", SPANS)
def test_degree_1_matches_statsmodels(span):
    peer = lowess(Y, X, frac=span, it=0, return_sorted=False)
    # Sums of some dozens of products in another order: rounding alone.
    np.testing.assert_allclose(loess(X, Y, span=span, degree=1), peer, rtol=0, atol=1e-10)


@pytest.mark.parametrize("span", SPANS)
def test_degree_2_matches_polyfit_at_each_point(span):
    direct = [parabola(at, span) for at in X]
    np.testing.assert_allclose(loess(X, Y, span=span), direct, atol=1e-9)
