"""The guides: on their own input and on the reader's, and what they say of a wrong file."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tifffile

ROOT = Path(__file__).resolve().parents[2]


def run_own(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "compendium.run", *arguments]
    return subprocess.run(
        [*command, "--output", "mine"], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("guide", "parameter", "message"),
    [
        ("focus_stack", "stack", "ValueError: .*mine.tif"),
        ("calibration", "photograph", "ValueError: path must name an image, got .*mine.tif"),
        ("embryo", "photograph", "ValueError: path must name an image, got .*mine.tif"),
        ("tracking", "frames", "ValueError: frames must match at least two files, got 1"),
    ],
)
def test_a_wrong_file_gives_one_clear_line(
    tmp_path: Path, guide: str, parameter: str, message: str
) -> None:
    (tmp_path / "mine.tif").write_bytes(b"II*\0 cut off")
    result = run_own(
        tmp_path, f"07_guide_{guide}", "-p", parameter, "mine.tif", "-p", "out", "kept"
    )
    assert result.returncode == 1
    assert re.search(message, result.stdout), result.stdout
    assert len(result.stdout.strip().splitlines()) == 1
    assert "Traceback" not in result.stdout + result.stderr


def test_a_guide_runs_on_the_readers_own_file(tmp_path: Path) -> None:
    """The example that the book's own run wrote, taken as if it were the reader's."""
    stack = ROOT / "build" / "guides" / "focus" / "example_stack.tif"
    shutil.copy(stack, tmp_path / "mine.tif")
    arguments = ["-p", "stack", "mine.tif", "-p", "out", "kept", "-p", "pixel_size", "2.0"]
    result = run_own(tmp_path, "07_guide_focus_stack", *arguments)
    assert result.returncode == 0, result.stdout
    kept = {path.name for path in (tmp_path / "kept").iterdir()}
    assert kept == {"height.tif", "surface.ply", "regions.csv", "all_in_focus.png"}
    with tifffile.TiffFile(tmp_path / "kept" / "height.tif") as tiff:
        assert "pixel size 2 um" in tiff.pages[0].aspage().description
