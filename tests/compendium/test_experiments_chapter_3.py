"""Chapter 3: labels follow from what a type's name says, and every fault in them is noticed."""

from __future__ import annotations

import numpy as np
import pytest

from compendium import ledger
from compendium.experiments import chapter_3
from microlib.curvature import (
    HK_NAMES,
    Curvature,
    curvature_windows,
    hk_labels,
    surface_curvature,
)

NAMES = set(HK_NAMES.values())


def turned() -> set[str]:
    """Return the types whose check in the notebook would fail."""
    found = chapter_3.labels_by_name()
    claims = {name: ledger.claim(f"table-3.1/{name.replace(' ', '-')}") for name in found}
    assert set(found) == NAMES
    return {name for name, label in found.items() if ledger.appraise(claims[name], *[label] * 3)[1]}


def bend(mean_sign: int, gaussian_sign: int, swap: bool = False):
    def faulty(height, pixel_size) -> Curvature:
        right = surface_curvature(height, pixel_size)
        mean, gaussian = mean_sign * right.mean, gaussian_sign * right.gaussian
        if swap:
            mean, gaussian = gaussian, mean
        return Curvature(mean, gaussian, right.mean_error, right.gaussian_error)

    return faulty


def relabel(labels: dict[int, int]):
    table = np.array([labels.get(k, k) for k in range(10)], np.uint8)
    return lambda *args, **options: table[hk_labels(*args, **options)]


def test_each_type_gets_the_label_of_its_name() -> None:
    assert turned() == set()
    # The names that the book shows beside the labels are the table's.
    assert {label: name for name, label in chapter_3.labels_by_name().items()} == HK_NAMES


@pytest.mark.parametrize(
    ("curvature", "caught"),
    [
        (bend(-1, 1), NAMES - {"none", "planar", "minimal surface"}),
        (
            bend(1, -1),
            {n for n in NAMES if "elliptic" in n or "saddle" in n} | {"minimal surface"},
        ),
        (bend(1, 1, swap=True), NAMES - {"none", "planar"}),
        (
            lambda z, pixel: surface_curvature(-z, pixel),
            NAMES - {"none", "planar", "minimal surface"},
        ),
    ],
    ids=["H flipped", "K flipped", "H and K swapped", "heights negated"],
)
def test_a_wrong_curvature_is_noticed(monkeypatch, curvature, caught: set[str]) -> None:
    monkeypatch.setattr(chapter_3, "surface_curvature", curvature)
    assert turned() == caught


@pytest.mark.parametrize(
    ("labels", "caught"),
    [
        ({k: k % 9 + 1 for k in range(1, 10)}, NAMES),
        ({1: 2, 2: 1}, {"convex elliptic", "convex cylindric"}),
        (dict.fromkeys(range(1, 10), 5), NAMES - {"planar"}),
        ({4: 0}, {"none"}),
        (
            {k: 3 * ((k - 1) % 3) + (k - 1) // 3 + 1 for k in range(1, 10)},
            NAMES - {"convex elliptic", "planar", "saddle valley"},
        ),
    ],
    ids=["shuffled", "two swapped", "every label 5", "none missing", "table turned over"],
)
def test_wrong_labels_are_noticed(monkeypatch, labels: dict, caught: set[str]) -> None:
    monkeypatch.setattr(chapter_3, "hk_labels", relabel(labels))
    assert turned() == caught


def test_eight_types_are_possible() -> None:
    claim = ledger.claim("section-3.2.1/surface-types")
    assert chapter_3.surface_types() == set(range(1, 10)) - {4}
    assert not ledger.appraise(claim, *[len(chapter_3.surface_types())] * 3)[1]
    # With K above H², which no surface has, all nine cells of the table would be filled.
    h, k = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0])
    assert ledger.appraise(claim, *[len(np.unique(hk_labels(h, k, 0.0, 0.0)))] * 3)[1]


def test_the_windows_are_whole_numbers_over_one_divisor(monkeypatch) -> None:
    found = chapter_3.window_divisors()
    for name, divisor in found.items():
        assert not ledger.appraise(ledger.claim(f"section-3.2.1/{name}"), *[divisor] * 3)[1]
    right = curvature_windows(7)
    fields = {"s": "smooth", "d0": "mean", "d1": "slope", "d2": "second_derivative"}
    for name, field in fields.items():
        for fault in (
            2 * getattr(right, field),
            np.roll(getattr(right, field), 1),
            right.smooth**2,
        ):
            windows = type(right)(**(vars(right) | {field: fault}))
            monkeypatch.setattr(chapter_3, "curvature_windows", lambda size, w=windows: w)
            wrong = chapter_3.window_divisors()[name]
            uniform = name == "d0" and np.allclose(fault, right.mean)  # rolled, it is the same
            assert (
                uniform or ledger.appraise(ledger.claim(f"section-3.2.1/{name}"), *[wrong] * 3)[1]
            )
