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
    settling = [table[f"table-5.3/{zoom}/settling-time"] for zoom in thesis.ZOOMS]
    return {
        "section-4.1/small-slopes": table["table-5.6/w_d"] / table["table-5.6/a"],
        "section-5.4/settles-in-a-second": max(settling),
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
    error = records["5.5/ridge-thesis"].value / thesis.RIDGE_STEP
    return {"section-6/reconstruction-synthetic": error}
