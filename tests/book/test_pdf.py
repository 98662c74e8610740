"""The PDF of the book: whole, with links that lead somewhere, and with page numbers."""

import re
from pathlib import Path

from make_pdf import combine, make_pdf, page_numbers, pages_in_order, slug
from playwright.sync_api import Browser

FEW = ["intro", "conventions", "errata", "claims"]


def test_pdf_has_all_pages_and_no_dead_link(html: Path) -> None:
    pages = pages_in_order()
    assert pages[0] == "intro"
    assert {"try", "notebooks/05_experimental_results", "symbols"} < set(pages)
    text = combine(html, pages)
    identified = re.findall(r'\sid="([^"]+)"', text)
    anchors = set(identified)
    links = re.findall(r'<a\s[^>]*?href="#([^"]+)"', text)
    assert len(links) > 1000
    assert [link for link in links if link not in anchors] == []
    # Pages share names of sections; each has its own in the whole.
    assert sum(one.startswith("claims--claim-") for one in identified) > 190


def test_pdf_of_few_pages_has_outline_and_page_numbers(
    html: Path, tmp_path: Path, browser: Browser
) -> None:
    make_pdf(browser, html, FEW, tmp_path / "few.pdf")
    data = (tmp_path / "few.pdf").read_bytes()
    assert data.count(b"/Type /Page\n") >= len(FEW)
    assert data.count(b"/Subtype /Link") > 40  # between errata and claims
    assert b"/Outlines" in data
    assert not (html / "whole_book.html").exists()
    numbers = page_numbers(data)
    first = [numbers[slug(name)] for name in FEW[1:]]
    assert first[0] > 2  # behind the first page and the contents
    assert first == sorted(set(first))
    assert first[-1] <= data.count(b"/Type /Page\n")
    make_pdf(browser, html, ["summary"], tmp_path / "summary.pdf")
    assert 2 <= (tmp_path / "summary.pdf").read_bytes().count(b"/Type /Page\n") <= 4
