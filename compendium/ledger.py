"""The thesis' printed numbers, and the verdict on each.

`data/thesis/claims.toml` holds every printed number once. A notebook computes a number and calls
`check`, which compares it with the printed one, asserts that the verdict is the one the book
states, and writes a record. The book's pages, tables and prose are made from these records.

Verdicts:

- ``agrees``: the recomputed number agrees with the printed one, or the sentence holds.
- ``disagrees``: it does not, whatever the thesis leaves open. Claims that disagree for one reason
  have one ``cause``.
- ``cannot tell``: what was published does not decide it. Data are missing, the simulation gives a
  bound only, an interval contains the limit or is too wide, or a choice that the thesis leaves open
  decides.
- ``fitted``: one of our quantities was chosen so that this number, or one that follows from it,
  comes out. Agreement is then no evidence.
- ``input``: a setting, or a number that the computation was fed with; not a result.

How a number is compared:

- by ``arithmetic``: it follows from other printed numbers and must lie within the tolerance;
- by ``simulation``: on rendered images or in a simulated loop. Outside of the 95 % interval the
  printed number disagrees. Inside it agrees if the half-width is at most half of the number;
- a ``sentence`` is turned into a condition on printed numbers. (A sentence that needs a simulation
  counts as one.) An interval that contains the limit of the condition cannot tell.

A ``star`` marks agreement that depends on something that the thesis does not print.
"""

from __future__ import annotations

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
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from microlib._common import replace_file

#: The sign of each verdict, which tells it where its color is not seen. The order is that of the
#: book's tables: what says most about the thesis comes first.
VERDICTS = {"disagrees": "✗", "cannot tell": "?", "agrees": "✓", "fitted": "≈", "input": "•"}
COMPARED = ("arithmetic", "simulation", "sentence")
STAR = "★"
#: Set to make `check` record a verdict that the book does not state instead of failing.
RECORD_MISMATCHES = "COMPENDIUM_RECORD_MISMATCHES"
#: Largest half-width of a simulated interval over the printed number, above which the interval says
#: nothing; and of one around a number that the simulation was fed with.
MAX_RELATIVE_HALF_WIDTH, MAX_RELATIVE_HALF_WIDTH_OF_INPUT = 0.5, 1.0

_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_THESIS = Path(__file__).resolve().parent.parent / "data" / "thesis"
_COMPARISONS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
_IN_WORDS = {">=": "at least", "<=": "at most", ">": "above", "<": "below"}


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
    verdict : str
        One of `VERDICTS`: what the book states, and `check` asserts.
    printed : str
        The number as printed, so that its last place is known; empty if the thesis gives none. An
        entry of ``claims.toml`` about a number of another claim has ``printed_in``, the id of that
        claim, instead.
    compared : str
        One of `COMPARED`; empty if nothing was compared.
    unit : str
        Unit of the number; empty for pure numbers.
    says : str
        What the thesis says there, in other words.
    limit : str
        The predicate that a recomputed number must fulfil for a sentence to hold, ``>= 0.5``.
    bound : str
        ``lower`` or ``upper``, where the simulation omits causes of error and gives only a bound.
    tolerance : float
        Largest difference at which arithmetic still agrees, in `unit`: that of the recomputed
        number from the printed one and, with `corrected`, also from the corrected one. By default
        it is half a unit in the last place of the printed number, or with `corrected` in the last
        place of the corrected number.
    reason : str
        Why the tolerance is not the default, or why the limit is what it is where the thesis gives
        none.
    corrected : str
        The right value where the printed one is proven wrong.
    recomputed, within : float
        For a claim that disagrees or is undecided, the number found and how far a later run may
        deviate from it: for a simulation, four standard deviations over seeds.
    star : str
        What agreement depends on that the thesis does not print; empty if nothing.
    fitted : str
        Which of our quantities was chosen so that this number, or one that follows from it, comes
        out; empty if none.
    undecided : str
        A choice that the thesis leaves open, another value of which gives another verdict.
    given : bool
        Whether the simulation was fed with this number.
    cause : str
        Of a claim that disagrees: its cause, an entry of ``causes.toml``.
    note : str
        Why it disagrees, or which data are missing.
    test : str
        A test that shows more than the check in the notebook, such as a known truth that is
        recovered, as pytest names it.
    """

    id: str
    what: str
    where: str
    verdict: str
    printed: str
    compared: str = ""
    unit: str = ""
    says: str = ""
    limit: str = ""
    bound: str = ""
    tolerance: float = math.nan
    reason: str = ""
    corrected: str = ""
    recomputed: float = math.nan
    within: float = math.nan
    star: str = ""
    fitted: str = ""
    undecided: str = ""
    given: bool = False
    cause: str = ""
    note: str = ""
    test: str = ""

    def __post_init__(self) -> None:
        if self.compared == "arithmetic" and math.isnan(self.tolerance):
            object.__setattr__(self, "tolerance", half_ulp(self.corrected or self.printed))

    @property
    def value(self) -> float:
        """The printed number; for a sentence, its limit."""
        return float((self.limit or self.printed).split()[-1])

    @property
    def label(self) -> str:
        """The verdict, with its star if it has one."""
        return f"{self.verdict} {STAR}" if self.star else self.verdict

    @property
    def rule(self) -> str:
        """How the claim is judged, in words."""
        unit = f" {self.unit}".rstrip()
        if not self.compared:
            return ""
        if self.limit:
            sign, limit = self.limit.split()
            return f"the recomputed number must be {_IN_WORDS[sign]} {limit}{unit}"
        if self.bound:
            return f"the simulation leaves causes out, so that it gives a {self.bound} bound"
        if self.compared == "simulation":
            return "the printed number must lie in the 95 % interval of the simulation"
        exact = self.tolerance < 1e-6
        nearness = "equal" if exact else f"lie within {self.tolerance:.2g}{unit} of"
        if self.corrected:
            proven = f"{self.corrected}{unit} is proven"
            return f"the printed number must {nearness} the recomputed one; {proven}"
        return f"the recomputed number must {nearness} the printed number"


@dataclass(frozen=True)
class Record:
    """What a notebook found for a claim, or a number without a printed one for the prose.

    Attributes
    ----------
    id : str
        The claim's id, or a name of its own.
    value : float
        The recomputed number, in `unit`.
    low, high : float
        The ends of its interval: 95 % over seeds for a simulation, the propagated rounding of
        printed inputs for arithmetic; both equal `value` where there is none.
    unit : str
        Unit of the number.
    verdict : str
        The verdict; ``result`` for a number without a printed one. If the book says otherwise and
        `RECORD_MISMATCHES` is set, the objection follows: ``disagrees: not within 0.05 of 7.5,
        which the book says``.
    digits : int
        Decimal places to show at most.
    notebook : str
        The notebook that recorded it, as its record's file is called; empty without a record.
    cell : int
        The cell that recorded it, as IPython counts what it runs; 0 outside of a notebook.
    """

    id: str
    value: float
    low: float
    high: float
    unit: str
    verdict: str
    digits: int
    notebook: str = ""
    cell: int = 0

    def __str__(self) -> str:
        half = (self.high - self.low) / 2
        if half and abs(self.high + self.low - 2 * self.value) < 1e-6 * half:
            return f"{with_error(self.value, half)} {self.unit}".rstrip()
        ends = (self.value, self.low, self.high)
        text, low, high = (_text(number, half, self.digits) for number in ends)
        between = f" ({low} to {high})" if half else ""
        return f"{text}{between} {self.unit}".rstrip()


def with_error(value: float, half_width: float) -> str:
    """Write a number and the half-width of its interval, to two digits of that.

    Parameters
    ----------
    value, half_width : float
        The number and the half-width of its interval, above 0.

    Returns
    -------
    str
        Both to the same place; below 1e-5 in powers of ten.

    Examples
    --------
    >>> from compendium.ledger import with_error
    >>> with_error(201173.2, 1290.0), with_error(-2.79268, 0.009)
    ('201200 ± 1300', '-2.7927 ± 0.0090')
    >>> with_error(-8.39877e-10, 1.7e-12)
    '(-8.399 ± 0.017)·10⁻¹⁰'
    """
    power = math.floor(math.log10(abs(value))) if 0 < abs(value) < 1e-5 else 0
    parts = [part / 10**power for part in (value, half_width)]
    text = " ± ".join(_text(part, parts[1]) for part in parts)
    return f"({text})·10{str(power).translate(_RAISED)}" if power else text


def _text(value: float, error: float, most: int = 99) -> str:
    """Write a number to the second digit of its error, or to `most` decimals if they are fewer.

    A number without an interval takes them all. A tiny one, such as a distortion per µm², reads
    better in powers of ten.
    """
    if most > 7 and 0 < abs(value) < 1e-5:
        return f"{value:.2e}"
    decimals = min(most, 1 - math.floor(math.log10(error))) if error > 0 else most
    return f"{round(value, decimals):.{max(0, decimals)}f}"


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
        If the data file is missing.

    Examples
    --------
    >>> from compendium.ledger import claims
    >>> claims()["table-5.6/E"].printed
    '1.3237'
    """
    entries, result = _read("claims.toml"), {}
    for name, entry in entries.items():
        fields = dict(entry)
        if other := fields.pop("printed_in", ""):
            fields["printed"] = entries[other]["printed"]
        result[name] = Claim(id=name, **fields)
    return result


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
    >>> from compendium.ledger import claim
    >>> claim("table-5.6/w_d").value
    121.22
    """
    if id not in claims():
        raise ValueError(f"id must name a claim of claims.toml, got {id!r}")
    return claims()[id]


def errata() -> Mapping[str, Mapping[str, str]]:
    """Read the faults of the thesis.

    Returns
    -------
    mapping of str to mapping
        By id: ``title``, ``where``, ``printed`` (a quotation), ``corrected``, ``proof``, ``origin``
        (certain, printing or text recognition, or a matter of reading), and perhaps ``reading``, in
        which nothing is wrong, and ``reaches``, which result it changes.

    Examples
    --------
    >>> from compendium.ledger import errata
    >>> errata()["table-5.6-zeta"]["printed"]
    '“ζ (c/a) 44.78”'
    """
    return _read("errata.toml")


def causes() -> Mapping[str, Mapping[str, str]]:
    """Read the causes of the claims that disagree.

    Returns
    -------
    mapping of str to mapping
        By id: ``title``, ``text``, and perhaps ``reaches``, which result the cause changes.

    Examples
    --------
    >>> from compendium.ledger import causes
    >>> causes()["probe-ratio"]["title"]
    'The printed ratio ζ is a number of another table'
    """
    return _read("causes.toml")


def part_of(claim: Claim) -> str:
    """Return the part of the thesis that a claim belongs to, a title that begins with its number.

    Parameters
    ----------
    claim : Claim
        The claim.

    Returns
    -------
    str
        One of the parts in ``parts.toml``.

    Examples
    --------
    >>> from compendium.ledger import claim, part_of
    >>> part_of(claim("table-5.6/E"))
    '5.6 Stiffness of the embryo'
    """
    parts = _read("parts.toml").items()
    return next(part for part, starts in parts if claim.id.startswith(tuple(starts)))


def judge(claim: Claim, value: float, low: float, high: float) -> str:
    """Compare a computed number with its claim.

    Parameters
    ----------
    claim : Claim
        What was printed.
    value : float
        The computed number, in the claim's unit.
    low, high : float
        Ends of its interval, by which simulations and sentences are judged. Arithmetic is judged by
        `value` alone.

    Returns
    -------
    str
        One of `VERDICTS`.

    Raises
    ------
    ValueError
        If nothing was compared for this claim.

    Examples
    --------
    >>> from compendium.ledger import claim, judge
    >>> judge(claim("table-5.6/E"), 1.32372, 1.32372, 1.32372)
    'agrees'
    >>> judge(claim("table-5.6/w_d"), 120.0, 120.0, 120.0)
    'disagrees'
    """
    if not claim.compared:
        raise ValueError(f"{claim.id} is not compared; no number can judge it")
    decides = True  # whether the interval is narrow enough to say anything
    if claim.limit:
        compare = _COMPARISONS[claim.limit.split()[0]]
        holds = compare(value, claim.value)
        decides = compare(low, claim.value) == compare(high, claim.value)
    elif claim.compared == "arithmetic":
        holds = abs(value - claim.value) <= claim.tolerance
    elif claim.bound:
        holds = claim.value >= low if claim.bound == "lower" else claim.value <= high
    else:
        holds = low <= claim.value <= high
        most = MAX_RELATIVE_HALF_WIDTH_OF_INPUT if claim.given else MAX_RELATIVE_HALF_WIDTH
        decides = not holds or (high - low) / 2 <= most * abs(claim.value)
    if claim.undecided or not decides:
        return "cannot tell"
    if not holds:  # what depends on something not printed is no contradiction
        return "cannot tell" if claim.star else "disagrees"
    if claim.bound:
        return "cannot tell"
    return "input" if claim.given else "fitted" if claim.fitted else "agrees"


def check_stated_verdict(claim: Claim, value: float, low: float, high: float) -> tuple[str, str]:
    """Judge a computed number, and compare the verdict with the one that the book states.

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
    >>> from compendium.ledger import check_stated_verdict, claim
    >>> check_stated_verdict(claim("table-3.1/planar"), 6.0, 6.0, 6.0)
    ('disagrees', 'disagrees, but the book says agrees')
    """
    verdict = judge(claim, value, low, high)
    if verdict != claim.verdict:
        return verdict, f"{verdict}, but the book says {claim.verdict}"
    found = float(claim.corrected or claim.recomputed)
    within = claim.tolerance if claim.corrected else claim.within
    if not math.isnan(found) and not abs(value - found) <= within:
        return verdict, f"not within {within:g} of {found:g}, which the book says"
    return verdict, ""


@dataclass
class _Session:
    """Where `check` and `report` of this process write, and what they have written so far."""

    path: Path | None = None
    records: dict[str, Record] = field(default_factory=dict)

    def add(self, record: Record) -> Record:
        """Keep a record with its cell; a later record of an id replaces the earlier one."""
        # The library's tests read claims where IPython is not installed.
        shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        cell = len(shell.user_ns["In"]) - 1 if shell else 0  # its count may be the next cell's
        notebook = self.path.stem if self.path else ""
        self.records[record.id] = replace(record, notebook=notebook, cell=cell)
        self.write()
        return record

    def write(self) -> None:
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        records = [asdict(record) for record in self.records.values()]
        text = json.dumps(records, indent=1, ensure_ascii=False) + "\n"
        replace_file(self.path, lambda file: file.write_text(text, encoding="utf-8"))


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
    _session.write()


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
        The computed number, in the claim's unit; 1 or 0 for a predicate that simply holds or not.
    uncertainty : float
        Half-width of the interval around it: of the 95 % interval over seeds for a simulation, of
        the propagated rounding of the printed inputs for arithmetic.
    interval : tuple of float, optional
        Both ends, where they do not lie evenly around `value`.

    Returns
    -------
    Record
        The verdict with the computed number.

    Raises
    ------
    ClaimError
        If the verdict is not the one that ``claims.toml`` states, or the number differs by another
        amount than it states.
    ValueError
        If there is no such claim, the value is not finite, or a simulated number comes without an
        interval.

    Examples
    --------
    >>> from compendium.ledger import check
    >>> print(check("table-5.6/E", 1.32372))
    1.32372 MPa
    """
    stated = claim(id)
    low, high = interval or (value - uncertainty, value + uncertainty)
    if not all(math.isfinite(number) for number in (value, low, high)):
        raise ValueError(f"value of {id} must be finite, got {value} in [{low}, {high}]")
    if not low <= value <= high:
        raise ValueError(f"interval of {id} must contain its value, got {value} in [{low}, {high}]")
    if stated.compared == "simulation" and not stated.limit and low == high:
        raise ValueError(f"{id} is simulated and needs an interval, got a bare {value}")
    if stated.limit:
        # No printed digits say how many to show: four in all, and three decimals at most.
        shown = min(3, max(0, 3 - math.floor(math.log10(abs(value))))) if value else 3
    else:  # one place more than printed
        shown = max(0, 1 - int(Decimal(stated.corrected or stated.printed).as_tuple().exponent))
    verdict, objection = check_stated_verdict(stated, value, low, high)
    if objection and not os.environ.get(RECORD_MISMATCHES):
        printed = f"printed {stated.printed or stated.limit} {stated.unit}".rstrip()
        if stated.corrected:
            printed += f", corrected to {stated.corrected} {stated.unit}".rstrip()
        raise ClaimError(
            f"claim {id}, {stated.what} ({stated.where}): {printed}, recomputed "
            f"{value:.8g} in [{low:.8g}, {high:.8g}]: {objection}"
        )
    verdict = f"{verdict}: {objection}" if objection else verdict
    numbers = (float(value), float(low), float(high))
    return _session.add(Record(id, *numbers, stated.unit, verdict, shown))


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
    with np.errstate(invalid="ignore"):
        difference = np.where(finite, np.abs(printed - found), np.inf)
    excess = difference - (atol + rtol * size + rounding)
    worst = np.unravel_index(excess.argmax(), excess.shape)
    if excess[worst] > 0:
        place = f" at {tuple(int(k) for k in worst)}" if worst else ""
        raise ClaimError(
            f"equation ({number}): the formula gives {printed[worst]:.10g}, the library "
            f"{found[worst]:.10g}{place}; they differ by {difference[worst]:.3g}, and at most "
            f"{difference.max():.3g} over {printed.size} numbers"
        )


def report(id: str, value: float, unit: str = "", *, digits: int = 2) -> Record:
    """Record a number that has no printed counterpart, so that the prose can quote it.

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
    >>> from compendium.ledger import report
    >>> print(report("4/example", 1.27791, digits=2))
    1.28
    """
    if id in claims():
        raise ValueError(f"id must not be that of a claim, got {id!r}")
    if not math.isfinite(value):
        raise ValueError(f"value of {id} must be finite, got {value}")
    number = float(value)
    return _session.add(Record(id, number, number, number, unit, "result", digits))


def summary(prefix: str = "") -> pd.DataFrame:
    """Tabulate what this notebook has checked so far.

    Parameters
    ----------
    prefix : str
        Only claims whose id begins with it, ``table-5.6``.

    Returns
    -------
    pandas.DataFrame
        One row for each claim, by its id: quantity, printed, recomputed, unit, verdict.
    """
    rows = {
        record.id: {
            "quantity": stated.what,
            "printed": stated.printed,
            "recomputed": str(replace(record, unit="")),
            "unit": stated.unit,
            "verdict": stated.label,
        }
        for record in _session.records.values()
        if record.id.startswith(prefix) and (stated := claims().get(record.id)) is not None
    }
    columns = ["quantity", "printed", "recomputed", "unit", "verdict"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    return table.rename_axis(columns="claim")


def read_records(folder: str | os.PathLike[str]) -> dict[str, Record]:
    """Read the records of all notebooks.

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
        for entry in json.loads(path.read_text(encoding="utf-8")):
            if entry["id"] in records:
                raise ValueError(f"{entry['id']} is recorded twice, the second time in {path.name}")
            records[entry["id"]] = Record(**entry)
    return records


def scorecard(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Tabulate every claim with what the notebooks recorded for it.

    Parameters
    ----------
    folder : path-like
        Folder of records, as for `read_records`.

    Returns
    -------
    pandas.DataFrame
        One row a claim in the thesis' order: claim, part (from `part_of`),
        where, quantity, printed, recomputed, low, high, unit, verdict, star, fitted, undecided,
        cause, compared, rule, reason, corrected, says, note, test. The column verdict has the
        verdict that ``claims.toml`` states, and not that of a record.

    Examples
    --------
    >>> from compendium.ledger import scorecard
    >>> table = scorecard("no/such/folder")
    >>> table.loc[table["claim"] == "table-5.6/E", "printed"].item()
    '1.3237'
    """
    records, rows = read_records(folder), []
    names = ["unit", "verdict", "star", "fitted", "undecided", "cause", "compared", "rule"]
    names += ["reason", "corrected", "says", "note", "test"]
    for stated in claims().values():
        part, where = part_of(stated), stated.where
        row: dict[str, Any] = {"claim": stated.id, "part": part, "where": where}
        row |= {"quantity": stated.what, "printed": stated.printed}
        row |= {"recomputed": "", "low": math.nan, "high": math.nan}
        if found := records.get(stated.id):
            text = str(replace(found, unit=""))
            row |= {"recomputed": text, "low": found.low, "high": found.high}
        rows.append(row | {name: getattr(stated, name) for name in names})
    return pd.DataFrame(rows)


@cache
def _read(name: str) -> dict:
    path = _THESIS / name
    if not path.exists():
        raise ValueError(f"{name} must lie in data/thesis beside the package; run from a checkout")
    with path.open("rb") as file:
        return tomllib.load(file)
