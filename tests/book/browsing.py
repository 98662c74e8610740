"""What the tests ask of a page: that it opens whole, and that nobody is kept out."""

from pathlib import Path

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

CONTRAST = "color-contrast"
#: Of five rows of claims, of both shades, two are asked: all are made by one template.
ALIKE = [[f"table.claims tbody tr:nth-child(5n+{k})"] for k in (2, 3, 4)]


def open_page(page: Page, path: Path, *screen: int) -> None:
    """Open a page and wait until its formulas are drawn; fail on whatever is missing in it."""
    if screen:
        page.set_viewport_size(dict(zip(("width", "height"), screen, strict=True)))
    page.goto(path.as_uri())
    page.evaluate("window.MathJax?.startup?.promise")
    assert page.faults == [], f"{path.name}: {page.faults}"  # type: ignore[attr-defined]
    assert refused_formulas(page) == [], path.name


def refused_formulas(page: Page) -> list[str]:
    """Return the source of each formula that stands on the page undrawn, or drawn as an error."""
    return page.evaluate("""() => {
        const drawn = new Set(document.querySelectorAll("mjx-container"));
        const errors = [...document.querySelectorAll("[data-mml-node=merror], mjx-merror")];
        const undrawn = [...document.querySelectorAll(".math.notranslate, .math.nohighlight")]
            .filter(math => ![...math.querySelectorAll("mjx-container")].some(m => drawn.has(m)));
        const source = node => node.closest(".math") ?? node;
        return [...errors.map(source), ...undrawn].map(node => node.textContent.trim());
    }""")


def hindrances(page: Page, *, colors: bool = True, others: bool = True) -> list[str]:
    """Return what axe-core calls a serious or critical hindrance to some readers.

    Of contrasts of colors, which take longest, and of all others. The outlines of glyphs, most of
    what a chapter has, say nothing to it and are removed.
    """
    page.evaluate("document.querySelectorAll('mjx-container svg > *').forEach(one => one.remove())")
    # It would ask for the style sheets once more, which no page from a file may.
    options: dict = {"resultTypes": ["violations"], "preload": False}
    options |= {"rules": {CONTRAST: {"enabled": colors}}} if others else {"runOnly": [CONTRAST]}
    found = Axe().run(page, {"exclude": ALIKE}, options).response["violations"]
    return [
        f"{v['id']}: {v['nodes'][0]['html'][:120]}"
        for v in found
        if v["impact"] in ("serious", "critical")
    ]
