"""Make one PDF of the built book: its pages in order, printed by a headless Chromium.

``make pdf`` runs it after ``make html``. All pages become one, so that links between them hold in
the PDF; the links of its contents, its bookmarks and its page numbers are the browser's.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from html import unescape
from pathlib import Path
from posixpath import dirname, join, normpath

import yaml
from playwright.sync_api import Browser, sync_playwright

ROOT = Path(__file__).resolve().parents[1]
HTML = ROOT / "build" / "html"
PDF = ROOT / "build" / "book.pdf"
ARTICLE = re.compile(r'<article class="bd-article">(.*)</article>', re.S)
TITLE = re.compile(r"<title>(.*?)(?: &#8212;.*?)?</title>", re.S)
IDENTIFIED = re.compile(r'(<[^>]*?\s)id="([^"]*)"')
LINKED = re.compile(r'(<a\s[^>]*?)href="([^"]*)"')
LOADED = re.compile(r'\ssrc="(?!data:)([^"]*)"')
NUMBERS = (
    '<div style="width: 100%; font: 8pt sans-serif; text-align: center">'
    '<span class="pageNumber"></span></div>'
)
NOTHING = "<span></span>"
# Formulas in every script of a big page take their time, s.
PATIENCE = 600


def pages_in_order() -> list[str]:
    """Return the written pages as the contents have them, then those of the library's functions."""
    contents = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
    written = [chapter["file"] for part in contents["parts"] for chapter in part["chapters"]]
    library = sorted(f"generated/{path.stem}" for path in (HTML / "generated").glob("*.html"))
    return [contents["root"], *written, *library]


def slug(page: str) -> str:
    return re.sub(r"\W+", "-", page)


def gather(html: Path, page: str, pages: list[str]) -> str:
    """Return the body of a page with its anchors and links made those of the whole."""
    match = ARTICLE.search((html / f"{page}.html").read_text(encoding="utf-8"))
    if match is None:
        raise ValueError(f"page must hold an article, got {page}")

    def lead(link: re.Match[str]) -> str:
        address = unescape(link[2])
        if re.match(r"\w+:", address):
            return link[0]
        file, _, anchor = address.partition("#")
        target = normpath(join(dirname(page), file)).removesuffix(".html") if file else page
        if target not in pages:
            return link[1]  # a download, or a test's source: on paper it leads nowhere
        return f'{link[1]}href="#{slug(target)}{"--" + anchor if anchor else ""}"'

    def load(loaded: re.Match[str]) -> str:
        return f' src="{normpath(join(dirname(page), loaded[1]))}"'

    body = IDENTIFIED.sub(rf'\1id="{slug(page)}--\2"', match[1])
    return LOADED.sub(load, LINKED.sub(lead, body))


def title_of(html: Path, page: str) -> str:
    match = TITLE.search((html / f"{page}.html").read_text(encoding="utf-8"))
    return match[1].strip() if match else page


def combine(html: Path, pages: list[str]) -> str:
    """Return one page of many, with contents in front."""
    home = (html / f"{pages[0]}.html").read_text(encoding="utf-8")
    head = home[home.index("<head>") : home.index("</head>")]
    contents = "".join(
        f'<li><a href="#{slug(page)}">{title_of(html, page)}</a></li>' for page in pages[1:]
    )
    parts = [
        f'<section class="printed-page" id="{slug(page)}">{gather(html, page, pages)}</section>'
        for page in pages
    ]
    parts.insert(1, f'<nav class="printed-page"><h2>Contents</h2><ol>{contents}</ol></nav>')
    return (
        f'<!DOCTYPE html><html lang="en" data-content_root="./" data-theme="light">{head}'
        "<style>.printed-page { break-before: page; } nav ol { columns: 2; }</style></head>"
        f'<body><article class="bd-article bd-content">{"".join(parts)}</article></body></html>'
    )


def make_pdf(browser: Browser, html: Path, pages: list[str], target: Path) -> None:
    """Print pages of the built book to one PDF, A4."""
    whole = html / "whole_book.html"  # beside the pages, for the sake of their pictures
    whole.write_text(combine(html, pages), encoding="utf-8")
    context = browser.new_context(offline=True, viewport={"width": 700, "height": 1000})
    try:
        page = context.new_page()
        page.set_default_timeout(PATIENCE * 1000)
        page.goto(whole.as_uri())
        page.wait_for_function("window.formulasFit")
        page.pdf(
            path=target,
            format="A4",
            margin={"top": "18mm", "bottom": "20mm", "left": "16mm", "right": "16mm"},
            display_header_footer=True,
            header_template=NOTHING,
            footer_template=NUMBERS,
            outline=True,
            tagged=True,
            print_background=True,
        )
    finally:
        context.close()
        whole.unlink()


if __name__ == "__main__":
    found = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if not found:
        sys.exit("make pdf needs a Chromium (set CHROMIUM to its path)")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=found,
            chromium_sandbox=False,
            # 3-D figures are drawn without a graphics card.
            args=["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        make_pdf(chromium, HTML.resolve(), pages_in_order(), PDF)
        chromium.close()
