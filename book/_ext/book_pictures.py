"""Figures that notebooks drew, on other pages: ``{picture}`` with a figure's name shows one.

The gallery extensions run scripts of their own; these figures are in notebooks that ran already.
"""

from __future__ import annotations

import hashlib
from functools import cache
from html import escape

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

    def run(self) -> list[nodes.Node]:
        alt, picture = read_pictures()[self.arguments[0]]
        # Its file is that of its own page, which its hash names.
        file = hashlib.sha256("\n".join(picture.splitlines()).encode()).hexdigest()
        source = "../" * self.env.docname.count("/") + f"_images/{file}.svg"
        return [raw_html(f'<img src="{source}" alt="{escape(alt)}" loading="lazy">')]


def setup(app: Sphinx) -> None:
    app.add_directive("picture", Picture)
