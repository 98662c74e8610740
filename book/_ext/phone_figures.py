"""On a narrow screen a figure is shown in its second rendering, with text as large as the page's.

`compendium.figures.phone` draws it. One that is wider than the screen is scrolled sideways.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from PIL import Image
from sphinx.application import Sphinx

from compendium.figures.phone import DPI, LEAST

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "build" / "figures"
FIGURE = re.compile(r'(<figure [^>]*id="([^"]+)"[^>]*>\s*)(<img [^>]*>)')
#: Screens below this width get it: 30 times the size of their text.
NARROW = "screen and (max-width: 30rem)"
#: What a screen of 390 px shows beside the margins, in sizes of the text.
ROOM = 358 / 16


def show_narrow(app: Sphinx, page: str, template: str, context: Any, doctree: Any) -> None:
    """Offer the browser both renderings of each figure that has two."""
    if "body" in context:
        up = "../" * page.count("/")
        context["body"] = FIGURE.sub(lambda found: offer(found, up), context["body"])


def offer(found: re.Match[str], up: str) -> str:
    begin, name, image = found.groups()
    path = FIGURES / f"{name}.webp"
    if not path.exists():
        return found[0]
    with Image.open(path) as picture:
        width, height = picture.size
    size = width * 72 / DPI / LEAST  # in sizes of its own smallest text
    scrolled = ' tabindex="0" role="group" aria-label="Figure, wider than a phone"'
    return (
        f'{begin}<div class="figure-frame"{scrolled if size > ROOM + 0.1 else ""}><picture>'
        f'<source media="{NARROW}" srcset="{up}_static/figures/{name}.webp" '
        f'width="{width}" height="{height}">'
        f'<img style="--narrow: {size:.3f}rem" {image.removeprefix("<img ")}</picture></div>'
    )


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("html-page-context", show_narrow)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
