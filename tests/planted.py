"""Faults that people make in numerical code, to be planted by ``tests/mutants.py``.

Each kind finds its places in a module's syntax tree and says what to write there. cosmic-ray's own
operators put another number or sign in one place; these exchange, drop and forget.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

#: Calls for which the order of the arguments makes no difference, or which fail at once.
SYMMETRIC = (
    *("hypot", "minimum", "maximum", "add", "multiply", "isclose", "allclose", "logical_and"),
    *("logical_or", "min", "max", "isinstance", "getattr", "issubclass", "gcd"),
)
#: Arguments of a drawing that only say how it looks.
LOOKS = {
    *("alpha", "bbox_to_anchor", "dpi", "figsize", "fontsize", "lw", "linewidth", "linewidths"),
    *(
        "loc",
        "markerscale",
        "mec",
        "mew",
        "mfc",
        "ms",
        "ncols",
        "shrink",
        "shrinkA",
        "shrinkB",
        "size",
        "zorder",
    ),
    *("width_ratios", "elev", "azim"),
}


class Edit(NamedTuple):
    """A stretch of a source, from and to in bytes, and what to write in its place."""

    begin: int
    end: int
    text: str


class Source:
    """A module's text with the places of its syntax tree."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._bytes = text.encode()
        lengths = [len(line) for line in self._bytes.splitlines(keepends=True)]
        self._starts = [sum(lengths[:k]) for k in range(len(lengths))]
        tree = ast.parse(text)
        idle = {
            id(inner) for node in ast.walk(tree) for part in _idle(node) for inner in ast.walk(part)
        }
        self.nodes = [node for node in ast.walk(tree) if id(node) not in idle]
        #: Names that hold a list or a tuple somewhere in the module.
        self.lists = {ast.unparse(name) for node in ast.walk(tree) for name in _lists(node)}

    def span(self, node: ast.AST) -> tuple[int, int]:
        begin = self._starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        end = self._starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        return begin, end

    def of(self, node: ast.AST) -> str:
        begin, end = self.span(node)
        return self._bytes[begin:end].decode()

    def replace(self, node: ast.AST, text: str) -> Edit:
        return Edit(*self.span(node), text)

    def is_look(self, faulty: str) -> bool:
        """Tell whether another version differs in nothing but how a drawing looks."""
        pairs = enumerate(zip(self._bytes, faulty.encode(), strict=False))
        same = next((k for k, (old, new) in pairs if old != new), 0)
        spans = [
            self.span(node.value)
            for node in self.nodes
            if isinstance(node, ast.keyword) and node.arg in LOOKS
        ]
        return any(begin <= same < end for begin, end in spans)

    def swap(self, one: ast.AST, other: ast.AST) -> Edit:
        (begin, middle), (resume, end) = self.span(one), self.span(other)
        between = self._bytes[middle:resume].decode()
        return Edit(begin, end, self.of(other) + between + self.of(one))

    def apply(self, edit: Edit) -> str:
        whole = self._bytes[: edit.begin] + edit.text.encode() + self._bytes[edit.end :]
        return whole.decode()


def _idle(node: ast.AST) -> list[ast.AST]:
    """Return the parts of a node that are never evaluated, or whose order means nothing."""
    parts = [getattr(node, name, None) for name in ("annotation", "returns")]
    parts += getattr(node, "decorator_list", [])
    if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
        parts.append(node.value)
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("TypeVar", "cast"):
        parts.append(node)
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
        parts += node.comparators  # a set, in whatever order it is written
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("isinstance", "issubclass"):
        parts += node.args[1:]  # types, likewise
    if isinstance(node, ast.ExceptHandler):
        parts.append(node.type)
    if isinstance(node, ast.JoinedStr):  # whose parts have no places of their own before 3.12
        parts += node.values
    return [part for part in parts if part is not None]


def _lists(node: ast.AST) -> list[ast.expr]:
    """Return what an assignment, or the type of an argument, makes a list or a tuple."""
    kinds = ("list[", "tuple[")
    if isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation).startswith(kinds):
        return [node.target]
    if isinstance(node, ast.arg) and node.annotation is not None:
        return [ast.Name(node.arg)] * ast.unparse(node.annotation).startswith(kinds)
    if isinstance(node, ast.Assign) and isinstance(node.value, ast.List | ast.ListComp):
        return node.targets
    return []


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
    )


def swapped_arguments(source: Source, node: ast.AST) -> Iterator[Edit]:
    """``f(a, b)`` → ``f(b, a)``, and ``f(x=a, y=b)`` → ``f(x=b, y=a)``."""
    if not isinstance(node, ast.Call) or _name(node) in SYMMETRIC:
        return
    if any(isinstance(argument, ast.Starred) for argument in node.args):
        return
    named = [keyword.value for keyword in node.keywords if keyword.arg is not None]
    for values in (node.args, named):
        for one, other in pairwise(values):
            if source.of(one) != source.of(other):
                yield source.swap(one, other)


def swapped_axes(source: Source, node: ast.AST) -> Iterator[Edit]:
    """``[a, b]`` → ``[b, a]`` in an index or a pair, and ``axis=0`` ↔ ``axis=1``."""
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple):
        pair = node.slice.elts
    elif isinstance(node, ast.List | ast.Tuple) and isinstance(node.ctx, ast.Load):
        pair = node.elts
    else:
        pair = []
    plain = not any(_is_text(each) or isinstance(each, ast.Starred) for each in pair)
    if len(pair) == 2 and plain and source.of(pair[0]) != source.of(pair[1]):
        yield source.swap(*pair)
    if isinstance(node, ast.keyword) and node.arg == "axis":
        other = {"0": "1", "1": "0", "-1": "0"}.get(source.of(node.value))
        if other is not None:
            yield source.replace(node.value, other)


def dropped_terms(source: Source, node: ast.AST) -> Iterator[Edit]:
    """``a + b`` → ``a`` and ``b``, ``a - b`` → ``a``."""
    if not isinstance(node, ast.BinOp) or _is_text(node.left) or _is_text(node.right):
        return
    if isinstance(node.op, ast.Add | ast.Sub):
        yield source.replace(node, f"({source.of(node.left)})")
    if isinstance(node.op, ast.Add):
        yield source.replace(node, f"({source.of(node.right)})")


def wrong_defaults(source: Source, node: ast.AST) -> Iterator[Edit]:
    """A default of an argument or of a field of a class: the half more, or the contrary."""
    values: list[ast.expr | None] = []
    if isinstance(node, ast.arguments):
        values = [*node.defaults, *node.kw_defaults]
    elif isinstance(node, ast.ClassDef):
        values = [part.value for part in node.body if isinstance(part, ast.AnnAssign)]
    for value in values:
        if not isinstance(value, ast.Constant) or isinstance(value.value, str | type(None)):
            continue
        if isinstance(value.value, bool):
            yield source.replace(value, str(not value.value))
        elif isinstance(value.value, int):
            yield source.replace(value, str(value.value + max(1, value.value // 2)))
        elif isinstance(value.value, float):
            yield source.replace(value, repr(1.5 * value.value or 0.5))


def removed_checks(source: Source, node: ast.AST) -> Iterator[Edit]:
    """A ``raise`` that does nothing, an ``if`` that is never taken."""
    if isinstance(node, ast.Raise):
        yield source.replace(node, "pass")
    elif isinstance(node, ast.If) and ast.unparse(node.test) != "__name__ == '__main__'":
        yield source.replace(node.test, "False")


def removed_copies(source: Source, node: ast.AST) -> Iterator[Edit]:
    """``a.copy()`` → ``a``, ``np.array(a)`` → ``np.asarray(a)``.

    Not of a list or a tuple, which either copies.
    """
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return
    if node.func.attr == "copy" and not node.args:
        yield source.replace(node, source.of(node.func.value))
        return
    given = node.args[0] if node.args else None
    part = isinstance(given, ast.Subscript) and isinstance(given.slice, ast.Slice)
    whole = given.value if part and isinstance(given, ast.Subscript) else given
    named = isinstance(given, ast.Name | ast.Subscript)
    if named and source.of(node.func) == "np.array" and ast.unparse(whole) not in source.lists:
        yield source.replace(node.func, "np.asarray")


def wrong_units(source: Source, node: ast.AST) -> Iterator[Edit]:
    """A product a thousand times as large, a quotient a thousandth."""
    if not isinstance(node, ast.BinOp) or _is_text(node.left) or _is_text(node.right):
        return
    if isinstance(node.op, ast.Mult):
        yield source.replace(node, f"({source.of(node)} * 1000)")
    elif isinstance(node.op, ast.Div):
        yield source.replace(node, f"({source.of(node)} / 1000)")


def dropped_roots(source: Source, node: ast.AST) -> Iterator[Edit]:
    """``np.sqrt(a)`` → ``a``, ``a ** 0.5`` → ``a``."""
    if isinstance(node, ast.Call) and _name(node) == "sqrt" and len(node.args) == 1:
        yield source.replace(node, f"({source.of(node.args[0])})")
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        half = source.of(node.right) in ("0.5", "(1 / 2)")
        if half:
            yield source.replace(node, f"({source.of(node.left)})")


def _name(call: ast.Call) -> str:
    return ast.unparse(call.func).rpartition(".")[2]


KINDS: dict[str, Callable[[Source, ast.AST], Iterator[Edit]]] = {
    kind.__name__: kind
    for kind in (
        swapped_arguments,
        swapped_axes,
        dropped_terms,
        wrong_defaults,
        removed_checks,
        removed_copies,
        wrong_units,
        dropped_roots,
    )
}


def edits(text: str, kind: str) -> list[Edit]:
    """Return every place of a module for a fault of this kind, in a fixed order."""
    source = Source(text)
    return sorted({edit for node in source.nodes for edit in KINDS[kind](source, node)})


def plant(text: str, kind: str, occurrence: int) -> str:
    """Return a module with one fault of this kind in it."""
    return Source(text).apply(edits(text, kind)[occurrence])
