"""Inputs are found from any folder, and a result that is not the truth is not let pass."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile

from compendium.guides import FOLDER, Input, compare, find_input, manifest, open_input, out_folder
from microlib.io import read_frames, read_grey

EMBRYO = find_input("embryo.png")
SETTINGS = manifest()["embryo.png"]["settings"]
TRUTH = manifest()["embryo.png"]["truth"]
MINE = Input(EMBRYO, None, SETTINGS, pd.DataFrame())
ALLOWED = {"modulus_MPa": 0.05, "rim_radius_um": 1.0, "dimple_depth_um": 1.0}


@pytest.mark.parametrize("wrong", [0.0, -1.3, 1.36, np.nan, np.inf])
def test_compare_accepts_truth_and_names_wrong_result(wrong):
    near = {name: value + 0.01 for name, value in TRUTH.items()}
    columns = {"values": dict.fromkeys(TRUTH, 1), "found": near, "true value": TRUTH}
    columns |= {"error": pytest.approx(dict.fromkeys(TRUTH, 0.01)), "allowed": ALLOWED}
    assert compare(MINE, near, ALLOWED).to_dict() == columns
    with pytest.raises(AssertionError, match=r"embryo\.png: modulus_MPa is .* off the truth"):
        compare(MINE, TRUTH | {"modulus_MPa": wrong}, ALLOWED)


def test_compare_checks_arrays_against_truth_file():
    path = FOLDER / "frames.tif"
    film = Input(str(path), None, manifest()["frames.tif"]["settings"], pd.DataFrame())
    true = pd.read_csv(FOLDER / "frames_path.csv")
    allowed = {"x_px": 0.05, "y_px": 0.05, "lost_frames": 0.0}
    x = true["x_px"].to_numpy().copy()
    x[7] += 5.0  # one place of forty
    found = {"x_px": x, "y_px": true["y_px"], "lost_frames": 0}
    assert compare(film, found, allowed).loc["x_px", "values"] == len(true)
    for wrong in (x[::-1], x + 0.06, np.full_like(x, np.nan)):
        with pytest.raises(AssertionError, match="x_px"):
            compare(film, found | {"x_px": wrong}, allowed)
    assert "true value" not in compare(film, found | {"x_px": x[:9]}, allowed)  # a part of it


def test_truth_and_scales_are_those_of_the_demo_alone(tmp_path, capsys):
    """With another force, and for another file of the same name, nothing is compared or filled."""
    wrong = dict.fromkeys(TRUTH, -1.0)
    other = replace(MINE, scales=SETTINGS | {"force": 113.76})
    assert "true value" not in compare(other, wrong, ALLOWED)
    assert "embryo.png hold for force = 113.75" in capsys.readouterr().out
    mine = tmp_path / "embryo.png"
    mine.write_bytes(Path(EMBRYO).read_bytes())
    assert "true value" not in compare(replace(MINE, path=str(mine)), wrong, ALLOWED)
    unknown = dict.fromkeys(SETTINGS)
    assert open_input("embryo.png", "", read_grey, **unknown).scales == SETTINGS
    asked = r"force, pixel_size, .* given for .*: -p force VALUE -p pixel_size"
    with pytest.raises(ValueError, match=asked):
        open_input("embryo.png", str(mine), read_grey, SETTINGS, **unknown)


def test_scales_are_those_given_or_of_the_file_or_not_known(tmp_path, capsys):
    path = tmp_path / "mine.tif"
    frames = np.zeros((4, 8, 9), np.uint8)
    of_file = {"axes": "ZYX", "PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0, "PhysicalSizeZ": 7.0}
    tifffile.imwrite(path, frames, photometric="minisblack", metadata=of_file, ome=True)
    names = ("focal_stack.tif", str(path), read_frames)
    mine = open_input(*names, spacing=None, pixel_size=None)
    # Its positions may be uneven, so that they are left to what reads them.
    assert mine.scales == {"spacing": None, "pixel_size": 2.0}
    assert mine.table["value"].to_dict() == {"spacing": 7.0, "pixel_size": 2.0}
    assert mine.table["unit"].tolist() == ["µm", "µm/px"]
    assert mine.table["from"].tolist() == ["the file", "the file"]
    mine = open_input(*names, spacing=-5.0, pixel_size=3.0)
    assert mine.scales == {"spacing": -5.0, "pixel_size": 3.0}
    assert mine.table["from"].tolist() == ["given", "given"]
    assert "focused lower" in capsys.readouterr().out
    tifffile.imwrite(path, frames, photometric="minisblack")
    assert open_input(*names, spacing=None, pixel_size=None).scales["spacing"] == "frame"
    assert "heights are in frames" in (printed := capsys.readouterr().out)
    assert "lengths are in px" in printed
    assert "µm" not in printed
    timed = {"axes": "TYX", "TimeIncrement": 0.04, "TimeIncrementUnit": "s"}
    tifffile.imwrite(path, frames, photometric="minisblack", metadata=timed, ome=True)
    film = open_input("frames.tif", str(path), read_frames, rate=None)
    assert film.table.loc["rate"].tolist() == pytest.approx([25.0, "frames/s", "the file"])
    assert film.scales == {"rate": None}  # each frame has its own time
    with pytest.raises(ValueError, match=r"spacing must be between .* did you mean .*0\.0025mm"):
        open_input("focal_stack.tif", "", read_frames, spacing=0.0025)


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
