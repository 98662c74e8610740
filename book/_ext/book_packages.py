"""The directive ``{packages}``: the packages of `microlib` with what each imports.

Sphinx draws inheritance, and none of its extensions imports.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from book_tables import IMPORT, link, table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import microlib


def imported(path: Path) -> set[str]:
    """Return the names in `microlib` that a package, or a module beside it, imports from."""
    files = path.rglob("*.py") if path.is_dir() else [path.with_suffix(".py")]
    return {name for file in files for name in IMPORT.findall(file.read_text(encoding="utf-8"))}


class Packages(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        folder = Path(microlib.__file__).parent
        modules = [module.name for module in iter_modules([str(folder)]) if module.name[1] != "_"]
        rows = []
        for name in modules:
            what = import_module(f"microlib.{name}").__doc__ or ""
            label: nodes.Node = nodes.literal("", name)
            if not name.startswith("_"):
                label = link(self.env, label, "api", f"microlib-{name}")
            others = imported(folder / name) & {*modules} - {name, "_common"}
            rows.append(
                [label, what.partition("\n")[0].replace("``", ""), ", ".join(sorted(others)) or "–"]
            )
        return [table(["Package", "What it is for", "Imports, besides _common"], rows)]


def setup(app: Sphinx) -> None:
    app.add_directive("packages", Packages)
