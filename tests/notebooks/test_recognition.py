"""The cell of the page on recognition that names a reader's height map, run on files."""

import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
import tifffile

from compendium.experiments import recognition
from microlib.io import write_height_tiff

NOTEBOOK = Path(__file__).resolve().parents[2] / "notebooks" / "08_recognition.ipynb"
CELLS = {cell.id: cell.source for cell in nbformat.read(NOTEBOOK, as_version=4).cells}
PARTS = ("cone", "step", "parabolic ridge")


def height(part: str, seed: int) -> np.ndarray:
    """Return heights of a part in a pose of its own, with an error of 1 µm."""
    rng = np.random.default_rng(seed)
    true = recognition.surface(recognition.PARTS[part], recognition.random_pose(rng))[0]
    found = true + rng.normal(0, 1.0, true.shape)
    found[:3, 40:50] = np.nan  # a hole, as depth from focus leaves them
    return found


def write(path: Path, part: str, seed: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, height(part, seed))
    else:
        write_height_tiff(path, height(part, seed), pixel_size=recognition.PIXEL)


def run_cell(mine: Path, labeled: Path, pixel_size: float | None) -> dict[str, object]:
    names: dict[str, object] = {"mine": str(mine), "labeled": str(labeled)}
    names |= {"pixel_size": pixel_size, "noise": 1.0, "np": np, "re": re, "tifffile": tifffile}
    names |= {"Path": Path, "recognition": recognition}
    exec(CELLS["rec-use"], names)
    return names


@pytest.mark.parametrize(("ending", "pixel_size"), [("ome.tif", None), ("npy", 4.0)])
@pytest.mark.parametrize("part", PARTS)
def test_part_in_own_height_map_is_named_by_labeled_maps(tmp_path, part, ending, pixel_size):
    for k, name in enumerate(PARTS):
        for seed in range(4):
            write(tmp_path / "labeled" / name / f"{seed}.{ending}", name, 10 * k + seed)
    (tmp_path / "labeled" / "notes.txt").touch()
    mine = tmp_path / f"mine.{ending}"
    write(mine, part, 99)
    names = run_cell(mine, tmp_path / "labeled", pixel_size)
    assert names["answer"]["name"].tolist() == [part]


def test_unit_of_pixel_size_is_read_from_file(tmp_path):
    for k, name in enumerate(PARTS):
        for seed in range(2):
            write(tmp_path / "labeled" / name / f"{seed}.ome.tif", name, 10 * k + seed)
    mine, heights = tmp_path / "mine.ome.tif", height("cone", 99).astype(np.float32)
    distances = []
    for size, unit in ((4.0, "µm"), (4e-3, "mm"), (4000.0, "nm")):
        scale = {"PhysicalSizeX": size, "PhysicalSizeXUnit": unit}
        tifffile.imwrite(mine, heights, ome=True, metadata={"axes": "YX", **scale})
        answer = run_cell(mine, tmp_path / "labeled", None)["answer"]
        distances.append(answer["distance"].item())
    assert distances == pytest.approx(distances[:1] * 3, rel=1e-9)
    scale = {"PhysicalSizeX": 4.0, "PhysicalSizeXUnit": "inch"}
    tifffile.imwrite(mine, heights, ome=True, metadata={"axes": "YX", **scale})
    with pytest.raises(ValueError, match=r"pixel_size of mine\.ome\.tif must be in µm, got inch"):
        run_cell(mine, tmp_path / "labeled", None)


def test_a_map_without_a_pixel_size_asks_for_it(tmp_path):
    write(tmp_path / "labeled" / "cone" / "1.npy", "cone", 1)
    with pytest.raises(ValueError, match=r"pixel_size must be given, as 1\.npy does"):
        run_cell(tmp_path / "mine.npy", tmp_path / "labeled", None)
