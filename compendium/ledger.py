"""The thesis' printed numbers, and the verdict on each.

`data/thesis/claims.toml` holds every printed number once. A notebook computes a number and calls
`check`, which compares it with the printed one, asserts that the verdict is the one the book
states, and writes a record. The book, its scorecard and its prose are rendered from these records.

Kinds of claims and how they are judged:

- ``exact`` follows from other printed numbers. Ours must lie within the claim's tolerance: half a
  unit in the last printed place unless the claim states another one with its reason. Verdict:
  reproduced, or differs.
- ``simulated`` was measured in 2008 with an apparatus that is gone. Ours is a 95 % interval over
  seeds; the printed value lies inside (consistent) or not (differs).
- ``stated`` is a sentence turned into a predicate with a bound. It holds (consistent) or not
  (differs).
- ``lost`` cannot be checked without data that nobody has.
- ``given`` is a choice or a catalogue value, not a result: used as printed.

A claim with a ``corrected`` value is an erratum: ours must agree with the correction and contradict
the print.
"""

from __future__ import annotations

import json
import math
import operator
import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from decimal import Decimal
from functools import cache
from pathlib import Path

import pandas as pd

__all__ = [
    "VERDICTS",
    "Claim",
    "ClaimError",
    "Record",
    "check",
    "claim",
    "claims",
    "errata",
    "judge",
    "open_record",
    "read_records",
    "report",
    "scorecard",
    "summary",
]

KINDS = ("exact", "simulated", "stated", "lost", "given")
VERDICTS = ("reproduced", "consistent", "differs", "erratum", "lost", "given", "pending")

# Kinds that no computation can judge: the verdict is the kind itself.
_UNJUDGED = ("lost", "given")

_THESIS = Path(__file__).resolve().parent.parent / "data" / "thesis"
_COMPARISONS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}


class ClaimError(AssertionError):
    """A computed number does not lead to the verdict that the book states for its claim."""


@dataclass(frozen=True)
class Claim:
    """
    One printed number, or one sentence turned into a predicate.

    Attributes
    ----------
    id : str
        Where it stands and what it is, ``table-5.6/E``.
    what : str
        The quantity in words.
    where : str
        Table, section or figure of the thesis.
    kind : str
        One of exact, simulated, stated, lost, given.
    verdict : str
        The verdict that the book states, which `check` asserts; ``pending`` if not yet judged.
    printed : str
        The number as printed, so that its last place is known; for a stated claim, the bound (``>=
        0.5``).
    unit : str
        Unit of the number; empty for pure numbers.
    tolerance : float
        Largest difference at which ours still agrees, in `unit`.
    reason : str
        Why the tolerance is what it is.
    corrected : str
        The right value where the printed one is wrong.
    identified : bool
        True if a simulation was tuned to this number, so that agreement is no check of it.
    note : str
        Explanation of what differs, or which data are missing.
    """

    id: str
    what: str
    where: str
    kind: str
    verdict: str
    printed: str
    unit: str = ""
    tolerance: float = math.nan
    reason: str = ""
    corrected: str = ""
    identified: bool = False
    note: str = ""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind of {self.id} must be one of {KINDS}, got {self.kind!r}")
        if self.verdict not in VERDICTS:
            raise ValueError(
                f"verdict of {self.id} must be one of {VERDICTS}, got {self.verdict!r}"
            )
        if (self.kind in _UNJUDGED or self.verdict in _UNJUDGED) and self.verdict != self.kind:
            raise ValueError(
                f"{self.id} is {self.kind} and cannot have the verdict {self.verdict!r}"
            )
        if (self.verdict == "erratum") != bool(self.corrected):
            raise ValueError(
                f"{self.id} must have a corrected value if and only if it is an erratum"
            )
        if self.verdict in ("differs", "lost") and not self.note:
            raise ValueError(f"{self.id} must explain its verdict {self.verdict!r} in a note")
        if math.isnan(self.tolerance):
            if self.kind == "exact":
                object.__setattr__(self, "tolerance", half_ulp(self.corrected or self.printed))
                object.__setattr__(self, "reason", "half a unit in the last printed place")
        elif not self.reason:
            raise ValueError(f"{self.id} must give the reason for its tolerance")

    @property
    def value(self) -> float:
        """The printed number; for a stated claim, its bound."""
        return float(self.printed.split()[-1])


@dataclass(frozen=True)
class Record:
    """
    What a notebook found for a claim, or a number of its own for the prose.

    Attributes
    ----------
    id : str
        The claim's id, or a name of ours for a number without a printed one.
    value : float
        Our number, in `unit`.
    low, high : float
        The ends of its interval: 95 % over seeds for a simulation, the propagated rounding of
        printed inputs for an exact claim; both equal `value` where there is none.
    unit : str
        Unit of the number.
    verdict : str
        The verdict; ``result`` for a number of ours.
    digits : int
        Decimal places to show.
    """

    id: str
    value: float
    low: float
    high: float
    unit: str
    verdict: str
    digits: int

    def __str__(self) -> str:
        # Tiny numbers (a distortion per µm²) read better in powers of ten.
        style = f".{self.digits}f" if self.digits <= 7 else ".2e"
        text = format(self.value, style)
        if self.high > self.low:
            half = (self.high - self.low) / 2
            if math.isclose(self.high + self.low, 2 * self.value, rel_tol=1e-6):
                text += f" ± {format(half, style)}"
            else:
                text += f" ({format(self.low, style)} to {format(self.high, style)})"
        return f"{text} {self.unit}".rstrip()


def half_ulp(printed: str) -> float:
    """Return half a unit in the last place of a printed decimal, ``1.3237`` giving 0.00005."""
    exponent = Decimal(printed).as_tuple().exponent
    if not isinstance(exponent, int):
        raise ValueError(f"printed must be a finite decimal, got {printed!r}")
    return 0.5 * 10.0**exponent


@cache
def claims() -> Mapping[str, Claim]:
    """
    Read all claims.

    Returns
    -------
    mapping of str to Claim
        Every printed number by its id, in the order of the thesis.

    Raises
    ------
    ValueError
        If the data file is missing or a claim in it is incomplete.

    Examples
    --------
    >>> claims()["table-5.6/E"].printed
    '1.3237'
    """
    return {name: Claim(id=name, **entry) for name, entry in _read("claims.toml").items()}


def claim(id: str) -> Claim:
    """
    Return one claim by its id.

    Parameters
    ----------
    id : str
        For example ``table-5.6/E``.

    Returns
    -------
    Claim
        The printed number and how it is judged.

    Raises
    ------
    ValueError
        If there is no such claim.

    Examples
    --------
    >>> claim("table-5.6/w_d").value
    121.22
    """
    if id not in claims():
        raise ValueError(f"id must name a claim of claims.toml, got {id!r}")
    return claims()[id]


@cache
def errata() -> Mapping[str, Mapping[str, str]]:
    """
    Read the faults of the thesis.

    Returns
    -------
    mapping of str to mapping
        By id: ``where``, ``printed``, ``corrected``, ``proof`` and the ``origin`` of the fault,
        which is ``print``, or ``open`` where print and machine reading cannot be told apart.

    Examples
    --------
    >>> errata()["table-5.6-zeta"]["printed"]
    'ζ = c/a = 44.78'
    """
    return _read("errata.toml")


def judge(claim: Claim, value: float, low: float, high: float) -> str:
    """
    Compare a computed number with its claim.

    Parameters
    ----------
    claim : Claim
        What was printed.
    value : float
        Our number, in the claim's unit.
    low, high : float
        Ends of our interval; only a simulated claim is judged by them.

    Returns
    -------
    str
        ``reproduced``, ``consistent``, ``differs`` or ``erratum``.

    Raises
    ------
    ValueError
        If the claim is of a kind that no number can judge.

    Examples
    --------
    >>> judge(claim("table-5.6/E"), 1.32372, 1.32372, 1.32372)
    'reproduced'
    >>> judge(claim("table-5.6/E"), 1.30, 1.30, 1.30)
    'differs'
    """
    if claim.kind == "exact":
        if claim.corrected:
            contradicts = abs(value - claim.value) > claim.tolerance + half_ulp(claim.printed)
            agrees = abs(value - float(claim.corrected)) <= claim.tolerance
            return "erratum" if agrees and contradicts else "differs"
        return "reproduced" if abs(value - claim.value) <= claim.tolerance else "differs"
    if claim.kind == "simulated":
        return "consistent" if low <= claim.value <= high else "differs"
    if claim.kind == "stated":
        comparison = _COMPARISONS[claim.printed.split()[0]]
        return "consistent" if comparison(value, claim.value) else "differs"
    raise ValueError(f"{claim.id} is {claim.kind}; no number can judge it")


@dataclass
class _Session:
    """Where `check` and `report` of this process write, and what they have written so far."""

    path: Path | None = None
    own_data: bool = False
    records: dict[str, Record] = field(default_factory=dict)


_session = _Session()


def open_record(path: str | os.PathLike[str], *, own_data: bool = False) -> None:
    """
    Begin a notebook's record.

    Parameters
    ----------
    path : path-like
        JSON file for the records; empty for none. An older file of the same name is replaced.
    own_data : bool
        True if the notebook runs on the reader's data, which the thesis' numbers do not describe:
        `check` then says that it skips, and nothing is written.
    """
    _session.path = None if own_data or not os.fspath(path) else Path(path)
    _session.own_data = own_data
    _session.records = {}
    if own_data:
        print("Own data: the checks against the thesis are skipped.")
    _write()


def check(
    id: str,
    value: float,
    uncertainty: float = 0.0,
    *,
    interval: tuple[float, float] | None = None,
) -> Record | None:
    """
    Compare a computed number with the printed one and record the verdict.

    Parameters
    ----------
    id : str
        The claim, ``table-5.6/E``.
    value : float
        Our number, in the claim's unit; 1 or 0 for a predicate that simply holds or not.
    uncertainty : float
        Half-width of the interval around it: of the 95 % interval over seeds for a simulated claim,
        of the propagated rounding of the printed inputs for an exact one.
    interval : tuple of float, optional
        Both ends, where they do not lie evenly around `value`.

    Returns
    -------
    Record or None
        The verdict with our number; None if the notebook runs on the reader's own data.

    Raises
    ------
    ClaimError
        If the verdict is not the one that ``claims.toml`` states: ours changed, or the claim was
        never judged.
    ValueError
        If there is no such claim, the value is not finite, or a simulated claim comes without an
        interval.

    Examples
    --------
    >>> print(check("table-5.6/E", 1.32372))
    1.32372 MPa
    """
    stated = claim(id)
    if _session.own_data:
        return None
    low, high = interval or (value - uncertainty, value + uncertainty)
    if not all(math.isfinite(number) for number in (value, low, high)):
        raise ValueError(f"value of {id} must be finite, got {value} in [{low}, {high}]")
    if not low <= value <= high:
        raise ValueError(f"interval of {id} must contain its value, got {value} in [{low}, {high}]")
    if stated.kind == "simulated" and low == high:
        raise ValueError(f"{id} is simulated and needs an interval, got a bare {value}")
    verdict = judge(stated, value, low, high)
    if verdict != stated.verdict:
        printed = stated.corrected or stated.printed
        raise ClaimError(
            f"claim {id}: printed {printed} {stated.unit}, tolerance {stated.tolerance:g}, "
            f"ours {value:.8g} in [{low:.8g}, {high:.8g}]: "
            f"{verdict}, but the book says {stated.verdict}"
        )
    return _add(
        Record(id, float(value), float(low), float(high), stated.unit, verdict, _places(stated))
    )


def report(id: str, value: float, unit: str = "", *, digits: int = 2) -> Record:
    """
    Record a number of ours that has no printed counterpart, so that the prose can quote it.

    Parameters
    ----------
    id : str
        A name, chapter first, as ``4/strain-ratio``.
    value : float
        The number, in `unit`.
    unit : str
        Its unit; empty for pure numbers.
    digits : int
        Decimal places to show.

    Returns
    -------
    Record
        The number as the book will print it.

    Raises
    ------
    ValueError
        If the id is that of a claim, or the value is not finite.

    Examples
    --------
    >>> print(report("4/example", 1.27791, digits=2))
    1.28
    """
    if id in claims():
        raise ValueError(f"id must not be that of a claim, got {id!r}")
    if not math.isfinite(value):
        raise ValueError(f"value of {id} must be finite, got {value}")
    return _add(Record(id, float(value), float(value), float(value), unit, "result", digits))


def summary(prefix: str = "") -> pd.DataFrame:
    """
    Tabulate what this notebook has checked so far.

    Parameters
    ----------
    prefix : str
        Only claims whose id begins with it, ``table-5.6``.

    Returns
    -------
    pandas.DataFrame
        One row a claim: id, quantity, printed, ours, unit, verdict.
    """
    rows = [
        {
            "claim": record.id,
            "quantity": stated.what,
            "printed": stated.printed,
            "ours": str(replace(record, unit="")),
            "unit": stated.unit,
            "verdict": record.verdict + (" (identified)" if stated.identified else ""),
        }
        for record in _session.records.values()
        if record.id.startswith(prefix) and (stated := claims().get(record.id)) is not None
    ]
    return pd.DataFrame(rows, columns=["claim", "quantity", "printed", "ours", "unit", "verdict"])


def read_records(folder: str | os.PathLike[str]) -> dict[str, Record]:
    """
    Read the records of all notebooks.

    Parameters
    ----------
    folder : path-like
        Folder with the JSON files that `open_record` made.

    Returns
    -------
    dict of str to Record
        By id.

    Raises
    ------
    ValueError
        If two notebooks recorded the same id.
    """
    records: dict[str, Record] = {}
    for path in sorted(Path(folder).glob("*.json")):
        for entry in json.loads(path.read_text()):
            if entry["id"] in records:
                raise ValueError(f"{entry['id']} is recorded twice, the second time in {path.name}")
            records[entry["id"]] = Record(**entry)
    return records


def scorecard(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """
    Tabulate every claim with what the notebooks recorded for it.

    Parameters
    ----------
    folder : path-like
        Folder of records, as for `read_records`.

    Returns
    -------
    pandas.DataFrame
        One row a claim in the thesis' order: claim, part (the table or section it belongs to),
        quantity, kind, printed, rounding (half a unit in the last place), ours, low, high, unit,
        verdict, identified, note.

    Examples
    --------
    >>> table = scorecard("no/such/folder")
    >>> table.loc[table["claim"] == "table-5.6/E", "printed"].item()
    '1.3237'
    """
    records = read_records(folder)
    rows = []
    for stated in claims().values():
        record = records.get(stated.id)
        rows.append(
            {
                "claim": stated.id,
                "part": stated.id.split("/")[0].replace("-", " ").capitalize(),
                "quantity": stated.what,
                "kind": stated.kind,
                "printed": stated.printed,
                "rounding": math.nan if stated.kind == "stated" else half_ulp(stated.printed),
                "ours": "" if record is None else str(replace(record, unit="")),
                "low": math.nan if record is None else record.low,
                "high": math.nan if record is None else record.high,
                "unit": stated.unit,
                "verdict": stated.verdict,
                "identified": stated.identified,
                "note": stated.note,
            }
        )
    return pd.DataFrame(rows)


def _places(stated: Claim) -> int:
    """Return how many decimals to show: one more than printed."""
    if stated.kind == "stated":
        return 3
    exponent = Decimal(stated.corrected or stated.printed).as_tuple().exponent
    return max(0, 1 - int(exponent))


def _add(record: Record) -> Record:
    # A cell that is run again replaces what it recorded.
    _session.records[record.id] = record
    _write()
    return record


def _write() -> None:
    if _session.path is None:
        return
    _session.path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps([asdict(r) for r in _session.records.values()], indent=1, ensure_ascii=False)
    _session.path.write_text(text + "\n", encoding="utf-8")


def _read(name: str) -> dict:
    path = _THESIS / name
    if not path.exists():
        raise ValueError(f"{name} must lie in data/thesis beside the package; run from a checkout")
    with path.open("rb") as file:
        return tomllib.load(file)
