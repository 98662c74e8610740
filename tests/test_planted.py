"""The faults that are planted are those that are named, and nothing else changes."""

from __future__ import annotations

import pytest

from tests.planted import KINDS, Source, edits, plant


@pytest.mark.parametrize(
    ("kind", "code", "faulty"),
    [
        ("swapped_arguments", "f(a, b, c)", ["f(b, a, c)", "f(a, c, b)"]),
        ("swapped_arguments", "f(x=a, y=b)", ["f(x=b, y=a)"]),
        ("swapped_arguments", "np.hypot(a, b)", []),
        ("swapped_arguments", "f(*a, b)", []),
        ("swapped_axes", "µ = z[i, j]", ["µ = z[j, i]"]),
        ("swapped_axes", "z[:, 0]", ["z[0, :]"]),
        ("swapped_axes", "(x, y)", ["(y, x)"]),
        ("swapped_axes", "z.sum(axis=0)", ["z.sum(axis=1)"]),
        ("swapped_axes", "x: tuple[int, str] = y", []),
        ("swapped_axes", "a in (b, c)", []),
        ("swapped_axes", "isinstance(a, (int, float))", []),
        ("swapped_axes", "try:\n    f()\nexcept (A, B):\n    g()", []),
        ("swapped_axes", "x, y = y, x", ["x, y = x, y"]),
        ("dropped_terms", "a + b * c", ["(a)", "(b * c)"]),
        ("dropped_terms", "a - b", ["(a)"]),
        ("dropped_terms", "'µ' + b", []),
        ("wrong_defaults", "def f(a=4, *, b=1.0, c=True): 0", ["a=6", "b=1.5", "c=False"]),
        ("wrong_defaults", "class A:\n    a: int = 0", ["a: int = 1"]),
        ("removed_checks", "if a:\n    raise E", ["if False:\n    raise E", "if a:\n    pass"]),
        ("removed_copies", "a.copy()", ["a"]),
        ("removed_copies", "np.array(a)", ["np.asarray(a)"]),
        ("removed_copies", "a: list[int] = b\nnp.array(a)", []),
        ("removed_copies", "a = [b for b in c]\nnp.array(a)", []),
        ("removed_copies", "def f(a: tuple[int, ...]):\n    np.array(a[:2])", []),
        ("removed_copies", "a = [b, c]\nnp.array(a[0])", ["np.asarray(a[0])"]),
        ("wrong_units", "a * b", ["(a * b * 1000)"]),
        ("wrong_units", "a / b", ["(a / b / 1000)"]),
        ("wrong_units", "'-' * 3", []),
        ("dropped_roots", "np.sqrt(a)", ["(a)"]),
        ("dropped_roots", "a**0.5 + a**2", ["(a) + a**2"]),
    ],
)
def test_a_kind_has_these_places(kind: str, code: str, faulty: list[str]) -> None:
    made = [plant(code, kind, k) for k in range(len(edits(code, kind)))]
    assert len(made) == len(faulty)
    assert all(part in text for part, text in zip(faulty, made, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_never_computed_is_left_alone(kind: str) -> None:
    code = '__all__ = ["a", "b"]\n"""a + b, f(a, b)."""\ndef f(a: dict[int, str] = None): "a * b"\n'
    assert edits(code + "f'{a + b}'", kind) == []


def test_how_a_drawing_looks_is_told_from_what_it_shows() -> None:
    code = "axes.plot(x, 2 * y, lw=1.5, label='µ')"
    assert Source(code).is_look(code.replace("1.5", "2.5"))
    assert not Source(code).is_look(code.replace("2 *", "3 *"))
    assert not Source(code).is_look(code.replace("x, 2 * y", "2 * y, x"))
