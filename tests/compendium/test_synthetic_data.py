"""The canonical inputs are what the manifest says, and are made again within a grey level."""

import subprocess
import sys
import tomllib
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "data" / "synthetic"
FILES = [path for path in FOLDER.iterdir() if path.is_file() and path.suffix != ".py"]


def test_manifest_describes_every_file():
    manifest = tomllib.loads((FOLDER / "MANIFEST.toml").read_text(encoding="utf-8"))
    assert {p.name for p in FILES} == {*manifest, "MANIFEST.toml"}
    for name, entry in manifest.items():
        assert entry["what"], name
        assert (FOLDER / entry.get("truth_file", name)).is_file(), name
    assert sum(path.stat().st_size for path in FILES) < 4e6


def test_synthetic_inputs_are_reproducible(tmp_path):
    """Another processor rounds a pixel to the next grey level, a height in single precision."""
    command = [sys.executable, "-m", "data.synthetic.make", str(tmp_path)]
    subprocess.run(command, check=True, cwd=ROOT)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in FILES}
    for path in FILES:
        if path.suffix == ".toml":
            assert (tmp_path / path.name).read_text() == path.read_text()
            continue
        read = pd.read_csv if path.suffix == ".csv" else imageio.imread
        made, kept = (np.asarray(read(folder / path.name), float) for folder in (tmp_path, FOLDER))
        # In tables the last digit that is written of an outline, in px; in images a grey level.
        off = {".csv": 0.00101, ".png": 1}.get(path.suffix, 1e-4 if "height" in path.name else 1)
        np.testing.assert_allclose(made, kept, rtol=1e-6, atol=off, err_msg=path.name)
        assert off < 1 or (made != kept).mean() < 1e-3, path.name
