"""Figures: their colors, their text on a phone and in the dark, opened, turned; and films."""

import json
import re
from base64 import b64decode
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from book_benchmarks import draw, rows_of
from book_surfaces import surface_script
from matplotlib import colormaps
from PIL import Image
from playwright.sync_api import Browser, Page

from compendium.figures import surfaces
from compendium.figures.data import FOLDER_VARIABLE
from compendium.figures.style import COLORS, ON_DARK
from microlib.curvature import HK_NAMES

CHAPTER = "notebooks/03_visual_reconstruction_and_classification.html"
PAGES = {"light": "#ffffff", "dark": "#121212"}  # the theme's grounds
PHONE = 360
SVG = "{http://www.w3.org/2000/svg}"
LINK = "{http://www.w3.org/1999/xlink}href"


@pytest.fixture(scope="module")
def figures(html: Path) -> dict[str, ET.Element]:
    return {path.name: ET.parse(path).getroot() for path in (html / "_images").glob("*.svg")}


def glyphs(root: ET.Element, size: float = 1.0, fill: str = "") -> Iterator[tuple[float, str]]:
    """Yield the font size in points and the color of each glyph."""
    for child in root:
        if child.tag == f"{SVG}defs":
            continue
        scale = re.search(r"scale\(([\d.]+)", child.get("transform", ""))
        color = re.search(r"fill: (#\w+)", child.get("style", ""))
        here = size * (float(scale[1]) if scale else 1.0), color[1] if color else fill
        if child.tag == f"{SVG}use" and "DejaVu" in child.get(LINK, ""):
            yield 100 * here[0], here[1]  # Matplotlib's glyphs are drawn at 100 points
        yield from glyphs(child, *here)


def contrast(one: str, other: str) -> float:
    """WCAG 2: the contrast of two colors."""
    light = []
    for color in (one, other):
        level = np.array([int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)])
        linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        light.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(light) + 0.05) / (min(light) + 0.05)


@pytest.mark.parametrize("scheme", PAGES)
def test_color_bar_pixels_in_browser_are_viridis(browser: Browser, html: Path, scheme: str) -> None:
    """From Matplotlib through notebook, page and browser: the pixels are viridis."""
    page = browser.new_page(viewport={"width": 1280, "height": 900}, device_scale_factor=2)
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    page.goto((html / CHAPTER).as_uri())
    picture = page.locator(f"#fig-ch3-spikes img.only-{scheme}")
    source = str(picture.get_attribute("src")).partition("#")[0]
    screen = Image.open(BytesIO(picture.screenshot())).convert("RGB")
    page.close()
    root = ET.parse((html / CHAPTER).parent / source).getroot()
    bar = next(one for one in root.iter(f"{SVG}image") if {"height", "x"} <= set(one.attrib))
    x, y, width, height = (float(bar.get(key, "")) for key in ("x", "y", "width", "height"))
    flip = re.search(r"scale\(1 -1\) translate\(0 (-[\d.]+)\)", bar.get("transform", ""))
    top = -y - height - float(flip[1]) if flip else y
    _, _, across, down = map(float, root.get("viewBox", "").split())
    pixels = np.asarray(screen).astype(float)
    scale = np.array(pixels.shape[:2]) / (down, across)
    column = int((x + width / 2) * scale[1])
    rows = np.arange(int(top * scale[0]) + 6, int((top + height) * scale[0]) - 6)
    share = 1 - ((rows + 0.5) / scale[0] - top) / height
    expected = 255 * colormaps["viridis"](share)[:, :3]
    # A pixel is half a step of the map off at most, and a step changes a level by at most 4.
    np.testing.assert_allclose(pixels[rows, column], expected, atol=6)


def test_figure_text_is_legible_on_phone_in_both_themes(figures: dict[str, ET.Element]) -> None:
    """As wide as the phone, each glyph has at least 9 px; text has a contrast of 4.5 or more."""
    dark = {COLORS[name].lower(): shown for name, shown in ON_DARK.items()}
    over_pictures = {"#000000", "", "#ffffff"}  # plain black and white stand on what is drawn
    small, faint = set(), set()
    for name, root in figures.items():
        width = float(root.get("viewBox", "").split()[2])
        for size, color in glyphs(root):
            if size * PHONE / width < 9:
                small.add((name, round(size * PHONE / width, 1)))
            for scheme, ground in PAGES.items():
                seen = dark.get(color, color) if scheme == "dark" else color
                if color not in over_pictures and contrast(seen, ground) < 4.5:
                    faint.add((name, scheme, color))
    assert small == set()
    assert faint == set()


def test_opened_figure_has_its_caption_and_closes(page: Page, html: Path) -> None:
    page.set_viewport_size({"width": 1000, "height": 700})
    page.goto((html / CHAPTER).as_uri())
    link, dialog = page.locator("#fig-ch3-profile a.enlarge"), page.locator("#figure-dialog")
    width = "document.querySelector('.figure-view img').getBoundingClientRect().width"
    button = page.get_by_role("button", name="Close")
    for shut in (
        lambda: page.keyboard.press("Escape"),
        page.go_back,
        lambda: button.press("Enter"),
    ):
        link.press("Enter")
        assert "Focus profile of one pixel" in dialog.inner_text()
        fitting = page.evaluate(width)
        page.locator(".figure-view").hover()
        page.mouse.wheel(0, -400)
        page.wait_for_function(f"{width} > 1.5 * {fitting}")
        shut()
        page.wait_for_function("!document.querySelector('#figure-dialog').open")
        page.wait_for_function("!history.state?.figure")
    assert page.faults == []  # type: ignore[attr-defined]


def test_surface_rotates_on_screen_and_prints_as_image(page: Page, html: Path) -> None:
    page.goto((html / CHAPTER).as_uri())
    surface = page.locator("#fig-ch3-dome canvas")
    surface.scroll_into_view_if_needed()
    before = surface.screenshot()
    surface.press("ArrowLeft")
    page.wait_for_timeout(100)
    assert (turned := surface.screenshot()) != before
    surface.drag_to(page.locator("#fig-ch3-dome figcaption"))
    page.wait_for_timeout(100)
    assert surface.screenshot() != turned
    page.emulate_media(media="print", color_scheme="dark")
    page.wait_for_function("document.documentElement.dataset.theme === 'dark'")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert not surface.is_visible()
    assert page.locator("#fig-ch3-dome img.only-light").is_visible()
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("#fig-ch3-dome img.only-dark").is_visible()
    assert page.faults == []  # type: ignore[attr-defined]


def test_interactive_surface_has_heights_and_colors_of_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    height = 20 + 500 * np.random.default_rng(0).random((40, 230))
    height[6:8, 8:10] = np.nan
    labels = np.random.default_rng(1).integers(1, 10, height.shape).astype(np.uint8)
    surfaces.show_surface("plain", height, 2.0, height_unit="frames")
    surfaces.show_surface("types", height, 2.0, labels=labels)
    # At most 160 points a side: the medians of blocks of 2×2 px.
    blocks = [height[i::2, j::2] for i in range(2) for j in range(2)]
    part, types = np.median(blocks, axis=0), labels[1::2, 1::2]
    for name in ("plain", "types"):
        script = surface_script(tmp_path / f"{name}.npz")
        kept = json.loads(re.sub("<[^>]*>", "", script))
        assert (kept["rows"], kept["cols"], kept["pitch"]) == (*part.shape, 4.0)
        codes = np.frombuffer(b64decode(kept["heights"]), "<u2").reshape(part.shape)
        np.testing.assert_array_equal(codes == 0, np.isnan(part))  # a hole
        ends = np.nanmin(part), np.nanmax(part)
        np.testing.assert_allclose([float(kept["low"]), float(kept["high"])], ends, atol=0.5)
        found = ends[0] + np.ptp(ends) * (codes[codes > 0] - 1.0) / 65534
        np.testing.assert_allclose(found, part[codes > 0], atol=0.01)
        kinds = np.frombuffer(b64decode(kept["kinds"]), np.uint8).reshape(part.shape)
        scale = {"plain": "vertical scale arbitrary", "types": "vertical scale as horizontal"}
        assert kept["note"] == scale[name]
        share = 255 * (found - ends[0]) / np.ptp(ends)
        wanted = types[codes > 0] if name == "types" else share
        np.testing.assert_allclose(kinds[codes > 0], wanted, atol=0.6 * (name == "plain"))
    assert kept["key"] == {f"{k} {HK_NAMES[k]}": surfaces.HK_COLORS[k] for k in np.unique(types)}


def test_button_stops_and_starts_film(page: Page, html: Path) -> None:
    page.goto((html / "notebooks" / "04_mechanical_characterization.html").as_uri())
    parts = (".film-moving", ".film-still", "button")
    moving, still, button = (page.locator(f"#film-dimple {each}") for each in parts)
    assert (moving.is_visible(), still.is_visible()) == (True, False)
    button.press("Enter")
    assert (moving.is_visible(), still.is_visible()) == (False, True)
    page.emulate_media(media="print")
    assert (still.is_visible(), button.is_visible()) == (True, False)


def test_cases_of_a_benchmark_chart_keep_the_order_of_its_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("book_benchmarks.RESULTS", tmp_path)
    data = [[3, "a", 1.0], [3, "b", 0.9], [20, "a", 0.8], [20, "b", 0.7], [7, "a", 0.6]]
    tables = {"Shifts": {"columns": ["px", "method", "share"], "data": data}}
    (tmp_path / "trials.json").write_text(json.dumps({"tables": tables}))
    options = {"table": "Shifts", "label": "{px} px", "pivot": "method", "values": "share"}
    shown = rows_of("trials", options | {"columns": "b = B | a"})
    assert [*shown.index] == ["3 px", "20 px", "7 px"]
    np.testing.assert_array_equal(shown, [[0.9, 1.0], [0.7, 0.8], [np.nan, 0.6]])
    axes = draw(shown, "share", log=False).axes[0]
    ticks = {text.get_text(): text.get_position()[1] for text in axes.get_yticklabels()}
    assert [ticks[name] for name in shown.index] == [*axes.lines[0].get_ydata()]
