"""The numbers kept beside a figure are those that were drawn, x as x and y as y."""

import csv

import matplotlib as mpl
import numpy as np

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium.figures.data import keep_data

# No number occurs twice, and none of one column lies in the range of another.
X, Y = np.array([1.125, 2.25, 3.5]), np.array([-10.0625, -20.123457, np.nan])
SPOTS = np.array([[101.5, 202.25], [103.0, 204.5]])


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def drawn():
    figure, (left, right) = plt.subplots(1, 2)
    left.plot(X, Y, label="curve")
    left.scatter(*SPOTS.T, label="spots")
    left.axvline(2.0, label="helper")
    left.set(xlabel="time (s)", ylabel="force (µN)")
    right.bar([5.0, 7.0], [11.0, 13.0], width=1.0, label="bars")
    right.set(xlabel="class", ylabel="share (%)")
    return figure


def test_every_point_is_kept_in_its_own_column(tmp_path):
    (path,) = keep_data(drawn(), tmp_path / "figure")
    rows = read(path)
    expected = {
        ("1", "curve", "time (s)", "force (µN)"): np.column_stack([X, Y]),
        ("1", "spots", "time (s)", "force (µN)"): SPOTS,
        ("2", "bars", "class", "share (%)"): [[5.0, 11.0], [7.0, 13.0]],
    }
    found = {}
    for row in rows:
        key = (row["panel"], row["series"], row["x_label"], row["y_label"])
        found.setdefault(key, []).append([float(row["x"]), float(row["y"])])
    assert found.keys() == expected.keys()
    for key, points in expected.items():
        # Eight digits are written.
        np.testing.assert_allclose(found[key], points, rtol=1e-7)


def test_an_image_is_kept_row_by_row_with_its_panel(tmp_path):
    figure, (left, right) = plt.subplots(1, 2)
    image = np.arange(6.0).reshape(2, 3)
    left.set_title("nothing")
    right.imshow(image)
    right.set_title("height (µm)")
    (path,) = keep_data(figure, tmp_path / "deep" / "figure")
    with np.load(path) as kept:
        assert set(kept) == {"panel_titles", "panel2_image1"}
        np.testing.assert_array_equal(kept["panel2_image1"], image)
        assert kept["panel_titles"].tolist() == ["nothing", "height (µm)"]


def test_a_drawing_without_data_keeps_nothing(tmp_path):
    figure, axes = plt.subplots()
    axes.axhline(1.0)
    axes.set(xlim=(0, 5), ylim=(0, 5))
    assert keep_data(figure, tmp_path / "figure") == []
    assert list(tmp_path.iterdir()) == []
