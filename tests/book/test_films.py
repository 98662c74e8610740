"""Films move, stop by their button, and are stills on paper and for who asked for less motion."""

from __future__ import annotations

import base64
import re
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page

from compendium.figures.films import MOST_BYTES


def shown(page: Page, name: str) -> list[str]:
    return page.locator(f"#{name} img").evaluate_all(
        "all => all.filter(one => one.checkVisibility()).map(one => one.className)"
    )


def test_a_film_is_light_loops_and_has_a_still(html: Path) -> None:
    text = (html / "notebooks" / "04_mechanical_characterization.html").read_text("utf-8")
    found = re.search(r'<figure class="film" id="film-dimple">(.*?)</figure>', text, re.S)
    assert found
    moving, still = (
        base64.b64decode(data)
        for data in re.findall(r"data:image/webp;base64,([^\"]*)", found.group(1))
    )
    assert len(moving) + len(still) < MOST_BYTES
    film = Image.open(BytesIO(moving))
    assert film.n_frames > 10  # type: ignore[attr-defined]
    assert film.info["loop"] == 0
    assert Image.open(BytesIO(still)).size == film.size


def test_a_button_stops_a_film_and_starts_it(page: Page, html: Path) -> None:
    name = "film-dimple"
    page.goto((html / "notebooks" / "04_mechanical_characterization.html").as_uri())
    button = page.locator(f"#{name} button")
    assert (shown(page, name), button.inner_text()) == (["film-moving"], "Stop the film")
    button.press("Enter")
    assert (shown(page, name), button.inner_text()) == (["film-still"], "Play the film")
    page.emulate_media(media="print")
    assert (shown(page, name), button.is_visible()) == (["film-still"], False)
