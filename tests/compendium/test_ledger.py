"""The ledger: what it judges and refuses, the rules on its data, and that every check can fail."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = list(ledger.claims().values())


def make(**changes: object) -> ledger.Claim:
    fields = {"id": "x", "what": "", "where": "", "verdict": "agrees", "printed": "2.50"}
    return ledger.Claim(**fields | {"compared": "arithmetic"} | changes)


SIMULATED = {"compared": "simulation"}


@pytest.mark.parametrize(
    ("changes", "numbers", "verdict"),
    [
        ({}, (2.5049, 2.5049, 2.5049), "agrees"),
        ({}, (2.5051, 2.0, 3.0), "disagrees"),  # an interval widens no tolerance
        (SIMULATED, (2.4, 2.3, 2.5), "agrees"),
        (SIMULATED, (2.4, 2.3, 2.49), "disagrees"),
        (SIMULATED, (2.5, 1.3, 3.7), "agrees"),
        (SIMULATED, (2.5, 1.2, 3.8), "cannot tell"),
        (SIMULATED | {"given": True}, (2.5, 0.1, 4.9), "input"),
        (SIMULATED | {"given": True}, (2.5, -0.1, 5.1), "cannot tell"),
        (SIMULATED | {"given": True}, (2.4, 2.3, 2.49), "disagrees"),
        (SIMULATED | {"fitted": "x"}, (2.4, 2.3, 2.5), "fitted"),
        (SIMULATED | {"fitted": "x"}, (2.4, 2.3, 2.49), "disagrees"),
        (SIMULATED | {"fitted": "x"}, (2.5, 1.2, 3.8), "cannot tell"),
        (SIMULATED | {"star": "x"}, (2.4, 2.3, 2.5), "agrees"),
        (SIMULATED | {"star": "x"}, (2.4, 2.3, 2.49), "cannot tell"),
        (SIMULATED | {"undecided": "x"}, (2.4, 2.3, 2.5), "cannot tell"),
        (SIMULATED | {"undecided": "x"}, (2.4, 2.3, 2.49), "cannot tell"),
        ({"compared": "sentence", "limit": ">= 0.5"}, (0.5, 0.5, 0.5), "agrees"),
        ({"compared": "sentence", "limit": "> 0.5"}, (0.5, 0.5, 0.5), "disagrees"),
        (SIMULATED | {"limit": "< 1"}, (0.9, 0.9, 0.9), "agrees"),
        (SIMULATED | {"limit": "< 1"}, (0.9, 0.8, 1.0), "cannot tell"),
        (SIMULATED | {"limit": "< 1"}, (1.1, 0.9, 1.2), "cannot tell"),
        (SIMULATED | {"limit": "< 1"}, (1.1, 1.0, 1.2), "disagrees"),
        (SIMULATED | {"limit": "> 0.5", "fitted": "x"}, (0.9, 0.8, 1.0), "fitted"),
        (SIMULATED | {"bound": "lower"}, (2.6, 2.45, 2.7), "cannot tell"),
        (SIMULATED | {"bound": "lower"}, (2.6, 2.55, 2.7), "disagrees"),
        (SIMULATED | {"bound": "upper"}, (2.4, 2.3, 2.55), "cannot tell"),
        (SIMULATED | {"bound": "upper"}, (2.4, 2.3, 2.45), "disagrees"),
    ],
)
def test_judge_gives_verdict_from_interval_and_tolerance(changes, numbers, verdict):
    """The verdict that the entry states decides nothing."""
    for stated in ledger.VERDICTS:
        assert ledger.judge(make(**changes | {"verdict": stated}), *numbers) == verdict


@pytest.mark.parametrize("value", [1e9, -1e9, 0.0, 2.0, -2.5])
def test_changed_difference_fails_pinned_verdict(value):
    claim = make(verdict="disagrees", recomputed=3.0, within=0.1)
    assert ledger.check_stated_verdict(claim, 3.05, 3.05, 3.05) == ("disagrees", "")
    assert "not within 0.1 of 3" in ledger.check_stated_verdict(claim, value, value, value)[1]
    erratum = make(verdict="disagrees", corrected="7.5")
    assert ledger.check_stated_verdict(erratum, 7.52, 7.52, 7.52) == ("disagrees", "")
    assert "not within 0.05 of 7.5" in ledger.check_stated_verdict(erratum, value, value, value)[1]


@pytest.mark.parametrize(
    ("formula", "library", "message"),
    [
        (2.0, 2.0 + 1e-6, r"equation \(3.13\): the formula gives 2, the library 2.000001"),
        ([1.0, 5.0], [1.0, -5.0], r"gives 5, the library -5 at \(1,\); they differ by 10"),
        ([1.0, 1e-9], [1.0, 2e-9], "they differ by 1e-09"),
        (1.0, math.nan, "the library nan"),
        (math.inf, math.inf, "the formula gives inf"),
        ([1.0, 1.0], 1.0, "must have one shape"),
    ],
)
def test_check_equation_names_failing_equation(formula, library, message):
    with pytest.raises((ledger.ClaimError, ValueError), match=message):
        ledger.check_equation("3.13", formula, library)


def test_check_equation_accepts_rounding_and_stated_tolerances():
    ledger.check_equation("3.13", [0.1 + 0.2, 1.0], [0.3, 1.0])
    ledger.check_equation("3.13", 0.5, 0.51, rtol=0.03)
    ledger.check_equation("3.13", 0.0, 0.01, atol=0.02)
    with pytest.raises(ValueError, match="number must be that of an equation"):
        ledger.check_equation("9.9", 1.0, 1.0)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_claim_entry_is_consistent(claim):
    """What must hold of every entry of claims.toml."""
    arithmetic, simulated = claim.compared == "arithmetic", claim.compared == "simulation"
    assert claim.verdict in ledger.VERDICTS
    assert claim.compared in ("", *ledger.COMPARED)
    assert claim.compared or claim.verdict in ("cannot tell", "input")
    assert claim.compared or not claim.test
    file, _, function = claim.test.partition("::")
    assert not function or f"def {function}(" in (ROOT / file).read_text(encoding="utf-8")
    # A sentence needs its words, and a limit that the thesis does not print its reason.
    assert bool(claim.limit) <= bool(claim.says)
    assert (claim.compared == "sentence") <= bool(claim.limit)
    if claim.limit:
        assert re.fullmatch(r"(>=|<=|>|<) [-+\d.e]+", claim.limit)
        assert not (claim.reason and claim.printed), "a limit of this book is not printed"
    assert claim.bound in (("", "lower", "upper") if simulated else ("",))
    # Whoever cannot tell or disagrees says why, and how far off it is.
    assert claim.note or claim.verdict not in ("cannot tell", "disagrees")
    stated = claim.recomputed == claim.recomputed
    off = claim.verdict == "disagrees" or bool(claim.undecided)
    assert off == (stated or bool(claim.corrected))
    assert stated == (0 < claim.within < math.inf)
    # What agrees may depend on something not printed; what disagrees may not, and has a cause.
    assert not claim.star or claim.verdict == "agrees"
    assert bool(claim.fitted) == (claim.verdict == "fitted")
    assert not claim.undecided or claim.verdict == "cannot tell"
    assert bool(claim.cause) == (claim.verdict == "disagrees")
    assert not claim.cause or claim.cause in ledger.causes()
    assert not claim.given or claim.verdict == "input"
    if arithmetic:
        most = max(0.5 * abs(claim.value), ledger.half_ulp(claim.printed))
        assert 0 < claim.tolerance <= most
        usual = ledger.half_ulp(claim.corrected or claim.printed)
        assert claim.reason or claim.tolerance == usual
    elif not claim.limit:
        assert not claim.reason


@pytest.mark.parametrize(
    ("id", "value", "options", "message"),
    [
        ("table-5.6/E", 1.31, {}, r"claim table-5\.6/E, .*: printed 1\.3237 MPa, recomputed 1.31 "),
        ("section-3.2.1/d2", 50, {}, r"printed 84, corrected to 42, recomputed 50 in"),
        ("table-5.1/square-4X/T_z", 1, {}, r": printed \S+ µm, corrected to 36007\.5 µm, recom"),
        ("table-9.9/x", 1.0, {}, "id must name a claim"),
        ("table-5.6/E", math.nan, {}, "must be finite"),
        ("table-5.6/E", 1.3237, {"interval": (2.0, 3.0)}, "must contain its value"),
        ("table-5.7/mean", 1.28, {}, "needs an interval"),
        ("table-5.6/F", 197.0, {}, "not compared"),
    ],
)
def test_check_refuses_wrong_numbers(id, value, options, message):
    with pytest.raises((ledger.ClaimError, ValueError), match=message):
        ledger.check(id, value, **options)


def test_rule_of_corrected_claim_judges_printed_number():
    rule = make(verdict="disagrees", corrected="7.5", unit="µm").rule
    text = "the printed number must lie within 0.05 µm of the recomputed one; 7.5 µm is proven"
    assert rule == text
    rule = make().rule
    assert rule == "the recomputed number must lie within 0.005 of the printed number"


def test_wrong_printed_modulus_fails(monkeypatch):
    """The claim on Table 5.5 has a wide tolerance, so that its printed number is that of 5.6."""
    entries = dict(ledger._read("claims.toml"))
    entries["table-5.6/E"] = entries["table-5.6/E"] | {"printed": "1.3337"}
    monkeypatch.setattr(ledger, "_read", lambda name: entries)
    changed = ledger.claims.__wrapped__()
    assert changed["section-5.6/E-from-table-5.5"].printed == "1.3337"
    verdict, objection = ledger.check_stated_verdict(changed["table-5.6/E"], *[1.32372] * 3)
    assert (verdict, objection) == ("cannot tell", "cannot tell, but the book says agrees")


def test_mismatch_is_recorded_on_request(monkeypatch):
    monkeypatch.setenv(ledger.RECORD_MISMATCHES, "1")
    said = ledger.check("table-5.6/w_d", 120.0).verdict
    assert said == "disagrees: disagrees, but the book says agrees"


def test_tolerances_of_table_5_1_are_95_percent_quantiles():
    """All its lengths have five digits; M is T_op/f, d is f²/T_op, T_z is f + d."""
    rng = np.random.default_rng(0)
    for column in ("circle-1X", "circle-4X", "square-1X", "square-4X"):
        entry = {k: ledger.claim(f"table-5.1/{column}/{k}") for k in ("M", "T_op", "f", "d", "T_z")}
        right = {k: float(one.corrected or one.printed) for k, one in entry.items()}
        # Of the lengths five digits are known; a T_z that is corrected has no rounding of its own.
        half = {k: 0.5 * 10.0 ** (math.floor(math.log10(abs(v))) - 4) for k, v in right.items()}
        half["M"] = ledger.half_ulp(entry["M"].printed)
        half["T_z"] *= not entry["T_z"].corrected
        off = {k: width * rng.uniform(-1, 1, 100_000) for k, width in half.items()}
        t_op, f = right["T_op"], right["f"]
        tube, focal = t_op + off["T_op"], f + off["f"]
        draws = {"M": tube / focal - t_op / f, "d": focal**2 / tube - f**2 / t_op}
        draws["T_z"] = focal - f + off["d"]
        for name, drawn in draws.items():
            limit = np.quantile(np.abs(drawn + off[name]), 0.95)
            assert entry[name].tolerance == pytest.approx(limit, rel=0.06), (column, name)


def test_records_are_written_and_read(tmp_path):
    try:
        ledger.open_record(tmp_path / "claims" / "05.json")
        ledger.check("table-5.6/E", 1.32372)
        ledger.report("5.6/half-width", 25.0, "µm", digits=1)
        ledger.check("table-5.6/E", 1.32371)  # a cell run again replaces its record
        records = ledger.read_records(tmp_path / "claims")
        assert records["table-5.6/E"].value == 1.32371
        assert str(records["5.6/half-width"]) == "25.0 µm"
        assert list(ledger.summary("table-5.6").index) == ["table-5.6/E"]
        table = ledger.scorecard(tmp_path / "claims").set_index("claim")
        assert table.loc["table-5.6/E", "recomputed"] == "1.32371"
        assert table["verdict"].isin(ledger.VERDICTS).all()
        (tmp_path / "claims" / "06.json").write_text((tmp_path / "claims" / "05.json").read_text())
        with pytest.raises(ValueError, match="recorded twice"):
            ledger.read_records(tmp_path / "claims")
    finally:
        ledger.open_record("")
    with pytest.raises(ValueError, match="must not be that of a claim"):
        ledger.report("table-5.6/E", 1.0)


@pytest.mark.parametrize(
    ("value", "low", "high", "digits", "text"),
    [
        (1.5, 1.2, 1.6, 2, "1.50 (1.20 to 1.60) px"),
        (197883.28, 180277.68, 215488.88, 0, "198000 ± 18000 px"),
        (1.32338, 1.30074, 1.34891, 5, "1.323 (1.301 to 1.349) px"),
        (-8.4e-10, -8.4e-10, -8.4e-10, 12, "-8.40e-10 px"),
        (-8.4e-10, -8.6e-10, -8.2e-10, 12, "(-8.40 ± 0.20)·10⁻¹⁰ px"),
    ],
)
def test_number_is_shown_to_its_uncertainty(value, low, high, digits, text):
    record = ledger.Record("x", value, low, high, "px", "agrees", digits)
    assert str(record) == text
    noise = 1 + 2e-7  # what another machine changes
    moved = replace(record, value=noise * value, low=noise * low, high=noise * high)
    assert str(moved) == text


@pytest.mark.parametrize("claim", [c for c in CLAIMS if c.compared], ids=lambda claim: claim.id)
def test_every_claim_fails_for_some_planted_number(claim):
    """No claim is true by construction: some planted number changes its verdict or its pin."""
    size = abs(claim.value) or 1.0
    planted = (0.0, -size, 0.4 * size, 2.1 * size, 100 * size)
    assert any(ledger.check_stated_verdict(claim, x, x, x)[1] for x in planted)
    if claim.fitted or claim.given or claim.star:
        turned = {ledger.judge(claim, x, x, x) for x in planted}
        assert turned & {"disagrees", "cannot tell"}, turned


def test_causes_and_claims_correspond():
    assert {claim.cause for claim in CLAIMS} - {""} == set(ledger.causes())


def test_errata_name_existing_claims_and_tests():
    for name, entry in ledger.errata().items():
        assert ("reading" in entry) == (entry["origin"] == "A matter of reading"), name
        assert all(id in ledger.claims() for id in entry.get("claims", "").split()), name
        assert (ROOT / entry["test"]).is_file(), name
    origins = {"Certain", "Probably printing or text recognition", "A matter of reading"}
    assert {entry["origin"] for entry in ledger.errata().values()} == origins
