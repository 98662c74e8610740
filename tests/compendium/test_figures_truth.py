"""What can be read off a figure, a film or the file beside a figure is what is so."""

import base64
import re
from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from compendium.figures import films, style
from compendium.figures.data import keep_data


def test_figure_data_keep_points_images_and_labels(tmp_path: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2)
    left.plot([1, 2, 3], [10, 20, 60], label="line")
    left.scatter([4, 5], [40, 50], label="dots")
    left.axvline(7, label="helper")
    left.set(xlabel="time (s)", ylabel="force (µN)")
    image = 1000 + 0.07 * np.arange(6.0).reshape(2, 3)  # a range far from zero
    right.imshow(image)
    right.set_title("height")
    keep_data(figure, tmp_path / "new" / "a")
    kept = pd.read_csv(tmp_path / "new" / "a.csv")
    assert kept[["x", "y"]].to_numpy().tolist() == [[1, 10], [2, 20], [3, 60], [4, 40], [5, 50]]
    assert kept["series"].tolist() == ["line"] * 3 + ["dots"] * 2
    assert set(kept["x_label"] + kept["y_label"]) == {"time (s)force (µN)"}
    with np.load(tmp_path / "new" / "a.npz") as arrays:
        # To 1/10 000 of the range, and to float32.
        np.testing.assert_allclose(arrays["panel2_image1"], image, rtol=0, atol=1e-4)
        assert arrays["panel_titles"].tolist() == ["", "height"]


def test_svg_has_two_themes_and_is_reproducible() -> None:
    """What follows the page changes with it; a map in the same grey, and black, do not."""
    style.use_style()
    pictures = []
    for _ in range(2):
        figure, axes = plt.subplots()
        axes.plot([0, 1], [0, 1], color=style.COLORS["ink"])
        axes.axhline(0.5, color="black")
        axes.imshow(np.arange(12.0).reshape(3, 4), extent=(0, 1, 0, 1))
        pictures.append(style.to_svg(figure))
        plt.close(figure)
    assert pictures[0] == pictures[1]
    rules = pictures[0].partition("</style>")[0]
    assert f"#dark:target {{--ink: {style.ON_DARK['ink']}" in rules
    assert "stroke: var(--ink, #1a1a1c)" in rules
    assert "#000000" not in rules
    data = re.search(r'base64,([^"]*)"', pictures[0])
    grey = np.asarray(Image.open(BytesIO(base64.b64decode(data[1]))))  # type: ignore[index]
    np.testing.assert_allclose(grey, 255 * np.arange(12).reshape(3, 4) / 11, atol=1)


def test_film_loops_and_has_still_image() -> None:
    figure = Figure(figsize=(2, 1), dpi=50, facecolor="none")
    axes = figure.subplots()
    bar = axes.axvspan(0, 1, color="black")
    axes.set(xlim=(0, 3), ylim=(0, 1))
    axes.axis("off")
    texts = {"name": "film-x", "alt": "a dot", "caption": "A dot."}
    html = films.film(figure, bar.set_x, [100, 200, 300], still=1, **texts).data
    moving, still = (
        Image.open(BytesIO(base64.b64decode(text)))
        for text in re.findall(r"data:image/webp;base64,([^\"]*)", html)
    )
    assert (moving.n_frames, moving.info["loop"], still.size) == (3, 0, (100, 50))
    for k, length in enumerate((100, 200, 300)):
        moving.seek(k)
        moving.load()
        assert moving.info["duration"] == length
        # The page shows through beside the bar, so that the film suits a dark page, too.
        dark = np.flatnonzero(np.asarray(moving.convert("RGBA"))[25, :, 3] > 128).mean()
        assert np.digitize(dark, np.linspace(0, 100, 4)) == k + 1
