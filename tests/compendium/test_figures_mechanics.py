"""Drawings of the page on membranes: shares add up, bars hold 95 %, the misfit is the largest."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium import thesis
from compendium.experiments.section_5_6 import compare_shape
from compendium.figures.mechanics import draw_shape

CAPSULE = pd.DataFrame({"E": np.geomspace(0.5, 0.9, 200)})
DISC = pd.DataFrame({"E": np.geomspace(1.5, 2.5, 50)})


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_the_arrow_is_the_largest_departure():
    curve = thesis.outline_curve()
    shape = compare_shape(curve)
    axes = draw_shape(curve, shape).axes[0]
    (arrow,) = [text for text in axes.texts if not text.get_text()]
    (x, top), (same, low) = arrow.xyann, arrow.xy
    assert x == same
    departure = thesis.EMBRYO_PIXEL * abs(top - low)
    assert departure == pytest.approx(shape.departure, rel=1e-6)
    assert f"{departure:.0f} µm" in " ".join(text.get_text() for text in axes.texts)
