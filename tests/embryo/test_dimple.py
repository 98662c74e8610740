"""The membrane's profile fitted to outlines with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter1d

from microlib.embryo import fit_dimple
from microlib.synthetic import Embryo
from tests.checks import hold_sigma
from tests.scenes.embryo import small_outline

PIXEL = 4.0  # µm
ROWS = 800
CENTER = (500.3, 600.2)  # px, y up


def outline(
    embryo: Embryo, noise: float = 0.0, tilt: float = 0.0, shared: int = 1, seed: int | None = None
):
    """Return a boundary of points one px apart on an outline, displaced across it by noise.

    The noise is a running mean over `shared` independent normal errors.
    """
    x, y = embryo.outline(PIXEL).T / PIXEL
    order = np.argsort(x)
    x, y = x[order], y[order]
    upper = (y > -1.05 * embryo.dimple_depth / PIXEL) & (np.abs(x) > 11)
    x, y = x[upper], y[upper]
    if seed is not None:
        step = np.gradient(np.stack([x, y]), axis=1)
        across = np.stack([-step[1], step[0]]) / np.hypot(*step)
        errors = np.random.default_rng(seed).normal(0.0, noise, x.size)
        x, y = np.stack([x, y]) + across * uniform_filter1d(errors, shared)
    cos, sin = np.cos(tilt), np.sin(tilt)
    tip = np.array([-sin, cos]) * -embryo.dimple_depth / PIXEL + CENTER
    extracted = small_outline()
    probe = replace(
        extracted.probe,
        tip=(tip[0], ROWS - 1 - tip[1]),
        slope=np.tan(tilt),
        half_width=embryo.probe_half_width / PIXEL,
    )
    return replace(
        extracted,
        x=cos * x - sin * y + CENTER[0],
        y=sin * x + cos * y + CENTER[1],
        uncertainty=np.full(x.size, max(noise, 0.01)),
        under_probe=np.zeros(x.size, dtype=bool),
        probe=probe,
        image_height=ROWS,
    )


def fit(boundary):
    return fit_dimple(boundary, pixel_size=PIXEL, probe_half_width=25.0)


@settings(deadline=None, max_examples=25)
@given(depth=st.floats(40.0, 150.0), rim=st.floats(350.0, 600.0), tilt=st.floats(-0.06, 0.06))
@example(depth=47.5, rim=431.0, tilt=0.0)  # a fifth of its points lie on the flank
def test_fit_dimple_recovers_dimple_of_exact_outline(depth, rim, tilt):
    embryo = Embryo.dented(depth, modulus=1.0, rim_curvature_radius=rim)
    boundary = outline(embryo, tilt=tilt)
    dimple = fit(boundary)
    # The drawn flank is an ellipse and the fitted one a circle, which changes the sizes by up to
    # 0.3 %.
    assert dimple.dimple_depth == pytest.approx(embryo.dimple_depth, rel=3e-3)
    assert dimple.rim_radius == pytest.approx(embryo.rim_radius, rel=3e-3)
    assert dimple.tilt == pytest.approx(tilt, abs=1e-3)
    assert dimple.center == pytest.approx(CENTER, abs=0.05)
    assert dimple.rim_curvatures == pytest.approx((1 / rim, 1 / rim), rel=0.1)
    beyond = np.maximum(boundary.x - CENTER[0] - embryo.rim_radius / PIXEL, 0)
    bent = replace(boundary, y=boundary.y - 0.002 * beyond**2)
    steeper = fit(bent)
    assert steeper.rim_curvatures[1] > 1.2 * steeper.rim_curvatures[0]
    near = np.abs(boundary.x - CENTER[0]) < 1.2 * embryo.rim_radius / PIXEL
    for fitted, drawn in ((dimple, boundary), (steeper, bent)):
        height = np.interp(drawn.x[near], *fitted.curve)
        np.testing.assert_allclose(height, drawn.y[near], atol=0.1)


@pytest.mark.parametrize("shared", [1, 4])
def test_covariance_matches_scatter_of_noisy_fits(shared):
    """For independent errors, and for correlated ones, which determine the sizes less well."""
    embryo = Embryo.dented(80.0, modulus=1.0)
    fits = [fit(outline(embryo, 0.06, shared=shared, seed=seed)) for seed in range(60)]
    found = np.array([[each.rim_radius, each.dimple_depth] for each in fits])
    covariances = np.array([each.covariance for each in fits])
    # The flank, which is no circle, biases the fits, so the scatter is taken about their mean. This
    # leaves 59 of 60 degrees of freedom.
    hold_sigma((found - found.mean(axis=0)) * np.sqrt(60 / 59), covariances)
    # The correlation of radius and depth matches too; Fisher's z has the standard deviation 1/√57.
    a, both, w = covariances.mean(axis=0)[[0, 0, 1], [0, 1, 1]]
    stated, seen = both / np.sqrt(a * w), np.corrcoef(found.T)[0, 1]
    assert abs(np.arctanh(seen) - np.arctanh(stated)) < 3.3 / np.sqrt(57)


@pytest.mark.parametrize("height", [-20.0, 8.0, 20.0])
def test_outliers_on_the_flanks_do_not_change_the_fit(height):
    """They are 10 % of its points. An earlier fit was up to 200 std off, or failed."""
    embryo = Embryo.dented(100.0, modulus=1.0)
    for seed in range(6):
        boundary = outline(embryo, 0.06, seed=seed)
        flank = np.flatnonzero(np.abs(boundary.x - CENTER[0]) < embryo.rim_radius / PIXEL)
        stray = np.random.default_rng(seed).choice(flank, flank.size // 10, replace=False)
        y = boundary.y.copy()
        y[stray] += height
        plain, other = fit(boundary), fit(replace(boundary, y=y))
        std = plain.covariance[1, 1] ** 0.5
        assert other.dimple_depth == pytest.approx(plain.dimple_depth, abs=2 * std)
        assert other.covariance[1, 1] ** 0.5 == pytest.approx(std, rel=0.3)


def rippled(height: float):
    """Return an outline with ripples, which profile (4.2) cannot follow."""
    plain = outline(Embryo.dented(120.0, modulus=1.0))
    return replace(plain, y=plain.y + height * np.sin(np.abs(plain.x - CENTER[0]) / 6.0))


def pit():
    """Return an outline that is flat except for a pit around the probe."""
    plain = outline(Embryo.dented(120.0, modulus=1.0))
    return replace(plain, y=CENTER[1] - 30.0 * (np.abs(plain.x - CENTER[0]) < 13))


def test_outline_of_another_shape_has_larger_covariance():
    plain, other = (fit(rippled(height)) for height in (0, 3))
    # The root mean square of a sine, less what the fit follows.
    assert other.rms_px == pytest.approx(3 / np.sqrt(2), rel=0.2)
    assert plain.rms_px < 0.02
    off = other.dimple_depth - plain.dimple_depth
    assert abs(off) < 3 * other.covariance[1, 1] ** 0.5
    # Ripples of 38 px correlate the residuals of neighbors, so that about one in ten of the 250
    # points counts. Independent residuals of this size would give a third of the deviation.
    free = other.rms_px * PIXEL / np.sqrt(np.abs(np.ptp(rippled(0).x)))
    assert other.covariance[1, 1] ** 0.5 > 3 * free


def with_end_off(right: float, down: float):
    plain = outline(Embryo.dented(100.0, modulus=1.0), noise=0.06)
    x, y = plain.probe.tip
    return replace(plain, probe=replace(plain.probe, tip=(x + right, y + down)))


def test_distance_of_probe_end_from_bottom_increases_depth_variance():
    there, below = (fit(with_end_off(0.0, down)) for down in (0.0, 4.0))
    assert below.dimple_depth == pytest.approx(there.dimple_depth, rel=1e-9)
    added = below.covariance - there.covariance
    # The end of the probe is known to 1 px, which explains a part of the 4 px. The bottom of the
    # profile lies within 0.05 px of the end that was not moved.
    assert added[1, 1] == pytest.approx((4**2 - 1**2) * PIXEL**2, rel=0.03)
    assert max(abs(added[0, 0]), abs(added[0, 1])) < 1e-9 * added[1, 1]


@pytest.mark.parametrize(
    ("boundary", "message"),
    [
        (
            with_end_off(0.0, 9.0),
            r"probe's end .* 0\.0 px beside the axis and 9\.0 px off in height",
        ),
        (with_end_off(12.0, 0.0), "boundary must have the probe's end .* got it 12"),
        (pit(), r"profile \(4.2\) to within a sixth of the dimple"),
    ],
)
def test_outline_without_profile_of_probe_is_rejected(boundary, message):
    with pytest.raises(ValueError, match=message):
        fit(boundary)
