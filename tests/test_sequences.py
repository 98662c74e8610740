"""Sequences of calls: readers and trackers that are used again after faults.

What may come is what a model says, or a `ValueError`; ``make fuzz`` draws many more.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from microlib.focus import depth_from_focus
from microlib.io import read_frames
from microlib.tracking import ESMTracker
from tests.fuzz import target
from tests.laws import unlike

FRAMES = np.random.default_rng(3).integers(0, 255, (7, 12, 18)).astype(np.uint8)


class Readers(RuleBasedStateMachine):
    """A folder whose pictures come and go, read by readers of readers."""

    def __init__(self) -> None:
        super().__init__()
        self.place = tempfile.TemporaryDirectory()
        self.files = [Path(self.place.name) / f"{k}.png" for k in range(len(FRAMES))]
        for file, frame in zip(self.files, FRAMES, strict=True):
            cv2.imwrite(str(file), frame)
        self.reader, self.next, self.failed = read_frames(self.place.name), 0, False
        self.cut = (slice(None), slice(None))

    @rule(color=st.booleans(), x=st.integers(0, 2), width=st.integers(1, 20))
    def narrow(self, color: bool, x: int, width: int) -> None:
        rows, columns = self.reader.shape
        try:
            self.reader = read_frames(self.reader, color=color, region=(x, 1, width, rows - 1))
        except ValueError:
            assert x + width > columns or rows < 2 or self.failed or self.gone()
            return
        self.cut = tuple(
            slice((old.start or 0) + a, (old.start or 0) + a + n)
            for old, a, n in zip(self.cut, (1, x), (rows - 1, width), strict=True)
        )

    def gone(self) -> bool:
        return self.next < len(FRAMES) and not self.files[self.next].exists()

    @rule()
    def read(self) -> None:
        try:
            frame = next(self.reader)
        except StopIteration:
            assert self.next == len(FRAMES)
        except ValueError:
            assert self.failed or self.gone()
            self.failed = True  # for good
        else:
            assert not self.failed
            np.testing.assert_array_equal(frame, FRAMES[self.next][self.cut])
            self.next += 1

    @rule()
    def depth(self) -> None:
        """What is refused before it is read is not lost."""
        with pytest.raises(ValueError, match=r"positions|frames"):
            depth_from_focus(self.reader, positions=[0.0, 1.0])

    @precondition(lambda self: self.next + 1 < len(FRAMES))
    @rule(ahead=st.integers(1, 3))
    def remove(self, ahead: int) -> None:
        self.files[min(self.next + ahead, len(FRAMES) - 1)].unlink(missing_ok=True)

    def teardown(self) -> None:
        self.place.cleanup()


class Trackers(RuleBasedStateMachine):
    """What was refused leaves no trace: another tracker sees the good frames only."""

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
for machine in (Readers, Trackers):
    machine.TestCase.settings = settings(max_examples=settings.default.max_examples // 16, **FEW)
TestReaders, TestTrackers = Readers.TestCase, Trackers.TestCase
