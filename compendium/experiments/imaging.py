"""The price of each choice when images are taken: errors on rendered scenes with known truth.

Each function returns the choices and the error of each by the label of their axis; the other
choices have the usual value meanwhile.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compendium import thesis
from compendium.experiments.chapter_2 import grid_in_view
from compendium.experiments.microscope import open_microscope
from compendium.experiments.section_5_3 import texture_sequence
from microlib.calibration import calibrate
from microlib.embryo import modulus_from_image
from microlib.focus import depth_from_focus
from microlib.membrane import elastic_modulus, modulus_uncertainty
from microlib.microscope import Microscope
from microlib.servoing import servo
from microlib.synthetic import Embryo, embryo_image, focal_stack, mixed_texture
from microlib.tracking import ESMTracker, track_all

MEMBRANE = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}  # µm, µm, no unit
Prices = dict[str, tuple[Sequence[float], list[float]]]


def vary(error: Callable[..., float], **choices: tuple[str, Sequence[float]]) -> Prices:
    """Return the errors of each choice by its label, one argument of `error` after the other."""
    with warnings.catch_warnings(action="ignore"):
        return {
            label: (values, [error(**{name: value}) for value in values])
            for name, (label, values) in choices.items()
        }


def rms(errors: Any) -> float:
    """Return the root mean square of the known errors."""
    return float(np.sqrt(np.nanmean(np.square(errors))))


def of_focus() -> Prices:
    """Return errors of heights, in depths of field: within one the blur stays below 1 px."""

    def error(spacing: float = 0.5, contrast: float = 25.0, slope: float = 0.02) -> float:
        rng = np.random.default_rng(1)
        texture = mixed_texture((96, 128), rng)
        texture = 128 + contrast * (texture - texture.mean()) / texture.std()
        height = slope * np.arange(128) + np.zeros((96, 128))
        positions = np.arange(-1.3, height.max() + 1 + spacing, spacing)
        frames = focal_stack(texture, height, positions, blur_rate=2.0, noise=2.0, rng=rng)
        found = depth_from_focus(frames, positions)
        return rms((found.depth - height)[8:-8, 8:-8])

    return vary(
        error,
        spacing=("spacing (depths of field)", (0.25, 0.5, 1.0, 2.0)),
        contrast=("contrast (grey levels)", (2.0, 8.0, 32.0)),
        slope=("slope (depths of field per px)", (0.01, 0.05, 0.2)),
    )


def of_calibration() -> Prices:
    """Return stated standard errors of the focal length, percent, from points of a tilted grid."""
    t_op, f = (thesis.table_5_1("circle-1X", name) for name in ("T_op", "f"))
    sensor: dict[str, Any] = {"pixel_pitch": 9.9, "image_size": (656, 491)}
    flat = Microscope(t_op, f, 79374.6, tx=-1900.0, ty=-1400.0, **sensor)

    def error(views: int = 4, tilt: float = 20.0, noise: float = 0.05) -> float:
        rng = np.random.default_rng(1)
        angle = np.deg2rad(tilt)
        scopes = [
            replace(flat, alpha=2.4 * view, beta=0.8 * angle, gamma=0.6 * angle)
            for view in range(views)
        ]
        worlds = [grid_in_view(scope, pitch=560.0) for scope in scopes]
        images = [
            s.project(w) + rng.normal(0, noise, w.shape)
            for s, w in zip(scopes, worlds, strict=True)
        ]
        fit = calibrate(worlds, images, **sensor)
        return 100 * fit.parameters["focal_length"].uncertainty / flat.focal_length

    return vary(
        error,
        views=("number (views)", (1, 2, 4, 7)),
        tilt=("tilt (°)", (3.0, 8.0, 25.0)),
        noise=("error of a point (px)", (0.01, 0.05, 0.3)),
    )


def of_tracking() -> Prices:
    """Return errors of a position, px, of a square that moves over another texture."""

    def error(side: int = 40, noise: float = 2.0, move: float = 2.3) -> float:
        corners = np.array([10.0, 10.0]) + move * np.arange(10)[:, None] * (1.0, 0.3)
        frames = texture_sequence(corners, np.random.default_rng(2), size=side, noise=noise)
        track = track_all(frames, (10, 10, side, side), "translation")
        return rms(track[["center_x", "center_y"]] - (corners + (side - 1) / 2))

    return vary(
        error,
        side=("side of the box (px)", (16, 32, 80)),
        noise=("noise (grey levels)", (1.0, 4.0, 16.0)),
        move=("motion (px/frame)", (0.7, 4.6, 30.3)),
    )


def of_embryo() -> Prices:
    """Return stated standard errors of the modulus by (5.2), percent, in images of an embryo."""

    def error(pixel_size: float = 6.0, blur: float = 1.0, depth: float = 90.0) -> float:
        embryo = Embryo.dented(depth, modulus=1.3, **MEMBRANE)
        shape = (round(2976 / pixel_size), round(3968 / pixel_size))
        scene = embryo_image(embryo, rng=1, pixel_size=pixel_size, shape=shape, blur=blur)
        known: dict[str, Any] = {"pixel_size": pixel_size, **MEMBRANE}
        modulus = modulus_from_image(scene.image, embryo.force, **known).modulus
        return 100 * modulus.uncertainty / modulus.value

    return vary(
        error,
        pixel_size=("pixel size (µm/px)", (4.0, 6.0, 9.0)),
        blur=("blur (px)", (0.5, 1.0, 1.5)),
        depth=("depth of the dimple (µm)", (60.0, 120.0)),
    )


def of_modulus() -> Prices:
    """Return standard errors of the modulus by (5.2), percent, of a dimple of 250 µm radius."""

    def error(depth: float = 50.0, length: float = 2.0, force: float = 2.0) -> float:
        values = {"force": 10.0, "rim_radius": 250.0, "dimple_depth": depth} | MEMBRANE
        errors = {"force": force / 10, "rim_radius": length, "dimple_depth": length}
        return 100 * float(modulus_uncertainty(values, errors) / elastic_modulus(**values))

    return vary(
        error,
        depth=("depth of the dimple (µm)", (20.0, 50.0, 120.0)),
        length=("error of a length (µm)", (0.5, 1.0, 3.0)),
        force=("error of the force (%)", (1.0, 5.0, 25.0)),
    )


def of_servoing() -> Prices:
    """Return the number of frames until the simulation reaches its targets."""

    def frames(test: float = 50.0, longest: float = 150.0, tolerance: float = 0.05) -> float:
        scope, _ = open_microscope("")
        tracker = ESMTracker(scope.camera.snap()[0], (135, 95, 50, 50), "translation")
        targets = np.add([159.5, 119.5], [[40.0, -30.0], [-35.0, -25.0], [0.0, 0.0]])
        limits: dict[str, Any] = {"test_move": test, "longest_move": longest}
        return len(servo(scope, tracker, targets, travel=400.0, tolerance=tolerance, **limits).log)

    return vary(
        frames,
        test=("test move (µm)", (2.0, 10.0, 50.0)),
        longest=("longest move (µm)", (50.0, 75.0, 150.0)),
        tolerance=("tolerance (px)", (0.02, 0.1, 0.5)),
    )
