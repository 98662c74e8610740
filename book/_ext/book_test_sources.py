"""Pages with the source of the tests that hold the claims and prove the errata.

sphinx.ext.viewcode shows documented modules only, and tests are none.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer
from sphinx.application import Sphinx

from compendium import ROOT, ledger


def line_of(file: str, text: str) -> int:
    """Return the number of the first line that holds a text."""
    for number, line in enumerate((ROOT / file).read_text("utf-8").splitlines(), start=1):
        if text in line:
            return number
    raise ValueError(f"text must stand in {file}, got {text!r}")


def page_of(file: str) -> str:
    """Return the page that shows a test's file: ``tests/a/b.py`` is on ``_tests/a/b``."""
    return "_" + file.removesuffix(".py")


def place_of_test(test: str, entry: str = "") -> tuple[str, str]:
    """Return page and anchor of a test that is named as pytest does, or of an entry in its file."""
    file, _, function = test.partition("::")
    text = entry or (f"def {function}(" if function else "")
    return page_of(file), f"line-{line_of(file, text)}"


def show_sources(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    files = {c.test.partition("::")[0] for c in ledger.claims().values() if c.test}
    files |= {entry["test"] for entry in ledger.errata().values()}
    formatter = HtmlFormatter(lineanchors="line", anchorlinenos=False)
    for file in sorted(files):
        body = highlight((ROOT / file).read_text("utf-8"), PythonLexer(), formatter)
        yield page_of(file), {"title": file, "body": f"<h1>{file}</h1>{body}"}, "page.html"


def setup(app: Sphinx) -> None:
    app.connect("html-collect-pages", show_sources)
