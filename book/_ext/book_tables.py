"""Pieces of pages that the other extensions are made of; and the benchmarks as tables.

- ``{benchmarks}`` with the names of results: their tables, with the machine that they were
  measured on; without one, what must hold.

They read files of this project, which no extension that exists knows.
"""

from __future__ import annotations

import json
import re
import subprocess
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.util.docutils import SphinxDirective

from compendium import ROOT

RESULTS = ROOT / "benchmarks" / "results"
#: A cell that holds a number, perhaps with a sign of comparison, is not broken on a phone.
NUMBER = re.compile(r"[≤≥]?\s?[−+-]?\d[\d.,e+-]*")
#: A line that imports from `microlib`, and from which of its packages.
IMPORT = re.compile(r"^\s*(?:from|import) microlib(?:\.| import )(\w+)", re.M)
LONG = 20  # rows above which a table is folded


def table(head: list[str], rows: list[list], *, ids: list[str] | None = None) -> nodes.table:
    """Build a docutils table; cells are text, nodes, or lists of paragraphs."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=1) for _ in head]

    def across(cells: list, name: str = "") -> nodes.row:
        row = nodes.row(ids=[nodes.make_id(name)] if name else [])
        for cell in cells:
            shown = cell
            if not isinstance(cell, list):
                shown = nodes.paragraph()
                shown += cell if isinstance(cell, nodes.Node) else nodes.Text(cell)
            entry = nodes.entry()
            if isinstance(cell, str) and NUMBER.fullmatch(cell):
                entry["classes"] += ["number"]
            entry += shown
            row += entry
        return row

    header, body = nodes.thead(), nodes.tbody()
    header += across(head)
    body += [across(row, name) for row, name in zip(rows, ids or [""] * len(rows), strict=True)]
    group += [header, body]
    result = nodes.table(classes=["colwidths-auto"])
    result += group
    return result


def link(env: Any, shown: nodes.Node, page: str, anchor: str) -> nodes.reference:
    """Return a link to an anchor of a page of this book."""
    uri = env.app.builder.get_relative_uri(env.docname, page)
    address = f"{uri}#{nodes.make_id(anchor)}" if anchor else uri
    result = nodes.reference("", "", internal=True, refuri=address)
    result += shown
    return result


def section(name: str, title: str) -> nodes.section:
    result = nodes.section(ids=[nodes.make_id(name)])
    result += nodes.title(title, title)
    return result


def line(text: str, kind: str = "") -> nodes.paragraph:
    return nodes.paragraph(text, text, classes=[kind] if kind else [])


def span(text: str, kind: str) -> nodes.inline:
    return nodes.inline(text, text, classes=[kind])


def script_json(data: object) -> str:
    """Return data for an element ``<script type="application/json">``, which no text may end."""
    return json.dumps(data, ensure_ascii=False).replace("<", "\\u003c")


def raw_html(text: str) -> nodes.raw:
    return nodes.raw("", text, format="html")


def show(value: object) -> str:
    if value is None or value != value:  # NaN
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class Benchmarks(SphinxDirective):
    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        if self.arguments:
            return [part for name in self.arguments[0].split() for part in self.one(name)]
        lines = []
        for path in sorted(RESULTS.glob("*.json")):
            name = path.stem.replace("_", " ").capitalize()
            for what, measured, limit, holds in json.loads(path.read_text("utf-8"))["limits"]:
                kind = "agrees" if holds == "yes" else "disagrees"
                answer = nodes.inline(holds, holds, classes=["verdict", f"verdict-{kind}"])
                lines.append([name, what, measured, limit, answer])
        kept = sum(row[-1].astext() == "yes" for row in lines)
        lines.sort(key=lambda row: row[-1].astext() == "yes")
        text = f"Limits were set before anything was measured; {kept} of {len(lines)} hold. "
        text += f"The {len(lines) - kept} that do not stand first."
        return [line(text), table(["", "what", "measured", "limit", "holds"], lines)]

    def one(self, name: str) -> list[nodes.Node]:
        record = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
        result = section(f"benchmark-{name}", name.replace("_", " ").capitalize())
        machine = record["machine"]
        versions = [f"{k} {v}" for k, v in machine.items() if k not in ("processor", "cores")]
        result += line(
            f"Measured on {machine['processor']}, {machine['cores']} cores; {', '.join(versions)}."
        )
        result += line(changes_since(name, machine["commit"].split()[0]))
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
        return [result]


def changes_since(name: str, commit: str) -> str:
    """Say how often what a benchmark measures was changed after the commit that it measured."""
    file = f"benchmarks/{name}.py"
    packages = {"_common", *IMPORT.findall((ROOT / file).read_text("utf-8"))}
    paths = [file, *(f"microlib/{package}{end}" for package in packages for end in ("", ".py"))]
    command = ["git", "-C", str(ROOT), "rev-list", "--count", f"{commit}..HEAD", "--", *paths]
    count = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    if count == "0":
        return "The code that it measures is the same since."
    known = f"was changed in {count} commits since" if count else "may have changed since"
    return f"The code that it measures {known}, so another run may give other numbers."


def disable_numfig(app: Sphinx, config: Config) -> None:
    # A LaTeX helper of jupyter-book turns Sphinx' own figure numbers on, whatever the settings say.
    config["numfig"] = False


def setup(app: Sphinx) -> None:
    app.add_directive("benchmarks", Benchmarks)
    app.connect("config-inited", disable_numfig, priority=900)
