"""The directive ``{exercise-list}``: all exercises of the notebooks, with the time each takes.

An exercise is a directive ``{exercise} KIND: what it asks, N minutes`` with the options ``label``
and ``nonumber``, in this order, which sphinx-exercise renders.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

from book_tables import link, table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from compendium import ROOT

FORM = re.compile(
    r"\{exercise(?:-start)?\} (On paper|Predict|Write): (.+), (\d+) minutes\n"
    r":label: (\S+)\n:nonumber:$",
    re.M,
)


@dataclass(frozen=True)
class Exercise:
    """One exercise of a notebook."""

    kind: str
    title: str
    minutes: int
    label: str


def read_exercises(notebook: Path) -> list[Exercise]:
    """Return the exercises of a notebook in their order."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return [Exercise(k, title, int(n), label) for k, title, n, label in FORM.findall(text)]


class ExerciseList(SphinxDirective):
    """A table of all exercises, in the order of the notebooks."""

    def run(self) -> list[nodes.Node]:
        rows = []
        for path in sorted((ROOT / "notebooks").glob("[0-9]*.ipynb")):
            page = f"notebooks/{path.stem}"
            if not (found := read_exercises(path)):
                continue
            chapter = f"Chapter {int(path.stem[:2])}"
            total = str(sum(one.minutes for one in found))
            rows.append([nodes.strong(chapter, chapter), "", nodes.strong(total, total)])
            for one in found:
                title = nodes.Text(f"{one.title[0].upper()}{one.title[1:]}")
                rows.append([one.kind, link(self.env, title, page, one.label), str(one.minutes)])
        return [table(["Kind", "Exercise", "Minutes"], rows)]


def replace_sections(app: Sphinx, doctree: nodes.document) -> None:
    """Put the content of each exercise and solution in a container.

    The package makes sections of it, which have no title and all have the same id.
    """
    for part in list(doctree.findall(nodes.section)):
        if part["ids"] in (["exercise-content"], ["solution-content"]):
            part.replace_self(nodes.container("", *part.children))


def setup(app: Sphinx) -> None:
    app.connect("doctree-read", replace_sections, priority=100)  # before sections are named
    app.add_directive("exercise-list", ExerciseList)
