"""Trackers are used again after rejected frames; ``make fuzz`` draws more sequences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule

from microlib.tracking import ESMTracker
from tests.fuzz import target
from tests.laws import unlike


class Trackers(RuleBasedStateMachine):
    """A tracker that rejected frames equals one that saw only the good frames."""

    def __init__(self) -> None:
        super().__init__()
        self.pair = [ESMTracker(target(), (16, 16, 32, 32), "translation") for _ in range(2)]

    @rule(x=st.integers(-4, 4), y=st.integers(-4, 4), light=st.sampled_from([0.0, 0.5, 1.0]))
    def track(self, x: int, y: int, light: float) -> None:
        frame = light * np.roll(target(), (y, x), (0, 1)) + 9.0
        first, second = (tracker.track(frame) for tracker in self.pair)
        assert not [*unlike(first, second)]
        assert first.lost or np.isfinite(first.corners).all()

    @rule(
        wrong=st.sampled_from([None, "a", np.full((64, 72), np.nan), np.zeros(3), np.ones((2, 2))])
    )
    def refuse(self, wrong: object) -> None:
        with pytest.raises(ValueError, match="frame"):
            self.pair[0].track(wrong)


FEW = {"stateful_step_count": 12, "deadline": None}
Trackers.TestCase.settings = settings(max_examples=settings.default.max_examples // 16, **FEW)
TestTrackers = Trackers.TestCase
