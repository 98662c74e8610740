"""Films: small, looping, with a still, and showing what is so at each moment."""

import base64
import re
from io import BytesIO

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

mpl.use("agg")

from compendium.figures import films

TEXTS = {"name": "film-x", "alt": 'a "dot"', "caption": "<strong>Film.</strong> A dot."}


def pictures(html):
    return [
        Image.open(BytesIO(base64.b64decode(text)))
        for text in re.findall(r"data:image/webp;base64,([^\"]*)", html.data)
    ]


def test_a_film_loops_beside_its_still():
    figure = Figure(figsize=(2, 1), dpi=50)
    axes = figure.subplots()
    bar = axes.axvspan(0, 1, color="black")
    axes.set(xlim=(0, 3), ylim=(0, 1))
    axes.axis("off")
    html = films.film(figure, lambda k: bar.set_x(k), [100, 200, 300], still=1, **TEXTS)
    moving, still = pictures(html)
    assert (moving.n_frames, moving.info["loop"]) == (3, 0)
    assert (moving.size, still.size, getattr(still, "n_frames", 1)) == ((100, 50), (100, 50), 1)
    middle = np.asarray(still.convert("L"))[25]
    for k, length in enumerate((100, 200, 300)):
        moving.seek(k)
        moving.load()
        assert moving.info["duration"] == length
        shown = np.asarray(moving.convert("L"))[25].astype(int)
        dark = np.flatnonzero(shown < 128).mean()
        assert np.digitize(dark, np.linspace(0, 100, 4)) == k + 1
        if k == 1:
            assert np.abs(shown - middle).max() < 60  # both lossy
    assert html.data.count('alt="a &quot;dot&quot;"') == 2
    assert html.data.count(" hidden ") == 1
    assert 'id="film-x"' in html.data


def test_a_film_that_is_too_heavy_is_refused(monkeypatch):
    monkeypatch.setattr(films, "MOST_BYTES", 50)
    with pytest.raises(ValueError, match=r"film-x weighs \d+ bytes, at most 50"):
        films.film(Figure(figsize=(1, 1)), lambda _: None, [100, 100], still=0, **TEXTS)


@pytest.fixture
def drawn(monkeypatch):
    """Return the figure, and what each picture brings it to, without drawing any."""
    seen = {}

    def keep(figure, draw, durations, *, still, **texts):
        seen.update(figure=figure, draw=draw, durations=durations, still=still, texts=texts)

    monkeypatch.setattr(films, "film", keep)
    return seen


def test_the_dimple_is_as_deep_as_the_dot_says(drawn):
    depths = np.linspace(0, 40, 50)
    films.film_dimple(depths, depths**3 / 500, radius=200.0, half_width=20.0, **TEXTS)
    section, curve = drawn["figure"].axes
    count = len(drawn["durations"])
    reached = []
    for k in range(count):
        drawn["draw"](k)
        depth, force = (float(v[0]) for v in curve.lines[1].get_data())
        assert section.lines[0].get_ydata().min() == pytest.approx(-depth, abs=1e-9)
        corners = [[-20, -depth], [20, -depth], [20, 40], [-20, 40]]
        np.testing.assert_allclose(section.patches[0].get_xy()[:4], corners, atol=1e-9)
        assert force == pytest.approx(depth**3 / 500, abs=0.2)  # between points of the curve
        reached.append(depth)
    # Down and back again, to where it began.
    assert reached[0] == 0
    assert reached[count // 2] == max(reached) == pytest.approx(40)
    np.testing.assert_allclose(reached[1:], reached[:0:-1], atol=1e-9)
