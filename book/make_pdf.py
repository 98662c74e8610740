"""Make one PDF of the built book, and one of its summary, printed by a headless Chromium.

``make pdf`` runs it after ``make html``. All pages become one, so that links between them hold in
the PDF; its links, its bookmarks and the numbers below its pages are the browser's. On which page
a chapter begins is read from a first print, and stands in the contents of the next.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from html import escape, unescape
from pathlib import Path
from posixpath import dirname, join, normpath

import yaml
from playwright.sync_api import Browser, Page, sync_playwright

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
STYLE = """<style>
.printed-page { break-before: page; }
.contents { columns: 2; column-gap: 3em; }
.contents h3 { font-size: 1em; margin: 0.8em 0 0.2em; break-after: avoid; }
.contents ol { list-style: none; margin: 0; padding: 0; }
.contents li { display: flex; gap: 1em; justify-content: space-between; align-items: end; }
.contents a { min-width: 0; overflow-wrap: anywhere; }
.contents [data-page] { flex: none; width: 2.5em; text-align: right; }
</style>"""
# What the browser writes into a PDF: the tree of pages, and a table from anchors to pages.
OBJECT = re.compile(rb"^(\d+) 0 obj\n(.*?)^endobj", re.S | re.M)
KIDS = re.compile(rb"/Kids \[(.*?)\]", re.S)
DESTINATION = re.compile(rb"/([^\s/<>\[\]]+) \[(\d+) 0 R /XYZ")
# One to see the numbers, one with them, and more if they or what is loaded late moved a page.
MOST_PRINTS = 6
# Formulas in every script of a big page take their time, s.
PATIENCE = 600


def parts_in_order() -> list[tuple[str, list[str]]]:
    """Return the parts of the contents with their pages, and last the library's functions."""
    contents = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
    parts = [
        (
            part["caption"],
            [
                one["file"]
                for chapter in part["chapters"]
                for one in (chapter, *chapter.get("sections", []))
            ],
        )
        for part in contents["parts"]
    ]
    library = sorted(f"generated/{path.stem}" for path in (HTML / "generated").glob("*.html"))
    return [("", [contents["root"]]), *parts, ("The library's functions", library)]


def pages_in_order() -> list[str]:
    """Return the written pages as the contents have them, then those of the library's functions."""
    return [page for _, pages in parts_in_order() for page in pages]


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
    return LOADED.sub(load, LINKED.sub(lead, body)).replace(' loading="lazy"', "")


def title_of(html: Path, page: str) -> str:
    match = TITLE.search((html / f"{page}.html").read_text(encoding="utf-8"))
    return match[1].strip() if match else page


def list_contents(html: Path, pages: list[str]) -> str:
    """Return the contents of some pages, by part, with room for the number of each page."""
    shown = []
    for caption, members in parts_in_order():
        lines = "".join(
            f'<li><a href="#{slug(page)}">{title_of(html, page)}</a>'
            f'<span data-page="{slug(page)}"></span></li>'
            for page in members
            if page in pages[1:]
        )
        if lines:
            shown.append(f"<h3>{escape(caption)}</h3><ol>{lines}</ol>")
    return f'<h2>Contents</h2><div class="contents">{"".join(shown)}</div>'


def combine(html: Path, pages: list[str]) -> str:
    """Return one page of many, with contents behind the first; of one, that page alone."""
    home = (html / f"{pages[0]}.html").read_text(encoding="utf-8")
    head = home[home.index("<head>") : home.index("</head>")]
    head = TITLE.sub(f"<title>{title_of(html, pages[0])}</title>", head)
    parts = [
        f'<section class="printed-page" id="{slug(page)}">{gather(html, page, pages)}</section>'
        for page in pages
    ]
    if len(pages) > 1:
        parts.insert(1, f'<nav class="printed-page">{list_contents(html, pages)}</nav>')
    return (
        f'<!DOCTYPE html><html lang="en" data-content_root="./" data-theme="light">{head}'
        f"{STYLE}</head>"
        f'<body><article class="bd-article bd-content">{"".join(parts)}</article></body></html>'
    )


def page_numbers(pdf: bytes) -> dict[str, int]:
    """Return the number of the page on which each linked anchor of a printed PDF stands."""
    objects = {int(number): body for number, body in OBJECT.findall(pdf)}
    kids = {
        number: [int(kid) for kid in re.findall(rb"(\d+) 0 R", listed[1])]
        for number, body in objects.items()
        if b"/Type /Pages" in body and (listed := KIDS.search(body))
    }
    inner = {kid for group in kids.values() for kid in group}

    def leaves(number: int) -> list[int]:
        return (
            [leaf for kid in kids[number] for leaf in leaves(kid)] if number in kids else [number]
        )

    roots = [number for number in kids if number not in inner]
    order = {leaf: k for k, leaf in enumerate((p for r in roots for p in leaves(r)), 1)}
    # The table is an object of its own; bookmarks lead to pages without a name.
    table = max(objects.values(), key=lambda body: len(DESTINATION.findall(body)), default=b"")
    return {name.decode(): order[int(page)] for name, page in DESTINATION.findall(table)}


def print_page(page: Page) -> bytes:
    return page.pdf(
        format="A4",
        margin={"top": "18mm", "bottom": "20mm", "left": "16mm", "right": "16mm"},
        display_header_footer=True,
        header_template=NOTHING,
        footer_template=NUMBERS,
        outline=True,
        tagged=True,
        print_background=True,
    )


def print_numbered(page: Page) -> bytes:
    """Print until the contents have the numbers of the pages on which the anchors stand."""
    listed = page.locator("[data-page]").evaluate_all("all => all.map(one => one.dataset.page)")
    numbers: dict[str, int] = {}
    for turn in range(MOST_PRINTS):
        printed = print_page(page)
        every = page_numbers(printed)
        found = {name: every[name] for name in listed}
        if found == numbers:
            return printed
        if turn % 2:  # Chromium may break a page in two ways, in turn: the next print is as before
            continue
        numbers = found
        page.evaluate(
            """numbers => document.querySelectorAll("[data-page]").forEach(
                one => { one.textContent = numbers[one.dataset.page]; })""",
            numbers,
        )
    raise ValueError("page must keep its breaks when its contents are numbered, moved some")


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
        target.write_bytes(print_numbered(page))
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
        )
        make_pdf(chromium, HTML.resolve(), pages_in_order(), PDF)
        make_pdf(chromium, HTML.resolve(), ["summary"], PDF.with_name("summary.pdf"))
        chromium.close()
    # Beside the pages, and from now on their footers lead to it.
    for made in (PDF, PDF.with_name("summary.pdf")):
        shutil.copy(made, HTML / made.name)
    style = HTML / "_static" / "pdf.css"
    style.write_text("a.pdf-link { display: inline; }\n", encoding="utf-8")
