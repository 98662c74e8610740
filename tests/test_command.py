"""The four commands on small inputs with known truth, and their errors."""

import contextlib
import csv
import json
import logging
import os
import re
import shlex
import subprocess
import sys
from argparse import Namespace
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import tifffile
from matplotlib.figure import Figure
from PIL import Image

import microlib
from microlib import calibration, io, membrane, tracking
from microlib.__main__ import main
from microlib.embryo import dimple_from_outline
from microlib.estimate import Estimate
from microlib.focus import FocusResult, depth_from_focus
from microlib.synthetic import focal_stack, mixed_texture
from tests.checks import hold_same
from tests.scenes import moving_square, straight_step
from tests.scenes.calibration import ruled
from tests.scenes.files import read_ply, read_stl, varied_times

ROOT = Path(__file__).resolve().parent.parent
INPUTS = ROOT / "data" / "synthetic"
MODULUS = "--pixel-size 3.875 --thickness 3 --probe-half-width 25 --poisson-ratio 0.5"
BOX = "--box 30 40 40 40"
#: A part that fills three quarters of its box of 49×49 px.
DISC = np.hypot(*(np.indices((160, 173)) - 84)) < 24
STACK = "depth focal_stack.tif --spacing 25 --pixel-size 3.9"
GRID = "calibrate circles.png --pitch 0.28mm --pixel-pitch 9.9um --focal-length 126150"
LINES = "--marks micrometer --division 10"
OUTLINE = f"modulus outline.csv --force 10 --force-uncertainty 3 {MODULUS}"

POINTS = pd.read_csv(INPUTS / "outline.csv")
NUMBERS = ["value", "uncertainty", "low", "high"]
pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")


def status(line: str, out: Path | str, look: str = "--no-look") -> int:
    """Run a task on a file of the inputs, without a picture; return its exit status."""
    task, source, *options = shlex.split(line)
    try:
        return main([task, str(INPUTS / source), *options, *look.split(), "-o", str(out)])
    except SystemExit as end:
        return int(end.code)


def run_alone(line: str, out: Path, monkeypatch) -> int:
    """Run a task as a program of its own, which changes its streams; return its exit status."""
    given = ["microlib", *shlex.split(line), "--no-look", "-o", str(out)]
    monkeypatch.setattr(sys, "argv", given)
    monkeypatch.setattr(os, "environ", os.environ.copy())
    return main()


@pytest.fixture
def figures(monkeypatch):
    """Return the figures that are saved."""
    seen: list[Figure] = []
    save = Figure.savefig
    keep = lambda figure, *given, **how: (seen.append(figure), save(figure, *given, **how))  # noqa: E731
    monkeypatch.setattr(Figure, "savefig", keep)
    return seen


def hold_alike(found: object, wanted: object, within: float = 1e-7) -> None:
    """Compare numbers that were written with ten digits or more, by default."""
    hold_same(wanted, found, within=within)


@pytest.mark.parametrize(
    ("line", "out", "file"),
    [
        (STACK, "out", "out/look.png"),
        (GRID, "out", "out/camera.csv"),
        (f"track frames.tif {BOX} --rate 33 --pixel-size 6.23", "track.csv", "track.csv"),
        (OUTLINE, "out.csv", "out_look.png"),
    ],
    ids=["depth", "calibrate", "track", "modulus"],
)
def test_existing_output_is_kept_without_overwrite(line, out, file, tmp_path, capsys):
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
    path.write_text("mine")
    assert status(line, tmp_path / out, "") == 2
    printed = capsys.readouterr()
    assert f"{path} exists already" in printed.err
    assert not printed.out  # it was found before the work
    assert path.read_text() == "mine"
    assert status(line, tmp_path / out, "--overwrite") == 0
    assert path.read_bytes() != b"mine"
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"{path.parent}: ")
    (look,) = path.parent.glob("*look.png")
    with Image.open(look) as picture:  # not a small one, nor of one color
        assert min(picture.size) > 300
        assert np.ptp(np.asarray(picture.convert("L"))) > 100


def test_mesh_or_picture_that_fails_gives_a_note(tmp_path, capsys, monkeypatch):
    """A mesh needs a height; the mesh of an earlier run is removed."""
    fail = Mock(side_effect=RuntimeError("latex could not be found\n" * 80))
    monkeypatch.setattr(FocusResult, "plot", fail)
    tifffile.imwrite(tmp_path / "flat.tif", np.full((7, 64, 80), 100, np.uint8))
    (tmp_path / "surface.ply").write_text("of another run")
    line = f"depth {tmp_path / 'flat.tif'} --spacing 10 --pixel-size 1"
    assert status(line, tmp_path, "--overwrite") == 0
    *meshes, look, unknown, removed = capsys.readouterr().err.splitlines()
    assert "no height is known: frames must differ in focus" in unknown
    for note, ending in zip(meshes, ("ply", "stl"), strict=True):
        assert note.startswith(f"note: surface.{ending} is not written: height must have")
    assert look.startswith("note: look.png is not written: RuntimeError: latex could not")
    assert removed == f"note: {tmp_path / 'surface.ply'} of an earlier run is removed"
    assert not (tmp_path / "surface.ply").exists()
    assert (tmp_path / "summary.json").exists()


REGION = {"region": (9, 5, 60, 44)}


@pytest.mark.filterwarnings("ignore:frames change in position")  # of the library
@pytest.mark.parametrize(
    ("line", "options", "size"),
    [
        ("--spacing -.007mm --region 9 5 60 44 --reduce 2",
            {"spacing": -7.0, "reduce": 2, **REGION}, 3.0),
        ("--spacing 0.007mm --register --workers 2", {"spacing": 7.0, "register": True}, 1.5),
        ("--pixel-size 2500nm/px --register --reduce 2", {"register": True, "reduce": 2}, 5.0),
        ("--region 9 5 60 44 --workers 2", REGION, 1.5),
        ("--register auto", {}, 1.5),
        ("--register auto --pixel-size 2.5", {"register": "auto"}, 2.5),
    ],
)  # fmt: skip
def test_depth_writes_what_the_library_returns(line, options, size, tmp_path, capsys, figures):
    """The options replace the spacing and the pixel size in the file. What is registered moves."""
    levels = mixed_texture((70, 90), np.random.default_rng(0)).astype(np.float32)
    frames = [cv2.GaussianBlur(levels, (0, 0), 0.5 + abs(k - 2.6)) for k in range(7)]
    if "register" in options:
        frames = [np.roll(frame, 2 * k, axis=1) for k, frame in enumerate(frames)]
    sizes = {"PhysicalSizeX": 1.5, "PhysicalSizeY": 1.5, "PhysicalSizeZ": 4.0}
    tifffile.imwrite(tmp_path / "z.ome.tif", np.stack(frames), metadata={"axes": "ZYX", **sizes})
    assert status(f"depth {tmp_path / 'z.ome.tif'} {line}", tmp_path / "out", "") == 0
    printed, notes = capsys.readouterr()
    assert ("frames change in position" in notes) == (options.get("register") == "auto")
    for name, scale in (("spacing", "4 µm"), ("pixel_size", "1.5 µm/px")):
        given = f"--{name.replace('_', '-')}" in line
        assert f"{name} {scale} (the file)" in printed or given
        assert f"{name} {scale}" not in printed or not given
    at_rest = (
        "not registered; motion of less than 0.1 % of the shorter side per frame is not detected"
    )
    assert (at_rest in printed) == (options == {})
    if "spacing" not in options:
        options = {"positions": 4.0 * np.arange(7), **options}
    found = depth_from_focus(np.stack(frames), **options)
    maps = {
        "height": found.depth, "uncertainty": found.uncertainty, "frame": found.index,
        "all_in_focus": found.all_in_focus,
    }  # fmt: skip
    for name, values in maps.items():
        with tifffile.TiffFile(tmp_path / "out" / f"{name}.ome.tif") as file:
            hold_alike(file.asarray(), values)
            assert f'PhysicalSizeX="{size}"' in file.ome_metadata
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    spacing = options.get("spacing", 4.0)
    hold_alike(summary, found.to_dict() | {"spacing": spacing, "pixel_size": size})
    sharp = (found.all_in_focus - found.all_in_focus.min()) / np.ptp(found.all_in_focus)
    own = {"height": found.depth, "image": (255 * sharp).astype(np.uint8)}
    io.write_ply(tmp_path / "own.ply", **own, pixel_size=size)
    mesh, own = (read_ply(tmp_path / name) for name in ("out/surface.ply", "own.ply"))
    np.testing.assert_allclose(mesh["vertices"], own["vertices"], rtol=1e-6, atol=1e-6)
    # A grey level by rounding.
    np.testing.assert_allclose(mesh["colors"].astype(int), own["colors"], atol=1)
    height = figures[0].axes[1]
    hold_alike(height.images[0].get_array().filled(np.nan), found.depth)
    (bar,) = height.artists
    (length,) = (part.get_width() for part in bar.size_bar.get_children())
    assert bar.txt_label.get_text() == f"{size * length:g} µm"


@pytest.mark.parametrize("color", [False, True])
def test_heights_beyond_the_largest_uncertainty_are_left_out(color, tmp_path, capsys):
    """A step is uncertain; the picture and the mesh have the colors of the frames."""
    height = straight_step((64, 84), 24.0) + 8
    stack = focal_stack(mixed_texture(height.shape, 3), height, 4.0 * np.arange(11), blur_rate=0.25)
    stack = np.rint(stack[..., None] * [1, 0.8, 0.6]).astype(np.uint8) if color else stack
    kind = "rgb" if color else "minisblack"
    tifffile.imwrite(tmp_path / "z.tif", stack, photometric=kind)
    line = f"depth {tmp_path / 'z.tif'} --spacing 4 --pixel-size 1.5 --max-uncertainty 500nm"
    assert status(line, tmp_path / "out") == 0
    found = depth_from_focus(stack, spacing=4.0)
    known = found.uncertainty <= 0.5
    assert 0.3 < known.mean() < 0.95
    maps = ("height", "uncertainty", "frame", "all_in_focus")
    files = [tmp_path / "out" / f"{name}.ome.tif" for name in maps]
    height, uncertainty, frame, sharp = (tifffile.imread(file) for file in files)
    hold_alike(height, np.where(known, found.depth, np.nan))
    hold_alike(uncertainty, np.where(known, found.uncertainty, np.nan))
    np.testing.assert_array_equal(frame, np.where(known, found.index, -1))
    np.testing.assert_array_equal(sharp, found.all_in_focus)
    with Image.open(tmp_path / "out" / "all_in_focus.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), sharp)
    mesh = read_ply(tmp_path / "out" / "surface.ply")
    assert len(mesh["vertices"]) == known.sum()
    levels = sharp[known] if color else np.repeat(sharp[known][:, None], 3, axis=1)
    np.testing.assert_array_equal(mesh["colors"], levels)
    facets = read_stl(tmp_path / "out" / "surface.stl")
    np.testing.assert_array_equal(facets["corners"], mesh["vertices"][mesh["faces"]])
    line = line.replace("500nm", "0")
    assert status(f"{line} --overwrite", tmp_path / "out") == 2
    assert "--max-uncertainty must be positive" in capsys.readouterr().err


def test_mesh_of_a_large_map_has_the_size_of_the_map(tmp_path):
    """A mesh of more than 250 000 vertices leaves out every second row and column."""
    levels = mixed_texture((420, 600), np.random.default_rng(0)).astype(np.float32)
    frames = [cv2.GaussianBlur(levels, (0, 0), 0.6 + abs(k - 2)) for k in range(5)]
    tifffile.imwrite(tmp_path / "z.tif", np.stack(frames), photometric="minisblack")
    line = f"depth {tmp_path / 'z.tif'} --spacing 25 --pixel-size 2"
    assert status(line, tmp_path / "out") == 0
    x, y, _ = read_ply(tmp_path / "out" / "surface.ply")["vertices"].T
    assert np.ptp(x) == pytest.approx(2 * 598, abs=4)
    assert np.ptp(y) == pytest.approx(2 * 418, abs=4)


def chessboards() -> list[np.ndarray]:
    """Draw five views of a tilted chessboard through one lens of 900 px."""
    flat = np.pad(np.kron(np.indices((7, 9)).sum(axis=0) % 2, np.ones((40, 40))), 60)
    camera, images = np.array([[900, 0, 239.5], [0, 900, 199.5], [0, 0, 1]]), []
    for k in range(5):
        turn = cv2.Rodrigues(np.array([0.3 * np.cos(2.5 * k), 0.4 * np.sin(2.5 * k), 0.1 * k]))[0]
        turn[:, 2] = [0, 0, 1000] - turn @ [239.5, 199.5, 0]
        view = cv2.warpPerspective(200 * flat, camera @ turn, (480, 400), flags=cv2.INTER_AREA)
        images.append(cv2.GaussianBlur(view + 20, (0, 0), 1.0).astype(np.uint8))
    return images


@pytest.mark.parametrize(
    ("line", "given"),
    [
        ("--pitch 100", {"pixel_pitch": None}),
        ("--pitch 0.1mm --pitch-y 99 --pixel-pitch 5000nm --focal-length 0.16cm --marks chessboard",
            {"pitch": (100.0, 99.0), "focal_length": 1600.0}),
    ],
)  # fmt: skip
def test_calibrate_writes_what_the_library_returns(line, given, tmp_path, capsys, figures):
    """Without photographs of nothing, of another size and of other aspect ratios."""
    images, photos = chessboards(), [tmp_path / f"view_{k}.png" for k in range(5)]
    others = {
        "blank[1]": np.full((400, 480), 200, np.uint8),
        "view_wide": np.pad(images[0], 4, mode="edge"),
        "view_stretched": cv2.resize(images[1], None, fx=1.5, fy=1.0)[:, 120:600],
        "view_tall": cv2.resize(images[2], None, fx=1.0, fy=1.4)[80:480],
    }
    for photo, image in zip(photos, images, strict=True):
        cv2.imwrite(str(photo), image)
    for name, image in others.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    line = f"calibrate {tmp_path}/view_[stw]*.png {' '.join(map(str, photos))} {line}"
    assert status(line.replace(" --", f" {tmp_path}/blank[1].png --", 1), tmp_path / "out", "") == 0
    printed = capsys.readouterr()
    assert printed.out.count("png: chessboard: Detection of 48 points") == 8
    assert f"left out {tmp_path}/blank[1].png: " in printed.err
    assert "wide.png: its size is 488×408 px, of most 480×400" in printed.err
    others = re.findall(r"(\w+).png: it shows another pattern or lens than the", printed.err)
    assert sorted(others) == ["view_stretched", "view_tall"]
    # The same as the calls of the library.
    found = [calibration.detect_squares(image, pattern="chessboard") for image in images]
    result = calibration.calibrate(found, **{"pitch": 100.0, "pixel_pitch": 5.0} | given)
    assert str(result) in printed.out
    camera = json.loads((tmp_path / "out" / "camera.json").read_text())
    hold_alike(camera, json.loads(result.to_json()))
    table = pd.read_csv(tmp_path / "out" / "camera.csv", index_col="parameter")
    table = table.fillna({"unit": ""})  # of the magnification
    exact = result.to_frame().astype(table.dtypes)
    step = exact["uncertainty"].replace([0, np.inf], np.nan) / 100  # of three digits or more
    np.testing.assert_array_less(
        (table[NUMBERS] - exact[NUMBERS]).abs().div(step, axis=0).fillna(0), 0.51
    )
    hold_alike(table.drop(columns=NUMBERS), exact.drop(columns=NUMBERS))
    pairs = zip(found, photos, strict=True)
    tables = pd.concat([each.to_frame().assign(photo=str(photo)) for each, photo in pairs])
    points = pd.read_csv(tmp_path / "out" / "points.csv")
    hold_alike(points, tables.reset_index(drop=True)[points.columns])
    for ax, each, image in zip(figures[0].axes, found, images, strict=False):
        np.testing.assert_allclose(np.transpose(ax.lines[0].get_data()), each.points)
        np.testing.assert_allclose(ax.images[0].get_array(), (image - 20.0) * 1.275, atol=2)


def test_micrometers_give_a_table_of_objectives(tmp_path, capsys, figures):
    """Divisions that are finer than the name says are noted; a blank photograph is left out."""
    gaps = {"2x": 15.7, "10x": 15.7, "20x": 31.1, "40x, dry": 62.9, "63x": 15.7}
    for name, gap in gaps.items():
        places = gap * np.arange(np.ceil(-120 / gap), 121 / gap)
        cv2.imwrite(str(tmp_path / f"{name}.png"), ruled(places, 60.0, gap / 5))
    cv2.imwrite(str(tmp_path / "blank.png"), np.full((90, 120), 100, np.uint8))
    line = f"calibrate '{tmp_path}/*.png' --marks micrometer --division 0.01mm"
    assert status(line, tmp_path / "out", "") == 0
    printed = capsys.readouterr()
    assert f"left out {tmp_path}/blank.png: image must show a scale" in printed.err
    assert re.search(r"note: 63x: its pixel size is 6.\d+ times .* other divisions\?", printed.err)
    assert "note: 2x: its pixel size is 0.2 times" in printed.err
    table = pd.read_csv(tmp_path / "out" / "objectives.csv", index_col="objective")
    names = [name.replace(",", "_") for name in gaps]
    assert [*table.index] == names
    assert {*table.unit} == {"µm/px"}
    true = 10.0 / np.array([*gaps.values()])
    assert ((table.low < true) & (true < table.high)).all()
    np.testing.assert_allclose(table.value, true, rtol=1e-3)
    for name, value in zip(names, table.value, strict=True):
        shown = re.search(rf"^{name}: (\S+) µm/px", printed.out, flags=re.M)[1]
        assert float(shown) == pytest.approx(value, rel=1e-4)
    for ax, file, (name, count) in zip(figures[0].axes, gaps, table.lines.items(), strict=True):
        x, y = np.rint(ax.lines[0].get_data()).astype(int)
        assert ax.get_title() == f"{name}: {len(x)} lines" == f"{name}: {count} lines"
        shown, grey = ax.images[0].get_array().data, cv2.imread(f"{tmp_path}/{file}.png", 0)
        assert np.corrcoef(shown.ravel(), grey.ravel())[0, 1] > 0.999
        assert shown[y, x].max() < 128  # the lines are dark
    macro = (tmp_path / "out" / "imagej.ijm").read_text()
    assert f"names = newArray({', '.join(map(json.dumps, names))});" in macro
    sizes = re.search(r"sizes = newArray\((.*)\)", macro)[1].replace('"', "").split(", ")
    np.testing.assert_allclose(np.array(sizes, float), table.value, rtol=1e-6)
    core = pytest.importorskip("pymmcore_plus").CMMCorePlus()
    core.loadSystemConfiguration(tmp_path / "out" / "micromanager.txt")
    assert {*core.getAvailablePixelSizeConfigs()} == {*names}
    found = [core.getPixelSizeUmByID(name) for name in names]
    np.testing.assert_allclose(found, table.value, rtol=1e-6)
    assert "Label: 10x" in str(core.getPixelSizeConfigData("10x"))


def test_each_photograph_has_its_line_as_soon_as_it_is_searched(tmp_path, monkeypatch):
    """In natural order, and also where the output is a file, else written in large blocks."""
    for name in ("view_2", "view_10", "view_11"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((90, 120), 100, np.uint8))
    printed = TextIOWrapper(BytesIO(), encoding="utf-8")
    before: list[bytes] = []

    def search(image, pattern):
        before.append(printed.buffer.getvalue())
        if len(before) == 2:
            return "circles", "Detection of 9 points"
        raise ValueError("none")

    monkeypatch.setattr("microlib.calibration.detect_pattern", search)
    monkeypatch.setattr("sys.stdout", printed)
    run_alone(f"calibrate '{tmp_path}/*.png' --pitch 200", tmp_path / "out", monkeypatch)
    first = f"{tmp_path}/view_2.png: left out\n"
    second = f"{tmp_path}/view_10.png: circles: Detection of 9 points\n"
    shown = [text.decode().partition("(given)\n")[2] for text in before]
    assert shown == ["", first, first + second]


MISFIT = {"adequate": False}


@pytest.mark.parametrize(
    ("side", "changed", "views", "advice"),
    [
        (32, {}, 3, ""),
        (31, {}, 1, "the grid covers less than 5 % of the image"),
        (32, {"deviation": 5.0}, 1, ""),
        (
            32,
            {"deviation": 8.0},
            1,
            "by up to 8 px from the calibrated model; residuals are 5 px rms",
        ),
        (32, MISFIT, 1, "; one photograph does not determine the center of the lens, which is "),
        (32, MISFIT, 2, "and --pitch the same everywhere?\n"),
        (32, MISFIT, 2, "note: residuals are larger than noise, most in embryo.png 5 px, circles"),
        (32, MISFIT, 3, "is --focal-length that of the objective, the pattern flat"),
        (32, {"lack_of_fit": np.nan}, 1, "note: photograph more marks: intervals contain only"),
        (32, {"high": np.inf, "undetermined": ("f",)}, 1, "the pixel size has no upper limit"),
        (32, {"print_aspect": 2}, 2, "note: measure the print, and give --pitch and --pitch-y"),
        (32, {"undetermined": ("alpha", "f")}, 1, "note: give --focal-length, or tilt the pattern"),
    ],
)
def test_each_weakness_of_a_calibration_has_its_note(
    side, changed, views, advice, tmp_path, capsys, monkeypatch
):
    """One of the grids has sides of so many px and twice as many, in 400×100 px."""
    shown = dict.fromkeys(("to_frame", "plot"), POINTS.copy)
    own = {"adequate": True, "lack_of_fit": 1.0, "views": [], "undetermined": ()}
    own |= {"inconsistent": (), "print_aspect": 1.0, "high": 1.0} | changed
    own["residuals"] = np.array([[3.0, 4.0]]) * np.arange(views).repeat(2)[:, None]
    own |= {"reprojection": Namespace(rms=5.0)}
    own["um_per_pixel"] = Namespace(value=0.9, high=own["high"])
    camera = {"distortion_model_error_px": own.get("deviation")}
    own["to_json"] = lambda: json.dumps({"opencv": camera})
    own["to_frame"] = lambda: pd.DataFrame([[0.9, 0.1, 0.7, 1.1]], columns=NUMBERS)
    own["plot"] = POINTS.copy
    ends = [np.array([[30, 40], [30 + n, 40 + 2 * n]]) for n in (side, *[0] * (views - 1))]
    grids = [
        Namespace(points=each, positions=each, image_size=(400, 100), **shown) for each in ends
    ]
    monkeypatch.setattr(calibration, "detect_pattern", lambda *_, **__: ("grid", grids.pop()))
    monkeypatch.setattr(calibration, "calibrate", lambda *_, **__: Namespace(**own))
    photos = ["circles.png", f"{INPUTS}/embryo.png", f"{INPUTS}/height_um.tif"][:views]
    assert status(GRID.replace("circles.png", shlex.join(photos)), tmp_path) == 0
    printed = capsys.readouterr().err
    assert advice in printed
    assert printed.count("\n") == bool(advice)


@pytest.mark.parametrize(
    ("line", "options"),
    [
        ("--motion affine --rate 20 --video", {"motion": "affine", "rate": 20.0}),
        ("--pixel-size 2.5 --video", {"motion": "translation", "pixel_size": 2.5}),
        ("--mask MASK", {"motion": "translation", "mask": DISC, "pixel_size": 2.5}),
        ("--motion homography --rate 12.5 --pixel-size 2.5um",
            {"motion": "homography", "rate": 12.5, "pixel_size": 2.5}),
    ],
)  # fmt: skip
def test_track_writes_what_the_library_returns(line, options, tmp_path, capsys, figures):
    """A part that is lost in one frame, in 16 bits; the same run again gives the same table.

    The film of the first is in color, and that of the third has a pixel size.
    """
    way = [(60 + 2.5 * k, 60 - k) for k in range(6)]
    frames = np.stack(moving_square(way, np.random.default_rng(1))).astype(np.uint16) * 200
    frames[4] //= 2
    frames[3] = np.random.default_rng(2).integers(0, 50000, frames[3].shape)
    kind, tint = ("rgb", [1, 0.9, 0.8]) if "affine" in line else ("minisblack", 1)
    frames = (frames[..., None] * tint).astype(np.uint16).squeeze()
    size = {"resolution": (4000, 4000), "resolutionunit": "CENTIMETER"} if "mask" in options else {}
    tifffile.imwrite(tmp_path / "film.tif", frames, photometric=kind, **size)
    out = tmp_path / "track.csv"
    cv2.imwrite(str(tmp_path / "mask.png"), np.uint8(200 * DISC))
    line = line.replace("MASK", str(tmp_path / "mask.png"))
    line = f"track {tmp_path / 'film.tif'} --box 60 60 49 49 {line}"
    assert status(line, out, "") == 0
    printed = capsys.readouterr()
    assert "lost in 1 of 6 frames;" in printed.out
    assert ("x_um and y_um in µm" in printed.out) == ("pixel_size" in options)
    assert ("frames/s (given)" in printed.out) == ("rate" in options)
    assert not printed.err
    before = out.read_text()
    assert status(f"{line} --quiet --overwrite", out, "") == 0
    assert not capsys.readouterr().out
    assert out.read_text() == before
    table = pd.read_csv(out, index_col="frame")
    wanted = tracking.track_all(frames, (60, 60, 49, 49), **options)
    assert [*table] == [*wanted]
    hold_alike(table.fillna({"reason": ""}), wanted.astype(table.dtypes), 1e-6)
    (look,) = figures[0].axes[0].images
    np.testing.assert_allclose(look.get_array(), 255 * (frames[0] / frames[0].max()), atol=4)
    if "--video" not in line:
        assert not (tmp_path / "track_look.mp4").exists()
        return
    looked = cv2.VideoCapture(str(tmp_path / "track_look.mp4"))
    assert looked.get(cv2.CAP_PROP_FPS) == pytest.approx(options.get("rate", 25))
    for k, frame in enumerate(frames):
        # Yellow has red and green without blue, red has no green; around where it was last seen.
        shown = looked.read()[1].astype(int)
        marked = np.argwhere(shown[..., 2] - shown[..., 0] > 80)[:, ::-1]
        at = np.array(way[k if k != 3 else 2]) - way[0] + 84
        np.testing.assert_allclose((marked.min(axis=0) + marked.max(axis=0)) / 2, at, atol=3)
        assert (np.median(shown[marked[:, 1], marked[:, 0], 1]) < 100) == (k == 3)
        level = 255 * frame[:30].mean(axis=(0, 1)) / frames[0].max()
        assert shown[:30].mean(axis=(0, 1))[::-1] == pytest.approx(level, abs=6)
    assert not looked.read()[0]


def film(path: Path, codec: str, rate: float, count: int) -> Path:
    """Write a part of 49×49 px at (60, 60) that moves by 2.5 px a frame to the right."""
    frames = moving_square([(60 + 2.5 * k, 60) for k in range(count)], np.random.default_rng(0))
    size = frames[0].shape[::-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, size, False)
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def test_track_takes_the_times_of_the_film_unless_a_rate_is_given(tmp_path, capsys):
    path = film(tmp_path / "film.mp4", "mp4v", 20, 10)
    ticks = [256, 768] * 5  # a second has 10 240
    varied_times(path, ticks)
    line, out = f"track {path} --box 60 60 49 49", tmp_path / "track.csv"
    assert status(f"{line} --video", out) == 0
    printed = capsys.readouterr()
    assert "times of the frames (the file)" in printed.out
    assert not printed.err
    true = np.cumsum([0, *ticks[:-1]]) / 10240
    np.testing.assert_allclose(pd.read_csv(out)["time_s"], true, atol=1e-6)
    rate = cv2.VideoCapture(str(tmp_path / "track_look.mp4")).get(cv2.CAP_PROP_FPS)
    assert rate == pytest.approx(9 / true[-1], rel=0.01)
    assert status(f"{line} --rate 500 --overwrite", out) == 0
    printed = capsys.readouterr()
    assert "rate 500 frames/s (given)" in printed.out
    note, removed = printed.err.splitlines()
    assert note == f"note: the file has {9 / true[-1]:.4g} frames/s: --rate 500 is used"
    assert removed == f"note: {tmp_path / 'track_look.mp4'} of an earlier run is removed"
    np.testing.assert_allclose(pd.read_csv(out)["time_s"], np.arange(10) / 500)


def test_truncated_film_keeps_the_rows_before_its_end(tmp_path, capsys):
    path = film(tmp_path / "cut.avi", "MJPG", 30, 30)
    path.write_bytes(path.read_bytes()[: int(0.8 * path.stat().st_size)])
    out = tmp_path / "out.csv"
    assert status(f"track {path} --box 60 60 49 49", out) == 3
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    count = int(re.search(r"keeps the (\d+) rows so far", printed)[1])
    assert 10 < count < 30
    way = pd.read_csv(out)["center_x"]
    assert len(way) == count
    assert way.diff().dropna().to_numpy() == pytest.approx(2.5, abs=0.2)


def test_each_row_is_written_at_once_and_counted_when_ctrl_c_follows(tmp_path, monkeypatch, capsys):
    out = tmp_path / "track.csv"

    class Stopped(csv.DictWriter):
        def writerow(self, row: dict) -> None:
            super().writerow(row)
            if isinstance(row["frame"], int):  # not the header
                assert out.read_text().count("\n") == row["frame"] + 2
            if row["frame"] == 7:
                raise KeyboardInterrupt

    monkeypatch.setattr(csv, "DictWriter", Stopped)
    assert status(f"track frames.tif {BOX} --quiet", out) == 130
    assert f"{out} keeps the 8 rows so far" in capsys.readouterr().err
    assert len(pd.read_csv(out)) == 8


@pytest.mark.parametrize(
    ("motion", "remedy"),
    [
        ("translation", "--motion affine, or more frames per second"),
        ("affine", "--motion homography, or more frames per second"),
        ("homography", "more frames per second"),
    ],
)
def test_lost_part_gives_exit_status_4_and_a_remedy_that_was_not_tried(
    motion, remedy, tmp_path, capsys
):
    """The message names the most frequent reason and the first frame; the count is given once."""
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (9, 100, 120)).astype(np.uint8)
    frames[:2] = cv2.GaussianBlur(frames[0], (0, 0), 2)
    tifffile.imwrite(tmp_path / "noise.tif", frames)
    line = f"track {tmp_path / 'noise.tif'} {BOX} --motion {motion}"
    assert status(line, tmp_path / "track.csv") == 4
    out, err = capsys.readouterr()
    table = pd.read_csv(tmp_path / "track.csv")
    assert len(table) == 9
    (reason,) = table["reason"].dropna().mode()
    assert f"lost in 7 of 9 frames, first in frame 2, mostly by {reason}: try {remedy}\n" in err
    assert (out + err).count("lost in 7") == 1


def test_part_that_leaves_the_image_has_a_remedy_of_its_own(tmp_path, capsys):
    texture = mixed_texture((100, 280), np.random.default_rng(0), scales=2.0)
    frames = [texture[:, 8 * k :][:, :120] for k in range(20)]  # the box leaves after nine
    tifffile.imwrite(tmp_path / "leaving.tif", np.clip(frames, 0, 255).astype(np.uint8))
    assert status(f"track {tmp_path / 'leaving.tif'} {BOX}", tmp_path / "track.csv") == 4
    remedy = "mostly by out of view: try a --box around a part that stays in the image\n"
    assert remedy in capsys.readouterr().err


def test_each_fact_about_a_steep_dimple_of_a_thick_membrane_is_noted_once(tmp_path, capsys):
    """Radius and depth of the two rims differ, and each is computed by several models."""
    line = f"{OUTLINE} --thickness 30 --quiet"
    assert status(line, tmp_path / "out.csv") == 0
    notes = capsys.readouterr().err.splitlines()
    starts = ["note: w_d/a = 0.19 > 0.1: small", "note: dimple_depth is 1.5 times the thickn"]
    assert [note[: len(start)] for note, start in zip(notes, starts, strict=True)] == starts


def test_modulus_writes_what_the_library_returns(tmp_path, capsys, figures):
    """Of either rim."""
    line = f"{OUTLINE} --thickness-uncertainty 0.2um --poisson-ratio 0.4"
    assert status(line, tmp_path / "out.csv", "") == 0
    printed = capsys.readouterr().out
    for given in ("force_uncertainty 3 µN", "thickness_uncertainty 0.2 µm"):
        assert f"{given} (given)" in printed
    table = pd.read_csv(tmp_path / "out.csv", index_col="quantity").fillna({"unit": ""})
    found, unit = table["value"], table["unit"]
    units = {"_MPa": "MPa", "force": "µN", "ratio": "", "ness|_width|radius|depth": "µm"}
    for kind, wanted in units.items():
        assert {*unit.filter(regex=kind)} == {wanted}
    x, y = pd.read_csv(INPUTS / "outline.csv").sort_values("x").to_numpy().T
    measured = dimple_from_outline(x, y, pixel_size=3.875)
    title = figures[0].axes[0].get_title()
    points = {"outline": (x, y - y.min()), "bottom": measured.left.bottom}
    every = []
    for rim, prefix in (("left", ""), ("right", "right_")):
        dimple = getattr(measured, rim)
        values = {"force": 10.0, "thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.4}
        stds = {"force": 3.0, "thickness": 0.2}
        for k, name in enumerate(("rim_radius", "dimple_depth")):
            values[name] = getattr(dimple, name)
            stds[name] = np.sqrt(dimple.covariance[k, k])
        modulus = membrane.elastic_modulus(**values)
        own = {"modulus_MPa": modulus, **values}
        own |= {f"{name}_uncertainty": std for name, std in stds.items()}
        own["finite_slope_modulus_MPa"] = membrane.finite_slope_modulus(**values)
        for name, value in own.items():
            assert found[prefix + name] == pytest.approx(value, rel=1e-4), prefix + name
        drawn = membrane.modulus_samples(values, stds, size=20_000, rng=5)
        ends = found[[f"{prefix}modulus_{end}_MPa" for end in ("low", "high")]]
        # Two draws of the tails differ by 2 %.
        np.testing.assert_allclose(ends, np.quantile(drawn, [0.025, 0.975]), rtol=0.06)
        uncertainty = membrane.modulus_uncertainty(values, stds)
        assert found[f"{prefix}modulus_uncertainty_MPa"] == pytest.approx(uncertainty, rel=1e-4)
        moduli = membrane.model_moduli(**values)
        wide = np.array([min(moduli.values()), max(moduli.values())]) / moduli.pop("point load")
        over = found[[f"{prefix}modulus_{end}_over_models_MPa" for end in ("low", "high")]]
        np.testing.assert_allclose(over, wide * ends, rtol=2e-4)  # of five digits
        for model, other in moduli.items():
            column = model.replace(", ", "_").replace("-", "_").replace(" ", "_")
            assert found[f"{prefix}{column}_MPa"] == pytest.approx(other, rel=1e-4)
        every.extend(over)
        others = f"{min(moduli.values()):.2g} to {max(moduli.values()):.2g} MPa by 4 others"
        estimate, _, _ = str(Estimate(modulus, uncertainty, *ends, "MPa")).partition(":")
        a, w = (f"{values[name]:.1f} ± {stds[name]:.1f} µm" for name in [*values][-2:])
        assert f"{rim} rim{', as in the thesis' * (rim == 'left')}: {estimate}: " in printed
        assert f" by (5.2), {others}\na = {a}, w_d = {w}" in printed
        points[f"{rim} rim"] = dimple.rim
    headline = f"E = {min(every):.2g} to {max(every):.2g} MPa over all models and both rims"
    assert [line for line in printed.splitlines() if line.startswith("E ")] == [headline]
    assert title == headline
    drawn = {line.get_label(): line.get_data() for line in figures[0].axes[0].lines}
    for name, at in points.items():
        np.testing.assert_allclose(np.squeeze(drawn[name]), at, rtol=1e-4)


DOWN = POINTS.assign(y=300 - POINTS["y"])
MIDDLE = POINTS["x"].mean()
STRETCHED = POINTS["x"].where(POINTS["x"] > MIDDLE, 1.5 * POINTS["x"] - 0.5 * MIDDLE)


@pytest.mark.parametrize(
    ("table", "options", "code", "message"),
    [
        (DOWN, "", 0, "with y pointing down"),
        (DOWN, "--y-down", 0, ""),
        (POINTS, "--y-down", 2, "leave out --y-down"),
        (POINTS.rename(columns={"x": "col", "y": "row"}), "", 0, "with y pointing up"),
        (POINTS.rename(columns={"x": "x_um", "y": "y_um"}), "", 2, "leave out --pixel-size"),
        (POINTS, "--force-uncertainty 0", 0, ""),
        (POINTS.mul(3.875).rename(columns={"x": "x_um", "y": "y_um"}), None, 0, ""),
    ],
)
def test_outline_table_that_disagrees_is_noted(table, options, code, message, tmp_path, capsys):
    """Directions of y, and units."""
    file, out = tmp_path / "points.csv", tmp_path / "out.csv"
    table.to_csv(file, index=False)
    line = OUTLINE.replace("outline.csv", str(file))
    line = line.replace("--pixel-size 3.875", "") if options is None else f"{line} {options}"
    assert status(line, out) == code
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("points.csv") == bool(message)
    if code == 0:
        found = pd.read_csv(out, index_col="quantity")["value"]
        assert found["rim_radius"] == pytest.approx(250, abs=3.875)


@pytest.mark.parametrize("side", [1, -1], ids=["left", "right"])
def test_headline_of_moduli_spans_both_rims_whichever_is_further(side, tmp_path, capsys):
    POINTS.assign(x=side * STRETCHED).to_csv(tmp_path / "outline.csv", index=False)
    command = OUTLINE.replace("outline.csv", str(tmp_path / "outline.csv"))
    assert status(f"{command} --force-uncertainty 0", tmp_path / "out.csv", "") == 0
    found = pd.read_csv(tmp_path / "out.csv", index_col="quantity")["value"]
    ends = found.filter(like="over_models")
    headline = f"E = {ends.min():.2g} to {ends.max():.2g} MPa over all models and both rims\n"
    printed = capsys.readouterr()
    assert headline in printed.out
    assert "the moduli of the two rims differ by more than their intervals" in printed.err


@pytest.mark.parametrize(
    ("line", "message"),
    [
        # A scale that is missing, has another unit, or is out of range.
        ("depth focal_stack.tif --max-uncertainty 5", "--max-uncertainty is in µm: give --spacing"),
        (f"{STACK} --spacing 0.025 mm", "no blank between them, as in 0.5mm"),
        (
            "deep focal_stack.tif",
            "must be a task: depth, calibrate, track, modulus; options follow",
        ),
        (f"{STACK} --spaceing 25", "unknown --spaceing: did you mean --spacing?"),
        ("track frames.tif --box 30,40,40,40", "with blanks between them, as in 30 40 64 64"),
        (f"track circles.png {BOX}", "circles.png must hold two frames or more, got 1"),
        # A scale that no microscope has, and the unit that makes it possible.
        (GRID.replace("0.28mm", "0.28"), "give a magnification of 1589, and a microscope has"),
        ("calibrate circles.png --pitch 0.28", "gives 0.00623 µm per pixel"),
        ("calibrate circles.png --pitch 0.28", "did you mean --pitch 0.28mm?"),
        ("calibrate circles.png --pitch 1e6", "did you mean --pitch 1e+06nm?"),
        (GRID.replace("126150", "126.15"), "got 126.15: did you mean 126.15mm?"),
        (f"{OUTLINE} --force 1e-5", "got 1e-05: did you mean 1e-05mN or 1e-05N?"),
        (f"{OUTLINE} --thickness 3e-3", "--thickness must be between 0.005 and 10000 µm"),
        (f"{OUTLINE} --force 9e5 --thickness 0.006", "modulus must be between"),
        (f"{STACK} --pixel-size 0.006", "got 0.006: did you mean 0.006mm/px?"),
        (f"track frames.tif {BOX} --pixel-size 50800", "got 50800: did you mean 50800nm/px?"),
        ("calibrate circles.png", "microlib calibrate: no scale is in the file: give --pitch µm"),
        (GRID.replace("circles", "none"), "none.png: no such file"),
        ("calibrate circles.png --marks micrometer", "give --division µm"),
        (f"{GRID} --division 10", "--division belongs to --marks micrometer"),
        (f"{GRID} --marks micrometer", "a micrometer needs --division, not --pitch"),
        (f"calibrate circles.png {LINES}", "image must show a scale of"),
        (
            f"calibrate circles.png '{INPUTS}/circles.png' {LINES}",
            "names of photographs must differ",
        ),
        ("modulus outline.csv", "--thickness µm, --probe-half-width µm, --poisson-ratio ratio"),
        (f"{STACK} --spacing 5kg", "--spacing: invalid number in µm value: '5kg'"),
        (f"{STACK} --spacing 0", "--spacing must be between 0.02 and 10000 µm in any experiment"),
        ("calibrate circles.png --pitch 280 --focal-length 126150", "give --pixel-pitch µm"),
        (f"{GRID} --pixel-pitch=-1.25", "--pixel-pitch must be positive, got -1.25"),
        (f"{GRID} --pixel-pitch 1,25", "--pixel-pitch: must have a decimal point, got 1,25"),
        (f"{GRID} --pixel-pitch 1,500.0", "--pixel-pitch: must have a decimal point, got 1,5"),
        (f"{OUTLINE} --force-uncertainty -3", "--force-uncertainty must be zero or positive"),
        # Arguments that the library refuses, by the names of the options.
        (f"{STACK} --region 0 0 999 5", "--region must"),
        (f"{STACK} --time 1", "--time must be left out for frames without"),
        ("track frames.tif --box 0 0 5 40", "track: --box width must be at least 6, got 5"),
        (f"track frames.tif {BOX} --mask no.png", "--mask must name an image, got no.png: no such"),
        # A source that is not there, or shows something else.
        ("depth missing.tif --spacing 25 --pixel-size 1", "missing.tif"),
        ("depth circles.png --spacing 5 --pixel-size 1", "circles.png must hold three frames"),
        ("calibrate embryo.png --marks charuco --pitch 9", ": image must show the corners of a C"),
        (f"calibrate embryo.png '{INPUTS}/height_um.tif' --pitch 280", "; so 2 photographs"),
        (f"modulus missing.csv --force 10 {MODULUS}", "missing.csv: No such file"),
        (f"modulus frames_path.csv --force 10 {MODULUS}", "(a dimple, y up)"),
        # Outputs.
        (f"{STACK} -o c.CSV", "microlib depth: --out must be a folder, got c.CSV"),
        (f"track frames.tif {BOX} -o t.xlsx", "must be a table that ends in .csv, got t.xlsx"),
        (f"{OUTLINE} -o .", "must be a table that ends in .csv, got ."),
        (f"{GRID} -o /dev/null/x", "/dev/null/x cannot be written"),
        (f"track frames.tif {BOX} -o /dev/null/t.csv", "/dev/null/t.csv cannot be written: Not a"),
    ],
)
def test_error_has_one_line_and_leaves_no_file(line, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line, _, out = line.partition(" -o ")
    table = line.split()[0] in ("track", "modulus")
    assert status(line, out or ("out.csv" if table else "out")) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
def test_full_standard_output_is_named_in_the_error(tmp_path):
    with open("/dev/full", "w") as full:
        ended = run("-m", "microlib", *OUTLINE.split(), "-o", tmp_path / "m.csv", stdout=full)
    error = "microlib modulus: standard output: No space left on device\n"
    assert (ended.returncode, ended.stderr) == (2, error)


@pytest.mark.parametrize(("source", "out"), [("focal_stack.tif", ""), ("", "out")])
def test_empty_name_is_not_the_current_folder(source, out, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = ["depth", str(INPUTS / source) if source else "", "--spacing", "25", "-o", out]
    with contextlib.suppress(SystemExit):
        assert main(line) == 2
    assert "must name a file or a folder, got an empty text" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("given", "note"),
    [
        ("--spacing 0.025 --pixel-size 3.9", "is 0.0064 pixels of 3.9 µm, where 2 to 50 are usual"),
        ("--spacing 9000 --pixel-size 3.9", "is 2.3e+03 pixels of 3.9 µm"),
        ("--spacing -25 --pixel-size 3.9", "the spacing is negative: each frame is focused lower"),
        ("--spacing 25 --pixel-size 3.9", ""),
        ("--spacing 25", "the maps have no scale, no mesh is written: give --pixel-size"),
        ("--pixel-size 3.9", "heights are in frames, no mesh is written: give --spacing"),
        ("", "in frames, the maps have no scale, no mesh is written: give --spacing and"),
    ],
)
def test_scale_of_a_stack_that_is_unknown_or_unlikely_is_noted(given, note, tmp_path, capsys):
    assert status(f"depth focal_stack.tif {given}", tmp_path, "") == 0
    printed = capsys.readouterr()
    assert note in printed.err
    assert printed.err.count("note: ") == bool(note)
    known = {"µm": "--spacing" in given, "frames": "--spacing" not in given}
    summary = json.loads((tmp_path / "summary.json").read_text())
    with tifffile.TiffFile(tmp_path / "height.ome.tif") as file:
        heights, about = file.asarray(), file.ome_metadata
    for unit, used in known.items():
        assert (unit in printed.out.split("FocusResult")[1]) == used
        assert (f"heights in {unit}" in about) == used
        assert (summary["unit"] == unit) == used
    assert ("PhysicalSizeX" in about) == ("--pixel-size" in given)
    assert (tmp_path / "surface.ply").exists() == ("no mesh" not in note)
    if not note:
        return
    truth = tifffile.imread(INPUTS / "height_um.tif") / 25 + 2  # the third frame is at 0
    found = heights / (summary["spacing"] or 1)
    assert np.nanmedian(np.abs(found - truth)) < 0.05  # frames


@pytest.mark.parametrize(
    ("given", "number"),
    [
        ("--force=10", 10), ("--force=10uN", 10), ("--force=1e4 nN", 10), ("--force=10e-6N", 10),
        ("--pixel-size=0.01mm/px", 10), ("--thickness=12cm", 120000), ("--thickness=12.5mm", 12500),
        ("--thickness=0.25", 0.25),
    ],
)  # fmt: skip
def test_number_can_have_a_unit(given, number, tmp_path, capsys):
    """Scales are printed one by one, before that of the probe is rejected."""
    line = [*OUTLINE.split()[2:], given, "--probe-half-width=0", "-o", str(tmp_path / "out.csv")]
    assert main(["modulus", str(INPUTS / "outline.csv"), *line]) == 2
    name = given[2:].split("=")[0].replace("-", "_")
    assert f"{name} {number:g} µ" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "owner", "fails", "kept"),
    [
        (STACK, io, "write_height_tiff", []),
        (STACK, io, "write_ply", [*2 * ["all_in_focus"], "frame", "height", "uncertainty"]),
        (STACK, FocusResult, "plot", [*2 * ["all_in_focus"], "frame", "height", "summary",
            *2 * ["surface"], "uncertainty"]),
        (f"track frames.tif {BOX} --video", tracking, "plot_track", ["out"]),
        (f"track frames.tif {BOX} --video", cv2, "polylines", ["out", "out_look"]),
        (f"track frames.tif {BOX} --video", cv2.VideoWriter, "isOpened", ["out", "out_look"]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("stopped", [False, True])
def test_written_files_stay_when_a_later_file_fails(
    line, owner, fails, kept, stopped, tmp_path, capsys, monkeypatch
):
    """On a full disk, or by Ctrl-C."""
    error = KeyboardInterrupt() if stopped else OSError(28, "No space left on device")
    monkeypatch.setattr(owner, fails, Mock(side_effect=error))
    folder = tmp_path / "new"
    out = folder if line == STACK else folder / "out.csv"
    found, printed = status(line, out, ""), capsys.readouterr().err
    if owner is io or stopped:
        file = out / ("surface.ply" if kept else "height.ome.tif")
        reason = "stopped" if stopped else f"{file}: No space left on device"
        assert printed == f"microlib {line.split()[0]}: {reason}\n"
        assert found == (130 if stopped else 2)
    else:  # a picture, without which the numbers are complete
        assert (found, printed.count("\n")) == (0, 1)
        assert printed.startswith("note: ")
        assert re.search(r"(\S+) is not written: \S+/\1: No space left on device\n$", printed)
        kept = [*kept, "out_look"] if fails == "plot_track" else kept
    assert sorted(path.name.split(".")[0] for path in folder.iterdir()) == kept


@pytest.mark.parametrize(("size", "film"), [(60_000, True), (4_000, False)])
def test_track_on_a_full_disk_keeps_whole_rows_and_no_broken_film(size, film, tmp_path):
    """A file may have `size` bytes: enough for the table, but not for the film, or for neither."""
    resource = pytest.importorskip("resource", reason="Windows has no such limit")
    out, old = tmp_path / "out.csv", tmp_path / "out_look.mp4"
    old.write_bytes(b"old")
    line = f"-m microlib track frames.tif {BOX} --no-look --overwrite {'--video' * film}".split()
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))  # noqa: E731
    ended = run(*line, "-o", out, preexec_fn=limit)
    rows = out.read_text().removesuffix("\n").split("\n")[1:]
    assert {row.count(",") for row in rows} == {32}
    assert not old.exists()
    if film:
        assert (ended.returncode, len(rows)) == (0, 40)
        assert "out_look.mp4 is not written: " in ended.stderr
    else:
        assert ended.returncode == 3
        assert f"out.csv keeps the {len(rows)} rows so far" in ended.stderr
        assert 10 < len(rows) < 40


def test_overwriting_that_fails_names_old_and_new_files(tmp_path, capsys, monkeypatch):
    assert status(STACK, tmp_path) == 0
    error = OSError(28, "No space left on device")
    monkeypatch.setattr(io, "write_ply", Mock(side_effect=error))
    assert status(f"{STACK} --overwrite", tmp_path) == 2
    new, old = capsys.readouterr().err.split("; files of an earlier run: ")
    assert new.endswith("all_in_focus.ome.tif, all_in_focus.png")
    assert old.split() == ["surface.ply,", "surface.stl,", "summary.json"]


def test_mask_is_an_input_that_is_not_overwritten(tmp_path, capsys):
    mask = tmp_path / "out_look.png"
    cv2.imwrite(str(mask), np.full((140, 181), 255, np.uint8))
    old = mask.read_bytes()
    assert status(f"track frames.tif {BOX} --mask {mask} --overwrite", tmp_path / "out.csv") == 2
    assert "out_look.png is an input: give another --out" in capsys.readouterr().err
    assert mask.read_bytes() == old


def test_help_lists_the_tasks_and_shows_an_example(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out == f"{microlib.__version__}\n"
    assert main([]) == 0
    overview = capsys.readouterr().out
    for task in ("depth", "calibrate", "track", "modulus"):
        assert re.search(rf"^ +{task}\s+[A-Z]", overview, flags=re.M)
        with pytest.raises(SystemExit, match="0"):
            main([task, "--help"])
        assert f"Example: microlib {task} " in capsys.readouterr().out


def run(*arguments: str | Path, path: Path | str = "", **how: Any) -> subprocess.CompletedProcess:
    """Run Python in the folder of the inputs, with another folder to import from."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "encoding": "utf-8"}
    env = os.environ | {"PYTHONPATH": f"{path}{os.pathsep}{ROOT}"}
    line = [sys.executable, *arguments]
    return subprocess.run(line, cwd=INPUTS, env=env, check=False, **streams | how)


@pytest.mark.parametrize(
    "words",
    [
        ["-m", "microlib", *STACK.split(), "-o", "out"],
        ["-c", "import microlib.focus"],
        ["-c", "import microlib.optics"],
        ["-c", "import microlib; help(microlib)"],
    ],
)
def test_missing_opencv_error_names_the_package(tmp_path, words):
    (tmp_path / "cv2.py").write_text("raise ModuleNotFoundError('No module', name='cv2')")
    done = run(*words, path=tmp_path)
    last = (done.stderr or done.stdout.strip()).splitlines()[-1]
    assert last.endswith("OpenCV 4.12 or newer is needed: pip install opencv-python-headless")
    if "-m" in words:
        assert (done.returncode, done.stderr) == (2, f"{last}\n")


def test_commands_run_as_a_module_without_docstrings(tmp_path):
    table = str(tmp_path / "a.csv")
    done = run("-OO", "-m", "microlib", *OUTLINE.split(), "--no-look", "-o", table)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False)
    assert pd.read_csv(table, index_col=0).loc["modulus_MPa", "value"] > 0


def test_full_disk_is_reported_and_old_pictures_are_removed(tmp_path, capsys):
    (tmp_path / "full.csv").symlink_to("/dev/full")
    assert status(f"track frames.tif {BOX} --overwrite", tmp_path / "full.csv") == 3
    assert "full.csv: No space left on device" in capsys.readouterr().err
    (tmp_path / "full.csv").unlink()
    for name in ("track_look.png", "track_look.mp4"):
        (tmp_path / name).write_text("of another run")
    assert status(f"track frames.tif {BOX} --overwrite", tmp_path / "track.csv") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["track.csv"]


# --- The user's files, numbers and terminals ------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "source", "out", "name"),
    [
        (STACK, "height.ome.tif", ".", "height.ome.tif"),
        (GRID, "look.png", ".", "look.png"),
        (f"track frames.tif {BOX}", "a_look.png.tif", "a.csv", "a_look.png"),  # a link to it
        (OUTLINE, "outline.csv", "outline.csv", "outline.csv"),
    ],
)
def test_output_never_replaces_an_input(line, source, out, name, tmp_path, capsys):
    """Also behind a link, and with --overwrite."""
    folder = tmp_path / "scan"
    folder.mkdir()
    given = line.split()[1]
    (folder / source).write_bytes(before := (INPUTS / given).read_bytes())
    if name != source:
        (folder / name).symlink_to(folder / source)
    # A folder that is missing hides the others from a search for them.
    for target in (folder / out, folder / "missing" / ".." / out):
        assert status(line.replace(given, str(folder / source)), target, "--overwrite") == 2
        assert f"{folder / name} is an input: give another --out" in capsys.readouterr().err
    assert {file.name for file in folder.iterdir()} == {source, name}
    assert (folder / source).read_bytes() == before


@pytest.mark.parametrize(
    ("line", "out"),
    [(STACK, "."), (GRID, "."), (f"track frames.tif {BOX}", "track.csv")],
    ids=["depth", "calibrate", "track"],
)
def test_results_in_the_input_folder_are_ignored(line, out, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = line.split()[1]
    if source == "circles.png":
        (tmp_path / "grid.png").write_bytes((INPUTS / source).read_bytes())
    else:
        for k, frame in enumerate(tifffile.imread(INPUTS / source)[:12]):
            cv2.imwrite(str(tmp_path / f"f{k}.png"), frame)
    line = line.replace(source, str(tmp_path))
    assert status(line, out, "") == 0
    assert source == "circles.png" or "12 files, from f0.png to f11" in capsys.readouterr().out
    results = {p: p.read_bytes() for p in tmp_path.iterdir() if p.suffix in (".csv", ".json")}
    assert results
    assert status(line, out, "--overwrite") == 0
    assert re.search(r"look\.png.*: results, left out", capsys.readouterr().err)
    assert {file: file.read_bytes() for file in results} == results


def test_files_on_the_command_line_are_read_in_natural_order(tmp_path, capsys):
    """A shell replaces a pattern by names in an order without regard to numbers."""
    frames = tifffile.imread(INPUTS / "focal_stack.tif")
    for k, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"f{k}.png"), frame)
    files = sorted(map(str, tmp_path.glob("*.png")))  # f0, f1, f10, …
    line = ["depth", *files, "--spacing", "25", "--pixel-size", "3.9", "-o", str(tmp_path / "out")]
    assert main(line) == 0
    printed = capsys.readouterr()
    assert f"{len(frames)} files, from f0.png to f{len(frames) - 1}.png" in printed.out
    assert not printed.err
    found = tifffile.imread(tmp_path / "out" / "height.ome.tif")
    np.testing.assert_allclose(found, depth_from_focus(frames, spacing=25.0).depth, rtol=1e-5)


@pytest.mark.parametrize("axes", ["C", "T"])
def test_axis_of_a_stack_is_given_as_its_error_says(axes, tmp_path, capsys):
    """As `tifffile.imwrite` labels an array by default, and Fiji a stack of slices."""
    frames = tifffile.imread(INPUTS / "focal_stack.tif")
    path, labels = tmp_path / "a.tif", {"axes": f"{axes}YX"}
    tifffile.imwrite(path, frames, imagej=True, metadata=labels)
    line = f"depth {path} --spacing 25 --pixel-size 3.9"
    assert status(line, tmp_path / "out") == 2
    (axis,) = re.findall(r"\((--axis .)\)", capsys.readouterr().err)
    assert status(f"{line} {axis}", tmp_path / "out") == 0
    found = tifffile.imread(tmp_path / "out" / "height.ome.tif")
    np.testing.assert_allclose(found, depth_from_focus(frames, spacing=25.0).depth, rtol=1e-5)


@pytest.mark.parametrize("option", ["channel", "time", "series"])
def test_part_of_a_file_is_chosen_by_its_number(option, tmp_path):
    frames = tifffile.imread(INPUTS / "focal_stack.tif")
    both = np.stack([frames[::-1], frames])
    with tifffile.TiffWriter(path := tmp_path / "a.ome.tif", ome=True) as file:
        for part in both if option == "series" else [both]:
            file.write(part, metadata={"axes": f"{option[0].upper()}ZYX"[-part.ndim :]})
    line = f"depth {path} --spacing 25 --pixel-size 3.9 --{option} 1"
    assert status(line, tmp_path / "out") == 0
    found = tifffile.imread(tmp_path / "out" / "height.ome.tif")
    np.testing.assert_allclose(found, depth_from_focus(frames, spacing=25.0).depth, rtol=1e-5)


@pytest.mark.parametrize("encoding", ["cp1252", "cp932"])
def test_letters_that_a_terminal_lacks_are_replaced(tmp_path, monkeypatch, encoding):
    """The name has Cyrillic letters and the output µ and ±."""
    out, err = (TextIOWrapper(BytesIO(), encoding) for _ in range(2))
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    photo = tmp_path / "сетка.png"
    photo.write_bytes((INPUTS / "circles.png").read_bytes())
    line = GRID.replace("circles.png", str(photo))
    assert run_alone(line, tmp_path / "µ", monkeypatch) == 0
    out.flush()
    assert b"circles: " in out.buffer.getvalue()
    assert not err.buffer.getvalue()
    assert len(list((tmp_path / "µ").iterdir())) == 3


def test_program_that_calls_main_keeps_streams_environment_and_loggers(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdout", TextIOWrapper(BytesIO(), "ascii"))
    monkeypatch.delenv("OPENCV_LOG_LEVEL", raising=False)
    environment, handlers = dict(os.environ), [*logging.getLogger("tifffile").handlers]
    assert status(f"{STACK} --quiet", tmp_path / "out") == 0
    assert sys.stdout.errors == "strict"
    assert dict(os.environ) == environment
    assert logging.getLogger("tifffile").handlers == handlers


#: Settings that turn pictures upside down, need LaTeX, or change colors, sizes and formats.
USER_STYLE = {
    "image.origin": "lower", "text.usetex": True, "axes.grid": True, "figure.dpi": 30,
    "savefig.format": "pdf", "savefig.bbox": "tight", "savefig.transparent": True,
    "image.cmap": "jet",
}  # fmt: skip


def test_progress_is_seen_on_a_terminal_that_states_no_width(tmp_path):
    """As that of `script`; a new pseudo-terminal has 0 columns."""
    pty = pytest.importorskip("pty")
    leader, follower = pty.openpty()
    command = [sys.executable, "-m", "microlib", "track", INPUTS / "frames.tif", *BOX.split()]
    subprocess.run([*command, "-o", tmp_path / "a.csv", "--no-look"], stderr=follower, check=True)
    os.set_blocking(leader, False)
    shown = os.read(leader, 4096).decode()
    for end in (leader, follower):
        os.close(end)
    assert "track:" in shown
    assert "/40" in shown


def test_user_style_does_not_change_the_picture(tmp_path, capsys):
    looks = []
    for name, style in (("plain", {}), ("own", USER_STYLE)):
        with mpl.rc_context(style):
            assert status(STACK, tmp_path / name, "") == 0
        with Image.open(tmp_path / name / "look.png") as picture:
            looks.append(np.asarray(picture.convert("RGB")).astype(int))
    assert not capsys.readouterr().err
    assert looks[0].shape == looks[1].shape
    assert np.abs(looks[1] - looks[0]).mean() < 1  # of 255; another origin gives 20


def test_error_of_any_kind_has_one_line(tmp_path, capsys, monkeypatch):
    fail = Mock(side_effect=cv2.error("OpenCV(5.0.0)\nassertion\nfailed"))
    monkeypatch.setattr("microlib.focus.depth_from_focus", fail)
    assert status(STACK, tmp_path / "out", "") == 2
    assert capsys.readouterr().err == "microlib depth: error: OpenCV(5.0.0) assertion failed\n"


@pytest.mark.parametrize(
    ("frames", "note"),
    [
        (np.arange(7), "{at_end:.0%} of the heights are at the first or last frame"),
        (np.random.default_rng(1).permutation(21), "are the frames in order of focus?"),
        (np.arange(21), ""),
    ],
)
def test_stack_that_does_not_show_the_heights_is_noted(frames, note, tmp_path, capsys):
    """A ramp in the lowest frames, and in all frames in a random order."""
    texture = mixed_texture((64, 90), np.random.default_rng(0))
    ramp = np.broadcast_to(np.linspace(20.0, 180.0, 90), texture.shape)
    stack = focal_stack(texture, ramp, np.arange(0.0, 210.0, 10.0), blur_rate=0.1)
    tifffile.imwrite(tmp_path / "stack.tif", np.float32(stack[frames]))
    line = f"depth {tmp_path}/stack.tif --spacing 10 --pixel-size 3.9"
    assert status(line, tmp_path / "out") == 0
    printed = capsys.readouterr().err
    assert note.format(**json.loads((tmp_path / "out" / "summary.json").read_text())) in printed
    assert bool(printed) == bool(note)


def grid_of(stretch: float) -> np.ndarray:
    """Draw circles whose distances are larger down the image; ten per cent is no square lattice."""
    y, x = np.indices((330, 360))
    radius = np.hypot(x % 30 - 14.5, y % (30 * stretch) - 15 * stretch)
    return np.uint8(200 - 150 * np.clip(9 - radius, 0, 1))


EVEN, UNEVEN = 15.7 * np.arange(-7, 8), 15.7 * np.arange(-2, 3) + [0, 0.7, -0.7, 0.7, 0]
SCALE = "calibrate PICTURE --marks micrometer --division"


@pytest.mark.parametrize(
    ("line", "picture", "note"),
    [
        # Of a pattern and a scale in µm whose divisions are given in mm, and as it is given.
        ("calibrate circles.png --pitch 28mm", None, "µm is that of no microscope"),
        (f"track frames.tif {BOX} --pixel-size 0.5mm", None, "µm is that of no microscope"),
        (f"{SCALE} 10mm", ruled(EVEN, 60.0, 3.0), "µm is that of no microscope"),
        (f"{SCALE} 10", ruled(EVEN, 60.0, 3.0), ""),
        (GRID, None, ""),
        (f"{SCALE} 10", ruled(UNEVEN, 60.0, 3.0), "picture: the lines are uneven"),
        ("calibrate PICTURE --pitch 280", grid_of(1.08), "1.080 times as far .* no tilt of 22°"),
        # The file has 25 µm and 3.9 µm/px.
        ("depth PICTURE --spacing -25", "stack", "25 µm: --spacing -25 is used"),
        ("depth PICTURE --pixel-size 0.39", "stack", "3.9 µm/px: --pixel-size 0.39 is used"),
        ("depth PICTURE --spacing 25.1", "stack", ""),
        # Of an egg of 1.2 MPa under 10 µN, with its force in mN and in nN.
        (f"modulus outline.csv --force 10 {MODULUS}", None, ""),
        (f"modulus outline.csv --force 0.01 {MODULUS}", None, "0.0013 MPa is seldom that of a"),
        (f"modulus outline.csv --force 100000 {MODULUS}", None, "is the unit of --force right"),
    ],
)
def test_unlikely_scales_and_pictures_are_noted(line, picture, note, tmp_path, capsys):
    file = tmp_path / ("picture.png" if isinstance(picture, np.ndarray) else "picture.ome.tif")
    if isinstance(picture, np.ndarray):
        cv2.imwrite(str(file), picture)
    else:
        about = {"axes": "ZYX", "PhysicalSizeX": 3.9, "PhysicalSizeY": 3.9, "PhysicalSizeZ": 25.0}
        frames = tifffile.imread(INPUTS / "focal_stack.tif")
        tifffile.imwrite(file, frames, ome=True, metadata=about)
    out = tmp_path / ("out" if line.startswith(("depth", "calibrate")) else "out.csv")
    assert status(line.replace("PICTURE", str(file)), out) == 0
    printed = [each for each in capsys.readouterr().err.splitlines() if "w_d/a" not in each]
    assert re.search(note, "".join(printed))
    assert bool(printed) == bool(note)
