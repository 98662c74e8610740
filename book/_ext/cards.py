"""The directive ``{guides}``: each guide with its purpose and the first picture that it draws.

The gallery extensions run scripts of their own; these pictures are in notebooks that ran already.
"""

from __future__ import annotations

import re
from functools import cache
from html import escape
from pathlib import Path

import nbformat
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from tables import line, link, raw_html

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "build" / "notebooks"
TITLE = re.compile(r"^# (.*)$", re.M)
PURPOSE = re.compile(r"^(This guide .*?\.)\s", re.M | re.S)


@cache
def read_pictures() -> dict[str, tuple[str, str]]:
    """Return the first picture that each guide drew and what it shows, by the guide's stem."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted(NOTEBOOKS.glob("07_*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            for output in cell.get("outputs", []):
                if picture := output.get("data", {}).get("image/svg+xml"):
                    alt = cell.metadata.get("mystnb", {}).get("image", {}).get("alt", "")
                    found.setdefault(path.stem, (alt, picture))
    return found


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
                alt = escape(read_pictures()[path.stem][0])
                up = "../" * self.env.docname.count("/")
                source = f"{up}_static/pictures/{path.stem}.svg"
                card += raw_html(f'<img src="{source}" alt="{alt}" loading="lazy">')
            card += [label, line(" ".join(purpose[1].split()))]
            result += card
        return [result]


def write_pictures(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "_static" / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for name, (_, picture) in read_pictures().items():
        (folder / f"{name}.svg").write_text(picture, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("guides", Guides)
    app.connect("build-finished", write_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
