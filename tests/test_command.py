"""The command line: four tasks on the small inputs, whose truth is known, and what it refuses."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile

from microlib._command import main

ROOT = Path(__file__).resolve().parent.parent
INPUTS = ROOT / "data" / "synthetic"
MODULUS = "--force 10 --pixel-size 3.875 --thickness 3 --probe-half-width 25"


def run(task: str, source: str, options: str, out: Path) -> str:
    """Run a task in a process of its own; return what it prints."""
    line = [sys.executable, "-m", "microlib", task, INPUTS / source, *options.split(), "-o", out]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_depth_writes_the_heights_to_scale(tmp_path: Path) -> None:
    told = run("depth", "focal_stack.tif", "--spacing 25 --pixel-size 3.9", tmp_path)
    assert "spacing 25 (given)" in told
    truth = tifffile.imread(INPUTS / "height_um.tif") + 50  # whose first frame is at -50 µm
    off = np.abs(tifffile.imread(tmp_path / "height.ome.tif") - truth)
    assert np.nanquantile(off, 0.95) < 5  # a fifth of the spacing, as in the guide
    assert json.loads((tmp_path / "summary.json").read_text())["pixel_size"] == 3.9
    assert (tmp_path / "surface.ply").stat().st_size > 1000
    # The file that was written tells its scale: it is asked for no more.
    stack = np.stack([tifffile.imread(tmp_path / "all_in_focus.ome.tif")] * 3)
    metadata = {"axes": "ZYX", "PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0, "PhysicalSizeZ": 7.0}
    tifffile.imwrite(tmp_path / "own.ome.tif", stack, metadata=metadata)
    told = run("depth", str(tmp_path / "own.ome.tif"), "--reduce 2", tmp_path)
    assert "spacing 7 (the file)" in told
    assert "pixel_size 2 (the file)" in told


def test_calibrate_finds_the_microscope(tmp_path: Path) -> None:
    told = run("calibrate", "circles.png", "--pitch 280 --cell 9.9 --focal-length 126150", tmp_path)
    assert "pitch 280 (given)" in told
    camera = pd.read_csv(tmp_path / "camera.csv", index_col="parameter")
    truth = {"magnification": 1.5892988, "alpha": 0.03, "beta": -0.02, "gamma": 0.0}
    for name, value in truth.items():
        off = abs(camera.loc[name, "estimate"] - value)
        assert off < 4 * camera.loc[name, "sigma"], name
    assert len(pd.read_csv(tmp_path / "points.csv")) == 149
    assert json.loads((tmp_path / "camera.json").read_text())["micro_manager"]["PixelSizeUm"]


def test_track_follows_the_square(tmp_path: Path) -> None:
    options = "--box 30 40 40 40 --rate 33 --pixel-size 6.23"
    told = run("track", "frames.tif", options, tmp_path / "track.csv")
    assert "lost in 0 of 40 frames" in told
    table, truth = pd.read_csv(tmp_path / "track.csv"), pd.read_csv(INPUTS / "frames_path.csv")
    way = table[["center_x", "center_y"]].to_numpy()
    assert np.abs(way - truth[["x_px", "y_px"]].to_numpy()).max() < 0.1
    assert table["x_um"].to_numpy() == pytest.approx(6.23 * (way[:, 0] - way[0, 0]), abs=1e-6)
    assert table["time_s"].iloc[-1] == pytest.approx(39 / 33)


def test_every_motion_of_the_help_is_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["track", "--help"])
    motions = re.search(r"--motion \{(.*?)\}", capsys.readouterr().out)[1].split(",")
    assert len(motions) == 3
    line = ["track", str(INPUTS / "frames.tif"), "--box", "30", "40", "40", "40"]
    for motion in motions:
        assert main([*line, "--motion", motion, "-o", str(tmp_path / "track.csv")]) == 0
        assert "lost in 0 of 40 frames" in capsys.readouterr().out


def test_modulus_holds_the_truth(tmp_path: Path) -> None:
    run("modulus", "outline.csv", MODULUS, tmp_path / "modulus.csv")
    found = pd.read_csv(tmp_path / "modulus.csv", index_col="quantity")["value"]
    assert found["modulus_low95_MPa"] < 1.3 < found["modulus_high95_MPa"]
    assert found["dimple_radius"] == pytest.approx(250, abs=3.875)  # a pixel


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("depth focal_stack.tif --spacing 25", "give --pixel-size VALUE"),
        ("depth focal_stack.tif", "give --spacing VALUE, --pixel-size VALUE"),
        ("depth missing.tif --spacing 25 --pixel-size 1", "missing.tif"),
        ("calibrate circles.png --cell 9.9", "give --pitch VALUE"),
        ("calibrate embryo.png --cell 9.9 --pitch 280", "microlib calibrate: "),
        ("track frames.tif --box 0 0 400 40", "microlib track: box"),
        ("modulus outline.csv", "give --force VALUE, --pixel-size VALUE, --thickness VALUE"),
        (f"modulus frames_path.csv {MODULUS}", "columns x and y"),
        (f"modulus missing.csv {MODULUS}", "missing.csv: No such file"),
        (f"modulus outline.csv {MODULUS} --thickness -3", "thickness"),
    ],
)
def test_what_cannot_work_is_told_in_one_line(
    line: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task, source, *options = line.split()
    assert main([task, str(INPUTS / source), *options, "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert not list(tmp_path.glob("*.csv"))


@pytest.mark.parametrize("task", ["depth", "calibrate", "track", "modulus"])
def test_help_shows_an_example(task: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main([task, "--help"])
    assert f"Example: microlib {task} " in capsys.readouterr().out
