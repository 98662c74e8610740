"""What every figure draws is what it drew when a person last looked at it.

A text that differs says which artist, in which panel, and how. If the drawing was to change, write
the texts anew (``make drawn``) and look at its picture in ``build/drawn``: the texts hold what is
drawn, not that it is right, which only a look and the other tests of figures can tell.
"""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import compendium.figures
from tests.compendium.figure_cases import CASES, draw
from tests.drawn import FOLDER
from tests.snapshots import compare, others_than_locked

#: Without a text: `label_patches` is drawn by the legends, `film` by films, `show` shows.
DRAWING = ("draw_", "film_", "show_", "add_", "label_legend", "turnable_", "narrow", "keep_data")
OTHERS = others_than_locked("matplotlib")


@pytest.mark.skipif(bool(OTHERS), reason="another matplotlib places ticks otherwise")
@pytest.mark.parametrize("name", CASES)
def test_a_figure_draws_what_it_drew(name: str) -> None:
    expected = (FOLDER / f"{name}.txt").read_text(encoding="utf-8")
    if lines := compare(expected, draw(name)):
        pytest.fail(
            "\n".join([*lines, "", "`make drawn` writes it anew; look at build/drawn then"]),
            pytrace=False,
        )


def test_every_drawing_has_a_text_and_every_text_a_drawing() -> None:
    names = set()
    for module in pkgutil.iter_modules(compendium.figures.__path__):
        public = importlib.import_module(f"compendium.figures.{module.name}").__all__
        names |= {f"{module.name}.{name}" for name in public if name.startswith(DRAWING)}
    names.discard("phone.keep_narrow")
    assert names - {"data.show"} <= {name.partition("-")[0] for name in CASES}
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(CASES)


def test_texts_agree_as_far_as_a_drawing_shows() -> None:
    line = "figure\n  x: 1 2.5 1e-05\n  text 'a' #ff0000\n"
    assert not compare(line, line.replace("2.5", "2.50001").replace("1e-05", "1.00001e-05"))
    for old, new in (("2.5", "2.51"), ("1e-05", "1.1e-05"), ("#ff", "#fe"), ("'a'", "'b'")):
        changed = compare(line, line.replace(old, new))
        assert [text[0] for text in changed[3:]].count("-") == 1
    assert compare(line, line + "  line\n")
    assert compare("x: nan", "x: 1")
    # Noise around zero beside large numbers is none of them.
    assert not compare("x: 0 5", "x: 1e-17 5")
