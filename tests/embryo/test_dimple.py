"""The membrane's profile fitted to outlines with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter1d

from microlib.embryo import _dimple, fit_dimple
from microlib.embryo._boundary import Boundary
from microlib.embryo._probe import Probe
from microlib.embryo._view import View
from microlib.synthetic import Embryo
from tests.laws import hold_sigma

PIXEL = 4.0  # µm
ROWS = 800
CENTER = (500.3, 600.2)  # px, y up


def outline(
    embryo: Embryo, *, noise: float = 0.0, tilt: float = 0.0, rng: np.random.Generator | None = None
) -> Boundary:
    """Points of an embryo's outline one px apart, moved across it by noise, as an extraction's."""
    x, y = embryo.outline(PIXEL).T / PIXEL
    order = np.argsort(x)
    x, y = x[order], y[order]
    upper = (y > -1.05 * embryo.dimple_depth / PIXEL) & (np.abs(x) > 11)
    x, y = x[upper], y[upper]
    if rng is not None:
        step = np.gradient(np.stack([x, y]), axis=1)
        across = np.stack([-step[1], step[0]]) / np.hypot(*step)
        x, y = np.stack([x, y]) + across * rng.normal(0.0, noise, x.size)
    cos, sin = np.cos(tilt), np.sin(tilt)
    tip = np.array([-sin, cos]) * -embryo.dimple_depth / PIXEL + CENTER
    probe = Probe((tip[0], ROWS - 1 - tip[1]), np.tan(tilt), embryo.probe_half_width / PIXEL)
    return Boundary(
        x=cos * x - sin * y + CENTER[0],
        y=sin * x + cos * y + CENTER[1],
        std=np.full(x.size, max(noise, 0.01)),
        under_probe=np.zeros(x.size, dtype=bool),
        probe=probe,
        blur=1.0,
        image_height=ROWS,
        view=View((1000, ROWS), "top"),
    )


@settings(deadline=None, max_examples=25)
@given(
    depth=st.floats(40.0, 150.0),
    rim=st.floats(350.0, 600.0),
    tilt=st.floats(-0.06, 0.06),
)
@example(depth=47.5, rim=431.0, tilt=0.0)  # exact but for the flank, a fifth of the points
def test_fit_dimple_recovers_dimple_of_exact_outline(depth, rim, tilt):
    embryo = Embryo.dented(depth, modulus=1.0, rim_radius=rim)
    boundary = outline(embryo, tilt=tilt)
    dimple = fit_dimple(boundary, pixel_size=PIXEL, probe_half_width=25.0)
    # The drawn flank is an ellipse and the fitted one a circle: parts in a thousand.
    assert dimple.dimple_depth == pytest.approx(embryo.dimple_depth, rel=3e-3)
    assert dimple.dimple_radius == pytest.approx(embryo.dimple_radius, rel=3e-3)
    assert dimple.tilt == pytest.approx(tilt, abs=1e-3)
    assert dimple.center == pytest.approx(CENTER, abs=0.05)
    assert dimple.rim_curvatures == pytest.approx((1 / rim, 1 / rim), rel=0.1)
    # Calling the fit draws the outline.
    near = np.abs(boundary.x - CENTER[0]) < 1.2 * embryo.dimple_radius / PIXEL
    np.testing.assert_allclose(dimple(boundary.x[near]), boundary.y[near], atol=0.1)


def test_covariance_matches_scatter_of_noisy_fits():
    rng = np.random.default_rng(0)
    embryo = Embryo.dented(80.0, modulus=1.0)
    fits = [
        fit_dimple(outline(embryo, noise=0.06, rng=rng), pixel_size=PIXEL, probe_half_width=25.0)
        for _ in range(60)
    ]
    found = np.array([[fit.dimple_radius, fit.dimple_depth] for fit in fits])
    covariances = np.array([fit.covariance for fit in fits])
    # The drawn flank is no circle: about the mean, which takes one of 60 from the scatter.
    hold_sigma((found - found.mean(axis=0)) * np.sqrt(60 / 59), covariances)
    # Radius and depth vary together as it says; Fisher's z has the deviation 1/√57.
    a, both, w = covariances.mean(axis=0)[[0, 0, 1], [0, 1, 1]]
    stated, seen = both / np.sqrt(a * w), np.corrcoef(found.T)[0, 1]
    assert abs(np.arctanh(seen) - np.arctanh(stated)) < 3.3 / np.sqrt(57)


@pytest.mark.parametrize("width", [1, 6])
def test_residual_variance_allows_for_correlation(width):
    """Of a running mean of unit errors, whose own mean is as uncertain as theirs."""
    drawn = np.random.default_rng(0).normal(size=(60, 250))
    errors = uniform_filter1d(drawn, width, axis=1, mode="wrap")
    found = [_dimple.residual_variance(each, 1) for each in errors]
    # 60 draws know it to 5 %; correlations are cut off where chance leaves as much.
    assert np.mean(found) == pytest.approx(1.0, abs=0.15)


def test_outliers_do_not_change_depth():
    rng = np.random.default_rng(1)
    embryo = Embryo.dented(100.0, modulus=1.0)
    boundary = outline(embryo, noise=0.06, rng=rng)
    stray = rng.choice(boundary.y.size, 12, replace=False)
    boundary.y[stray] += rng.uniform(2.0, 8.0, stray.size)
    dimple = fit_dimple(boundary, pixel_size=PIXEL, probe_half_width=25.0)
    assert dimple.dimple_depth == pytest.approx(100.0, abs=5 * dimple.covariance[1, 1] ** 0.5)


def rippled(height: float) -> Boundary:
    """A dimple 30 px deep with ripples that (4.2) does not have."""
    plain = outline(Embryo.dented(120.0, modulus=1.0))
    return replace(plain, y=plain.y + height * np.sin(np.abs(plain.x - CENTER[0]) / 6.0))


def test_outline_of_another_shape_has_larger_covariance():
    plain, other = (
        fit_dimple(rippled(height), pixel_size=PIXEL, probe_half_width=25.0) for height in (0, 3)
    )
    # A sine's root mean square, but for what the fit follows.
    assert other.misfit == pytest.approx(3 / np.sqrt(2), rel=0.2)
    assert plain.misfit < 0.02
    off = other.dimple_depth - plain.dimple_depth
    assert abs(off) < 3 * other.covariance[1, 1] ** 0.5
    # Waves of 38 px: as if of 250 points only every tenth or so told anything. Independent errors
    # of this size would leave the depth three times as certain.
    free = other.misfit * PIXEL / np.sqrt(np.abs(np.ptp(rippled(0).x)))
    assert other.covariance[1, 1] ** 0.5 > 3 * free


def test_outline_without_profile_raises(monkeypatch):
    zigzag = rippled(0.0)
    zigzag = replace(zigzag, y=zigzag.y + 7.0 * (-1.0) ** np.arange(zigzag.x.size))
    with pytest.raises(ValueError, match=r"probe's end at the bottom of the dimple"):
        fit_dimple(zigzag, pixel_size=PIXEL, probe_half_width=25.0)
    # Ripples of 2 px in 30 (1.82 or 1.84, by SciPy's version) are let pass, and would not be by a
    # limit below that.
    monkeypatch.setattr(_dimple, "_MAX_MISFIT", 0.055)
    with pytest.raises(ValueError, match=r"profile \(4.2\) to within .* got 1.8. px of 30"):
        fit_dimple(rippled(3), pixel_size=PIXEL, probe_half_width=25.0)


def with_end_off(pixels: float) -> Boundary:
    plain = outline(Embryo.dented(100.0, modulus=1.0), noise=0.06)
    x, y = plain.probe.tip
    return replace(plain, probe=replace(plain.probe, tip=(x, y + pixels)))


def test_distance_of_probe_end_from_bottom_increases_depth_variance():
    there, below = (
        fit_dimple(with_end_off(pixels), pixel_size=PIXEL, probe_half_width=25.0)
        for pixels in (0.0, 4.0)
    )
    assert below.dimple_depth == pytest.approx(there.dimple_depth, rel=1e-9)
    added = below.covariance - there.covariance
    # 4 px, of which 1 px is how well the end is seen; the profile ends within 0.05 px of it.
    assert added[1, 1] == pytest.approx((4**2 - 1**2) * PIXEL**2, rel=0.03)
    assert max(abs(added[0, 0]), abs(added[0, 1])) < 1e-9 * added[1, 1]
    with pytest.raises(ValueError, match=r"0\.0 px beside the axis and 9\.0 px off in height"):
        fit_dimple(with_end_off(9.0), pixel_size=PIXEL, probe_half_width=25.0)


def test_probe_beside_dimple_axis_raises():
    boundary = outline(Embryo.dented(100.0, modulus=1.0))
    (x, y), slope = boundary.probe.tip, boundary.probe.slope
    other = replace(boundary, probe=Probe((x + 12, y), slope, 6.25))
    with pytest.raises(ValueError, match=r"boundary must have the probe's end .* got it 12"):
        fit_dimple(other, pixel_size=PIXEL, probe_half_width=6.25 * PIXEL)
