"""The ledger: what it judges and refuses, the rules on its data, and that every check can fail."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = list(ledger.claims().values())
SETTINGS = list(ledger.settings().values())
PROVEN = {"proof": "p", "cause": "c"}
FOUND = {"found": "f", "decides": "d", "recomputed": 3.0, "within": 0.1}


def make(kind: str, **fields: object) -> ledger.Claim:
    entry = {"id": "x", "what": "", "where": "", "printed": "2.50"}
    return ledger.KINDS[kind](**entry | fields)


@pytest.mark.parametrize(
    ("kind", "fields", "numbers", "passes"),
    [
        ("follows", {}, (2.5049, 2.5049, 2.5049), True),
        ("follows", {}, (2.5051, 2.5051, 2.5051), False),
        ("follows", {}, (2.5149, 2.5049, 2.5249), True),  # what printed inputs allow
        ("follows", {}, (2.5151, 2.5051, 2.5251), False),
        ("follows", {"printed": "-2.50"}, (-2.5149, -2.5249, -2.5049), True),
        ("follows", {}, (2.5, 2.4, 2.6), False),  # no rounding is as large
        ("follows", {"printed": "< 1", "unit": "s"}, (0.9, 0.9, 0.9), True),
        ("follows", {"printed": "< 1", "unit": "s"}, (1.0, 1.0, 1.0), False),
        ("follows", {"limit": ">= 0.5"}, (0.5, 0.5, 0.5), True),
        ("follows", {"limit": "> 0.5"}, (0.5, 0.5, 0.5), False),
        ("contradicts", PROVEN | {"corrected": "7.5"}, (7.52, 7.52, 7.52), True),
        ("contradicts", PROVEN | {"corrected": "7.5"}, (7.56, 7.56, 7.56), False),
        ("contradicts", PROVEN | {"corrected": "2.504"}, (2.504, 2.504, 2.504), False),
        ("contradicts", PROVEN | {"recomputed": 2.6, "within": 0.2}, (2.6, 2.6, 2.6), True),
        ("contradicts", PROVEN | {"recomputed": 2.6, "within": 0.2}, (2.6, 2.5, 2.7), False),
        ("contradicts", PROVEN | {"recomputed": 3.0, "within": 0.1}, (3.15, 3.15, 3.15), False),
        ("contradicts", PROVEN | {"limit": "< 1", **FOUND}, (3.0, 3.0, 3.0), None),
        ("contradicts", PROVEN | {"limit": "< 1", "corrected": "3"}, (3.0, 2.9, 3.1), True),
        ("contradicts", PROVEN | {"limit": "< 1", "corrected": "3"}, (3.0, 0.9, 5.1), False),
        ("possible", {"assumes": "a"}, (2.4, 2.3, 2.5), True),
        ("possible", {"assumes": "a"}, (2.4, 2.3, 2.49), False),
        ("possible", {"assumes": "a", "printed": "-2.50"}, (-2.4, -2.5, -2.3), True),
        ("possible", {"assumes": "a"}, (2.5, 0.1, 4.9), True),
        ("possible", {"assumes": "a"}, (2.5, -0.1, 5.1), False),  # such an interval says nothing
        ("possible", {"assumes": "a", "limit": "< 1"}, (0.9, 0.8, 0.99), True),
        ("possible", {"assumes": "a", "limit": "< 1"}, (0.9, 0.8, 1.0), False),
        ("possible", {"assumes": "a", "limit": "< 1"}, (1.1, 0.9, 1.2), False),
        ("open", FOUND, (3.05, 0.0, 9.0), True),
        ("open", FOUND, (3.11, 0.0, 9.0), False),
        ("open", FOUND, (2.5, 2.5, 2.5), False),  # although it equals the printed number
    ],
)
def test_claim_of_each_kind_objects_to_wrong_numbers_alone(kind, fields, numbers, passes):
    if passes is None:
        with pytest.raises(TypeError, match="unexpected keyword argument"):
            make(kind, **fields)
    else:
        assert (make(kind, **fields).objection(*numbers) == "") == passes


@pytest.mark.parametrize(
    ("formula", "library", "message"),
    [
        (2.0, 2.0 + 1e-6, r"equation \(3.13\): the library"),
        ([1.0, 5.0], [1.0, -5.0], "Max absolute difference among violations: 10"),
        ([1.0, 1e-9], [1.0, 2e-9], "Mismatched elements: 1 / 2"),
        (1.0, math.nan, "nan location mismatch"),
        (math.inf, math.inf, "must give finite numbers, got inf"),
        ([], [], "must give finite numbers"),
        ([1.0, 1.0], 1.0, "shapes"),
    ],
)
def test_check_equation_names_failing_equation(formula, library, message):
    with pytest.raises((AssertionError, ValueError), match=message):
        ledger.check_equation("3.13", formula, library)


def test_check_equation_accepts_rounding_and_stated_tolerances():
    ledger.check_equation("3.13", [0.1 + 0.2, 1.0], [0.3, 1.0])
    ledger.check_equation("3.13", 0.5, 0.51, rtol=0.03)
    ledger.check_equation("3.13", 0.0, 0.01, atol=0.02)
    with pytest.raises(ValueError, match="number must be that of an equation"):
        ledger.check_equation("9.9", 1.0, 1.0)


@pytest.mark.parametrize("claim", [*CLAIMS, *SETTINGS], ids=lambda claim: claim.id)
def test_claim_entry_is_consistent(claim):
    """What must hold of every entry of claims.toml and settings.toml."""
    file, _, function = claim.test.partition("::")
    assert not function or f"def {function}(" in (ROOT / file).read_text(encoding="utf-8")
    if claim.condition:
        assert re.fullmatch(r"(>=|<=|>|<) [-+\d.e]+", claim.condition)
    # A sentence needs its words.
    assert claim.says or claim.printed or claim.verdict is None
    match claim:
        case ledger.Contradicts():
            assert claim.proof
            assert claim.cause in ledger.causes()
            assert bool(claim.corrected) != (0 < claim.within < math.inf)
        case ledger.Possible():
            assert claim.chosen or claim.assumes
        case ledger.Open():
            assert claim.found
            assert claim.decides
            assert claim.compared == (0 < claim.within < math.inf)
            assert not claim.note, "what was found says it"


@pytest.mark.parametrize(
    ("id", "value", "options", "message"),
    [
        ("table-5.6/E", 1.31, {}, r"E, .*: printed 1\.3237 MPa, recomputed 1.31 .* “poss"),
        ("section-3.2.1/d2", 50, {}, r"84, recomputed 50 .*contradicts.* within 0\.5 of 42"),
        ("section-3.2.1/d2", 84, {}, "it does not contradict"),
        ("section-5.1/zoom-ratio", 15.6, {}, "“follows”, but it differs by more than the rounding"),
        ("section-5.6/y_1", 94.1202, {}, r"“open”, but it is not within 0\.005 of 94\.152"),
        ("table-5.7/mean", 1.28, {"interval": (1.2, 1.27)}, "must contain its value"),
        ("table-5.7/mean", 1.25, {"interval": (1.2, 1.27)}, "does not contain the printed number"),
        ("table-5.1/circle-1X/f", 130000.0, {}, "“setting”, but its interval does not contain"),
        ("table-9.9/x", 1.0, {}, "id must name an entry"),
        ("table-5.6/E", math.nan, {}, "must be finite"),
        ("section-6/reconstruction-real", 1.0, {}, "not compared"),
    ],
)
def test_check_refuses_wrong_numbers(id, value, options, message):
    with pytest.raises((ledger.ClaimError, ValueError), match=message):
        ledger.check(id, value, **options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"verdict": "agrees"}, "verdict of table-5.6/w_d must be one of follows"),
        ({"star": "x"}, "table-5.6/w_d must be a Follows: .* 'star'"),
        ({"verdict": "open", "found": "f"}, "table-5.6/w_d must be a Open: .* 'decides'"),
        ({"printed": "121.30"}, ""),
    ],
)
def test_wrong_entry_of_a_claim_is_an_error(monkeypatch, change, message):
    entries = dict(ledger.read_toml("claims.toml"))
    entries["table-5.6/w_d"] = entries["table-5.6/w_d"] | change
    monkeypatch.setattr(ledger, "read_toml", lambda name: entries)
    if message:
        with pytest.raises(ValueError, match=message):
            ledger.claims.__wrapped__()
    else:  # a printed number that is copied wrong
        assert ledger.claims.__wrapped__()["table-5.6/w_d"].objection(*[121.217] * 3)


def test_mismatch_is_recorded_on_request(monkeypatch):
    monkeypatch.setenv(ledger.RECORD_MISMATCHES, "1")
    said = ledger.check("table-5.6/w_d", 120.0).verdict
    assert said == "follows: it differs by more than the rounding of the printed numbers"


def test_bound_is_rounded_away_from_the_number():
    """What is at most 0.124 is at most 0.13, and what is at least 0.126 is at least 0.12."""
    assert str(ledger.report("above", 0.124, toward=1)) == "0.13"
    assert str(ledger.report("below", 0.126, toward=-1)) == "0.12"
    assert str(ledger.report("nearest", 0.126)) == "0.13"


def test_records_are_written_and_read(tmp_path):
    try:
        ledger.open_record(tmp_path / "claims" / "05.json")
        ledger.check("table-5.6/E", 1.32372)
        ledger.report("5.6/half-width", 25.0, "µm", digits=1)
        ledger.check("table-5.6/w_d", 121.22)
        ledger.check("table-5.6/E", 1.32371, 0.02)  # a cell run again replaces its record
        records = ledger.read_records(tmp_path / "claims")
        assert records["table-5.6/E"].value == 1.32371
        assert str(records["5.6/half-width"]) == "25.0 µm"
        entry, ours = ledger.claim("table-5.6/E"), "1.324 ± 0.020"
        shown = {"quantity": entry.what, "printed": entry.printed, "recomputed": ours}
        shown |= {"unit": entry.unit, "verdict": entry.label}
        assert ledger.summary("table-5.6/E").to_dict("index") == {entry.id: shown}
        table = ledger.scorecard(tmp_path / "claims").set_index("claim")
        shown |= {name: getattr(entry, name) for name in ("where", "says", "note", "test")}
        assert (
            table.loc[entry.id].to_dict().items()
            >= (shown | {"part": ledger.part_of(entry)}).items()
        )
        assert [*table.loc["table-5.6/E", ["low", "high"]]] == pytest.approx([1.30371, 1.34371])
        assert table["verdict"].isin(ledger.ORDER).all()
        places = table.loc[["section-4/contact-mechanics", "section-4.1/no-bending"], "where"]
        assert [*places] == ["Chapter 4", "Section 4.1"]
        assert table.loc["table-5.6/zeta", "explanation"].startswith("Proof: ")
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
    record = ledger.Record("x", value, low, high, "px", "follows", digits)
    assert str(record) == text
    noise = 1 + 2e-7  # what another machine changes
    moved = replace(record, value=noise * value, low=noise * low, high=noise * high)
    assert str(moved) == text


def test_count_is_shown_without_decimals_and_number_of_a_sentence_to_four_digits():
    assert str(ledger.check("section-5.1/zoom-ratio", 15.0)) == "15"
    assert str(ledger.check("section-5.1/zoom-ratio", 15.2)) == "15.2"
    assert str(ledger.check("section-2.2/converges", -12.3456)) == "-12.35 1/s"
    assert str(ledger.check("section-4.1/no-bending", 0.012345)) == "0.012"


@pytest.mark.parametrize("claim", [c for c in CLAIMS if c.compared], ids=lambda claim: claim.id)
def test_every_claim_fails_for_some_planted_number(claim):
    """No claim is true by construction: a number far from the right one does not pass."""
    is_open = isinstance(claim, ledger.Open)
    size = max(abs(claim.recomputed), 3 * claim.within) if is_open else abs(claim.value)
    planted = (0.0, -size, 0.4 * size, 2.1 * size, 100 * size)
    failed = sum(bool(claim.objection(x, x, x)) for x in planted)
    assert failed >= (2 if is_open or claim.condition else 4)


def test_causes_and_claims_correspond():
    causes = {claim.cause for claim in CLAIMS if isinstance(claim, ledger.Contradicts)}
    assert causes == set(ledger.causes())


def test_errata_name_existing_claims_and_tests():
    for name, entry in ledger.errata().items():
        assert ("reading" in entry) == (entry["origin"] == "A matter of reading"), name
        assert all(ledger.claim(id) for id in entry.get("claims", "").split()), name
        assert (ROOT / entry["test"]).is_file(), name
    origins = {"Certain", "Probably printing or text recognition", "A matter of reading"}
    assert {entry["origin"] for entry in ledger.errata().values()} == origins
