"""Figures that notebooks drew, on other pages: ``{picture}`` with a figure's name shows one.

The option ``:part:`` shows a part of the figure only. It has four shares of the figure's size:
left, top, width and height. The option ``:alt:`` describes that part.

The gallery extensions run scripts of their own; these figures are in notebooks that ran already.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from html import escape
from typing import ClassVar

import nbformat
from book_map import PAGES
from book_tables import raw_html
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


@cache
def read_pictures() -> dict[str, tuple[str, str]]:
    """Return what each figure shows and its SVG, by its name."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(PAGES.glob("*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            shown = cell.metadata.get("mystnb", {})
            for output in cell.get("outputs", []):
                if picture := output.get("data", {}).get("image/svg+xml"):
                    entry = shown.get("image", {}).get("alt", ""), picture
                    found.setdefault(shown.get("figure", {}).get("name", ""), entry)
    return found


class Picture(SphinxDirective):
    required_arguments = 1
    option_spec: ClassVar = {"part": str, "alt": str}

    def run(self) -> list[nodes.Node]:
        alt, picture = read_pictures()[self.arguments[0]]
        alt = self.options.get("alt", alt)
        # Its file is that of its own page, which its hash names.
        file = hashlib.sha256("\n".join(picture.splitlines()).encode()).hexdigest()
        source = "../" * self.env.docname.count("/") + f"_images/{file}.svg"
        if "part" not in self.options:
            return [raw_html(f'<img src="{source}" alt="{escape(alt)}" loading="lazy">')]
        left, top, width, height = (float(share) for share in self.options["part"].split())
        size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', picture)
        if size is None:
            raise self.error(f"{self.arguments[0]} must have a viewBox")
        aspect = float(size[1]) / float(size[2])
        margin = f"{-100 * top / width / aspect}% 0 0 {-100 * left / width}%"
        image = f"width: {100 / width}%; margin: {margin}"
        return [
            raw_html(
                f'<span class="part" style="aspect-ratio: {aspect * width / height}">'
                f'<img src="{source}" alt="{escape(alt)}" style="{image}"></span>'
            )
        ]


def setup(app: Sphinx) -> None:
    app.add_directive("picture", Picture)
