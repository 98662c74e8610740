"""Phones get the second rendering of a figure, whole and light; test_pages.py reads its texts."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Page

sys.path.insert(0, str(Path(__file__).parent))
from browsing import without_solids


@pytest.fixture
def phone(page: Page) -> Page:
    page.set_viewport_size({"width": 390, "height": 844})
    return page


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
        size = len(without_solids(text).encode()) + sum(one.stat().st_size for one in pictures)
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
