"""Other arguments for the valid calls of `tests/fuzz.py`, which take other ways through the code.

Inputs are noisy, so that no number that is written down is rounding noise around zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.ndimage import map_coordinates, shift

from microlib import automation, calibration, focus, optics, servoing, synthetic
from microlib.microscope import Microscope
from microlib.tracking import ESMTracker, KalmanFilter
from tests import fuzz

Arguments = dict[str, object]
SHAPE = (56, 68)
POSITIONS = 2.5 * np.arange(11) - 3


@cache
def relief() -> np.ndarray:
    """A stack of a ridge on a slope, with noise."""
    y, x = np.indices(SHAPE)
    height = 8 * np.exp(-(((x - 30) / 9) ** 2) - ((y - 25) / 14) ** 2) + 0.12 * y + 2
    height[:, 50:] += 6
    texture = synthetic.mixed_texture(SHAPE, 5)
    texture[40:50, 5:25] = 240  # without texture, and nearly saturated
    return synthetic.focal_stack(texture, height, POSITIONS, blur_rate=0.6, noise=2.0, rng=6)


@cache
def moved_relief() -> np.ndarray:
    """The same, with frames that drift and get brighter."""
    moved = [
        (1 + 0.01 * k) * shift(frame.astype(float), (0.2 * k, -0.15 * k), mode="nearest")
        for k, frame in enumerate(relief())
    ]
    return np.clip(moved, 0, 255).astype(np.uint8)


def stacked(**changes: object) -> Callable[[], Arguments]:
    plain = {"measure": "multiscale", "region": None, "points": None}
    return lambda: {"frames": relief(), "positions": POSITIONS, **plain, **changes}


@cache
def depth_map() -> np.ndarray:
    rng = np.random.default_rng(3)
    y, x = np.indices((40, 50))
    depth = 0.2 * x + 3 * np.sin(y / 6) + rng.normal(0, 0.3, (40, 50)) + 8 * (x > 30)
    depth[rng.random((40, 50)) < 0.05] += 30
    depth[5:9, 10:14] = np.nan
    return depth


@cache
def noisy_points(seed: int = 0, **changes: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = replace(fuzz.scope(), **changes).project(fuzz.grid())
    return points + rng.normal(0, 0.1, (42, 2))


def outlying() -> np.ndarray:
    image = noisy_points().copy()
    image[[3, 20]] += [[4.0, -3.0], [-2.0, 5.0]]
    return image


def tilted(alpha: float, beta: float) -> np.ndarray:
    return noisy_points(1, alpha=alpha, beta=beta, gamma=0.4, distortion=2e-9)


def several() -> Arguments:
    poses = ((0.3, 0.05), (-0.2, 0.3), (0.1, -0.35), (0.02, 0.01))
    return {
        "world": [fuzz.grid()] * 4, "image": [tilted(*pose) for pose in poses],
        "focal_length": None, "groups": None, "axis_sigma": None,
    }  # fmt: skip


@cache
def noisy_fit() -> calibration.Calibration:
    return calibration.calibrate(
        fuzz.grid(), tilted(0.25, 0.2), pixel_size=9.9, image_size=(200, 160)
    )


@cache
def board(kind: str) -> np.ndarray:
    """A board seen at an angle, drawn by sampling, without the library's renderer and models."""
    rows, cols = 200, 260
    v, u = np.indices((4 * rows, 4 * cols)) / 4
    x, y = (u - 125) / 27, (v - 103) / 27
    if kind == "barrel":
        x, y = (n * (1 + 0.006 * (x**2 + y**2)) for n in (x, y))
    tilt = 4 if kind == "steep" else 1
    w = 1 + tilt * (0.012 * x - 0.009 * y)
    x, y = (np.cos(0.13) * x + np.sin(0.13) * y) / w, (np.cos(0.13) * y - np.sin(0.13) * x) / w
    across, along = np.round(x), np.round(y)
    if kind == "chessboard":
        dark = ((np.floor(x) + np.floor(y)) % 2 == 0) & (np.abs(x) < 4) & (np.abs(y) < 3)
    elif kind == "asymmetric":
        dark = (np.hypot(x - across, y - along) < 0.3) & ((across + along) % 2 == 0)
        dark &= (np.abs(across) <= 3) & (np.abs(along) <= 2)
    elif kind == "hexagonal":
        along = np.round(y / 0.75**0.5)
        across = np.round(x - along / 2) + along / 2
        dark = np.hypot(x - across, y - along * 0.75**0.5) < 0.3
        dark &= (np.abs(across) <= 3) & (np.abs(along) <= 2)
    elif "squares" in kind:
        dark = (np.maximum(abs(x - across), abs(y - along)) < 0.26) & (np.abs(across) <= 3)
        dark &= np.abs(along) <= 2
    else:
        dark = (
            (np.hypot(x - across, y - along) < 0.27) & (np.abs(across) <= 3) & (np.abs(along) <= 2)
        )
        if kind == "marked":
            odd = (across == 0) & (along == 0) & (np.hypot(x, y) < 0.16)
            dark = (dark & ~((across == 0) & (along == 0))) | odd
        if kind == "dirty":
            for at, wide in (((0.45, 0.5), 0.1), ((-1.5, 0.45), 0.27), ((2.1, -1.4), 0.2)):
                dark |= np.hypot(x - at[0], (y - at[1]) * 1.7) < wide
        if kind == "in pieces":
            dark &= across != along
    image = np.where(dark, 60.0, 190.0).reshape(rows, 4, cols, 4).mean(axis=(1, 3))
    noise = np.random.default_rng(8).normal(0, 2, image.shape)
    if kind == "uneven":
        image = image * np.linspace(0.45, 1.1, cols) * np.linspace(1, 0.7, rows)[:, None]
    blurred = optics.defocus(image, 2.4 if "blurred" in kind else 0.9)
    return np.clip(blurred + noise, 0, 255).astype(np.uint8)


def photographed(kind: str, **changes: object) -> Callable[[], Arguments]:
    return lambda: {"image": board(kind), "region": None, **changes}


def towards(direction: str, turns: int) -> Callable[[], Arguments]:
    image = lambda: np.rot90(fuzz.egg().image, turns).copy()  # noqa: E731
    return lambda: {"image": image(), "direction": direction, "region": None}


def track_of(motion: str, steps: int, **settings: object) -> ESMTracker:
    """A tracker that has followed a texture for some frames."""
    found = ESMTracker(texture_frame(0), (18, 16, 30, 28), motion, **settings)  # type: ignore[arg-type]
    for k in range(1, steps):
        found.track(texture_frame(k))
    return found


@cache
def texture_frame(k: int) -> np.ndarray:
    """Frames of a texture that moves, turns and gets brighter."""
    rng = np.random.default_rng(40)
    texture = synthetic.mixed_texture((70, 80), rng).astype(float)
    rows, cols = np.indices((70, 80), dtype=float)
    turn = 0.02 * k
    y, x = rows - 32 - 0.7 * k, cols - 34 + 0.5 * k
    place = [32 + np.cos(turn) * y - np.sin(turn) * x, 34 + np.sin(turn) * y + np.cos(turn) * x]
    moved = map_coordinates(texture, place, order=3, mode="nearest")
    noise = np.random.default_rng(50 + k).normal(0, 1.5, moved.shape)
    return np.clip(moved * (1 + 0.02 * k) + 3 * k + noise, 0, 255).astype(np.uint8)


def covered() -> np.ndarray:
    frame = texture_frame(2).copy()
    frame[20:32, 20:34] = 15
    return frame


def tracking(
    motion: str, frame: Callable[[], np.ndarray], **settings: object
) -> Callable[[], Arguments]:
    return lambda: {"self": track_of(motion, 2, **settings), "frame": frame()}


def kalman(updates: int) -> KalmanFilter:
    found = KalmanFilter([10.0, 20.0], interval=0.04, acceleration=100.0, noise=0.5)
    for k in range(updates):
        found.predict()
        found.update([10.5 + k, 20.0 - 0.4 * k])
    return found


def run_of(**changes: object) -> Callable[[], Arguments]:
    path = np.column_stack([np.linspace(100, 130, 24), 80 + 6 * np.sin(np.arange(24) / 4)])
    return lambda: {
        "reference": path, "start": None, "rng": 3,
        "stage": servoing.Stage(600.0, lag=0.02, step=0.05),
        "camera": servoing.Camera(0.04, latency=0.03, jitter=0.2), **changes,
    }  # fmt: skip


def curve(noise: float = 0.2) -> Arguments:
    x = np.linspace(0.0, 20.0, 60)
    y = fuzz.gaussians()(x) + np.random.default_rng(4).normal(0, noise, 60)
    return {"x": x, "y": y, "weights": None}


def rough_dome() -> np.ndarray:
    rng = np.random.default_rng(9)
    y, x = np.indices((36, 44))
    height = 7 * np.exp(-(((x - 20) / 9) ** 2) - ((y - 15) / 7) ** 2) + 0.1 * x
    height += rng.normal(0, 0.05, height.shape)
    height[3, 5] = np.nan
    return height


def solid(kind: str) -> Callable[[], Arguments]:
    shape = (64, 72)
    heights = {
        "ball": lambda: synthetic.sphere_on_plane(shape, 24.0, 1.0, roughness=0.05, rng=1),
        "cone": lambda: synthetic.cone(shape, 20.0, 26.0),
        "cylinder": lambda: synthetic.parabolic_cylinder(shape, 12.0, width=50.0),
        "step": lambda: synthetic.step(shape, 12.0),
        "plane": lambda: synthetic.tilted_plane(shape, 6.0, 3.0),
    }
    rough = lambda: heights[kind]() + np.random.default_rng(2).normal(0, 0.05, shape)  # noqa: E731
    return lambda: {"height": rough(), "noise": None}


def laws(**changes: object) -> dict[str, Callable[[], Arguments]]:
    return {law: (lambda law=law: {"law": law, **changes}) for law in ("hooke", "mooney-rivlin")}


def scope_of(**changes: object) -> Microscope:
    plain = {"gamma": 0.3, "tx": 120.0, "ty": -60.0, "distortion": 3e-9, "image_size": (150, 130)}
    return replace(fuzz.scope(), **plain | changes)  # type: ignore[arg-type]


LIGHT = synthetic.ImagingConditions(
    blur=1.4, dark=40.0, bright=210.0, vignetting=0.2, gradient=(0.1, -0.05), noise=1.5
)
POINTS = np.array([[3.0, 4.0], [-7.0, 2.0], [120.0, -90.0]])
MEASURED = {"k": 2, "measured": np.array([103.0, 78.0])}


def learnt(make: Callable[[], Callable[..., np.ndarray]]) -> Callable[[], Arguments]:
    """A controller that has seen some frames."""

    def made() -> Arguments:
        controller = make()
        path = np.column_stack([np.linspace(100, 130, 6), np.linspace(80, 70, 6)])
        for k in range(3):
            controller(k, path[k] + [0.4, -0.3 * k], path)
        return {"self": controller, "k": 3, "measured": path[3] + [0.5, -0.7], "reference": path}

    return made


def pressed_scene() -> Arguments:
    scene = fuzz.pipette()
    away = scene.contact - scene.home
    return {"self": scene, "tip": scene.contact + 0.04 * away + [0.3, 0.0]}


def measured(name: str, wide: bool) -> Callable[[], Arguments]:
    """Positions of a step response: noisy, with an overshoot."""
    time = np.arange(40.0) / 25
    rng = np.random.default_rng(7)
    one = 10 - 10 * np.exp(-time * 6) * np.cos(9 * time)
    position = np.column_stack([one, 0.5 * one]) + rng.normal(0, 0.05, (40, 2))
    return lambda: {
        "time": time,
        "position": position,
        "target": [10.0, 5.0],
        "band": 0.05 + 0.1 * wide,
    }


def wandering() -> Arguments:
    rng = np.random.default_rng(12)
    reference = np.column_stack([np.linspace(0, 30, 25), 5 * np.sin(np.arange(25) / 5)])
    return {"position": reference + rng.normal(0.1, 0.3, (25, 2)), "reference": reference}


def moves() -> Arguments:
    rng = np.random.default_rng(13)
    stage = rng.uniform(-50, 50, (9, 2))
    image = stage @ np.array([[0.9, 0.2], [-0.25, 1.1]]) + [3.0, -4.0]
    return {"stage": stage, "image": image + rng.normal(0, 0.2, (9, 2))}


def plane_points() -> Arguments:
    rng = np.random.default_rng(14)
    depth = 500 + rng.uniform(-80, 80, 42)
    flat = fuzz.grid() + rng.normal(0, 5, (42, 2))
    sensor = 126.0 * flat / depth[:, None] + [2.0, -3.0] + rng.normal(0, 0.05, (42, 2))
    return {"flat": flat, "depth": depth, "sensor": sensor}


def labels() -> np.ndarray:
    rng = np.random.default_rng(15)
    y, x = np.indices((30, 38))
    found = ((x // 9 + y // 11) % 4 + 1).astype(np.uint8)
    found[rng.random(found.shape) < 0.1] = 7
    found[:2] = 0
    return found


#: By callable and label.
VARIANTS: dict[str, dict[str, Callable[[], Arguments]]] = {
    "calibration.calibrate": {
        "noisy": lambda: {"image": noisy_points(), "groups": None, "axis_sigma": None},
        "outliers": lambda: {
            "image": outlying(),
            "loss": "huber",
            "groups": None,
            "axis_sigma": None,
        },
        "tilted": lambda: {
            "image": tilted(0.3, 0.2),
            "focal_length": None,
            "groups": np.arange(42) // 2,
        },
        "parallel": lambda: {"image": tilted(0.0, 0.0), "focal_length": None, "groups": None},
        "oblong": lambda: {"image": noisy_points(), "pixel_size": (9.9, 8.3)},
        "several": several,
    },
    "calibration.Calibration.interval": {
        "noisy": lambda: {"self": noisy_fit(), "parameter": "focal_length"},
        "tilt": lambda: {"self": noisy_fit(), "parameter": "alpha", "level": 0.5},
    },
    "calibration.Calibration.um_per_pixel": {"noisy": lambda: {"self": noisy_fit()}},
    "calibration.Calibration.to_json": {"noisy": lambda: {"self": noisy_fit()}},
    "calibration.Calibration.undistort": {
        "noisy": lambda: {"self": noisy_fit(), "points": POINTS + 60}
    },
    "calibration.Calibration.undistort_image": {
        "noisy": lambda: {"self": noisy_fit(), "image": np.resize(board("circles"), (160, 200))},
    },
    "calibration._calibrate.ErrorSummary.of": {
        "noise": lambda: {"differences": noisy_points() / 7}
    },
    "calibration.cramer_rao": {
        "all": lambda: {
            "microscope": scope_of(alpha=0.3, beta=0.2),
            "noise": 0.3,
            "parameters": (
                "magnification",
                "focus",
                "distortion",
                "alpha",
                "beta",
                "gamma",
                "tx",
                "ty",
            ),
        },
    },
    "calibration.detect_circles": {
        "board": photographed("circles"),
        "turned": photographed("circles", direction=2.0, mirrored=True),
        "hexagonal": photographed("hexagonal", lattice="hexagonal"),
        "asymmetric": photographed("asymmetric", lattice="asymmetric"),
        "marked": photographed("marked", origin="odd"),
        "part": photographed("circles", region=(40, 30, 160, 140)),
        **{
            kind: photographed(kind)
            for kind in ("barrel", "steep", "dirty", "in pieces", "uneven", "blurred circles")
        },
    },
    "calibration.detect_squares": {
        "chessboard": photographed("chessboard", pattern="chessboard"),
        "turned": photographed("chessboard", pattern="chessboard", direction=-1.0, mirrored=True),
        "squares": photographed("squares"),
        "blurred squares": photographed("blurred squares"),
    },
    "calibration.linear_intrinsics": {"noisy": plane_points},
    "calibration.radial_alignment": {"noisy": lambda: {"sensor": tilted(0.2, 0.1) - [100.0, 80.0]}},
    "calibration.stage_affine": {"noisy": moves},
    "curvature.clean_labels": {"patches": lambda: {"labels": labels(), "smallest": 6}},
    "curvature.hk_labels": {
        "noisy": lambda: {"mean": rough_dome() - 2, "gaussian": rough_dome()[::-1, ::-1] - 1},
    },
    "curvature.recognize_part": {
        **{kind: solid(kind) for kind in ("ball", "cone", "cylinder", "step", "plane")}
    },
    "curvature.surface_curvature": {
        "rough": lambda: {"height": rough_dome(), "pixel_size": 0.7, "size": 9, "noise": 0.05},
        "plain": lambda: {"height": rough_dome(), "pixel_size": 2.0, "size": 5, "noise": 0.0},
    },
    "curvature.curvature_windows": {"nine": lambda: {"size": 9}},
    "embryo.extract_boundary": {
        "bottom": towards("bottom", 2),
        "left": towards("left", 1),
        "right": towards("right", 3),
        "itself": towards("auto", 1),
        "whole": lambda: {"dimple": False},
        "part": lambda: {"region": (30, 0, 440, 300), "direction": "auto"},
    },
    "embryo.fit_gaussians": {"noisy": lambda: {k: v for k, v in curve().items() if k != "weights"}},
    "embryo.loess": {
        "noisy": curve,
        "robust": lambda: {**curve(0.5), "degree": 1, "robust_iterations": 3},
        "weighted": lambda: {**curve(), "weights": np.linspace(0.1, 2, 60), "span": 0.25},
    },
    "embryo.measure_dimple": {"gaussians": lambda: {"method": "gaussians"}},
    "embryo.modulus_from_image": {
        "gaussians": lambda: {"method": "gaussians", "radius": None},
        "hooke": lambda: {"law": "hooke", "radius": None},
    },
    "focus.correct_spikes": {"noisy": lambda: {"depth": depth_map(), "window": 7, "delta": 2.5}},
    "focus.smooth_depth": {
        "noisy": lambda: {"depth": depth_map(), "jump": 3.0, "radius": 2.0, "weight": None},
    },
    "focus.depth_from_focus": {
        "itself": stacked(),
        "seven": stacked(points=7),
        "floats": lambda: stacked(frames=relief().astype(np.float32) / 2)(),
        "deep": lambda: stacked(frames=relief().astype(np.uint16) * 200)(),
        "sml": stacked(measure="sml", window=7, step=2, threshold=4.0),
        "tenengrad": stacked(measure="tenengrad", points=5),
        "variance": stacked(measure="variance", window=9, points=3),
        "downwards": lambda: stacked(frames=relief()[::-1], positions=POSITIONS[::-1])(),
        "registered": lambda: stacked(frames=moved_relief(), register=True)(),
        "reduced": stacked(reduce=2, points=3),
        "part": stacked(region=(5, 8, 50, 40)),
        "unequal": lambda: stacked(positions=POSITIONS + 0.3 * np.sin(np.arange(11)))(),
        "surveyed": lambda: stacked(
            survey=focus.survey_focus(relief(), POSITIONS, points=7), points=7
        )(),
        "tiles": stacked(tile=32, points=7),
        "colored": lambda: stacked(frames=np.stack([relief(), relief() // 2, relief()], -1))(),
    },
    "focus.FocusResult.select": {
        "relief": lambda: {
            "self": focus.depth_from_focus(relief(), POSITIONS, measure="sml", points=3),
            "frames": relief()[:, :, ::-1],
        },
    },
    "focus.survey_focus": {"relief": lambda: {"frames": relief(), "positions": POSITIONS}},
    "focus.sum_modified_laplacian": {
        "wide": lambda: {"image": relief()[4], "window": 7, "step": 2, "threshold": 9.0},
    },
    "io.read_frames": {
        "reduced": lambda: {"frames": relief(), "reduce": 3, "region": (4, 2, 40, 50)},
        "colored": lambda: {
            "frames": np.stack([relief(), relief() // 2, relief()], -1),
            "color": True,
        },
    },
    "membrane.capsule_bending_force": laws(inflation=1.02),
    "membrane.capsule_modulus": {
        **laws(),
        "free": lambda: {"punch": "frictionless"},
    },
    "membrane.indent_capsule": {
        **laws(inflation=1.1),
        "free": lambda: {"punch": "frictionless"},
    },
    "membrane.disc_modulus": {
        **laws(),
        "balanced": lambda: {"pressure": "balance", "rim_inset": 0.02},
        "pretension": lambda: {"pretension": 0.01},
    },
    "membrane.indent_disc": {
        **laws(pressure=0.001),
        "balanced": lambda: {"pressure": "balance", "pretension": 0.05, "rim_inset": 0.02},
    },
    "membrane.modulus_samples": {"correlated": lambda: {"size": 40, "rng": 5}},
    "membrane.modulus_std": {
        "correlated": lambda: {
            "stds": {"force": 5.0, "thickness": 0.3},
            "dimple_covariance": np.array([[4.0, 1.5], [1.5, 2.0]]),
        },
    },
    "membrane.viscoelastic_force": {
        "two": lambda: {
            "time": np.array([0.0, 0.5, 2.0, 2.5, 6.0]),
            "elastic_force": np.array([0.0, 4.0, 9.0, 9.0, 3.0]),
            "shares": np.array([0.3, 0.2]),
            "relaxation_times": np.array([2.0, 0.4]),
        },
    },
    "membrane.mean_strain": {"small": lambda: {"small_slopes": True}},
    "microscope.Microscope.project": {"posed": lambda: {"self": scope_of()}},
    "microscope.Microscope.back_project": {
        "posed": lambda: {"self": scope_of(pixel_size=(9.9, 8.0))}
    },
    "microscope.Microscope.jacobian": {
        "posed": lambda: {
            "self": scope_of(),
            "parameters": (
                "tube_length",
                "focal_length",
                "distance",
                "distortion",
                "alpha",
                "beta",
                "gamma",
                "tx",
                "ty",
            ),
        }
    },
    "microscope.Microscope": {"posed": lambda: {"pixel_size": (9.9, 8.0), "gamma": 0.3, "tx": 5.0}},
    "microscope.distort": {"barrel": lambda: {"distortion": -2e-9}},
    "microscope.undistort": {"barrel": lambda: {"distortion": -2e-9}},
    "optics.BlurLadder.at": {
        "slope": lambda: {"sigma": np.linspace(0, 3, 64 * 72).reshape(64, 72)},
    },
    "optics.defocus": {
        "map": lambda: {"sigma": np.linspace(0, 4, 64 * 72).reshape(72, 64).T},
        "none": lambda: {"sigma": 0.0},
        "wide": lambda: {"image": relief()[0], "sigma": 7.5},
    },
    "optics.gaussian_kernel": {"narrow": lambda: {"sigma": 0.4, "size": 5}},
    "optics.blur_radius": {
        "both": lambda: {"object_distance": [150.0, 225.0, 400.0], "aperture_radius": 7.0},
    },
    "automation.LiveDepth.result": {"options": lambda: {"self": seen_live()}},
    "automation.acquire_depth": {"whole": lambda: {"farthest": None, "coarse": None}},
    "automation.autofocus": {"whole": lambda: {"region": None}},
    "servoing.OptimalController.__call__": {"seen": learnt(fuzz.controller)},
    "servoing.PredictiveController.__call__": {"seen": learnt(fuzz.predictive)},
    "servoing.ibvs_control": {
        "turned": lambda: {"jacobian": np.array([[0.3, 0.05], [-0.1, 0.25]]), "drift": None},
    },
    "servoing.optimal_control": {
        "turned": lambda: {
            "jacobian": np.array([[0.3, 0.05], [-0.1, 0.25]]),
            "feature_weight": np.diag([1.0, 2.0]),
        },
    },
    "servoing.loop_poles": {
        "none": lambda: {"delay": 0.0},
        "long": lambda: {"gain": 0.9, "delay": 2.25},
    },
    "servoing.path_metrics": {"noisy": wandering},
    "servoing.step_metrics": {"noisy": measured("step", False), "wide": measured("step", True)},
    "servoing.point_jacobian": {
        "depths": lambda: {"depth": [500.0, 430.0], "pixel_size": (9.9, 8.3)},
    },
    "servoing.simulate": {
        "path": run_of(),
        "predicted": lambda: {**run_of()(), "controller": fuzz.predictive()},
        "slow": run_of(stage=servoing.Stage(60.0, step=0.5, travel=400.0)),
    },
    "servoing.Stage.move": {
        "moving": lambda: {
            "self": servoing.Stage(200.0, lag=0.05, step=0.3, travel=30.0),
            "position": np.array([3.0, -28.0]),
            "velocity": np.array([40.0, -20.0]),
            "command": np.array([300.0, -90.0]),
            "duration": 0.12,
        },
        "stiff": lambda: {"self": servoing.Stage(200.0), "command": np.array([300.0, -90.0])},
    },
    "servoing.Stage.quantized": {"coarse": lambda: {"self": servoing.Stage(200.0, step=0.7)}},
    "synthetic.InjectionScene.approach": {"pressed": pressed_scene},
    "synthetic.InjectionScene.depth": {"pressed": pressed_scene},
    "synthetic.InjectionScene.force": {"pressed": pressed_scene},
    "synthetic.InjectionScene.frame": {"pressed": pressed_scene},
    "synthetic.cell_image": {"293T": lambda: {"kind": "293T", "count": 4, "pixel_size": 0.3}},
    "synthetic.camera_frame": {"bright": lambda: {"gain": 1.4, "noise": 5.0}},
    "synthetic.embryo_image": {
        "plain": lambda: {
            "center": None,
            "tilt": -0.2,
            "probe": False,
            "blur": 2.0,
            "unevenness": 0.4,
        },
    },
    "synthetic.focal_stack": {
        "relief": lambda: {
            "height": np.add.outer(np.linspace(0, 2, 64), np.linspace(0, 1, 72)),
            "sharpest": 0.8,
            "positions": [0.0, 0.7, 2.0],
            "noise": 0.0,
        },
    },
    "synthetic.gripper_scene": {"narrow": lambda: {"gap": 60.0, "reach": 50, "pixel_size": 1.5}},
    "synthetic._gripper.GripperScene.frame": {
        "bright": lambda: {"shift": np.array([-5.3, 2.2]), "gain": 1.2, "noise": 4.0},
    },
    "synthetic.quadric_patch": {
        f"{k}": (lambda k=k: {"label": k, "half": 5, "radius": 9.0}) for k in (1, 2, 5, 6, 7, 8, 9)
    },
    "synthetic.render_circles": {
        "light": lambda: {"microscope": scope_of(), "imaging": LIGHT, "counts": (4, 3)},
        "all": lambda: {
            "microscope": scope_of(),
            "imaging": None,
            "counts": None,
            "rng": None,
            "pitch": 200.0,
            "radius": 60.0,
        },
    },
    "synthetic.render_squares": {
        "light": lambda: {"microscope": scope_of(), "imaging": LIGHT, "counts": (4, 3)},
        "all": lambda: {
            "microscope": scope_of(),
            "imaging": None,
            "counts": None,
            "rng": None,
            "side": 130.0,
        },
    },
    "synthetic.step": {"off": lambda: {"at": 0.3}},
    "synthetic.warped_pair": {
        "affine": lambda: {"warp": "affine"},
        "homography": lambda: {"warp": "homography", "gain": 0.9},
    },
    "synthetic.patchy_texture": {"wide": lambda: {"shape": (40, 50), "weakest": 0.3, "patch": 9.0}},
    "synthetic.sphere_on_plane": {
        "smooth": lambda: {"roughness": 0.0, "pixel_size": 0.5, "rng": None}
    },
    "synthetic.parabolic_cylinder": {"whole": lambda: {"width": None}},
    "synthetic.Embryo.outline": {"fine": lambda: {"spacing": 2.0}},
    "tracking.ESMTracker.track": {
        "homography": tracking("homography", lambda: texture_frame(2)),
        "affine": tracking("affine", lambda: texture_frame(2), smoothing=2.0),
        "translation": tracking("translation", lambda: texture_frame(2), levels=2),
        "covered": tracking("affine", covered),
        "masked": tracking(
            "homography",
            lambda: texture_frame(2),
            mask=np.add.outer(np.arange(28), np.arange(30)) > 9,
        ),
        "filtered": lambda: {
            "self": track_of("translation", 4, kalman=kalman(0)),
            "frame": texture_frame(4),
        },
        "lost": tracking("affine", lambda: texture_frame(2)[::-1, ::-1].copy()),
    },
    "tracking.KalmanFilter.predict": {"moving": lambda: {"self": kalman(3)}},
}


def seen_live() -> automation.LiveDepth:
    found = automation.LiveDepth(measure="sml", window=7)
    for z, frame in zip(POSITIONS, relief(), strict=True):
        found.push(frame, float(z))
    return found
