"""Every page opens whole, on both screens and in both themes, with its formulas drawn and uncut.

Each is opened once and asked everything: drawing formulas takes longer than all the questions.
"""

import re
from pathlib import Path

import pytest
import yaml
from playwright.sync_api import Page

from tests.book.browsing import hindrances, open_page, refused_formulas

ROOT = Path(__file__).resolve().parents[2]
# The pages that were written for readers, the search, and one of the library's.
CONTENTS = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
MODULUS = "generated/microlib.membrane.elastic_modulus"
WRITTEN = [
    CONTENTS["root"],
    *(one["file"] for part in CONTENTS["parts"] for one in part["chapters"]),
    "search",
    "genindex",
    MODULUS,
]

# Pages of which a reader of the dark theme is asked for, too.
DARK = ("intro", "claims", "errata", "notebooks/01_introduction", "notebooks/06_conclusion")
# Chapters and guides are colored alike; in the fourth all is that they have.
COLORED = {
    *(name for name in WRITTEN if not name.startswith("notebooks/")),
    *DARK, "notebooks/04_mechanical_characterization",
}  # fmt: skip
PARTS = 6
# A sidebar and a margin apart, a line holds every formula; on a phone half its size is legible.
LEAST = {1280: 1.0, 390: 0.45}


def formulas(page: Page) -> list[tuple[str, float, float]]:
    """Return source, share of its full size, and px that stand out, of each display formula."""
    return page.evaluate("""() =>
        [...document.querySelectorAll("div.math")].filter(one => one.checkVisibility()).map(one => {
            const drawn = one.querySelector("mjx-container");
            one.style.overflowX = drawn.style.overflowX = "auto"; // so that what stands out counts
            return [one.textContent.slice(0, 40), parseFloat(drawn.style.fontSize || 100) / 100,
                Math.max(one.scrollWidth, drawn.scrollWidth) - one.clientWidth];
        })
    """)


def opens_to_everyone(page: Page, name: str) -> None:
    assert hindrances(page, colors=name in COLORED) == [], name
    if name in DARK:
        page.evaluate("document.documentElement.dataset.theme = 'dark'")
        page.evaluate("Promise.all(document.getAnimations().map(one => one.finished))")
        assert hindrances(page, others=False) == [], f"{name}, dark"


def fits_and_is_drawn(page: Page, name: str) -> None:
    """Hold a page against both screens."""
    for width, least in reversed(LEAST.items()):
        page.set_viewport_size({"width": width, "height": 844})
        page.evaluate("new Promise(drawn => requestAnimationFrame(() => setTimeout(drawn)))")
        excess = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert excess <= 0, f"{name} is {excess} px wider than its screen"
        tables = page.locator(".pst-scrollable-table-container")
        cut = tables.evaluate_all(
            "all => all.filter(e => e.scrollWidth > e.clientWidth + 1).length"
        )
        assert width > min(LEAST) or cut == 0, f"{name} has tables wider than a phone"
        # The box of a glyph reaches a few px past what is drawn of it.
        wrong = [one for one in formulas(page) if one[1] < least or one[2] > 6]
        assert wrong == [], f"{name}, {width} px wide"


@pytest.mark.parametrize("part", range(PARTS))
def test_pages_fit_screens_and_are_accessible(page: Page, html: Path, part: int) -> None:
    for name in WRITTEN[part::PARTS]:
        open_page(page, html / f"{name}.html", 1280, 844)
        if page.locator(".math").count():
            page.wait_for_function("window.formulasFit")
        fits_and_is_drawn(page, name)
        opens_to_everyone(page, name)


def test_library_pages_fit_screens(page: Page, html: Path) -> None:
    """Its hundred pages are made alike: their articles, all on one of them."""
    texts = [path.read_text("utf-8") for path in sorted((html / "generated").glob("*.html"))]
    articles = [re.search(r"<article.*?</article>", text, re.S)[0] for text in texts]
    open_page(page, html / f"{MODULUS}.html")
    page.wait_for_function("window.formulasFit")
    page.evaluate(
        """all => {
            document.querySelector("article").outerHTML = all;
            return MathJax.typesetPromise();
        }""",
        "".join(articles),
    )
    assert page.locator(".math mjx-container").count() > 50
    assert refused_formulas(page) == []
    fits_and_is_drawn(page, "generated")
