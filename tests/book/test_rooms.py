"""The drawings of who imports whom show what the code imports, and are legible."""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "book" / "_ext"))
from rooms import (  # noqa: E402
    HEIGHT,
    ROW,
    Graph,
    describe,
    draw,
    house_graph,
    imported,
    lay_out,
    library_graph,
)

LONG = {"a": {"b", "c"}, "b": {"c"}, "c": set(), "d": {"c"}, "e": set()}


def test_imports_are_read_from_the_code() -> None:
    source = "import a.b\nfrom c import d as e\ndef f():\n    from g.h import i\n"
    assert imported(source) == {"a.b", "c.d", "g.h.i"}
    library = library_graph()
    assert library["calibration"] == {"_common", "microscope"}
    assert library["_common"] == set()
    house = house_graph()
    assert house["microlib"] == set()
    assert house["notebooks"] >= {"compendium", "microlib"}


@pytest.mark.parametrize("graph", [LONG, library_graph(), house_graph()])
def test_arrows_point_right_and_cross_no_box(graph: Graph) -> None:
    layout = lay_out(graph)
    assert layout.boxes.keys() == graph.keys()
    assert len(set(layout.boxes.values())) == len(graph)
    assert len(layout.arrows) == sum(map(len, graph.values()))
    for path in layout.arrows:
        assert [column for column, _ in path] == list(range(path[0][0], path[-1][0] + 1))
        for column, row in path[1:-1]:
            rows = [r for c, r in layout.boxes.values() if c == column]
            assert all(abs(row - other) * ROW > HEIGHT for other in rows)


def test_a_circle_is_refused() -> None:
    with pytest.raises(ValueError, match="these import each other"):
        lay_out({"a": {"b"}, "b": {"a"}})


def test_the_drawing_says_in_words_what_it_shows() -> None:
    drawing = ElementTree.fromstring(draw(LONG, below="f, for all"))
    assert drawing.attrib["role"] == "img"
    assert drawing.attrib["aria-label"] == describe(LONG)
    assert describe(LONG).startswith("a imports b and c; b imports c; d imports c; c and e: no")
    assert [text.text for text in drawing.iter("text")] == [*LONG, "f, for all"]
    width, height = map(float, drawing.attrib["viewBox"].split()[2:])
    for box in drawing.iter("rect"):
        assert float(box.attrib["x"]) + float(box.attrib["width"]) < width
        assert float(box.attrib["y"]) + float(box.attrib["height"]) < height
