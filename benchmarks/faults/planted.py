"""Plant one fault at a time in the code and count those that its tests notice.

``python -m benchmarks.faults.planted focus --faults 20 --seed 3`` draws faults of eight kinds from
one package, the same number of each kind as far as there are so many, and runs that package's tests
and the examples of the module in a copy of the project. Without a package it goes through all.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parents[2]
#: The order of whose arguments makes no difference.
SYMMETRIC = {"hypot", "minimum", "maximum", "isclose", "allclose", "min", "max", "isinstance"}
SIGNS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
TURNED = {ast.Lt: ">", ast.LtE: ">", ast.Gt: "<", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
NOT_COPIED = (".*", "__pycache__", "build", "*.egg-info")
Fault = tuple[str, int, int, str]  # kind, begin and end in bytes, and what stands there instead


def replacements(node: ast.AST, text: dict[ast.AST, str]) -> Iterator[tuple[str, ast.AST, str]]:
    """Yield the faults of one node: a kind, the part that is replaced, and by what."""
    if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] not in SYMMETRIC:
        for k, (one, other) in enumerate(pairwise(node.args)):
            if not {ast.Starred} & {type(one), type(other)} and text[one] != text[other]:
                swapped = copy.copy(node)
                swapped.args = [*node.args[:k], other, one, *node.args[k + 2 :]]
                yield "arguments exchanged", node, ast.unparse(swapped)
    if isinstance(node, ast.keyword) and node.arg == "axis" and text[node.value] in ("0", "1"):
        yield "axes exchanged", node.value, "1" if text[node.value] == "0" else "0"
    pair = node.slice if isinstance(node, ast.Subscript) else None
    if isinstance(pair, ast.Tuple) and len(pair.elts) == 2:
        yield "axes exchanged", pair, ", ".join(text[e] for e in pair.elts[::-1])
    if isinstance(node, ast.BinOp) and type(node.op) in SIGNS and not is_text(node):
        left, right = text[node.left], text[node.right]
        yield "sign or operator", node, f"({left} {SIGNS[type(node.op)]} {right})"
        yield "term dropped", node, f"({left})"
        if isinstance(node.op, ast.Mult | ast.Div):
            yield "wrong unit", node, f"({text[node]} * 1000)"
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in TURNED:
        left, right = text[node.left], text[node.comparators[0]]
        yield "comparison turned", node, f"({left} {TURNED[type(node.ops[0])]} {right})"
    if isinstance(node, ast.Raise):
        yield "check removed", node, "pass"
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield "another number", node, repr(1.5 * node.value or 1)
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("sqrt"):
        yield "root dropped", node, f"({text[node.args[0]]})"


def is_text(node: ast.BinOp) -> bool:
    parts = (node.left, node.right)
    return any(
        isinstance(p, ast.JoinedStr) or isinstance(getattr(p, "value", 0), str) for p in parts
    )


def faults_of(source: str) -> list[Fault]:
    """Return every fault that can be planted in a module, in the order of its text."""
    raw = source.encode()
    starts = [0]
    for line in raw.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    tree = ast.parse(source)
    spans, text = {}, {}
    idle: set[ast.AST] = set()
    for node in ast.walk(tree):
        if hasattr(node, "end_lineno") and node.end_lineno:
            begin = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
            end = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
            spans[node], text[node] = (begin, end), raw[begin:end].decode()
        for part in ("annotation", "returns"):  # never evaluated
            if found := getattr(node, part, None):
                idle |= set(ast.walk(found))
        if isinstance(node, ast.JoinedStr):  # its parts have no places of their own before 3.12
            idle |= set(ast.walk(node))
    return sorted(
        (kind, *spans[part], new)
        for node in ast.walk(tree)
        if node not in idle
        for kind, part, new in replacements(node, text)
    )


def package_of(path: Path) -> str:
    top, *inner = path.relative_to(ROOT).with_suffix("").parts
    return inner[0] if top == "microlib" and inner[0] != "__init__" else top


def sample(modules: list[Path], count: int, seed: str) -> list[tuple[Path, Fault]]:
    """Draw faults, each kind in its turn, from any of the modules."""
    draw = Random(seed)
    by_kind: dict[str, list[tuple[Path, Fault]]] = {}
    for path in modules:
        for fault in faults_of(path.read_text(encoding="utf-8")):
            by_kind.setdefault(fault[0], []).append((path, fault))
    waiting = [draw.sample(found, len(found)) for _, found in sorted(by_kind.items())]
    chosen: list[tuple[Path, Fault]] = []
    while len(chosen) < count and any(waiting):
        chosen += [found.pop() for found in draw.sample(waiting, len(waiting)) if found]
    return chosen[:count]


def tests_of(package: str, module: Path) -> list[str]:
    """Return what judges a module: its examples, and the tests of its package."""
    examples = str(module.relative_to(ROOT))
    folder = ROOT / "tests" / package
    own = folder if folder.exists() else folder.with_name(f"test_{package}.py")
    through_all = ["tests/test_refusals.py", "tests/test_disturbed.py"]
    shared = [name for name in through_all if package != "compendium" and (ROOT / name).exists()]
    return [examples, *([str(own.relative_to(ROOT))] if own.exists() else []), *shared]


def passes(folder: Path, tests: list[str], limit: float) -> bool:
    command = [sys.executable, "-m", "pytest", "-xq", "-p", "no:cacheprovider", "-p", "no:xdist"]
    where = {"PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    where |= {"PYTHONDONTWRITEBYTECODE": "1"}
    try:
        run = subprocess.run(
            [*command, *tests], cwd=folder, env=os.environ | where, capture_output=True,
            timeout=limit, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False  # a loop without end is noticed, too
    return run.returncode in (0, 5)  # 5: a module without tests or examples


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="*", help="such as focus; all of them without any")
    parser.add_argument("--faults", type=int, default=20, help="in each package")
    parser.add_argument("--seed", default="0", help="of the sample")
    parser.add_argument("--limit", type=float, default=600.0, help="s, for the tests of one fault")
    options = parser.parse_args()
    packages: dict[str, list[Path]] = {}
    for path in sorted([*ROOT.glob("microlib/**/*.py"), *ROOT.glob("compendium/**/*.py")]):
        packages.setdefault(package_of(path), []).append(path)
    caught = planted = 0
    with tempfile.TemporaryDirectory() as name:
        tree = Path(name) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*NOT_COPIED))
        for package in options.packages or packages:
            for module, (kind, begin, end, new) in sample(
                packages[package], options.faults, options.seed + package
            ):
                path = tree / module.relative_to(ROOT)
                sound = path.read_bytes()
                path.write_bytes(sound[:begin] + new.encode() + sound[end:])
                noticed = not passes(tree, tests_of(package, module), options.limit)
                path.write_bytes(sound)
                caught, planted = caught + noticed, planted + 1
                place = f"{module.relative_to(ROOT)}:{len(sound[:begin].splitlines())}"
                old = sound[begin:end].decode()
                print(
                    f"{'caught' if noticed else 'MISSED'} {place} {kind}: {old} → {new}", flush=True
                )
    print(f"{caught} of {planted} faults caught")
    return 0


if __name__ == "__main__":
    sys.exit(main())
