"""Films: small, looping, with a still, and showing what is so at each moment."""

import base64
import re
from io import BytesIO

import matplotlib as mpl
import numpy as np
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
