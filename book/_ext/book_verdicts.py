"""Roles and directives that put the ledger's numbers into the book's text.

- ``{recomputed}`id` ``, ``{printed}`id` ``, ``{verdict}`id` ``: the recomputed
  number, the thesis' number and the verdict; a recomputed number leads to the cell that recorded
  it, a verdict to its row in the list of claims.
- ``{number}`follows` ``, or another verdict, ``claims``, ``settings``, ``errata``, ``causes``,
  ``chosen`` or a class of errata: how many there are.
- ``{ledger-table} section-3.1.2/ table-3.1/labels``: what the thesis reports of a section, as a
  table of the claims whose ids are, or begin with, one of the words. With the option ``:short:``
  it says where each claim stands, and gives the first sentence of what its verdict rests on.
- ``{verdict-map}``: a bar for each part of the thesis, each piece of which leads to its claims;
  with the option ``:whole:``, one bar for all parts.
- ``{claims}``: the list of all claims and settings, which ``_static/filter.js`` narrows;
  ``{differences}``: the contradictions, by cause.
- ``{errata}``: every fault of the thesis with its proof; ``{reaches}``: which results they change.

A number that no notebook recorded is replaced by the note that it was not computed.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from html import escape
from typing import Any, ClassVar
from urllib.parse import urlencode

from book_map import find_items
from book_tables import line, link, raw_html, script_json, section, span, table
from book_test_sources import place_of_test
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole

from compendium import MISSING, ROOT, ledger
from compendium.tables import verdict_link

CLAIMS = ROOT / "build" / "claims"
#: The head of the column with the numbers of this book.
FOUND = "Recomputed or simulated"
#: The verdicts for a new reader.
PROOF = "printed numbers and formulas, or mathematics alone,"
MEANINGS = {
    ledger.Verdict.CONTRADICTS: f"{PROOF} prove the claim wrong",
    ledger.Verdict.OPEN: "what was published does not decide the claim",
    ledger.Verdict.POSSIBLE: "the claim holds under named assumptions",
    ledger.Verdict.FOLLOWS: f"{PROOF} give the claim",
}


@cache
def records() -> dict[str, ledger.Record]:
    return ledger.read_records(CLAIMS)


def every_entry() -> list[ledger.Entry]:
    """Return all claims and settings in the order of the book's tables."""
    entries = [*ledger.claims().values(), *ledger.settings().values()]
    return sorted(entries, key=lambda entry: ledger.ORDER.index(entry.label))


def facets(entry: ledger.Entry) -> dict[str, str]:
    """Return what the list of claims can be narrowed by, as the address has it."""
    return {"verdict": entry.label, "part": ledger.part_of(entry).split()[0]}


def number_of(what: str) -> int:
    """Return one count: of a verdict, ``claims``, ``settings``, ``unchecked`` results among
    these, ``errata``, a class of errata, ``causes`` of contradictions, or ``chosen`` assumptions.
    """
    claims = ledger.claims().values()
    origins = Counter(entry["origin"] for entry in ledger.errata().values())
    counts = Counter(claim.label for claim in claims) | origins
    counts["claims"], counts["settings"] = len(claims), len(ledger.settings())
    results = ("table-5.1", "table-5.5", "table-5.6/F")  # of the settings
    counts["unchecked"] = sum(id.startswith(results) for id in ledger.settings())
    counts["errata"], counts["causes"] = len(ledger.errata()), len(ledger.causes())
    counts["chosen"] = sum(bool(getattr(claim, "chosen", "")) for claim in claims)
    return counts[what]


def printed(claim: ledger.Entry) -> str:
    """Return the number that the thesis prints, with its unit."""
    number = f"{claim.printed} {claim.unit}".replace(">=", "≥").rstrip()
    return number if claim.printed else "no number"


def cell_link(env: Any, name: str) -> nodes.Node:
    """Return a recomputed number, which leads to the cell that recorded it, if one did."""
    if (record := records().get(name)) is None:
        return span(MISSING, "missing")
    shown = span(str(record), "recomputed")
    return link(env, shown, f"notebooks/{record.notebook}", f"number-{record.id}")


def name_cells(app: Sphinx, doctree: nodes.document) -> None:
    """Give each cell of a notebook the anchors of the numbers that it recorded."""
    notebook = app.env.docname.rpartition("/")[2]
    for cell in doctree.findall(nodes.container):
        if "exec_count" in cell:
            place = notebook, cell["exec_count"]
            found = (r.id for r in records().values() if (r.notebook, r.cell) == place)
            cell["ids"] += [nodes.make_id(f"number-{name}") for name in found]


def claim_link(env: Any, claim: ledger.Entry) -> nodes.raw:
    """Return a claim's verdict, which leads to its row."""
    return raw_html(verdict_link(claim, claim.label, up="../" * env.docname.count("/")))


class Role(SphinxRole):
    """A role whose function makes a node of its text."""

    functions: ClassVar = {
        "number": lambda env, of: span(str(number_of(of)), "count"),
        "printed": lambda env, name: span(printed(ledger.claim(name)), "printed"),
        "recomputed": cell_link,
        "verdict": lambda env, name: claim_link(env, ledger.claim(name)),
    }

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        return [self.functions[self.name](self.env, self.text)], []


class VerdictMap(SphinxDirective):
    """A bar for each part of the thesis, or for all; each piece leads to the claims it counts."""

    option_spec: ClassVar = {"whole": directives.flag}

    def run(self) -> list[nodes.Node]:
        whole, claims = "whole" in self.options, ledger.claims().values()
        names = ["" if whole else ledger.part_of(claim) for claim in claims]
        counts = Counter(zip(names, (claim.label for claim in claims), strict=True))
        totals = Counter(names)
        parts = []
        for part, total in totals.items():
            pieces = []
            for verdict in ledger.Verdict:
                if count := counts[part, verdict.word]:
                    query = {"verdict": verdict.word} | ({} if whole else {"part": part.split()[0]})
                    piece = {"verdict": verdict.word, "count": count, "query": urlencode(query)}
                    pieces.append(piece)
            parts.append((part, pieces, max(totals.values()) - total))
        page = self.env.app.builder.get_relative_uri(self.env.docname, "claims")
        order = {v.word: MEANINGS[v] if whole else "" for v in ledger.Verdict}
        context = {"parts": parts, "order": order, "page": page}
        return [raw_html(self.env.app.builder.templates.render("verdict_map.html", context))]


class Claims(SphinxDirective):
    """The list of all claims with a filter, contradictions first and settings last."""

    def run(self) -> list[nodes.Node]:
        chosen = every_entry()
        head = ["Claim", "Thesis", FOUND, "Verdict", "Where"]
        rows = [self.row(claim) for claim in chosen]
        result = table(head, rows, ids=[f"claim-{claim.id}" for claim in chosen])
        result["classes"].append("claims")
        data = {nodes.make_id(f"claim-{claim.id}"): facets(claim) for claim in chosen}
        script = f'<script type="application/json" id="claims-facets">{script_json(data)}</script>'
        return [raw_html(script), result]

    def row(self, claim: ledger.Entry) -> list[list[nodes.Node]]:
        recorded = claim.compared or claim.id in records()
        found = cell_link(self.env, claim.id) if recorded else nodes.Text("–")
        verdict = nodes.paragraph("", "", claim_link(self.env, claim))
        said = {f"{what}: ": text for what, text in claim.explanations().items()} | {"": claim.note}
        thesis = [line(printed(claim), "printed")]
        return [
            [line(claim.what), line(claim.id, "claim-id")],
            [*thesis, line(f"{claim.says}.")] if claim.says else thesis,
            [nodes.paragraph("", "", found)],
            [verdict, *(line(f"{what}{text.rstrip('.')}.") for what, text in said.items() if text)],
            list(self.sources(claim)),
        ]

    def sources(self, claim: ledger.Entry) -> Iterator[nodes.Node]:
        """Yield where a claim stands in the chapters, what holds its computation, its erratum."""
        page, anchor = place_of(claim)
        yield self.lead(claim.where, page, anchor)
        if record := records().get(claim.id):
            yield self.lead("code", f"notebooks/{record.notebook}", f"number-{record.id}")
        if claim.test:
            yield self.lead("test", *place_of_test(claim.test))
        for name, entry in ledger.errata().items():
            if claim.id in entry.get("claims", "").split():
                yield self.lead("erratum", "errata", f"erratum-{name}")

    def lead(self, text: str, page: str, anchor: str) -> nodes.paragraph:
        return nodes.paragraph("", "", link(self.env, nodes.Text(text), page, anchor))


class LedgerTable(SphinxDirective):
    """What the thesis reports of a section: printed, recomputed, verdict, and what it rests on."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec: ClassVar = {"short": directives.flag}

    def run(self) -> list[nodes.Node]:
        rows = []
        for prefix in self.arguments[0].split():
            claims = ledger.claims()
            whole = [claims[prefix]] if prefix in claims else []
            found = whole or [claim for name, claim in claims.items() if name.startswith(prefix)]
            if not found:
                raise self.error(f"no claim has an id that begins with {prefix}")
            rows += [self.row(claim) for claim in found]
        head = ["The thesis reports", "Printed", FOUND, "Verdict", "It rests on"]
        if all(row[1].astext() == "–" for row in rows):  # only sentences
            head, *rows = ([first, *others] for first, _, *others in (head, *rows))
        result = table(head, rows)
        result["classes"].append("ledger")
        return [result]

    def row(self, claim: ledger.Claim) -> list[nodes.Node | list[nodes.Node]]:
        short = "short" in self.options
        place = f" ({claim.where})" if short else ""
        told = [line(f"{claim.what}{place}.")]
        if claim.says and (claim.condition or not claim.printed):
            told = [line(_sentence(claim.says + place))]
            told += [line(f"Our number: {claim.what}.")] if claim.compared else []
        number = span(printed(claim) if claim.printed else "–", "printed")
        found = cell_link(self.env, claim.id) if claim.compared else nodes.Text("–")
        rests = grounds(claim)
        if short:
            rests = [line(re.split(r"(?<=\.) (?=[A-Z])", rests[0].astext())[0])]
        return [told, number, found, claim_link(self.env, claim), rests]


def grounds(claim: ledger.Entry) -> list[nodes.Node]:
    """Return what a verdict rests on, as one paragraph for each kind of evidence."""
    if isinstance(claim, ledger.Follows):
        return [line("Printed numbers and formulas, or mathematics alone.")]
    told = {name: text for name, text in claim.explanations().items() if text}
    kept = {name: text for name, text in told.items() if name not in ("Right", "Rule")}
    return [line(_sentence(f"{name}: {text}")) for name, text in kept.items()]


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:].rstrip('.')}."


def place_of(claim: ledger.Entry) -> tuple[str, str]:
    """Return page and anchor of the table or section that a claim's id begins with."""
    places = find_items()
    name = claim.id.split("/")[0]
    while name not in places and "." in name:
        name = name.rpartition(".")[0]  # a subsection without a heading of its own
    stem, anchor = places.get(name, places["section-6"])
    return f"notebooks/{stem}", anchor


def parse_lines(directive: SphinxDirective, lines: list[str], part: nodes.Element) -> nodes.Element:
    """Return a node with the content of lines in the book's own markup."""
    directive.state.nested_parse(StringList(lines, source=directive.name), 0, part)
    return part


class Differences(SphinxDirective):
    """Each contradiction by its cause: both numbers and the proof."""

    def run(self) -> list[nodes.Node]:
        causes = ledger.causes()
        lines = {name: [cause["text"], ""] for name, cause in causes.items()}
        for claim in ledger.claims().values():
            if isinstance(claim, ledger.Contradicts):
                thesis = f"The thesis prints {printed(claim)}."
                if claim.limit:
                    thesis = f"The thesis states: {claim.says}."
                texts = (claim.what, claim.where, thesis, claim.proof)
                what, where, thesis, proof = (escape(text, quote=False) for text in texts)
                text = f"- **{what}** ({where}). {{verdict}}`{claim.id}` {thesis} "
                text += f"The recomputed number is {{recomputed}}`{claim.id}`. Proof: {proof}."
                lines[claim.cause].append(text)
        parts = {name: section(f"cause-{name}", causes[name]["title"]) for name in lines}
        return [parse_lines(self, lines[name], part) for name, part in parts.items()]


class Reaches(SphinxDirective):
    """What of the errata and of the causes changes a result, the same list on every page."""

    def run(self) -> list[nodes.Node]:
        entries = [*ledger.errata().values(), *ledger.causes().values()]
        lines = [f"- {entry['reaches']}" for entry in entries if "reaches" in entry]
        return parse_lines(self, lines, nodes.container()).children


class Errata(SphinxDirective):
    """One section an erratum: where, what was printed, what is right, and the proof."""

    def run(self) -> list[nodes.Node]:
        places = find_items()
        result: list[nodes.Node] = []
        for name, entry in ledger.errata().items():
            proof = place_of_test(entry["test"], f'"{name}": (')
            ways = f"{html_link('Test', *proof)}."
            if claims := entry.get("claims", "").split():
                rows = ledger.claims() | ledger.settings()
                links = (html_link(rows[c].what, "claims", f"claim-{c}") for c in claims)
                ways += f" The entry concerns: {'; '.join(links)}."
            if name in places:
                # The map makes a link of it.
                ways += f" The formula is ({name.removeprefix('equation-')})."
            lines = [f"**{entry['where']}.** *{entry['origin']}.*"]
            lines += ["", f"**Printed:** {entry['printed']}", ""]
            if reading := entry.get("reading"):
                lines += [f"**A reading without an error:** {reading}", ""]
            right = "In the other reading, the text should say" if reading else "Right"
            lines += [f"**{right}:** {entry['corrected']}", ""]
            lines += [entry["proof"], "", f'<span class="erratum-sources">{ways}</span>']
            result.append(parse_lines(self, lines, section(f"erratum-{name}", entry["title"])))
        return result


def html_link(text: str, page: str, anchor: str) -> str:
    """Return a link from a page at the top of the book, for its markup."""
    return f'<a class="internal" href="{page}.html#{nodes.make_id(anchor)}">{escape(text)}</a>'


def setup(app: Sphinx) -> None:
    for name in Role.functions:
        app.add_role(name, Role())
    app.add_directive("ledger-table", LedgerTable)
    app.add_directive("verdict-map", VerdictMap)
    app.add_directive("claims", Claims)
    app.add_directive("differences", Differences)
    app.add_directive("errata", Errata)
    app.add_directive("reaches", Reaches)
    app.connect("doctree-read", name_cells)
