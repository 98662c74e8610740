"""Hostile values for every public callable: what may come back is a result or a `ValueError`.

One rule for every wrong value, a wrong kind such as None included: a `ValueError` whose message
names an argument. No other exception, no warning but the documented ones, no changed input, nothing
non-finite from finite values unless it is documented, and no call over its time.

    python -m tests.fuzz [name …]    # all of it, or the callables whose name contains a word

Values are put in the place of one argument of a valid call, or of two at once, which are drawn,
also from what other calls give to such an argument. Sequences of calls are in
`tests/test_sequences.py`.
"""

from __future__ import annotations

import atexit
import contextlib
import copy
import faulthandler
import importlib
import importlib.util
import inspect
import pkgutil
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import types
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from itertools import zip_longest
from pathlib import Path

import cv2
import numpy as np

import microlib
from microlib import (
    automation,
    calibration,
    curvature,
    embryo,
    focus,
    io,
    membrane,
    microscope,
    optics,
    servoing,
    synthetic,
    tracking,
)

#: Processor time for one call, s: waiting for other processes does not count.
LIMIT = 5.0
#: The same for what fits a boundary value problem to an outline, tried by `make fuzz` only.
SLOW = {"membrane.fit_capsule": 60.0}
#: Calls of each callable with two arguments replaced.
PAIRS = 60
#: Memory that all of it may take, bytes.
MEMORY = 4 << 30
#: Public, but not called here: a category of warnings, and a picture, as below.
NOT_CALLED = {"membrane.SmallSlopeWarning", "tracking.plot_track"}
#: Methods that take nothing, and pictures, whose tests are tests/test_plots.py.
WITHOUT = {"to_dict", "to_frame", "to_xarray", "plot"}

EGG = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
INPUTS = {"force": 100.0, "dimple_radius": 200.0, "dimple_depth": 40.0, **EGG}
#: Files are written here and nowhere else: calls are made with it as the current folder.
_KEPT = tempfile.TemporaryDirectory(prefix="fuzz")
atexit.register(_KEPT.cleanup)
FOLDER = Path(_KEPT.name)
GREY = FOLDER / "grey.tif"


def scope() -> microscope.Microscope:
    return microscope.Microscope(
        200000.0, 126000.0, 79380.0, alpha=0.02, beta=0.01, image_size=(300, 260)
    )


@cache
def target() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (64, 72)).astype(np.uint8)


def grid(rows: int = 6, columns: int = 7, pitch: float = 200.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns) - columns // 2, np.arange(rows) - rows // 2)
    return np.column_stack([x.ravel(), y.ravel()]) * pitch + 0.0


@cache
def lines() -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 2, (40, 120))
    return 190 - 120 * np.exp(-((np.arange(120) % 12 - 5.5) ** 2) / 4) + noise


@cache
def circles() -> np.ndarray:
    return synthetic.render_circles(replace(scope(), alpha=0.0, beta=0.0))


@cache
def charuco() -> np.ndarray:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard((4, 3), 3.0, 2.0, markers).generateImage((180, 140))


@cache
def squares() -> np.ndarray:
    return synthetic.render_squares(replace(scope(), alpha=0.0, beta=0.0))


@cache
def egg() -> synthetic.EmbryoImage:  # type: ignore[name-defined]
    return synthetic.embryo_image(
        synthetic.Embryo.pressed(150.0, modulus=1.0), rng=0, pixel_size=7.75, shape=(384, 512)
    )


@cache
def outline():
    return embryo.extract_boundary(egg().image)


@cache
def capsule_outline() -> np.ndarray:
    settings = {**EGG, "modulus": 1.0, "radius": 600.0, "inflation": 1.05}
    state = membrane.indent_capsule(100.0, **settings)
    return np.column_stack([state.r, state.z])[::10]


@cache
def dimple():
    return embryo.fit_dimple(outline(), pixel_size=7.75, probe_half_width=25.0)


@cache
def gripper():
    return synthetic.gripper_scene(0, pixel_size=2.0, shape=(160, 200), reach=40)


def gaussians() -> embryo.GaussianSum:
    return embryo.GaussianSum(**{**CALLS["embryo.GaussianSum"](), "covariance": None})


def dented() -> embryo.GaussianSum:
    return embryo.GaussianSum(
        np.array([20.0, -18.0]), np.array([50.0, 50.0]), np.array([40.0, 12.0]), (0.0, 100.0)
    )


@cache
def stack() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 255, (5, 24, 31)).astype(np.uint8)


@cache
def depths() -> focus.FocusResult:
    return focus.depth_from_focus(stack(), np.arange(5.0))


def dome() -> np.ndarray:
    return synthetic.paraboloid((24, 28), 6.0)


@cache
def bent():
    return curvature.surface_curvature(dome(), 1.0)


def controller() -> servoing.OptimalController:
    return servoing.OptimalController(**CALLS["servoing.OptimalController"]())


def predictive() -> servoing.PredictiveController:
    return servoing.PredictiveController(**CALLS["servoing.PredictiveController"]())


def filter_() -> tracking.KalmanFilter:
    return tracking.KalmanFilter(**CALLS["tracking.KalmanFilter"]())


def tracker() -> tracking.ESMTracker:
    return tracking.ESMTracker(target(), (16, 16, 32, 32), "translation")


@cache
def calibrated() -> calibration.Calibration:
    return calibration.calibrate(**{**CALLS["calibration.calibrate"](), "groups": None})


def peaks() -> dict[str, object]:
    window = np.random.default_rng(2).random((3, 4, 5)).astype(np.float32) + 1
    window[1] += 2
    index = np.full((4, 5), 2, np.uint16)
    return {"window": window, "index": index, "positions": np.arange(5.0)}


def reference() -> np.ndarray:
    return np.tile([100.0, 80.0], (6, 1))


def simulation() -> dict[str, object]:
    return {
        "controller": controller(), "reference": reference(), "jacobian": np.eye(2) * 0.3,
        "stage": servoing.Stage(500.0), "camera": servoing.Camera(0.04), "rng": 0,
        "start": [90.0, 80.0],
    }  # fmt: skip


def workstation(**options: object) -> servoing.SimulatedWorkstation:
    scene = gripper()
    settings: dict = {
        "render": lambda feature, focus: scene.frame(feature - scene.home, 0),
        "jacobian": np.eye(2) * 0.3, "stage": servoing.Stage(500.0), "home": scene.home,
        "camera": servoing.Camera(0.04), "rng": 0,
    }  # fmt: skip
    return servoing.SimulatedWorkstation(**settings | options)


def core() -> types.SimpleNamespace:
    return types.SimpleNamespace(
        getXYStageDevice=lambda: "XY",
        getCameraDevice=lambda: "Camera",
        getShutterDevice=lambda: "Shutter",
        getFocusDevice=lambda: "Z",
    )


def steering() -> dict[str, object]:
    scene, station = gripper(), workstation()
    frame, _ = station.camera.snap()
    return {
        "workstation": station, "tracker": tracking.ESMTracker(frame, scene.box(40), "translation"),
        "targets": [scene.home + 5.0], "travel": [300.0, 300.0], "path": False,
        "jacobian": np.eye(2) * 0.3, "test_move": 30.0,
        "controller": lambda k, measured, goals: (goals[0] - measured) * 30.0, "tolerance": 0.5,
        "step": 50.0, "speed": 400.0, "interval": 0.1, "most_frames": 20,
        "most_lost": 2, "timeout": 10.0, "progress": lambda row: None,
    }  # fmt: skip


def live() -> automation.LiveDepth:
    found = automation.LiveDepth(measure="tenengrad")
    for z, frame in enumerate(stack()):
        found.push(frame, float(z))
    return found


def focusing() -> servoing.SimulatedWorkstation:
    seen = {"render": lambda feature, z: stack()[int(np.clip(round(z), 0, 4))]}
    return workstation(**seen, focus_drive=servoing.Stage(1e6))


def control() -> dict[str, object]:
    return {"k": 0, "measured": np.array([1.0, 2.0]), "reference": reference()}


WEIGHTS = {
    "interval": 0.04, "feature_weight": np.eye(2), "control_weight": np.eye(2) * 0.01
}  # fmt: skip
TRACK = {
    "corners": np.zeros((4, 2)), "lost": False, "reason": "", "correlation": 1.0,
    "homography": np.eye(3), "gain": 1.0, "bias": 0.0, "visible": 1.0, "iterations": 3,
    "covariance": np.eye(2), "corner_covariance": np.eye(8), "confidence": 1.0,
    "hidden": np.zeros((6, 6), bool),
}  # fmt: skip


#: Where files are measured: a pool of processes for each call would take half a second.
THREADS = ThreadPoolExecutor(1)


def len_of(path: Path) -> dict[str, int]:
    return {"letters": len(str(path))}


def stored(value: object) -> dict[str, object]:
    """Return the fields of a dataclass, shallow."""
    return {f.name: getattr(value, f.name) for f in fields(value)}  # type: ignore[arg-type]


#: Valid arguments of every public callable and of every public method, made anew for each call.
CALLS: dict[str, Callable[[], dict[str, object]]] = {
    "batch.process_files": lambda: {
        "files": [FOLDER / "a.txt"], "work": len_of, "table": FOLDER / "t.csv",
        "executor": THREADS, "retry": False, "progress": False,
    },
    "calibration.Calibration": lambda: stored(calibrated()),
    "calibration._calibration.ErrorSummary.of": lambda: {"differences": grid() / 100},
    "calibration.Calibration.interval": lambda: {
        "self": calibrated(), "parameter": "magnification", "level": 0.9
    },
    "calibration.Calibration.um_per_pixel": lambda: {"self": calibrated(), "level": 0.9},
    "calibration.Calibration.from_json": lambda: {"text": calibrated().to_json()},
    "calibration.Calibration.to_json": lambda: {"self": calibrated()},
    "calibration.Detection": lambda: {
        "points": grid(), "grid": grid().astype(int), "sigma": np.ones(42),
        "group": np.zeros(42, int), "positions": grid(), "side": 0.5, "misfit": 1.0,
        "image_size": (200, 160),
    },
    "calibration.calibrate": lambda: {
        "world": grid(), "image": scope().project(grid()), "focal_length": 126000.0,
        "pixel_size": 9.9, "image_size": (300, 260), "groups": np.arange(42),
        "pitch": None,
    },
    "calibration.cramer_rao": lambda: {
        "microscope": scope(), "world": grid(), "noise": 0.1, "parameters": ("tx", "ty", "alpha")
    },
    "calibration.Detection.to_layers": lambda: {
        "self": calibration.Detection(**CALLS["calibration.Detection"]()),
        "pixel_size": 2.0,
    },
    "calibration.detect_circles": lambda: {
        "image": circles(), "direction": 0.0, "mirrored": False, "lattice": "square",
        "region": (0, 0, 160, 120),
    },
    "calibration.detect_squares": lambda: {
        "image": squares(), "direction": 0.0, "mirrored": False, "pattern": "squares",
        "region": (0, 0, 160, 120),
    },
    "calibration.linear_intrinsics": lambda: {
        "flat": grid()[:, :2] * 1.0, "depth": np.linspace(0.0, 50.0, 42) + 500.0,
        "sensor": grid() * 1.5,
    },
    "calibration.detect_charuco": lambda: {"image": charuco()},
    "calibration.detect_micrometer": lambda: {"image": lines(), "region": (0, 0, 120, 40)},
    "calibration._micrometer.Micrometer.um_per_pixel": lambda: {
        "self": calibration.detect_micrometer(lines()), "division": 10.0,
    },
    "calibration.stage_affine": lambda: {"stage": grid() * 1.0, "image": grid() * 1.5 + 3.0},
    "calibration.radial_alignment": lambda: {"world": grid(), "sensor": grid() * 1.5 + 3.0},
    "curvature.clean_labels": lambda: {"labels": target() % 8 + 1, "smallest": 4},
    "curvature.curvature_windows": lambda: {"size": 7},
    "curvature.hk_labels": lambda: {
        "mean": dome() - 3, "gaussian": dome() - 2, "h_zero": 0.1, "k_zero": 0.1
    },
    "curvature.region_table": lambda: {
        "labels": np.tile(np.uint8([1, 2]), (24, 14)), "curvature": bent()
    },
    "curvature.surface_curvature": lambda: {
        "height": dome(), "pixel_size": 1.0, "size": 7, "noise": 0.1
    },
    "embryo._boundary.Boundary.without_probe": lambda: {
        "self": outline(), "image": egg().image
    },
    "embryo._probe.Probe.axis": lambda: {"self": outline().probe, "y": np.arange(5.0)},
    "embryo._probe.Probe.half_width_at": lambda: {
        "self": outline().probe, "y": np.arange(5.0)
    },
    "embryo._dimple.DimpleFit.__call__": lambda: {"self": dimple(), "x": np.linspace(200, 300, 9)},
    "embryo.GaussianSum": lambda: {
        "amplitudes": np.array([3.0, -1.0]), "centers": np.array([5.0, 12.0]),
        "widths": np.array([8.0, 3.0]), "domain": (0.0, 20.0), "covariance": np.eye(6),
    },
    **{
        f"embryo.GaussianSum.{name}": lambda: {"self": gaussians(), "x": np.linspace(1.0, 9.0, 5)}
        for name in ("__call__", "slope", "second_derivative")
    },
    "embryo.GaussianSum.gradient": lambda: {"self": gaussians(), "x": 4.0},
    "embryo.GaussianSum.extrema": lambda: {"self": gaussians()},
    "embryo.dimple_geometry": lambda: {"curve": dented(), "pixel_size": 3.9, "rim": "left"},
    "embryo.extract_boundary": lambda: {
        "image": egg().image, "direction": "top", "dimple": True
    },
    "embryo.fit_dimple": lambda: {
        "boundary": outline(), "pixel_size": 7.75, "probe_half_width": 25.0
    },
    "embryo.fit_gaussians": lambda: {
        "x": np.linspace(0.0, 20.0, 30), "y": gaussians()(np.linspace(0.0, 20.0, 30)), "terms": 2,
        "max_iterations": 50,
    },
    "embryo.force_from_image": lambda: {
        "image": egg().image, "modulus": 1.0, "pixel_size": 7.75, **EGG,
        "radius": 600.0, "direction": "top",
    },
    "embryo.force_over_time": lambda: {
        "images": [egg().image] * 2, "time": np.array([0.0, 1.0]), "modulus": 1.0,
        "shares": np.array([0.3]), "relaxation_times": np.array([2.0]), "modulus_std": 0.1,
        "pixel_size": 7.75, **EGG, "direction": "top",
    },
    "embryo.loess": lambda: {
        "x": np.linspace(0.0, 20.0, 30), "y": gaussians()(np.linspace(0.0, 20.0, 30)),
        "span": 0.4, "degree": 2,
    },
    "embryo.modulus_from_image": lambda: {
        "image": egg().image, "force": 150.0, "pixel_size": 7.75, **EGG, "method": "membrane",
        "radius": 600.0, "law": "neo-hooke", "direction": "top",
    },
    "focus.FocusResult": lambda: stored(depths()),
    "focus.correct_spikes": lambda: {"depth": dome(), "window": 5, "delta": 2.0},
    "focus.depth_from_focus": lambda: {
        "frames": stack(), "positions": np.arange(5.0), "measure": "sml", "window": 5, "step": 1,
        "threshold": 0.0, "points": 3, "workers": 1, "register": False, "region": (0, 0, 20, 20),
        "reduce": 1, "progress": None, "spacing": None,
    },
    "focus.FocusResult.to_layers": lambda: {"self": depths()},
    "focus.FocusResult.select": lambda: {
        "self": replace(depths(), index=np.full_like(depths().index, 2)), "frames": stack()
    },
    "focus.smooth_depth": lambda: {
        "depth": dome(), "jump": 2.0, "radius": 3.0, "weight": np.ones((24, 28))
    },
    "focus.sum_modified_laplacian": lambda: {
        "image": target(), "window": 5, "step": 1, "threshold": 0.0
    },
    "focus.three_point_peak": peaks,
    "io.read_frames": lambda: {
        "frames": stack(), "color": False, "region": (0, 0, 20, 20), "reduce": 1
    },
    "io.read_grey": lambda: {"path": written()},
    "io.write_height_tiff": lambda: {
        "path": FOLDER / "fuzz.tif", "height": dome(), "pixel_size": 2.0, "what": "height in um"
    },
    "io.write_ply": lambda: {
        "path": FOLDER / "fuzz.ply", "height": dome(), "pixel_size": 2.0,
        "image": np.zeros((24, 28), np.uint8), "step": 1,
    },
    "membrane.capsule_modulus": lambda: {
        "force": 100.0, "rim_radius": 185.0, "depth": 65.0, "radius": 600.0, **EGG,
        "law": "neo-hooke",
    },
    "membrane.disc_modulus": lambda: {
        "force": 100.0, "rim_radius": 200.0, "depth": 40.0, **EGG, "law": "neo-hooke",
        "pressure": 0.0, "pretension": 0.0, "rim_inset": 0.0,
    },
    "membrane.viscoelastic_force": lambda: {
        "time": np.arange(4.0), "elastic_force": np.arange(4.0), "shares": np.array([0.3]),
        "relaxation_times": np.array([2.0]),
    },
    "membrane.fit_capsule": lambda: {
        "force": 100.0, "outline": capsule_outline(), "radius": 600.0, **EGG,
        "law": "neo-hooke", "start": (1.0, 1.05),
        "fit_tilt": True,
    },
    "membrane.indent_capsule": lambda: {
        "force": 100.0, "modulus": 1.0, "radius": 600.0, **EGG, "law": "neo-hooke",
        "inflation": 1.05,
    },
    "membrane.indent_disc": lambda: {
        "force": 100.0, "modulus": 1.0, "radius": 200.0, **EGG, "law": "neo-hooke",
        "pressure": 0.0, "pretension": 0.0, "rim_inset": 0.0,
    },
    "membrane.dimple_depth": lambda: {
        "force": 100.0, "dimple_radius": 200.0, "modulus": 1.0, **EGG
    },
    "membrane.dimple_profile": lambda: {
        "radius": np.linspace(30.0, 190.0, 7), "dimple_radius": 200.0, "dimple_depth": 40.0,
        "probe_half_width": 25.0,
    },
    "membrane.elastic_modulus": lambda: dict(INPUTS),
    "membrane.finite_slope_modulus": lambda: dict(INPUTS),
    "membrane.indentation_force": lambda: {
        "modulus": 1.0, "dimple_radius": 200.0, "dimple_depth": 40.0, **EGG
    },
    "membrane.mean_strain": lambda: {
        "dimple_radius": 200.0, "dimple_depth": 40.0, "probe_half_width": 25.0,
        "small_slopes": False,
    },
    "membrane.membrane_stress": lambda: {
        k: v for k, v in INPUTS.items() if k != "poisson_ratio"
    },
    "membrane.modulus_samples": lambda: {
        "values": dict(INPUTS), "stds": {"force": 5.0}, "size": 10, "rng": 0,
        "dimple_covariance": np.eye(2),
    },
    "membrane.modulus_std": lambda: {
        "values": dict(INPUTS), "stds": {"force": 5.0}, "dimple_covariance": np.eye(2)
    },
    "membrane.steepest_depth": lambda: {"dimple_radius": 200.0, "probe_half_width": 25.0},
    "microscope.Microscope": lambda: stored(scope()),
    "microscope.Microscope.to_objective": lambda: {"self": scope(), "points": grid()},
    "microscope.Microscope.project": lambda: {"self": scope(), "points": grid()},
    "microscope.Microscope.back_project": lambda: {"self": scope(), "pixels": grid() / 20 + 90},
    "microscope.Microscope.jacobian": lambda: {
        "self": scope(), "world": grid(), "parameters": ("tx", "alpha")
    },
    "microscope.Microscope.project_plane": lambda: {
        "visible": np.array([1.6, 5e-6, -1e-10, 0.1, 0.02, 0.01, 3.0, 4.0]), "world": grid(),
        "cell": np.array([9.9, 9.9]),
    },
    "microscope.distort": lambda: {"points": grid(), "distortion": 1e-9},
    "microscope.euler_rotation": lambda: {"alpha": 0.1, "beta": 0.2, "gamma": 0.3},
    "microscope.undistort": lambda: {"points": grid(), "distortion": 1e-9},
    "optics.BlurLadder": lambda: {"image": target(), "largest": 3.0},
    "optics.BlurLadder.at": lambda: {
        "self": optics.BlurLadder(target(), 3.0), "sigma": np.full((64, 72), 1.5)
    },
    "optics.blur_radius": lambda: {
        "object_distance": [200.0, 300.0], "focal_length": 100.0, "sensor_distance": 180.0,
        "aperture_radius": 10.0,
    },
    "optics.defocus": lambda: {"image": target(), "sigma": 2.0},
    "optics.gaussian_kernel": lambda: {"sigma": 1.5, "size": 7},
    "optics.gaussian_transfer": lambda: {"u": [0.1, 0.2], "v": [0.0, 0.3], "sigma": 1.5},
    "optics.image_distance": lambda: {"object_distance": [200.0, 300.0], "focal_length": 100.0},
    "automation.LiveDepth": lambda: {"farthest": 3.0},
    "automation.LiveDepth.push": lambda: {
        "self": automation.LiveDepth(), "frame": stack()[0], "z": 1.0
    },
    "automation.LiveDepth.result": lambda: {"self": live()},
    "automation.acquire_depth": lambda: {
        "workstation": focusing(), "positions": np.arange(5.0), "farthest": 3.0, "coarse": 2,
        "timeout": 5.0, "progress": lambda live: None, "measure": "tenengrad",
    },
    "automation.autofocus": lambda: {
        "workstation": focusing(), "positions": np.arange(5.0), "region": (0, 0, 20, 20),
        "timeout": 5.0,
    },
    "servoing.Camera": lambda: {"interval": 0.04, "latency": 0.02, "jitter": 0.1},
    "servoing.MicroManager": lambda: {"core": core()},
    "servoing.OptimalController": lambda: {"jacobian": np.eye(2) * 0.3, **WEIGHTS},
    "servoing.OptimalController.__call__": lambda: {"self": controller(), **control()},
    "servoing.PredictiveController": lambda: {
        "jacobian": np.eye(2) * 0.3, **WEIGHTS, "delay": 0.06, "saturation": 500.0,
        "innovation_gain": 0.3,
    },
    "servoing.PredictiveController.__call__": lambda: {"self": predictive(), **control()},
    "servoing.SimulatedWorkstation": lambda: {
        "render": lambda feature, focus: target(), "jacobian": np.eye(2) * 0.3,
        "stage": servoing.Stage(500.0), "camera": servoing.Camera(0.04), "rng": 0,
        "home": [10.0, 10.0], "drift": [0.1, 0.2], "focus_drive": servoing.Stage(10.0),
    },
    "servoing.Stage": lambda: {"saturation": 500.0, "step": 0.05, "travel": 7500.0},
    "servoing.Stage.rounded": lambda: {
        "self": servoing.Stage(200.0), "position": np.array([1.23, 4.56])
    },
    "servoing.ibvs_control": lambda: {
        "jacobian": np.eye(2) * 0.3, "error": [3.0, 4.0], "gain": 0.5, "drift": [0.1, 0.1]
    },
    "servoing.loop_poles": lambda: {"gain": 0.5, "delay": 1.5},
    "servoing.optimal_control": lambda: {
        "jacobian": np.eye(2) * 0.3, "feature": [3.0, 4.0], "target": [5.0, 6.0], **WEIGHTS
    },
    "servoing.path_metrics": lambda: {"position": reference() + 1, "reference": reference()},
    "servoing.point_jacobian": lambda: {
        "points": [[10.0, 20.0], [5.0, 6.0]], "depth": 500.0, "magnification": 2.0,
        "pixel_size": 9.9,
    },
    "servoing.servo": steering,
    "servoing.simulate": simulation,
    "servoing.step_metrics": lambda: {
        "time": np.arange(40.0), "position": 10 - 10 * np.exp(-np.arange(40.0) / 5)[:, None],
        "target": [10.0], "band": 0.05,
    },
    "synthetic.Embryo": lambda: stored(synthetic.Embryo.pressed(150.0, modulus=1.0)),
    "synthetic.Embryo.pressed": lambda: {
        "force": 150.0, "modulus": 1.0, "rim_radius": 450.0, "thickness": 3.0
    },
    "synthetic.Embryo.dented": lambda: {"depth": 100.0, "modulus": 1.0, "rim_radius": 450.0},
    "synthetic.Embryo.outline": lambda: {
        "self": synthetic.Embryo.pressed(150.0, modulus=1.0), "spacing": 5.0
    },
    "synthetic.ImagingConditions": lambda: {
        "blur": 1.0, "dark": 50.0, "bright": 200.0, "vignetting": 0.1, "gradient": (0.1, 0.0),
        "noise": 1.0,
    },
    "synthetic.camera_frame": lambda: {"image": target(), "rng": 0, "noise": 2.0, "gain": 1.0},
    "synthetic.cell_image": lambda: {
        "kind": "Jurkat", "rng": 0, "count": 3, "pixel_size": 0.25, "shape": (200, 240)
    },
    "synthetic.cone": lambda: {"shape": (20, 24), "height": 5.0, "radius": 8.0},
    "synthetic._embryo.EmbryoImage.to_pixels": lambda: {"self": egg(), "points": grid() / 10},
    "synthetic._gripper.GripperScene.box": lambda: {
        "self": gripper(), "size": 20, "shift": np.array([3.0, 4.0])
    },
    "synthetic._gripper.GripperScene.frame": lambda: {
        "self": gripper(), "shift": np.array([3.0, 4.0]), "rng": 0, "noise": 2.0, "gain": 1.0
    },
    "synthetic.embryo_image": lambda: {
        "embryo": synthetic.Embryo.pressed(150.0, modulus=1.0), "rng": 0, "pixel_size": 7.75,
        "shape": (200, 256), "center": (128.0, 40.0), "tilt": 0.1, "blur": 1.0, "noise": 2.0,
        "unevenness": 0.1, "probe": True,
    },
    "synthetic.focal_stack": lambda: {
        "texture": target(), "height": np.zeros((64, 72)), "positions": [0.0, 1.0, 2.0],
        "blur_rate": 1.0, "sharpest": 0.5, "noise": 1.0, "rng": 0,
    },
    "synthetic.gripper_scene": lambda: {
        "rng": 0, "pixel_size": 2.0, "gap": 100.0, "shape": (160, 200), "reach": 40
    },
    "synthetic.mixed_texture": lambda: {
        "shape": (20, 24), "rng": 0, "mean": 128.0, "std": 38.0, "scales": (0.6, 1.2)
    },
    "synthetic.parabolic_cylinder": lambda: {"shape": (20, 24), "height": 5.0, "width": 9.0},
    "synthetic.paraboloid": lambda: {"shape": (20, 24), "height": 5.0},
    "synthetic.render_circles": lambda: {
        "microscope": scope(), "radius": 70.0, "pitch": 280.0, "counts": (3, 3),
        "imaging": synthetic.ImagingConditions(noise=1.0), "rng": 0,
    },
    "synthetic.render_squares": lambda: {
        "microscope": scope(), "side": 200.0, "counts": (3, 3),
        "imaging": synthetic.ImagingConditions(noise=1.0), "rng": 0,
    },
    "synthetic.sphere_on_plane": lambda: {
        "shape": (20, 24), "radius": 8.0, "pixel_size": 1.0, "roughness": 0.1, "grain": 2.0,
        "rng": 0,
    },
    "synthetic.step": lambda: {"shape": (20, 24), "height": 5.0, "at": 0.5},
    "synthetic.texture_sequence": lambda: {
        "positions": [[0.0, 0.0], [1.0, 2.0]], "rng": 0, "size": 30, "sigma": 1.0, "noise": 2.0
    },
    "synthetic.tilted_plane": lambda: {"shape": (20, 24), "rise_x": 5.0, "rise_y": 1.0},
    "synthetic.warped_pair": lambda: {
        "rng": 0, "distance": 2.0, "warp": "shift", "size": 30, "sigma": 1.0, "noise": 2.0,
        "gain": 1.05,
    },
    "tracking.ESMTracker": lambda: {
        "image": target(), "box": (16, 16, 32, 32), "motion": "translation",
        "kalman": filter_(),
    },
    "tracking.ESMTracker.track": lambda: {"self": tracker(), "frame": target()},
    "tracking.KalmanFilter": lambda: {
        "position": [10.0, 20.0], "interval": 0.04, "acceleration": 100.0, "noise": 0.5
    },
    "tracking.KalmanFilter.predict": lambda: {"self": filter_()},
    "tracking.KalmanFilter.update": lambda: {"self": filter_(), "position": [11.0, 21.0]},
    "tracking.Track": lambda: dict(TRACK),
    "tracking.Track.to_layers": lambda: {"self": tracker().track(target()), "pixel_size": 2.0},
    "tracking.track_all": lambda: {
        "frames": [target(), target()], "box": (16, 16, 32, 32), "motion": "translation",
        "rate": 25.0, "pixel_size": 2.0, "kalman": filter_(),
    },
    "tracking.track_each": lambda: {
        "frames": [target(), target()], "box": (16, 16, 32, 32), "motion": "translation",
        "rate": 25.0, "pixel_size": 2.0, "kalman": filter_(),
    },
}  # fmt: skip

#: Where a result may be NaN or infinite from finite values, as its documentation says.
MAY_BE_UNKNOWN = {
    # unobservable parameters have infinite variances
    "calibration.Calibration.interval", "calibration.calibrate", "calibration.cramer_rao",
    "calibration.Calibration",
    # circles have no side, nor have corners
    "calibration.detect_circles", "calibration.detect_charuco",
    # three moves leave no residual to tell an error by
    "calibration.stage_affine",
    # NaN far from the dimple
    "embryo._dimple.DimpleFit.__call__",
    # the covariance, where that of the curve is not known
    "embryo.dimple_geometry",
    # NaN where the three measures are equal or zero
    "focus.three_point_peak",
    # NaN beyond the fold of the distortion model
    "microscope.distort", "microscope.undistort", "microscope.Microscope.project",
    "microscope.Microscope.project_plane",
    # a region without a known curvature
    "curvature.region_table",
    # the border is NaN
    "curvature.surface_curvature",
    # a direction that the outline leaves open
    "embryo.fit_dimple", "embryo.modulus_from_image", "embryo.force_from_image",
    # terms that coincide have infinite variances
    "embryo.fit_gaussians",
    # unknown pixels are NaN
    "focus.FocusResult", "focus.depth_from_focus", "automation.LiveDepth.result",
    "automation.acquire_depth",
    # stretches are NaN where the wall is slack
    "membrane.capsule_modulus", "membrane.indent_capsule",
    # NaN where no slope is steep enough
    "membrane.finite_slope_modulus",
    # NaN where a ray misses the plane
    "microscope.Microscope.back_project",
    # an object in the focal plane has its image at infinity
    "optics.image_distance",
    # what a run did not come to
    "automation.autofocus", "servoing.servo",
    # a step that never settles
    "servoing.step_metrics",
    # a lost target has no position
    "tracking.ESMTracker.track",
}  # fmt: skip


@cache
def written() -> Path:
    io.write_height_tiff(GREY, np.ones((4, 5)), pixel_size=1.0)
    return GREY


def public() -> Iterator[str]:
    """Yield the name of every public callable, and of every public method of a public class."""
    for room in (m.name for m in pkgutil.iter_modules(microlib.__path__) if m.name[0] != "_"):
        module = importlib.import_module(f"microlib.{room}")
        for name in module.__all__:
            value = getattr(module, name)
            if not callable(value) or f"{room}.{name}" in NOT_CALLED:
                continue
            yield f"{room}.{name}"
            for method, found in vars(value).items() if inspect.isclass(value) else ():
                function = getattr(found, "__func__", found)
                open_to_all = method == "__call__" or method[0] != "_"
                if inspect.isfunction(function) and open_to_all and method not in WITHOUT:
                    yield f"{room}.{name}.{method}"


def valid_call(name: str) -> dict[str, object]:
    return CALLS[name]()


def resolve(name: str) -> Callable:
    room, *path = name.split(".")
    value: object = importlib.import_module(f"microlib.{room}")
    for part in path:
        value = getattr(value, part)
    assert callable(value)
    return value


def parameters(name: str, valid: dict[str, object]) -> list[str]:
    """Return the names of the arguments: those that the table has are all that there are."""
    given = inspect.signature(resolve(name)).parameters.values()
    names = [p.name for p in given if p.kind is not p.VAR_KEYWORD]
    return names + [key for key in valid if key not in names]


SINGLES: dict[str, object] = {
    "nan": np.nan, "inf": np.inf, "-inf": -np.inf, "None": None, "text": "text", "bytes": b"x",
    "True": True, "np.True_": np.True_, "[]": [], "[1.0]": [1.0], "array([1.0])": np.ones(1),
    "[[1.0]]": [[1.0]], "0": 0, "-1": -1, "1e30": 1e30, "-1e30": -1e30, "1e300": 1e300,
    "1e-300": 1e-300, "10**400": 10**400, "1j": 1j, "uint8(200)": np.uint8(200),
    "int8(-100)": np.int8(-100), "1.5": 1.5, "object()": object(), "{}": {}, "'nan'": "nan",
    "1000001": 1000001, "-2147483649": -(1 << 31) - 1, "1e60": 1e60, "1e-60": 1e-60,
    "list of masked": [np.ma.array([1.0, 2.0], mask=[0, 1])] * 2, "set": {1.0},
    "0-d nan": np.array(np.nan), "0-d text": np.array("x"), "float16": np.float16(1.5),
    "masked": np.ma.array(1.0, mask=True), "masked array": np.ma.array([1.0, 2.0], mask=[0, 1]),
    "ragged": [[1.0], [1.0, 2.0]], "1e6": 10**6, "datetime": np.datetime64("2026-01-01"),
}  # fmt: skip


def hostile(value: object) -> Iterator[tuple[str, object]]:
    """Yield labelled values to put in a valid one's place."""
    yield from SINGLES.items()
    # What the library itself gave: frames that are read, frames that were, results.
    yield "reader", io.read_frames(stack())
    spent = io.read_frames(stack())
    yield f"reader of {len(list(spent))} that were read", spent
    yield from {"depths": depths(), "camera": calibrated(), "curvature": bent()}.items()
    if isinstance(value, dict):
        for key in list(value)[:2]:
            for label in ("nan", "None", "text", "[1.0]", "-1", "1e300", "True"):
                yield f"{key}={label}", {**value, key: SINGLES[label]}
        return
    if isinstance(value, (str, bool)) or not isinstance(value, (np.ndarray, list, tuple)):
        return
    array = np.asarray(value)
    if array.dtype.kind not in "uif" or not array.size:
        return
    plain = array.astype(np.float64)
    for label, wrong in (("nan", np.nan), ("inf", np.inf)):
        holed = plain.copy()
        holed.flat[-1] = wrong
        yield f"with {label}", holed
    with np.errstate(over="ignore"):
        yield "zeros", np.zeros_like(plain)
        yield "negative", -plain
        yield "all equal", np.full_like(plain, plain.flat[0])
        for scale in (1e-300, 1e-100, 1e-30, 1e12, 1e30, 1e100, 1e300):
            yield f"×{scale:g}", plain * scale
        yield "descending from 1e300", np.linspace(1e300, 0, plain.size).reshape(plain.shape)
        yield "alternating", np.where(np.arange(plain.size).reshape(plain.shape) % 2, plain, -plain)
        yield "uint8", np.nan_to_num(plain).clip(-1e9, 1e9).astype(np.int64).astype(np.uint8)
    yield "bool", plain > 0
    yield "complex", array.astype(complex)
    yield "objects", array.astype(object)
    yield "text array", array.astype(str)
    yield "masked", np.ma.array(array, mask=plain > np.median(plain))
    yield "masked nowhere", np.ma.array(array)
    yield "empty", array[:0]
    yield "one less", array[:-1]
    yield "first", array[:1]
    yield "one axis more", array[None]
    yield "flat", array.ravel()
    yield "one column less", array[..., :-1]
    yield "reversed", array[::-1]
    yield "no rows", array.reshape(-1, *array.shape[1:])[:0].T
    yield "16-bit floats", plain.clip(-6e4, 6e4).astype(np.float16)
    yield "long doubles", plain.astype(np.longdouble)
    yield "list of masked rows", [np.ma.array(row, mask=True) for row in np.atleast_1d(array)[:9]]


@dataclass(frozen=True)
class Case:
    """One call of `name` with one argument replaced, or several."""

    name: str
    label: str
    values: dict[str, object]

    @property
    def key(self) -> str:
        return f"{self.name}({self.label})"


def cases(name: str) -> Iterator[Case]:
    for argument, value in valid_call(name).items():
        if argument != "self":
            for label, wrong in hostile(value):
                yield Case(name, f"{argument}={label}", {argument: wrong})


@cache
def elsewhere(argument: str) -> list[str]:
    """Return the callables that have an argument of that name."""
    return [name for name in CALLS if name not in SLOW and argument in valid_call(name)]


def pairs(name: str, count: int) -> Iterator[Case]:
    """Yield calls with two arguments replaced, the same ones each time."""
    rng, valid = random.Random(name), valid_call(name)
    arguments = [argument for argument in valid if argument != "self"]
    for _ in range(count if len(arguments) > 1 else 0):
        values, labels = {}, []
        for argument in rng.sample(arguments, 2):
            other = rng.choice(elsewhere(argument) or [name])
            near = (f"as for {other}", valid_call(other).get(argument))
            label, values[argument] = rng.choice([*hostile(valid[argument]), *[near] * 40])
            labels.append(f"{argument}={label}")
        yield Case(name, ", ".join(labels), values)


def harmless(value: object) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the same numbers in other forms, which must not change the answer."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "uif" or value.ndim == 0:
        return
    frozen = value.copy()
    frozen.flags.writeable = False
    yield "read-only", frozen
    wide = np.empty((*value.shape[:-1], 2 * value.shape[-1]), value.dtype)
    wide[..., ::2] = value
    yield "strided", wide[..., ::2]
    yield "column by column", np.asfortranarray(value)
    yield "other byte order", value.astype(value.dtype.newbyteorder(">"))


#: In place of the result of a call that was refused.
REFUSED = object()


class OutOfTime(BaseException):
    pass


def _stop(*_: object) -> None:
    raise OutOfTime


def leaves(value: object, depth: int = 0) -> Iterator[np.ndarray]:
    """Yield the numbers and arrays that a value holds."""
    if is_dataclass(value) and not isinstance(value, type):
        value = stored(value)
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)) and depth < 6:
        for one in value:
            yield from leaves(one, depth + 1)
    elif isinstance(value, (np.ndarray, float, complex, np.number)):
        yield np.asarray(value)


def same(first: object, second: object) -> bool:
    """Return whether two values hold the same bits."""
    pairs = list(zip_longest(leaves(first), leaves(second), fillvalue=np.array("none")))
    return all(a.dtype == b.dtype and a.tobytes() == b.tobytes() for a, b in pairs)


def finite(value: object) -> bool:
    """Return whether every number in a value is finite."""
    return all(one.dtype.kind not in "fc" or np.isfinite(one).all() for one in leaves(value))


def alike(first: object, second: object) -> bool:
    """Return whether two results are the same but for the order of sums."""
    pairs = list(zip_longest(leaves(first), leaves(second), fillvalue=np.array("none")))
    return all(
        a.shape == b.shape
        and (a.dtype.kind not in "buifc" or np.allclose(a, b, 1e-4, 1e-6, a.dtype.kind in "fc"))
        for a, b in pairs
    )


def answer(name: str, changed: dict[str, object]) -> tuple[object, str | None]:
    """Call with some arguments replaced; return the result and what is wrong, if anything."""
    given = valid_call(name)
    valid = {key: value for key, value in given.items() if key != "self"}
    call = resolve(name)
    if "self" in given:
        call = getattr(given["self"], name.rsplit(".", 1)[1])
    given = {**valid, **changed}
    kept = {k: v for k, v in given.items() if isinstance(v, (np.ndarray, list, tuple, dict))}
    before = copy.deepcopy(kept)
    limit = SLOW.get(name, LIMIT)
    signal.signal(signal.SIGPROF, _stop)
    # What waits, or never returns from a library in C, is told by the watchdog.
    faulthandler.dump_traceback_later(20 * limit, exit=True)
    signal.setitimer(signal.ITIMER_PROF, limit)
    result, wrong = None, None
    try:
        with contextlib.chdir(FOLDER), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            warnings.simplefilter("ignore", membrane.SmallSlopeWarning)
            # Documented: a modulus that no membrane has, and what the rest is found without.
            warnings.filterwarnings("ignore", "a modulus of .* is that of no membrane")
            warnings.filterwarnings("ignore", "frames .* cannot be registered to each other")
            result = call(**given)
            if inspect.isgenerator(result):
                result = list(result)
    except ValueError as error:
        words = [
            *parameters(name, valid),
            *(k for v in valid.values() if isinstance(v, dict) for k in v),
        ]
        if not re.search(rf"\b({'|'.join(words)})\b", str(error)):
            wrong = f"names no argument: {error}"
        result = REFUSED
    except OutOfTime:
        wrong = "out of time"
    except (Exception, RecursionError) as error:
        wrong = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
        for path in FOLDER.iterdir():  # what one call writes is not there for the next
            if path != GREY:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    if not wrong and said:
        wrong = f"warning: {said[0].message}"
    if not wrong and not same(before, kept):
        wrong = "changed its input"
    return result, wrong and wrong[:160]


def fault(case: Case) -> str | None:
    """Return what is wrong with the answer to a case, or None."""
    result, wrong = answer(case.name, case.values)
    kind = resolve(case.name)
    if wrong or result is REFUSED or (is_dataclass(kind) and not hasattr(kind, "__post_init__")):
        return wrong  # what only stores does not look at what it is given
    if "masked" in case.label:
        return "dropped a mask"
    # NaN may come from NaN, in what was replaced or beside it.
    given = (*case.values.values(), valid_call(case.name))
    known = case.name in MAY_BE_UNKNOWN or finite(result) or not all(map(finite, given))
    return None if known else "not finite"


def differences(name: str) -> Iterator[str]:
    """Yield where the same numbers in another form are refused, or give another answer."""
    for argument, value in valid_call(name).items():
        for label, other in harmless(value):
            expected, _ = answer(name, {})
            result, wrong = answer(name, {argument: other})
            if result is REFUSED or wrong or not alike(expected, result):
                yield f"{name}({argument} {label}): {wrong or 'refused or another answer'}"


def main(words: list[str]) -> int:
    # What asks for more fails instead of taking the machine down.
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    total, wrong = 0, 0
    for name in CALLS:
        if words and not any(word in name for word in words):
            continue
        begin, found, every = time.process_time(), [*differences(name)], list(cases(name))
        every += pairs(name, 0 if name in SLOW else PAIRS)
        found += [f"{case.key}: {said}" for case in every if (said := fault(case))]
        seconds = time.process_time() - begin
        print(*found, f"# {name}: {len(every)} in {seconds:.1f} s", sep="\n", flush=True)
        total, wrong = total + len(every), wrong + len(found)
    print(f"{total} cases, {wrong} faults", flush=True)
    return bool(wrong)


if __name__ == "__main__":
    from tests import fuzz  # the calls are made of that module's, not of this script's

    sys.exit(fuzz.main(sys.argv[1:]))
