"""Pictures that notebooks drew, on other pages: ``{picture}`` with a figure's name shows one, and
``{guides}`` each guide with its purpose and its first.

The gallery extensions run scripts of their own; these pictures are in notebooks that ran already.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import nbformat
from book_tables import line, link, raw_html
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "build" / "notebooks"
TITLE = re.compile(r"^# (.*)$", re.M)
PURPOSE = re.compile(r"^(This guide .*?\.)\s", re.M | re.S)


@cache
def read_pictures() -> dict[str, tuple[str, str]]:
    """Return what each figure shows and its SVG, by its name; the first of a guide by its stem."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            shown = cell.metadata.get("mystnb", {})
            for output in cell.get("outputs", []):
                if picture := output.get("data", {}).get("image/svg+xml"):
                    entry = shown.get("image", {}).get("alt", ""), picture
                    found.setdefault(path.stem, entry)
                    found.setdefault(shown.get("figure", {}).get("name", path.stem), entry)
    return found


def show_picture(env: Any, name: str) -> nodes.raw:
    """Return a picture's element; its file is that of its own page, which its hash names."""
    alt, picture = read_pictures()[name]
    file = hashlib.sha256("\n".join(picture.splitlines()).encode()).hexdigest()
    source = "../" * env.docname.count("/") + f"_images/{file}.svg"
    return raw_html(f'<img src="{source}" alt="{escape(alt)}" loading="lazy">')


class Picture(SphinxDirective):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        return [show_picture(self.env, self.arguments[0])]


class Guides(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        result = nodes.container(classes=["guides"])
        for path in sorted(NOTEBOOKS.glob("07_*.ipynb")):
            head = nbformat.read(path, as_version=4).cells[0].source
            title, purpose = TITLE.search(head), PURPOSE.search(head)
            if title is None or purpose is None:
                raise ValueError(f"{path.name} must have a title and say what it does")
            name = link(self.env, nodes.Text(title[1]), f"notebooks/{path.stem}", "")
            label = nodes.paragraph("", "", name, classes=["guide-title"])
            card = nodes.container(classes=["guide"])
            if path.stem in read_pictures():
                card += show_picture(self.env, path.stem)
            card += [label, line(" ".join(purpose[1].split()))]
            result += card
        return [result]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("picture", Picture)
    app.add_directive("guides", Guides)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
