"""Mend what the theme leaves: pages that ask other servers, and parts that not everyone can use.

MathJax comes from a package on disk as one file; the inert thebe loader goes; plotly's library is
copied once and loaded only by pages that hold one of its figures. Font preloads go too: a browser
refuses them for a page opened from a file, and loads the fonts from the style sheet anyway.

The toggles of the contents get a name for screen readers, and wide tables can be scrolled by
keyboard.
"""

from __future__ import annotations

import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.fileutil import copy_asset_file

MATHJAX = "mathjax/tex-svg-full.js"
PLOTLY = "plotly.min.js"
# No toolbar over a title.
PLOTLY_SETTINGS = "Plotly.setPlotConfig({displayModeBar: false});"
PLOTLY_INLINE = re.compile(r"<script[^>]*>(\s*window\.PLOTLYENV)")
TOGGLE = '<summary><span class="toctree-toggle"'
WIDE_TABLE = '<div class="pst-scrollable-table-container"'
MENDS = {
    TOGGLE: TOGGLE.replace("<summary", '<summary aria-label="subpages"'),
    '<div role="list" class="citation-list">': '<div class="citation-list">',
    WIDE_TABLE: f'{WIDE_TABLE} tabindex="0" role="region" aria-label="table"',
}
FONT_PRELOAD = re.compile(r'<link rel="preload" as="font"[^>]*>')


def package_folder(name: str) -> Path:
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        raise RuntimeError(f"the package {name} is not installed")
    return Path(spec.origin).parent


def use_local_mathjax(app: Sphinx, config: Any) -> None:
    config.mathjax_path = MATHJAX


def shape_page(app: Sphinx, page: str, template: str, context: dict, doctree: Any) -> None:
    def wanted(asset: Any) -> bool:
        inline = getattr(asset, "attributes", {}).get("body", "")
        return "thebe" not in f"{getattr(asset, 'filename', asset)} {inline}".lower()

    context["script_files"] = [s for s in context.get("script_files", []) if wanted(s)]
    context["css_files"] = [s for s in context.get("css_files", []) if wanted(s)]
    if "plotly-graph-div" in context.get("body", ""):
        # Deferred, and the figures' own scripts with it, so that the page shows before they draw.
        path = context["pathto"](f"_static/{PLOTLY}", 1)
        body = PLOTLY_INLINE.sub(rf'<script type="module">{PLOTLY_SETTINGS}\1', context["body"])
        context["body"] = f'<script defer src="{path}"></script>\n{body}'


def copy_libraries(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    static = Path(app.outdir) / "_static"
    (static / "mathjax").mkdir(parents=True, exist_ok=True)
    source = package_folder("sphinx-mathjax-offline") / "static" / MATHJAX
    copy_asset_file(str(source), str(static / MATHJAX))
    needs_plotly = False
    for page in Path(app.outdir).rglob("*.html"):
        html = page.read_text(encoding="utf-8")
        needs_plotly |= PLOTLY in html
        html = FONT_PRELOAD.sub("", html)
        for fault, mend in MENDS.items():
            html = html.replace(fault, mend)
        page.write_text(html, encoding="utf-8")
    if needs_plotly:
        library = package_folder("plotly") / "package_data" / PLOTLY
        copy_asset_file(str(library), str(static / PLOTLY))
    shutil.rmtree(static / "sphinx-thebe", ignore_errors=True)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("config-inited", use_local_mathjax, priority=900)
    app.connect("html-page-context", shape_page, priority=900)
    app.connect("build-finished", copy_libraries)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
