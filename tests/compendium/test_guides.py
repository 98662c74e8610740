"""Inputs are found from any folder, and a result that is not the truth is not let pass."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from compendium.guides import FOLDER, compare, find_input, manifest, resolve_scales

EMBRYO = find_input("embryo.png")
SETTINGS = manifest()["embryo.png"]["settings"]
TRUTH = manifest()["embryo.png"]["truth"]
ALLOWED = {"modulus_MPa": 0.05, "dimple_radius_um": 1.0, "dimple_depth_um": 1.0}


def test_demo_scales_are_not_used_for_other_files(tmp_path):
    unknown = dict.fromkeys(SETTINGS)
    values, table = resolve_scales(EMBRYO, unknown)
    assert values == SETTINGS
    assert set(table["from"]) == {"the demo"}
    mine = tmp_path / "embryo.png"
    mine.write_bytes(Path(EMBRYO).read_bytes())
    with pytest.raises(
        ValueError, match=r"force, pixel_size, .* given for .*: -p force VALUE -p pixel_size"
    ):
        resolve_scales(mine, unknown)
    given = SETTINGS | {"pixel_size": None, "force": 3.0}
    values, table = resolve_scales(mine, given, {"pixel_size": 2.0, "force": 9.0})
    assert (values["force"], values["pixel_size"]) == (3.0, 2.0)
    assert table["from"][["force", "pixel_size"]].tolist() == ["given", "the file"]


@pytest.mark.parametrize("wrong", [0.0, -1.3, 1.36, np.nan, np.inf])
def test_compare_accepts_truth_and_names_wrong_result(wrong):
    table = compare(EMBRYO, SETTINGS, TRUTH, ALLOWED)
    assert list(table.index) == list(TRUTH)
    assert (table["off by"] == 0).all()
    with pytest.raises(AssertionError, match=r"embryo\.png: modulus_MPa is .* off the truth"):
        compare(EMBRYO, SETTINGS, TRUTH | {"modulus_MPa": wrong}, ALLOWED)


def test_compare_checks_arrays_against_truth_file():
    path = FOLDER / "frames.tif"
    settings = manifest()["frames.tif"]["settings"]
    true = pd.read_csv(FOLDER / "frames_path.csv")
    allowed = {"x_px": 0.05, "y_px": 0.05, "lost_frames": 0.0}

    def result(x: np.ndarray) -> pd.DataFrame:
        return compare(path, settings, {"x_px": x, "y_px": true["y_px"], "lost_frames": 0}, allowed)

    x = true["x_px"].to_numpy().copy()
    x[7] += 5.0  # one place of forty
    table = result(x)
    assert table.loc["x_px", "values"] == len(true)
    assert table.loc["x_px", "off by"] < 0.05
    for wrong in (x[::-1], x + 0.06, np.full_like(x, np.nan)):
        with pytest.raises(AssertionError, match="x_px"):
            result(wrong)


def test_compare_without_truth_compares_nothing(tmp_path, capsys):
    wrong = dict.fromkeys(TRUTH, -1.0)
    mine = tmp_path / "embryo.png"
    mine.write_bytes(Path(EMBRYO).read_bytes())
    assert "truth" not in compare(mine, SETTINGS, wrong, ALLOWED)
    assert "The true values of embryo.png" in capsys.readouterr().out
    other = SETTINGS | {"force": 100.0}
    assert "truth" not in compare(EMBRYO, other, wrong, ALLOWED)
    assert "embryo.png hold for force = 113.75" in capsys.readouterr().out
