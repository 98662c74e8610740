"""Images that others took; what is measured in them stands in notebooks/08_real_images.ipynb."""

import hashlib
import tomllib
from pathlib import Path

import pytest

from microlib.calibration import detect_circles, detect_squares
from microlib.io import read_grey

FOLDER = Path(__file__).resolve().parents[1] / "data" / "real"


def test_real_data_match_their_hash_and_licence():
    manifest = tomllib.loads((FOLDER / "MANIFEST.toml").read_text(encoding="utf-8"))
    assert {path.name for path in FOLDER.iterdir() if path.is_dir()} == set(manifest)
    for name, entry in manifest.items():
        assert all(entry[word] for word in ("source", "author", "license")), name
        images = sorted(p for p in (FOLDER / name).iterdir() if p.name != "LICENSE")
        held = b"".join(path.read_bytes() for path in images)
        assert (len(images), hashlib.sha256(held).hexdigest()) == (entry["files"], entry["sha256"])
        assert (FOLDER / name / "LICENSE").is_file()
    assert sum(path.stat().st_size for path in FOLDER.rglob("*.*")) < 8e6


def test_photograph_without_pattern_is_refused():
    bead, board = (read_grey(next((FOLDER / name).glob("*.*p*"))) for name in ("beads", "board"))
    for image in (bead, board[:300, :400]):
        for detect in (detect_circles, detect_squares):
            with pytest.raises(ValueError, match="image"):
                detect(image)
