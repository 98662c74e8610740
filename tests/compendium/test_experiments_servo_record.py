"""The record of section 5.4's inference: complete, remade in part, and tabled as it says."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import servo_record
from compendium.experiments.servo_inference import NUMBERS, printed
from compendium.experiments.servo_loop import BANDS
from compendium.experiments.servo_models import LEADING, MECHANISMS, priors


def test_a_small_piece_is_remade() -> None:
    assert servo_record.agrees()
    assert len(servo_record.record()["small"]) == 1 + 2 * len(priors("base"))


def test_the_small_piece_is_of_the_wide_record() -> None:
    """With few states the evidence varies by one."""
    kept = servo_record.record()
    assert kept["small"][0] == pytest.approx(np.mean(kept["evidence"]["base"]), abs=3)


def test_the_record_is_complete() -> None:
    kept = servo_record.record()
    assert list(kept["evidence"]) == list(MECHANISMS)
    assert {len(logs) for logs in kept["evidence"].values()} == {5}
    assert tuple(kept["left out"]) == tuple(kept["posterior"]) == LEADING
    for model in LEADING:
        ends = np.array(kept["left out"][model])
        assert ends.shape == (len(NUMBERS), 3)
        assert (np.diff(ends, axis=1) > 0).all()
        assert (ends > 0).all()
        posterior = kept["posterior"][model]
        assert posterior["names"] == [prior.name for prior in priors(model)]
        for prior, (low, middle, high) in zip(priors(model), posterior["quantiles"], strict=True):
            assert low < middle < high
            if prior.shape != "normal":
                assert prior.low <= low
                assert high <= prior.high
        assert sum(posterior["steps"]) == pytest.approx(1, abs=0.01)
        assert sum(posterior["paths"]) == pytest.approx(1, abs=0.01)
    for model, tried in kept["calibration"].items():
        ranks = np.array(tried["ranks"])
        assert ranks.shape == (100, len(priors(model)))
        assert ranks.min() >= 0
        assert ranks.max() <= 1


def made_up() -> dict:
    numbers = printed()
    ends = np.column_stack([0.5 * numbers, numbers, 2 * numbers])
    outside = ends.copy()
    outside[3] *= 3
    both = outside[:, :].copy()
    return {
        "evidence": {"base": [-2.0, -4.0], "better": [-1.0, -1.5]},
        "left out": {"base": outside.tolist(), "better": both.tolist()},
        "calibration": {
            "base": {"names": ["a", "b"], "ranks": [[k / 50, 0.5] for k in range(51)]},
            "better": {"names": ["a"], "ranks": [[k / 50] for k in range(51)]},
        },
        "posterior": {
            "base": {
                "names": ["a", "b", "c"],
                "quantiles": [[1.0, 2.0, 3.0], [0.1, 0.2, 0.3], [4, 5, 6]],
                "widths": [1.0, 0.5, 0.25],
                "correlation": [[1, 0.1, -0.9], [0.1, 1, 0.5], [-0.9, 0.5, 1]],
                "steps": [0.5] + [0.0] * 15 + [0.5] + [0.0] * 15,
                "paths": [0.25, 0.75, 0, 0, 0, 0, 0, 0],
            }
        },
    }


def test_tables_say_what_the_record_says(monkeypatch) -> None:
    monkeypatch.setattr(servo_record, "record", made_up)
    found = servo_record.evidence()
    assert list(found["model"]) == ["better", "base"]
    assert found["over the base"].tolist() == [1.75, 0.0]
    assert found["least"].tolist() == [-1.5, -4.0]
    assert found["deviation"].iloc[1] == pytest.approx(np.sqrt(2))
    assert not servo_record.held()["base"].iloc[3]
    assert servo_record.held().to_numpy().sum() == 34
    assert servo_record.never_held() == ["Settling time at 4X"]
    table = servo_record.left_out_table()
    assert table["base"].iloc[-1] == "17 of 18"
    assert table["base"].str.endswith("outside").sum() == 1
    assert table.iloc[0].tolist()[:3] == ["Settling time at 1X", "0.80 s", "0.4 to 1.6"]
    assert servo_record.calibration()["uniform"].tolist() == ["no", "yes"]
    assert servo_record.calibration()["least uniform"].tolist() == ["b", "a"]
    # Of ranks that are all the same, and of even ones; the mean of both is a half.
    assert servo_record.calibration()["deviation"].tolist() == pytest.approx([0.5, 1.0], abs=0.03)
    assert servo_record.widths("base")["c"] == 0.25
    assert servo_record.trades("base")["names"] == ["a", "b", "c"]
    assert servo_record.quantiles().loc["a", "base"] == "2 (1 to 3)"
    readings = servo_record.reading_table("base", 1)
    assert readings["probability"].tolist() == [0.5, 0.75]
    assert readings["reading"].iloc[1] == "same frame, deviation of the vector"
    shares = servo_record.band_shares("base")
    assert shares == {BANDS[0]: 0.5, BANDS[1]: 0.0, BANDS[2]: 0.5, BANDS[3]: 0.0}


def test_the_text_of_the_chapter_follows_the_record() -> None:
    """What is said in words there: which models lead, what none explains, what is not told."""
    table = servo_record.evidence().set_index("model")["over the base"]
    assert set(table.index[:2]) == {servo_record.FAVORED, "stage jumps"}
    assert set(table.index[2:5]) == {"dropped frames", "lost frames", "bursts"}
    assert table.iloc[5:].max() < 2
    assert servo_record.never_held() == ["Precision on the circle at 1X"]
    inside = servo_record.held().sum()
    assert inside.idxmax() == servo_record.FAVORED
    assert servo_record.band_shares(servo_record.FAVORED)[0.1] < 0.05
    # The evidence is known to a half; by how much the calibrated runs are narrow.
    assert servo_record.evidence()["deviation"].max() < servo_record.STEADY
    calibration = servo_record.calibration()
    assert set(calibration["uniform"]) == {"yes"}
    assert calibration["deviation"].between(1.0, 1.1).all()
    widths = servo_record.widths(servo_record.FAVORED)
    assert widths["image noise"] < 0.5
    trades = servo_record.trades(servo_record.FAVORED)
    places = [trades["names"].index(name) for name in ("latency", "image noise")]
    assert trades["correlation"][places[0]][places[1]] < -0.5
    assert widths[["path size", "sinusoid height", "scale error at 4X"]].min() > 0.6


def test_what_the_text_quotes_is_the_record() -> None:
    """Names, values, units and digits, read from the record by another way."""
    kept, favored = servo_record.record(), servo_record.FAVORED
    found = {name.removeprefix("5.4/"): rest for name, *rest in servo_record.findings()}
    logs = {model: np.mean(each) for model, each in kept["evidence"].items()}
    for model, log in logs.items():
        assert found[f"over-{model}".replace(" ", "-")] == [
            pytest.approx(log - logs["base"], abs=1e-9), "", 1,
        ]  # fmt: skip
    spread = max(np.std(each, ddof=1) for each in kept["evidence"].values())
    assert found["evidence-deviation"] == [pytest.approx(spread, rel=1e-6), "", 2]
    bands = [found[f"band-{100 * band:g}"] for band in BANDS]
    assert sum(value for value, *_ in bands) == pytest.approx(100, abs=0.1)
    assert {tuple(rest) for _, *rest in bands} == {("%", 0)}
    for model in LEADING:
        inside = sum(
            low <= y <= high
            for (low, _, high), y in zip(kept["left out"][model], printed(), strict=True)
        )
        assert found[f"inside-{model}".replace(" ", "-")] == [inside, "", 0]
    assert found["rank-deviation-base"][1:] == ["", 2]
    # Nearly all of the paths' weight lies on one reading.
    assert found["next-reference"] == [100 * max(kept["posterior"][favored]["paths"]), "%", 0]
    ends = kept["posterior"][favored]["quantiles"]
    for prior, (low, _, high) in zip(priors(favored), ends, strict=True):
        name = prior.name.replace(" ", "-")
        value, unit, digits = found[f"{name}-low"]
        assert (value, unit) == (low, prior.unit)
        assert found[f"{name}-high"] == [high, prior.unit, digits]
        # At least two figures of the smaller end, and no more than it needs.
        assert abs(round(low, digits) / low - 1) < 0.05
        assert digits == 0 or abs(low) < 10 ** (2 - digits)
