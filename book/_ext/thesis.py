"""Roles and directives that put the ledger's numbers into the book's text.

- ``{ours}`id` ``: our number as recorded; ``{printed}`id` ``: the thesis' number;
  ``{verdict}`id` ``: the verdict.
- ``{claims}`` with a prefix: the scorecard of all claims whose id begins with it; with
  ``:filter:`` readers can narrow it down. Each leads to the cell of the notebook that computed it.
- ``{errata}``: every fault of the thesis with its proof.
- ``{benchmarks}``: every result of ``benchmarks/results`` with the machine named.
- ``{status}``: how each notebook's run went, with the hashes of what it depended on.

A number that was never recorded stops the build, so the text cannot outlive its notebook.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective, SphinxRole
from test_sources import place_of_proof, place_of_test
from thesis_map import find_items

from compendium import ledger

PACKAGES = ("numpy", "scipy", "scikit-image", "opencv-python-headless", "matplotlib", "pandas")
FILTER = """<div class="claims-filter">
<label>Find <input type="search" data-claims-text></label>
<label>Verdict <select data-claims-verdict><option value="">all</option></select></label>
<label>Spent <select data-claims-spent><option value="">all</option></select></label>
<label>Kind <select data-claims-kind><option value="">all</option></select></label>
<output data-claims-count></output></div>"""

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = ROOT / "build" / "claims"
RESULTS = ROOT / "benchmarks" / "results"
#: A cell that holds a number, perhaps with a sign of comparison.
NUMBER = re.compile(r"[≤≥]?\s?[−+-]?\d[\d.,e+-]*")
LONG = 20  # rows above which a table is folded
#: Columns of the scorecard; thesis.css names them again where they are stacked on a phone.
#: Names of faults that a row shows.
MOST_FAULTS = 3
SCORECARD = ["Claim", "Thesis", "Ours", "Rule", "Verdict", "Where"]


@cache
def records() -> dict[str, ledger.Record]:
    return ledger.read_records(CLAIMS)


@cache
def pages() -> dict[str, str]:
    """Return the notebook that recorded each claim."""
    return {
        entry["id"]: path.stem
        for path in sorted(CLAIMS.glob("*.json"))
        for entry in json.loads(path.read_text(encoding="utf-8"))
    }


class Ours(SphinxRole):
    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        record = records().get(self.text)
        if record is None:
            message = self.inliner.reporter.error(f"no notebook recorded {self.text!r}")
            return [nodes.problematic(self.rawtext, self.rawtext)], [message]
        return [nodes.inline(self.rawtext, str(record), classes=["ours"])], []


class Printed(SphinxRole):
    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        claim = ledger.claim(self.text)
        text = with_unit(claim.printed, claim.unit)
        return [nodes.inline(self.rawtext, text, classes=["printed"])], []


class Verdict(SphinxRole):
    """The verdict of a claim, which leads to its row in the scorecard."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        shown = badge(ledger.claim(self.text))
        return [link(self.env, shown, "claims", f"claim-{self.text}")], []


def badge(claim: ledger.Claim) -> nodes.inline:
    text = claim.qualified
    return nodes.inline(text, text, classes=["verdict", f"verdict-{claim.verdict}"])


def link(env: BuildEnvironment, shown: nodes.Node, page: str, anchor: str) -> nodes.reference:
    """Return a link to an anchor of a page of this book."""
    uri = env.app.builder.get_relative_uri(env.docname, page)
    result = nodes.reference("", "", internal=True, refuri=f"{uri}#{nodes.make_id(anchor)}")
    result += shown
    return result


def with_unit(number: str, unit: str) -> str:
    """Return a number with its unit, once; nothing without a number."""
    return f"{number} {unit}".rstrip() if number and not number.endswith(f" {unit}") else number


class Claims(SphinxDirective):
    """The scorecard of the claims whose id begins with the argument; of all without one."""

    optional_arguments = 1
    option_spec: ClassVar = {"filter": directives.flag}

    def run(self) -> list[nodes.Node]:
        prefix = self.arguments[0] if self.arguments else ""
        chosen = [c for c in ledger.claims().values() if c.id.startswith(prefix)]
        if not chosen:
            raise self.error(f"no claim begins with {prefix!r}")
        scores = ledger.scorecard(CLAIMS).set_index("claim")
        rows = [self.row(claim, scores.loc[claim.id]) for claim in chosen]
        # What filter.js narrows the table by.
        sorts = [
            [f"has-{c.verdict}", f"spent-{c.spent or 'nothing'}", f"kind-{c.kind}"] for c in chosen
        ]
        anchors = [nodes.make_id(f"claim-{c.id}") for c in chosen]
        result = [table(SCORECARD, rows, classes=["claims"], row_classes=sorts, row_ids=anchors)]
        if "filter" in self.options:
            result.insert(0, raw_html(FILTER))
        return result

    def row(self, claim: ledger.Claim, score: Mapping[str, Any]) -> list[list[nodes.Node]]:
        printed = with_unit(claim.printed, claim.unit) or "no number"
        if claim.limit_of == "ours":
            printed = f"our limit: {with_unit(claim.limit, claim.unit)}"
        thesis = [line(printed, "printed")]
        if claim.says:
            thesis.append(line(f"It says: {claim.says}."))
        verdict = nodes.paragraph()
        verdict += badge(claim)
        judged = [verdict]
        if score["turns"]:
            judged.append(line(f"turns at {score['turns']} of ours"))
        if score["faults"]:
            count, names = len(score["faults"]), ", ".join(score["faults"][:MOST_FAULTS])
            more = f" and {count - MOST_FAULTS} more" if count > MOST_FAULTS else ""
            judged.append(line(f"turned by: {names}{more}", "faults"))
        for label, text in (("spent", claim.input), ("note", claim.note)):
            if text:
                judged.append(line(f"{label}: {text}"))
        number = "–" if not score["ours"] else with_unit(score["ours"], claim.unit)
        rule = claim.rule
        if claim.limit_of == "ours" and claim.reason:
            rule += f": {claim.reason}"
        return [
            [line(claim.id, "claim-id"), line(claim.what)],
            thesis,
            [line(number, "ours")],
            [line(f"{claim.kind}: {rule}")],
            judged,
            self.sources(claim, score["cell"]),
        ]

    def sources(self, claim: ledger.Claim, cell: str) -> list[nodes.Node]:
        """Return where a claim is computed and what holds the computation."""
        found: list[nodes.Node] = []
        page = pages().get(claim.id)
        if page is not None:
            anchored = anchor(cell) if cell else page
            found.append(
                self.leads(f"cell {cell}" if cell else page, f"notebooks/{page}", anchored)
            )
        if claim.test:
            file, _, function = claim.test.partition("::")
            text = f"{file.removeprefix('tests/')} {function}"
            found.append(self.leads(text, *place_of_test(claim.test), kind="claim-test"))
        for name, entry in ledger.errata().items():
            if claim.id in entry.get("claims", "").split():
                found.append(self.leads("erratum", "errata", f"erratum-{name}"))
        return found or [line("–")]

    def leads(self, text: str, page: str, anchor: str, *, kind: str = "") -> nodes.paragraph:
        paragraph = nodes.paragraph(classes=[kind] if kind else [])
        paragraph += link(self.env, breakable(text), page, anchor)
        return paragraph


def breakable(name: str) -> nodes.inline:
    """Return a long name of the code that may be broken after its underscores and slashes."""
    shown = nodes.inline()
    for part in re.findall(r"[^_/]+[_/]*|[_/]+", name):
        shown += [nodes.Text(part), raw_html("<wbr>")]
    return shown


def line(text: str, kind: str = "") -> nodes.paragraph:
    return nodes.paragraph(text, text, classes=[kind] if kind else [])


class Status(SphinxDirective):
    """A table of the notebooks' runs, and the versions that they ran with."""

    def run(self) -> list[nodes.Node]:
        runs = [
            json.loads(p.read_text()) for p in sorted((ROOT / "build" / "status").glob("*.json"))
        ]
        key = runs[0]["key"]
        head = ["Notebook", "Run time (s)", "Checks passed", "Notebook's hash"]
        rows = [
            [
                r["notebook"],
                str(r["seconds"]),
                r["failed"] or str(r["checks"]),
                nodes.literal("", r["key"]["notebook"][:12]),
            ]
            for r in runs
        ]
        shared = [
            ["microlib", nodes.literal("", key["microlib"][:12])],
            ["data", nodes.literal("", key["data"][:12])],
            ["environment.txt", nodes.literal("", key["lock"][:12])],
            ["Python", key["python"]],
            *([name, version(name)] for name in PACKAGES),
        ]
        return [table(head, rows), table(["What they ran with", "Hash or version"], shared)]


class Errata(SphinxDirective):
    """One section an erratum: where, what was printed, what is right, and the proof."""

    def run(self) -> list[nodes.Node]:
        origins = {
            "print": "a fault of the thesis",
            "open": "print and machine reading cannot be told apart",
            "wording": "another reading is possible, in which nothing is wrong",
        }
        result: list[nodes.Node] = []
        for name, entry in ledger.errata().items():
            part = section(f"erratum-{name}", entry["where"])
            lines = [
                f"**Printed:** {entry['printed']}",
                "",
                f"**Right:** {entry['corrected']}",
                "",
                entry["proof"],
                "",
                f"*Origin: {origins[entry['origin']]}.*",
            ]
            self.state.nested_parse(StringList(lines, source="errata.toml"), 0, part)
            part += self.sources(name, entry)
            result.append(part)
        return result

    def sources(self, name: str, entry: Mapping[str, str]) -> nodes.paragraph:
        """Return the way to the proof, to the printed numbers, and to where the formula stands."""
        file = entry["test"]
        shown = [("Proof: ", file, *place_of_proof(name))]
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


class Benchmarks(SphinxDirective):
    """What must hold, and every benchmark on file, with the machine it was measured on."""

    def run(self) -> list[nodes.Node]:
        found = {
            path.stem.replace("_", " ").capitalize(): json.loads(path.read_text(encoding="utf-8"))
            for path in sorted(RESULTS.glob("*.json"))
        }
        lines = [
            [name, *line[:3], holds(line[3])] for name, r in found.items() for line in r["limits"]
        ]
        limits = section("benchmark-limits", "What must hold")
        text = (
            "Limits are what was asked for before anything was measured; "
            f"{sum(line[-1].astext() == 'yes' for line in lines)} of {len(lines)} hold."
        )
        limits += nodes.paragraph(text, text)
        limits += table(["", "what", "measured", "limit", "holds"], lines)
        return [limits, *(self.one(name, record) for name, record in found.items())]

    def one(self, name: str, record: dict) -> nodes.section:
        result = section(f"benchmark-{name}", name)
        machine = record["machine"]
        versions = ", ".join(
            f"{k} {v}" for k, v in machine.items() if k not in ("processor", "cores")
        )
        text = f"Measured on {machine['processor']}, {machine['cores']} cores; {versions}."
        result += nodes.paragraph(text, text)
        if record["note"]:
            self.state.nested_parse(StringList(record["note"].split("\n")), 0, result)
        for title, content in record["tables"].items():
            rows = [[show(value) for value in row] for row in content["data"]]
            whole = table([str(column) for column in content["columns"]], rows)
            if len(rows) <= LONG:
                result += [nodes.rubric("", title), whole]
                continue
            summary = f"<details><summary>{title} ({len(rows)} rows)</summary>"
            result += [raw_html(summary), whole, raw_html("</details>")]
        return result


def section(name: str, title: str) -> nodes.section:
    result = nodes.section(ids=[nodes.make_id(name)])
    result += nodes.title(title, title)
    return result


def raw_html(text: str) -> nodes.raw:
    return nodes.raw("", text, format="html")


def holds(answer: str) -> nodes.inline:
    kind = "reproduced" if answer == "yes" else "differs"
    return nodes.inline(answer, answer, classes=["verdict", f"verdict-{kind}"])


def show(value: object) -> str:
    if value is None or value != value:  # NaN
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def table(
    head: list[str],
    rows: list[list],
    *,
    classes: list[str] | None = None,
    row_classes: list[list[str]] | None = None,
    row_ids: list[str] | None = None,
) -> nodes.table:
    """Build a docutils table; cells are text, nodes, or lists of paragraphs."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=1) for _ in head]

    def across(cells: list, classes: list[str], ids: Sequence[str] = ()) -> nodes.row:
        row = nodes.row(classes=classes, ids=list(ids))
        for cell in cells:
            entry = nodes.entry()
            if isinstance(cell, list):
                entry += cell
            else:
                if isinstance(cell, str) and NUMBER.fullmatch(cell):
                    entry["classes"] += ["number"]  # not broken on a phone
                paragraph = nodes.paragraph()
                paragraph += cell if isinstance(cell, nodes.Node) else nodes.Text(cell)
                entry += paragraph
            row += entry
        return row

    header, body = nodes.thead(), nodes.tbody()
    header += across(head, [])
    names = row_classes or [[]] * len(rows)
    ids = [[name] for name in row_ids] if row_ids else [[]] * len(rows)
    body += [across(*whole) for whole in zip(rows, names, ids, strict=True)]
    group += [header, body]
    result = nodes.table(classes=["colwidths-auto", *(classes or [])])
    result += group
    return result


def keep_own_numbers(app: Sphinx, config: Config) -> None:
    # A LaTeX helper of jupyter-book turns Sphinx' own figure numbers on, whatever the settings say.
    config["numfig"] = False


def anchor(cell: str) -> str:
    return f"cell-{cell}"


def name_cells(app: Sphinx, doctree: nodes.document) -> None:
    """Give each code cell of a notebook an address: that of its lasting id."""
    path = Path(app.env.doc2path(app.env.docname))
    if path.suffix != ".ipynb":
        return
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    for node in doctree.findall(nodes.container):
        if node.get("nb_element") == "cell_code":
            node["ids"].append(anchor(cells[node["cell_index"]]["id"]))


def write_scorecard(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        path = Path(app.outdir) / "_static" / "scorecard.csv"
        ledger.scorecard(CLAIMS).to_csv(path, index=False)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_role("ours", Ours())
    app.add_role("printed", Printed())
    app.add_role("verdict", Verdict())
    app.add_directive("claims", Claims)
    app.add_directive("errata", Errata)
    app.add_directive("benchmarks", Benchmarks)
    app.add_directive("status", Status)
    app.add_css_file("thesis.css")
    app.add_js_file("filter.js", loading_method="defer")
    app.connect("config-inited", keep_own_numbers, priority=900)
    app.connect("doctree-read", name_cells)
    app.connect("build-finished", write_scorecard)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
