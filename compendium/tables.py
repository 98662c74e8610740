"""The tables of the thesis as they are printed, with what this book finds for each number."""

from __future__ import annotations

from html import escape

from docutils.nodes import make_id  # type: ignore[import-untyped]
from IPython.display import HTML

from compendium import ledger


def as_printed(name: str) -> HTML:
    """Show a table of the thesis: its rows, columns and units, and a verdict on each number.

    Below a printed number stands the recomputed one that this notebook has checked; both lead to
    their row in the list of claims.

    Parameters
    ----------
    name : str
        ``table-5.6``, as in ``data/thesis/tables.toml``.

    Returns
    -------
    IPython.display.HTML
        The table, whose caption explains the signs that occur in it.

    Raises
    ------
    ValueError
        If a number that can be compared was not checked.
    """
    layouts = ledger.read_toml("tables.toml")
    layout, found = layouts[name], ledger.summary(f"{name}/")["recomputed"]
    rows, claims = "", []
    for row in layout["rows"]:
        claims += (entries := [ledger.claim(f"{name}/{one}") for one in row["claims"]])
        missing = [one.id for one in entries if one.compared and one.id not in found]
        if missing:
            raise ValueError(f"name must be of a table that was checked; missing: {missing}")
        cells = "".join(_cell(one, found.get(one.id, "")) for one in entries)
        label = row.get("label", escape(entries[0].says))
        rows += f'<tr><th scope="row">{label}</th>{cells}</tr>'
    head = "".join(f'<th scope="col">{text}</th>' for text in layout["columns"])
    labels = {one.label: one.sign for one in claims}
    key = [f"{labels[word]} {word}" for word in ledger.ORDER if word in labels]
    title = f"{name.replace('-', ' ').capitalize()}. {layout['title']}"
    above = layout.get("above", "The printed number")
    told = f"{above} stands above our number: {', '.join(key)}."
    return HTML(
        f'<table class="as-printed"><caption><div><strong>{title}.</strong> {told}</div></caption>'
        f"<thead><tr><td></td>{head}</tr></thead><tbody>{rows}</tbody></table>"
    )


def _cell(entry: ledger.Entry, recomputed: str) -> str:
    number = recomputed.replace("± ", "±&nbsp;")
    between = "<br>" if number else "&nbsp;"
    link = verdict_link(entry, f"{entry.sign}&nbsp;{number}", up="../")
    return f"<td>{escape(entry.printed or entry.condition)}{between}{link}</td>"


def verdict_link(claim: ledger.Entry, shown: str, *, up: str) -> str:
    """Return a claim's verdict as HTML that leads to its row in the list of claims.

    Parameters
    ----------
    claim : Entry
        The claim or setting.
    shown : str
        What stands there, as HTML.
    up : str
        The way from the page to the book's top folder, such as ``../``.

    Returns
    -------
    str
        A link with the verdict's color.
    """
    address = f"{up}claims.html#{make_id(f'claim-{claim.id}')}"
    title = escape(f"{claim.what}: {claim.label}")
    return f'<a class="verdict verdict-{claim.label}" href="{address}" title="{title}">{shown}</a>'
