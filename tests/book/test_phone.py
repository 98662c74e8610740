"""On a phone nothing in a figure is smaller than the text around it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Page

from compendium.figures.phone import DPI, LEAST

#: Smallest text of the second renderings, px: tests/compendium/test_figures_phone.py measures it.
TEXT = LEAST * DPI / 72
#: That of a film, px: 12 points at 100 px per inch.
FILM_TEXT = 12 * 100 / 72


@pytest.fixture
def phone(page: Page) -> Page:
    page.set_viewport_size({"width": 390, "height": 844})
    return page


def smallest_texts(page: Page) -> dict[str, float]:
    """Return the size of the smallest text of each figure, over that of the page's text."""
    shown = page.evaluate("""() => [...document.querySelectorAll("article figure img")]
        .filter(one => one.checkVisibility()).map(one => [
            one.closest("figure").id, one.currentSrc.split("?")[0].slice(-5),
            one.getBoundingClientRect().width / one.naturalWidth])""")
    body = page.evaluate(
        "parseFloat(getComputedStyle(document.querySelector('article p')).fontSize)"
    )
    # A picture that is not of the second rendering has text of no known size.
    sizes = {"film": FILM_TEXT, "fig": TEXT}
    return {
        name: scale * (sizes[name.split("-")[0]] if kind == ".webp" or "film" in name else 0) / body
        for name, kind, scale in shown
    }


def test_text_in_figures_is_as_large_as_around_them(phone: Page, html: Path) -> None:
    found = {}
    for path in sorted((html / "notebooks").glob("*.html")):
        phone.goto(path.as_uri())
        phone.wait_for_function(
            "[...document.querySelectorAll('article figure img')].every(one => one.complete)"
        )
        found |= smallest_texts(phone)
        excess = phone.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert excess <= 0, path.name
    assert len(found) > 65
    # Widths are whole px: half of one is less than a hundredth of any figure.
    assert {name: size for name, size in found.items() if size < 0.99} == {}


def test_a_figure_that_is_wider_than_the_screen_is_scrolled_by_the_keyboard(
    phone: Page, html: Path
) -> None:
    phone.goto((html / "notebooks" / "02_microsystems_and_vision.html").as_uri())
    frame = phone.locator("#fig-2-3 .figure-frame")
    frame.focus()
    phone.keyboard.press("ArrowRight")
    phone.wait_for_function("document.querySelector('#fig-2-3 .figure-frame').scrollLeft > 0")
    fitting = phone.locator("#fig-2-2 .figure-frame")
    assert fitting.evaluate("one => one.scrollWidth <= one.clientWidth")


def test_pages_are_light_on_phones(html: Path) -> None:
    for path in sorted((html / "notebooks").glob("*.html")):
        text = path.read_text(encoding="utf-8")
        pictures = [path.parent / src for src in re.findall(r'srcset="([^"]+)"', text)]
        size = path.stat().st_size + sum(one.stat().st_size for one in pictures)
        assert size < 1.5e6, f"{path.name} weighs {size / 1e6:.2f} MB"


def test_both_renderings_show_one_figure(html: Path) -> None:
    """The file that stands behind a figure's name is that figure's, in the size that is stated."""
    text = (html / "notebooks" / "04_mechanical_characterization.html").read_text("utf-8")
    sources = re.findall(
        r'<figure[^>]*id="([^"]+)"[^>]*>\s*<div class="figure-frame"[^>]*><picture>'
        r'<source media="[^"]+" srcset="([^"]+)" width="(\d+)" height="(\d+)">',
        text,
    )
    assert len(sources) == text.count('<figure class="align-default"')
    for name, source, width, height in sources:
        path = html / "notebooks" / source
        assert path.stem == name
        with Image.open(path) as picture:
            assert picture.size == (int(width), int(height))
