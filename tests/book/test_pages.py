"""Every page opens whole, on both screens and in both themes, with its formulas drawn and uncut.

Each is opened once and asked everything: drawing formulas takes longer than all the questions.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml
from playwright.sync_api import Page

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).parent))
from browsing import hindrances, open_page  # noqa: E402

# The pages that were written for readers, the search, and one of the library's.
CONTENTS = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
WRITTEN = [
    CONTENTS["root"],
    *(one["file"] for part in CONTENTS["parts"] for one in part["chapters"]),
    "search",
    "generated/microlib.membrane.elastic_modulus",
]


# Pages of which a reader of the dark theme is asked for, too.
DARK = ("intro", "claims", "errata", "notebooks/01_introduction", "notebooks/06_conclusion")
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


def pages_to_open(html: Path) -> list[Path]:
    """Return the written pages, all with formulas, and of the library's, which are alike, some."""
    written = [html / f"{name}.html" for name in WRITTEN]
    formulas = [p for p in sorted(html.rglob("*.html")) if 'class="math' in p.read_text("utf-8")]
    assert len(formulas) > 30
    library = sorted((html / "generated").glob("*.html"))[::8]
    return list(dict.fromkeys([*written, *formulas, *library]))


def opens_to_everyone(page: Page, name: str) -> None:
    assert hindrances(page) == [], name
    if name in DARK:
        page.evaluate(
            """() => { // colors change gradually
                document.documentElement.dataset.theme = "dark";
                return Promise.all(document.getAnimations().map(one => one.finished));
            }"""
        )
        assert hindrances(page) == [], f"{name}, dark"


def fits_and_is_drawn(page: Page, name: str) -> list[tuple[str, int, str, float, float]]:
    """Hold a page against both screens and themes; return its formulas as `formulas` does."""
    found = []
    for width in LEAST:
        page.set_viewport_size({"width": width, "height": 844})
        page.evaluate("new Promise(drawn => requestAnimationFrame(() => setTimeout(drawn)))")
        excess = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert excess <= 0, f"{name} is {excess} px wider than its screen"
        found += [(name, width, *one) for one in formulas(page)]
    return found


@pytest.mark.parametrize("part", range(PARTS))
def test_a_page_is_whole_on_every_screen_for_every_reader(
    page: Page, html: Path, part: int
) -> None:
    found = []
    for path in pages_to_open(html)[part::PARTS]:
        name = str(path.relative_to(html).with_suffix(""))
        page.set_viewport_size({"width": 1280, "height": 844})
        open_page(page, path)
        if page.locator(".math").count():
            page.wait_for_function("window.formulasFit")
        if name in WRITTEN:
            opens_to_everyone(page, name)
        found += fits_and_is_drawn(page, name)
    # The box of a glyph reaches a few px past what is drawn of it.
    assert [one for one in found if one[4] > 6] == []
    assert [one for one in found if one[3] < LEAST[one[1]]] == []
