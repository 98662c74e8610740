"""Modulus from an outline: the truth comes back, with its scatter, from any part that shows it."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from microlib.membrane import fit_capsule, indent_capsule
from microlib.membrane.large._fit_capsule import newey_west_variance
from tests.laws import hold_sigma

SHELL: dict[str, Any] = {"thickness": 3.0, "probe_half_width": 25.0}
FORCE, RADIUS, INFLATION = 100.0, 600.0, 1.05
#: A search from the truth, which is fast; it ends where any other does, as a test says.
NEAR: dict[str, Any] = {**SHELL, "radius": RADIUS, "start": (1.0, INFLATION)}


def outline(noise: float, *, seed: int = 0, share: float = 0.85, state: Any = None) -> NDArray:
    """Both sides of a capsule, down from the probe, axis at 30 µm and plate at 70 µm."""
    if state is None:
        state = indent_capsule(FORCE, modulus=1.0, radius=RADIUS, inflation=INFLATION, **SHELL)
    along = np.concatenate([[0], np.cumsum(np.hypot(np.diff(state.r), np.diff(state.z)))])
    places = np.linspace(0, share * along[-1], 100)
    r, z = np.interp(places, along, state.r), np.interp(places, along, state.z)
    both = np.column_stack([np.concatenate([-r[::-1], r]), np.concatenate([z[::-1], z])])
    place = np.array([30.0, 70.0])
    return both + place + np.random.default_rng(seed).normal(0, noise, both.shape)


def test_fit_recovers_capsule_of_exact_outline() -> None:
    fit = fit_capsule(FORCE, outline(0.0), **SHELL)
    # The points lie on chords of the outline: up to 0.05 µm inside it.
    assert fit.modulus == pytest.approx(1, abs=2e-3)
    assert fit.inflation == pytest.approx(INFLATION, abs=2e-4)
    assert fit.radius == pytest.approx(RADIUS, abs=0.1)
    np.testing.assert_allclose(fit.center, [30, 70], atol=0.1)
    assert fit.misfit < 0.1


def test_fit_does_not_depend_on_start() -> None:
    """At the truth, or half as stiff and twice as inflated: a search that stops early differs."""
    starts = (1.0, INFLATION), (0.5, 1.1)
    points = outline(0.7)
    near, far = (fit_capsule(FORCE, points, start=s, radius=RADIUS, **SHELL) for s in starts)
    # A search ends within 3 % of a deviation, which is the noise's.
    assert near.modulus == pytest.approx(1, abs=3 * near.modulus_std)
    assert far.modulus == pytest.approx(near.modulus, abs=0.1 * near.modulus_std)
    # The fits solved each capsule from a similar one; two meshes of one tolerance.
    found = {"modulus": far.modulus, "inflation": far.inflation, "radius": RADIUS}
    wanted = indent_capsule(FORCE, **found, **SHELL)
    for name in ("depth", "approach", "pressure"):
        assert getattr(far.state, name) == pytest.approx(getattr(wanted, name), rel=1e-6)


def test_fit_that_ends_early_is_repeated_from_the_crest() -> None:
    """From this start the first search ends at 1.47 MPa, 0.8 µm from the points."""
    shell: dict[str, Any] = {"thickness": 3.0, "probe_half_width": 40.0, "law": "hooke"}
    state = indent_capsule(41.548, modulus=1.0, radius=489.45, inflation=1.037, **shell)
    points = outline(0.24, state=state, share=0.5)
    fit = fit_capsule(41.548, points, radius=489.45, start=(2.088, 1.0162), **shell)
    assert abs(fit.modulus - 1) < 4 * fit.modulus_std


def test_modulus_std_matches_errors() -> None:
    fits = [fit_capsule(FORCE, outline(0.7, seed=seed), **NEAR) for seed in range(3)]
    scores = np.array([(fit.modulus - 1) / fit.modulus_std for fit in fits])
    # χ² of three: between 0.07 and 12.8 in 99 of 100 samples.
    assert 0.07 < np.sum(scores**2) < 12.8
    assert all(0.5 < fit.misfit < 0.9 for fit in fits)


def test_fit_tilt_recovers_tilt_and_keeps_modulus_std() -> None:
    """Turned by what an image does not show of the probe's direction."""
    tilt = 0.006
    upright = outline(0.7, seed=1)
    cos, sin = np.cos(tilt), np.sin(tilt)
    # The top of what is turned clockwise goes to the right.
    turned = (upright - [30, 70]) @ np.array([[cos, -sin], [sin, cos]]) + [30, 70]
    before = fit_capsule(FORCE, upright, **NEAR, fit_tilt=True)
    fit = fit_capsule(FORCE, turned, **NEAR, fit_tilt=True)
    # A turn about the foot of the axis changes nothing else; the search ends within 3 % of a
    # deviation, which of the tilt is 0.3 mrad.
    assert fit.tilt - before.tilt == pytest.approx(tilt, abs=2e-4)
    np.testing.assert_allclose(fit.center, before.center, atol=0.1)
    assert fit.modulus == pytest.approx(before.modulus, abs=0.2 * before.modulus_std)
    assert fit.modulus_std == pytest.approx(before.modulus_std, rel=0.05)
    assert fit.misfit == pytest.approx(before.misfit, rel=0.02)
    stiff = fit_capsule(FORCE, turned, **NEAR)
    assert stiff.tilt == 0.0
    assert stiff.modulus_std > 2 * fit.modulus_std


@pytest.mark.parametrize("part", ["one side", "dimple"])
def test_fit_accepts_part_of_outline(part: str) -> None:
    points, start = outline(0.4), None
    if part == "one side":
        points = points[points[:, 0] > 30] - [30.0, 0.0]
    else:
        points, start = points[points[:, 1] > points[:, 1].max() - 150], (1.0, INFLATION)
    fit = fit_capsule(FORCE, points, radius=RADIUS, start=start, **SHELL)
    assert fit.radius == RADIUS
    assert fit.center[0] == pytest.approx(0 if part == "one side" else 30, abs=1)
    assert abs(fit.modulus - 1) < 4 * fit.modulus_std
    assert fit.modulus_std < 0.05


def test_points_far_from_any_capsule_raise() -> None:
    with pytest.raises(ValueError, match="outline must be near"):
        fit_capsule(FORCE, np.random.default_rng(0).uniform(0, 60, (40, 2)), **SHELL)


@pytest.mark.parametrize(("points", "width"), [(20, 1), (60, 1), (400, 1), (400, 6)])
def test_newey_west_variance_matches_scatter_of_fits(points, width):
    """Independent, at three sizes, or alike over six points: of each of four numbers."""
    jacobian = np.vander(np.linspace(-1, 1, points), 4)
    drawn = np.random.default_rng(0).normal(size=(400, points))
    errors = uniform_filter1d(drawn, width, axis=1, mode="wrap")
    for turn in range(4):
        columns = np.roll(jacobian, turn, axis=1)
        fits = errors @ np.linalg.pinv(columns).T
        left = errors - fits @ columns.T
        stated = np.array([newey_west_variance(columns, each) for each in left])
        if width == 1:
            # As many degrees as a χ² has that scatters like the stated variances.
            freedom = 2 * stated.mean() ** 2 / stated.var()
            hold_sigma(fits[:, 0], np.sqrt(stated), freedom)
        else:
            # 400 draws know a deviation to 4 %. Weights that fall over 20 points leave out up to a
            # tenth of it; taken for independent, it would be 0.4.
            assert 0.8 < np.sqrt(stated.mean()) / fits[:, 0].std() < 1.05
