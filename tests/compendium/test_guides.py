"""Inputs are found from any folder, and a result that is not the truth is not let pass."""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from compendium.guides import (
    FOLDER,
    compare,
    find_input,
    keep,
    manifest,
    settle,
)

EMBRYO = find_input("embryo.png")
SETTINGS = manifest()["embryo.png"]["settings"]
TRUTH = manifest()["embryo.png"]["truth"]
ALLOWED = {"modulus_MPa": 0.05, "dimple_radius_um": 1.0, "dimple_depth_um": 1.0}


def test_the_scales_of_the_demo_are_of_no_other_file(tmp_path: Path) -> None:
    unknown = dict.fromkeys(SETTINGS)
    values, table = settle(EMBRYO, unknown)
    assert values == SETTINGS
    assert set(table["from"]) == {"the demo"}
    mine = tmp_path / "embryo.png"
    mine.write_bytes(Path(EMBRYO).read_bytes())
    with pytest.raises(
        ValueError, match=r"force, pixel_size, .* given for .*: -p force VALUE -p pixel_size"
    ):
        settle(mine, unknown)
    given = SETTINGS | {"pixel_size": None, "force": 3.0}
    values, table = settle(mine, given, {"pixel_size": 2.0, "force": 9.0})
    assert (values["force"], values["pixel_size"]) == (3.0, 2.0)
    assert table["from"][["force", "pixel_size"]].tolist() == ["given", "the file"]


@pytest.mark.parametrize("wrong", [0.0, -1.3, 1.36, np.nan, np.inf])
def test_the_truth_passes_and_a_wrong_result_is_named(wrong: float) -> None:
    table = compare(EMBRYO, SETTINGS, TRUTH, ALLOWED)
    assert list(table.index) == list(TRUTH)
    assert (table["off by"] == 0).all()
    with pytest.raises(AssertionError, match=r"embryo\.png: modulus_MPa is .* off the truth"):
        compare(EMBRYO, SETTINGS, TRUTH | {"modulus_MPa": wrong}, ALLOWED)


def test_arrays_are_held_against_the_file_of_the_truth() -> None:
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


def test_nothing_is_compared_without_a_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = dict.fromkeys(TRUTH, -1.0)
    mine = tmp_path / "embryo.png"
    mine.write_bytes(Path(EMBRYO).read_bytes())
    assert "truth" not in compare(mine, SETTINGS, wrong, ALLOWED)
    assert "No truth is known of embryo.png" in capsys.readouterr().out
    assert "truth" not in compare(FOLDER / "height_um.tif", SETTINGS, wrong, ALLOWED)
    other = SETTINGS | {"force": 100.0}
    assert "truth" not in compare(EMBRYO, other, wrong, ALLOWED)
    assert "The truth of embryo.png is for force = 113.75" in capsys.readouterr().out


def test_results_are_kept_as_what_they_are(tmp_path: Path) -> None:
    table = pd.DataFrame({"x_um": np.arange(20) / 8, "lost": True})
    keep(tmp_path / "table.csv", table)
    keep(tmp_path / "named.csv", table.rename_axis("frame"))
    keep(tmp_path / "grey.png", np.tile(np.arange(0, 250, 10, np.uint8), (9, 1)))
    keep(tmp_path / "figure.png", plt.figure(figsize=(1, 1)))
    plt.close()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "table.csv"), table)
    named = pd.read_csv(tmp_path / "named.csv", index_col="frame")
    pd.testing.assert_frame_equal(named, table.rename_axis("frame"))
    grey = cv2.imread(str(tmp_path / "grey.png"), cv2.IMREAD_GRAYSCALE).astype(int)
    # From black to white, as matplotlib scales it; levels of the map are 1 in 255 apart.
    np.testing.assert_allclose(grey, np.tile(np.linspace(0, 255, 25), (9, 1)), atol=1.5)
    assert cv2.imread(str(tmp_path / "figure.png")).shape[2] == 3
