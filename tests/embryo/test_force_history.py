"""The force over time from images whose truth is a differential equation's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from microlib.embryo import force_over_time
from microlib.embryo._force_history import ForceHistory
from microlib.synthetic import Embryo, embryo_image

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
TIME = np.array([0.0, 0.2, 1.0, 1.5, 2.0, 5.0, 5.5, 6.0])
#: Pressed within 2 s, held for 3 s, half let go within 1 s.
ELASTIC = np.interp(TIME, [0, 2, 5, 6], [0, 120, 120, 60])
SHARE, TAU = 0.4, 1.5
LAW = {"shares": [SHARE], "relaxation_times": [TAU]}
SETTINGS = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5, "direction": "top"}


@pytest.fixture(scope="module")
def sequence() -> list[np.ndarray]:
    rng = np.random.default_rng(4)
    found = []
    for force in ELASTIC:
        # The second is pressed too little to be read.
        egg = Embryo(1.2, 0.0, 1.0) if force < 15 else Embryo.pressed(force, modulus=1.2)
        place = {"shape": (360, 400), "center": (200.0, 100.0)}
        found.append(embryo_image(egg, rng=rng, **place).image)
    return found


def true_force() -> np.ndarray:
    """By Runge–Kutta: a spring beside a spring and a dashpot in line."""

    def slope(t: float, q: np.ndarray) -> np.ndarray:
        rate = np.select([t < 2, t < 5], [60.0, 0.0], -60.0)
        return SHARE * rate - q / TAU

    held = solve_ivp(slope, (0, 6), [0.0], t_eval=TIME, rtol=1e-9, atol=1e-9, max_step=0.01).y[0]
    return (1 - SHARE) * ELASTIC + held


@pytest.fixture(scope="module")
def found(sequence: list[np.ndarray]) -> ForceHistory:
    return force_over_time(sequence, TIME, 1.2, **LAW, pixel_size=4.65 / 1.2, **SETTINGS)


def test_the_force_relaxes_while_the_outline_stays(found: ForceHistory) -> None:
    truth = true_force()
    measured = np.isfinite(found.elastic_force)
    assert measured.tolist() == [False, False] + [True] * 6
    assert found.reasons[0]
    assert not any(found.reasons[2:])
    # A tenth of the intervals may miss; of six, one.
    inside = (found.low <= truth) & (truth <= found.high)
    assert inside[2:].sum() >= 5
    np.testing.assert_allclose(found.force[2:], truth[2:], rtol=0.06)
    # The elastic reading of the last image before the release is off by all that has relaxed.
    assert found.elastic_force[5] > 1.4 * truth[5]
    # The shapes of a standard linear solid are those of its equation.
    np.testing.assert_allclose(found.high - found.force, 1.959964 * found.std)


def test_an_unread_image_costs_certainty(found: ForceHistory, sequence: list[np.ndarray]) -> None:
    dark = np.full_like(sequence[0], 190)
    blind = [sequence[0], dark, sequence[2], dark, sequence[4], dark]
    other = force_over_time(blind, TIME[:6], 1.2, **LAW, pixel_size=4.65 / 1.2, **SETTINGS)
    assert "probe" in other.reasons[3]
    assert np.isnan(other.elastic_force[3])
    assert other.std[3] > 3 * found.std[3]
    assert abs(other.force[3] - found.force[3]) < 2 * other.std[3]
    # What comes after the last outline nobody knows.
    for known in (other.force, other.std, other.low, other.high):
        assert np.isfinite(known).tolist() == [True] * 5 + [False]


def test_a_sequence_without_a_dimple_is_refused(sequence: list[np.ndarray]) -> None:
    with pytest.raises(ValueError, match="images must show a dimple in one of them at least"):
        force_over_time(sequence[:2], TIME[:2], 1.2, pixel_size=4.65 / 1.2, **SETTINGS, **LAW)
