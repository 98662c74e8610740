"""Roles and directives that put the ledger's numbers into the book's text.

- ``{recomputed}`id` `` (or ``ours``), ``{printed}`id` ``, ``{verdict}`id` ``: the recomputed
  number, the thesis' number and the verdict; a verdict leads to its row in the list of claims.
- ``{verdict-map}``: a bar for each part of the thesis, each piece of which leads to its claims.
- ``{claims}``: the list of all claims, which ``_static/filter.js`` narrows; ``{differences}``:
  those that disagree, with the reason; ``{deviations}``: where another rule than 95 % judges.
- ``{errata}``: every fault of the thesis with its proof.

A number that was never recorded stops the build, so the text cannot outlive its notebook. No
extension that exists knows of claims, which is what all of this file is about.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from html import escape
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole
from tables import line, link, long_name, raw_html, section, table
from test_sources import place_of_proof, place_of_test
from thesis_map import find_items

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = ROOT / "build" / "claims"
#: Most telling first.
ORDER = ("disagrees", "cannot tell", "agrees", "input")
#: Parts of the thesis, and what the ids of their claims begin with.
PARTS = {
    "1 and 2 Introduction, microsystems and vision": ("section-1", "section-2"),
    "3 Visual reconstruction and classification": ("section-3", "table-3"),
    "4 Mechanical characterization": ("section-4",),
    "5.1 Hardware": ("section-5.1",),
    "5.2 Calibration": ("section-5.2", "table-5.1", "table-5.2"),
    "5.3 Tracking": ("section-5.3",),
    "5.4 Visual servoing": ("section-5.4", "table-5.3", "table-5.4"),
    "5.5 Shape from focus and surface types": ("section-5.5",),
    "5.6 Stiffness of the embryo": ("section-5.6", "table-5.5", "table-5.6", "table-5.7"),
    "6 Abstract and conclusion": ("abstract", "section-6"),
}
FILTER = """<div class="claims-filter">
<label>Find <input type="search" data-claims="text"></label>
<label>Verdict <select data-claims="verdict"><option value="">all</option></select></label>
<label>Star <select data-claims="star"><option value="">all</option></select></label>
<label>Compared by <select data-claims="by"><option value="">all</option></select></label>
<label>Part <select data-claims="part"><option value="">all</option></select></label>
<output data-claims-count></output></div>"""
ORIGINS = {
    "print": "a fault of the thesis",
    "open": "print and machine reading cannot be told apart",
    "wording": "the text can be understood so that nothing is wrong",
}


@cache
def records() -> dict[str, ledger.Record]:
    return ledger.read_records(CLAIMS)


def part_of(claim: ledger.Claim) -> str:
    """Return the part of the thesis that a claim belongs to."""
    return next(part for part, starts in PARTS.items() if claim.id.startswith(starts))


def facets(claim: ledger.Claim) -> dict[str, str]:
    """Return what the list of claims can be narrowed by, as the address has it."""
    star = "starred" if claim.star else "unstarred"
    by = claim.compared or "not compared"
    return {"verdict": claim.verdict, "star": star, "by": by, "part": part_of(claim).split()[0]}


class Recomputed(SphinxRole):
    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        record = records().get(self.text)
        if record is None:
            message = self.inliner.reporter.error(f"no notebook recorded {self.text!r}")
            return [nodes.problematic(self.rawtext, self.rawtext)], [message]
        return [nodes.inline(self.rawtext, str(record), classes=["recomputed"])], []


class Printed(SphinxRole):
    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        text = printed(ledger.claim(self.text))
        return [nodes.inline(self.rawtext, text, classes=["printed"])], []


class Verdict(SphinxRole):
    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        return [lead_to(self.env, ledger.claim(self.text))], []


def printed(claim: ledger.Claim) -> str:
    """Return the number that the thesis prints, with its unit."""
    return f"{claim.printed} {claim.unit}".rstrip() if claim.printed else "no number"


def badge(claim: ledger.Claim) -> nodes.inline:
    kind = claim.verdict.replace(" ", "-")
    return nodes.inline(claim.label, claim.label, classes=["verdict", f"verdict-{kind}"])


def lead_to(env: object, claim: ledger.Claim) -> nodes.reference:
    """Return a claim's badge, which leads to its row."""
    return link(env, badge(claim), "claims", f"claim-{claim.id}")


class VerdictMap(SphinxDirective):
    """A bar for each part of the thesis; each piece leads to the claims that it counts."""

    def run(self) -> list[nodes.Node]:
        page = self.env.app.builder.get_relative_uri(self.env.docname, "claims")
        shades = [(verdict, star) for verdict in ORDER for star in ("unstarred", "starred")]
        rows = []
        totals = Counter(part_of(claim) for claim in ledger.claims().values())
        for part in PARTS:
            pieces = ""
            for verdict, star in shades:
                wanted = {"verdict": verdict, "star": star, "part": part.split()[0]}
                count = sum(
                    wanted.items() <= facets(claim).items() for claim in ledger.claims().values()
                )
                if count:
                    query = "&amp;".join(f"{key}={value}" for key, value in wanted.items())
                    said = f"{part}: {count} {verdict}, {star}"
                    pieces += (
                        f'<a class="verdict-{verdict.replace(" ", "-")} {star}" '
                        f'style="flex-grow: {count}" href="{page}?{query.replace(" ", "%20")}" '
                        f'title="{said}" aria-label="{said}">{count}</a>'
                    )
            if pieces:
                rest = max(totals.values()) - totals[part]
                rest = f'<span style="flex-grow: {rest}"></span>'
                rows.append(f"<dt>{part}</dt><dd>{pieces}{rest}</dd>")
        key = "".join(
            f'<span class="verdict-{verdict.replace(" ", "-")}">{verdict}</span>'
            for verdict in ORDER
        )
        key += f'<span class="starred">{ledger.STAR} hangs on something not printed</span>'
        html = f'<p class="verdict-key">{key}</p><dl>{"".join(rows)}</dl>'
        return [raw_html(f'<div class="verdict-map">{html}</div>')]


class Claims(SphinxDirective):
    """The list of all claims with a filter, those that disagree first."""

    def run(self) -> list[nodes.Node]:
        chosen = sorted(ledger.claims().values(), key=lambda claim: ORDER.index(claim.verdict))
        head = ["Claim", "Thesis", "Recomputed", "Verdict", "Where"]
        rows = [self.row(claim) for claim in chosen]
        result = table(head, rows, ids=[f"claim-{claim.id}" for claim in chosen])
        result["classes"].append("claims")
        data = {nodes.make_id(f"claim-{claim.id}"): facets(claim) for claim in chosen}
        script = f'<script type="application/json" id="claims-facets">{json.dumps(data)}</script>'
        return [raw_html(FILTER), result, raw_html(script)]

    def row(self, claim: ledger.Claim) -> list[list[nodes.Node]]:
        record = records().get(claim.id)
        verdict = nodes.paragraph()
        verdict += badge(claim)
        if claim.compared:
            verdict += nodes.Text(f" by {claim.compared}")
        said = [(f"{ledger.STAR} ", claim.star), ("", claim.note), ("Corrected: ", claim.corrected)]
        rule = f"{claim.rule}: {claim.reason}" if claim.reason else claim.rule
        said.append(("Rule: ", rule))
        thesis = [line(printed(claim), "printed")]
        return [
            [line(claim.what), line(claim.id, "claim-id")],
            [*thesis, line(f"{claim.says}.")] if claim.says else thesis,
            [line("–" if record is None else str(record), "recomputed")],
            [verdict, *(line(f"{label}{text.rstrip('.')}.") for label, text in said if text)],
            list(self.sources(claim)),
        ]

    def sources(self, claim: ledger.Claim) -> Iterator[nodes.Node]:
        """Yield where a claim stands in the chapters, what holds its computation, its erratum."""
        page, anchor = place_of(claim)
        yield self.leads(claim.where, page, anchor)
        if claim.test:
            text = claim.test.removeprefix("tests/").replace("::", " ")
            yield self.leads(text, *place_of_test(claim.test), kind="claim-test")
        for name, entry in ledger.errata().items():
            if claim.id in entry.get("claims", "").split():
                yield self.leads("erratum", "errata", f"erratum-{name}")

    def leads(self, text: str, page: str, anchor: str, *, kind: str = "") -> nodes.paragraph:
        paragraph = nodes.paragraph(classes=[kind] if kind else [])
        paragraph += link(self.env, long_name(text), page, anchor)
        return paragraph


def place_of(claim: ledger.Claim) -> tuple[str, str]:
    """Return page and anchor of the table or section that a claim's id begins with."""
    places = find_items(ROOT / "build" / "notebooks")
    name = claim.id.split("/")[0]
    while name not in places and "." in name:
        name = name.rpartition(".")[0]  # a subsection without a heading of its own
    stem, anchor = places.get(name, places["section-6"])
    return f"notebooks/{stem}", anchor


class Differences(SphinxDirective):
    """Each claim that disagrees: both numbers and the reason, by part of the thesis."""

    def run(self) -> list[nodes.Node]:
        found = [claim for claim in ledger.claims().values() if claim.verdict == "disagrees"]
        result: list[nodes.Node] = []
        for part in PARTS:
            entries = [self.entry(claim) for claim in found if part_of(claim) == part]
            if entries:
                whole = section(f"differences-{part.split()[0]}", part)
                whole += nodes.bullet_list("", *entries)
                result.append(whole)
        return result

    def entry(self, claim: ledger.Claim) -> nodes.list_item:
        record = records().get(claim.id)
        text = nodes.paragraph()
        text += [nodes.strong("", f"{claim.what}. "), lead_to(self.env, claim), nodes.Text(" ")]
        thesis = f"Printed: {printed(claim)}. " if claim.printed else f"It says: {claim.says}. "
        text += nodes.Text(f"{thesis}Recomputed: {'–' if record is None else record}. {claim.note}")
        item = nodes.list_item("", text)
        if claim.star:
            item += line(f"{ledger.STAR} {claim.star}.")
        return item


class Deviations(SphinxDirective):
    """Every tolerance and limit that is not the general rule, with its reason."""

    def run(self) -> list[nodes.Node]:
        groups: dict[str, list[ledger.Claim]] = {}
        for claim in ledger.claims().values():
            if claim.reason:
                groups.setdefault(claim.reason, []).append(claim)
        rows = []
        for reason, alike in groups.items():
            names = nodes.paragraph()
            for k, claim in enumerate(alike):
                shown = long_name(claim.id)
                names += [nodes.Text(", " if k else "")]
                names += link(self.env, shown, "claims", f"claim-{claim.id}")
            rows.append([[names], alike[0].rule, reason])
        return [table(["Claims", "Rule", "Reason"], rows)]


class Errata(SphinxDirective):
    """One section an erratum: where, what was printed, what is right, and the proof."""

    def run(self) -> list[nodes.Node]:
        result: list[nodes.Node] = []
        for name, entry in ledger.errata().items():
            part = section(f"erratum-{name}", entry["title"])
            lines = [
                f"**{entry['where']}.** *{ORIGINS[entry['origin']].capitalize()}.*",
                "",
                f"**Printed:** {entry['printed']}",
                "",
                f"**Right:** {entry['corrected']}",
                "",
                entry["proof"],
            ]
            self.state.nested_parse(StringList(lines, source="errata.toml"), 0, part)
            part += self.sources(name, entry)
            result.append(part)
        return result

    def sources(self, name: str, entry: Mapping[str, str]) -> nodes.paragraph:
        """Return the way to the proof, to the printed numbers, and to where the formula stands."""
        shown = [("Proof: ", entry["test"], *place_of_proof(name))]
        for k, claim in enumerate(entry.get("claims", "").split()):
            before = ", " if k else ". Printed numbers: "
            shown.append((before, claim, "claims", f"claim-{claim}"))
        if name in (places := find_items(ROOT / "build" / "notebooks")):
            stem, anchored = places[name]
            number = name.removeprefix("equation-")
            shown.append((". Formula: ", f"({number})", f"notebooks/{stem}", anchored))
        paragraph = nodes.paragraph(classes=["erratum-sources"])
        for before, text, page, anchored in shown:
            paragraph += [nodes.Text(before), link(self.env, nodes.Text(text), page, anchored)]
        paragraph += nodes.Text(".")
        return paragraph


def preview_claims() -> dict[str, str]:
    """Return what a link to a claim's row shows of it, by the row's anchor."""
    return {
        nodes.make_id(f"claim-{claim.id}"): f"<p>{escape(claim.what)}: {escape(printed(claim))} "
        f"in the thesis; {escape(claim.label)}. {escape(claim.note or claim.says)}</p>"
        for claim in ledger.claims().values()
    }


def write_scorecard(app: Sphinx, error: Exception | None) -> None:
    """Publish all verdicts as a spreadsheet and as JSON."""
    if error is None and app.builder.format == "html":
        scores = ledger.scorecard(CLAIMS)
        scores.to_csv(Path(app.outdir) / "_static" / "scorecard.csv", index=False)
        text = scores.to_json(orient="records", force_ascii=False, indent=1)
        (Path(app.outdir) / "_static" / "verdicts.json").write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    for name in ("recomputed", "ours"):
        app.add_role(name, Recomputed())
    app.add_role("printed", Printed())
    app.add_role("verdict", Verdict())
    app.add_directive("verdict-map", VerdictMap)
    app.add_directive("claims", Claims)
    app.add_directive("differences", Differences)
    app.add_directive("deviations", Deviations)
    app.add_directive("errata", Errata)
    app.add_css_file("thesis.css")
    app.add_js_file("filter.js", loading_method="defer")
    app.connect("build-finished", write_scorecard)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
