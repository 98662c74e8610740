"""The parts of chapter 6 come through focus with their names, and their picture shows them."""

from __future__ import annotations

from compendium.experiments import recognition
from compendium.figures.recognition import draw_recognized


def test_parts_through_focus_are_named_and_drawn() -> None:
    parts = recognition.through_focus(1)
    said = {part.name: part.found.kind for part in parts}
    assert said.pop("pyramid") is None
    assert all(name == kind for name, kind in said.items()), said
    figure = draw_recognized(parts)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[: len(parts)] == [part.name for part in parts]
    for part, title in zip(parts, titles[len(parts) :], strict=True):
        assert title.startswith(f"→ {part.found.kind or 'refused'}")
