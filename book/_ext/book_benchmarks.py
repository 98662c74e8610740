"""The benchmarks on their pages: a chart first, and the tables folded.

- ``{benchmark-chart}`` with the name of a result: one of its tables as a dot plot, with a line for
  each row and a symbol for each column.
- ``{benchmarks}`` with the names of results: their tables, with the machine that they were
  measured on; without a name, the limits that must hold.

They read files of this project, for which no extension exists.
"""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from book_tables import line, raw_html, section, show, table
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from compendium import ROOT
from compendium.figures.style import to_svg, use_style

RESULTS = ROOT / "benchmarks" / "results"
MARKERS = "osD^v*"


def rows_of(result: str, options: dict[str, str]) -> pd.DataFrame:
    """Return the numbers of a chart: a row for each line, a column for each symbol."""
    record = json.loads((RESULTS / f"{result}.json").read_text(encoding="utf-8"))
    content = record["tables"][options["table"]]
    found = pd.DataFrame(content["data"], columns=content["columns"])
    if "rows" in options:
        column, _, value = options["rows"].partition(" = ")
        found = found[found[column] == value]
    names = [options["label"].format(**row) for row in found.to_dict("records")]
    found.index = pd.Index(names)
    if "pivot" in options:
        found = found.assign(name=names).pivot(
            index="name", columns=options["pivot"], values=options["values"]
        )
        found = found.loc[list(dict.fromkeys(names))]
    series = dict(one.strip().partition(" = ")[::2] for one in options["columns"].split("|"))
    shown = found[list(series)].rename(columns={k: v for k, v in series.items() if v})
    return shown.apply(pd.to_numeric, errors="coerce")  # a text says that nothing was found


def draw(found: pd.DataFrame, quantity: str, *, log: bool) -> Figure:
    use_style()
    figure = Figure(figsize=(5.2, 1.8 + 0.34 * len(found) + 0.22 * len(found.columns)))
    axes = figure.subplots()
    places = range(len(found), 0, -1)
    for name, marker in zip(found, MARKERS, strict=False):
        axes.plot(found[name].to_numpy(), list(places), marker, label=name, markersize=7)
    axes.set(yticks=list(places), xlabel=quantity)
    axes.set_yticklabels(list(found.index))
    if log:
        axes.set_xscale("log")
        few_decades = np.nanmax(found) < 20 * np.nanmin(found)  # the labels have room
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if few_decades else (1,)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=1)
    return figure


class BenchmarkChart(SphinxDirective):
    """A chart of one table, with its caption, which is the content of the directive.

    Its options are the title of the ``table``; the ``label`` of a row, with columns in braces; the
    ``columns`` that are drawn, each perhaps with its name in the legend; and the ``quantity`` of
    the horizontal axis, which is logarithmic unless it is ``linear``. ``rows`` keeps those with
    one value in a column. The values of the column ``pivot`` become columns of the ``values``.
    """

    required_arguments = 1
    has_content = True
    names = ("table", "label", "columns", "quantity", "rows", "pivot", "values")
    option_spec: ClassVar = dict.fromkeys(names, str) | {"linear": directives.flag}

    def run(self) -> list[nodes.Node]:
        name, quantity = self.arguments[0], self.options["quantity"]
        numbers = rows_of(name, self.options)
        figure = draw(numbers, quantity, log="linear" not in self.options)
        folder = Path(self.env.app.outdir) / "_images"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"benchmark_{name}.svg").write_text(to_svg(figure), encoding="utf-8")
        alt = f"Dot plot of {quantity} for {len(numbers)} cases and "
        alt += f"{len(numbers.columns)} series: {', '.join(numbers)}. The tables have the numbers."
        result = nodes.container(classes=["benchmark-chart"])
        image = f'<img src="_images/benchmark_{name}.svg" alt="{escape(alt)}">'
        result += raw_html(f"<figure>{image}</figure>")
        self.state.nested_parse(self.content, self.content_offset, result)
        return [result]


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
                kind = "follows" if holds == "yes" else "contradicts"
                answer = nodes.inline(holds, holds, classes=["verdict", f"verdict-{kind}"])
                lines.append([name, what, measured, limit, answer])
        kept = sum(row[-1].astext() == "yes" for row in lines)
        lines.sort(key=lambda row: row[-1].astext() == "yes")
        text = f"The limits were set before the measurements. {kept} of {len(lines)} limits hold. "
        text += f"The {len(lines) - kept} limits that do not hold come first."
        return [line(text), table(["", "quantity", "measured", "limit", "holds"], lines)]

    def one(self, name: str) -> list[nodes.Node]:
        record = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
        result = section(f"benchmark-{name}", name.replace("_", " ").capitalize())
        machine = record["machine"]
        run = table([*machine], [[str(value) for value in machine.values()]])
        result += [raw_html("<details><summary>Date, machine and versions</summary>"), run]
        result += raw_html("</details>")
        if record["note"]:
            self.state.nested_parse(StringList(record["note"].split("\n")), 0, result)
        if missed := [each[:3] for each in record["limits"] if each[3] == "no"]:
            result += line("Limits that do not hold:")
            result += table(["quantity", "measured", "limit"], missed)
        for title, content in record["tables"].items():
            rows = [[show(value) for value in row] for row in content["data"]]
            whole = table([str(column) for column in content["columns"]], rows)
            summary = f"<details><summary>Table: {title} ({len(rows)} rows)</summary>"
            result += [raw_html(summary), whole, raw_html("</details>")]
        return [result]


def setup(app: Sphinx) -> None:
    app.add_directive("benchmarks", Benchmarks)
    app.add_directive("benchmark-chart", BenchmarkChart)
