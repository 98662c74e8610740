"""Sentences of the abstract and of chapter 6, held against printed numbers and against records."""

from __future__ import annotations

from collections.abc import Mapping

from compendium import thesis
from compendium.ledger import Record, claim, claims


def of_printed_numbers() -> dict[str, float]:
    """Return what decides each sentence that printed numbers alone decide, by its claim."""
    table = {name: entry.value for name, entry in claims().items() if entry.printed}
    errors = {name: value for name, value in table.items() if name.endswith("/accuracy")}
    on_paths = [
        errors[f"table-5.4/{zoom}/{path}/accuracy"] / claim(f"section-5.4/pixel-{zoom}").value
        for zoom in thesis.ZOOMS
        for path in ("square", "circle", "sinusoid")
    ]
    kappa = [thesis.table_5_1(f"{pattern}-1X", "kappa") for pattern in ("circle", "square")]
    return {
        "abstract/modulus-obtained": table["table-5.6/w_d"] / table["table-5.6/a"],
        "section-5.2/lenses-precise": abs(kappa[0] - kappa[1]) / max(map(abs, kappa)),
        "section-5.4/tracked-accurately": sum(px <= 1 for px in on_paths) / len(on_paths),
        "section-6/precise-and-accurate": min(errors.values()),
    }


def of_records(records: Mapping[str, Record]) -> dict[str, float]:
    """Return what decides each sentence that the simulations of section 5.5 decide, by its claim.

    Parameters
    ----------
    records : mapping of str to Record
        What chapter 5 recorded.
    """
    crest = records["section-5.5/crest-convex-cylindric"].value
    sides = records["section-5.5/sides-planar"].value
    # What is not convex cylindric on the crest is planar, as section-5.5/crest-convex has it.
    return {
        "section-6/reconstruction-synthetic": records["5.5/ridge-thesis"].value / thesis.RIDGE_STEP,
        "section-6/homogeneous-patches": min(sides, max(crest, 1 - crest)),
    }
