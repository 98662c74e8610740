"""What a link leads to, for the small window that ``_static/previews.js`` opens over it.

A page that was opened from a file may read no other page, so all previews stand in one script,
which is loaded when the first one is asked for. They are taken from the pages as they were built.
sphinx-hoverxref asks a server for them, and sphinx-tippy shows neither a formula nor a claim.
"""

from __future__ import annotations

import json
import re
from html import escape
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from thesis import preview_claims, preview_numbers
from thesis_map import TAG, read_map

ROOT = Path(__file__).resolve().parents[2]
FORMULA = re.compile(r'<div class="math notranslate nohighlight">\s*(\\\[.*?\\\])', re.S)
FIGURE = re.compile(
    r'<figure[^>]*id="(?P<id>[^"]+)".*?<img[^>]*alt="(?P<alt>[^"]*)"[^>]*src="(?:\.\./)*(?P<src>[^"]+)"'
    r'.*?<span class="caption-text">(?P<text>.*?)'
    r'(?:<span class="figure-data">|<a class="headerlink")',
    re.S,
)
CITATION = re.compile(r'<div class="citation" id="([^"]+)".*?<p>(.*?)</p>', re.S)
TERM = re.compile(r'<dt id="(term-[^"]+)">(.*?)<a.*?<dd>(.*?)</dd>', re.S)
TAGS = re.compile(r"<[^>]+>")


def plain(html: str) -> str:
    """Return a piece of a page without its links and other elements."""
    return TAGS.sub("", html).strip()


def preview_formulas(text: str) -> dict[str, str]:
    """Return each numbered formula of a page, as MathJax takes it, with what it says."""
    thesis = read_map()
    found = {}
    for formula in FORMULA.findall(text):
        for number in TAG.findall(formula):
            if f"equation-{number}" in thesis:
                what = escape(thesis[f"equation-{number}"].what)
                found[nodes.make_id(f"equation-{number}")] = f"<p>{what}</p><div>{formula}</div>"
    return found


def preview_figures(text: str) -> dict[str, str]:
    """Picture and caption; of a film, which lies in the page itself and is heavy, the caption."""
    found = {}
    for figure in FIGURE.finditer(text):
        picture = f'<img src="{figure["src"]}" alt="{figure["alt"]}">'
        shown = "" if figure["src"].startswith("data:") else picture
        found[figure["id"]] = f"{shown}<p>{plain(figure['text'])}</p>"
    return found


def preview_page(name: str, text: str) -> dict[str, str]:
    """Return what the anchors of a page stand for."""
    if name == "claims.html":
        return preview_claims()
    if name == "bibliography.html":
        return {anchor: f"<p>{plain(entry)}</p>" for anchor, entry in CITATION.findall(text)}
    if name == "symbols.html":
        return {a: f"<p><b>{plain(t)}</b> {plain(says)}</p>" for a, t, says in TERM.findall(text)}
    numbers = preview_numbers(Path(name).stem)
    return preview_formulas(text) | preview_figures(text) | numbers


def write_previews(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    out = Path(app.outdir)
    names = ["claims.html", "bibliography.html", "symbols.html"]
    names += [f"notebooks/{path.name}" for path in sorted((out / "notebooks").glob("*.html"))]
    previews = {
        f"{name}#{anchor}": preview
        for name in names
        for anchor, preview in preview_page(name, (out / name).read_text(encoding="utf-8")).items()
    }
    text = json.dumps(previews, ensure_ascii=False)
    (out / "_static" / "preview_data.js").write_text(
        f"globalThis.linkPreviews = {text};\n", encoding="utf-8"
    )


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("build-finished", write_previews)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
