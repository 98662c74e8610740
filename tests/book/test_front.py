"""The front page: its first screen, and its figure by keyboard, on a phone and without scripts."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from compendium import ledger
from compendium.experiments.section_5_6 import printed_dimple
from tests.book.browsing import hindrances, open_page


def modulus(text: str) -> float:
    return float(text.removeprefix("E = ").split()[0])


def test_first_screen_shows_verdicts_ways_on_and_finding(page: Page, html: Path) -> None:
    for width in (1280, 390):
        open_page(page, html / "intro.html", width, 800)
        for part in (".bar a", ".front-buttons > *", ".finding", ".front-figure svg"):
            boxes = [one.bounding_box() for one in page.locator(f"article {part}").all()]
            assert boxes, part
            assert max(box["y"] + box["height"] for box in boxes) <= 800, (part, width)
    counts = page.locator("article .bar a").all_inner_texts()
    assert sum(map(int, counts)) == len(ledger.claims())
    page.get_by_role("button", name="Check a number").click()
    page.wait_for_selector("ul.search li a")
    assert page.locator("ul.search li a").first.inner_text().startswith("Elastic modulus")


def test_front_figure_has_numbers_of_chapters(html: Path, claims_folder: Path) -> None:
    text = (html / "intro.html").read_text("utf-8")
    found = re.search(r'front-figure.*?<script type="application/json">(.*?)</script>', text, re.S)
    assert found
    states, recorded = json.loads(found[1]), ledger.read_records(claims_folder)
    for rim, name in (("left", "table-5.6/E"), ("right", "5.6/E-right")):
        shown = modulus(states[f"{rim} small 25"]["text"])
        assert shown == pytest.approx(recorded[name].value, rel=1e-3)  # four digits are shown
    low, high = (recorded[f"5.6/E-{end}"].value for end in ("wide", "thin"))
    assert f"c = 21.25–28.75 µm: {low:.2f} to {high:.2f} MPa" in text
    # The model is drawn to the scale of its probe, from the rim at its radius and depth.
    state = states["left small 25"]
    points = np.array([pair.split(",") for pair in state["path"][1:].split()], float)
    bottom = points[:, 1].max()
    scale = state["width"] / 50  # the probe is 2c wide
    radius, depth = printed_dimple()
    assert np.ptp(points[:, 0]) / scale == pytest.approx(2 * radius, abs=0.3)
    assert (bottom - points[0, 1]) / scale == pytest.approx(depth, abs=0.3)
    # The deviation in the text is the largest one that is drawn between both rims.
    drawn = re.search(r'class="outline" d="M(.*?)"', text)
    rims = [float(x) for x in re.findall(r'data-part="(?:left|right)" d="M([\d.]+),', text)]
    stated = re.search(r"point-load model by up to (\d+) µm", state["text"])
    assert drawn
    assert stated
    x, y = np.array([pair.split(",") for pair in drawn[1].split()], float).T
    apart = np.abs(np.interp(x, *points.T) - y)[(x >= rims[0]) & (x <= rims[1])].max() / scale
    assert apart == pytest.approx(float(stated[1]), abs=0.6)


def test_front_figure_works_by_keyboard_on_phone(page: Page, html: Path) -> None:
    open_page(page, html / "intro.html", 360, 780)
    figure = page.locator(".front-figure")
    axis = figure.locator(".axis text")
    middle = "one => { const b = one.getBoundingClientRect(); return b.x + b.width / 2 }"
    places = [one.evaluate(middle) for one in axis.all()]
    powers = np.log10([float(text) for text in axis.all_text_contents()])
    page.get_by_label("left", exact=False).focus()
    for below, width in ((1.33, "25"), (1.2, "25"), (1.1, "27.5")):
        value = modulus(figure.locator(".told").inner_text())
        assert value < below
        assert figure.locator("output").inner_text() == width
        # The mark on the axis is at the number in the text.
        at = np.interp(np.log10(value), powers, places)
        assert figure.locator(".found").evaluate(middle) == pytest.approx(at, abs=1)
        page.keyboard.press("Tab")  # to the model, then to the half-width
        page.keyboard.press("ArrowRight")
    page.get_by_label("right", exact=False).check()
    assert "No closed capsule" in figure.locator(".told").inner_text()
    assert not figure.locator(".found, [data-part=band] text").locator("visible=true").count()
    assert hindrances(page) == []
    assert page.faults == []  # type: ignore[attr-defined]


def test_front_figure_is_static_without_scripts(browser: Browser, html: Path) -> None:
    page = browser.new_page(java_script_enabled=False)
    page.goto((html / "intro.html").as_uri())
    figure = page.locator(".front-figure")
    assert figure.locator(".model").first.is_visible()
    assert figure.locator("form").is_hidden()
    assert "E = 1.324 MPa" in figure.locator(".told").inner_text()
    page.close()
