"""microlib beside OpenCV and scikit-image on photographs and films by others.

Run as ``python -m benchmarks real``; takes some minutes. No true values are known. Besides those in
``data/real``, it measures data that no method was developed on, if `FOLDER_VARIABLE` names a folder
that holds the folders of ``held_out.toml``; they are not part of this project.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, laplace
from skimage.feature import corner_subpix, peak_local_max
from skimage.filters import sobel
from skimage.measure import centroid
from skimage.registration import phase_cross_correlation

from benchmarks.boards import opencv_corners, our_corners
from benchmarks.report import Limits, Tables
from microlib.calibration import detect_squares
from microlib.focus import depth_from_focus
from microlib.io import read_frames, read_grey
from microlib.tracking import track_all

REAL = Path(__file__).resolve().parents[1] / "data" / "real"
FOLDER_VARIABLE = "MICROLIB_HELD_OUT"
HELD_OUT = Path(__file__).with_name("held_out.toml")
TOOLS = ["microlib", "OpenCV", "scikit-image", "SML"]
#: Middles of the five beads in the first frame, px.
MIDDLES = np.array(((200, 24), (242, 128), (345, 114), (25, 290), (226, 364)))
ERROR_ROW = "corners beside one camera of OpenCV's model, rms (px)"
#: What is measured, and the number by each tool.
Rows = dict[str, dict[str, float]]


# --- Focal stacks --------------------------------------------------------------------------------


def depths(frames: NDArray, step: float) -> dict[str, tuple[NDArray, NDArray]]:
    """Return depth in frames and where it is certain; the peers take the sharpest frame, aligned.

    A depth is certain if its stated standard deviation is below a fifth of the scan.
    """
    middle = frames[len(frames) // 2]
    turned, moved = [], []
    for frame in frames:
        warp = np.eye(2, 3, dtype=np.float32)
        end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
        _, warp = cv2.findTransformECC(middle, frame, warp, cv2.MOTION_AFFINE, end, None, 5)
        size = middle.shape[::-1]
        turned.append(cv2.warpAffine(frame, warp, size, flags=cv2.INTER_LINEAR | 16))
        shift = phase_cross_correlation(middle, frame, upsample_factor=10)[0]
        moved.append(cv2.warpAffine(frame, np.float32([[1, 0, shift[1]], [0, 1, shift[0]]]), size))
    sharp = [gaussian_filter(np.abs(laplace(f.astype(np.float32))), 3) for f in turned]
    edges = [gaussian_filter(sobel(f.astype(np.float32)), 3) for f in moved]
    found = {
        name: (step * np.argmax(measure, axis=0), np.ones(middle.shape, bool))
        for name, measure in (("OpenCV", sharp), ("scikit-image", edges))
    }
    options = {"spacing": step, "register": True}
    for name, measure in (("microlib", {}), ("SML", {"measure": "sml", "window": 5})):
        result = depth_from_focus(frames, **options, **measure)
        found[name] = result.depth, result.uncertainty < step * (len(frames) - 1) / 5
    return found


def flatness(height: NDArray) -> float:
    """Return the share of the bare board within one frame of a plane, %; what is unknown is not."""
    y, x = np.mgrid[: height.shape[0], : height.shape[1]]
    bare = ((x < 100) | (x > 365)) & (y > 10) & (y < 260)
    terms = np.stack([np.ones(bare.sum()), x[bare], y[bare]], axis=1)
    near = np.isfinite(height[bare])
    for _ in range(5):
        plane = np.linalg.lstsq(terms[near], height[bare][near], rcond=None)[0]
        near = np.abs(height[bare] - terms @ plane) < 1
    return 100 * float(near.mean())


def apart(odd: NDArray, even: NDArray) -> float:
    """Return the share of pixels that are more than two frames apart or unknown, %."""
    return 100 * float(1 - (np.abs(odd - (even + 1)) < 2).mean())  # from frames 0 and 1


def board() -> Rows:
    grey, color = (
        np.stack(list(read_frames(str(REAL / "board"), reduce=2, color=kind)))
        for kind in (False, True)
    )
    whole, odd, even = depths(grey, 1), depths(grey[::2], 2), depths(grey[1::2], 2)
    both = [depth_from_focus(color[k::2], spacing=2, register=True).depth for k in (0, 1)]
    found = depth_from_focus(color, spacing=1, register=True).depth
    halves = "odd and even photographs more than 2 frames apart or unknown (%)"
    return {
        "board in color: bare board within one frame of a plane (%)": {"microlib": flatness(found)},
        f"board in color: {halves}": {"microlib": apart(*both)},
        "board in grey: bare board within one frame of a plane (%)": {
            name: flatness(each) for name, (each, _) in whole.items()
        },
        f"board in grey: {halves}": {name: apart(odd[name][0], even[name][0]) for name in odd},
    }


def background(folder: Path, *, reduce: int, rows: float, columns: float) -> Rows:
    """Return how many pixels of a background, above or right of shares of the frame, are sure."""
    frames = np.stack(list(read_frames(str(folder), reduce=reduce)))
    y, x = np.indices(frames[0].shape) / np.reshape(frames[0].shape, (2, 1, 1))
    bare = (y < rows) & (x > columns)
    shares = {name: 100 * sure[bare].mean() for name, (_, sure) in depths(frames, 1).items()}
    return {f"{folder.name}: background with a depth that is certain (%)": shares}


# --- Chessboards ---------------------------------------------------------------------------------


def chessboard() -> Rows:
    photographs = [read_grey(path) for path in sorted((REAL / "chessboard").glob("*.jpg"))]
    found = [detect_squares(each, pattern="chessboard") for each in photographs]
    rough = [each.points.astype(np.float32).round() for each in found]
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    corners = {"microlib": [each.points.astype(np.float32) for each in found]}
    corners["OpenCV"] = [
        cv2.cornerSubPix(image, points[:, None].copy(), (5, 5), (-1, -1), end)[:, 0]
        for image, points in zip(photographs, rough, strict=True)
    ]
    refined = [
        corner_subpix(image, points[:, ::-1].astype(int), window_size=11)[:, ::-1]
        for image, points in zip(photographs, rough, strict=True)
    ]
    # Where scikit-image finds no corner, the pixel stays.
    corners["scikit-image"] = [
        np.where(np.isfinite(one), one, other).astype(np.float32)
        for one, other in zip(refined, rough, strict=True)
    ]
    grids = [each.grid for each in found]
    rms = {name: camera_error(each, grids, (640, 480)) for name, each in corners.items()}
    return {f"chessboard: {ERROR_ROW}": rms}


def camera_error(corners: list, grids: list, size: tuple[int, int], flags: int = 0) -> float:
    """Return how far corners are from where one camera sees their grids, rms (px)."""
    world = [np.c_[grid, 0 * grid[:, :1]].astype(np.float32) for grid in grids]
    return cv2.calibrateCamera(world, corners, size, None, None, flags=flags)[0]


def photographs(folder: Path, *, scale: float) -> Rows:
    """Return how many photographs show a board to each detector, its corners, and their error."""
    images = [read_grey(path) for path in sorted(folder.iterdir())]
    images = [cv2.resize(each, None, fx=scale, fy=scale, interpolation=3) for each in images]
    rows: Rows = {}
    for tool, detect in (("microlib", our_corners), ("OpenCV", opencv_corners)):
        found = []
        for image in images:
            try:
                found.append(detect(image))
            except ValueError:
                continue
        corners = [points.astype(np.float32) for points, _ in found]
        size, model = images[0].shape[::-1], cv2.CALIB_RATIONAL_MODEL
        for what, number in (
            (f"a board found, of {len(images)} photographs", len(found)),
            ("corners of a board, median", np.median([len(points) for points in corners])),
            (ERROR_ROW, camera_error(corners, [grid for _, grid in found], size, model)),
        ):
            rows.setdefault(f"{folder.name}: {what}", {})[tool] = float(number)
    return rows


# --- Beads ---------------------------------------------------------------------------------------


def cut(image: NDArray, place: NDArray, half: int) -> tuple[NDArray, NDArray]:
    """Return a square about a place and its first pixel, (x, y)."""
    x, y = (np.rint(place) - half).astype(int)
    x, y = max(x, 0), max(y, 0)
    return image[y : y + 2 * half + 1, x : x + 2 * half + 1], np.array([x, y])


def registered(first: NDArray, image: NDArray) -> NDArray:
    """Return how far OpenCV moves the first picture of a bead, (x, y) px."""
    warp = np.eye(2, 3, dtype=np.float32)
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
    try:
        warp = cv2.findTransformECC(first, image, warp, cv2.MOTION_TRANSLATION, end, None, 1)[1]
    except cv2.error:
        return np.full(2, np.nan)
    return np.asarray(warp[:, 2])


def beads(name: str, film: list[NDArray], middles: NDArray, half: int) -> Rows:
    paths: dict[str, list[list[NDArray]]] = {}
    for x, y in middles:
        track = track_all(film, (x - half, y - half, 2 * half + 1, 2 * half + 1), "translation")
        ours = track[["center_x", "center_y"]].to_numpy()
        template = cut(film[0], np.array([x, y]), half)[0]
        ways: dict[str, list[NDArray]] = {name: [] for name in TOOLS[:3]}
        ways["microlib"] += list(ours)
        for frame, place in zip(film, ours, strict=True):
            if not np.isfinite(place).all():
                ways["OpenCV"].append(place)
                ways["scikit-image"].append(place)
                continue
            part, corner = cut(frame, place, half)
            same = part.shape == template.shape
            move = registered(template, part) if same else np.full(2, np.nan)
            ways["OpenCV"].append(corner + move)
            disc, corner = cut(frame, place, half - 2)
            weight = np.abs(disc - np.median(frame))
            ways["scikit-image"].append(corner + centroid(weight)[::-1])
        for tool, way in ways.items():
            paths.setdefault(tool, []).append(way)
    every = {tool: np.array(way) for tool, way in paths.items()}
    centered = {k: p - np.nanmean(p, axis=1, keepdims=True) for k, p in every.items()}
    off = {
        frozenset(pair): float(np.sqrt(np.nanmean((centered[pair[0]] - centered[pair[1]]) ** 2)))
        for pair in combinations(centered, 2)
    }
    lost = 100 * float(np.isnan(every["microlib"]).any(axis=2).mean())
    return {
        f"{name}: lost (%)": {"microlib": lost},
        f"{name}: path beside microlib's, rms (px)": {
            tool: off.get(frozenset(("microlib", tool)), np.nan) for tool in centered
        },
        f"{name}: path beside the nearer of the other two, rms (px)": {
            tool: min(rms for pair, rms in off.items() if tool in pair) for tool in centered
        },
    }


def particles(folder: Path, *, count: int, frames: int) -> Rows:
    """Follow the dark particles of the first frame that are alone and clearest."""
    film = [frame for frame, _ in zip(read_frames(str(folder)), range(frames), strict=False)]
    dark = -gaussian_filter(film[0].astype(float), 1.5)
    places = peak_local_max(dark, min_distance=20, exclude_border=30, num_peaks=count)
    return beads(folder.name, film, places[:, ::-1], 8)


# --- Data that no method was developed on --------------------------------------------------------


MEASURES = {measure.__name__: measure for measure in (background, photographs, particles)}


def hash_of(folder: Path) -> str:
    """Return the SHA-256 of the contents of a folder's files, by name."""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def held_out() -> tuple[Rows, pd.DataFrame]:
    """Measure what is there of `HELD_OUT`; the table says what is, and what is missing."""
    top, rows, sources = os.environ.get(FOLDER_VARIABLE, ""), {}, []
    for name, entry in tomllib.loads(HELD_OUT.read_text(encoding="utf-8")).items():
        folder = Path(top) / name
        state = f"missing: set {FOLDER_VARIABLE} to the folder that holds it"
        if top and folder.is_dir():
            same = hash_of(folder) == entry["sha256"]
            state = "measured" if same else "not measured: its files are others"
            if same:
                rows |= MEASURES[entry["measure"]](folder, **entry["options"])
        described = {key: entry[key] for key in ("what", "source", "licence", "sha256")}
        sources.append({"folder": name} | described | {"state": state})
    return rows, pd.DataFrame(sources)


NOTE = """\
The photographs and films are from public sources (`data/real/README.md`, and the second table),
and their true values are not known. The photographs of the board are binned by 2 × 2 px. microlib
accepts color and grey images.

- *Board*: OpenCV aligns the photographs by `findTransformECC` (affine), and scikit-image by
  `phase_cross_correlation` (shifts only, although the scale changes). Their height at each pixel
  is the frame with the largest Laplacian or Sobel edge, averaged with σ = 3 px. *SML* is the
  sum-modified-Laplacian of the thesis in microlib, with windows of 5 px. The maps from the odd and
  the even photographs count as different from 2 frames on, so that rounding to whole frames is not
  counted as an error.
- *Background*: nothing in it has texture, so no depth is right. A depth is certain if its stated
  standard deviation is below a fifth of the scan. OpenCV and scikit-image state none.
- *Chessboard*: microlib finds the corners as saddle points. OpenCV's `cornerSubPix` and
  scikit-image's `corner_subpix`, with windows of 11 px, start from the same corners, rounded to
  pixels. In the photographs that were held out, OpenCV is `findChessboardCornersSB` for a board of
  unknown size. A wrong lattice shows as a large error beside one camera.
- *Beads* and *water*: OpenCV registers the first picture of a bead by `findTransformECC`.
  scikit-image computes the `centroid` of the pixels that differ from the background. The mean of
  each path is subtracted.
"""


def main() -> tuple[Tables, Limits]:
    film = list(read_frames(str(REAL / "beads")))
    found, sources = held_out()
    lines = board() | chessboard() | beads("beads", film, MIDDLES, 16) | found
    table = pd.DataFrame(lines).T.reindex(columns=TOOLS).astype(float).round(3)
    table.insert(0, "data and question", table.index)
    return {"Real images": table.reset_index(drop=True), "Data held out": sources}, []
