"""The built book: whole in its own folder, every link alive, and well in a real browser."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
# Pages that Sphinx makes for itself and no reader is sent to.
INTERNAL = {"genindex.html", "py-modindex.html"}


class Links(HTMLParser):
    """Collect a page's ids, its links, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.images_without_alt = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        self.ids |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if "src" in values:
            self.loads.append(values["src"])
        if tag == "link" and values.get("rel") not in (
            "canonical",
            "search",
            "next",
            "prev",
            "index",
        ):
            self.loads.append(values.get("href", ""))
        self.images_without_alt += tag == "img" and not values.get("alt")


@pytest.fixture(scope="module")
def pages(html: Path) -> dict[Path, Links]:
    return {
        p: Links(p.read_text(encoding="utf-8"))
        for p in sorted(html.rglob("*.html"))
        if "_static" not in p.parts
    }


def test_nothing_is_loaded_from_elsewhere(html: Path, pages: dict[Path, Links]) -> None:
    for path, page in pages.items():
        for url in page.loads:
            parts = urlsplit(url)
            if parts.scheme == "data" or not url:
                continue
            assert parts.scheme + parts.netloc == "", f"{path.name} loads {url}"
            assert (path.parent / unquote(parts.path)).exists(), f"{path.name} loads missing {url}"
    for sheet in html.rglob("*.css"):
        foreign = re.findall(
            r"(?:url\(|@import)\s*['\"]?(https?:)?//[^)'\"]+", sheet.read_text(encoding="utf-8")
        )
        assert not foreign, f"{sheet.name} loads {foreign}"


def test_every_internal_link_resolves(pages: dict[Path, Links]) -> None:
    for path, page in pages.items():
        for url in page.links:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc or url in ("#", ""):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.exists(), f"{path.name} links to missing {url}"
            if parts.fragment and target in pages and path.name not in INTERNAL:
                assert unquote(parts.fragment) in pages[target].ids, (
                    f"{path.name}: dead anchor {url}"
                )


def test_every_figure_has_alternative_text(pages: dict[Path, Links]) -> None:
    assert {p.name: n.images_without_alt for p, n in pages.items() if n.images_without_alt} == {}


def test_no_page_names_this_machine(html: Path) -> None:
    for path in html.rglob("*.html"):
        assert str(ROOT) not in path.read_text(encoding="utf-8"), path.name


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    executable = (
        os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    )
    if not executable:
        if os.environ.get("CI"):
            pytest.fail("CI must install a Chromium")
        pytest.skip("no Chromium on this machine (set CHROMIUM to its path)")
    with sync_playwright() as playwright:
        instance = playwright.chromium.launch(
            executable_path=executable,
            chromium_sandbox=False,
            args=["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        yield instance
        instance.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that notes everything that goes wrong in it and blocks every foreign request."""
    context = browser.new_context()
    page = context.new_page()
    page.faults = []  # type: ignore[attr-defined]
    note = page.faults.append  # type: ignore[attr-defined]

    def guard(route, request) -> None:
        if request.url.startswith(("file:", "data:", "blob:")):
            route.continue_()
        else:
            note(f"foreign request {request.url}")
            route.abort()

    page.route("**/*", guard)
    page.on("console", lambda m: note(f"console: {m.text}") if m.type == "error" else None)
    page.on("pageerror", lambda error: note(f"script: {error}"))
    page.on("requestfailed", lambda request: note(f"failed request {request.url}"))
    yield page
    context.close()


def test_every_page_opens_without_a_fault(page: Page, pages: dict[Path, Links]) -> None:
    for path in pages:
        if "http-equiv" in path.read_text(encoding="utf-8"):
            continue  # index.html only sends the reader on
        page.goto(path.as_uri())
        page.evaluate("window.MathJax?.startup?.promise")
        assert page.faults == [], f"{path.name}: {page.faults}"  # type: ignore[attr-defined]
        assert page.locator("mjx-merror").count() == 0, f"{path.name} has a formula MathJax refuses"


def test_equations_are_drawn(page: Page, html: Path) -> None:
    page.goto((html / "notebooks" / "04_mechanical_characterization.html").as_uri())
    page.evaluate("MathJax.startup.promise")
    assert page.locator("mjx-container").count() > 20
    tags = page.locator("mjx-container[display=true]").evaluate_all("nodes => nodes.length")
    assert tags >= 7  # (4.1) to (4.7)


def test_search_finds_a_word(page: Page, html: Path) -> None:
    page.goto((html / "search.html").as_uri() + "?q=chorion")
    page.wait_for_selector("ul.search li a", timeout=10_000)
    found = page.locator("ul.search li a").all_inner_texts()
    assert any("Mechanical characterization" in text for text in found), found
    assert page.faults == []  # type: ignore[attr-defined]
