"""The directive ``{rooms}``: the packages of `microlib` and what they import, read from the code.

Sphinx draws inheritance, and none of its extensions imports.
"""

from __future__ import annotations

import ast
from pathlib import Path

from book_tables import link, table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]


def imported(path: Path) -> set[tuple[str, ...]]:
    """Return the first two parts of the names that a file or a folder's files import."""
    found = set()
    for file in [path] if path.is_file() else path.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            else:
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            found |= {tuple(name.split(".")[:2]) for name in names}
    return found


class Rooms(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        files = sorted((ROOT / "microlib").iterdir())
        paths = {path.stem: path for path in files if path.suffix in ("", ".py")}
        rows = []
        for name, path in paths.items():
            if name.startswith("__"):
                continue
            others = {part[1] for part in imported(path) if part[0] == "microlib" and part[1:]}
            file = path / "__init__.py" if path.is_dir() else path
            said = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
            label: nodes.Node = nodes.literal("", name)
            if not name.startswith("_"):
                label = link(self.env, label, "api", f"microlib-{name}")
            imports = ", ".join(sorted(others & paths.keys() - {name, "_common"})) or "–"
            rows.append([label, said.partition("\n")[0].replace("``", ""), imports])
        return [table(["Package", "What it is for", "Imports, besides _common"], rows)]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("rooms", Rooms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
