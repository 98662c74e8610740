"""Who may import whom, and that what is public is documented."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest

import microlib

PACKAGE = Path(microlib.__file__).parent
MODULES = sorted(
    str(path.relative_to(PACKAGE).with_suffix("")).replace("/", ".").removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if path != PACKAGE / "__init__.py"
)
GROUND_FLOOR = {"optics", "microscope", "membrane"}
FOR_NOTEBOOKS = {"ledger", "figures"}


def imports(module: str) -> set[str]:
    """Return the modules of ours that a module imports, by their first name."""
    path = PACKAGE / (module.replace(".", "/") + ".py")
    if not path.exists():
        path = PACKAGE / module.replace(".", "/") / "__init__.py"
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("microlib"):
            rest = (node.module or "").split(".")[1:]
            found |= {rest[0]} if rest else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("microlib.")}
    return found - {"_checks"}


@pytest.mark.parametrize("module", MODULES)
def test_imports_follow_the_arrows(module: str) -> None:
    first = module.split(".")[0]
    found = imports(module) - {first}
    if first in GROUND_FLOOR or first == "_checks":
        assert not found, f"{module} is on the ground floor and imports {found}"
    elif first == "synthetic":
        assert found <= GROUND_FLOOR, f"{module} may import the ground floor only, not {found}"
    elif first not in FOR_NOTEBOOKS:
        banned = found & (FOR_NOTEBOOKS | {"synthetic"})
        assert not banned, f"{module} is an algorithm and must not know {banned}"


def test_imports_have_no_circle() -> None:
    graph = {m: {n for n in imports(m) if n in MODULES} - {m} for m in MODULES if "." not in m}
    while leaves := {m for m, needs in graph.items() if not needs & graph.keys()}:
        for leaf in leaves:
            del graph[leaf]
    assert not graph, f"these import each other: {sorted(graph)}"


def listed_modules() -> list[str]:
    """Return the public modules: those that the book's page of the library names."""
    api = (PACKAGE.parent / "book" / "api.md").read_text(encoding="utf-8")
    return re.findall(r"^   (microlib\.[\w.]+)$", api, flags=re.M)


def public_objects() -> list[tuple[str, object]]:
    objects = []
    for module_name in listed_modules():
        module = importlib.import_module(module_name)
        for name in module.__all__:
            value = getattr(module, name)
            if callable(value) and value.__module__ == module_name:
                objects.append((f"{module_name}.{name}", value))
    return objects


@pytest.mark.parametrize(
    ("name", "value"), public_objects(), ids=lambda v: v if isinstance(v, str) else ""
)
def test_public_names_are_documented(name: str, value: object) -> None:
    doc = inspect.getdoc(value) or ""
    assert doc, f"{name} has no docstring"
    is_exception = inspect.isclass(value) and issubclass(value, BaseException)
    if is_exception or ".figures" in name:
        return
    if inspect.isclass(value):
        wanted = ["Attributes", "Parameters", "Notes"]
    elif getattr(value, "__annotations__", {}).get("return") in (None, "None"):
        wanted = ["Parameters"]
    else:
        wanted = ["Returns", "Yields"]
    assert any(f"{heading}\n---" in doc for heading in wanted), (
        f"{name} lacks {' or '.join(wanted)}"
    )


def test_a_public_name_leads_to_a_public_module() -> None:
    """What a listed module re-exports is documented too: its own module is listed."""
    listed = set(listed_modules())
    for module_name in listed:
        module = importlib.import_module(module_name)
        for name in module.__all__:
            origin = getattr(getattr(module, name), "__module__", module_name)
            if origin.startswith("microlib.") and origin not in listed:
                pytest.fail(f"{module_name}.{name} comes from {origin}, which is not listed")
