"""The notebooks read as articles, recorded what the book says, and fail when they should."""

import ast
import re
import shutil
from pathlib import Path

import nbformat
import pandas as pd
import pytest

from compendium import ledger, run

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9]*.ipynb"))
GUIDES = [path for path in NOTEBOOKS if path.stem.startswith("07_guide_")]
#: What has no unit, as an axis names it.
PURE = {
    "grey value", "step", "frame", "loop gain g", "recomputed / printed", "focus measure F",
    "focus measure / its maximum", "depth of the dimple / its radius",
}  # fmt: skip
CHAPTER_5 = ROOT / "notebooks" / "05_experimental_results.ipynb"
#: Words of every drawing, which mean the figure or the panels at hand; chapter 5 needs none.
DRAWING = {"fig", "ax", "axes", "color", "title"}


def code(path: Path) -> list[nbformat.NotebookNode]:
    return [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]


def bound(source: str) -> list[str]:
    """Return the names that a cell's own lines bind, as often as they do."""
    found = []
    todo: list[ast.AST] = [*ast.parse(source).body]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.append(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found += [(a.asname or a.name).split(".")[0] for a in node.names]
        elif not isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id != "_":
                found.append(node.id)
            todo += ast.iter_child_nodes(node)
    return found


@pytest.mark.parametrize("path", NOTEBOOKS[:6], ids=lambda path: path.stem)
def test_notebook_binds_each_name_once(path: Path) -> None:
    """No name is bound twice, in one cell or in two, but those of a drawing."""
    allowed = set() if path.stem.startswith("05") else DRAWING
    every = [name for cell in code(path) for name in bound(cell.source)]
    twice = sorted({name for name in every if every.count(name) > 1} - allowed)
    assert not twice, twice


@pytest.mark.parametrize("path", GUIDES, ids=lambda path: path.stem)
def test_parameters_of_guide_have_comments_and_keep_their_values(path: Path) -> None:
    first, *others = (cell.source.replace("%xmode Minimal", "") for cell in code(path))
    assert all("  # " in line for line in first.splitlines())
    assert not set(bound(first)) & {name for source in others for name in bound(source)}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_follows_layout_rules(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    number = int(path.stem[:2])
    title = next(line for line in notebook.cells[0].source.splitlines() if line.startswith("# "))
    assert number > 6 or title.startswith(f"# {number} "), title
    cells = code(path)
    (first,) = (c for c in cells if "parameters" in c.metadata.get("tags", []))
    assert "record" in first.source
    lines = {cell.id: len(cell.source.splitlines()) for cell in cells}
    assert max(lines.values()) <= 25, lines
    # The code of an exercise is read apart from the chapter.
    chapter = {id: count for id, count in lines.items() if not id.startswith("ch5-ex")}
    assert path != CHAPTER_5 or sum(chapter.values()) <= 540
    for cell in cells:
        assert not cell.outputs, f"{cell.id} has outputs; run `make format`"
        figure = cell.metadata.get("mystnb", {})
        if "figure" in figure:
            assert figure["figure"]["caption"], cell.id
            assert len(figure["image"]["alt"]) > 20, cell.id
        elif "plt.show()" in cell.source:
            pytest.fail(f"{cell.id} draws a figure without a caption")
    # A number with three or more decimals in running text is a result and belongs to a role.
    for cell in (one for one in notebook.cells if one.cell_type == "markdown"):
        prose = re.sub(r"\$\$.*?\$\$|\$.*?\$|`.*?`", "", cell.source, flags=re.S)
        assert not re.search(r"(?<![\w.])\d+\.\d{3,}", prose), f"{cell.id}: {prose}"


def test_no_page_links_a_figure_that_needs_the_microscope_engine() -> None:
    """Without ``make extras`` the figure is not drawn, and a link to it would stop the book."""
    cells = code(ROOT / "notebooks" / "08_live_microscope.ipynb")
    figures = (cell.metadata.get("mystnb", {}).get("figure") for cell in cells)
    names = [figure["name"] for figure in figures if figure]
    pages = [*NOTEBOOKS, *(ROOT / "book").glob("*.md")]
    assert names
    assert not [p.name for p in pages for n in names if f"(#{n})" in p.read_text("utf-8")]


def test_compared_claims_are_recorded_with_their_verdict(claims_folder: Path) -> None:
    records = ledger.read_records(claims_folder)
    for claim in ledger.claims().values():
        if not claim.compared:
            assert claim.id not in records, f"{claim.id} is recorded but not compared"
        else:
            assert claim.id in records, f"{claim.id} is {claim.label} but no notebook records it"
            found = records[claim.id]
            assert found.verdict == claim.label
            assert claim.objection(found.value, found.low, found.high) == ""
    for setting in ledger.settings().values():
        recovered = setting.id.startswith("table-5.1") and not setting.id.endswith("/d")
        assert (setting.id in records) == recovered, setting.id


def test_notebooks_have_no_warnings_and_axes_have_units(claims_folder: Path) -> None:
    """Drawings of the apparatus name no axis."""
    for path in (claims_folder.parent / "notebooks").glob("*.ipynb"):
        outputs = [o for c in nbformat.read(path, as_version=4).cells for o in c.get("outputs", [])]
        assert not [one.text for one in outputs if one.get("name") == "stderr"], path.name
    tables = [pd.read_csv(path) for path in (claims_folder.parent / "figures").glob("*.csv")]
    names = {name for one in tables for axis in "xy" for name in one[f"{axis}_label"].dropna()}
    wrong = {name for name in names if not re.search(r"\(.+\)", name) and name not in PURE}
    assert len(names) > 40
    assert not wrong, f"without a unit: {wrong}"


def excerpt(folder: Path) -> Path:
    """Copy what chapter 5 needs into `folder`, cut to what uses printed data alone."""
    for name in ("microlib", "compendium", "data"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    notebook = nbformat.read(CHAPTER_5, as_version=4)
    notebook.cells = [cell for cell in notebook.cells if re.fullmatch(r"ch5-\d\d[bct]?", cell.id)]
    path = folder / "05_excerpt.ipynb"
    nbformat.write(notebook, path)
    return path


def test_wrong_constant_fails_notebook_and_names_claim(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = excerpt(tmp_path)
    source = tmp_path / "microlib" / "membrane" / "_point_load.py"
    right, wrong = "numerator = 2 * np.pi *", "numerator = 2.001 * np.pi *"
    assert right in source.read_text()
    source.write_text(source.read_text().replace(right, wrong))
    # The kernel starts in the copy, whose microlib comes before the installed one.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    message, passed = run.execute(
        path, tmp_path / "done.ipynb", {}, tmp_path, log=tmp_path / "log.txt"
    )
    assert not passed
    assert "claim table-5.6/E, Elastic modulus (Table 5.6): printed 1.3237 MPa" in message
