"""The directive ``{guides}``: each guide with its question and the first picture that it draws."""

from __future__ import annotations

import io
import re
from base64 import b64decode
from dataclasses import dataclass
from pathlib import Path

import nbformat
from docutils import nodes
from PIL import Image
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "build" / "notebooks"
WIDTH = 480  # px; shown at half of it or less
TITLE = re.compile(r"^# (.*)$", re.M)
QUESTION = re.compile(r"\*\*The question\.\*\* (.*?)\n\n", re.S)


@dataclass(frozen=True)
class Guide:
    """What the list says of a guide."""

    stem: str
    title: str
    question: str
    picture: bytes
    alt: str


def read_guides() -> list[Guide]:
    return [read_guide(path) for path in sorted(NOTEBOOKS.glob("07_*.ipynb"))]


def read_guide(path: Path) -> Guide:
    cells = nbformat.read(path, as_version=4).cells
    head = cells[0].source
    title, question = TITLE.search(head), QUESTION.search(head)
    drawn = [
        (picture, cell.metadata.get("mystnb", {}).get("image", {}).get("alt", ""))
        for cell in cells
        if cell.cell_type == "code"
        for output in cell.outputs
        for kind, picture in output.get("data", {}).items()
        if kind in ("image/png", "image/jpeg")
    ]
    if title is None or question is None or not drawn:
        raise ValueError(f"{path.name} must have a title, a question and a picture")
    asked = " ".join(question[1].split())
    return Guide(path.stem, title[1], asked, b64decode(drawn[0][0]), drawn[0][1])


class Guides(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        result = nodes.container(classes=["guides"])
        for guide in read_guides():
            uri = self.env.app.builder.get_relative_uri(self.env.docname, f"notebooks/{guide.stem}")
            link = nodes.reference("", "", internal=True, refuri=uri)
            link += nodes.Text(guide.title)
            title = nodes.paragraph(classes=["guide-title"])
            title += link
            up = "../" * self.env.docname.count("/")
            alt = guide.alt.replace('"', "&quot;")
            picture = f'<img src="{up}_static/guides/{guide.stem}.png" alt="{alt}" loading="lazy">'
            card = nodes.container(classes=["guide"])
            card += [
                nodes.raw("", picture, format="html"),
                title,
                nodes.paragraph(guide.question, guide.question),
            ]
            result += card
        return [result]


def write_pictures(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "_static" / "guides"
    folder.mkdir(parents=True, exist_ok=True)
    for guide in read_guides():
        image = Image.open(io.BytesIO(guide.picture)).convert("RGB")
        image.thumbnail((WIDTH, WIDTH))
        image.save(folder / f"{guide.stem}.png")


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("guides", Guides)
    app.connect("build-finished", write_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
