"""Who may import whom, what is public, and that what is public is documented in one place."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
import tokenize
import typing
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pandas as pd
import pytest

import microlib
from microlib._common import Result

PACKAGE = Path(microlib.__file__).parent
ROOT = PACKAGE.parent
ROOMS = sorted(
    path.stem if path.is_file() else path.name
    for path in PACKAGE.iterdir()
    if not path.name.startswith("_") and (path.suffix == ".py" or (path / "__init__.py").exists())
)
# Which subjects a subject may import; `_common` and `estimate` are free to all.
ARROWS = {
    "__main__": {"_command"},
    "_command": {"_plots", "calibration", "embryo", "focus", "io", "membrane", "tracking"},
    "calibration": {"_plots", "microscope"},
    "embryo": {"_plots", "membrane"},
    "focus": {"_plots", "io"},
    "synthetic": {"microscope", "optics", "membrane"},
    "tracking": {"_plots"},
}
#: Functions and classes that people call; the classes of results come with them. Whoever needs
#: another name takes one away.
MOST_PUBLIC_NAMES = 96


#: What people call, and the classes of results that come with it, by its room and name.
PUBLIC = {
    f"{room}.{name}": getattr(importlib.import_module(f"microlib.{room}"), name)
    for room in ROOMS
    for name in importlib.import_module(f"microlib.{room}").__all__
}


def sources(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.py") if "__pycache__" not in path.parts)


def imported(path: Path) -> set[str]:
    """Return the dotted names that a file imports: the module's, and module.name for each name."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", sources(PACKAGE), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_packages_import_only_allowed_packages(path):
    room = room_of(path)
    for name in imported(path):
        first, *rest = name.split(".")
        assert first not in ("compendium", "benchmarks", "tests", "plotly"), name
        assert room == "_plots" or first not in ("matplotlib", "mpl_toolkits"), name
        if first != "microlib" or not rest or rest[0] == room:
            continue
        other = rest[0]
        assert other in ("_common", "estimate") or other in ARROWS.get(room, set()), (
            f"{room} imports {other}"
        )
        inner = rest[1:-1] if other != "_common" else []
        assert not inner, f"{room} reaches into {other}: {name}"


#: Packages with what goes beyond the thesis' own method: the file of the core that uses each, and
#: the package that it shares with the core.
EXTENSIONS = {
    "calibration/adequacy": ("_calibrate.py", ""),
    "focus/multiscale": ("_depth.py", "common"),
    "membrane/large": ("__init__.py", ""),
}


@pytest.mark.parametrize("package", EXTENSIONS)
def test_a_core_uses_its_extension_in_one_place_which_uses_no_core(package):
    room, _, extension = package.partition("/")
    face, shared = EXTENSIONS[package]

    def used(path: Path) -> set[str]:
        """Return the parts of the room that a file imports."""
        names = (name.partition(f"microlib.{room}.") for name in imported(path))
        return {rest.split(".")[0] for before, _, rest in names if rest and not before}

    assert {p.name for p in (PACKAGE / room).glob("*.py") if extension in used(p)} == {face}
    if shared:
        assert set().union(*map(used, sources(PACKAGE / package))) <= {extension, shared}
        assert set().union(*map(used, sources(PACKAGE / room / shared))) <= {shared}


#: Imports of private modules by tests and benchmarks; each is to go where a public name shows the
#: same. Whoever needs another one takes one away.
MOST_PRIVATE_IMPORTS = 15


def private_imports(*folders: str) -> list[str]:
    """Return each file in folders with a private module of the library that it imports.

    But for `_common`, which writes files and shows results for the compendium as well.
    """
    private = re.compile(r"microlib\.(?!_common\b|__main__).*\b_\w")
    found = {
        f"{path.relative_to(ROOT)} imports {name.rpartition('.')[0]}"
        for folder in folders
        for path in sources(ROOT / folder)
        for name in imported(path)
        if private.match(name)
    }
    return sorted(found)


def test_few_private_modules_are_imported():
    assert not private_imports("compendium")
    assert len(found := private_imports("tests", "benchmarks")) <= MOST_PRIVATE_IMPORTS, found


def test_imports_have_no_cycle():
    TopologicalSorter(ARROWS).prepare()  # which names a circle


def is_result(value: object) -> bool:
    return inspect.isclass(value) and issubclass(value, Result)


def test_public_names_are_few_and_listed_once():
    listed = {name.split(".")[1]: name.split(".")[0] for name in PUBLIC}
    assert len(listed) == len(PUBLIC), "a name stands in two rooms"
    assert not [name for name in listed if name.startswith("_")]
    called = [name for name, value in PUBLIC.items() if not is_result(value)]
    assert len(called) <= MOST_PUBLIC_NAMES, len(called)
    text = (ROOT / "book" / "api.md").read_text(encoding="utf-8")
    shown: dict[str, str] = {}
    for part in text.split(".. currentmodule:: microlib.")[1:]:
        room, _, rest = part.partition("\n")
        shown |= dict.fromkeys(re.findall(r"^   (\w+)$", rest.split("```")[0], flags=re.M), room)
    assert shown == listed


def test_files_of_a_package_are_private():
    for path in sources(PACKAGE):
        inside = path.relative_to(PACKAGE).parts
        if len(inside) > 1 and path.name != "__init__.py":
            assert path.name.startswith("_"), path


@pytest.mark.parametrize("name", [n for n, value in PUBLIC.items() if callable(value)])
def test_public_names_are_documented_and_tested_in_their_room(name):
    value, (room, own) = PUBLIC[name], name.split(".")
    tests = [*(ROOT / "tests").glob(f"{room}/test_*.py"), *(ROOT / "tests").glob(f"test_{room}.py")]
    tests.append(ROOT / "tests" / "test_plots.py")
    used = any(re.search(rf"\b{own}\b", path.read_text(encoding="utf-8")) for path in tests)
    assert used or is_result(value), f"{name} is in no test of its room"
    doc = inspect.getdoc(value) or ""
    assert doc, f"{name} has no docstring"
    assert not re.search(r"^ *--+ +\S", doc, flags=re.M), f"{name}: text behind an underline"
    assert value.__module__.startswith(f"microlib.{name.split('.')[0]}")
    if inspect.isclass(value):
        wanted = ["Attributes", "Parameters", "Notes"]
    elif getattr(value, "__annotations__", {}).get("return") in (None, "None"):
        wanted = ["Parameters"]
    else:
        wanted = ["Returns", "Yields"]
    assert any(f"{heading}\n---" in doc for heading in wanted), (
        f"{name} lacks {' or '.join(wanted)}"
    )


def test_import_loads_only_dependencies_of_the_library():
    """And of these not what takes long: it waits for the function that needs it."""
    names = ", ".join(["microlib", *(f"microlib.{room}" for room in ROOMS)])
    code = f"import sys; own = {{*sys.modules}}; import {names}; print(*{{*sys.modules}} - own)"
    run = [sys.executable, "-c", code]
    loaded = subprocess.run(run, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    modules = {name.partition(".")[0] for name in loaded.split()}
    owners = packages_distributions()
    found = {owner.lower() for name in modules for owner in owners.get(name, ())}
    needed = [line for line in requires("microlib-thesis") or [] if "extra ==" not in line]
    own = {"microlib-thesis", "opencv-python-headless", *(re.split("[<>=]", n)[0] for n in needed)}
    # NumPy and tifffile import these where they are installed.
    own |= {"charset-normalizer", "imagecodecs"}
    assert found <= own, found - own
    late = {"matplotlib", "pandas", "scipy.stats", "skimage"}
    assert not {*modules, *loaded.split()} & {"compendium", "benchmarks", *late}


@pytest.mark.parametrize("path", sources(PACKAGE), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_results_are_frozen(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        for decorator in getattr(node, "decorator_list", []):
            if "dataclass" in ast.unparse(decorator):
                assert "frozen=True" in ast.unparse(decorator), f"{path.name}: {node.name}"


def test_a_page_names_only_functions_that_exist():
    """Whoever follows a page must find what it names in code marks, in the code or in a package."""
    code = {"microlib", "compendium", "benchmarks", "tests", "book", "data"}
    known = set()
    for path in (path for folder in code for path in sources(ROOT / folder)):
        with path.open("rb") as file:
            tokens = tokenize.tokenize(file.readline)
            known |= {token.string for token in tokens if token.type == tokenize.NAME}
    known |= {"detect_name"}  # which stands for a new one
    known |= {p.name.removesuffix(".py") for f in code for p in (ROOT / f).rglob("*")}
    for page in sorted((ROOT / "book").glob("*.md")):
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        # A name with an underscore or with arguments, alone or behind dots; no word and no file.
        marked = re.findall(r"(?<!\})`([A-Za-z_][\w.]*)(\([^`]*\))?`", text)
        named = {n.split(".")[-1]: n for n, call in marked if "_" in n or (call and len(n) > 1)}
        files = {"py", "md", "toml", "json", "ipynb", "npz", "txt", "csv"}
        wrong = sorted(n for last, n in named.items() if last not in known | files)
        assert not wrong, f"{page.name} names what is not there: {wrong}"


def classes_in(annotation: object) -> set[type]:
    """Return the classes of microlib that an annotation names, such as ``list[Track] | None``."""
    inner = set().union(*map(classes_in, typing.get_args(annotation)))
    own = inspect.isclass(annotation) and annotation.__module__.startswith("microlib")
    return inner | {annotation} if own else inner


@pytest.mark.parametrize("name", [n for n, value in PUBLIC.items() if callable(value)])
def test_classes_that_public_functions_return_are_public(name):
    value = PUBLIC[name]
    methods = [own for own in vars(value).values() if inspect.isfunction(own)]
    for function in methods if inspect.isclass(value) else [value]:
        if function.__name__.startswith("_") and function.__name__ != "__call__":
            continue
        returned = classes_in(typing.get_type_hints(function, localns={"pd": pd}).get("return"))
        for found in returned - {Path}:
            room = importlib.import_module(".".join(found.__module__.split(".")[:2]))
            assert found.__name__ in room.__all__, f"{name} returns {found.__name__}"
