"""Roles and directives that put the ledger's numbers into the book's text.

- ``{ours}`id` ``: our number as recorded; ``{printed}`id` ``: the thesis' number;
  ``{verdict}`id` ``: the verdict.
- ``{claims}`` with a prefix: a table of all claims whose id begins with it; with ``:filter:``
  readers can narrow it down.
- ``{errata}``: every fault of the thesis with its proof.
- ``{benchmarks}``: every result of ``benchmarks/results`` with the machine named.
- ``{status}``: how each notebook's run went, with the hashes of what it depended on.

A number that was never recorded stops the build, so the text cannot outlive its notebook.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.util.docutils import SphinxDirective, SphinxRole

from compendium import ledger

PACKAGES = ("numpy", "scipy", "scikit-image", "opencv-python-headless", "matplotlib", "pandas")
FILTER = """<div class="claims-filter">
<label>Find <input type="search" data-claims-text></label>
<label>Verdict <select data-claims-verdict><option value="">all</option></select></label>
<output data-claims-count></output></div>"""

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = ROOT / "build" / "claims"
RESULTS = ROOT / "benchmarks" / "results"
LONG = 20  # rows above which a table is folded


@cache
def records() -> dict[str, ledger.Record]:
    return ledger.read_records(CLAIMS)


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
        text = f"{claim.printed} {claim.unit}".rstrip()
        return [nodes.inline(self.rawtext, text, classes=["printed"])], []


class Verdict(SphinxRole):
    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        return [badge(ledger.claim(self.text))], []


def badge(claim: ledger.Claim) -> nodes.inline:
    text = claim.qualified
    return nodes.inline(text, text, classes=["verdict", f"verdict-{claim.verdict}"])


class Claims(SphinxDirective):
    """A table of the claims whose id begins with the argument; all of them without one."""

    optional_arguments = 1
    option_spec: ClassVar = {"filter": directives.flag}

    def run(self) -> list[nodes.Node]:
        prefix = self.arguments[0] if self.arguments else ""
        chosen = [c for c in ledger.claims().values() if c.id.startswith(prefix)]
        if not chosen:
            raise self.error(f"no claim begins with {prefix!r}")
        head = ["Claim", "Quantity", "Printed", "Ours", "Unit", "Verdict"]
        rows = []
        for claim in chosen:
            record = records().get(claim.id)
            number = ""
            if record is not None:
                number = str(record).removesuffix(claim.unit).rstrip()
            cells = [
                nodes.literal(claim.id, claim.id),
                claim.what,
                claim.printed,
                number,
                claim.unit,
            ]
            rows.append([*cells, badge(claim)])
        result = [table(head, rows, classes=["claims"])]
        if "filter" in self.options:
            result.insert(0, raw_html(FILTER))
        return result


class Status(SphinxDirective):
    """A table of the notebooks' runs, and the versions that they ran with."""

    def run(self) -> list[nodes.Node]:
        runs = [
            json.loads(p.read_text()) for p in sorted((ROOT / "build" / "status").glob("*.json"))
        ]
        head = ["Notebook", "Run time (s)", "Checks passed", "Notebook's hash"]
        rows = [
            [
                r["notebook"],
                str(r["seconds"]),
                str(r["checks"]),
                nodes.literal("", r["notebook_file"][:12]),
            ]
            for r in runs
        ]
        shared = [
            ["microlib", nodes.literal("", runs[0]["library"][:12])],
            ["data", nodes.literal("", runs[0]["data"][:12])],
            ["environment.txt", nodes.literal("", runs[0]["lock"][:12])],
            ["Python", runs[0]["python"]],
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
                f"*Origin: {origins[entry['origin']]}. Proven in* `{entry['test']}`.",
            ]
            self.state.nested_parse(StringList(lines, source="errata.toml"), 0, part)
            result.append(part)
        return result


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


def table(head: list[str], rows: list[list], *, classes: list[str] | None = None) -> nodes.table:
    """Build a docutils table; cells are text or nodes."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=1) for _ in head]

    def line(cells: list) -> nodes.row:
        row = nodes.row()
        for cell in cells:
            content = cell if isinstance(cell, nodes.Node) else nodes.Text(cell)
            paragraph = nodes.paragraph()
            paragraph += content
            entry = nodes.entry()
            entry += paragraph
            row += entry
        return row

    header, body = nodes.thead(), nodes.tbody()
    header += line(head)
    body += [line(row) for row in rows]
    group += [header, body]
    result = nodes.table(classes=["colwidths-auto", *(classes or [])])
    result += group
    return result


def keep_own_numbers(app: Sphinx, config: Config) -> None:
    # A LaTeX helper of jupyter-book turns Sphinx' own figure numbers on, whatever the settings say.
    config["numfig"] = False


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
    app.connect("build-finished", write_scorecard)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
