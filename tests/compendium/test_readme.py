"""The commands that the README and the page Start print give the truth of their inputs."""

import re
import shlex

import numpy as np
import pandas as pd
import pytest
import tifffile

from compendium import ROOT
from compendium.guides import FOLDER, manifest
from microlib.__main__ import main

README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMAND = r"^microlib (depth|calibrate|track|modulus) (.*)$"
COMMANDS = re.findall(COMMAND, README, re.M)


def test_start_page_has_commands_of_readme():
    assert len(COMMANDS) == 4
    assert re.findall(COMMAND, (ROOT / "book" / "start.md").read_text("utf-8"), re.M) == COMMANDS


@pytest.mark.parametrize(("task", "text"), COMMANDS, ids=lambda value: value.split()[0])
def test_readme_command_reproduces_truth(tmp_path, monkeypatch, capsys, task, text):
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    assert main([task, *shlex.split(text)]) == 0
    if task == "depth":
        off = tifffile.imread("heights/height.ome.tif") - tifffile.imread(FOLDER / "height_um.tif")
        # µm; where it starts is not given.
        assert np.nanmedian(np.abs(off - np.nanmedian(off))) < 1.0
    elif task == "calibrate":
        assert float(re.search(r"([\d.]+) px rms residual", capsys.readouterr().out)[1]) < 0.01
    elif task == "track":
        found = pd.read_csv("track.csv")[["center_x", "center_y"]]
        true = pd.read_csv(FOLDER / "frames_path.csv")[["x_px", "y_px"]]
        np.testing.assert_allclose(found, true, atol=0.1)
    else:
        values = pd.read_csv("modulus.csv", index_col="quantity")["value"]
        true = manifest()["outline.csv"]["truth"]["modulus_MPa"]
        assert values["modulus_low_MPa"] < true < values["modulus_high_MPa"]
