"""The browser that opens the book."""

import os
import shutil
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, Request, sync_playwright


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    executable = (
        os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    )
    if not executable:
        if os.environ.get("CI"):
            pytest.fail("CI must install a Chromium")
        pytest.skip("no Chromium on this machine (set CHROMIUM to its path)")
    with sync_playwright() as playwright:
        instance = playwright.chromium.launch(executable_path=executable, chromium_sandbox=False)
        yield instance
        instance.close()


def was_left(request: Request) -> bool:
    """Tell whether the browser itself dropped a request: the page was left before it was done."""
    return request.failure == "net::ERR_ABORTED"


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page without a network that notes everything that goes wrong in it."""
    context = browser.new_context(offline=True)
    page = context.new_page()
    page.faults = []  # type: ignore[attr-defined]
    note = page.faults.append  # type: ignore[attr-defined]
    page.on("console", lambda m: note(f"console: {m.text}") if m.type == "error" else None)
    page.on("pageerror", lambda error: note(f"script: {error}"))
    page.on("requestfailed", lambda r: note(f"failed request {r.url}") if not was_left(r) else None)
    yield page
    context.close()
