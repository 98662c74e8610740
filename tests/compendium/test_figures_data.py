"""The numbers kept beside a figure are those that it shows, in the right columns."""

from __future__ import annotations

import csv
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures.data import keep_data


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_points_stand_in_the_columns_of_their_axes(tmp_path: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2)
    left.plot([1, 2, 3], [10, 20, 60], label="line")
    left.scatter([4, 5], [40, 50], label="dots")
    left.axvline(7, label="helper")
    left.set(xlabel="time (s)", ylabel="force (µN)")
    right.plot([6, 8], [2, 4], label="other")
    (path,) = keep_data(figure, tmp_path / "a")
    assert path == tmp_path / "a.csv"
    found = [(r["panel"], r["series"], float(r["x"]), float(r["y"])) for r in rows(path)]
    assert found == [
        *(("1", "line", x, y) for x, y in ((1, 10), (2, 20), (3, 60))),
        *(("1", "dots", x, y) for x, y in ((4, 40), (5, 50))),
        *(("2", "other", x, y) for x, y in ((6, 2), (8, 4))),
    ]
    assert {(r["x_label"], r["y_label"]) for r in rows(path) if r["panel"] == "1"} == {
        ("time (s)", "force (µN)")
    }


def test_images_are_kept_as_they_are(tmp_path: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2)
    first, second = np.arange(6.0).reshape(2, 3), np.arange(4).reshape(2, 2)
    left.imshow(first)
    left.set_title("height")
    right.imshow(second)
    assert keep_data(figure, tmp_path / "new" / "b") == [tmp_path / "new" / "b.npz"]
    with np.load(tmp_path / "new" / "b.npz") as kept:
        np.testing.assert_array_equal(kept["panel1_image1"], first)
        np.testing.assert_array_equal(kept["panel2_image1"], second)
        assert kept["panel_titles"].tolist() == ["height", ""]
        assert len(kept.files) == 3
