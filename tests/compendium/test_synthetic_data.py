"""The canonical inputs are what the manifest says, and are made again to the last byte."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from microlib.embryo import modulus_from_image
from microlib.io import read_grey
from microlib.membrane import SmallSlopeWarning

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "data" / "synthetic"


def test_the_manifest_describes_every_file() -> None:
    manifest = tomllib.loads((FOLDER / "MANIFEST.toml").read_text(encoding="utf-8"))
    assert {p.name for p in FOLDER.iterdir()} == {*manifest, "MANIFEST.toml"}
    for name, entry in manifest.items():
        assert hashlib.sha256((FOLDER / name).read_bytes()).hexdigest() == entry["sha256"], name
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 10e6


def test_the_inputs_are_made_again_byte_for_byte(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "compendium.synthetic_data", str(tmp_path)]
    subprocess.run(command, check=True)
    for path in FOLDER.iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_the_embryo_gives_its_modulus_back() -> None:
    with pytest.warns(SmallSlopeWarning):
        found = modulus_from_image(
            read_grey(FOLDER / "embryo.png"),
            113.75,
            pixel_size=3.875,
            thickness=3.0,
            probe_half_width=25.0,
            poisson_ratio=0.5,
        )
    # One image leaves about 1.4 % open; four times that.
    assert np.log(found.modulus / 1.3) == pytest.approx(0.0, abs=0.056)
