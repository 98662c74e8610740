"""One look for every figure of the book: legible, colour-blind safe, on a light and a dark page."""

from __future__ import annotations

import re
from base64 import b64decode, b64encode
from io import BytesIO, StringIO
from itertools import product
from typing import Any

import matplotlib as mpl
import pandas as pd
from cycler import cycler
from matplotlib.figure import Figure
from PIL import Image

#: Okabe and Ito's colours, distinguishable with every common colour deficiency.
COLORS = {
    "blue": "#0072B2",
    "orange": "#D55E00",
    "green": "#009E73",
    "pink": "#CC79A7",
    "yellow": "#E69F00",
    "sky": "#56B4E9",
    "grey": "#6E6E6E",
    "ink": "#1A1A1C",
}
#: Colors that are too dark on a dark page, and what they become there. No map or picture has them;
#: what is drawn over one is plain black or white.
ON_DARK = {"ink": "#CED6DD", "blue": "#4DA6E0", "grey": "#A3A3A3"}
#: Of what an SVG would take thousands of elements for (`rasterized=True`), dots per inch.
RASTER = 200


def use_style() -> None:
    """Set figures and tables up for the book: the body's font size, tight boxes, whole texts.

    Nothing of a reader's own ``matplotlibrc`` is kept.
    """
    mpl.rcdefaults()
    pd.set_option("display.max_colwidth", None, "display.max_rows", 80)
    mpl.rcParams.update(
        {
            "figure.figsize": (6.4, 4.2),  # on a phone 12 points are then 9 px
            "figure.constrained_layout.use": True,
            "savefig.bbox": "tight",
            "savefig.pad_inches": 0.05,
            "axes.formatter.min_exponent": 5,  # 0.01, not 10 with a small exponent
            "font.size": 12,
            "axes.titlesize": 12,
            "axes.grid": True,
            "axes.axisbelow": True,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "grid.alpha": 0.3,
            "image.cmap": "gray",
            "image.interpolation": "none",  # pixels as they are, in any size
            "legend.frameon": False,
            "lines.linewidth": 2.0,
            "axes.prop_cycle": cycler(color=[v for k, v in COLORS.items() if k != "ink"]),
            "svg.hashsalt": "microlib",
        }
    )
    ink = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    more: dict[Any, Any] = dict.fromkeys(
        (*ink, "patch.edgecolor", "patch.facecolor"), COLORS["ink"]
    )
    panes = [f"axes3d.{axis}axis.panecolor" for axis in "xyz"]
    more |= dict.fromkeys(
        ("figure.facecolor", "axes.facecolor", "savefig.facecolor", *panes), "none"
    )
    mpl.rcParams.update(more)


def to_svg(figure: Figure) -> str:
    """Return a figure as SVG in two looks: as drawn, and for a dark page where the address of the
    picture ends in ``#dark``."""
    file = StringIO()
    figure.savefig(file, format="svg", dpi=RASTER, metadata={"Date": None})
    # By variables, since the elements that `use` draws see no rule that names the whole picture.
    rules = [f"#dark:target {{{'; '.join(f'--{k}: {v}' for k, v in ON_DARK.items())}}}"]
    for name, part in product(ON_DARK, ("fill", "stroke")):
        color = COLORS[name].lower()
        rules.append(f'[style*="{part}: {color}"] {{{part}: var(--{name}, {color}) !important}}')
    text = file.getvalue().replace("<svg ", '<svg id="dark" ', 1)
    # Matplotlib asks for hard pixels, which an image loses that is shown smaller than it is.
    text = re.sub(r'(matrix\(0\.[^"]*") style="image-rendering[^"]*"', r"\1", text)
    text = re.sub(r"(?<=base64,)[^\"]*", _pack, text)
    return text.replace("</style>", "\n".join(["", *rules, "</style>"]), 1)


def _pack(embedded: re.Match[str]) -> str:
    """Return the same pixels without the channels that say nothing: an alpha of 1, equal colors."""
    picture: Image.Image = Image.open(BytesIO(b64decode(embedded[0])))
    if picture.getchannel("A").getextrema() == (255, 255):
        red, green, blue, _ = (channel.tobytes() for channel in picture.split())
        picture = picture.convert("L" if red == green == blue else "RGB")
    file = BytesIO()
    picture.save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()
