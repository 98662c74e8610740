"""The four commands on small inputs with known truth, and their errors."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from argparse import Namespace
from io import BytesIO, TextIOWrapper
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import tifffile
from matplotlib.figure import Figure
from PIL import Image

from compendium.experiments.section_5_3 import texture_sequence
from microlib import io, membrane, tracking
from microlib.__main__ import main
from microlib._command._calibrate import _advise
from microlib.calibration import calibrate, detect_squares
from microlib.embryo import dimple_from_outline
from microlib.focus import FocusResult, depth_from_focus
from microlib.synthetic import mixed_texture
from tests.io.files import read_ply
from tests.laws import unlike

ROOT = Path(__file__).resolve().parent.parent
INPUTS = ROOT / "data" / "synthetic"
MODULUS = "--pixel-size 3.875 --thickness 3 --probe-half-width 25 --poisson-ratio 0.5"
BOX = "--box 30 40 40 40"
STACK = "depth focal_stack.tif --spacing 25 --pixel-size 3.9"
GRID = "calibrate circles.png --pitch 0.28mm --cell 9.9um --focal-length 126150"
OUTLINE = f"modulus outline.csv --force 10 --force-std 3 {MODULUS}"

Capture = pytest.CaptureFixture[str]


def status(line: str, out: Path | str, look: str = "--no-look") -> int:
    """Run a task on a file of the inputs, without a picture; return its exit status."""
    task, source, *options = line.split()
    try:
        return main([task, str(INPUTS / source), *options, *look.split(), "-o", str(out)])
    except SystemExit as end:
        return int(end.code)


@pytest.fixture
def figures(monkeypatch):
    """Return the figures that are saved."""
    seen: list[Figure] = []
    save = Figure.savefig
    keep = lambda figure, *given, **how: (seen.append(figure), save(figure, *given, **how))  # noqa: E731
    monkeypatch.setattr(Figure, "savefig", keep)
    return seen


def hold_alike(found: object, wanted: object) -> None:
    """Compare numbers that were written with ten digits or more."""
    assert not [*unlike(wanted, found, within=1e-7)]


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
@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
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
    (look,) = path.parent.glob("*look.png")
    with Image.open(look) as picture:  # not a small one, nor of one color
        assert min(picture.size) > 300
        assert np.ptp(np.asarray(picture.convert("L"))) > 100


def test_mesh_or_picture_that_fails_is_reported_and_the_rest_is_written(
    tmp_path, capsys, monkeypatch
):
    """A mesh needs a height; the mesh of an earlier run is removed."""

    def fail(result: FocusResult) -> None:
        raise RuntimeError("latex could not be found\n" * 80)

    monkeypatch.setattr(FocusResult, "plot", fail)
    tifffile.imwrite(tmp_path / "flat.tif", np.full((7, 64, 80), 100, np.uint8))
    (tmp_path / "surface.ply").write_text("of another run")
    line = f"depth {tmp_path / 'flat.tif'} --spacing 10 --pixel-size 1"
    assert status(line, tmp_path, "--overwrite") == 0
    printed = capsys.readouterr()
    assert "surface.ply" not in printed.out
    assert "note: surface.ply is not written: height must have" in printed.err
    assert "note: look.png is not written: RuntimeError: latex could not" in printed.err
    assert printed.err.count("\n") == 2
    assert not (tmp_path / "surface.ply").exists()
    assert (tmp_path / "summary.json").exists()


REGION = {"region": (9, 5, 60, 44)}


@pytest.mark.parametrize(
    ("line", "options", "size"),
    [
        ("--spacing -7 --region 9 5 60 44 --reduce 2",
            {"spacing": -7.0, "reduce": 2, **REGION}, 3.0),
        ("--spacing 0.007mm --register --workers 2", {"spacing": 7.0, "register": True}, 1.5),
        ("--pixel-size 2500nm/px --register --reduce 2", {"register": True, "reduce": 2}, 5.0),
        ("--region 9 5 60 44 --workers 2", REGION, 1.5),
    ],
)  # fmt: skip
def test_depth_writes_what_the_library_returns(line, options, size, tmp_path, capsys, figures):
    """The options replace the spacing and the pixel size in the file."""
    levels = mixed_texture((70, 90), np.random.default_rng(0)).astype(np.float32)
    frames = [cv2.GaussianBlur(levels, (0, 0), 0.5 + abs(k - 2.6)) for k in range(7)]
    sizes = {"PhysicalSizeX": 1.5, "PhysicalSizeY": 1.5, "PhysicalSizeZ": 4.0}
    tifffile.imwrite(tmp_path / "z.ome.tif", np.stack(frames), metadata={"axes": "ZYX", **sizes})
    assert status(f"depth {tmp_path / 'z.ome.tif'} {line}", tmp_path / "out", "") == 0
    printed = capsys.readouterr().out
    for name, scale in (("spacing", "4 µm"), ("pixel_size", "1.5 µm/px")):
        given = f"--{name.replace('_', '-')}" in line
        assert f"{name} {scale} (the file)" in printed or given
        assert f"{name} {scale}" not in printed or not given
    if "spacing" not in options:
        options = {"positions": 4.0 * np.arange(7), **options}
    found = depth_from_focus(np.stack(frames), **options)
    maps = {
        "height": (found.depth, "heights in µm"),
        "uncertainty": (found.uncertainty, "standard deviation of each height, µm"),
        "frame": (found.index, "number of the frame nearest to focus, from 0; -1 where unknown"),
        "all_in_focus": (found.all_in_focus, "every pixel from that frame"),
    }
    for name, (values, what) in maps.items():
        with tifffile.TiffFile(tmp_path / "out" / f"{name}.ome.tif") as file:
            hold_alike(file.asarray(), values)
            assert f'PhysicalSizeX="{size}"' in file.ome_metadata
            assert f'Name="{what}"' in file.ome_metadata
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    spacing = options.get("spacing", 4.0)
    hold_alike(summary, found.to_dict() | {"spacing": spacing, "pixel_size": size})
    sharp = (found.all_in_focus - found.all_in_focus.min()) / np.ptp(found.all_in_focus)
    grey = (255 * sharp).astype(np.uint8)
    io.write_ply(tmp_path / "own.ply", found.depth, pixel_size=size, image=grey)
    mesh, own = (read_ply(tmp_path / name) for name in ("out/surface.ply", "own.ply"))
    np.testing.assert_allclose(mesh["vertices"], own["vertices"], rtol=1e-6, atol=1e-6)
    # A grey level by rounding.
    assert np.abs(mesh["colors"].astype(int) - own["colors"]).max() <= 1
    (figure,) = figures
    hold_alike(figure.axes[1].images[0].get_array().filled(np.nan), found.depth)
    (bar,) = figure.axes[1].artists
    (length,) = (part.get_width() for part in bar.size_bar.get_children())
    assert bar.txt_label.get_text() == f"{size * length:g} µm"


def test_camera_matrix_and_scale_need_no_cell_size(tmp_path, capsys):
    line = "calibrate circles.png --pitch 280"
    assert status(f"{line} --focal-length 126150", tmp_path / "no") == 2
    assert "give --cell µm" in capsys.readouterr().err
    assert status(line, tmp_path / "a") == 0
    assert "lengths in the camera are in cells of its sensor" in capsys.readouterr().err
    assert status(f"{line} --cell 9.9", tmp_path / "b") == 0
    assert "in cells" not in capsys.readouterr().err
    one, other = (json.loads((tmp_path / name / "camera.json").read_text()) for name in "ab")
    # Two fits from different starts of f, which one plane hardly determines.
    np.testing.assert_allclose(
        one["micro_manager"]["PixelSizeUm"], other["micro_manager"]["PixelSizeUm"], rtol=1e-6
    )
    for key in ("camera_matrix", "rotation_vectors"):
        np.testing.assert_allclose(one["opencv"][key], other["opencv"][key], rtol=1e-4, atol=1e-7)


def board(tilt: float, fields: tuple[int, int] = (9, 7)) -> np.ndarray:
    """Draw a chessboard with fields of 40 px in 400×520 px in perspective."""
    dark = np.indices(fields[::-1]).sum(axis=0) % 2 * 200 + 30
    flat = np.pad(np.kron(dark, np.ones((40, 40))), 60, constant_values=230).astype(np.uint8)
    rows, columns = flat.shape
    corners = np.float32([[0, 0], [columns, 0], [columns, rows], [0, rows]])
    seen = corners * 0.9 + 20 + np.float32([[0, 0], [0, 60 * tilt], [0, -60 * tilt], [0, 0]])
    view = cv2.getPerspectiveTransform(corners, seen)
    image = cv2.warpPerspective(flat, view, (columns, rows), borderValue=230)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


@pytest.mark.parametrize(
    ("line", "given"),
    [
        ("--pitch 100 --cell 5", {}),
        ("--pitch 0.1mm --cell 5000nm --focal-length 12cm --marks chessboard",
            {"focal_length": 120000.0}),
    ],
)  # fmt: skip
def test_calibrate_writes_what_the_library_returns(line, given, tmp_path, capsys, figures):
    """The source is a quoted pattern beside a name with brackets."""
    photos = [tmp_path / f"view_{k}.png" for k in range(3)]
    images = [board(tilt) for tilt in (0.0, 0.5, 1.0)]
    for photo, image in zip(photos, images, strict=True):
        cv2.imwrite(str(photo), image)
    blank = tmp_path / "blank[1].png"
    cv2.imwrite(str(blank), np.full((400, 520), 200, np.uint8))
    line = f"calibrate {tmp_path}/view_*.png {blank} {line}"
    assert status(line, tmp_path / "out", "") == 0
    printed = capsys.readouterr()
    assert printed.out.count("png: chessboard: Detection of 48 points") == 3
    assert "3 view(s)" in printed.out
    assert f"left out {blank}" in printed.err
    # The same as the calls of the library.
    found = [detect_squares(image, pattern="chessboard") for image in images]
    result = calibrate(found, pitch=100.0, pixel_size=5.0, **given)
    assert str(result) in printed.out
    hold_alike(
        json.loads((tmp_path / "out" / "camera.json").read_text()), json.loads(result.to_json())
    )
    camera = pd.read_csv(tmp_path / "out" / "camera.csv", index_col="parameter")
    hold_alike(camera, result.to_frame().astype(camera.dtypes))
    pairs = zip(found, photos, strict=True)
    tables = pd.concat([each.to_frame().assign(photo=str(photo)) for each, photo in pairs])
    points = pd.read_csv(tmp_path / "out" / "points.csv")
    hold_alike(points, tables.reset_index(drop=True)[points.columns])
    for ax, each, image in zip(figures[0].axes, found, images, strict=False):
        np.testing.assert_allclose(np.transpose(ax.lines[0].get_data()), each.points)
        np.testing.assert_allclose(ax.images[0].get_array(), (image - 30.0) * 1.275, atol=2)
        assert "px rms" in ax.get_title()


def test_calibrate_leaves_out_photographs_that_disagree(tmp_path, capsys):
    """One photograph has another size and one another aspect ratio."""
    flat = np.pad(np.kron(np.indices((7, 9)).sum(axis=0) % 2, np.ones((40, 40))), 60)
    camera, images = np.array([[900, 0, 239.5], [0, 900, 199.5], [0, 0, 1]]), {}
    for k in range(5):  # through one lens
        turn = cv2.Rodrigues(np.array([0.3 * np.cos(2.5 * k), 0.4 * np.sin(2.5 * k), 0.1 * k]))[0]
        turn[:, 2] = [0, 0, 1000] - turn @ [239.5, 199.5, 0]
        view = cv2.warpPerspective(200 * flat, camera @ turn, (480, 400), flags=cv2.INTER_AREA)
        images[f"view_{k}"] = cv2.GaussianBlur(view + 20, (0, 0), 1.0).astype(np.uint8)
    images["wide"] = np.pad(images["view_0"], 4, mode="edge")
    images["stretched"] = cv2.resize(images["view_1"], None, fx=1.5, fy=1.0)[:, 120:600]
    for name, image in images.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    assert status(f"calibrate {tmp_path} --pitch 100 --cell 5", tmp_path / "out") == 0
    printed = capsys.readouterr()
    assert "wide.png: its size is 488×408 px, of most 480×400" in printed.err
    assert "stretched.png: it disagrees with the others by" in printed.err
    assert "5 view(s)" in printed.out
    found = [detect_squares(images[f"view_{k}"], pattern="chessboard") for k in range(5)]
    assert str(calibrate(found, pitch=100.0, pixel_size=5.0)) in printed.out


def test_advice_depends_on_the_result():
    """A small grid, a lack of fit and undetermined parameters, each alone."""
    notes: list[str] = []
    a = Namespace(note=notes.append)

    def advice(side: float, fits: bool, low: float, open_: tuple, views: int = 1) -> str:
        notes.clear()
        points = np.array([[30.0, 40.0], [30 + side, 40 + 2 * side]])
        view = Namespace(points=points, image_size=(400, 100))
        small = Namespace(points=points[:1], image_size=(400, 100))
        interval = {"magnification": (low, 3.0)}.__getitem__
        result = Namespace(adequate=fits, interval=interval, undetermined=open_)
        _advise(a, result, [small] * (views - 1) + [view])
        return "\n".join(notes)

    assert not advice(32.0, True, 1.0, (), views=3)
    assert "less than 5 %" in advice(31.0, True, 1.0, ())
    assert advice(32.0, False, 1.0, ()).endswith("Several photographs show more of the lens")
    assert advice(32.0, False, 1.0, (), views=2).endswith("the same everywhere?")
    assert "interval reaches zero" in advice(32.0, True, 0.0, ("alpha",))
    assert advice(32.0, True, 1.0, ("alpha", "f")).startswith("alpha, f: undetermined; give --f")


def test_calibrate_prints_advice(tmp_path, capsys):
    image = np.full((1500, 2000), 230, np.uint8)
    image[100:500, 200:680] = board(0.0)
    cv2.imwrite(str(tmp_path / "small.png"), image)
    line = f"calibrate {tmp_path / 'small.png'} --marks chessboard --pitch 100 --cell 5"
    assert status(line, tmp_path / "out") == 0
    printed = capsys.readouterr().err
    assert "less than 5 % of the image" in printed
    assert "give --focal-length" in printed or "reaches zero" in printed


@pytest.mark.parametrize(
    ("line", "options"),
    [
        ("--motion affine --rate 20 --video", {"motion": "affine", "rate": 20.0}),
        ("--pixel-size 2.5 --video", {"motion": "translation", "pixel_size": 2.5}),
        ("--motion homography --rate 12.5 --pixel-size 2.5um",
            {"motion": "homography", "rate": 12.5, "pixel_size": 2.5}),
    ],
)  # fmt: skip
def test_track_writes_what_the_library_returns(line, options, tmp_path, capsys, figures):
    """A part that is lost in one frame, in 16 bits; the same run again gives the same table."""
    way = [(60 + 2.5 * k, 60 - k) for k in range(6)]
    frames = np.stack(texture_sequence(way, np.random.default_rng(1))).astype(np.uint16) * 200
    frames[4] //= 2
    frames[3] = np.random.default_rng(2).integers(0, 50000, frames[3].shape)
    tifffile.imwrite(tmp_path / "film.tif", frames)
    out = tmp_path / "track.csv"
    line = f"track {tmp_path / 'film.tif'} --box 60 60 49 49 {line}"
    assert status(line, out, "") == 0
    printed = capsys.readouterr()
    assert "lost in 1 of 6 frames;" in printed.out
    assert not printed.err
    before = out.read_text()
    assert status(f"{line} --quiet --overwrite", out, "") == 0
    assert not capsys.readouterr().out
    assert out.read_text() == before
    table = pd.read_csv(out, index_col="frame")
    wanted = tracking.track_all(frames, (60, 60, 49, 49), **options)
    assert [*table] == [*wanted]
    hold_alike(table.fillna({"reason": ""}), wanted.astype(table.dtypes))
    figure = figures[0]
    np.testing.assert_allclose(
        figure.axes[0].images[0].get_array(), 255 * (frames[0] / frames[0].max()), atol=4
    )
    assert figure.axes[1].get_xlabel() == ("time (s)" if "rate" in options else "frame")
    if "--video" not in line:
        assert not (tmp_path / "track_look.mp4").exists()
        return
    film = cv2.VideoCapture(str(tmp_path / "track_look.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(options.get("rate", 25))
    for k, frame in enumerate(frames):
        # Yellow has red and green without blue, red has no green; around where it was last seen.
        shown = film.read()[1].astype(int)
        marked = np.argwhere(shown[..., 2] - shown[..., 0] > 80)[:, ::-1]
        at = np.array(way[k if k != 3 else 2]) - way[0] + 84
        np.testing.assert_allclose((marked.min(axis=0) + marked.max(axis=0)) / 2, at, atol=3)
        green = np.median(shown[marked[:, 1], marked[:, 0], 1])
        assert (green < 100) == (k == 3)
        unmarked = shown[:30].mean()
        assert unmarked == pytest.approx(255 * frame[:30].mean() / frames[0].max(), abs=6)
    assert not film.read()[0]


def test_truncated_film_keeps_the_rows_before_its_end(tmp_path, capsys):
    way = [(60 + 2.5 * k, 60) for k in range(30)]
    frames = texture_sequence(way, np.random.default_rng(0))
    film = tmp_path / "cut.avi"
    size = frames[0].shape[::-1]
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 30, size, False)
    for frame in frames:
        writer.write(np.clip(frame, 0, 255).astype(np.uint8))
    writer.release()
    film.write_bytes(film.read_bytes()[: int(0.8 * film.stat().st_size)])
    out = tmp_path / "out.csv"
    assert status(f"track {film} --box 60 60 49 49", out) == 3
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    count = int(re.search(r"keeps the (\d+) rows so far", printed)[1])
    assert 10 < count < 30
    way = pd.read_csv(out)["center_x"]
    assert len(way) == count
    assert way.diff().dropna().to_numpy() == pytest.approx(2.5, abs=0.2)


def test_row_written_during_ctrl_c_is_counted(tmp_path, monkeypatch, capsys):
    class Stopped(csv.DictWriter):
        def writerow(self, row: dict) -> None:
            super().writerow(row)
            if row["frame"] == 7:
                raise KeyboardInterrupt

    monkeypatch.setattr(csv, "DictWriter", Stopped)
    out = tmp_path / "track.csv"
    words = f"track {INPUTS / 'frames.tif'} {BOX} --quiet --no-look -o {out}".split()
    assert main(words) == 130
    assert len(pd.read_csv(out)) == 8
    assert f"{out} keeps the 8 rows so far" in capsys.readouterr().err


def test_each_row_is_written_before_the_next_frame(tmp_path, monkeypatch):
    out, lines, each = tmp_path / "track.csv", [], tracking.track_each

    def watched(*args, **options):
        for row in each(*args, **options):
            yield row
            lines.append(out.read_text().count("\n"))

    monkeypatch.setattr(tracking, "track_each", watched)
    assert status(f"track frames.tif {BOX}", out) == 0
    assert lines == [*range(2, len(lines) + 2)]


def test_lost_part_gives_exit_status_4(tmp_path, capsys):
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (9, 100, 120)).astype(np.uint8)
    frames[:2] = cv2.GaussianBlur(frames[0], (0, 0), 2)
    tifffile.imwrite(tmp_path / "noise.tif", frames)
    assert status(f"track {tmp_path / 'noise.tif'} {BOX}", tmp_path / "track.csv") == 4
    printed = capsys.readouterr().err
    assert "lost in 7 of 9 frames: try another --motion" in printed
    assert len(pd.read_csv(tmp_path / "track.csv")) == 9


@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
def test_modulus_writes_what_the_library_returns(tmp_path, capsys, figures):
    """Of either rim."""
    assert status(f"{OUTLINE} --thickness-std 0.2um", tmp_path / "out.csv", "") == 0
    printed = capsys.readouterr().out
    found = pd.read_csv(tmp_path / "out.csv", index_col="quantity")["value"]
    x, y = pd.read_csv(INPUTS / "outline.csv").sort_values("x").to_numpy().T
    measured = dimple_from_outline(x, y, pixel_size=3.875)
    points, title = {"outline": (x, y - y.min())}, figures[0].axes[0].get_title()
    for rim, prefix in (("left", ""), ("right", "right_rim_")):
        dimple = getattr(measured, rim)
        values = {"force": 10.0, "thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
        stds = {"force": 3.0, "thickness": 0.2}
        for k, name in enumerate(("dimple_radius", "dimple_depth")):
            values[name] = getattr(dimple, name)
            stds[name] = np.sqrt(dimple.covariance[k, k])
        modulus = membrane.elastic_modulus(**values)
        own = {"modulus_MPa": modulus, **values, **{f"{k}_std": std for k, std in stds.items()}}
        own["finite_slope_modulus_MPa"] = membrane.finite_slope_modulus(**values)
        for name, value in own.items():
            assert found[prefix + name] == pytest.approx(value, rel=1e-4), prefix + name
        drawn = membrane.modulus_samples(values, stds, size=20_000, rng=5)
        ends = found[[f"{prefix}modulus_{end}95_MPa" for end in ("low", "high")]]
        # Two draws of the tails differ by 2 %.
        np.testing.assert_allclose(ends, np.quantile(drawn, [0.025, 0.975]), rtol=0.06)
        words = f"E = {modulus:.4g} MPa, 95 % between {ends.iloc[0]:.4g} and {ends.iloc[1]:.4g} MPa"
        a, w = (f"{values[name]:.1f} ± {stds[name]:.1f} µm" for name in [*values][-2:])
        words = f"{rim} rim{', as in the thesis' * (rim == 'left')}: {words}\na = {a}, w_d = {w}"
        assert words in printed
        assert words in title
        points |= {f"{rim} rim": dimple.rim, "bottom": dimple.bottom}
    for line in figures[0].axes[0].lines:
        if line.get_label() != "fitted model":
            at = np.atleast_2d(np.transpose(line.get_data()))
            wanted = np.atleast_2d(np.transpose(points.pop(line.get_label())))
            np.testing.assert_allclose(at, wanted, rtol=1e-4)
    assert not points


POINTS = pd.read_csv(INPUTS / "outline.csv")


@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
@pytest.mark.parametrize(
    ("table", "options", "code", "message"),
    [
        (POINTS.assign(y=300 - POINTS["y"]), "", 0, "with y pointing down"),
        (POINTS.assign(y=300 - POINTS["y"]), "--y-down", 0, ""),
        (POINTS, "--y-down", 2, "leave out --y-down"),
        (POINTS.rename(columns={"x": "col", "y": "row"}), "", 0, "with y pointing up"),
        (POINTS.rename(columns={"x": "x_um", "y": "y_um"}), "", 2, "leave out --pixel-size"),
    ],
)
def test_direction_and_unit_of_an_outline_table(table, options, code, message, tmp_path, capsys):
    file, out = tmp_path / "points.csv", tmp_path / "out.csv"
    table.to_csv(file, index=False)
    line = OUTLINE.replace("outline.csv", str(file))
    assert status(f"{line} {options}", out) == code
    assert message in capsys.readouterr().err
    if code == 0:
        found = pd.read_csv(out, index_col="quantity")["value"]
        assert found["dimple_radius"] == pytest.approx(250, abs=3.875)


@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
def test_disagreeing_rims_give_a_note(tmp_path, capsys):
    """The left flank is stretched by a half."""
    file = tmp_path / "points.csv"
    middle = POINTS["x"].mean()
    stretched = np.where(POINTS["x"] < middle, middle + 1.5 * (POINTS["x"] - middle), POINTS["x"])
    for x, noted in ((POINTS["x"], False), (stretched, True)):
        POINTS.assign(x=x).to_csv(file, index=False)
        line = OUTLINE.replace("outline.csv", str(file)).replace("--force-std 3", "--force-std 0")
        assert status(f"{line} --overwrite", tmp_path / "out.csv") == 0
        assert ("two rims differ" in capsys.readouterr().err) == noted


@pytest.mark.parametrize(
    ("line", "message"),
    [
        # A scale that is missing, has another unit, or is out of range.
        ("depth focal_stack.tif --spacing 25", "give --pixel-size µm"),
        ("depth focal_stack.tif", "give --spacing µm, --pixel-size µm"),
        ("calibrate circles.png", "microlib calibrate: no scale is in the file: give --pitch µm"),
        ("modulus outline.csv", "--thickness µm, --probe-half-width µm, --poisson-ratio ratio"),
        (f"{STACK} --spacing 5kg", "--spacing: invalid number in µm value: '5kg'"),
        (f"{STACK} --spacing 0", "positions must rise or fall strictly"),
        ("calibrate circles.png --cell=-1,25 --pitch 280", "--cell must be positive, got -1.25"),
        (f"{OUTLINE} --force-std -3", "['force'] must be zero or positive"),
        # Arguments that the library refuses, by the names of the options.
        (f"{STACK} --region 0 0 999 5", "--region must"),
        (f"{STACK} --time 1", "--time must be left out for frames without"),
        ("track frames.tif --box 0 0 5 40", "track: --box width must be at least 6, got 5"),
        (f"track frames.tif {BOX} --channel 2", "--channel must be left out for frames without"),
        (f"track frames.tif {BOX} --color", "unrecognized arguments: --color"),
        # A source that is not there, or shows something else.
        ("depth missing.tif --spacing 25 --pixel-size 1", "missing.tif"),
        ("depth circles.png --spacing 5 --pixel-size 1", "circles.png must hold three frames"),
        ("calibrate embryo.png --marks charuco --cell 9.9 --pitch 280", "microlib calibrate: "),
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


@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
@pytest.mark.parametrize(
    ("line", "given"),
    [
        (OUTLINE.replace("--force-std 3", "--force-std 0"), "--force 1e-05"),
        (f"track frames.tif {BOX}", "--pixel-size 50800"),
        (f"track frames.tif {BOX}", "--pixel-size 0.006"),
    ],
)
def test_unusual_scale_gives_a_note(line, given, tmp_path, capsys):
    assert status(f"{line} {given}", tmp_path / "out.csv") == 0
    assert f"note: {given} is unusual under a microscope" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "number"),
    [
        ("--force=10", 10), ("--force=10uN", 10), ("--force=1e4 nN", 10), ("--force=10e-6N", 10),
        ("--pixel-size=0,01mm/px", 10), ("--thickness=12cm", 120000), ("--thickness=0,25", 0.25),
        ("--thickness=12,5mm", 12500), ("--thickness=0,125", 0.125), ("--thickness=1.500", 1.5),
    ],
)  # fmt: skip
def test_number_can_have_a_unit_and_a_comma(given, number, tmp_path, capsys):
    """Scales are printed one by one, before that of the probe is rejected."""
    line = [*OUTLINE.split()[2:], given, "--probe-half-width=0", "-o", str(tmp_path / "out.csv")]
    assert main(["modulus", str(INPUTS / "outline.csv"), *line]) == 2
    name = given[2:].split("=")[0].replace("-", "_")
    assert f"{name} {number:g} µ" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "readings"),
    [
        ("126,000", "126,000 can be 126000 or 126.000"), ("1,500", "1,500 can be 1500 or 1.500"),
        ("-1,500", ""), ("126.000,5", ""), ("1,23,456", ""), ("1,500.0", ""), ("1,234,567", ""),
    ],
)  # fmt: skip
def test_ambiguous_comma_is_rejected(text, readings, capsys):
    assert status(f"calibrate circles.png --pitch 1 --cell 1 --focal-length={text}", "out") == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert readings in printed


def full(*given: object, **options: object) -> None:
    raise OSError(28, "No space left on device")


def stopped(*given: object, **options: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("line", "fails", "kept"),
    [
        (STACK, io.write_height_tiff, []),
        (STACK, io.write_ply, ["all_in_focus", "frame", "height", "uncertainty"]),
        (STACK, FocusResult.plot, ["all_in_focus", "frame", "height", "summary", "surface",
            "uncertainty"]),
        (f"track frames.tif {BOX} --video", tracking.plot_track, ["out"]),
        (f"track frames.tif {BOX} --video", cv2.polylines, ["out", "out_look"]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("how", [full, stopped])
def test_written_files_stay_when_a_later_file_fails(
    line, fails, kept, how, tmp_path, capsys, monkeypatch
):
    owner = {"plot": FocusResult, "plot_track": tracking, "polylines": cv2}.get(fails.__name__, io)
    monkeypatch.setattr(owner, fails.__name__, how)
    folder = tmp_path / "new"
    out = folder if line == STACK else folder / "out.csv"
    found = status(line, out, "")
    task, printed = line.split()[0], capsys.readouterr().err
    if how is full and owner is not io:  # a picture, without which the numbers are complete
        assert found == 0
        assert printed.count("\n") == 1
        assert printed.startswith("note: ")
        assert printed.endswith(f" is not written: {out}: No space left on device\n")
        kept = [*kept, "out_look"] if fails.__name__ == "plot_track" else kept
    else:
        assert found == (2 if how is full else 130)
        reason = f"{out}: No space left on device" if how is full else "stopped"
        assert printed == f"microlib {task}: {reason}\n"
    assert sorted(path.name.split(".")[0] for path in folder.iterdir()) == kept


def test_help_lists_the_tasks_and_shows_an_example(capsys):
    assert main([]) == 0
    overview = capsys.readouterr().out
    for task in ("depth", "calibrate", "track", "modulus"):
        assert re.search(rf"^ +{task}\s+[A-Z]", overview, flags=re.M)
        with pytest.raises(SystemExit, match="0"):
            main([task, "--help"])
        assert f"Example: microlib {task} " in capsys.readouterr().out


@pytest.mark.parametrize(
    "code",
    [
        "import sys; from microlib._command import main; sys.exit(main(sys.argv[1:]))",
        "import microlib.focus",
        "import microlib.optics",
        "import microlib; help(microlib)",
    ],
)
def test_missing_opencv_error_names_the_package(tmp_path, code):
    (tmp_path / "cv2.py").write_text("raise ModuleNotFoundError('No module', name='cv2')")
    done = subprocess.run(
        [sys.executable, "-c", code, *STACK.split(), "-o", str(tmp_path / "out")],
        cwd=INPUTS,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    last = (done.stderr or done.stdout.strip()).splitlines()[-1]
    assert last.endswith("OpenCV 4.12 or newer is needed: pip install opencv-python-headless")
    if "_command" in code:
        assert done.returncode == 2
        assert done.stderr == f"{last}\n"


def test_full_disk_is_reported_and_old_pictures_are_removed(tmp_path, capsys):
    (tmp_path / "full.csv").symlink_to("/dev/full")
    assert status(f"track frames.tif {BOX} --overwrite", tmp_path / "full.csv") == 2
    assert "full.csv: No space left" in capsys.readouterr().err
    (tmp_path / "full.csv").unlink()
    for name in ("track_look.png", "track_look.mp4"):
        (tmp_path / name).write_text("of another run")
    assert status(f"track frames.tif {BOX} --overwrite", tmp_path / "track.csv") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["track.csv"]


# --- The user's files, numbers and terminals ------------------------------------------------------


def test_output_never_replaces_an_input(tmp_path, capsys):
    """Also behind a link, and with --overwrite."""
    folder = tmp_path / "scan"
    folder.mkdir()
    stack = tifffile.imread(INPUTS / "focal_stack.tif")
    tifffile.imwrite(folder / "height.ome.tif", stack, metadata={"axes": "ZYX"})
    cv2.imwrite(str(folder / "look.png"), cv2.imread(str(INPUTS / "circles.png")))
    tifffile.imwrite(folder / "a_look.png.tif", tifffile.imread(INPUTS / "frames.tif"))
    (folder / "a_look.png").symlink_to(folder / "a_look.png.tif")
    (folder / "outline.csv").write_bytes((INPUTS / "outline.csv").read_bytes())
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    for line, out, name in (
        (f"depth {folder}/height.ome.tif --spacing 25 --pixel-size 3.9", folder, "height.ome.tif"),
        (f"{GRID.replace('circles', f'{folder}/look')}", folder, "look.png"),
        (f"track {folder}/a_look.png.tif {BOX}", folder / "a.csv", "a_look.png"),
        (
            f"modulus {folder}/outline.csv --force 10 {MODULUS}",
            folder / "outline.csv",
            "outline.csv",
        ),
    ):
        assert status(line, out, "--overwrite") == 2
        assert f"{folder / name} is an input: give another --out" in capsys.readouterr().err
        # A folder that is missing hides the others from a search for them.
        assert status(line, folder / "missing" / ".." / out.relative_to(folder), "--overwrite") == 2
        assert f"{folder / name} is an input" in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


@pytest.mark.parametrize("task", ["depth", "calibrate", "track"])
def test_results_in_the_input_folder_are_ignored(task, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if task == "calibrate":
        (tmp_path / "grid.png").write_bytes((INPUTS / "circles.png").read_bytes())
    else:
        source = {"depth": "focal_stack.tif", "track": "frames.tif"}[task]
        for k, frame in enumerate(tifffile.imread(INPUTS / source)[:12]):
            cv2.imwrite(str(tmp_path / f"f{k}.png"), frame)
    line = {
        "depth": "depth . --spacing 25 --pixel-size 3.9 -o .",
        "calibrate": "calibrate . --pitch 280 --cell 9.9 --focal-length 126150 -o .",
        "track": f"track . {BOX} -o track.csv",
    }[task].split()
    assert main(line) == 0
    first = capsys.readouterr()
    if task != "calibrate":
        assert "12 files, from f0.png to f11.png" in first.out
    results = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.suffix in (".csv", ".json")}
    assert results
    assert main([*line, "--overwrite"]) == 0
    assert re.search(r"look\.png.*: results, left out", capsys.readouterr().err)
    for name, content in results.items():
        assert (tmp_path / name).read_bytes() == content


@pytest.mark.parametrize("encoding", ["cp1252", "cp932"])
def test_letters_that_a_terminal_lacks_are_replaced(tmp_path, monkeypatch, encoding):
    """The name has Cyrillic letters and the output µ and ±."""
    out, err = (TextIOWrapper(BytesIO(), encoding) for _ in range(2))
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    photo = tmp_path / "сетка.png"
    photo.write_bytes((INPUTS / "circles.png").read_bytes())
    assert status(GRID.replace("circles.png", str(photo)), tmp_path / "µ") == 0
    out.flush()
    assert b"circles: " in out.buffer.getvalue()
    assert not err.buffer.getvalue()
    assert len(list((tmp_path / "µ").iterdir())) == 3


def test_commands_run_as_a_module_without_docstrings(tmp_path):
    line = [*OUTLINE.split(), "--no-look", "-o", str(tmp_path / "a.csv")]
    done = subprocess.run(
        [sys.executable, "-OO", "-m", "microlib", *line],
        cwd=INPUTS,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
    )
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)
    assert pd.read_csv(tmp_path / "a.csv", index_col=0).loc["modulus_MPa", "value"] > 0


#: Settings that turn pictures upside down, need LaTeX, or change colors, sizes and formats.
USER_STYLE = {
    "image.origin": "lower", "text.usetex": True, "axes.grid": True, "figure.dpi": 30,
    "savefig.format": "pdf", "savefig.bbox": "tight", "savefig.transparent": True,
    "image.cmap": "jet",
}  # fmt: skip


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
    def fail(*_: object, **__: object) -> None:
        raise cv2.error("OpenCV(5.0.0)\nassertion\nfailed")

    monkeypatch.setattr("microlib.focus.depth_from_focus", fail)
    assert status(STACK, tmp_path / "out", "") == 2
    assert capsys.readouterr().err == "microlib depth: error: OpenCV(5.0.0) assertion failed\n"


def test_film_that_cannot_be_written_gives_a_note(tmp_path, capsys):
    wide = np.random.default_rng(0).integers(0, 255, (2, 64, 9000)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "wide.tif", wide)
    line = f"track {tmp_path}/wide.tif --box 20 8 40 40 --video"
    assert status(line, tmp_path / "t.csv") in (0, 4)
    printed = capsys.readouterr()
    film = tmp_path / "t_look.mp4"
    if film.exists():  # of a build of OpenCV that can
        assert cv2.VideoCapture(str(film)).read()[0]
    else:
        assert "t_look.mp4 is not written: OpenCV cannot write a film of 9000×64 px" in printed.err
        assert "t_look.mp4" not in printed.out


def test_output_name_can_be_a_dot_or_begin_with_a_tilde(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert status(STACK, ".") == 0
    assert status(STACK, "~out") == 0
    assert {"height.ome.tif", "~out"} <= {file.name for file in tmp_path.iterdir()}
