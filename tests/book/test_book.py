"""The built book: whole in its own folder, every link alive, and well in a real browser."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Pages that Sphinx makes for itself and no reader is sent to.
INTERNAL = {"genindex.html", "py-modindex.html"}
# Relations of a page to others, which load nothing.
LEADS_ON = {"canonical", "search", "next", "prev", "index"}


class Links(HTMLParser):
    """Collect a page's ids, its links, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: set[str] = set()
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        self.ids |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.add(values["href"])
        if "src" in values:
            self.loads.append(values["src"])
        if tag == "link" and values.get("rel") not in LEADS_ON:
            self.loads.append(values.get("href", ""))


@pytest.fixture(scope="module")
def pages(html: Path) -> dict[Path, Links]:
    return {
        p: Links(p.read_text(encoding="utf-8"))
        for p in sorted(html.rglob("*.html"))
        if "_static" not in p.parts
    }


def test_pages_load_and_name_nothing_outside_their_folder(
    html: Path, pages: dict[Path, Links]
) -> None:
    for path, page in pages.items():
        assert str(ROOT) not in path.read_text(encoding="utf-8"), path.name
        for url in page.loads:
            parts = urlsplit(url)
            if parts.scheme == "data" or not url:
                continue
            assert parts.scheme + parts.netloc == "", f"{path.name} loads {url}"
            assert (path.parent / unquote(parts.path)).exists(), f"{path.name} loads missing {url}"
    foreign = re.compile(r"(?:url\(|@import)\s*['\"]?(https?:)?//[^)'\"]+")
    for sheet in html.rglob("*.css"):
        assert not foreign.search(sheet.read_text(encoding="utf-8")), sheet.name


def test_every_internal_link_resolves(pages: dict[Path, Links]) -> None:
    for path, page in pages.items():
        for url in page.links:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc or url in ("#", "") or url.endswith("book.pdf"):
                continue  # the PDF is made after the pages
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.exists(), f"{path.name} links to missing {url}"
            if parts.fragment and target in pages and path.name not in INTERNAL:
                anchor = unquote(parts.fragment)
                assert anchor in pages[target].ids, f"{path.name}: dead anchor {url}"


def test_pages_and_pictures_stay_below_size_limits(pages: dict[Path, Links], html: Path) -> None:
    """A page stays under 1 MB and its own pictures under 4 MB: chapter 5 has nine photographs
    with all their pixels. What pages share is not counted. The whole stays under 35 MB."""
    whole = sum(path.stat().st_size for path in html.resolve().rglob("*") if path.is_file())
    assert whole < 35e6, f"{whole / 1e6:.1f} MB"
    assert not list((html / "_static" / "vendor").rglob("fontawesome/**/*.js")), "1.5 MB a page"
    for path, page in pages.items():
        loads = {unquote(urlsplit(u).path) for u in page.loads if "_images" in u}
        own = {(path.parent / one).resolve() for one in loads}
        size, pictures = path.stat().st_size, sum(file.stat().st_size for file in own)
        assert size < 1e6, f"{path.name} weighs {size / 1e6:.2f} MB"
        assert pictures < 4e6, f"{path.name} has pictures of {pictures / 1e6:.2f} MB"


def test_missed_limit_is_on_the_page_of_its_benchmark_with_its_size(html: Path) -> None:
    page = (html / "benchmarks_focus.html").read_text(encoding="utf-8")
    record = json.loads((ROOT / "benchmarks" / "results" / "focus_speed.json").read_text("utf-8"))
    for what, measured, _, holds in record["limits"]:
        row = f'<p>{what}</p></td>\n<td class="number"><p>{measured}</p>'
        assert (row in page) == (holds == "no"), what
