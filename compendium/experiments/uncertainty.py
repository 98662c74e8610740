"""Errors beside stated uncertainties, on scenes that other code renders."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage
from scipy.stats import norm
from skimage import data

from compendium.experiments.rendering import blended, disc_blur, expose
from microlib import synthetic
from microlib.calibration import calibrate
from microlib.embryo import modulus_from_image
from microlib.focus import depth_from_focus
from microlib.membrane import indent_capsule
from microlib.microscope import euler_rotation
from microlib.tracking import ESMTracker

#: Levels of the intervals in a reliability diagram.
LEVELS = np.array([0.5, 0.6827, 0.8, 0.9, 0.95, 0.99])
#: Side of a rendered frame and border that is left out, px; number of frames, one spacing apart.
SIDE, BORDER, COUNT = 160, 16, 21
#: Photographs that come with scikit-image.
PHOTOGRAPHS = ("camera", "coins", "moon", "brick", "grass", "gravel")


def coverage(error: NDArray, std: NDArray) -> pd.Series:
    """Return the share of errors within the interval of each level of a normal distribution."""
    with np.errstate(invalid="ignore"):
        score = np.abs(np.asarray(error) / np.asarray(std)).ravel()
    score = score[np.isfinite(score)]
    shares = [float(np.mean(score <= limit)) for limit in norm.ppf((1 + LEVELS) / 2)]
    return pd.Series(shares, pd.Index(LEVELS, name="level of the interval"))


# --- Heights -------------------------------------------------------------------------------------


def focal_stacks(seed: int) -> Iterator[tuple[str, NDArray, NDArray]]:
    """Yield name, true height in frame spacings and stack; the blur is that of a uniform disc."""
    rng = np.random.default_rng(seed)
    texture = synthetic.mixed_texture((SIDE, SIDE), rng).astype(np.float32)
    y, x = np.indices((SIDE, SIDE)) / SIDE - 0.5
    slope = 10.2 + 8 * x + 2 * y
    positions = np.arange(float(COUNT))
    radii = np.arange(0.0, 32.0, 0.5)
    ladder = np.stack([disc_blur(texture, radius) for radius in radii])
    defocus = (2 * np.abs(slope - position) for position in positions)
    frames = [expose(blended(ladder, radii, radius), rng) for radius in defocus]
    yield "slope", slope, np.stack(frames)
    codes = [cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 80])[1] for frame in frames]
    coded = np.stack([np.asarray(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE)) for code in codes])
    yield "slope, JPEG", slope, coded
    # A focus ring: blur grows as |1/a − 1/b|, faster on the near side.
    blurs = [12 * abs(1 / (6 + k) - 1 / 16.3) * 16 for k in positions]
    ring = np.stack([expose(disc_blur(texture, blur), rng) for blur in blurs])
    yield "focus ring", np.full((SIDE, SIDE), 10.3), ring
    near = x + 0.13 * y > 0.05
    step = []
    for position in positions:
        cover = disc_blur(near.astype(np.float32), 2 * abs(14.4 - position))
        layer = disc_blur(texture * near, 2 * abs(14.4 - position))
        step.append(expose(layer + disc_blur(texture, 2 * abs(6.7 - position)) * (1 - cover), rng))
    yield "step", np.where(near, 14.4, 6.7), np.stack(step)


def heights(seed: int, **options: Any) -> dict[str, tuple[NDArray, NDArray]]:
    """Return error and stated standard deviation of the heights of each scene, in spacings."""
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    found = {}
    for name, truth, stack in focal_stacks(seed):
        result = depth_from_focus(stack, spacing=1.0, **options)
        found[name] = (result.depth - truth)[inner], result.uncertainty[inner]
    return found


# --- Calibrations --------------------------------------------------------------------------------


def focal_lengths(seed: int, runs: int) -> tuple[NDArray, NDArray]:
    """Return error and stated standard deviation (µm) of f from four views, by OpenCV's camera."""
    rng = np.random.default_rng(seed)
    world = 280.0 * np.stack(np.meshgrid(np.arange(11.0), np.arange(8.0)), -1).reshape(-1, 2)
    world -= world.mean(axis=0)
    camera = np.array([[900, 0, 319.5], [0, 900, 239.5], [0, 0, 1]])
    rows = []
    for _ in range(runs):
        images = []
        for _ in range(4):
            angle = rng.uniform(0, 2 * np.pi)
            turn = euler_rotation(0.3, 0.35 * np.cos(angle), 0.35 * np.sin(angle))
            place = np.array([0.0, 0.0, 280 * 900 / 40])
            lens = np.array([-0.05, 0.0, 0.0, 0.0])
            flat = np.column_stack([world, np.zeros(len(world))])
            seen, _ = cv2.projectPoints(flat, cv2.Rodrigues(turn)[0], place, camera, lens)
            images.append(seen[:, 0] + rng.normal(0, 0.05, world.shape))
        found = calibrate([world] * 4, images, pixel_pitch=8.0, image_size=(640, 480))
        focal = found.parameters["focal_length"]
        truth = 900 * 8 / (1 + found.microscope.magnification)
        rows.append((focal.value - truth, focal.uncertainty))
    error, std = np.transpose(rows)
    return error, std


# --- Positions -----------------------------------------------------------------------------------


def positions(seed: int, pairs: int, *, hidden: float = 0.0) -> tuple[NDArray, NDArray]:
    """Return error and stated standard deviation of the tracked centers of patches of photographs.

    Each patch of 50 px moves by up to 5 px and a fraction. Splines of the fifth order move it, and
    the second frame has another gain. A share of the patch may be hidden by another photograph.
    """
    rng = np.random.default_rng(seed)
    pictures = [getattr(data, name)().astype(float) for name in PHOTOGRAPHS]
    errors, stds = [], []
    for _ in range(pairs):
        k, other = rng.choice(len(pictures), 2, replace=False)
        y, x = (int(rng.integers(0, n - 130)) for n in pictures[k].shape)
        part = pictures[k][y : y + 130, x : x + 130]
        move = rng.uniform(-5, 5, 2)
        second = 0.9 * ndimage.shift(part, move[::-1], order=5, mode="mirror")
        side = round(50 * np.sqrt(hidden))
        second[40 : 40 + side, 40 : 40 + side] = pictures[other][:side, :side]
        tracker = ESMTracker(expose(part, rng), (40, 40, 50, 50), "translation")
        track = tracker.track(expose(second, rng))
        if not track.lost:
            errors.append(track.center - 64.5 - move)
            stds.append(np.sqrt(np.diag(track.covariance)))
    return np.array(errors), np.array(stds)


# --- Moduli --------------------------------------------------------------------------------------


def moduli(seed: int, count: int) -> dict[str, tuple[NDArray, NDArray]]:
    """Measure images with the flat model (5.2); return errors and stated std of the logarithm of E.

    Half of the images show outlines that follow (4.2), as the flat model assumes; the library draws
    them. The others show closed capsules, which are drawn as polygons.
    """
    rng = np.random.default_rng(seed)
    walls: Any = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    rows: dict[str, list[tuple[float, float]]] = {"follows (4.2)": [], "closed capsule": []}
    while min(map(len, rows.values())) < count:
        modulus, force, radius = rng.uniform([0.6, 60, 550], [1.8, 180, 650])
        egg: Any = {"modulus": modulus, "capsule_radius": radius}
        egg |= {"inflation": rng.uniform(1.01, 1.08)}
        try:
            state = indent_capsule(force, **egg, **walls)
        except ValueError:  # no dimple at this force
            continue
        if not 40 < state.depth < 110:
            continue
        depth, rim = rng.uniform([40, 350], [150, 600])
        flat = synthetic.Embryo.dented(depth, modulus=modulus, rim_curvature_radius=rim)
        scene = synthetic.embryo_image(flat, rng=rng)
        for name, image, load, pixel in (
            ("follows (4.2)", scene.image, flat.force, scene.pixel_size),
            ("closed capsule", draw_capsule(state, rng), force, 2.0),
        ):
            found = modulus_from_image(image, load, pixel_size=pixel, **walls)
            found_modulus = found.modulus
            relative = found_modulus.uncertainty / found_modulus.value
            rows[name].append((np.log(found_modulus.value / modulus), relative))
    return {name: tuple(np.transpose(pairs)) for name, pairs in rows.items()}


def draw_capsule(state: Any, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw a dark capsule under a darker probe on a bright ground; a pixel is 2 µm."""
    fine = 4  # samples of a pixel's side
    half = np.stack([state.r, state.z], axis=1)
    outline = np.concatenate([half[::-1] * [-1, 1], half]) / 2.0
    floor, tip = 760.0 + outline[:, 1].min(), float(state.z[0]) / 2
    probe = np.array([[-12.5, tip], [12.5, tip], [12.5, 1500.0], [-12.5, 1500.0]])
    picture: NDArray = np.full((fine * 800, fine * 800), 200.0, np.float32)
    for polygon, grey in ((outline, 120.0), (probe, 40.0)):
        place = fine * 16 * (polygon * [1, -1] + [400.0, floor])
        cv2.fillPoly(picture, [np.rint(place).astype(np.int32)], grey, cv2.LINE_AA, 4)
    picture = cv2.GaussianBlur(picture, (0, 0), 1.2 * fine)
    return expose(cv2.resize(picture, (800, 800), interpolation=cv2.INTER_AREA), rng)
