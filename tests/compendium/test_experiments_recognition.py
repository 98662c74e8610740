"""The parts of chapter 6 come through focus with their names, and their picture shows them."""

from __future__ import annotations

import numpy as np

from compendium.experiments import recognition
from compendium.figures.recognition import draw_recognized


def test_parts_through_focus_are_named_and_drawn() -> None:
    parts = recognition.through_focus(1)
    said = {part.name: part.found.kind for part in parts}
    assert said.pop("pyramid") is None
    assert all(name == kind for name, kind in said.items()), said
    # Written once more: four planes of slope 0.8 whose edges run along the rows and columns.
    y, x = np.indices(parts[-1].depth.shape) - len(parts[-1].depth) / 2
    off = np.sqrt(np.maximum((x + y) ** 2, (x - y) ** 2) / 2)
    error = parts[-1].depth - np.clip(0.8 * (40 - off), 0, None)
    assert parts[-1].name == "pyramid"
    # The default depth's error on slopes; steps of frames are some 3 µm.
    assert np.sqrt(np.nanmean(error**2)) < 0.6
    figure = draw_recognized(parts)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[: len(parts)] == [part.name for part in parts]
    for part, title in zip(parts, titles[len(parts) :], strict=True):
        assert title.startswith(f"→ {part.found.kind or 'refused'}")
