"""Inputs are found from any folder, and a result that is not the truth is not let pass."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from compendium.guides import FOLDER, compare, find_input, manifest, out_folder, resolve_scales

EMBRYO = find_input("embryo.png")
SETTINGS = manifest()["embryo.png"]["settings"]
TRUTH = manifest()["embryo.png"]["truth"]
ALLOWED = {"modulus_MPa": 0.05, "rim_radius_um": 1.0, "dimple_depth_um": 1.0}


@pytest.mark.parametrize("wrong", [0.0, -1.3, 1.36, np.nan, np.inf])
def test_compare_accepts_truth_and_names_wrong_result(wrong):
    assert (compare(EMBRYO, SETTINGS, TRUTH, ALLOWED)["error"] == 0).all()
    with pytest.raises(AssertionError, match=r"embryo\.png: modulus_MPa is .* off the truth"):
        compare(EMBRYO, SETTINGS, TRUTH | {"modulus_MPa": wrong}, ALLOWED)


def test_compare_checks_arrays_against_truth_file():
    path = FOLDER / "frames.tif"
    settings = manifest()["frames.tif"]["settings"]
    true = pd.read_csv(FOLDER / "frames_path.csv")
    allowed = {"x_px": 0.05, "y_px": 0.05, "lost_frames": 0.0}
    x = true["x_px"].to_numpy().copy()
    x[7] += 5.0  # one place of forty
    found = {"x_px": x, "y_px": true["y_px"], "lost_frames": 0}
    assert compare(path, settings, found, allowed).loc["x_px", "values"] == len(true)
    for wrong in (x[::-1], x + 0.06, np.full_like(x, np.nan)):
        with pytest.raises(AssertionError, match="x_px"):
            compare(path, settings, found | {"x_px": wrong}, allowed)


def test_truth_and_scales_are_those_of_the_demo_alone(tmp_path, capsys):
    """With another force, and for another file of the same name, nothing is compared or filled."""
    wrong = dict.fromkeys(TRUTH, -1.0)
    assert "true value" not in compare(EMBRYO, SETTINGS | {"force": 113.76}, wrong, ALLOWED)
    assert "embryo.png hold for force = 113.75" in capsys.readouterr().out
    mine = tmp_path / "embryo.png"
    mine.write_bytes(Path(EMBRYO).read_bytes())
    assert "true value" not in compare(mine, SETTINGS, wrong, ALLOWED)
    assert resolve_scales(EMBRYO, dict.fromkeys(SETTINGS))[0] == SETTINGS
    asked = r"force, pixel_size, .* given for .*: -p force VALUE -p pixel_size"
    with pytest.raises(ValueError, match=asked):
        resolve_scales(mine, dict.fromkeys(SETTINGS))
    given, in_file = SETTINGS | {"pixel_size": None}, {"pixel_size": 2.0, "force": 9.0}
    assert resolve_scales(mine, given, in_file)[0] == SETTINGS | {"pixel_size": 2.0}


def test_folder_with_files_is_refused_unless_it_holds_the_table_of_a_stopped_run(tmp_path):
    own = tmp_path / "own"
    assert out_folder(str(own), "embryo") == own
    (own / "07_guide_embryo.log.txt").touch()  # of the run itself
    assert out_folder(str(own), "embryo") == own
    table = own / "moduli.csv"
    table.write_text("modulus\n1.3\n")
    (own / "plate").mkdir()
    for continued in ("", "moduli.csv"):  # the table is the reader's own
        with pytest.raises(
            ValueError, match=r"out must be .*own, which holds moduli.csv and 1 more"
        ):
            out_folder(str(own), "embryo", continued=continued)
    table.write_text("file,modulus\nb.png,1.3\n")
    assert out_folder(str(own), "embryo", continued="moduli.csv") == own
    with pytest.raises(ValueError, match="out must be a new or empty folder"):
        out_folder(str(own), "embryo")
