"""Everything leads on: claims, errata, badges, numbers, links; and nothing is cut on paper."""

import json
import re
from collections import Counter, defaultdict
from pathlib import Path

from book_verdicts import number_of
from bs4 import BeautifulSoup
from docutils import nodes
from playwright.sync_api import Browser, Page

from compendium import ledger
from tests.book.browsing import open_page

ROOT = Path(__file__).resolve().parents[2]
CHAPTER = "notebooks/04_mechanical_characterization.html"
CLAIMS = ledger.claims().values()


def article(path: Path) -> str:
    """Return a page without what all pages have."""
    return path.read_text("utf-8").partition("<article")[2].partition("</article>")[0]


def test_verdicts_and_counts_on_pages_equal_the_ledger(html: Path) -> None:
    """Each link to a claim that has the color of a verdict has that of the claim."""
    entries = [*CLAIMS, *ledger.settings().values()]
    known = {nodes.make_id(f"claim-{one.id}"): one.label for one in entries}
    seen: Counter[str] = Counter()
    for path in [*html.glob("*.html"), *html.glob("notebooks/*.html")]:
        pattern = r'verdict-([\w-]+)" href="[^"]*#(claim-[^"]+)"'
        for verdict, name in re.findall(pattern, article(path)):
            assert verdict == known[name], f"{path.name}: {name}"
            seen[path.stem] += 1
    assert seen["claims"] == len(entries)
    assert seen["differences"] == sum(claim.label == "contradicts" for claim in CLAIMS)
    for verdict in ledger.Verdict:
        number = sum(claim.verdict is verdict for claim in CLAIMS)
        assert number_of(verdict.word) == number, verdict
    assert number_of("chosen") == sum(getattr(claim, "chosen", "") != "" for claim in CLAIMS)


def test_no_sentence_is_repeated_on_another_page(html: Path) -> None:
    """The cells of tables, which the build makes from the ledger, may be repeated."""
    pages = defaultdict(set)
    for path in [*html.glob("*.html"), *html.glob("notebooks/*.html")]:
        soup = BeautifulSoup(article(path), "html.parser")
        for one in soup.select("table, .headerlink, .erratum-sources"):
            one.decompose()
        for block in soup.select("p, figcaption"):
            for sentence in re.split(r"(?<=[.:?!]) (?=[A-Z])", " ".join(block.text.split())):
                if len(sentence.split()) >= 6 and sentence.endswith((".", ":", "?", "!")):
                    pages[sentence].add(path.stem)
    assert len(pages) > 1000
    assert {sentence: names for sentence, names in pages.items() if len(names) > 1} == {}


def test_tables_of_four_columns_take_the_room_of_the_margin(html: Path) -> None:
    for name in ("symbols", "benchmarks_tracking"):
        for table in BeautifulSoup(article(html / f"{name}.html"), "html.parser").select("table"):
            columns = len(table.select_one("tr").find_all(["th", "td"]))
            assert ("full-width" in table["class"]) == (columns >= 4), name


def test_number_links_to_cell_that_recorded_it(page: Page, html: Path) -> None:
    open_page(page, html / "summary.html", 360, 780)
    page.locator("article a[href$='#number-5-6-e-edge-depth']").first.click()
    page.wait_for_function("window.formulasFit")
    cell = page.locator(".cell:has(#number-5-6-e-edge-depth)")
    assert "membranes.readings()" in cell.locator("details[open] pre").inner_text()
    assert 0 <= cell.bounding_box()["y"] < 300


def test_verdict_bars_count_all_claims_and_filter_table(page: Page, html: Path) -> None:
    open_page(page, html / "verdicts.html")
    pieces = page.locator(".verdict-map dd a")
    assert sum(int(text) for text in pieces.all_inner_texts()) == len(CLAIMS)
    piece = page.locator(".verdict-map a[title^='5.6'][title*='contradicts']")
    count = piece.inner_text()
    piece.click()
    listed = len(CLAIMS) + len(ledger.settings())
    page.wait_for_selector(f"output:has-text('{count} of {listed}')")
    assert page.locator("table.claims tbody tr:visible").count() == int(count)
    page.goto((html / "claims.html").as_uri())
    assert page.locator("table.claims .verdict").first.inner_text().startswith("contradicts")
    page.get_by_label("Find").focus()
    page.keyboard.type("table-5.6")
    page.reload()  # the address keeps what is sought
    assert page.locator("table.claims tbody tr:visible").count() == 7


def test_search_lists_matching_number_first(page: Page, html: Path) -> None:
    for query, first in (
        ("5.6", "Section 5.6"),  # before the table and the figure of that number
        ("1.32", "Elastic modulus"),  # the first digits of 1.3237
        ("0.04 MPa", "Standard deviation of the modulus"),  # 0.037, not 0.0439 µm
        ("6.386", "Magnification, circle 4X"),  # 6.3859, rounded
    ):
        page.goto((html / "search.html").as_uri() + f"?q={query}")
        page.wait_for_selector("ul.search li a")
        assert page.locator("ul.search li a").first.inner_text().startswith(first)
        done = "finished|did not match"
        page.wait_for_function(
            f"/{done}/.test(document.querySelector('#search-results').textContent)"
        )
        assert page.get_by_text("did not match any").locator("visible=true").count() == 0


def test_search_finds_every_numbered_item(page: Page, html: Path) -> None:
    text = (html / "_static" / "thesisNumbers.js").read_text(encoding="utf-8")
    numbers = json.loads(text.partition("= ")[2].rstrip(";\n"))
    kinds = [kind for entries in numbers.values() for kind, *_ in entries]
    wanted = {"equation": 63, "figure": 30, "table": 8}
    assert {kind: kinds.count(kind) for kind in wanted} == wanted
    assert kinds.count("section") > 20
    forms = {"section": "§ {}", "equation": "Eq. ({})", "figure": "Fig. {}", "table": "tab. {}"}
    queries: dict[str, list | None] = dict.fromkeys(("4X zoom", "3-D surface", "16 frames", "v2.1"))
    for number, entries in numbers.items():
        queries[forms.get(entries[0][0], "{}").format(number)] = entries[0]
        for _, text, address in entries:
            name, _, anchor = address.partition("#")
            assert f'id="{anchor}"' in (html / name).read_text(encoding="utf-8"), text
    page.goto((html / "search.html").as_uri())
    found = page.evaluate("all => all.map(one => findNumber(one)[0] ?? null)", list(queries))
    assert dict(zip(queries, found, strict=True)) == queries


def test_anchor_is_scrolled_into_view_on_dark_phone(browser: Browser, html: Path) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
    page.goto(f"{(html / CHAPTER).as_uri()}#equation-4-7")
    page.wait_for_function("window.formulasFit")  # the way to the anchor is gone at once
    top = page.evaluate("document.getElementById('equation-4-7').getBoundingClientRect().top")
    assert 0 <= top < 300
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.close()


def test_print_view_has_whole_code_and_no_navigation(page: Page, html: Path) -> None:
    open_page(page, html / CHAPTER)
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 650, "height": 900})  # A4 within its margins
    cut = "all => all.filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent)"
    assert page.locator("pre:visible").count() > 10
    assert page.locator("pre:visible").evaluate_all(cut) == []
    hidden = page.locator(".bd-sidebar-primary, .prev-next-footer, details.hide summary")
    assert hidden.locator("visible=true").count() == 0


def test_text_lines_do_not_begin_with_percent_sign() -> None:
    """In the book's markup a line that begins with a percent sign is a comment."""
    texts = {path.name: path.read_text("utf-8") for path in (ROOT / "book").glob("*.md")}
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        prose = ("".join(one["source"]) for one in cells if one["cell_type"] == "markdown")
        texts[path.name] = "\n".join(prose)
    assert [name for name, text in texts.items() if re.search(r"^\s*%", text, re.M)] == []
