"""Everything leads on: claims, errata, badges, numbers, links; and nothing is cut on paper."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import pytest
from book_verdicts import ORDER, count_by_class, number_of
from docutils import nodes
from playwright.sync_api import Browser, Page

from compendium import ledger
from tests.book.browsing import open_page

ROOT = Path(__file__).resolve().parents[2]
CHAPTER = "notebooks/04_mechanical_characterization.html"
CLAIMS = ledger.claims().values()
# What a new reader wants from the front page on: what is clicked or searched for, and then seen.
TASKS = {
    "what was found": ("reproduces the printed",),
    "is 1.3237 right": ("a[href$='#claim-table-5-6-e']", "remember from the catalogue"),
    "which erratum": ("?q=203610", "ul.search li a",
                      "#claim-table-5-1-square-4x-t-z a:text('erratum')", "Right:"),
    "which function": ("a[href$='#claim-table-5-6-e']", "#claim-table-5-6-e a:text('code')",
                       "thesis.modulus"),
    "which cell": ("a[href*='#number-5-6-e-wide']", "thesis.modulus"),
    "use my TIFF": ("microlib depth scan.tif",),
    "use my film": ("article a:has-text('Use it')", "article a:has-text('Track a part')",
                    "-p frames my_film.mp4"),
    "what is not known and why": ("article a:has-text('How a verdict')",
                                  ".verdict-map a[title^='5.6'][title*='cannot']",
                                  "the outline is not in the text."),
    "how to cite": ("@software{microlib",),
    "which cell of table 5.4": ("a[href$='#claim-table-5-4-4x-circle-precision']",
                                "#claim-table-5-4-4x-circle-precision a:text('code')",
                                "ledger.check"),
    "calibrate with my chessboards": ("article a:has-text('methods on my images')",
                                      "article a:has-text('Pixels to micro')", "-p photograph"),
    "how sure is a height": ("article a:has-text('How sure is a number')", "reliability diagram"),
    "which function of an equation": ("?q=(3.10)", "ul.search li a", "in code: "),
    "chapter 3 with another window": ("article a:has-text('how it was done')",
                                      "article a[href$='#ch3']", "-p window 9"),
    "a figure in large": ("a:has-text('Stiffness')", "figure a.enlarge", "Close"),
    "a proof": ("article a:has-text('errata')", ".erratum-sources a", "def test_"),
}  # fmt: skip


def script(html: Path, name: str) -> dict:
    """Return the data that a script of the book holds."""
    text = (html / "_static" / name).read_text(encoding="utf-8")
    return json.loads(text.partition("= ")[2].rstrip(";\n"))


def test_differences_page_lists_all_disagreeing_claims(html: Path) -> None:
    text = (html / "differences.html").read_text(encoding="utf-8")
    found = re.findall(r'href="claims\.html#(claim-[^"]+)"', text)
    wanted = [c.id for c in CLAIMS if c.verdict == "disagrees"]
    assert sorted(found) == sorted(nodes.make_id(f"claim-{id}") for id in wanted)


def cells(row: str) -> list[str]:
    """Return the texts of a table's row."""
    texts = re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row, re.S)
    return [unescape(re.sub("<[^>]+>", "", text)).strip() for text in texts]


def test_counts_and_labels_on_pages_equal_the_ledger(html: Path) -> None:
    """Whatever a page counts is counted by the ledger; a table of claims has their labels."""
    counts = {of: number_of(of) for of in (*ledger.VERDICTS, "claims", "errata")}
    assert counts["claims"] == len(CLAIMS) == sum(counts[verdict] for verdict in ledger.VERDICTS)
    assert counts["errata"] == len(ledger.errata())
    for verdict in ledger.VERDICTS:
        assert count_by_class(verdict).total() == counts[verdict], verdict
    origins = {entry["origin"] for entry in ledger.errata().values()}
    shown = {*counts.values(), *map(number_of, ("causes", "starred", *origins))}
    words = {claim.label for claim in CLAIMS}
    named = {name: claim for claim in CLAIMS for name in (claim.id, claim.says) if name}
    seen = 0
    for path in [*html.glob("*.html"), *html.glob("notebooks/*.html")]:
        text = path.read_text("utf-8").partition("<article")[2].partition("</article>")[0]
        for number in re.findall(r'class="count">(\d+)<', text):
            assert int(number) in shown, path.name
        for row in re.findall(r"<tr>(.*?)</tr>", text, re.S):
            found = cells(row)
            for name in named.keys() & set(found):
                given = words & set(found)
                assert given <= {named[name].label}, f"{path.name}: {found}"
                seen += len(given)
        plain = re.sub(r'<span class="count">.*?</span>|<[^>]+>', "", text)
        pattern = r"\b\d+ (?:claims|errata|faults|agree|disagree|cannot be told|are inputs)\b"
        assert re.findall(pattern, plain) == [], path.name
    assert seen > 30


def test_number_links_to_cell_that_recorded_it(page: Page, html: Path, claims_folder: Path) -> None:
    made: dict[tuple[str, int], str] = {}
    for path in (claims_folder.parent / "notebooks").glob("*.ipynb"):
        for cell in json.loads(path.read_text("utf-8"))["cells"]:
            made[path.stem, cell.get("execution_count")] = "".join(cell["source"])
    for record in ledger.read_records(claims_folder).values():
        source = made[record.notebook, record.cell]
        begins = re.split(r"[-/]", record.id)[0]  # the rest may be put together
        assert "ledger." in source or "report(" in source, record.id
        assert begins in source or "check(claim" in source or "{" in source, record.id
    page.set_viewport_size({"width": 360, "height": 780})
    open_page(page, html / "intro.html")
    page.locator("article a[href$='#number-5-6-e-thin']").first.click()
    page.wait_for_function("window.formulasFit")
    code = page.locator(".cell:has(#number-5-6-e-thin) details[open] pre")
    code.wait_for()
    assert "PROBE_WIDTH_ENDS" in code.inner_text()
    cell = page.locator(".cell:has(#number-5-6-e-thin)").bounding_box()
    assert cell
    assert 0 <= cell["y"] < 300
    page.go_back()
    assert page.url.endswith("intro.html")


@pytest.mark.parametrize("name", ["summary", "verdicts"])
def test_table_of_counts_has_all_claims_by_class(html: Path, name: str) -> None:
    text = (html / f"{name}.html").read_text("utf-8")
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", text, re.S)
    found = {row[0]: row[1:] for row in map(cells, rows) if row and row[0] in ORDER}
    assert found.keys() == set(ledger.VERDICTS)
    for verdict, (number, classes) in found.items():
        assert int(number) == number_of(verdict), verdict
        parts = re.findall(r"(?:^|\n)(\d+) (?!causes)", classes)
        assert sum(map(int, parts)) == int(number), f"{verdict}: {classes}"


def test_verdict_bars_count_all_claims_and_filter_table(page: Page, html: Path) -> None:
    open_page(page, html / "verdicts.html")
    pieces = page.locator(".verdict-map dd a")
    assert sum(int(text) for text in pieces.all_inner_texts()) == len(CLAIMS)
    piece = page.locator(".verdict-map a[title^='5.6'][title*='disagrees, unstarred']")
    count = piece.inner_text()
    piece.click()
    page.wait_for_selector(f"output:has-text('{count} of {len(CLAIMS)}')")
    assert page.locator("table.claims tbody tr:visible").count() == int(count)
    page.goto((html / "claims.html").as_uri())
    assert page.locator("table.claims .verdict").first.inner_text().startswith("disagrees")
    page.get_by_label("Find").focus()
    page.keyboard.type("table-5.6")
    assert page.locator("table.claims tbody tr:visible").count() == 7
    assert page.url.endswith("?text=table-5.6")
    page.reload()
    assert page.locator("table.claims tbody tr:visible").count() == 7


def test_search_lists_matching_number_first(page: Page, html: Path) -> None:
    for query, first in (
        ("equation (4.7)", "Equation (4.7): "),
        ("0.1012", "Relative probe width"),
        ("1.32", "Elastic modulus"),  # of 1.3237 the first digits, and
        ("1.324", "Elastic modulus"),  # rounded
    ):
        page.goto((html / "search.html").as_uri() + f"?q={query}")
        page.wait_for_selector("ul.search li a")
        assert page.locator("ul.search li a").first.inner_text().startswith(first)
        done = (
            "/finished|did not match/.test(document.querySelector('#search-results').textContent)"
        )
        page.wait_for_function(done)
        assert page.get_by_text("did not match any").locator("visible=true").count() == 0


def test_search_finds_every_numbered_item(page: Page, html: Path) -> None:
    numbers = script(html, "numbers.js")
    kinds = [kind for entries in numbers.values() for kind, *_ in entries]
    wanted = {"equation": 63, "figure": 30, "table": 8}
    assert {kind: kinds.count(kind) for kind in wanted} == wanted
    assert kinds.count("section") > 20
    forms = {
        "section": ("Section {}", "sec. {}", "§ {}"),
        "equation": ("equation ({})", "Eq. {}"),
        "figure": ("figure {}", "Fig. {}"),
        "table": ("Table {}", "tab. {}"),
        "value": ("{}",),
    }
    queries: dict[str, list | None] = dict.fromkeys(("4X zoom", "3-D surface", "16 frames", "v2.1"))
    for number, entries in numbers.items():
        for entry in entries:
            assert entry[1].startswith(entry[0].capitalize()) or entry[0] == "value", entry
            name, _, anchor = entry[2].partition("#")
            assert f'id="{anchor}"' in (html / name).read_text(encoding="utf-8"), entry[2]
        for form in forms[entries[0][0]]:
            queries[form.format(number)] = entries[0]
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
    figures = page.locator("figure:has(img):not(.film)")
    assert figures.count() == page.locator("figure a.enlarge").count() > 0
    assert page.locator("footer a[href$='certificate.html']").count() == 1
    page.close()


def test_print_view_has_whole_code_and_no_navigation(page: Page, html: Path) -> None:
    open_page(page, html / CHAPTER)
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 650, "height": 900})  # A4 within its margins
    wrong = page.evaluate("""() => {
        const all = (which) => [...document.querySelectorAll(which)];
        const seen = (which) => all(which).filter(e => e.checkVisibility());
        return [
            ...seen(".bd-sidebar-primary, .prev-next-footer, details.hide summary"),
            ...seen("pre").filter(e => e.scrollWidth > e.clientWidth + 1),
            ...seen("figure").filter(e => getComputedStyle(e).breakInside !== "avoid"),
        ].map(e => e.outerHTML.slice(0, 80));
    }""")
    assert wrong == []


def test_text_lines_do_not_begin_with_percent_sign() -> None:
    """In the book's markup a line that begins with a percent sign is a comment."""
    texts = {path.name: path.read_text("utf-8") for path in (ROOT / "book").glob("*.md")}
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        prose = ("".join(one["source"]) for one in cells if one["cell_type"] == "markdown")
        texts[path.name] = "\n".join(prose)
    assert [name for name, text in texts.items() if re.search(r"^\s*%", text, re.M)] == []


@pytest.mark.parametrize("task", TASKS)
def test_reader_finds_answer_in_three_steps(page: Page, html: Path, task: str) -> None:
    *steps, seen = TASKS[task]
    assert len(steps) <= 3
    page.set_viewport_size({"width": 360, "height": 780})
    page.goto((html / "intro.html").as_uri())
    for step in steps:
        if step.startswith("?q="):  # typed into the box that every page has
            page.goto((html / "search.html").as_uri() + step)
        else:
            page.locator(step).locator("visible=true").first.click()
    page.locator(f"text={seen}").locator("visible=true").first.wait_for()
