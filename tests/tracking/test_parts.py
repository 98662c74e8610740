"""The parts of the judgment of a pose, each on numbers whose answer is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy import ndimage

from microlib.tracking import ESMTracker, KalmanFilter, _tracker
from microlib.tracking._blocks import agreement, edges
from microlib.tracking._covariance import (
    _correlated,
    _local_size,
    _spread,
    corner_jacobian,
    kept_between,
    lag_between,
    largest_sigma,
    sandwich,
    squared_frequency,
)
from microlib.tracking._esm import Alignment, apply_homography, half_pixel, shifted
from microlib.tracking._light import _knots, _tukey_slope, make_lit
from microlib.tracking._local import _best_shifts, _kept_noise, gaussian, make_local
from microlib.tracking._loops import TUKEY, moved
from microlib.tracking._noise import ceiling_of
from microlib.tracking._search import RobustSearch, _shifted_before
from microlib.tracking._tracker import _clear, _hidden, _of_mean
from microlib.tracking._verdict import confidence, features

BOX = (30, 25, 40, 30)
START = np.array([[20.0, 0, 49.5], [0, 20.0, 39.5], [0, 0, 1]])


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    noise = np.random.default_rng(0).uniform(0, 255, (90, 110))
    return cv2.GaussianBlur(noise.astype(np.float32), (0, 0), 1.5)


@pytest.fixture(scope="module")
def tracker(image) -> ESMTracker:
    return ESMTracker(image, BOX)


def finding(**changes):
    fit = {"noise": 2.0, "bend": 0.3, "gain": 0.5} | changes.pop("fit", {})
    given = {
        "score": 12.0, "rival": 3.0, "share": 0.6, "deformation": 4.0, "motion": 9.0, "area": 0.2,
    }  # fmt: skip
    return SimpleNamespace(**given | changes, fit=SimpleNamespace(**fit))


def test_what_the_verdict_weighs():
    """Its coefficients were fitted to these numbers and to no others."""
    expected = [
        1.0, np.log(13.0), np.log(13.0) - np.log(4.0), np.log(0.1 + 0.03), np.log(2.0), 0.6,
        (50 / 40) * 4.0 / 5.0, (50 / 40) * 9.0 / 15.0, 0.3, 0.2, np.log(2.0),
    ]  # fmt: skip
    found = features(finding(), 0.1, size=40.0, near=True)
    np.testing.assert_allclose(found, expected)
    assert features(finding(), 0.1, size=40.0, near=False)[7] == 1.0
    beyond = finding(score=-2.0, rival=-1.0, area=5.0, fit={"noise": 50, "bend": 7, "gain": 0.0})
    expected = [1, 0, 0, np.log(3.03), np.log(10.0), 0.6, 1.0, 0.75, 2.0, 2.0, 2.0]
    np.testing.assert_allclose(features(beyond, 99.0, size=40.0, near=True), expected)
    coefficients = [-2.96, -0.39, 0.70, -3.03, -0.80, 3.72, 0.51, -3.70, -8.01, -3.83, -2.29]
    odds = np.exp(features(finding(), 0.1, size=40.0, near=True) @ coefficients)
    assert confidence(finding(), 0.1, size=40.0, near=True) == pytest.approx(odds / (1 + odds))


def test_a_filter_knows_its_first_place_and_not_its_velocity():
    place = np.array([3.0, 4.0])
    kalman = KalmanFilter(place, interval=0.1, acceleration=2.0, noise=0.3)
    np.testing.assert_allclose(kalman.covariance, [[0.09, 0.0], [0.0, 1e6]])
    np.testing.assert_array_equal(kalman.velocity, [0.0, 0.0])
    kalman.predict()
    kalman.update((5.0, 5.0))
    np.testing.assert_array_equal(place, [3.0, 4.0])
    for name in ("position", "velocity", "covariance"):
        given = getattr(kalman, name)
        given += 100.0
        assert (getattr(kalman, name) != given).all()


def test_cells_are_as_many_as_have_four_px():
    assert edges(90).tolist() == list(range(0, 91, 10))
    assert len(edges(35)) == 9  # eight cells of at least 4 px
    assert edges(7).tolist() == [0, 4, 7]
    assert len(edges(16, 2)) == 9  # of every second px, 32 of them


def test_blocks_drift_about_the_one_gain_and_bias():
    rng = np.random.default_rng(4)
    template = rng.normal(100, 30, (36, 36)).astype(np.float32)
    ones, noise = np.ones_like(template), 3.0
    level = (1.1 * template + 7).astype(np.float32)
    assert agreement(level, template, ones, noise).drift == pytest.approx(0, abs=1e-3)
    level[:18] += 4
    level[18:] -= 4
    down = edges(36)
    w, off = [], []
    slope, bias = np.polyfit(template.ravel(), level.ravel(), 1)
    for j in range(len(down) - 2):
        for i in range(len(down) - 2):
            at = slice(down[j], down[j + 2]), slice(down[i], down[i + 2])
            w.append(np.clip(level[at].var() / (2 * noise**2) - 1, 0, 50))
            off.append(np.mean(level[at] - slope * template[at] - bias))
    drift = np.sqrt(np.average(np.square(off), weights=w))
    assert agreement(level, template, ones, noise).drift == pytest.approx(drift, rel=1e-3)


def test_the_slope_of_tukeys_weights_is_their_derivative():
    residual, scale, trust = np.linspace(-9.0, 9.0, 181), 1.7, 0.6

    def product(r):
        u = (r / (TUKEY * scale)) ** 2
        return np.where(u < 1, trust * (1 - u) ** 2, 0.0) * r

    weight = product(residual) / np.where(residual == 0, 1, residual)
    weight[residual == 0] = trust
    numeric = (product(residual + 1e-6) - product(residual - 1e-6)) / 2e-6
    np.testing.assert_allclose(_tukey_slope(weight, residual, scale), numeric, atol=1e-5)


def test_hats_between_knots_add_up_to_one():
    for length, count in ((12, 2), (29, 2), (30, 3), (49, 4), (400, 5)):
        place = np.linspace(-1, 1, length)
        hats = np.array(_knots(place, length))
        assert len(hats) == count
        np.testing.assert_allclose(hats.sum(axis=0), 1.0)
        knots = np.linspace(-1, 1, count)
        np.testing.assert_allclose(np.array(_knots(knots, length)), np.eye(count), atol=1e-12)


def local(image, smoothing=0.6, density=1, halvings=0, **options):
    given = {"finest": 0, "motion": "homography", "mask": np.ones((30, 40), np.float32)} | options
    return make_local(
        image, BOX, START, halvings=halvings, smoothing=smoothing, density=density, **given
    )


def test_the_columns_of_the_light_are_what_light_blur_and_tone_do(image):
    sharp = local(image)
    blurred = local(cv2.GaussianBlur(image, (0, 0), 0.8))
    lit = make_lit(sharp, blurred)
    t = (sharp.grey - sharp.grey.mean()).ravel() / lit.contrast
    assert lit.contrast == pytest.approx(sharp.level.contrast)
    assert t.std() == pytest.approx(1.0, rel=1e-3)
    rows, columns = np.mgrid[:30, :40]
    u, v = (columns.ravel() / 39 * 2 - 1), (rows.ravel() / 29 * 2 - 1)
    blur = (blurred.grey - sharp.grey).ravel()
    blur = blur / blur.std()
    expected = [t, u * t, v * t, blur, t**2, t**3]
    np.testing.assert_allclose(lit.light[:6], expected, atol=1e-4)
    slopes = np.array([np.ones_like(t), u, v, 0 * t, 2 * t, 3 * t**2]) / lit.contrast
    np.testing.assert_allclose(lit.tone, slopes, atol=1e-4)
    assert len(lit.light) == 6 + 4 * 3  # a knot every 10 px
    np.testing.assert_allclose(lit.light[6:].sum(axis=0), 1.0, atol=1e-6)


def test_noise_that_is_spread_and_kept():
    impulse = np.zeros((1, 41, 41), np.float32)
    impulse[0, 20, 20] = 1.0
    for kept in (0.03, 0.1):
        spread = _spread(impulse, kept)
        # The sum of squares of a Gaussian is what it leaves of the variance of white noise.
        assert (spread**2).sum() == pytest.approx(kept, rel=0.03)
    np.testing.assert_array_equal(_spread(impulse, 0.96), impulse.reshape(1, -1))
    rng = np.random.default_rng(0)
    white = rng.standard_normal((300, 300))
    for sigma in (0.7, 1.2):
        noise = ndimage.gaussian_filter(white, sigma, mode="wrap")
        assert _correlated(noise, 1 / (4 * np.pi * sigma**2)) == pytest.approx(1.0, rel=0.07)
    wide = ndimage.gaussian_filter(white, 2.0, mode="wrap")
    # Of 2 px where 0.7 are told of: (0.7² + 1.5²) / 0.7² against (2² + 1.5²) / 2².
    factor = (0.7**2 + 1.5**2) / 0.7**2 * 2**2 / (2**2 + 1.5**2)
    assert _correlated(wide, 1 / (4 * np.pi * 0.7**2)) == pytest.approx(factor, rel=0.1)
    assert _correlated(np.zeros((20, 20)), 0.5) == 1.0
    weight = np.ones((60, 60))
    weight[:, 30:] = 0.25
    np.testing.assert_allclose(_local_size(np.full((60, 60), 3.0), weight), 3.0, rtol=1e-5)
    one = np.zeros((61, 61))
    one[30, 30] = 1.0
    size = _local_size(one, np.ones((61, 61)))
    ratio = size[30, 30] / size[30, 37]  # roots of a Gaussian of 3.5 px
    assert ratio == pytest.approx(np.exp(7**2 / (4 * 3.5**2)), rel=0.02)


def test_weights_below_one_make_a_fit_less_certain():
    """Of white noise, by weights that are 0 or 1, the covariance is that of the pixels used."""
    rng = np.random.default_rng(1)
    shape = (50, 50)
    v, u = np.mgrid[:50, :50] / 25.0 - 1
    design = np.stack([np.sin(5 * u + v), np.cos(4 * v), np.ones(shape)]).reshape(3, -1)
    used = (u + v < 0.5).ravel().astype(float)
    noise = rng.standard_normal(2500) * 2.0
    found = sandwich(design, noise, used, used, (1.0, 1.0), shape, 2)
    exact = 4.0 * np.linalg.inv((design * used) @ design.T)[:2, :2]
    np.testing.assert_allclose(np.diag(found), np.diag(exact), rtol=0.2)
    halved = sandwich(design, noise, used, 0.5 * used, (1.0, 1.0), shape, 2)
    np.testing.assert_allclose(halved, 4 * found)
    least = sandwich(design, noise, used, 0 * used, (1.0, 1.0), shape, 2)
    np.testing.assert_allclose(least, 100 * found)
    open_ = sandwich(np.zeros((3, 2500)), noise, used, used, (1.0, 1.0), shape, 2)
    assert np.isnan(open_).all()


def test_corners_move_as_the_jacobian_says(tracker):
    level = tracker._refinement
    pose = START @ np.array([[1.1, 0.1, 0.2], [-0.05, 0.9, -0.1], [0.05, -0.08, 1.0]])
    found = corner_jacobian(pose, level.basis, level.corners)
    assert found.shape == (8, 8)
    for k in range(8):
        step = np.zeros(8)
        step[k] = 1e-5
        up, down = (
            apply_homography(moved(pose, s * step, level.basis), level.corners) for s in (1, -1)
        )
        np.testing.assert_allclose(found[k], ((up - down) / 2e-5).ravel(), rtol=1e-5, atol=1e-5)


def test_interpolation_between_half_pixels_lags():
    x = np.arange(64.0)
    omega = 2 * np.pi / 8
    wave = np.tile(np.cos(omega * x), (16, 1)).astype(np.float32)
    fine = half_pixel(wave)[16]
    for part in (0.1, 0.2, 0.4, 0.6):
        places = np.arange(16.0, 48.0, 1.0) + part
        values = np.interp(2 * places, np.arange(fine.size), fine)
        phase = np.angle(np.sum(values * np.exp(-1j * omega * places)))
        # A phase of the wave is a place of it: the rest are higher orders of ω/2 = 0.39.
        lag = lag_between(np.array([[part, 0.0]]))[0] * omega**2
        assert -phase / omega == pytest.approx(lag, abs=0.15 * abs(lag) + 1e-4), part
    both = lag_between(np.array([[0.1, 0.2], [0.3, 0.4]]))
    each = [lag_between(np.array([[a, 0.0]]))[0] for a in (0.1, 0.3, 0.2, 0.4)]
    np.testing.assert_allclose(both, [np.mean(each[:2]), np.mean(each[2:])])
    assert kept_between(np.array([[0.0, 0.0], [0.5, 0.0]])) == pytest.approx(
        (1 + kept_between(np.array([[0.5, 0.0]]))) / 2
    )


def test_the_frequency_of_a_gradient():
    y, x = np.mgrid[:63, :94]
    gx, gy = np.cos(0.2 * x + 0.1), np.cos(0.1 * y)
    found = squared_frequency(np.stack([gx, gy]))
    np.testing.assert_allclose(found, [0.04, 0.01], rtol=0.08)
    assert largest_sigma(np.diag([4.0, 9.0, 1.0])) == 3.0
    assert largest_sigma(np.diag([4.0, np.nan])) == np.inf


def test_the_best_shift_is_the_vertex_of_its_votes():
    rows, columns = np.mgrid[-4:5, -4:5]

    def hill(x, y, height=5.0):
        return height - 0.1 * (columns - x) ** 2 - 0.2 * (rows - y) ** 2

    votes = np.stack([hill(1.3, -2.2), hill(-0.4, 0.0), hill(4.0, 0.0), hill(0.0, -9.0)])
    moves, weights = _best_shifts(votes.astype(np.float32))
    np.testing.assert_allclose(moves[:2], [[1.3, -2.2], [-0.4, 0.0]], atol=1e-4)
    np.testing.assert_allclose(weights[:2], votes[:2].max(axis=(1, 2)), rtol=1e-6)
    assert (weights[2:] == 0).all()  # at the border it may be better beyond


def test_a_level_holds_the_template_and_its_share_of_noise(image):
    assert gaussian(1.0, 3.0).tolist() == pytest.approx(
        (np.exp(-(np.arange(-3, 4) ** 2) / 2) / np.exp(-(np.arange(-3, 4) ** 2) / 2).sum()).tolist()
    )
    assert len(gaussian(1.1, 2.0)) == 7
    assert gaussian(0.0, 3.0).tolist() == [1.0]
    mask = np.zeros((30, 40), np.float32)
    mask[:, 20:] = 1
    level = local(image, mask=mask)
    np.testing.assert_array_equal(level.mask, mask)
    same = cv2.sepFilter2D(image, -1, level.kernel, level.kernel)[25:55, 30:70]
    np.testing.assert_allclose(level.grey, same, atol=1e-3)
    half = local(cv2.pyrDown(image), halvings=1, mask=mask)
    np.testing.assert_array_equal(half.mask, mask[1::2, ::2])  # row 26 is the first of the half
    pose = half.pose(half.warp(START))
    np.testing.assert_allclose(pose / pose[2, 2], START, atol=1e-9)
    # Half-way between the best phase of a linear interpolation, 1, and the worst, 1/4.
    taps = np.array([0.25, 0.75])
    assert _kept_noise(0, 1, 0.01) == pytest.approx(taps @ taps, rel=0.05)
    once = np.array([1, 4, 6, 4, 1]) / 16
    pair = np.convolve(once, [0.25, 0, 0.75])
    assert _kept_noise(1, 1, 0.01) == pytest.approx(pair @ pair, rel=0.1)


def test_a_deformation_costs_and_a_shift_does_not(image):
    for halvings, finest in ((0, 0), (1, 0), (1, 1)):
        level = local(
            cv2.pyrDown(image) if halvings else image, halvings=halvings, finest=finest,
        )  # fmt: skip
        corners, sigma = level.level.corners, 5.0 * 2.0 ** (finest - halvings)
        rng = np.random.default_rng(0)
        step = 1e-6 * rng.standard_normal(8)
        moved_corners = apply_homography(moved(np.eye(3), step, level.level.basis), corners)
        off = (moved_corners - corners) / level.level.to_template[0, 0]
        off = off - off.mean(axis=0)
        cost = step @ level.prior @ step
        assert cost == pytest.approx((off**2).sum() / (4 * sigma**2), rel=1e-4)


def test_motion_costs_nats_and_shifts_are_those_of_the_level(image):
    search = RobustSearch(image, BOX, START, "homography", np.ones((30, 40), np.float32))
    shift = np.eye(3)
    shift[:2, 2] = 6.0, -8.0
    # Three tenths of the longer side, 12 px.
    assert search._spent(START)(shift @ START) == pytest.approx(100 / (2 * 12.0**2))
    level = search._wide[0]
    further = _shifted_before(START, level, 3, -2)
    off = apply_homography(further, level.level.corners) - apply_homography(
        START, level.level.corners
    )
    np.testing.assert_allclose(off, np.tile([3.0, -2.0], (4, 1)), atol=1e-9)
    assert (search.finest, search.coarsest, search._reach) == (0, 1, 20)
    assert len(search._wide) == len(search._sharp) == len(search._lit) == 4


def fit_of(**changes):
    said = {"agreeing": 0.96, "texture": 101.0} | changes.pop("said", {})
    given = {"noise": 1.4} | changes
    return SimpleNamespace(agreement=SimpleNamespace(**said), **given)


def test_all_parts_agree_within_four_limits():
    certain = np.diag([0.14**2] * 8)
    assert _clear(fit_of(), certain)
    assert not _clear(fit_of(said={"agreeing": 0.94}), certain)
    assert not _clear(fit_of(said={"texture": 99.0}), certain)
    assert not _clear(fit_of(noise=1.6), certain)
    assert not _clear(fit_of(), np.diag([0.14**2] * 7 + [0.16**2]))


def test_what_is_hidden_exceeds_the_noise_and_the_texture():
    residual = np.zeros((60, 60), np.float32)
    residual[:, 30:] = 6.1
    flat = SimpleNamespace(residual=residual, model=np.full((60, 60), 90.0, np.float32))
    found = _hidden(flat, 2.0)  # over three times the noise
    assert not found[:, :25].any()
    assert found[:, 35:].all()
    assert not _hidden(SimpleNamespace(residual=0.97 * residual, model=flat.model), 2.0).any()
    waves = (10 * np.sqrt(2) * np.cos(2 * np.arange(60.0))).astype(np.float32)
    model = np.tile(waves, (60, 1))  # of a variance of 100, a quarter of which is 5²
    for height, hidden in ((5.4, True), (4.8, False)):
        level = SimpleNamespace(residual=residual * height / 6.1, model=model)
        assert _hidden(level, 0.1)[10:50, 40:50].all() == hidden
        assert _hidden(level, 0.1)[10:50, 40:50].any() == hidden


def test_the_covariance_of_the_mean_is_that_of_all_pairs():
    root = np.random.default_rng(0).standard_normal((8, 8))
    covariance = root @ root.T
    mean = np.kron(np.full((1, 4), 0.25), np.eye(2))
    np.testing.assert_allclose(_of_mean(covariance), mean @ covariance @ mean.T)


def test_what_convinces_follows_the_last_that_was_accepted(tracker):
    before = tracker._last_correlation
    for last, convincing in ((1.0, 0.998), (0.99, 0.978), (0.96, 0.918), (0.9, 0.9)):
        tracker._last_correlation = last
        assert tracker._convincing() == pytest.approx(convincing)
    tracker._last_correlation = before


def test_noise_is_at_least_that_of_rounding_and_interpolation(image, tracker):
    still = np.zeros((60, 60), np.float32)
    contrast = tracker._refinement.contrast
    assert tracker._noise_of(still) == pytest.approx(0.01 * contrast)
    whole = ESMTracker(np.rint(0.05 * image).astype(np.uint8), BOX)
    assert whole._noise_of(still) == pytest.approx(1 / np.sqrt(12))
    loud = np.random.default_rng(0).normal(0, 5, (200, 200)).astype(np.float32)
    assert tracker._noise_of(loud) == pytest.approx(5.0, rel=0.1)


def test_saturation_is_a_plateau_of_25_pixels():
    grey = np.full((20, 20), 10.0)
    grey.flat[:24] = 99.0
    assert ceiling_of(grey, 2.0) == np.inf
    grey.flat[:25] = 99.0
    assert ceiling_of(grey, 2.0) == 94.0


@pytest.mark.parametrize(("side", "halvings"), [(60, 0), (127, 0), (128, 1), (260, 2)])
def test_starts_begin_at_the_finest_and_end_with_the_correlation(side, halvings):
    asked = []

    class Level:
        def correlate(self, layer, pose, reach):
            asked.append((layer.shape, reach))
            return "matched"

    fake = SimpleNamespace(_levels=[Level() for _ in range(4)], _box=(0, 0, side, side // 2))
    frame = np.zeros((64, 96), np.float32)
    starts = list(ESMTracker._starts(fake, "pose", frame))
    assert [pose for pose, _ in starts] == ["pose"] * 4 + ["matched"]
    assert asked == [((64 >> halvings, 96 >> halvings), side >> halvings)]
    assert len(starts[-1][1]) == halvings + 1


def test_a_pose_is_confirmed_half_a_pixel_apart(tracker, monkeypatch):
    plain = SimpleNamespace(pose=START)
    monkeypatch.setattr(tracker, "_agreeing", lambda alignment, drift: drift)
    certain, origin = np.diag([0.49**2] * 8), np.array([3.0, -2.0])

    def fit_at(x):
        pose = START.copy()
        pose[:2, 2] += np.array([x, 0.0]) - origin
        return SimpleNamespace(pose=pose)

    assert tracker._confirms(fit_at(0.49), certain, plain, origin)
    assert not tracker._confirms(fit_at(0.51), certain, plain, origin)
    assert not tracker._confirms(fit_at(0.0), np.diag([0.51**2] * 8), plain, origin)
    monkeypatch.setattr(tracker, "_agreeing", lambda alignment, drift: None)
    assert not tracker._confirms(fit_at(0.0), certain, plain, origin)


def test_parts_agree_within_the_drift_that_is_allowed(tracker, image, monkeypatch):
    alignment = tracker._align([image], START)
    assert alignment.failure == ""
    said = SimpleNamespace(agreeing=0.95, texture=100.0, drift=0.0)
    monkeypatch.setattr(_tracker, "agreement", lambda *_: said)
    noise, contrast = tracker._noise, tracker._refinement.contrast
    steady = 0.5 * noise + 0.02 * alignment.gain * contrast
    assert tracker._agreeing(alignment, _tracker._STEADY) is not None
    for changes, fine in (
        ({"agreeing": 0.94}, False),
        ({"texture": 99.0}, False),
        ({"drift": 0.999 * steady}, True),
        ({"drift": 1.001 * steady}, False),
    ):
        changed = SimpleNamespace(**vars(said) | changes)
        monkeypatch.setattr(_tracker, "agreement", lambda *_, other=changed: other)
        assert (tracker._agreeing(alignment, _tracker._STEADY) is not None) == fine, changes
    assert _tracker._UNSTEADY == (1.0, 0.2)
    assert tracker._agreeing(replace(alignment, design=None), (1.0, 1.0)) is None


def test_only_a_plain_alignment_says_what_convinces_the_next_time(image, monkeypatch):
    tracker = ESMTracker(image, BOX)
    covariance, hidden = np.eye(8), np.zeros((30, 40), bool)
    for plain, expected in ((False, (1.0, 1.0)), (True, (0.8, 1.3))):
        alignment = Alignment(START, correlation=0.8, gain=1.3, visible=1.0)
        more = {"plain": True} if plain else {}
        found = _tracker.Found(alignment, "", covariance, 1.0, hidden, **more)
        monkeypatch.setattr(tracker, "_search", lambda frame, found=found: found)
        tracker.track(image)
        assert (tracker._last_correlation, tracker._gain) == expected


def test_where_nothing_was_aligned_the_light_is_taken_for_the_same(image):
    nothing = Alignment(START, failure="diverged")
    assert (nothing.gain, nothing.bias, nothing.correlation) == (1.0, 0.0, 0.0)
    assert (nothing.visible, nothing.iterations, nothing.design) == (0.0, 0, None)
    away = ESMTracker(image, BOX)
    away._pose = shifted(START, np.array([1e4, 0.0]))
    track = away.track(image)
    assert (track.reason, track.gain, track.bias) == ("out of view", 1.0, 0.0)


def test_a_fit_is_polished_with_the_template_as_it_is(image):
    search = RobustSearch(image, BOX, START, "homography", np.ones((30, 40), np.float32))
    plain, sharp, blurred = (
        search.polish(image, START, 2.0, np.inf, *blur) for blur in ((), (0,), (1,))
    )
    np.testing.assert_array_equal(plain.model, sharp.model)
    assert np.abs(plain.model - blurred.model).max() > 1e-3


@pytest.mark.parametrize(("size", "coarsest"), [((40, 23), 0), ((40, 24), 1)])
def test_no_template_is_halved_that_is_too_small_to_bend(size, coarsest):
    """Half of it is to be at least 12 px wide and high, as in the usual search."""
    width, height = size
    image = np.random.default_rng(0).uniform(0, 255, (80, 90)).astype(np.float32)
    mask = np.ones((height, width), np.float32)
    search = RobustSearch(image, (20, 20, width, height), START, "homography", mask)
    assert (search.finest, search.coarsest) == (0, coarsest)
