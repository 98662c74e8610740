"""Images that others took, with checks that need no truth: planes, halves, other programs."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from microlib.calibration import Calibration, calibrate, detect_circles, detect_squares
from microlib.focus import depth_from_focus
from microlib.io import read_frames, read_grey
from microlib.tracking import track_all

FOLDER = Path(__file__).resolve().parents[1] / "data" / "real"
BOARD, CHESSBOARD, BEADS = (FOLDER / name for name in ("board", "chessboard", "beads"))
#: Middles of three beads in the first frame, px.
MIDDLES = ((200, 24), (345, 114), (25, 290))


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


def test_depth_of_bare_board_is_planar():
    """Left of the heat sink and right of it lies one board; small parts on it are outliers."""
    depth = depth_from_focus(str(BOARD), spacing=1.0, register=True, reduce=2).depth
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    bare = np.isfinite(depth) & ((x < 100) | (x > 365)) & (y > 10) & (y < 260)
    terms = np.stack([np.ones(bare.sum()), x[bare], y[bare]], axis=1)
    value, near = depth[bare], np.ones(bare.sum(), bool)
    for _ in range(5):
        plane = np.linalg.lstsq(terms[near], value[near], rcond=None)[0]
        near = np.abs(value - terms @ plane) < 1
    assert near.mean() > 0.95  # the parts cover 3 % of it
    # The floor between two fins of the heat sink, and one fin: both parallel to the board.
    floor, fin = (np.nanmedian(depth[50:220, part]) for part in (slice(133, 150), slice(159, 164)))
    assert 2 < floor - plane @ (1, 141, 135) < fin - plane @ (1, 161, 135) - 3


@pytest.fixture(scope="module")
def corners():
    photographs = sorted(CHESSBOARD.glob("*.jpg"))
    return [detect_squares(read_grey(path), pattern="chessboard") for path in photographs]


def principal_distance(found: Calibration) -> float:
    """Return what OpenCV calls the focal length, px, of cells of 1 µm."""
    return found.microscope.tube_length + found.microscope.focal_length


def test_calibration_of_ten_chessboards_agrees_with_opencv(corners):
    assert all(len(found.points) == 54 for found in corners)
    ours = calibrate(corners, pitch=1.0, pixel_size=1.0)
    world = [np.c_[found.grid, 0 * found.grid[:, :1]].astype(np.float32) for found in corners]
    seen = [found.points.astype(np.float32) for found in corners]
    rms, matrix, *_ = cv2.calibrateCamera(world, seen, (640, 480), None, None)
    assert ours.to_dict()["reprojection_rms"] < 1.2 * rms  # it has three more terms of distortion
    np.testing.assert_allclose(principal_distance(ours), matrix[0, 0], rtol=0.01)


def test_beads_are_tracked_through_all_frames():
    """A displacement grows as diffusion has it: alike along both axes, and with the time."""
    frames = list(read_frames(str(BEADS)))
    tracks = [track_all(frames, (x - 16, y - 16, 33, 33)) for x, y in MIDDLES]
    assert not any(track["lost"].any() for track in tracks)
    path = np.stack([track[["center_x", "center_y"]] for track in tracks])
    one, four = (((path[:, n:] - path[:, :-n]) ** 2).mean(axis=(0, 1)) for n in (1, 4))
    # 147 steps an axis: a variance to 12 %, the ratio of two to 16 %; of four steps of both, too.
    assert abs(np.log(one[0] / one[1])) < 3 * 0.16
    assert abs(np.log(four.sum() / one.sum() / 4)) < 3 * 0.16


def test_photograph_without_pattern_is_refused():
    bead, board = (read_grey(next(folder.glob("*.*p*"))) for folder in (BEADS, BOARD))
    for image in (bead, board[:300, :400]):
        for detect in (detect_circles, detect_squares):
            with pytest.raises(ValueError, match="image"):
                detect(image)
