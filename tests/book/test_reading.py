"""Nothing is cut or trapped on any screen or on paper, and everything leads on."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from docutils import nodes
from PIL import Image
from playwright.sync_api import Browser, Page

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "book" / "_ext"), str(Path(__file__).parent)]
from browsing import open_page  # noqa: E402
from pictures import PICTURES  # noqa: E402
from test_sources import line_of, place_of_test  # noqa: E402

SURFACES = "notebooks/03_visual_reconstruction_and_classification.html"
CHAPTER = "notebooks/04_mechanical_characterization.html"


def test_every_claim_leads_to_its_cell_its_test_and_its_erratum(html: Path) -> None:
    text = (html / "claims.html").read_text(encoding="utf-8")
    rows = dict(re.findall(r'<tr class="[^"]*" id="(claim-[^"]+)">(.*?)</tr>', text, re.S))
    claims = ledger.claims()
    assert rows.keys() == {nodes.make_id(f"claim-{name}") for name in claims}
    for claim in claims.values():
        row = rows[nodes.make_id(f"claim-{claim.id}")]
        if claim.verdict not in ("given", "lost"):
            assert re.search(r'href="notebooks/0\d_\w+\.html#cell-', row), claim.id
        if claim.test:
            page, anchor = place_of_test(claim.test)
            assert f'href="{page}.html#{anchor}"' in row, claim.id
    for name, entry in ledger.errata().items():
        for claim_id in entry.get("claims", "").split():
            assert (
                f"errata.html#erratum-{nodes.make_id(name)}"
                in rows[nodes.make_id(f"claim-{claim_id}")]
            ), name


def test_every_erratum_leads_to_its_proof_and_its_claims(html: Path) -> None:
    text = (html / "errata.html").read_text(encoding="utf-8")
    ways = re.findall(r'<p class="erratum-sources">(.*?)</p>', text, re.S)
    assert len(ways) == len(ledger.errata())
    for way, (name, entry) in zip(ways, ledger.errata().items(), strict=True):
        line = line_of(entry["test"], f'"{name}": (')
        assert f'href="_tests/compendium/test_errata.html#line-{line}"' in way
        for claim in entry.get("claims", "").split():
            assert f'href="claims.html#{nodes.make_id(f"claim-{claim}")}"' in way
        if name.startswith("equation"):
            assert f"#{nodes.make_id(name)}" in way


def test_a_badge_leads_to_its_claim(page: Page, html: Path) -> None:
    open_page(page, html / "intro.html")
    page.locator("article .verdict").first.click()
    assert page.url.endswith("claims.html#claim-table-5-6-e")
    page.wait_for_function("""() => {
        const top = document.querySelector("tr:target")?.getBoundingClientRect().top;
        return 0 <= top && top < 700;
    }""")


def test_search_leads_to_a_number_first(page: Page, html: Path) -> None:
    for query, first in (
        ("5.6", "Section 5.6 Mechanical characterization"),
        ("equation (4.7)", "Equation (4.7): "),
    ):
        page.goto((html / "search.html").as_uri() + f"?q={query}")
        page.wait_for_selector("ul.search li a")
        assert page.locator("ul.search li a").first.inner_text().startswith(first)
    page.goto((html / "search.html").as_uri() + "?q=chorion")
    page.wait_for_selector("ul.search li a")
    assert page.locator(".number-results").count() == 0


def test_every_number_of_the_thesis_is_found_and_leads_somewhere(page: Page, html: Path) -> None:
    text = (html / "_static" / "numbers.js").read_text(encoding="utf-8")
    numbers = json.loads(text.partition("= ")[2].rstrip(";\n"))
    kinds = [kind for entries in numbers.values() for kind, *_ in entries]
    assert {kind: kinds.count(kind) for kind in ("equation", "figure", "table")} == {
        "equation": 63,
        "figure": 30,
        "table": 8,
    }
    assert kinds.count("section") > 20
    asked = {
        "section": ("Section {}", "sec. {}", "§ {}", "section {} of the thesis"),
        "equation": ("equation ({})", "Eq. {}", "eq ({})"),
        "figure": ("figure {}", "Fig. {}", "fig.{}"),
        "table": ("Table {}", "tab. {}"),
    }
    queries = {}
    for number, entries in numbers.items():
        assert "section" not in [kind for kind, *_ in entries[1:]], number
        queries |= dict.fromkeys((number, f"({number})", f"what is {number}?"), entries[0])
        for entry in entries:
            queries |= {form.format(number): entry for form in asked[entry[0]]}
            name, _, anchor = entry[2].partition("#")
            target = (html / name).read_text(encoding="utf-8")
            assert not anchor or f'id="{anchor}"' in target, entry[2]
    queries |= dict.fromkeys(("4X zoom", "3-D surface", "16 frames", "4.99X", "v2.1"), None)
    page.goto((html / "search.html").as_uri())
    found = page.evaluate("all => all.map(one => findNumber(one)[0] ?? null)", list(queries))
    assert dict(zip(queries, found, strict=True)) == queries


def test_a_page_is_scrolled_over_its_surfaces(browser: Browser, html: Path) -> None:
    context = browser.new_context(
        offline=True, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    page = context.new_page()
    page.goto((html / SURFACES).as_uri())
    page.wait_for_selector(".turn-surface", timeout=30_000)
    figure = page.locator(".plotly-graph-div").first
    assert figure.evaluate("one => getComputedStyle(one).pointerEvents") == "none"
    page.locator(".turn-surface").first.click()
    assert figure.evaluate("one => getComputedStyle(one).pointerEvents") == "auto"
    assert page.locator(".modebar").count() == 0
    sizes = figure.evaluate("""one => ["xaxis", "yaxis", "zaxis"].map(
        name => one._fullLayout.scene[name].tickfont.size).concat(one._fullLayout.font.size)""")
    assert min(sizes) >= 16  # px, as the page's text
    context.close()


def test_a_wheel_scrolls_the_page_and_surfaces_are_dark(page: Page, html: Path) -> None:
    page.add_init_script("localStorage.mode = 'dark'; localStorage.theme = 'dark'")
    page.goto((html / SURFACES).as_uri())
    page.wait_for_selector(".turn-surface", state="attached", timeout=30_000)
    figure = page.locator(".plotly-graph-div").first
    figure.scroll_into_view_if_needed()
    box = figure.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    before = page.evaluate("scrollY")
    page.mouse.wheel(0, 200)
    page.wait_for_function(f"scrollY > {before} + 100")
    assert page.faults == []  # type: ignore[attr-defined]
    ground = page.evaluate("""() => [
        document.querySelector(".plotly-graph-div").layout.paper_bgcolor,
        getComputedStyle(document.documentElement).getPropertyValue("--pst-color-background")]""")
    assert ground[0] == ground[1]


def test_paper_has_whole_code_and_nothing_of_the_screen(page: Page, html: Path) -> None:
    open_page(page, html / CHAPTER)
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 650, "height": 900})  # A4 within its margins
    gone = ".bd-sidebar-primary, .prev-next-footer, .turn-surface, details.hide summary"
    assert (
        page.locator(gone).evaluate_all("all => all.filter(e => e.checkVisibility()).length") == 0
    )
    cut = page.locator("pre").evaluate_all(
        "all => all.filter(e => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1).length"
    )
    assert cut == 0
    parted = page.locator("figure").evaluate_all(
        "all => all.filter(e => getComputedStyle(e).breakInside !== 'avoid').length"
    )
    assert parted == 0


@pytest.mark.parametrize(
    ("name", "tables", "cells"),
    [
        ("benchmarks.html", "section table:has(th:nth-child(7))", "th"),
        ("claims.html", "table.claims", ".claim-test"),
    ],
)
def test_wide_tables_fit_with_whole_words(
    page: Page, html: Path, name: str, tables: str, cells: str
) -> None:
    open_page(page, html / name)
    page.locator("details").evaluate_all("all => all.forEach(one => one.open = true)")
    scrolled, broken = page.locator(tables).evaluate_all(
        """(tables, cells) => {
        const parted = text => [...text.data.matchAll(/[\\p{L}\\p{N}]+/gu)].filter(word => {
            const range = document.createRange();
            range.setStart(text, word.index);
            range.setEnd(text, word.index + word[0].length);
            const tops = [...range.getClientRects()].map(box => Math.round(box.top));
            return new Set(tops).size > 1;
        }).map(word => word[0]);
        const words = cell => {
            const walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT), found = [];
            while (walker.nextNode()) found.push(...parted(walker.currentNode));
            return found;
        };
        const isScrolled = box => box.scrollWidth > box.clientWidth + 1;
        return [
            tables.filter(table => isScrolled(table.parentElement)).length,
            tables.flatMap(table => [...table.querySelectorAll(cells)].flatMap(words)),
        ];
    }""",
        cells,
    )
    assert scrolled == 0
    assert broken == []


def test_no_line_of_the_text_is_lost_as_a_comment() -> None:
    """In the book's markup a line that begins with a percent sign is a comment."""
    texts = {path.name: path.read_text("utf-8") for path in (ROOT / "book").glob("*.md")}
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        prose = ("".join(one["source"]) for one in cells if one["cell_type"] == "markdown")
        texts[path.name] = "\n".join(prose)
    for path in (ROOT / "benchmarks" / "results").glob("*.json"):
        texts[path.name] = json.loads(path.read_text("utf-8"))["note"]
    lost = [name for name, text in texts.items() if re.search(r"^\s*%", text, re.M)]
    assert len(texts) > 30
    assert lost == []


def previews(html: Path) -> dict[str, str]:
    text = (html / "_static" / "preview_data.js").read_text(encoding="utf-8")
    return json.loads(text.partition("= ")[2].rstrip(";\n"))


def test_every_formula_figure_source_and_claim_has_a_preview(html: Path) -> None:
    found = previews(html)
    counts = {
        "equation": 63,
        "fig": 30 - 3,  # three captions stand for two or three figures
        "claim": len(ledger.claims()),
        "term": 40,
    }
    for name, least in counts.items():
        assert sum(f"#{name}-" in key for key in found) >= least, name
    sources = (html / "bibliography.html").read_text(encoding="utf-8").count('class="citation"')
    assert sum(key.startswith("bibliography") for key in found) == sources
    for key, preview in found.items():
        page, _, anchor = key.partition("#")
        assert f'id="{anchor}"' in (html / page).read_text(encoding="utf-8"), key
        for image in re.findall(r'src="([^"]+)"', preview):
            assert (html / image).exists(), key


@pytest.mark.parametrize(
    ("name", "link", "seen"),
    [
        (CHAPTER, "a.mention", "mjx-container"),
        ("errata.html", "a[href*='claims.html#']", "text=in the thesis"),
        (CHAPTER, "a[href*='bibliography.html#']", "p"),
    ],
)
def test_a_link_shows_what_it_leads_to(
    page: Page, html: Path, name: str, link: str, seen: str
) -> None:
    open_page(page, html / name)
    page.locator(f"article {link}").first.hover()
    page.wait_for_selector(f"#link-preview:not([hidden]) {seen}" if "=" not in seen else seen)
    box = page.locator("#link-preview").bounding_box()
    assert box is not None
    assert box["height"] > 20
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 1280
    page.keyboard.press("Escape")
    assert page.locator("#link-preview").is_hidden()
    page.locator(f"article {link}").first.focus()
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")  # the keyboard has one, too
    page.wait_for_selector("#link-preview:not([hidden])")
    assert page.faults == []  # type: ignore[attr-defined]


def test_a_mention_leads_to_its_formula(page: Page, html: Path) -> None:
    open_page(page, html / "symbols.html")
    mentions = page.locator("article a.mention")
    assert mentions.count() > 60
    page.get_by_role("link", name="(4.3)").first.click()
    assert page.url.endswith("04_mechanical_characterization.html#equation-4-3")


def test_every_guide_stands_on_the_first_page_with_its_picture(page: Page, html: Path) -> None:
    open_page(page, html / "start.html")
    cards = page.locator(".guide")
    assert cards.count() == len(list((ROOT / "notebooks").glob("07_*.ipynb")))
    for card in cards.all():
        card.scroll_into_view_if_needed()
        picture = card.locator("img")
        assert picture.get_attribute("alt")
        page.wait_for_function(
            "src => [...document.images].some(i => i.src === src && i.complete && i.naturalWidth)",
            arg=picture.evaluate("one => one.src"),
        )


def test_a_main_function_shows_a_small_picture(html: Path) -> None:
    assert len(PICTURES) > 12
    for name, anchor in PICTURES.items():
        text = (html / "generated" / f"{name}.html").read_text(encoding="utf-8")
        found = re.search(
            r'<a class="function-picture" href="\.\./([^"#]+)#([^"]+)">'
            r'<img src="\.\./([^"]+)" alt="([^"]{40,})" width="(\d+)"',
            text,
        )
        assert found, name
        assert found[2] == anchor
        assert f'id="{anchor}"' in (html / found[1]).read_text(encoding="utf-8"), name
        file = html / found[3]
        assert file.stat().st_size <= 20_000, name
        with Image.open(file) as picture:
            assert picture.width >= int(found[5])


@pytest.mark.parametrize(
    ("ways", "seen"),
    [
        # Install, and recompute the modulus with an own force: by a command, or in the page.
        (
            ["a:has-text('Start here')"],
            ["pip install .", "make book", "-p force 150 -p force_std 3"],
        ),
        (
            ["a:has-text('Four tools in the page')"],
            ["From a dent to a modulus", "Force F (µN)"],
        ),
        # What is wrong in the thesis, and why.
        (["a:has-text('Errata')"], ["Printed:", "Right:"]),
        (["a:has-text('Errata')", ".erratum-sources a"], ["def test_"]),
        # Track a sequence of one's own.
        (["a:has-text('Start here')", "a:has-text('Follow a part')"], ["-p frames my_film.mp4"]),
    ],
)
def test_a_newcomer_comes_from_the_front_page_to_what_was_asked(
    page: Page, html: Path, ways: list[str], seen: list[str]
) -> None:
    page.goto((html / "intro.html").as_uri())
    for way in ways:
        page.locator("article").locator(way).first.click()
    for text in seen:
        page.get_by_text(text).locator("visible=true").first.wait_for(timeout=5_000)


def test_an_initial_begins_no_list(html: Path) -> None:
    pages = {p.stem: p.read_text(encoding="utf-8") for p in (html / "generated").glob("*.html")}
    assert [name for name, text in pages.items() if '<ol class="upperalpha' in text] == []
    assert "S. K. Nayar and Y. Nakagawa" in pages["microlib.focus.depth_from_focus"]


def test_numbers_are_not_broken_on_a_phone(page: Page, html: Path) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    for name, numbers in (("symbols", "td a[href*='#equation-']"), ("benchmarks", "td.number p")):
        page.goto((html / f"{name}.html").as_uri())
        lines = page.locator(numbers).evaluate_all(
            """all => all.filter(one => one.checkVisibility()).map(one => {
                const range = document.createRange();
                range.selectNodeContents(one);
                return new Set([...range.getClientRects()].map(box => Math.round(box.top))).size;
            })"""
        )
        assert len(lines) > 40
        assert set(lines) == {1}, name
