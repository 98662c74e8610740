"""Change what the theme leaves: pages that ask other servers, and parts that not everyone can use.

MathJax comes from a package on disk, without its menu, which makes each formula a stop of the
tabulator; the inert thebe loader goes. Font preloads go too:
a browser refuses them for a page opened from a file, and loads the fonts from the style sheet
anyway. The sidebar shows the part of the open page; the other parts are closed. The toggles of the
contents get a name for screen readers, wide tables can be scrolled by keyboard, empty heads of
tables are no heads, and each figure has two looks and opens larger. The theme has no setting for
any of it.
"""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from book_tables import when_written
from sphinx.application import Sphinx

from compendium import ROOT
from microlib import __version__

# The parts of MathJax that pages load; the last comes with the one before it.
MATHJAX = ("core", "a11y/assistive-mml", "input/tex", "output/svg", "output/svg/fonts/tex")
# Regular expressions and their replacements in every page.
HTML_FIXES: dict[str, str | Callable[[re.Match[str]], str]] = {
    r'<link rel="preload" as="font"[^>]*>': "",
    r'<script src="[^"]*/fontawesome/[^"]*\.js[^"]*"></script>': "",
    r'<summary>(?=<span class="toctree-toggle")': '<summary aria-label="subpages">',
    r' role="doc-biblioentry"| role="list"(?= class="citation-list")': "",
    r'(?<=class="pst-scrollable-table-container")': ' tabindex="0" role="group" aria-label="table"',
    r'<div (?=class="bd-sidebar-primary )': '<div role="complementary" aria-label="book" ',
    # The parts of the sidebar are closed, but for the one that holds the open page.
    r'<p [^>]*class="caption" role="heading"><span class="caption-text">([^<]*)</span></p>'
    r'\s*(<ul class="(current)?[^"]*bd-sidenav">(?s:.*?)</ul>)(?=\s*(?:<p aria|</div>|<details))': (
        lambda part: (
            f'<details class="part-of-book"{" open" if part[3] else ""}>'
            f"<summary>{part[1]}</summary>{part[2]}</details>"
        )
    ),
    r"<th([^>]*)>(?:&nbsp;|<p></p>|\s)*</th>": r"<td\1></td>",
    # A figure's file has two looks, the second for a dark page (`compendium.figures.style`).
    r'<img ([^>]*src="[^"]*_images/[^"]+\.svg)("[^>]*>)': (
        r'<img class="only-light" \1\2<img class="only-dark" \1#dark\2'
    ),
    r'(<figure[^>]*>\s*)((?:<img [^>]*src="(?!data:)([^"#]+)[^>]*>)+)': (
        r'\1<a class="enlarge" href="\3">\2</a>'
    ),
}


def package_folder(name: str) -> Path:
    return Path(find_spec(name).origin).parent


def configure(app: Sphinx, config: Any) -> None:
    """Take the local MathJax, and say which version of the project the pages are of."""
    config.mathjax_path = "mathjax/startup.js"
    config.mathjax3_config = {"loader": {"load": MATHJAX[:-1]}}
    command = ["git", "-C", app.srcdir, "log", "-1", "--format=%cs"]
    day = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    config.html_context |= {"project_version": __version__, "project_day": day}


def shape_page(app: Sphinx, page: str, template: str, context: dict, doctree: Any) -> None:
    def wanted(asset: Any) -> bool:
        inline = getattr(asset, "attributes", {}).get("body", "")
        return "thebe" not in f"{getattr(asset, 'filename', asset)} {inline}".lower()

    context["script_files"] = [s for s in context.get("script_files", []) if wanted(s)]
    context["css_files"] = [s for s in context.get("css_files", []) if wanted(s)]


def embed_icons(static: Path) -> None:
    """Put the font of the icons into their style sheet, and drop the script that draws them.

    The script weighs 1.5 MB on every page. The font is inside of the sheet because browsers refuse
    fonts in other files for a page that is opened from a file. All icons of the theme are solid.
    """
    for sheet in static.glob("vendor/fontawesome/*/css/all.min.css"):
        folder = sheet.parents[1]
        font = base64.b64encode((folder / "webfonts" / "fa-solid-900.woff2").read_bytes()).decode()
        face = (
            '@font-face{font-family:"Font Awesome 6 Free";font-style:normal;font-weight:900;'
            f"font-display:block;src:url(data:font/woff2;base64,{font})}}"
        )
        rules = re.sub(r"@font-face{[^}]*}", "", sheet.read_text(encoding="utf-8"))
        sheet.write_text(rules + face, encoding="utf-8")
        for unused in ("js", "webfonts"):
            shutil.rmtree(folder / unused)


def copy_libraries(app: Sphinx) -> None:
    static = Path(app.outdir) / "_static"
    source = package_folder("sphinx-mathjax-offline") / "static" / "mathjax"
    for part in ("startup", *MATHJAX):
        (static / "mathjax" / part).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / f"{part}.js", static / "mathjax" / f"{part}.js")
    for page in Path(app.outdir).rglob("*.html"):
        html = page.read_text(encoding="utf-8")
        for pattern, replacement in HTML_FIXES.items():
            html = re.sub(pattern, replacement, html)
        page.write_text(html, encoding="utf-8")
    embed_icons(static)
    # What no page needs: maps for who changes the theme, fonts for old browsers, other languages.
    for unused in [*static.rglob("*.map"), *static.rglob("*.ttf")]:
        unused.unlink()
    for folder in ("sphinx-thebe", "locales"):
        shutil.rmtree(static / folder, ignore_errors=True)
    # A reader downloads a notebook to run it: without what it drew, which the page shows.
    for copy in (Path(app.outdir) / "_sources" / "notebooks").glob("*.ipynb"):
        shutil.copy(ROOT / "notebooks" / copy.name, copy)


def setup(app: Sphinx) -> None:
    app.connect("config-inited", configure, priority=900)
    app.connect("html-page-context", shape_page, priority=900)
    when_written(app, copy_libraries)
