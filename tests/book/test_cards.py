"""The card of a number: it says what the ledger says, to a mouse, a finger and a keyboard."""

from pathlib import Path

from book_verdicts import printed, records
from docutils import nodes
from playwright.sync_api import Browser, Page

from compendium import ROOT, ledger
from tests.book.browsing import hindrances, open_page

CHAPTER = "notebooks/05_experimental_results.html"
NOTEBOOKS = ROOT / "build" / "notebooks"
NUMBER = "table.ledger a[href$='#number-table-5-6-zeta']"


def test_cards_say_what_the_ledger_says(page: Page, html: Path) -> None:
    open_page(page, html / CHAPTER)
    cards = page.evaluate("numberCards")
    sources = {path.stem: path.read_text("utf-8") for path in NOTEBOOKS.glob("*.ipynb")}
    for name, record in records().items():
        card = cards[nodes.make_id(f"number-{name}").removeprefix("number-")]
        rows = {row: text for row, text, *_ in card["rows"]}
        assert (card["label"], rows["Recomputed"]) == (record.verdict, str(record))
        source = sources[record.notebook]
        if any(rf"ledger.{call}(\"{name}\"" in source for call in ("check", "report")):
            assert f'("{name}"' in rows["Made by"]
        if record.verdict != "result":
            entry = ledger.claim(name)
            assert (rows["Printed"], rows.get("Test", "")) == (printed(entry), entry.test)
            parts = [getattr(entry, part, "") for part in ("proof", "assumes", "chosen", "found")]
            assert all(part.rstrip(".") in rows.get("Rests on", "") for part in parts), name
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.locator(".card-notes li").count() > 9  # of each that contradicts or is open


def test_keyboard_and_finger_reach_card(browser: Browser, page: Page, html: Path) -> None:
    open_page(page, html / CHAPTER)
    number, card = page.locator(NUMBER).first, page.locator("#number-card")
    number.focus()
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")
    assert page.locator(f"#{number.get_attribute('aria-describedby')}").is_visible()
    assert hindrances(page) == []
    page.keyboard.press("Tab")
    assert card.locator("a:focus").get_attribute("href").endswith("#claim-table-5-6-zeta")
    page.keyboard.press("Escape")
    assert number.evaluate("one => one === document.activeElement")
    number.hover()
    card.wait_for()  # Escape had closed it
    phone = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True).new_page()
    phone.goto((html / CHAPTER).as_uri())
    phone.locator(NUMBER).first.tap()
    assert phone.url.endswith(".html")
    phone.locator(NUMBER).first.tap()
    assert phone.url.endswith("#number-table-5-6-zeta")
    phone.context.close()
