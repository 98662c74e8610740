"""The command line: four tasks on the small inputs, whose truth is known, and what it refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from PIL import Image

from microlib._command import main
from microlib._command._scales import _quantity
from microlib.synthetic import mixed_texture, texture_sequence

ROOT = Path(__file__).resolve().parent.parent
INPUTS = ROOT / "data" / "synthetic"
MODULUS = "--force 10 --pixel-size 3.875 --thickness 3 --probe-half-width 25 --poisson 0.5"
BOX = "--box 30 40 40 40"


def run(task: str, source: str, options: str, out: Path) -> str:
    """Run a task in a process of its own; return what it prints."""
    line = [sys.executable, "-m", "microlib", task, INPUTS / source, *options.split(), "-o", out]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def status(line: str, out: Path) -> int:
    """Run a task here, of a file of the inputs, without a picture; return its exit status."""
    task, source, *options = line.split()
    try:
        return main([task, str(INPUTS / source), *options, "--no-look", "-o", str(out)])
    except SystemExit as end:
        return int(end.code)


def quantities(path: Path) -> pd.Series:
    return pd.read_csv(path, index_col="quantity")["value"]


def is_look(path: Path) -> bool:
    """Return whether a file is a picture of some hundred pixels, and not of one color."""
    with Image.open(path) as picture:
        return min(picture.size) > 300 and np.ptp(np.asarray(picture.convert("L"))) > 100


def test_depth_writes_the_heights_to_scale(tmp_path: Path) -> None:
    told = run("depth", "focal_stack.tif", "--spacing 25 --pixel-size 3.9", tmp_path)
    assert "spacing 25 µm (given)" in told
    truth = tifffile.imread(INPUTS / "height_um.tif") + 50  # whose first frame is at -50 µm
    off = np.abs(tifffile.imread(tmp_path / "height.ome.tif") - truth)
    assert np.nanquantile(off, 0.95) < 5  # a fifth of the spacing, as in the guide
    assert json.loads((tmp_path / "summary.json").read_text())["pixel_size"] == 3.9
    assert (tmp_path / "surface.ply").stat().st_size > 1000
    assert is_look(tmp_path / "look.png")
    # The file that was written tells its scale: it is asked for no more.
    stack = np.stack([tifffile.imread(tmp_path / "all_in_focus.ome.tif")] * 3)
    metadata = {"axes": "ZYX", "PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0, "PhysicalSizeZ": 7.0}
    tifffile.imwrite(tmp_path / "own.ome.tif", stack, metadata=metadata)
    told = run("depth", str(tmp_path / "own.ome.tif"), "--reduce 2", tmp_path / "own")
    assert "spacing 7 µm (the file)" in told
    assert "pixel_size 2 µm/px (the file)" in told


def test_depth_names_the_mesh_only_if_there_is_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tifffile.imwrite(tmp_path / "flat.tif", np.full((7, 64, 80), 100, np.uint8))
    line = f"depth {tmp_path / 'flat.tif'} --spacing 10 --pixel-size 1"
    assert status(line, tmp_path / "out") == 0
    told = capsys.readouterr()
    assert "surface.ply" not in told.out
    assert "note: surface.ply is not written" in told.err
    assert not (tmp_path / "out" / "surface.ply").exists()


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_the_mesh_has_the_contrast_of_the_frames(tmp_path: Path, scale: float) -> None:
    levels = mixed_texture((48, 64), np.random.default_rng(0)).astype(np.float32)
    frames = [cv2.GaussianBlur(levels, (0, 0), 0.5 + abs(k - 3)) for k in range(7)]
    tifffile.imwrite(tmp_path / "stack.tif", np.float32(scale) * np.stack(frames))
    line = f"depth {tmp_path / 'stack.tif'} --spacing 10 --pixel-size 1"
    assert status(line, tmp_path / "out") == 0
    raw = (tmp_path / "out" / "surface.ply").read_bytes()
    count = int(re.search(rb"element vertex (\d+)", raw)[1])
    kind = [("xyz", "<f4", 3), ("rgb", "u1", 3)]
    begin = raw.index(b"end_header\n") + len(b"end_header\n")
    colors = np.frombuffer(raw[begin:], kind, count)["rgb"]
    assert np.ptp(colors) > 200


def test_calibrate_finds_the_microscope(tmp_path: Path) -> None:
    line = "--pitch 0.28mm --cell 9.9um --focal-length 126150"
    told = run("calibrate", "circles.png", line, tmp_path)
    assert "pitch 280 µm (given)" in told
    assert "circles.png: circles, square lattice" in told
    camera = pd.read_csv(tmp_path / "camera.csv", index_col="parameter")
    truth = {"magnification": 1.5892988, "alpha": 0.03, "beta": -0.02, "gamma": 0.0}
    for name, value in truth.items():
        off = abs(camera.loc[name, "estimate"] - value)
        assert off < 4 * camera.loc[name, "sigma"], name
    assert len(pd.read_csv(tmp_path / "points.csv")) == 149
    assert json.loads((tmp_path / "camera.json").read_text())["micro_manager"]["PixelSizeUm"]
    assert is_look(tmp_path / "look.png")


def board(tilt: float, fields: tuple[int, int] = (9, 7)) -> np.ndarray:
    """Draw a chessboard of fields of 40 px in 400×520 px, seen from aside."""
    dark = np.indices(fields[::-1]).sum(axis=0) % 2 * 200 + 30
    flat = np.pad(np.kron(dark, np.ones((40, 40))), 60, constant_values=230).astype(np.uint8)
    rows, columns = flat.shape
    corners = np.float32([[0, 0], [columns, 0], [columns, rows], [0, rows]])
    seen = corners * 0.9 + 20 + np.float32([[0, 0], [0, 60 * tilt], [0, -60 * tilt], [0, 0]])
    view = cv2.getPerspectiveTransform(corners, seen)
    image = cv2.warpPerspective(flat, view, (columns, rows), borderValue=230)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


def test_calibrate_takes_several_views_and_says_what_it_sees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    views = [tmp_path / f"view_{k}.png" for k in range(3)]
    for view, tilt in zip(views, (0.0, 0.5, 1.0), strict=True):
        cv2.imwrite(str(view), board(tilt))
    cv2.imwrite(str(tmp_path / "blank.png"), np.full((400, 520), 200, np.uint8))
    photos = " ".join(map(str, [*views, tmp_path / "blank.png"]))
    line = f"calibrate {photos} --pitch 100 --cell 5"
    assert status(line, tmp_path / "out") == 0
    told = capsys.readouterr()
    assert told.out.count("png: chessboard: Detection of 48 points") == 3
    assert "48 points" in told.out
    assert "3 view(s)" in told.out
    assert f"left out {tmp_path / 'blank.png'}" in told.err
    assert pd.read_csv(tmp_path / "out" / "points.csv")["photo"].value_counts().tolist() == [48] * 3


def test_calibrate_says_what_to_do_next(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = np.full((1500, 2000), 230, np.uint8)
    image[100:500, 200:680] = board(0.0)
    cv2.imwrite(str(tmp_path / "small.png"), image)
    line = f"calibrate {tmp_path / 'small.png'} --marks chessboard --pitch 100 --cell 5"
    assert status(line, tmp_path / "out") == 0
    told = capsys.readouterr().err
    assert "less than 5 % of the image" in told
    assert "give --focal-length" in told or "reaches zero" in told


def test_track_follows_the_square(tmp_path: Path) -> None:
    options = f"{BOX} --rate 33 --pixel-size 6.23 --video"
    told = run("track", "frames.tif", options, tmp_path / "track.csv")
    assert "lost in 0 of 40 frames" in told
    table, truth = pd.read_csv(tmp_path / "track.csv"), pd.read_csv(INPUTS / "frames_path.csv")
    way = table[["center_x", "center_y"]].to_numpy()
    assert np.abs(way - truth[["x_px", "y_px"]].to_numpy()).max() < 0.1
    assert table["x_um"].to_numpy() == pytest.approx(6.23 * (way[:, 0] - way[0, 0]), abs=1e-6)
    assert table["time_s"].iloc[-1] == pytest.approx(39 / 33)
    assert is_look(tmp_path / "track_look.png")
    film = cv2.VideoCapture(str(tmp_path / "track_look.mp4"))
    shown = [film.read()[1] for _ in range(40)]
    assert not film.read()[0]
    # The box is drawn in yellow, red and green without blue, where the part is.
    yellow = shown[-1][..., 1:].min(axis=2).astype(int) - shown[-1][..., 0]
    assert np.argwhere(yellow > 80).mean(axis=0)[::-1] == pytest.approx(way[-1], abs=2)


@pytest.mark.parametrize("motion", ["affine", "homography"])
def test_every_motion_is_followed(
    motion: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(f"track frames.tif {BOX} --motion {motion}", tmp_path / "track.csv") == 0
    assert "lost in 0 of 40 frames" in capsys.readouterr().out


def write_film(path: Path, count: int, share: float = 1.0) -> None:
    """Write a film of a texture in motion, cut off after a share of its bytes."""
    way = [(60 + 2.5 * k, 60) for k in range(count)]
    frames = texture_sequence(way, np.random.default_rng(0))
    size = frames[0].shape[::-1]
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, size, False)
    for frame in frames:
        film.write(np.clip(frame, 0, 255).astype(np.uint8))
    film.release()
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])


def test_the_depth_of_a_film_that_ends_early_is_that_of_what_was_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_film(tmp_path / "cut.avi", 30, share=0.8)
    line = f"depth {tmp_path / 'cut.avi'} --spacing 5 --pixel-size 2"
    assert status(line, tmp_path / "none") == 2
    assert not (tmp_path / "none").exists()
    assert status(f"{line} --allow-truncated", tmp_path / "out") == 0
    count = int(re.search(r"the (\d+) frames before are used", capsys.readouterr().err)[1])
    assert 10 < count < 30
    best = tifffile.imread(tmp_path / "out" / "frame.ome.tif")
    assert best.max() < count


@pytest.mark.parametrize(("option", "expected"), [("", 3), (" --allow-truncated", 0)])
def test_a_film_that_ends_early_keeps_its_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, expected: int
) -> None:
    write_film(tmp_path / "cut.avi", 30, share=0.8)
    line = f"track {tmp_path / 'cut.avi'} --box 60 60 49 49{option}"
    assert status(line, tmp_path / "track.csv") == expected
    rows = pd.read_csv(tmp_path / "track.csv")
    assert 10 < len(rows) < 30
    assert rows["center_x"].diff().dropna().to_numpy() == pytest.approx(2.5, abs=0.2)
    told = capsys.readouterr().err
    assert f"keeps the {len(rows)} rows so far" in told
    assert told.count("\n") == 1


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_track_keeps_its_rows(tmp_path: Path, end: signal.Signals) -> None:
    out = tmp_path / "track.csv"
    tifffile.imwrite(
        tmp_path / "long.tif", np.tile(tifffile.imread(INPUTS / "frames.tif"), (40, 1, 1))
    )
    line = f"track {tmp_path / 'long.tif'} {BOX} --quiet --no-look -o {out}"
    # Whoever runs the tests in the background has Ctrl-C ignored.
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "from microlib._command import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *line.split()]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, encoding="utf-8") as process:
        while not out.exists() or out.read_text().count("\n") < 6:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(end)
        told = process.communicate()[1]
    rows = pd.read_csv(out)
    assert 5 <= len(rows) < 1600
    if end == signal.SIGINT:
        assert process.returncode == 130
        assert told == f"microlib track: stopped; {out} keeps the {len(rows)} rows so far\n"


def test_a_part_that_is_lost_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (9, 100, 120)).astype(np.uint8)
    frames[:2] = cv2.GaussianBlur(frames[0], (0, 0), 2)
    tifffile.imwrite(tmp_path / "noise.tif", frames)
    assert status(f"track {tmp_path / 'noise.tif'} {BOX}", tmp_path / "track.csv") == 4
    told = capsys.readouterr().err
    assert "lost in 7 of 9 frames: try another --motion" in told
    assert len(pd.read_csv(tmp_path / "track.csv")) == 9


def test_modulus_holds_the_truth(tmp_path: Path) -> None:
    run("modulus", "outline.csv", MODULUS, tmp_path / "modulus.csv")
    found = quantities(tmp_path / "modulus.csv")
    assert found["modulus_low95_MPa"] < 1.3 < found["modulus_high95_MPa"]
    assert found["dimple_radius"] == pytest.approx(250, abs=3.875)  # a pixel
    assert is_look(tmp_path / "modulus_look.png")


POINTS = pd.read_csv(INPUTS / "outline.csv")
TABLES = {
    "semicolon": (POINTS.to_csv(index=False, sep=";"), ""),
    "decimal comma": (POINTS.to_csv(index=False, sep=";", decimal=","), ""),
    "capitals": (POINTS.rename(columns=str.upper).to_csv(), ""),
    "no names": (POINTS.to_csv(index=False, header=False, sep="\t"), ""),
    "spaces": (POINTS.to_string(index=False, header=False), ""),
    "y down": (POINTS.assign(y=300 - POINTS["y"]).to_csv(index=False), "--y-down"),
    "y down unsaid": (POINTS.assign(y=300 - POINTS["y"]).to_csv(index=False), ""),
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> pd.Series:
    out = tmp_path_factory.mktemp("modulus") / "plain.csv"
    assert status(f"modulus outline.csv {MODULUS}", out) == 0
    return quantities(out)


@pytest.mark.parametrize("name", TABLES)
def test_an_outline_is_read_in_any_form(
    name: str, plain: pd.Series, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, option = TABLES[name]
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    line = f"modulus {tmp_path / 'points.csv'} {MODULUS} {option}"
    assert status(line, tmp_path / "out.csv") == 0
    # The last digits of y change with its origin.
    np.testing.assert_allclose(quantities(tmp_path / "out.csv"), plain, rtol=1e-3)
    assert ("y is taken to run down" in capsys.readouterr().err) == (name == "y down unsaid")


STACK = "depth focal_stack.tif --spacing 25 --pixel-size 1"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("depth focal_stack.tif --spacing 25", "give --pixel-size µm"),
        ("depth focal_stack.tif", "give --spacing µm, --pixel-size µm"),
        ("depth missing.tif --spacing 25 --pixel-size 1", "missing.tif"),
        (
            "depth focal_stack.tif --spacing 0 --pixel-size 1",
            "--spacing must rise or fall strictly",
        ),
        (
            "depth focal_stack.tif --spacing 5kg --pixel-size 1",
            "--spacing: invalid number in µm value: '5kg'",
        ),
        ("depth circles.png --spacing 5 --pixel-size 1", "circles.png must hold three frames"),
        (f"{STACK} --region 0 0 999 5", "--region must"),
        (f"{STACK} --reduce 0", "--reduce must"),
        ("calibrate circles.png --cell 9.9", "give --pitch µm"),
        ("calibrate embryo.png --marks charuco --cell 9.9 --pitch 280", "microlib calibrate: "),
        ("calibrate circles.png --cell -9 --pitch 280", "--cell must be positive"),
        ("track frames.tif --box 0 0 400 40", "microlib track: --box must"),
        (f"track frames.tif {BOX} --rate 0", "--rate must"),
        (f"track frames.tif {BOX} -o t.xlsx", "must be a table that ends in .csv, got t.xlsx"),
        (f"track frames.tif {BOX} --color", "unrecognized arguments: --color"),
        ("modulus outline.csv", "--thickness µm, --probe-half-width µm, --poisson ratio"),
        (f"modulus frames_path.csv {MODULUS}", "columns x and y"),
        (f"modulus missing.csv {MODULUS}", "missing.csv: No such file"),
        (f"modulus outline.csv {MODULUS} --thickness -3", "--thickness must be positive"),
        (f"modulus outline.csv {MODULUS} --poisson 0.7", "--poisson must"),
        (f"modulus outline.csv {MODULUS} --y-down", "leave out --y-down"),
    ],
)
def test_what_cannot_work_is_told_in_one_line(
    line: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = line.split()[0] in ("track", "modulus") and "-o" not in line
    out = tmp_path / ("out.csv" if table else "out")
    if "-o" in line:
        task, source, *options = line.split()
        with pytest.raises(SystemExit, match="2"):
            main([task, str(INPUTS / source), *options])
    else:
        assert status(line, out) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("line", "file"),
    [
        (STACK, "out.csv/look.png"),
        ("calibrate circles.png --pitch 280 --cell 9.9", "out.csv/camera.csv"),
        (f"track frames.tif {BOX}", "out.csv"),
        (f"modulus outline.csv {MODULUS}", "out_look.png"),
    ],
)
def test_what_is_there_is_not_overwritten_unasked(
    line: str, file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / file
    there.parent.mkdir(exist_ok=True)
    there.write_text("mine")
    task, source, *options = line.split()
    command = [task, str(INPUTS / source), *options, "-o", str(tmp_path / "out.csv")]
    begin = time.process_time()
    assert main(command) == 2
    assert time.process_time() - begin < 1  # before the work
    assert f"{there} is there already" in capsys.readouterr().err
    assert there.read_text() == "mine"
    force = "--overwrite" if task == "modulus" else "--force"
    assert main([*command, force]) == 0
    assert there.read_bytes() != b"mine"


def test_a_target_that_cannot_be_written_is_named_as_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    assert status(f"track frames.tif {BOX}", Path("file/track.csv")) == 2
    assert "file/track.csv cannot be written: Not a directory" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "note"),
    [
        (f"modulus outline.csv {MODULUS} --force 10e-6", "--force 1e-05 is unusual"),
        (f"track frames.tif {BOX} --pixel-size 50800", "--pixel-size 50800 is unusual"),
        (f"track frames.tif {BOX} --pixel-size 0.006", "--pixel-size 0.006 is unusual"),
    ],
)
def test_a_scale_in_another_unit_is_noted_last(
    line: str, note: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(line, tmp_path / "out.csv") == 0
    assert note in capsys.readouterr().err


@pytest.mark.parametrize("text", ["10", "10uN", "1e4 nN", "0,01mN", "10e-6N"])
def test_a_number_may_have_its_unit(text: str) -> None:
    assert _quantity("µN")(text) == pytest.approx(10)
    assert _quantity("µm/px")(text.replace("N", "m/px")) == pytest.approx(10)


def test_quiet_prints_nothing_and_a_pipe_no_bar(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(f"track frames.tif {BOX}", tmp_path / "a.csv") == 0
    assert not capsys.readouterr().err
    assert status(f"track frames.tif {BOX} --quiet", tmp_path / "b.csv") == 0
    assert not capsys.readouterr().out


def test_the_force_may_be_uncertain(tmp_path: Path) -> None:
    line = f"modulus outline.csv {MODULUS} --force 150 --force-std 40"
    assert status(line, tmp_path / "out.csv") == 0
    found = quantities(tmp_path / "out.csv")
    assert 0 < found["modulus_low95_MPa"] < found["modulus_MPa"] < found["modulus_high95_MPa"]


@pytest.mark.parametrize("task", ["depth", "calibrate", "track", "modulus"])
def test_help_shows_an_example(task: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main([task, "--help"])
    assert f"Example: microlib {task} " in capsys.readouterr().out


def test_without_opencv_the_command_says_so_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "cv2.py").write_text("raise ModuleNotFoundError('No module', name='cv2')")
    line = f"-m microlib {STACK} -o {tmp_path / 'out'}".split()
    path = {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, *line],
        cwd=INPUTS,
        env=os.environ | path,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "microlib depth: OpenCV 4.10 or newer is needed: pip install opencv-python-headless\n"
    )
