"""The ledger: what it judges, what it refuses, and that every exact claim's check can fail."""

from __future__ import annotations

import json
import math
import re
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from compendium import ledger
from microlib.embryo import GaussianSum, dimple_geometry
from microlib.membrane import SmallSlopeWarning, elastic_modulus

ROOT = Path(__file__).resolve().parents[2]


def make(**changes: object) -> ledger.Claim:
    fields = {
        "id": "x",
        "what": "",
        "where": "",
        "kind": "exact",
        "verdict": "pending",
        "printed": "2.50",
    }
    return ledger.Claim(**fields | changes)


STATED = {
    "kind": "stated",
    "printed": "",
    "says": "s",
    "limit": "> 1",
    "limit_of": "ours",
    "reason": "r",
}


@pytest.mark.parametrize(
    ("printed", "half"),
    [("1.3237", 5e-5), ("3", 0.5), ("-8.4e-10", 5e-12), ("200490", 0.5), ("28.60", 5e-3)],
)
def test_half_ulp_counts_printed_places(printed: str, half: float) -> None:
    assert ledger.half_ulp(printed) == pytest.approx(half, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "numbers", "verdict"),
    [
        ({}, (2.5049, 2.5049, 2.5049), "reproduced"),
        ({}, (2.5051, 2.0, 3.0), "differs"),  # an interval does not widen an exact tolerance
        ({"kind": "simulated"}, (2.4, 2.3, 2.5), "consistent"),
        ({"kind": "simulated"}, (2.4, 2.3, 2.49), "differs"),
        ({"kind": "simulated"}, (2.4, -1.0, 6.0), "inconclusive"),
        (STATED | {"limit": ">= 0.5"}, (0.5, 0.5, 0.5), "consistent"),
        (STATED | {"limit": "> 0.5"}, (0.5, 0.5, 0.5), "differs"),
        ({"kind": "bound", "side": "lower"}, (2.6, 2.45, 2.7), "bounded"),
        ({"kind": "bound", "side": "lower"}, (2.6, 2.55, 2.7), "differs"),
        ({"kind": "bound", "side": "upper"}, (2.4, 2.3, 2.55), "bounded"),
        ({"kind": "bound", "side": "upper"}, (2.4, 2.3, 2.45), "differs"),
        ({"verdict": "erratum", "corrected": "7.5"}, (7.52, 7.52, 7.52), "erratum"),
        ({"verdict": "erratum", "corrected": "7.5"}, (2.5, 2.5, 2.5), "differs"),
        ({"verdict": "erratum", "corrected": "2.504"}, (2.504, 2.504, 2.504), "differs"),
    ],
)
def test_judgement(changes: dict, numbers: tuple, verdict: str) -> None:
    assert ledger.judge(make(**changes), *numbers) == verdict


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "guess"}, "kind of x must be one of"),
        ({"verdict": "fine"}, "verdict of x must be one of"),
        ({"spent": "some"}, "spent of x must be one of"),
        ({"verdict": "erratum"}, "if and only if it is an erratum"),
        ({"corrected": "3"}, "if and only if it is an erratum"),
        ({"verdict": "differs", "ours": 1.0, "within": 0.1}, "explain its verdict 'differs'"),
        ({"verdict": "differs", "note": "n"}, "must say what ours is"),
        ({"verdict": "differs", "note": "n", "ours": 1.0}, "must say what ours is"),
        ({"verdict": "differs", "note": "n", "ours": 1.0, "within": math.inf}, "say what ours is"),
        ({"ours": 1.0, "within": 0.1}, "must say what ours is"),
        ({"kind": "simulated", "verdict": "inconclusive"}, "explain its verdict"),
        ({"kind": "lost", "verdict": "lost"}, "explain its verdict 'lost'"),
        ({"kind": "lost", "verdict": "reproduced", "note": "n"}, "cannot have the verdict"),
        ({"kind": "exact", "verdict": "given"}, "cannot have the verdict"),
        ({"tolerance": 0.1}, "reason for its tolerance"),
        ({"tolerance": math.inf, "reason": "r"}, "tolerance below half"),
        ({"tolerance": 1.3, "reason": "r"}, "tolerance below half"),
        ({"tolerance": 0.0, "reason": "r"}, "tolerance below half"),
        ({"kind": "simulated", "tolerance": 0.1}, "needs to be exact"),
        ({"kind": "simulated", "widest": 3.0}, "largest width below"),
        ({"kind": "simulated", "widest": math.inf, "reason": "r"}, "largest width below"),
        ({"limit": "> 1"}, "needs a limit"),
        (STATED | {"limit": ""}, "needs a limit"),
        (STATED | {"says": ""}, "what the thesis says"),
        (STATED | {"limit_of": "mine"}, "limit of the thesis or of ours"),
        (STATED | {"reason": ""}, "reason for a limit of ours"),
        (STATED | {"printed": "> 1"}, "must not print a limit that is ours"),
        ({"kind": "bound"}, "needs its side"),
        ({"side": "lower"}, "needs its side"),
        ({"kind": "bound", "side": "left"}, "lower or upper"),
        ({"spent": "assumed"}, "name the input"),
        ({"input": "c"}, "name the input"),
    ],
)
def test_incomplete_claims_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**changes)


@pytest.mark.parametrize("value", [1e9, -1e9, 0.0, 2.0, -2.5])
def test_a_difference_that_changes_is_noticed(value: float) -> None:
    claim = make(verdict="differs", note="n", ours=3.0, within=0.1)
    assert ledger.appraise(claim, 3.05, 3.05, 3.05) == ("differs", "")
    assert "not within 0.1 of 3" in ledger.appraise(claim, value, value, value)[1]


@pytest.mark.parametrize(
    ("formula", "library", "message"),
    [
        (2.0, 2.0 + 1e-6, r"equation \(3.13\): the formula gives 2, the library 2.000001"),
        ([1.0, 5.0], [1.0, -5.0], r"gives 5, the library -5 at \(1,\); they differ by 10"),
        ([1.0, 1e-9], [1.0, 2e-9], "they differ by 1e-09"),
        (1.0, math.nan, "the library nan"),
        (math.inf, math.inf, "the formula gives inf"),
    ],
)
def test_an_equation_that_does_not_hold_is_named(
    formula: object, library: object, message: str
) -> None:
    with pytest.raises(ledger.ClaimError, match=message):
        ledger.check_equation("3.13", formula, library)


def test_an_equation_is_counted_and_is_no_claim(tmp_path: Path) -> None:
    try:
        ledger.open_record(tmp_path / "03.json")
        ledger.check_equation("3.13", [0.1 + 0.2, 1.0], [0.3, 1.0])  # apart by rounding
        ledger.check_equation("3.13", 0.5, 0.51, rtol=0.03)
        ledger.check_equation("3.13", 0.0, 0.01, atol=0.02)
        entries = json.loads((tmp_path / "03.json").read_text())
        assert [entry["verdict"] for entry in entries] == ["checked"] * 3
        assert ledger.read_records(tmp_path) == {}
        assert ledger.summary().empty
    finally:
        ledger.open_record("")
    with pytest.raises(ValueError, match="number must be that of an equation"):
        ledger.check_equation("9.9", 1.0, 1.0)
    with pytest.raises(ValueError, match="must have one shape"):
        ledger.check_equation("3.13", [1.0, 1.0], 1.0)


def test_an_interval_that_says_nothing_is_no_agreement() -> None:
    claim = make(kind="simulated", verdict="consistent")
    assert ledger.appraise(claim, 2.5, 1.3, 3.7) == ("consistent", "")
    assert ledger.appraise(claim, 2.5, -1e12, 1e12)[1].startswith("inconclusive")


def test_turning_points_are_where_the_verdict_turns() -> None:
    claim = make(kind="simulated", verdict="consistent")
    low, high = ledger.turning_points(claim, ledger.Record("x", 2.5, 2.0, 3.0, "", "", 1))
    # The interval leaves 2.5 when its upper end falls to 2.5/3, or its lower end rises to 2.5/2.
    assert low == pytest.approx(2.5 / 3.0, rel=0.011)
    assert high == pytest.approx(2.5 / 2.0, rel=0.011)
    bound = make(kind="bound", side="lower", verdict="bounded")
    low, high = ledger.turning_points(bound, ledger.Record("x", 0.5, 0.5, 0.5, "", "", 1))
    assert low == 0.0
    assert high == pytest.approx(5.0, rel=0.011)


def test_a_tally_records_what_a_check_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ledger.TALLY_VARIABLE, "1")
    try:
        ledger.open_record(tmp_path / "05.json")
        record = ledger.check("table-5.6/E", 1.30)
    finally:
        ledger.open_record("")
    assert record.verdict == "differs: differs, but the book says reproduced"


def test_a_lost_claim_cannot_be_judged() -> None:
    with pytest.raises(ValueError, match="no number can judge it"):
        ledger.judge(make(kind="lost", verdict="lost", note="gone"), 1.0, 1.0, 1.0)


def test_check_records_the_interval_around_its_value() -> None:
    record = ledger.check("table-5.6/E", 1.3237, 0.01)
    assert record is not None
    assert (record.low, record.value, record.high) == pytest.approx((1.3137, 1.3237, 1.3337))
    record = ledger.check("table-5.6/E", 1.3237, interval=(1.32, 1.4))
    assert record is not None
    assert (record.low, record.high) == (1.32, 1.4)


def test_a_bare_value_of_a_simulated_claim_is_refused() -> None:
    """Without an interval over seeds, hitting the print is no agreement and missing it no news."""
    simulated = [claim for claim in ledger.claims().values() if claim.kind == "simulated"]
    assert simulated
    for claim in simulated:
        for given in ({}, {"uncertainty": 0.0}, {"interval": (claim.value, claim.value)}):
            with pytest.raises(ValueError, match=f"{re.escape(claim.id)} is simulated and needs"):
                ledger.check(claim.id, claim.value, **given)


def test_check_names_the_claim_that_fails() -> None:
    with pytest.raises(ledger.ClaimError, match=r"claim table-5\.6/E, .*: printed 1\.3237 MPa"):
        ledger.check("table-5.6/E", 1.31)
    with pytest.raises(ValueError, match="id must name a claim"):
        ledger.check("table-9.9/x", 1.0)
    with pytest.raises(ValueError, match="must be finite"):
        ledger.check("table-5.6/E", math.nan)
    with pytest.raises(ValueError, match="must contain its value"):
        ledger.check("table-5.6/E", 1.3237, interval=(2.0, 3.0))
    with pytest.raises(ValueError, match="must contain its value"):
        ledger.check("table-5.6/E", 1.3237, interval=(0.0, 1.0))
    with pytest.raises(ValueError, match="must not be that of a claim"):
        ledger.report("table-5.6/E", 1.0)


def computed(
    *, pixel_size: float = 4.65 / 1.2, swap: bool = False, rounded: bool = False, without: str = ""
) -> dict[str, float]:
    """Return section 5.6's exact claims, with one fault planted if asked to."""
    x1, y1, x2, y2 = (ledger.claim(f"section-5.6/{k}").value for k in ("x_1", "y_1", "x_2", "y_2"))
    a, depth = pixel_size * (x2 - x1), pixel_size * (y1 - y2)
    if swap:
        a, depth = depth, a
    nu = 0.0 if without == "poisson" else 0.5
    half_width = 2.5 if without == "width" else 25.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SmallSlopeWarning)
        modulus = elastic_modulus(
            197.24, a, depth, thickness=3.0, probe_half_width=half_width, poisson_ratio=nu
        )
    return {
        "table-5.6/w_d": depth,
        "table-5.6/a": a,
        "table-5.6/zeta": half_width / a,
        "table-5.6/E": float(modulus),
    }


def test_section_5_6_follows_from_its_printed_coordinates() -> None:
    for name, value in computed().items():
        assert ledger.check(name, value) is not None


@pytest.mark.parametrize(
    ("fault", "caught"),
    [
        ({"pixel_size": 4.65}, {"table-5.6/w_d", "table-5.6/a", "table-5.6/zeta", "table-5.6/E"}),
        ({"swap": True}, {"table-5.6/w_d", "table-5.6/a", "table-5.6/zeta", "table-5.6/E"}),
        ({"without": "poisson"}, {"table-5.6/E"}),
        ({"without": "width"}, {"table-5.6/zeta", "table-5.6/E"}),
    ],
)
def test_seeded_faults_are_caught(fault: dict, caught: set) -> None:
    failed = set()
    for name, value in computed(**fault).items():
        try:
            ledger.check(name, value)
        except ledger.ClaimError:
            failed.add(name)
    assert failed == caught


EXACT = [
    c
    for c in ledger.claims().values()
    if c.kind == "exact" and c.verdict in ("reproduced", "erratum")
]


@pytest.mark.parametrize("claim", EXACT, ids=lambda claim: claim.id)
def test_every_exact_tolerance_can_fail(claim: ledger.Claim) -> None:
    """Zero, the wrong sign and a value two per cent off are all rejected."""
    right = float(claim.corrected or claim.printed)
    for wrong in (0.0, -right, 1.02 * right):
        if abs(wrong - right) < 1e-300:
            continue
        # Integers such as labels have half a unit of room; 2 % of a small one stays inside.
        if wrong == 1.02 * right and claim.printed.lstrip("-").isdigit() and right < 26:
            wrong = right + 1
        assert ledger.judge(claim, wrong, wrong, wrong) == "differs"
    assert ledger.judge(claim, right, right, right) == claim.verdict


def test_tolerances_from_table_5_5_are_what_its_rounding_allows() -> None:
    """No guesses: worst cases for the coordinates, 95 % of even draws for the modulus."""
    columns = {k: [ledger.claim(f"table-5.5/{k}{i}") for i in range(1, 9)] for k in "abc"}
    half = {
        k: np.array([ledger.half_ulp(c.printed) for c in column]) for k, column in columns.items()
    }
    base = {k: np.array([c.value for c in column]) for k, column in columns.items()}

    def measure(values: dict[str, np.ndarray]) -> np.ndarray:
        curve = GaussianSum(*values.values(), domain=(50.0, 265.0))
        dimple = dimple_geometry(curve, pixel_size=4.65 / 1.2)
        modulus = elastic_modulus(
            197.24,
            dimple.dimple_radius,
            dimple.dimple_depth,
            thickness=3.0,
            probe_half_width=25.0,
            poisson_ratio=0.5,
        )
        return np.array([*dimple.rim, *dimple.bottom, float(modulus)])

    def moved(letter: str, i: int) -> dict[str, np.ndarray]:
        return base | {letter: base[letter] + half[letter] * (np.arange(8) == i)}

    rng = np.random.default_rng(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SmallSlopeWarning)
        shifts = [abs(measure(moved(k, i)) - measure(base)) for k in "abc" for i in range(8)]
        drawn = [
            measure({k: base[k] + half[k] * rng.uniform(-1, 1, 8) for k in "abc"})[-1]
            for _ in range(400)
        ]
    worst = np.sum(shifts, axis=0)
    for name, limit in zip(("x_1", "y_1", "x_2", "y_2"), worst, strict=False):
        tolerance = ledger.claim(f"section-5.6/{name}").tolerance
        assert 0.97 * limit < tolerance <= limit, name
    # The standard deviation of 400 draws is itself known to 3.5 %.
    tolerance = ledger.claim("section-5.6/E-from-table-5.5").tolerance
    assert 1.96 * np.std(drawn) == pytest.approx(tolerance, rel=0.1)


def test_records_are_written_and_read(tmp_path: Path) -> None:
    try:
        ledger.open_record(tmp_path / "claims" / "05.json")
        ledger.check("table-5.6/E", 1.32372)
        ledger.report("5.6/ours", 25.0, "µm", digits=1)
        ledger.check("table-5.6/E", 1.32371)  # a cell run again replaces its record
        records = ledger.read_records(tmp_path / "claims")
        assert records["table-5.6/E"].value == 1.32371
        assert str(records["5.6/ours"]) == "25.0 µm"
        assert list(ledger.summary("table-5.6").index) == ["table-5.6/E"]
        (tmp_path / "claims" / "06.json").write_text((tmp_path / "claims" / "05.json").read_text())
        with pytest.raises(ValueError, match="recorded twice"):
            ledger.read_records(tmp_path / "claims")
    finally:
        ledger.open_record("")


def test_record_text() -> None:
    record = ledger.Record("x", 1.5, 1.4, 1.6, "px", "consistent", 2)
    assert str(record) == "1.50 ± 0.10 px"
    assert str(replace(record, low=1.2)) == "1.50 (1.20 to 1.60) px"
    assert (
        str(replace(record, value=-8.4e-10, low=-8.4e-10, high=-8.4e-10, digits=12))
        == "-8.40e-10 px"
    )


def test_errata_are_complete() -> None:
    for name, entry in ledger.errata().items():
        keys = {"where", "printed", "corrected", "origin", "proof", "test"}
        assert set(entry) - {"claims"} == keys, name
        assert all(id in ledger.claims() for id in entry.get("claims", "").split()), name
        assert entry["origin"] in ("print", "open", "wording"), name
        assert (ROOT / entry["test"]).is_file(), name


def test_every_table_is_entered_whole() -> None:
    sizes = {"3.1": 9, "5.1": 44, "5.2": 12, "5.3": 8, "5.4": 12, "5.5": 24, "5.6": 7, "5.7": 2}
    for table, size in sizes.items():
        assert sum(name.startswith(f"table-{table}/") for name in ledger.claims()) == size, table


def test_claims_file_is_plain_toml() -> None:
    with (ROOT / "data" / "thesis" / "claims.toml").open("rb") as file:
        raw = tomllib.load(file)
    assert list(raw) == list(ledger.claims())
    assert json.dumps(raw)


@pytest.mark.parametrize(
    ("value", "low", "high", "stored"),
    [
        # Three digits of an interval's width, and evenly around the value where it was so.
        (197883.28293, 180277.68174, 215488.88412, (197900, 180300, 215500)),
        (2.2764, 1.3934, 3.3666, (2.28, 1.39, 3.37)),
        (-1.62337123, -1.65425123, -1.59249123, (-1.6234, -1.6543, -1.5925)),
        # Of a number alone two decimals more than are shown, or four digits.
        (1.22474487, 1.22474487, 1.22474487, (1.2247, 1.2247, 1.2247)),
        (184.0, 184.0, 184.0, (184, 184, 184)),
        (0.0021054123, 0.0021054123, 0.0021054123, (0.002105, 0.002105, 0.002105)),
        (0.0, 0.0, 0.0, (0, 0, 0)),
    ],
)
def test_what_another_machine_changes_is_not_stored(
    value: float, low: float, high: float, stored: tuple[float, float, float]
) -> None:
    for noise in (-2e-7, 0.0, 2e-7):
        numbers = [number * (1 + noise) for number in (value, low, high)]
        decimals = ledger._decimals(numbers[0], numbers[2] - numbers[1], 2, exact=False)
        found = ledger._rounded(*numbers, decimals)
        assert found == pytest.approx(stored, rel=1e-12, abs=0)
        assert len(repr(found[0])) <= 9


def test_an_exact_claim_keeps_what_decides_it() -> None:
    """Table 5.6's modulus has a tolerance of 5e-5 MPa; a wide interval takes no digit from it."""
    record = ledger.check("table-5.6/E", 1.323719876, 0.4)
    assert record.value == 1.3237199
    assert (record.low, record.high) == (0.9237199, 1.7237199)
    assert record.digits == 5
    assert ledger.report("5.2/gain", 1.22474487, digits=2).value == 1.2247


def test_no_more_is_shown_than_is_stored() -> None:
    record = ledger.check("table-5.1/circle-4X/T_op", 197883.28, 17605.6)
    assert str(record) == "197900 ± 17600 µm"
    assert record.digits == 0


def test_numbers_are_shown_as_far_as_their_intervals_allow(tmp_path):
    record = ledger.Record("5.2/gain", 1.32338, 1.30074, 1.34891, "MPa", "result", 5)
    assert str(record) == "1.323 (1.301 to 1.349) MPa"
    assert str(replace(record, low=1.30338, high=1.34338)) == "1.323 ± 0.020 MPa"
    # Of a stated limit, which has no printed digits, four.
    ledger.open_record(tmp_path / "record.json")
    try:
        assert str(ledger.check("section-2.1/robot-precision", 100.0)) == "100.0 µm"
    finally:
        ledger.open_record("")
    assert ledger.with_error(31199.3, 980.0) == "31200 ± 980"
    assert ledger.with_error(1.28582e-11, 4.9e-12) == "(1.29 ± 0.49)·10⁻¹¹"


@pytest.mark.parametrize(
    ("kind", "printed", "corrected", "digits"),
    [
        ("stated", "0.5", None, 3),
        ("exact", "1.23", None, 3),
        ("exact", "250", None, 1),
        ("exact", "1.2e3", None, 0),
        ("given", "1.23", "1.234", 4),
    ],
)
def test_one_decimal_more_than_printed_is_shown(kind, printed, corrected, digits) -> None:
    stated = SimpleNamespace(kind=kind, printed=printed, corrected=corrected)
    assert ledger._places(stated) == digits
