"""The benchmarks on their pages: a chart first, and the tables folded.

- ``{benchmark-chart}`` with the name of a chart in `CHARTS`: one table of a result as a picture.
- ``{benchmarks}`` with the names of results: their tables, with the machine that they were
  measured on; without a name, the limits that must hold.

They read files of this project, for which no extension exists.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
from book_tables import IMPORT, line, raw_html, section, show, table
from docutils import nodes
from docutils.statemachine import StringList
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from compendium import ROOT
from compendium.figures.style import COLORS, to_svg, use_style

RESULTS = ROOT / "benchmarks" / "results"
MARKERS = "osD^v*"


@dataclass(frozen=True)
class Chart:
    """One table as a dot plot: a line for each row, a symbol for each column.

    Attributes
    ----------
    result, table : str
        The file of the result and the title of the table in it.
    label : str
        The text of a row, with the names of columns in braces.
    columns : dict
        The columns that are drawn, with their names in the legend.
    quantity : str
        The label of the horizontal axis.
    rows : dict
        Only rows with these values in these columns.
    pivot : str
        A column whose values become the columns; the numbers are those of `values`.
    log : bool
        Whether the axis is logarithmic.
    """

    result: str
    table: str
    label: str
    columns: dict[str, str]
    quantity: str
    rows: dict[str, object] = field(default_factory=dict)
    pivot: str = ""
    values: str = ""
    log: bool = True


CHARTS = {
    "calibration": Chart(
        "calibration",
        "Localisation, RMS px",
        "blur {blur px} px, noise {noise}",
        {
            "circles, microlib": "circles, microlib",
            "findCirclesGrid": "circles, OpenCV findCirclesGrid",
            "squares, microlib": "squares, microlib",
            "findChessboardCornersSB": "squares, OpenCV findChessboardCornersSB",
        },
        "RMS error of a detected point (px)",
    ),
    "tracking": Chart(
        "tracking",
        "Convergence",
        "{warp}, {corner displacement (px)} px",
        {"ESM": "ESM (microlib)", "ECC, filter 5": "ECC (OpenCV)", "pyramidal LK": "pyramidal LK"},
        "trials in which all corners are found to 1 px (%)",
        rows={"motion": "translation"},
        pivot="method",
        values="success (%)",
        log=False,
    ),
    "servoing": Chart(
        "servoing",
        "Innovation gain",
        "gain {innovation gain}",
        {
            "circle, 1X": "circle, 1X",
            "square, 1X": "square, 1X",
            "sinusoid, 1X": "sinusoid, 1X",
            "circle, 4X": "circle, 4X",
            "square, 4X": "square, 4X",
            "sinusoid, 4X": "sinusoid, 4X",
        },
        "mean error along the path (µm)",
    ),
    "focus": Chart(
        "focus",
        "RMS depth error, steps between frames",
        "{scene}",
        {
            "microlib": "microlib, default",
            "SML 9×9": "measure of the thesis (SML 9×9)",
            "best other": "best other method",
        },
        "RMS height error (focus steps)",
    ),
    "embryo": Chart(
        "capsule_embryo",
        "Modulus of rendered capsules, by probe",
        "{probe}",
        {
            "bias of E (%)": "mean error",
            "spread of E (%)": "standard deviation",
            "worst (%)": "largest error",
        },
        "error of the modulus (%)",
        log=False,
    ),
}


def rows_of(chart: Chart) -> pd.DataFrame:
    """Return the numbers of a chart: a row for each line, a column for each symbol."""
    record = json.loads((RESULTS / f"{chart.result}.json").read_text(encoding="utf-8"))
    content = record["tables"][chart.table]
    found = pd.DataFrame(content["data"], columns=content["columns"])
    for column, value in chart.rows.items():
        found = found[found[column] == value]
    names = [chart.label.format(**row) for row in found.to_dict("records")]
    if chart.pivot:
        found = found.assign(name=names).pivot(
            index="name", columns=chart.pivot, values=chart.values
        )
        found = found.loc[list(dict.fromkeys(names))]
    else:
        found.index = pd.Index(names)
    shown = found[list(chart.columns)].rename(columns=chart.columns)
    return shown.apply(pd.to_numeric, errors="coerce")  # a text says that nothing was found


def draw(chart: Chart) -> Figure:
    use_style()
    found = rows_of(chart)
    figure = Figure(figsize=(5.2, 1.8 + 0.34 * len(found) + 0.22 * len(found.columns)))
    axes = figure.subplots()
    places = range(len(found), 0, -1)
    colors = [COLORS[name] for name in ("blue", "orange", "green", "pink", "grey", "yellow")]
    for name, color, marker in zip(found, colors, MARKERS, strict=False):
        axes.plot(
            found[name].to_numpy(), list(places), marker, color=color, label=name, markersize=7
        )
    axes.set(yticks=list(places), xlabel=chart.quantity)
    axes.set_yticklabels(list(found.index))
    if chart.log:
        axes.set_xscale("log")
        few_decades = np.nanmax(found) < 20 * np.nanmin(found)  # the labels have room
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if few_decades else (1,)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=1)
    return figure


class BenchmarkChart(SphinxDirective):
    """A chart with its caption, which is the content of the directive."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        chart = CHARTS[name]
        folder = Path(self.env.app.outdir) / "_images"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"benchmark_{name}.svg").write_text(to_svg(draw(chart)), encoding="utf-8")
        numbers = rows_of(chart)
        alt = f"Dot plot of {chart.quantity} for {len(numbers)} cases and "
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
                kind = "agrees" if holds == "yes" else "disagrees"
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
        known = ("processor", "cores", "date", "commit")
        versions = [f"{name} {version}" for name, version in machine.items() if name not in known]
        result += line(
            f"Measured on {machine['date']} at commit {machine['commit']}, on a machine with the "
            f"processor {machine['processor']} and {machine['cores']} cores. The versions were "
            f"{', '.join(versions)}."
        )
        result += line(changes_since(name, machine["commit"].split()[0]))
        if record["note"]:
            self.state.nested_parse(StringList(record["note"].split("\n")), 0, result)
        for title, content in record["tables"].items():
            rows = [[show(value) for value in row] for row in content["data"]]
            whole = table([str(column) for column in content["columns"]], rows)
            summary = f"<details><summary>Table: {title} ({len(rows)} rows)</summary>"
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
        return "The measured code has not changed since."
    times = "1 commit" if count == "1" else f"{count} commits"
    known = f"has changed in {times} since" if count else "may have changed since"
    return f"The measured code {known}, so a new run may give different numbers."


def setup(app: Sphinx) -> None:
    app.add_directive("benchmarks", Benchmarks)
    app.add_directive("benchmark-chart", BenchmarkChart)
