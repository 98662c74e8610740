"""The guides: on their own input and on the reader's, and what they say of a wrong file."""

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import nbformat
import numpy as np
import pandas as pd
import pytest
import tifffile

from compendium import run
from compendium.experiments import imaging
from compendium.figures import use_style
from compendium.guides import FOLDER, Input, manifest
from compendium.parameters import read_values
from microlib.synthetic import mixed_texture

ROOT = Path(__file__).resolve().parents[2]
# Each guide with the name of its input's parameter and the default for it.
GUIDES = {
    "calibration": ("photograph", "chessboard"),
    "embryo": ("photograph", "embryo.png"),
    "focus_stack": ("stack", "focal_stack.tif"),
    "modulus": ("outline", "outline.csv"),
    "tracking": ("frames", "beads"),
}
#: Rendered inputs, whose truth is known, for those whose own input is real.
RENDERED = {
    "calibration": "circles.png", "tracking": "frames.tif"
}  # fmt: skip
# Those that take no file of data: they steer a microscope, by default a simulated one.
WITHOUT_INPUT = ("servoing",)
EVERY = (*GUIDES, *WITHOUT_INPUT)


#: What each guide leaves of a file of the reader's.
LEAVES = {
    "calibration": {"camera.csv", "camera.json", "points.csv", "look.png"},
    "embryo": {"modulus.csv", "outline.csv", "look.png"},
    "focus_stack": {
        *(f"{name}.ome.tif" for name in ("height", "uncertainty", "frame", "all_in_focus")),
        *("surface.ply", "surface.stl", "regions.csv", "look.png"),
    },
    "modulus": {"modulus.csv", "models.csv", "inputs.csv", "dimple.png"},
    "tracking": {"track.csv", "look.png"},
    "servoing": {"log.csv", "jacobian.csv", "run.png"},
}


@pytest.fixture(autouse=True, scope="module")
def _style() -> None:
    """Set the style of the figures before a guide does it."""
    use_style()


@pytest.fixture(autouse=True)
def _few_prices(monkeypatch) -> None:
    """Draw the errors of imaging, which depend on no file of a reader's, at one value of each."""
    vary = imaging.vary

    def first(error, **choices):
        few = {name: (label, values[:1]) for name, (label, values) in choices.items()}
        return vary(error, **few)

    monkeypatch.setattr(imaging, "vary", first)


def source(guide: str) -> nbformat.NotebookNode:
    return nbformat.read(ROOT / "notebooks" / f"07_guide_{guide}.ipynb", as_version=4)


def code(guide: str) -> list[str]:
    """Return the code cells, without what is no Python; the parameters come first."""
    cells = [cell.source for cell in source(guide).cells if cell.cell_type == "code"]
    return [text.replace("%xmode Minimal", "") for text in cells]


def test_every_guide_is_tested():
    names = {path.stem.removeprefix("07_guide_") for path in ROOT.glob("notebooks/07_*.ipynb")}
    assert names == set(EVERY)


@pytest.mark.parametrize("guide", EVERY)
def test_executed_guide_compared_its_results_with_truth(guide, claims_folder):
    path = claims_folder.parent / "notebooks" / f"07_guide_{guide}.ipynb"
    cells = nbformat.read(path, as_version=4).cells
    text = str([one for cell in cells for one in cell.get("outputs", [])])
    assert "true value" in text or "true x" in text
    assert "nothing is compared" not in text


def run_here(guide: str, **values: object) -> None:
    """Run a guide in this process, without the second that a kernel takes to start."""
    first, *others = code(guide)
    names: dict[str, object] = {}
    exec(first, names)
    names |= {"out": "kept"} | values
    for text in others:
        exec(text, names)


def copy_input(guide: str, mine: Path) -> dict[str, object]:
    """Copy a rendered input; return its scales, of which nothing is used for another file."""
    name = RENDERED.get(guide, GUIDES[guide][1])
    shutil.copy(FOLDER / name, mine)
    scales = dict(manifest()[name]["settings"])
    scales.pop("poisson_ratio", None)
    return scales


#: Scales without which there is no result.
NEEDED = {
    "calibration": {"pitch"},
    "embryo": {"force", "pixel_size", "thickness", "probe_half_width"},
    "focus_stack": set(),
    "modulus": {"force", "pixel_size", "thickness", "probe_half_width"},
    "tracking": {"box"},
}


def assert_without_scale(folder: Path, printed: str) -> None:
    """No text that the guide prints, and no file that it writes, names a unit of length."""
    assert "heights are in frames" in printed
    text = [line for line in printed.splitlines() if "svg" not in line]
    assert not [line for line in text if "µm" in line]
    assert not list(folder.glob("surface.*"))
    for path in folder.glob("*.ome.tif"):
        with tifffile.TiffFile(path) as file:
            about = file.ome_metadata or ""
        assert "PhysicalSizeX=" not in about, path.name
        assert not re.search("in um|µm", about), path.name
    assert "µm" not in (folder / "regions.csv").read_text()


@pytest.mark.parametrize("guide", GUIDES)
def test_guide_asks_for_the_scales_of_own_file(tmp_path, monkeypatch, capsys, guide):
    parameter, name = GUIDES[guide]
    mine = f"mine{Path(RENDERED.get(guide, name)).suffix}"
    needed = set(copy_input(guide, tmp_path / mine)) & NEEDED[guide]
    monkeypatch.chdir(tmp_path)
    if not needed:
        run_here(guide, **{parameter: mine})
        assert_without_scale(tmp_path / "kept", capsys.readouterr().out)
        return
    with pytest.raises(ValueError, match="must be given for mine") as asked:
        run_here(guide, **{parameter: mine})
    assert set(str(asked.value).partition(" must be given")[0].split(", ")) == needed


@pytest.mark.parametrize("guide", EVERY)
def test_guide_stops_before_it_replaces_own_file(tmp_path, monkeypatch, guide):
    monkeypatch.chdir(tmp_path)
    for name in LEAVES[guide]:
        own = tmp_path / f"for {name}" / name
        own.parent.mkdir()
        own.write_text("mine")
        with pytest.raises(ValueError, match=f"^out must be a new or empty .* holds {name}$"):
            run_here(guide, out=str(own.parent))
        assert own.read_text() == "mine"
        assert list(own.parent.iterdir()) == [own]


#: The cell of each guide that measures a folder of files, and an input to put there.
RECIPES = {"embryo": ("ge-13", "embryo.png"), "focus_stack": ("gf-16", "focal_stack.tif")}


@pytest.fixture(params=["processes", "dask"])
def executor(request, tmp_path, monkeypatch) -> Iterator[dict[str, object]]:
    """Return what a recipe uses in place of `ProcessPoolExecutor`, if anything."""
    monkeypatch.chdir(tmp_path)  # before workers start
    if request.param == "processes":
        yield {}
        return
    distributed = pytest.importorskip("distributed", reason="dask is not installed")
    quiet = {"dashboard_address": ":0", "silence_logs": 50}
    with distributed.Client(n_workers=2, threads_per_worker=1, **quiet) as client:
        yield {"ProcessPoolExecutor": lambda **_: client.get_executor()}


@pytest.mark.parametrize("guide", RECIPES)
def test_folder_recipe_writes_one_row_per_file(tmp_path, capsys, guide, executor):
    """A damaged file has its error in its row; a second run evaluates only what has no row."""
    cell, name = RECIPES[guide]
    (recipe,) = [one.source for one in source(guide).cells if one.id == cell]
    assert len(recipe.splitlines()) <= 20
    settings = dict(manifest()[name]["settings"])
    names: dict[str, object] = {"mine": Input("", None, settings, pd.DataFrame())}
    for text in code(guide)[:2]:
        exec(text, names)
    names |= {"options": {"reduce": 4, "spacing": 25.0}, "known_size": 3.9, "size": 3.9 * 4}
    names |= {"folder": tmp_path, "more": f"plate/*{Path(name).suffix}"}
    plate = tmp_path / "plate"
    plate.mkdir()
    files = [plate / f"{letter}{Path(name).suffix}" for letter in "abc"]
    for file in files[:2]:
        shutil.copy(FOLDER / name, file)
    files[1].write_bytes(files[1].read_bytes()[:2000])
    names |= executor
    exec(recipe, names)
    shutil.copy(FOLDER / name, files[2])
    files[0].unlink()  # its row must stay, and it must not be looked for
    exec(recipe, names)
    table = pd.read_csv(names["table"], index_col="file").sort_index()
    assert table.index.tolist() == [f"plate/{file.name}" for file in files]
    assert [str(error)[:12] for error in table["error"].fillna("")] == ["", "ValueError: ", ""]
    measured = table.drop(columns="error").select_dtypes("number")
    assert measured.iloc[1].isna().all()
    pd.testing.assert_series_equal(measured.iloc[0], measured.iloc[2], check_names=False)
    if guide == "embryo":
        (summary,) = [one.source for one in source(guide).cells if one.id == "ge-14"]
        exec(summary, names)
        assert "3 images, 1 of them without a modulus\nb.png: Val" in capsys.readouterr().out


def printed_commands() -> list[tuple[str, list[str]]]:
    """Return the arguments of each command that a guide prints."""
    found = []
    for guide in EVERY:
        text = "".join(cell.source for cell in source(guide).cells if cell.cell_type == "markdown")
        for block in re.findall(r"```sh\n(.*?)```", text, flags=re.S):
            words = shlex.split(block.replace("\\\n", ""))
            found.append((guide, words[words.index("compendium.run") + 1 :]))
    return found


def write_inputs(guide: str) -> None:
    """Write the files that the command of a guide names."""
    if guide in GUIDES and guide != "tracking":
        name = RENDERED.get(guide, GUIDES[guide][1])
        shutil.copy(FOLDER / name, f"mine{Path(name).suffix}")
    elif guide == "tracking":  # a texture of 400 × 300 px that moves by half a pixel a frame
        size = (400, 300)
        film = cv2.VideoWriter("my_film.mp4", cv2.VideoWriter.fourcc(*"mp4v"), 33.0, size)
        scene = mixed_texture((320, 420), 3).astype(np.uint8)
        for k in range(20):
            shift = np.array([[1.0, 0.0, -k / 2], [0.0, 1.0, 0.0]])
            film.write(cv2.cvtColor(cv2.warpAffine(scene, shift, size), cv2.COLOR_GRAY2BGR))
        film.release()
    else:
        find = pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed")
        demo = Path(find.find_micromanager()) / "MMConfig_demo.cfg"
        more = "\nProperty,Camera,Mode,Fluorescent Beads\n"
        Path("my_microscope.cfg").write_text(demo.read_text() + more)


@pytest.mark.parametrize(("guide", "words"), printed_commands())
def test_printed_command_of_guide_runs(tmp_path, monkeypatch, capsys, guide, words):
    monkeypatch.chdir(tmp_path)
    write_inputs(guide)
    options = run.parse(words)
    (name,) = run.choose(options.names)
    values = read_values(ROOT / "notebooks" / f"{name}.ipynb", options.own)
    run_here(guide, **values)
    out = Path(str(values["out"]))
    assert list(out.glob("*.csv"))
    parameter = GUIDES.get(guide, ("",))[0]
    if mine := values.get(parameter):
        assert {path.name for path in out.iterdir()} == LEAVES[guide]
        text = capsys.readouterr().out
        assert f"{mine}, your own" in text
        if guide not in RENDERED:
            assert f"The true values of {mine} are not known" in text


def test_modulus_guide_accepts_numbers_and_reports_steep_dimple(tmp_path, monkeypatch, capsys):
    """Table 5.6, whose modulus is 1.3237 MPa from unrounded lengths."""
    monkeypatch.chdir(tmp_path)
    numbers = {"rim_radius": 246.95, "dimple_depth": 121.22, "force": 197.24}
    sizes = {"thickness": 3.0, "probe_half_width": 25.0, "capsule_radius": 600.0}
    run_here("modulus", **numbers, **sizes)
    found = pd.read_csv(tmp_path / "kept" / "modulus.csv", index_col="quantity")["value"]
    assert found["modulus_MPa"] == pytest.approx(1.3237, abs=2e-4)
    # Independent solutions of the disc: 0.549 of (5.2) for Hooke's law, 1.028 for neo-Hooke's over
    # an open hole; the capsule of 600 µm lies between.
    assert "E = 0.727 to 1.36 MPa over 7 models" in capsys.readouterr().out
    models = pd.read_csv(tmp_path / "kept" / "models.csv", index_col="model")["modulus_MPa"]
    assert models["capsule, hooke"] == pytest.approx(0.88, abs=0.005)


def test_modulus_without_standard_deviations_has_no_interval(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    numbers = {"rim_radius": 250.0, "dimple_depth": 45.7, "force": 10.0}
    run_here("modulus", **numbers, thickness=3.0, probe_half_width=25.0)
    found = pd.read_csv(tmp_path / "kept" / "modulus.csv", index_col="quantity")["value"]
    unknown = {
        "modulus_uncertainty_MPa",
        *(f"modulus_{one}_MPa" for one in ("low68", "high68", "low95", "high95")),
    }
    assert set(found.index[found.isna()]) == unknown
    text = capsys.readouterr().out
    assert "No interval is known" in text
    assert "±" not in text


def test_servo_run_that_ends_early_keeps_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="the run ended early: target 0 is beyond the travel"):
        run_here("servoing", targets=[[400, 0]])
    log = pd.read_csv("kept/log.csv")
    assert log["phase"].tolist() == ["start"] + ["calibration"] * 8 + ["end"]
    jacobian = pd.read_csv("kept/jacobian.csv", index_col=0)["value"].to_numpy()[:4]
    true = 0.2 * np.array([np.cos(2.2), np.sin(2.2), np.sin(2.2), -np.cos(2.2)])
    np.testing.assert_allclose(jacobian, true, atol=0.002)
