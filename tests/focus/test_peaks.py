"""The peak of a profile against (3.13), against exact Gaussians, and against its own laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microlib.focus import three_point_peak
from microlib.focus.multiscale._fit import fit_peaks


@settings(deadline=None, max_examples=100)
@given(
    center=st.floats(1.0, 5.0),
    width=st.floats(0.5, 3.0),
    gaps=st.lists(st.floats(0.5, 1.5), min_size=6, max_size=6),
    falling=st.booleans(),
)
def test_peak_of_gaussian_profile_is_exact(center, width, gaps, falling):
    """Both fits are exact on a Gaussian, at uneven and falling positions too."""
    positions = np.concatenate([[0.0], np.cumsum(gaps)])
    if falling:
        positions = positions[::-1].copy()
    profile = 1000 * np.exp(-((positions - center) ** 2) / (2 * width**2))
    best = int(profile.argmax())
    if not 0 < best < len(positions) - 1:
        return
    index = np.full((1, 1), best, np.uint8)
    three = profile[best - 1 : best + 2, None, None].astype(np.float32)
    # float32 measures: 6e-8 relative, over the curvature 0.25 / 3².
    assert three_point_peak(three, index, positions)[0, 0] == pytest.approx(center, abs=1e-4)
    frames = np.arange(best - 3, best + 4)
    seven = np.where((frames >= 0) & (frames <= 6), profile[np.clip(frames, 0, 6)], 0)
    window = seven[:, None, None].astype(np.float32)
    steps = np.abs(positions - positions[0])
    found = fit_peaks(window, index, steps)[0][0, 0]
    # A fit divides by the third and fourth moments of the frames that have a weight.
    assert found == pytest.approx(abs(center - positions[0]), abs=5e-4)


def test_peak_at_an_end_must_exceed_its_neighbor():
    window = np.array([[0, 5.0, 5], [5, 5, 0], [0, 5, 4], [4, 5, 0], [5, 5, 5]]).T[..., None]
    index = np.array([0, 4, 0, 4, 2])[:, None]
    found = three_point_peak(window, index, np.array([7.0, 8, 10, 13, 17]))
    np.testing.assert_array_equal(found[:, 0], [np.nan, np.nan, 7, 17, np.nan])


def documented_fit(profile, steps, best, reach):
    """The fit pixel by pixel: np.polyfit with the documented weights, twice."""
    count = len(steps)
    frames = np.arange(max(best - reach, 0), min(best + reach, count - 1) + 1)
    t, y = steps[frames] - steps[best], profile[frames]
    far = min(best, count - 1 - best, reach) or 2
    near = max(abs(steps[k] - steps[best]) for k in (best - 1, best + 1) if 0 <= k < count)
    half = max(
        abs(steps[k] - steps[best]) for k in (best - far, best + far) if 0 <= k < count
    ) + near * (0.5 if far > 1 else 1.0)
    center = 0.0
    for _ in range(2):
        weight = y**0.75 * np.maximum(1 - ((t - center) / half) ** 2, 0) ** 2
        a, b, _ = np.polyfit(t, np.log(y), 2, w=np.sqrt(weight))
        center = -b / (2 * a)
    return steps[best] + center


def test_fit_peaks_equals_polyfit_with_documented_weights():
    """On profiles with long tails, on which other weights give other depths."""
    rng = np.random.default_rng(0)
    steps = np.cumsum(rng.uniform(0.8, 1.2, 13))
    steps -= steps[0]
    for center in rng.uniform(3.5, 8.5, 20):
        profile = 1 / (1 + ((steps - center) / 1.7) ** 2) + 0.03 * rng.random(13)
        best = int(profile.argmax())
        window = profile[best - 3 : best + 4, None, None].astype(np.float32)
        found = fit_peaks(window, np.full((1, 1), best, np.uint16), steps)[0][0, 0]
        assert found == pytest.approx(documented_fit(profile, steps, best, 3), abs=1e-4)


@pytest.mark.parametrize("kind", [">f4", "<f2", ">f8", "longdouble", "int64", ">u2"])
def test_three_point_peak_accepts_any_real_dtype(kind):
    profile = np.rint(1000 * np.exp(-((np.arange(5.0) - 2.25) ** 2) / 8))
    window, index = profile[1:4, None, None], np.full((1, 1), 2)
    expected = three_point_peak(window, index, np.arange(5.0))
    found = three_point_peak(window.astype(kind), index.astype(">i4"), np.arange(5.0))
    # Whole numbers up to 1000, which all kinds hold.
    assert found == expected
