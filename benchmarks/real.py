"""microlib beside OpenCV and scikit-image on photographs and films by others (``data/real``).

Run as ``python -m benchmarks real``; takes some minutes. No true values are known.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, laplace
from skimage.feature import corner_subpix
from skimage.filters import sobel
from skimage.measure import centroid
from skimage.registration import phase_cross_correlation

from benchmarks.report import Limits, Tables
from microlib.calibration import detect_squares
from microlib.focus import depth_from_focus
from microlib.io import read_frames, read_grey
from microlib.tracking import track_all

REAL = Path(__file__).resolve().parents[1] / "data" / "real"
TOOLS = ["microlib", "OpenCV", "scikit-image", "SML"]
#: Middles of the five beads in the first frame, px.
MIDDLES = ((200, 24), (242, 128), (345, 114), (25, 290), (226, 364))


# --- A circuit board -----------------------------------------------------------------------------


def depths(frames: NDArray, step: float) -> dict[str, NDArray]:
    """Return the depth by each tool, frames; the peers take the sharpest frame, after alignment."""
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
    options = {"spacing": step, "register": True}
    return {
        "microlib": depth_from_focus(frames, **options).depth,
        "OpenCV": step * np.argmax(sharp, axis=0),
        "scikit-image": step * np.argmax(edges, axis=0),
        "SML": depth_from_focus(frames, **options, measure="sml", window=5).depth,
    }


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


def board() -> dict[str, dict[str, float]]:
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
            name: flatness(each) for name, each in whole.items()
        },
        f"board in grey: {halves}": {name: apart(odd[name], even[name]) for name in odd},
    }


# --- A chessboard --------------------------------------------------------------------------------


def chessboard() -> dict[str, dict[str, float]]:
    photographs = [read_grey(path) for path in sorted((REAL / "chessboard").glob("*.jpg"))]
    found = [detect_squares(each, pattern="chessboard") for each in photographs]
    world = [np.c_[each.grid, 0 * each.grid[:, :1]].astype(np.float32) for each in found]
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
    rms = {k: cv2.calibrateCamera(world, v, (640, 480), None, None)[0] for k, v in corners.items()}
    return {"chessboard: corners beside one camera of OpenCV's model, rms (px)": rms}


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
    move = cv2.findTransformECC(first, image, warp, cv2.MOTION_TRANSLATION, end, None, 1)[1]
    return np.asarray(move[:, 2])


def beads() -> dict[str, dict[str, float]]:
    film = list(read_frames(str(REAL / "beads")))
    paths: dict[str, list[list[NDArray]]] = {}
    for x, y in MIDDLES:
        track = track_all(film, (x - 16, y - 16, 33, 33), "translation")
        ours = track[["center_x", "center_y"]].to_numpy()
        template = cut(film[0], np.array([x, y]), 16)[0]
        ways: dict[str, list[NDArray]] = {name: [] for name in TOOLS[:3]}
        ways["microlib"] += list(ours)
        for frame, place in zip(film, ours, strict=True):
            part, corner = cut(frame, place, (len(template) - 1) // 2)
            same = part.shape == template.shape
            move = registered(template, part) if same else np.full(2, np.nan)
            ways["OpenCV"].append(corner + move)
            disc, corner = cut(frame, place, 14)
            weight = np.abs(disc - np.median(frame))
            ways["scikit-image"].append(corner + centroid(weight)[::-1])
        for name, way in ways.items():
            paths.setdefault(name, []).append(way)
    every = {name: np.array(way) for name, way in paths.items()}
    centered = {k: p - np.nanmean(p, axis=1, keepdims=True) for k, p in every.items()}
    apart = {
        frozenset(pair): float(np.sqrt(np.nanmean((centered[pair[0]] - centered[pair[1]]) ** 2)))
        for pair in combinations(centered, 2)
    }
    return {
        "beads: path beside microlib's, rms (px)": {
            name: apart.get(frozenset(("microlib", name)), np.nan) for name in centered
        },
        "beads: path beside the nearer of the other two, rms (px)": {
            name: min(off for pair, off in apart.items() if name in pair) for name in centered
        },
    }


NOTE = """\
The photographs and films are from public sources (`data/real/README.md`), and their true values
are not known. The photographs of the board are binned by 2 × 2 px. microlib accepts color and grey
images.

- *Board*: OpenCV aligns the photographs by `findTransformECC` (affine), and scikit-image by
  `phase_cross_correlation` (shifts only, although the scale changes). Their height at each pixel
  is the frame with the largest Laplacian or Sobel edge, averaged with σ = 3 px. *SML* is the
  sum-modified-Laplacian of the thesis in microlib, with windows of 5 px. The maps from the odd and
  the even photographs count as different from 2 frames on, so that rounding to whole frames is not
  counted as an error.
- *Chessboard*: microlib finds the corners as saddle points. OpenCV's `cornerSubPix` and
  scikit-image's `corner_subpix`, with windows of 11 px, start from the same corners, rounded to
  pixels.
- *Beads*: OpenCV registers the first picture of a bead by `findTransformECC`. scikit-image
  computes the `centroid` of the pixels that differ from the background. The mean of each path is
  subtracted.
"""


def main() -> tuple[Tables, Limits]:
    lines = board() | chessboard() | beads()
    table = pd.DataFrame(lines).T.reindex(columns=TOOLS).astype(float).round(3)
    table.insert(0, "data and question", table.index)
    return {"Real images": table.reset_index(drop=True)}, []
