"""Parts and the graph over their surface types: every node and border where its region is."""

from __future__ import annotations

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures.recognition import draw_recognized


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def part(name: str, kind: str | None, labels: np.ndarray) -> SimpleNamespace:
    regions = pd.DataFrame({"x": [3.0, 9.0, 5.0], "y": [2.0, 7.0, 8.0], "area": [0.2, 0.5, 0.3]})
    borders = pd.DataFrame({"one": [0, 1], "two": [2, 2], "length": [4.0, 5.0]})
    found = SimpleNamespace(
        kind=kind, confidence=0.876, labels=labels, regions=regions, borders=borders
    )
    return SimpleNamespace(name=name, depth=np.arange(120.0).reshape(10, 12), found=found)


def test_a_column_a_part_with_heights_types_graph_and_verdict() -> None:
    labels = np.full((10, 12), 5, np.uint8)
    labels[2:5, 3:9] = 1
    figure = draw_recognized(
        [part("ball", "sphere", labels), part("pyramid", None, 0 * labels + 3)]
    )
    above, other, below, last = figure.axes
    assert [axes.get_title() for axes in (above, other)] == ["ball", "pyramid"]
    assert below.get_title() == "→ sphere\n88%"
    assert last.get_title() == "→ refused\n"
    np.testing.assert_array_equal(above.images[0].get_array(), np.arange(120.0).reshape(10, 12))
    lines = [line.get_xydata().tolist() for line in below.lines]
    assert lines == [[[3, 2], [5, 8]], [[9, 7], [5, 8]]]
    (nodes,) = below.collections
    np.testing.assert_allclose(nodes.get_offsets(), [[3, 2], [9, 7], [5, 8]])
    # A tenth of 900 points² for the whole map, and never too small to be seen.
    np.testing.assert_allclose(nodes.get_sizes(), [38, 65, 47])
    assert nodes.get_zorder() > below.lines[0].get_zorder()
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(named) == 3  # of both parts together
    for axes in figure.axes:
        assert axes.get_xticks().size == axes.get_yticks().size == 0
        assert not any(spine.get_visible() for spine in axes.spines.values())
    width, height = figure.get_size_inches()
    assert (width, height) == pytest.approx((3.1, 4.3))
