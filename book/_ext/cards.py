"""Small pictures from the executed notebooks: on the cards of the guides, and by functions.

- ``{guides}``: each guide with its question and the first picture that it draws.
- The page of a function that the thesis map names with a figure shows that figure, and leads to it.

The gallery extensions run scripts of their own; these pictures are in notebooks that ran already.
"""

from __future__ import annotations

import io
import re
from base64 import b64decode
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

import nbformat
from docutils import nodes
from PIL import Image
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from tables import line, link, raw_html
from thesis_map import find_items, read_map

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "build" / "notebooks"
WIDTH, HEIGHT = 480, 400  # px at most; shown at two thirds of it
MOST_BYTES = 20_000
TITLE = re.compile(r"^# (.*)$", re.M)
QUESTION = re.compile(r"\*\*The question\.\*\* (.*?)\n\n", re.S)


@dataclass(frozen=True)
class Picture:
    """A picture that a notebook drew."""

    stem: str
    content: bytes
    alt: str

    def small(self) -> Image.Image:
        image = Image.open(io.BytesIO(self.content)).convert("RGB")
        image.thumbnail((WIDTH, HEIGHT))
        return image

    def webp(self) -> bytes:
        """Return the small picture, as well as it can be in few bytes."""
        for quality in range(80, 0, -10):
            file = io.BytesIO()
            self.small().save(file, "webp", quality=quality)
            if file.tell() <= MOST_BYTES:
                break
        return file.getvalue()


@cache
def read_pictures() -> dict[str, Picture]:
    """Return the figures of the executed notebooks by name, and the first of each by its stem."""
    found: dict[str, Picture] = {}
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            shown = cell.metadata.get("mystnb", {})
            for output in cell.get("outputs", []):
                for kind in ("image/png", "image/jpeg"):
                    if content := output.get("data", {}).get(kind):
                        alt = shown.get("image", {}).get("alt", "")
                        picture = Picture(path.stem, b64decode(content), alt)
                        found.setdefault(shown.get("figure", {}).get("name", path.stem), picture)
                        found.setdefault(path.stem, picture)
    return found


@cache
def pictured() -> dict[str, str]:
    """Return the figure in which each function is at work, by the name of the function."""
    places = find_items(NOTEBOOKS)
    found: dict[str, str] = {}
    for item in read_map().values():
        _, anchor = places.get(item.id, ("", ""))
        if item.kind == "figure" and anchor in read_pictures():
            found |= {name: anchor for name in item.functions if name not in found}
    return found


class Guides(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        result = nodes.container(classes=["guides"])
        for path in sorted(NOTEBOOKS.glob("07_*.ipynb")):
            head = nbformat.read(path, as_version=4).cells[0].source
            title, question = TITLE.search(head), QUESTION.search(head)
            if title is None or question is None:
                raise ValueError(f"{path.name} must have a title and a question")
            label = nodes.paragraph(classes=["guide-title"])
            label += link(self.env, nodes.Text(title[1]), f"notebooks/{path.stem}", "")
            card = nodes.container(classes=["guide"])
            if picture := read_pictures().get(path.stem):
                up = "../" * self.env.docname.count("/")
                source = f"{up}_static/pictures/{path.stem}.webp"
                card += raw_html(f'<img src="{source}" alt="{escape(picture.alt)}" loading="lazy">')
            card += [label, line(" ".join(question[1].split()))]
            result += card
        return [result]


def show_picture(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Put the picture of a function behind the first paragraph of its docstring."""
    anchor = pictured().get(name)
    if anchor is None:
        return
    picture = read_pictures()[anchor]
    width, height = picture.small().size
    html = (
        f'<a class="function-picture" href="../notebooks/{picture.stem}.html#{anchor}">'
        f'<img src="../_static/pictures/{anchor}.webp" alt="{escape(picture.alt)}" '
        f'width="{2 * width // 3}" height="{2 * height // 3}" loading="lazy"></a>'
    )
    # Numpydoc may begin with empty lines.
    begin = next(k for k, text in enumerate(lines) if text)
    end = lines.index("", begin) if "" in lines[begin:] else len(lines)
    lines[end:end] = ["", ".. raw:: html", "", f"   {html}", ""]


def write_pictures(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "_static" / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in read_pictures().items():
        if name in pictured().values() or name.startswith("07_"):
            (folder / f"{name}.webp").write_bytes(picture.webp())


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("guides", Guides)
    # After numpydoc, which rewrites the lines it is given.
    app.connect("autodoc-process-docstring", show_picture, priority=900)
    app.connect("build-finished", write_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
