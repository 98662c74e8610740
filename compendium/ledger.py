"""What the thesis prints and states, and this book's verdict on it.

``data/thesis/claims.toml`` holds every printed number and every sentence that states a result,
once. A claim is of one of four kinds, which are also the verdicts (`Verdict`):

- `Follows`: printed numbers and formulas, or mathematics alone, give it, within the rounding.
- `Contradicts`: the same prove it wrong, in every reading that the row names. No
  limit and no assumption of ours takes part; the proof is one line.
- `Possible`: a run with named assumptions gives it. An assumption that was chosen to
  obtain the printed number, or so that the sentence holds, is named first.
- `Open`: what was published does not decide it.

A `Setting`, of ``settings.toml``, is a number that computations were fed with. It is listed and not
counted. A notebook computes a number and calls `check`, which compares it in the way of the claim's
kind, raises if the result is not the verdict that the book states, and writes a record. The book's
pages, tables and prose are made from these records.
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
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from microlib._common import replace_file

#: Set to make `check` record a number that does not give the stated verdict instead of failing.
RECORD_MISMATCHES = "COMPENDIUM_RECORD_MISMATCHES"
#: Largest effect of the rounding of printed numbers on a number that follows from them, over it.
LARGEST_ROUNDING = 0.01

_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_THESIS = Path(__file__).resolve().parent.parent / "data" / "thesis"
_COMPARISONS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
_IN_WORDS = {">=": "at least", "<=": "at most", ">": "above", "<": "below"}


class ClaimError(AssertionError):
    """A computed number does not lead to the verdict that the book states for its claim."""


class Verdict(Enum):
    """The verdicts in the order of the book's tables: what says most about the thesis comes first.

    Attributes
    ----------
    word : str
        The verdict as pages and ``claims.toml`` write it.
    sign : str
        What stands for it where there is no room for a word.
    color : str
        Its color in figures, a name of `compendium.figures.style.COLORS`.
    """

    CONTRADICTS = ("contradicts", "✗", "orange")
    OPEN = ("open", "?", "pink")
    POSSIBLE = ("possible", "≈", "yellow")
    FOLLOWS = ("follows", "✓", "green")

    def __init__(self, word: str, sign: str, color: str) -> None:
        self.word, self.sign, self.color = word, sign, color


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What every claim and every setting has.

    Attributes
    ----------
    id : str
        Where it stands and what it is, ``table-5.6/E``.
    what : str
        The quantity in words.
    where : str
        Table, section or chapter of the thesis; by default the one in the id.
    printed : str
        The number as printed, so that its last place is known, or the printed condition, ``< 1``;
        empty if the thesis prints neither.
    unit : str
        Unit of the number; empty for pure numbers.
    says : str
        What the thesis says there, in other words.
    note : str
        What a reader should know besides.
    test : str
        A test that shows more than the check in the notebook, such as a known truth that is
        recovered, as pytest names it.
    """

    id: str
    what: str
    where: str
    printed: str = ""
    unit: str = ""
    says: str = ""
    note: str = ""
    test: str = ""

    verdict: ClassVar[Verdict | None] = None

    @property
    def label(self) -> str:
        """The word of the verdict."""
        return self.verdict.word if self.verdict else "setting"

    @property
    def sign(self) -> str:
        """The sign of the verdict."""
        return self.verdict.sign if self.verdict else "•"

    @property
    def condition(self) -> str:
        """What a recomputed number must fulfill, ``< 1``; empty if it is compared with a number."""
        return self.printed if self.printed.startswith((">", "<")) else ""

    @property
    def value(self) -> float:
        """The printed number, or that of the condition."""
        return float((self.condition or self.printed).split()[-1])

    @property
    def compared(self) -> bool:
        """Whether a notebook must record a number for it."""
        return False

    def objection(self, value: float, low: float, high: float) -> str:
        """Return why a number and its interval do not give the verdict; empty if they do."""
        raise ValueError(f"{self.id} is not compared; no number can be checked")

    def explanations(self) -> dict[str, str]:
        """Return the fields of its kind for a reader, by what they are."""
        return {}


class Setting(Entry):
    """A number that computations were fed with, or a device. It is no result of the thesis."""

    def objection(self, value: float, low: float, high: float) -> str:
        """Return why a simulation that was fed with the number does not recover it."""
        return _misses(self, low, high)


@dataclass(frozen=True, kw_only=True)
class Compared(Entry):
    """A claim that a recomputed number is compared with.

    Attributes
    ----------
    limit : str
        Of a sentence, the condition on the recomputed number, ``> 1``.
    """

    limit: str = ""

    @property
    def condition(self) -> str:
        return self.limit or super().condition

    @property
    def compared(self) -> bool:
        return True


@dataclass(frozen=True, kw_only=True)
class Follows(Compared):
    """A claim that printed numbers and formulas, or mathematics alone, give within the rounding.

    The number may differ by half a unit in the last printed place, and by what the rounding of the
    printed inputs can change.
    """

    verdict = Verdict.FOLLOWS

    def objection(self, value: float, low: float, high: float) -> str:
        if self.condition:
            return _unfulfilled(self, low, high)
        if high - low > 2 * LARGEST_ROUNDING * abs(value):
            return f"rounding must not change it by more than {LARGEST_ROUNDING:.0%}"
        near = abs(value - self.value) <= half_ulp(self.printed) + (high - low) / 2
        return "" if near else "it differs by more than the rounding of the printed numbers"

    def explanations(self) -> dict[str, str]:
        rule = "the difference must be within the rounding of the printed numbers"
        return {"Rule": _in_words(self) if self.condition else rule}


@dataclass(frozen=True, kw_only=True)
class Contradicts(Compared):
    """A claim that printed numbers and formulas, or mathematics, prove wrong in each known reading.

    Attributes
    ----------
    proof : str
        The contradiction in one line.
    cause : str
        An entry of ``causes.toml``, which several claims may have in common.
    readings : str
        The readings in which it was tried, if the text allows several.
    corrected : str
        The right value, if it is proven.
    recomputed, within : float
        The number found, and how far a later run may deviate from it; by default `corrected`, and
        half a unit in its last place.
    """

    proof: str
    cause: str
    readings: str = ""
    corrected: str = ""
    recomputed: float = math.nan
    within: float = math.nan

    verdict = Verdict.CONTRADICTS

    def objection(self, value: float, low: float, high: float) -> str:
        if self.condition:
            holds = any(_fulfills(self.condition, end) for end in (low, high))
        else:
            holds = abs(value - self.value) <= half_ulp(self.printed) + (high - low) / 2
        if holds:
            return "it does not contradict what is printed"
        if self.corrected:
            return _moved(value, float(self.corrected), half_ulp(self.corrected))
        return _moved(value, self.recomputed, self.within)

    def explanations(self) -> dict[str, str]:
        right = f"{self.corrected} {self.unit}".rstrip() if self.corrected else ""
        return {"Proof": self.proof, "Right": right, "Meanings that we tried": self.readings}


@dataclass(frozen=True, kw_only=True)
class Possible(Compared):
    """A claim that a run with named assumptions gives.

    Attributes
    ----------
    chosen : str
        The assumption that was chosen to obtain the printed number or sentence, if one was.
    assumes : str
        The other assumptions: inputs that are not printed, and the meaning of words.
    """

    chosen: str = ""
    assumes: str = ""

    verdict = Verdict.POSSIBLE

    def objection(self, value: float, low: float, high: float) -> str:
        if self.condition:
            return _unfulfilled(self, low, high)
        return _misses(self, low, high)

    def explanations(self) -> dict[str, str]:
        why = "to obtain the printed number" if self.printed else "so that the sentence holds"
        chosen = {f"Chosen {why}": self.chosen, "Assumes": self.assumes}
        return chosen | ({"Rule": _in_words(self)} if self.condition else {})


@dataclass(frozen=True, kw_only=True)
class Open(Entry):
    """A claim that what was published does not decide.

    Attributes
    ----------
    found : str
        What was found.
    decides : str
        What would decide it.
    recomputed, within : float
        The number that a notebook records, if one does, and how far a later run may deviate from
        it: for a simulation, four standard deviations over seeds.
    """

    found: str
    decides: str
    recomputed: float = math.nan
    within: float = math.nan

    verdict = Verdict.OPEN

    @property
    def compared(self) -> bool:
        return not math.isnan(self.recomputed)

    def objection(self, value: float, low: float, high: float) -> str:
        if not self.compared:
            return super().objection(value, low, high)
        return _moved(value, self.recomputed, self.within)

    def explanations(self) -> dict[str, str]:
        return {"Found": self.found, "Would decide it": self.decides}


Claim = Follows | Contradicts | Possible | Open
KINDS = {kind.verdict.word: kind for kind in (Follows, Contradicts, Possible, Open)}
#: The labels in the order of the book's tables.
ORDER = (*(verdict.word for verdict in Verdict), "setting")


def _fulfills(condition: str, number: float) -> bool:
    sign, limit = condition.split()
    return bool(_COMPARISONS[sign](number, float(limit)))


def _in_words(entry: Entry) -> str:
    sign, limit = entry.condition.split()
    return f"the recomputed number must be {_IN_WORDS[sign]} {limit} {entry.unit}".rstrip()


def _unfulfilled(entry: Entry, low: float, high: float) -> str:
    holds = all(_fulfills(entry.condition, end) for end in (low, high))
    return "" if holds else _in_words(entry)


def _misses(entry: Entry, low: float, high: float) -> str:
    """Return why an interval does not give a printed number, or says nothing about it."""
    if (high - low) / 2 > abs(entry.value):
        return "the half-width of its interval is larger than the printed number"
    rounding = half_ulp(entry.printed)
    inside = low - rounding <= entry.value <= high + rounding
    return "" if inside else "its interval does not contain the printed number"


def _moved(value: float, found: float, within: float) -> str:
    near = abs(value - found) <= within
    return "" if near else f"it is not within {within:g} of {found:g}, which the book says"


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
        printed inputs otherwise; both equal `value` where there is none.
    unit : str
        Unit of the number.
    verdict : str
        The verdict; ``setting`` for a setting that a simulation recovers, ``result`` for a number
        without a printed one. If the number does not give the verdict and `RECORD_MISMATCHES` is
        set, the objection follows.
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

    Both go to the same place; below 1e-5 they are in powers of ten.

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
    """Read all claims, by id, in the order of the thesis.

    Raises
    ------
    ValueError
        If a claim has no verdict, a field that its kind has not, or lacks one that its kind needs.

    Examples
    --------
    >>> from compendium.ledger import claims
    >>> claims()["table-5.6/E"].printed
    '1.3237'
    """
    entries, result = read_toml("claims.toml"), {}
    for id, entry in entries.items():
        # Claims that are like an earlier one state what differs.
        fields = entries[entry["like"]] | entry if "like" in entry else dict(entry)
        fields.pop("like", None)
        word = fields.pop("verdict", "")
        if word not in KINDS:
            raise ValueError(f"verdict of {id} must be one of {', '.join(KINDS)}, got {word!r}")
        result[id] = _make(KINDS[word], id, fields)
    return result


@cache
def settings() -> Mapping[str, Setting]:
    """Read all settings, by id, in the order of the thesis."""
    return {id: _make(Setting, id, entry) for id, entry in read_toml("settings.toml").items()}


def _make(kind: type[Any], id: str, fields: Mapping[str, Any]) -> Any:
    place, _, number = id.split("/")[0].partition("-")
    if place == "section" and "." not in number:
        place = "chapter"
    given = {"id": id, "where": f"{place.capitalize()} {number}".rstrip(), **fields}
    try:
        return kind(**given)
    except TypeError as error:  # a field too many or too few
        raise ValueError(f"{id} must be a {kind.__name__}: {error}") from None


def claim(id: str) -> Claim | Setting:
    """Return one claim or setting by its id; raise ValueError if there is none.

    Examples
    --------
    >>> from compendium.ledger import claim
    >>> claim("table-5.6/w_d").value
    121.22
    """
    found = claims().get(id) or settings().get(id)
    if found is None:
        raise ValueError(f"id must name an entry of claims.toml or settings.toml, got {id!r}")
    return found


def errata() -> Mapping[str, Mapping[str, str]]:
    """Read the faults of the thesis, by id; ``errata.toml`` says which fields they have.

    Examples
    --------
    >>> from compendium.ledger import errata
    >>> errata()["table-5.6-zeta"]["printed"]
    '“ζ (c/a) 44.78”'
    """
    return read_toml("errata.toml")


def causes() -> Mapping[str, Mapping[str, str]]:
    """Read the causes of contradictions, by id; ``causes.toml`` says which fields they have.

    Examples
    --------
    >>> from compendium.ledger import causes
    >>> causes()["probe-ratio"]["title"]
    'The printed ratio ζ is a number of another table'
    """
    return read_toml("causes.toml")


def part_of(entry: Entry) -> str:
    """Return the part of the thesis that an entry belongs to, a title that begins with its number.

    Examples
    --------
    >>> from compendium.ledger import claim, part_of
    >>> part_of(claim("table-5.6/E"))
    '5.6 Stiffness of the embryo'
    """
    parts = read_toml("parts.toml").items()
    return next(part for part, starts in parts if entry.id.startswith(tuple(starts)))


def write_json(path: Path, content: object) -> None:
    """Write a JSON file at once, so that no reader sees a part of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    replace_file(path, lambda file: file.write_text(text, encoding="utf-8"))


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
        if self.path is not None:
            write_json(self.path, [asdict(record) for record in self.records.values()])


_session = _Session()


def open_record(path: str | os.PathLike[str]) -> None:
    """Begin a notebook's record.

    They go to a JSON file, which replaces an older one of the same name; an empty path is for none.
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
    """Compare a computed number with its claim, in the way of the claim's kind, and record it.

    Parameters
    ----------
    id : str
        The claim, ``table-5.6/E``, or a setting that a simulation recovers.
    value : float
        The computed number, in the claim's unit; 1 or 0 for a predicate that simply holds or not.
    uncertainty : float
        Half-width of the interval around it: of the 95 % interval over seeds for a simulation, of
        the propagated rounding of the printed inputs otherwise.
    interval : tuple of float, optional
        Both ends, where they do not lie evenly around `value`.

    Returns
    -------
    Record
        The computed number with the verdict.

    Raises
    ------
    ClaimError
        If the number does not give the verdict that ``claims.toml`` states.
    ValueError
        If there is no such claim, nothing is compared for it, or the value is not finite.

    Examples
    --------
    >>> from compendium.ledger import check
    >>> print(check("table-5.6/E", 1.32372))
    1.32372 MPa
    """
    entry = claim(id)
    low, high = interval or (value - uncertainty, value + uncertainty)
    if not all(math.isfinite(number) for number in (value, low, high)):
        raise ValueError(f"value of {id} must be finite, got {value} in [{low}, {high}]")
    if not low <= value <= high:
        raise ValueError(f"interval of {id} must contain its value, got {value} in [{low}, {high}]")
    digits = (isinstance(entry, Contradicts) and entry.corrected) or entry.printed
    if entry.condition or not digits:
        # No printed digits say how many to show: four in all, and three decimals at most.
        shown = min(3, max(0, 3 - math.floor(math.log10(abs(value))))) if value else 3
    else:  # one place more than printed, and none for a count
        exponent = int(Decimal(digits).as_tuple().exponent)
        counted = exponent >= 0 and low == high and float(value).is_integer()
        shown = 0 if counted else max(0, 1 - exponent)
    objection = entry.objection(value, low, high)
    if objection and not os.environ.get(RECORD_MISMATCHES):
        printed = f"printed {entry.condition or entry.printed or 'without a number'}"
        raise ClaimError(
            f"claim {id}, {entry.what} ({entry.where}): {printed} {entry.unit}".rstrip()
            + f", recomputed {value:.8g} in [{low:.8g}, {high:.8g}]; the book says "
            f"“{entry.label}”, but {objection}"
        )
    verdict = f"{entry.label}: {objection}" if objection else entry.label
    return _session.add(
        Record(id, float(value), float(low), float(high), entry.unit, verdict, shown)
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

    Examples
    --------
    >>> from compendium.ledger import check_equation
    >>> from microlib.membrane import elastic_modulus, indentation_force
    >>> membrane = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    >>> modulus = elastic_modulus(100.0, 250.0, 10.0, **membrane)
    >>> check_equation("4.7", 100.0, indentation_force(modulus, 250.0, 10.0, **membrane))
    """
    if f"equation-{number}" not in read_toml("map.toml"):
        raise ValueError(f"number must be that of an equation of the thesis, got {number!r}")
    printed, found = np.asarray(formula, float), np.asarray(library, float)
    if not printed.size or not np.isfinite(printed).all():
        raise ValueError(f"formula of ({number}) must give finite numbers, got {printed}")
    allowed = atol + 64 * np.finfo(float).eps * np.abs(printed).max()
    name = f"equation ({number}): the library (ACTUAL) is not the formula (DESIRED)"
    np.testing.assert_allclose(found, printed, rtol, allowed, err_msg=name, strict=True)


def report(
    id: str, value: float, unit: str = "", *, digits: int = 2, toward: float = 0.0
) -> Record:
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
    toward : float
        Where to round the last of them: -inf for what the prose calls “at least”, inf for “at
        most”; 0 for the nearest.

    Examples
    --------
    >>> import math
    >>> from compendium.ledger import report
    >>> print(report("4/example", 1.27791, digits=2))
    1.28
    >>> print(report("4/example", 1.27791, digits=2, toward=-math.inf))
    1.27
    """
    if id in {**claims(), **settings()}:
        raise ValueError(f"id must not be that of a claim, got {id!r}")
    if not math.isfinite(value):
        raise ValueError(f"value of {id} must be finite, got {value}")
    number = float(value)
    if toward:
        number = (math.floor if toward < 0 else math.ceil)(number * 10**digits) / 10**digits
    return _session.add(Record(id, number, number, number, unit, "result", digits))


def summary(prefix: str = "") -> pd.DataFrame:
    """Tabulate what this notebook has checked so far, of claims whose id begins with `prefix`."""
    rows = {
        record.id: {
            "quantity": entry.what,
            "printed": entry.printed,
            "recomputed": str(replace(record, unit="")),
            "unit": entry.unit,
            "verdict": entry.label,
        }
        for record in _session.records.values()
        if record.id.startswith(prefix)
        and (entry := claims().get(record.id) or settings().get(record.id)) is not None
    }
    columns = ["quantity", "printed", "recomputed", "unit", "verdict"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    return table.rename_axis(columns="claim")


def read_records(folder: str | os.PathLike[str]) -> dict[str, Record]:
    """Read the records of all notebooks, by id, from the folder of the files of `open_record`."""
    records: dict[str, Record] = {}
    for path in sorted(Path(folder).glob("*.json")):
        for entry in json.loads(path.read_text(encoding="utf-8")):
            if entry["id"] in records:
                raise ValueError(f"{entry['id']} is recorded twice, the second time in {path.name}")
            records[entry["id"]] = Record(**entry)
    return records


def scorecard(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Tabulate every claim and setting with what the notebooks recorded for it.

    Parameters
    ----------
    folder : path-like
        Folder of records, as for `read_records`.

    Returns
    -------
    pandas.DataFrame
        One row a claim in the thesis' order, then the settings: claim, part (from `part_of`),
        where, quantity, printed, unit, says, recomputed, low, high, verdict, explanation (the
        fields of its kind, in words), note, test. The verdict is the one that ``claims.toml``
        states.

    Examples
    --------
    >>> from compendium.ledger import scorecard
    >>> table = scorecard("no/such/folder")
    >>> table.loc[table["claim"] == "table-5.6/E", "printed"].item()
    '1.3237'
    """
    records, rows = read_records(folder), []
    for entry in (*claims().values(), *settings().values()):
        row: dict[str, Any] = {"claim": entry.id, "part": part_of(entry), "where": entry.where}
        row |= {"quantity": entry.what, "printed": entry.printed, "unit": entry.unit}
        row |= {"says": entry.says, "recomputed": "", "low": math.nan, "high": math.nan}
        if found := records.get(entry.id):
            text = str(replace(found, unit=""))
            row |= {"recomputed": text, "low": found.low, "high": found.high}
        told = [f"{what}: {text}" for what, text in entry.explanations().items() if text]
        row |= {"verdict": entry.label, "explanation": "; ".join(told)}
        rows.append(row | {"note": entry.note, "test": entry.test})
    return pd.DataFrame(rows)


@cache
def read_toml(name: str) -> dict:
    """Read a file of ``data/thesis``."""
    return tomllib.loads((_THESIS / name).read_text(encoding="utf-8"))
