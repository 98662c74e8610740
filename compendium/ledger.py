"""The thesis' printed numbers, and the verdict on each.

`data/thesis/claims.toml` holds every printed number once. A notebook computes a number and calls
`check`, which compares it with the printed one, asserts that the verdict is the one the book
states, and writes a record. The book, its scorecard and its prose are rendered from these records.

Kinds of claims and how they are judged:

- ``exact`` follows from other printed numbers. Ours must lie within the claim's tolerance: half a
  unit in the last printed place unless the claim states another one with its reason. Verdict:
  reproduced, or differs.
- ``simulated`` was measured in 2008 with an apparatus that is gone. Ours is a 95 % interval over
  seeds; the printed value lies inside (consistent) or not (differs). An interval that is too wide
  to say anything is inconclusive.
- ``stated`` is a sentence turned into a predicate. It holds (consistent) or not (differs). Its
  limit is the thesis' own, or it is ours and then has a reason.
- ``bound`` is simulated with a cause left out, so that ours is a lower or an upper bound only. The
  printed value respects it (bounded) or not (differs).
- ``lost`` cannot be checked without data that nobody has.
- ``given`` is a choice or a catalogue value, not a result: used as printed.

A claim with a ``corrected`` value is an erratum: ours must agree with the correction and contradict
the print. A claim that differs says what ours is and within what, so that a change of it is
noticed, too.

What was ``spent`` on a claim qualifies its verdict: an input was ``identified`` from the printed
number itself or from one that follows from it, or an input that the thesis does not print is
``assumed`` and decides it. Such agreement is no evidence, and is never counted without its
qualifier.
"""

from __future__ import annotations

import csv
import json
import math
import operator
import os
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from decimal import Decimal
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from microlib._common import replace_file

__all__ = [
    "TALLY_VARIABLE",
    "VERDICTS",
    "Claim",
    "ClaimError",
    "Record",
    "appraise",
    "check",
    "check_equation",
    "claim",
    "claims",
    "errata",
    "judge",
    "open_record",
    "read_records",
    "report",
    "scorecard",
    "summary",
    "turned_by",
    "turning_points",
    "with_error",
]

KINDS = ("exact", "simulated", "stated", "bound", "lost", "given")
VERDICTS = (
    "reproduced",
    "consistent",
    "bounded",
    "inconclusive",
    "differs",
    "erratum",
    "lost",
    "given",
    "pending",
)
SPENT = ("", "identified", "assumed")

# Kinds that no computation can judge: the verdict is the kind itself.
_UNJUDGED = ("lost", "given")
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")

_THESIS = Path(__file__).resolve().parent.parent / "data" / "thesis"
_COMPARISONS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
#: Largest half-width of a simulated interval over the printed number, where a claim states none:
#: wider, and zero or the double would do as well.
_WIDEST = 0.5
#: What the record of a check says that compares no printed number.
CHECKED = "checked"
#: Set to make `check` record a verdict that the book does not state instead of failing.
TALLY_VARIABLE = "COMPENDIUM_TALLY"


class ClaimError(AssertionError):
    """A computed number does not lead to the verdict that the book states for its claim."""


@dataclass(frozen=True)
class Claim:
    """One printed number, or one sentence turned into a predicate.

    Attributes
    ----------
    id : str
        Where it stands and what it is, ``table-5.6/E``.
    what : str
        The quantity in words.
    where : str
        Table, section or figure of the thesis.
    kind : str
        One of exact, simulated, stated, bound, lost, given.
    verdict : str
        The verdict that the book states, which `check` asserts; ``pending`` if not yet judged.
    printed : str
        The number as printed, so that its last place is known; for a stated claim the limit as
        printed, or empty if the thesis gives none.
    unit : str
        Unit of the number; empty for pure numbers.
    says : str
        What the thesis says there, in our words; needed for a stated claim.
    limit : str
        For a stated claim, the predicate that ours must fulfil, ``>= 0.5``.
    limit_of : str
        ``thesis``, or ``ours`` with a `reason`.
    side : str
        For a bound, whether ours is a ``lower`` or an ``upper`` bound of the printed number.
    tolerance : float
        Largest difference at which ours still agrees, in `unit`.
    reason : str
        Why the tolerance, the limit or the largest width is what it is.
    widest : float
        Largest half-width of a simulated interval, in `unit`, that still says something.
    corrected : str
        The right value where the printed one is wrong.
    ours, within : float
        For a claim that differs, our number and how far a later run may depart from it, in `unit`.
    spent : str
        Empty, ``identified`` or ``assumed``.
    input : str
        Which input was identified or assumed, and how; needed where something was spent.
    note : str
        Explanation of what differs, or which data are missing.
    test : str
        The test that holds what is computed, as pytest names it.
    """

    id: str
    what: str
    where: str
    kind: str
    verdict: str
    printed: str
    unit: str = ""
    says: str = ""
    limit: str = ""
    limit_of: str = ""
    side: str = ""
    tolerance: float = math.nan
    reason: str = ""
    widest: float = math.nan
    corrected: str = ""
    ours: float = math.nan
    within: float = math.nan
    spent: str = ""
    input: str = ""
    note: str = ""
    test: str = ""

    def __post_init__(self) -> None:
        for name, allowed in (("kind", KINDS), ("verdict", VERDICTS), ("spent", SPENT)):
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name} of {self.id} must be one of {allowed}, got {getattr(self, name)!r}"
                )
        if (self.kind in _UNJUDGED or self.verdict in _UNJUDGED) and self.verdict != self.kind:
            raise ValueError(
                f"{self.id} is {self.kind} and cannot have the verdict {self.verdict!r}"
            )
        if self.kind == "exact" and math.isnan(self.tolerance):
            object.__setattr__(self, "tolerance", half_ulp(self.corrected or self.printed))
            if not self.reason:
                object.__setattr__(self, "reason", "half a unit in the last printed place")
        if self.kind == "simulated" and math.isnan(self.widest):
            object.__setattr__(self, "widest", _WIDEST * abs(self.value))
        for wanted, sound in self._rules():
            if not sound:
                raise ValueError(f"{self.id} {wanted}")

    def _rules(self) -> list[tuple[str, bool]]:
        """Return what must hold of the entry, in words, and whether it does."""
        stated, exact = self.kind == "stated", self.kind == "exact"
        own = self.limit_of == "ours"
        size = abs(self.value) if self.kind in ("exact", "simulated") else math.inf
        return [
            (
                "must have a corrected value if and only if it is an erratum",
                (self.verdict == "erratum") == bool(self.corrected),
            ),
            (
                f"must explain its verdict {self.verdict!r} in a note",
                self.verdict not in ("differs", "inconclusive", "lost") or bool(self.note),
            ),
            (
                "is stated and needs a limit, whose it is, and what the thesis says",
                stated == bool(self.limit) == bool(self.limit_of) and stated <= bool(self.says),
            ),
            (
                "must give the limit of the thesis or of ours",
                self.limit_of in ("", "thesis", "ours"),
            ),
            ("must give the reason for a limit of ours", not own or bool(self.reason)),
            ("must not print a limit that is ours", not own or not self.printed),
            ("is a bound and needs its side", (self.kind == "bound") == bool(self.side)),
            ("must give lower or upper as its side", self.side in ("", "lower", "upper")),
            ("has a tolerance and needs to be exact", exact or math.isnan(self.tolerance)),
            ("must give the reason for its tolerance", not exact or bool(self.reason)),
            (
                "must have a tolerance below half of the printed number",
                not exact or 0 < self.tolerance <= max(0.5 * size, half_ulp(self.printed)),
            ),
            (
                "must have a largest width below the printed number, or a reason",
                self.kind != "simulated" or 0 < self.widest < (math.inf if self.reason else size),
            ),
            (
                "differs and must say what ours is, and within what",
                (self.verdict == "differs") == (self.ours == self.ours)
                and (self.ours == self.ours) == (0 < self.within < math.inf),
            ),
            ("must name the input that was spent", bool(self.spent) == bool(self.input)),
        ]

    @property
    def value(self) -> float:
        """The printed number; for a stated claim, its limit."""
        return float((self.limit or self.printed).split()[-1])

    @property
    def rule(self) -> str:
        """How the claim is judged, in words."""
        unit = f" {self.unit}".rstrip()
        if self.kind in _UNJUDGED:
            return "not judged"
        if self.kind == "stated":
            whose = "the thesis' limit" if self.limit_of == "thesis" else "our limit"
            return f"ours {self.limit}{unit} ({whose})"
        if self.kind == "simulated":
            return f"printed lies in our 95 % interval of at most ± {self.widest:.3g}{unit}"
        if self.kind == "bound":
            return f"ours is {'an upper' if self.side == 'upper' else 'a lower'} bound of the print"
        if self.corrected:
            return f"ours within {self.tolerance:.2g}{unit} of {self.corrected}, and not the print"
        return f"ours within {self.tolerance:.2g}{unit} of the print: {self.reason}"

    @property
    def qualified(self) -> str:
        """The verdict, with what was spent on it."""
        text = "not yet judged" if self.verdict == "pending" else self.verdict
        return f"{text} ({self.spent})" if self.spent else text


@dataclass(frozen=True)
class Record:
    """What a notebook found for a claim, or a number of its own for the prose.

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
    cell : str
        The notebook's cell that computed it; empty outside of a notebook.
    """

    id: str
    value: float
    low: float
    high: float
    unit: str
    verdict: str
    digits: int
    cell: str = ""

    def __str__(self) -> str:
        # Tiny numbers (a distortion per µm²) read better in powers of ten.
        style = f".{self.digits}f" if self.digits <= 7 else ".2e"
        if self.high > self.low and self.digits <= 7:
            # Of an interval two digits, and of the number no more than they are worth.
            places = 1 - math.floor(math.log10((self.high - self.low) / 2))
            style = f".{min(self.digits, max(0, places))}f"
        text = format(self.value, style)
        if self.high > self.low:
            half = (self.high - self.low) / 2
            if math.isclose(self.high + self.low, 2 * self.value, rel_tol=1e-6):
                text += f" ± {format(half, style)}"
            else:
                text += f" ({format(self.low, style)} to {format(self.high, style)})"
        return f"{text} {self.unit}".rstrip()


def with_error(value: float, error: float) -> str:
    """Return a number and its error, both to two digits of the error.

    Parameters
    ----------
    value, error : float
        Of one unit; the error is positive.

    Examples
    --------
    >>> with_error(201173.2, 1290.0), with_error(-2.79268, 0.009)
    ('201200 ± 1300', '-2.7927 ± 0.0090')
    >>> with_error(-8.39877e-10, 1.7e-12)
    '(-8.399 ± 0.017)·10⁻¹⁰'
    """
    power = math.floor(math.log10(abs(value))) if 0 < abs(value) < 1e-5 else 0
    places = 1 - math.floor(math.log10(error)) + power
    scaled = [f"{round(part / 10**power, places):.{max(0, places)}f}" for part in (value, error)]
    text = " ± ".join(scaled)
    return f"({text})·10{str(power).translate(_RAISED)}" if power else text


def half_ulp(printed: str) -> float:
    """Return half a unit in the last place of a printed decimal, ``1.3237`` giving 0.00005."""
    exponent = Decimal(printed).as_tuple().exponent
    if not isinstance(exponent, int):
        raise ValueError(f"printed must be a finite decimal, got {printed!r}")
    return 0.5 * 10.0**exponent


@cache
def claims() -> Mapping[str, Claim]:
    """Read all claims.

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
    """Return one claim by its id.

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
    """Read the faults of the thesis.

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
    """Compare a computed number with its claim.

    Parameters
    ----------
    claim : Claim
        What was printed.
    value : float
        Our number, in the claim's unit.
    low, high : float
        Ends of our interval; a simulated claim and a bound are judged by them.

    Returns
    -------
    str
        ``reproduced``, ``consistent``, ``bounded``, ``inconclusive``, ``differs`` or
        ``erratum``.

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
        if not low <= claim.value <= high:
            return "differs"
        return "consistent" if (high - low) / 2 <= claim.widest else "inconclusive"
    if claim.kind == "stated":
        comparison = _COMPARISONS[claim.limit.split()[0]]
        return "consistent" if comparison(value, claim.value) else "differs"
    if claim.kind == "bound":
        respected = claim.value >= low if claim.side == "lower" else claim.value <= high
        return "bounded" if respected else "differs"
    raise ValueError(f"{claim.id} is {claim.kind}; no number can judge it")


@dataclass
class _Session:
    """Where `check` and `report` of this process write, and what they have written so far."""

    path: Path | None = None
    records: dict[str, Record] = field(default_factory=dict)


_session = _Session()


def open_record(path: str | os.PathLike[str]) -> None:
    """Begin a notebook's record.

    Parameters
    ----------
    path : path-like
        JSON file for the records; empty for none. An older file of the same name is replaced.
    """
    _session.path = Path(path) if os.fspath(path) else None
    _session.records = {}
    _write()


def check(
    id: str,
    value: float,
    uncertainty: float = 0.0,
    *,
    interval: tuple[float, float] | None = None,
) -> Record:
    """Compare a computed number with the printed one and record the verdict.

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
    Record
        The verdict with our number.

    Raises
    ------
    ClaimError
        If the verdict is not the one that ``claims.toml`` states, or ours differs by another amount
        than it states.
    ValueError
        If there is no such claim, the value is not finite, or a simulated claim comes without an
        interval.

    Examples
    --------
    >>> print(check("table-5.6/E", 1.32372))
    1.32372 MPa
    """
    stated = claim(id)
    low, high = interval or (value - uncertainty, value + uncertainty)
    if not all(math.isfinite(number) for number in (value, low, high)):
        raise ValueError(f"value of {id} must be finite, got {value} in [{low}, {high}]")
    if not low <= value <= high:
        raise ValueError(f"interval of {id} must contain its value, got {value} in [{low}, {high}]")
    if stated.kind == "simulated" and low == high:
        raise ValueError(f"{id} is simulated and needs an interval, got a bare {value}")
    places = _places(stated)
    decimals = _decimals(value, high - low, places, exact=stated.kind == "exact")
    # What is stored is what is judged.
    value, low, high = _rounded(value, low, high, decimals)
    shown = min(places, max(0, decimals))
    if stated.kind == "stated" and value:
        # No printed digits say how many to show: four in all.
        shown = min(shown, max(0, 3 - math.floor(math.log10(abs(value)))))
    verdict, objection = appraise(stated, value, low, high)
    if objection and not os.environ.get(TALLY_VARIABLE):
        raise ClaimError(
            f"claim {id}, {stated.what} ({stated.where}): printed "
            f"{stated.corrected or stated.printed or stated.limit} {stated.unit}, recomputed "
            f"{value:.8g} in [{low:.8g}, {high:.8g}]: {objection}"
        )
    return _add(
        Record(
            id,
            value,
            low,
            high,
            stated.unit,
            f"{verdict}: {objection}" if objection else verdict,
            shown,
            _cell(),
        )
    )


def check_equation(
    number: str,
    formula: ArrayLike,
    library: ArrayLike,
    *,
    rtol: float = 1e-9,
    atol: float = 0.0,
) -> None:
    """Assert that a formula of the thesis and the library's function agree on the same numbers.

    Parameters
    ----------
    number : str
        The equation, ``3.13``.
    formula : array_like
        What the printed formula gives, corrected where the thesis has an erratum.
    library : array_like
        What the library's function gives for the same input, in the same shape.
    rtol, atol : float
        Largest difference, relative to each of the formula's numbers and absolute. Rounding of
        64 units in the last place of the largest number is always allowed.

    Raises
    ------
    ClaimError
        If a number differs by more, or is not finite; the message names the equation and both
        numbers.
    ValueError
        If the thesis has no such equation, or the shapes differ or are empty.

    Examples
    --------
    >>> from compendium.ledger import check_equation
    >>> from microlib.membrane import elastic_modulus, indentation_force
    >>> membrane = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    >>> modulus = elastic_modulus(100.0, 250.0, 10.0, **membrane)
    >>> check_equation("4.7", 100.0, indentation_force(modulus, 250.0, 10.0, **membrane))
    """
    if f"equation-{number}" not in _read("map.toml"):
        raise ValueError(f"number must be that of an equation of the thesis, got {number!r}")
    printed, found = np.asarray(formula, float), np.asarray(library, float)
    if printed.shape != found.shape or not printed.size:
        raise ValueError(
            f"formula and library of ({number}) must have one shape, and not be empty, "
            f"got {printed.shape} and {found.shape}"
        )
    finite = np.isfinite(printed) & np.isfinite(found)
    size = np.abs(np.where(finite, printed, 0.0))
    rounding = 64 * np.finfo(float).eps * size.max()
    difference = np.full(printed.shape, np.inf)
    np.subtract(printed, found, out=difference, where=finite)
    difference = np.abs(difference)
    excess = difference - (atol + rtol * size + rounding)
    worst = np.unravel_index(excess.argmax(), excess.shape)
    if excess[worst] > 0:
        place = f" at {tuple(int(k) for k in worst)}" if worst else ""
        raise ClaimError(
            f"equation ({number}): the formula gives {printed[worst]:.10g}, the library "
            f"{found[worst]:.10g}{place}; they differ by {difference[worst]:.3g}, and at most "
            f"{difference.max():.3g} over {printed.size} numbers"
        )
    largest = float(difference.max())
    name = f"equation-{number}/{sum(r.verdict == CHECKED for r in _session.records.values())}"
    _add(Record(name, largest, largest, largest, "", CHECKED, 0, _cell()))


def appraise(claim: Claim, value: float, low: float, high: float) -> tuple[str, str]:
    """Judge a computed number, and hold the verdict against the one that the book states.

    Parameters
    ----------
    claim : Claim
        What was printed.
    value, low, high : float
        As for `judge`.

    Returns
    -------
    verdict : str
        As from `judge`.
    objection : str
        Empty if all is as the book says; otherwise what is not.

    Examples
    --------
    >>> appraise(claim("table-5.6/E"), 1.30, 1.30, 1.30)
    ('differs', 'differs, but the book says reproduced')
    """
    verdict = judge(claim, value, low, high)
    if verdict != claim.verdict:
        return verdict, f"{verdict}, but the book says {claim.verdict}"
    if claim.verdict == "differs" and not abs(value - claim.ours) <= claim.within:
        return verdict, f"not within {claim.within:g} of {claim.ours:g}, which the book says"
    return verdict, ""


def turning_points(claim: Claim, record: Record) -> tuple[float, float]:
    """Return by what factors our number can fall and rise before the verdict turns.

    Parameters
    ----------
    claim : Claim
        A claim that was judged.
    record : Record
        What was found for it; its interval is moved with the value.

    Returns
    -------
    tuple of float
        The largest factor below one and the smallest above one, of a ladder in steps of 1 % up to
        a hundredfold, at which the verdict is another; 0 and infinity if there is none. Our number
        must not be zero.

    Examples
    --------
    >>> low, high = turning_points(
    ...     claim("table-5.6/w_d"), Record("table-5.6/w_d", 121.217, 121.217, 121.217, "µm", "", 3)
    ... )
    >>> round(low, 2), round(high, 2)
    (0.99, 1.01)
    """
    ladder = 1.01 ** np.arange(1, 464)

    def turns(factor: float) -> bool:
        ends = sorted((factor * record.low, factor * record.high))
        return bool(appraise(claim, factor * record.value, *ends)[1])

    down = next((1 / float(f) for f in ladder if turns(1 / f)), 0.0)
    return down, next((float(f) for f in ladder if turns(f)), math.inf)


def _cell() -> str:
    """Return the number of the notebook's cell that is being executed, ``[7]``."""
    shell = sys.modules.get("IPython") and sys.modules["IPython"].get_ipython()
    # Its inputs, the first of which is empty; the shell's own count may have moved on already.
    return f"[{len(shell.user_ns['In']) - 1}]" if shell else ""


def report(id: str, value: float, unit: str = "", *, digits: int = 2) -> Record:
    """Record a number of ours that has no printed counterpart, so that the prose can quote it.

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
    value = round(float(value), _decimals(value, 0.0, digits, exact=True))
    return _add(Record(id, value, value, value, unit, "result", digits))


def summary(prefix: str = "") -> pd.DataFrame:
    """Tabulate what this notebook has checked so far.

    Parameters
    ----------
    prefix : str
        Only claims whose id begins with it, ``table-5.6``.

    Returns
    -------
    pandas.DataFrame
        One row for each claim, by its id: quantity, printed, ours, unit, verdict.
    """
    rows = [
        {
            "claim": record.id,
            "quantity": stated.what,
            "printed": stated.printed,
            "ours": str(replace(record, unit="")),
            "unit": stated.unit,
            "verdict": stated.qualified,
        }
        for record in _session.records.values()
        if record.id.startswith(prefix) and (stated := claims().get(record.id)) is not None
    ]
    columns = ["claim", "quantity", "printed", "ours", "unit", "verdict"]
    table = pd.DataFrame(rows, columns=columns).set_index("claim")
    # The word above the ids, in the same line as the other columns' names.
    return table.rename_axis(index=None, columns="claim")


def read_records(folder: str | os.PathLike[str]) -> dict[str, Record]:
    """Read the records of all notebooks.

    Parameters
    ----------
    folder : path-like
        Folder with the JSON files that `open_record` made.

    Returns
    -------
    dict of str to Record
        By id; without what `check_equation` recorded.

    Raises
    ------
    ValueError
        If two notebooks recorded the same id.
    """
    records: dict[str, Record] = {}
    for path in sorted(Path(folder).glob("*.json")):
        for entry in json.loads(path.read_text(encoding="utf-8")):
            if entry["verdict"] == CHECKED:
                continue
            if entry["id"] in records:
                raise ValueError(f"{entry['id']} is recorded twice, the second time in {path.name}")
            records[entry["id"]] = Record(**entry)
    return records


@cache
def turned_by() -> Mapping[str, tuple[str, ...]]:
    """Read which faults turned the check of each claim, when they were planted in its inputs.

    Returns
    -------
    mapping of str to tuple of str
        Names of the faults by the claim's id, as ``make vacuity`` wrote them; the faults themselves
        stand in ``tests/vacuity_faults.toml``.

    Examples
    --------
    >>> "window-d2-halved" in turned_by()["section-3.2.1/d2"]
    True
    """
    with (_THESIS / "vacuity.csv").open(newline="", encoding="utf-8") as file:
        return {row["claim"]: tuple(row["inputs"].split()) for row in csv.DictReader(file)}


def scorecard(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Tabulate every claim with what the notebooks recorded for it.

    Parameters
    ----------
    folder : path-like
        Folder of records, as for `read_records`.

    Returns
    -------
    pandas.DataFrame
        One row a claim in the thesis' order: claim, part (the table or section it belongs to),
        quantity, kind, printed, rounding (half a unit in the last place), ours, low, high, unit,
        verdict, spent, rule, turns (the factors at which the verdict turns, see `turning_points`),
        faults (of `turned_by`), input, says, note, cell, test.

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
        is_number = stated.kind != "stated" and stated.printed != ""
        rows.append(
            {
                "claim": stated.id,
                "part": stated.id.split("/")[0].replace("-", " ").capitalize(),
                "quantity": stated.what,
                "kind": stated.kind,
                "printed": stated.printed,
                "rounding": half_ulp(stated.printed) if is_number else math.nan,
                "ours": "" if record is None else str(replace(record, unit="")),
                "low": math.nan if record is None else record.low,
                "high": math.nan if record is None else record.high,
                "unit": stated.unit,
                "verdict": stated.verdict,
                "spent": stated.spent,
                "rule": stated.rule,
                "turns": "" if record is None else _in_words(turning_points(stated, record)),
                "faults": turned_by().get(stated.id, ()),
                "input": stated.input,
                "says": stated.says,
                "note": stated.note,
                "cell": "" if record is None else record.cell,
                "test": stated.test,
            }
        )
    return pd.DataFrame(rows)


def _in_words(factors: tuple[float, float]) -> str:
    down, up = factors
    return f"× {down:.2g}, × {up:.3g}" if down > 0 and up < math.inf else f"× {down:.2g}, × {up:g}"


def _decimals(value: float, width: float, places: int, *, exact: bool) -> int:
    """Return to how many decimals a number is stored: as many as mean something.

    Other BLAS kernels move results by up to 2e-6 of themselves or of their interval's width (93 of
    193 records of another machine); three digits of the width, or four of a number without an
    interval and two more than are shown, leave such a change out.
    """
    by_width = 2 - math.floor(math.log10(width)) if width > 0 else None
    if by_width is not None and not exact:
        return by_width
    by_size = 3 - math.floor(math.log10(abs(value))) if value else 0
    return max(places + 2, by_size if by_width is None else by_width)


def _rounded(value: float, low: float, high: float, decimals: int) -> tuple[float, float, float]:
    """Round a number and its interval; one that lies evenly around the number stays so."""
    middle = round(float(value), decimals)
    if abs(high + low - 2 * value) > 1e-6 * (high - low):
        return middle, round(float(low), decimals), round(float(high), decimals)
    half = round((high - low) / 2, decimals)
    return middle, round(middle - half, decimals), round(middle + half, decimals)


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
    replace_file(_session.path, lambda file: file.write_text(text + "\n", encoding="utf-8"))


@cache
def _read(name: str) -> dict:
    path = _THESIS / name
    if not path.exists():
        raise ValueError(f"{name} must lie in data/thesis beside the package; run from a checkout")
    with path.open("rb") as file:
        return tomllib.load(file)
