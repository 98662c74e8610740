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


def directly(x: np.ndarray, y: np.ndarray, span: float, weights: np.ndarray) -> np.ndarray:
    """Local parabolas by numpy's polyfit, one point at a time."""
    k = int(span * len(x) + 1e-10)
    smooth = []
    for at in x:
        distance = np.abs(x - at)
        near = np.argsort(distance, kind="stable")[:k]
        tricube = (1 - (distance[near] / distance[near].max()) ** 3) ** 3 * weights[near]
        # The furthest point has the weight 0 and polyfit wants the root of the weight.
        fit = np.polyfit(x[near] - at, y[near], 2, w=np.sqrt(tricube))
        smooth.append(fit[-1])
    return np.array(smooth)


@settings(deadline=None, max_examples=30)
@given(
    n=st.integers(20, 200),
    seed=st.integers(0, 10_000),
    span=st.floats(0.25, 1.0),
    rounds=st.integers(0, 3),
)
def test_first_degree_equals_statsmodels(n, seed, span, rounds):
    x, y = noisy(n, seed)
    peer = lowess(y, x, frac=span, it=rounds, return_sorted=False)
    ours = loess(x, y, span=span, degree=1, robust_iterations=rounds)
    np.testing.assert_allclose(ours, peer, rtol=0, atol=SAME)


@pytest.mark.parametrize("span", [0.1, 0.25, 0.7, 1.0])
def test_second_degree_equals_a_direct_fit(span):
    x, y = noisy(150, 3)
    weights = np.random.default_rng(1).uniform(0.2, 3.0, x.size)
    np.testing.assert_allclose(
        loess(x, y, span=span, weights=weights), directly(x, y, span, weights), atol=1e-9
    )
    assert not np.allclose(loess(x, y, span=span), directly(x, y, span, weights), atol=1e-4)


@settings(deadline=None, max_examples=20)
@given(coefficients=st.tuples(*[st.floats(-3, 3)] * 3), seed=st.integers(0, 100))
def test_a_parabola_passes_unchanged(coefficients, seed):
    x, _ = noisy(60, seed)
    y = np.polyval(coefficients, x)
    np.testing.assert_allclose(loess(x, y, span=0.3), y, atol=1e-7)


def test_order_of_the_points_does_not_matter():
    x, y = noisy(80, 5)
    shuffled = np.random.default_rng(0).permutation(80)
    np.testing.assert_array_equal(loess(x[shuffled], y[shuffled]), loess(x, y)[shuffled])


def test_robust_iterations_leave_an_outlier_out():
    x = np.linspace(0, 10, 101)
    y = np.sin(x)
    spoiled = y.copy()
    spoiled[50] += 20
    plain = np.abs(loess(x, spoiled) - y)[40:61].max()
    robust = np.abs(loess(x, spoiled, robust_iterations=4) - y)[40:61].max()
    # The outlier pulls the plain fit by a quarter of its height; the robust one keeps only the
    # smoothing error of a sine over a quarter of its range, 0.02.
    assert plain > 1.0
    assert robust < 0.03


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"y": np.zeros(9)}, "same length"),
        ({"x": np.r_[np.nan, np.arange(9.0)]}, "x must be finite"),
        ({"span": 0.0}, r"span must lie in \(0, 1\]"),
        ({"span": 1.2}, r"span must lie in \(0, 1\]"),
        ({"span": 0.2}, "span must hold at least 3 points"),
        ({"degree": 3}, "degree must lie in"),
        ({"robust_iterations": -1}, "robust_iterations must be"),
        ({"weights": np.zeros(10)}, "weights must be positive"),
        ({"x": np.ones(10)}, "3 different values"),
        ({"x": np.repeat([0.0, 1.0], 5), "span": 0.8}, "3 different values"),
    ],
)
def test_refusals(change, message):
    call = {"x": np.arange(10.0), "y": np.zeros(10), "span": 0.5} | change
    with pytest.raises(ValueError, match=message):
        loess(**call)
