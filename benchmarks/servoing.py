"""The innovation gain of a controller, and the loop over images beside the one over coordinates.

Run with ``python -m benchmarks servoing``; it takes about a minute of one core.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.report import Limits, Tables, rms
from compendium import thesis
from compendium.experiments.microscope import turned
from compendium.experiments.section_5_3 import WINDOWS
from compendium.experiments.section_5_4 import LAW, PATHS, STEP_PATH
from microlib.servoing import (
    Camera,
    OptimalController,
    PredictiveController,
    Stage,
    path_metrics,
    simulate,
)
from microlib.synthetic import gripper_scene
from microlib.tracking import ESMTracker

INTERVAL = thesis.FRAME_INTERVAL
CAMERA = Camera(interval=INTERVAL, latency=0.8 * INTERVAL, jitter=0.15)
STAGE = Stage(saturation=400.0)
#: px/µm at both zooms, and window of the tracker in px.
ZOOMS = {zoom: (1 / thesis.effective_pixel(zoom), WINDOWS[zoom]) for zoom in thesis.ZOOMS}
PREDICTIVE = LAW | {"delay": CAMERA.latency, "saturation": STAGE.saturation}
SEEDS = 50
TASKS = {
    "step of 50 px": STEP_PATH,
    "circle, 40 px/s": PATHS["circle"](40.0, 1.0, 1.0),
    "square, 40 px/s": PATHS["square"](40.0, 1.0, 1.0),
    "sinusoid, 15 px/s": PATHS["sinusoid"](30.0, 1.0, 1.0),  # 15 px/s along x
}


def run(controller: Any, scale: float, task: str, seed: int, **options: object) -> Any:
    """Simulate one task with a Jacobian that the controller knows to 1 % and 1°."""
    rng = np.random.default_rng(seed)
    angle, size = rng.normal(0, np.deg2rad(1.0)), rng.normal(1, 0.01)
    return simulate(
        controller,
        TASKS[task],
        jacobian=turned(angle, size * scale, mirrored=False),
        stage=STAGE,
        camera=CAMERA,
        rng=rng,
        start=(0.0, 0.0),
        **options,
    )


def innovation_gains() -> pd.DataFrame:
    """True error (µm) of the predictive controller over its innovation gain."""
    rows = []
    for share in (0.1, 0.2, 0.3, 0.4, 0.6, 1.0):
        row: dict[str, object] = {"innovation gain": share}
        for zoom, (scale, _) in ZOOMS.items():
            for task in list(TASKS)[1:]:
                errors = []
                for seed in range(SEEDS):
                    controller = PredictiveController(
                        scale * np.eye(2), **PREDICTIVE, innovation_gain=share
                    )
                    result = run(controller, scale, task, seed)
                    errors.append(path_metrics(result.feature, result.reference).accuracy / scale)
                row[f"{task.split(',')[0]}, {zoom}"] = round(float(np.mean(errors)), 3)
        rows.append(row)
    return pd.DataFrame(rows)


def modes() -> pd.DataFrame:
    """The loop over rendered, tracked frames beside the one over coordinates."""
    rows = []
    for zoom, (scale, size) in ZOOMS.items():
        for task in TASKS:
            rng = np.random.default_rng(0)
            scene = gripper_scene(rng, pixel_size=1 / scale, reach=110)
            # The path is centered in the frame, so that the window stays inside it.
            away = -np.rint((TASKS[task].min(axis=0) + TASKS[task].max(axis=0)) / 2)
            box = scene.box(size, away)
            origin = np.array(box[:2]) + (size - 1) / 2
            tracker = ESMTracker(scene.frame(away, rng), box, "translation")

            def observer(feature: NDArray, seen=(scene, away, rng, tracker, origin)) -> NDArray:
                scene, away, rng, tracker, origin = seen
                track = tracker.track(scene.frame(feature + away, rng))
                return np.full(2, np.nan) if track.lost else track.center - origin

            controller = OptimalController(scale * np.eye(2), **LAW)
            rendered = run(controller, scale, task, 1, observer=observer)
            fast = run(controller, scale, task, 1)
            apart = np.linalg.norm(rendered.feature - fast.feature, axis=1)
            noise = rendered.measured - rendered.feature
            rows.append(
                {
                    "zoom": zoom,
                    "task": task,
                    "lost frames": int(np.isnan(rendered.measured).any(axis=1).sum()),
                    "RMS distance of both (px)": round(rms(apart), 3),
                    "mean error, rendered (px)": round(_error(rendered), 3),
                    "mean error, fast (px)": round(_error(fast), 3),
                    "bias of the tracker (px)": round(float(np.linalg.norm(noise.mean(0))), 3),
                }
            )
    return pd.DataFrame(rows)


def _error(result: Any) -> float:
    late = slice(40, None)
    return path_metrics(result.feature[late], result.reference[late]).accuracy


NOTE = f"""\
The simulated camera takes 33 frames per second, and a command takes effect 0.8 frames after its
exposure. The stage moves at up to 400 µm/s in increments of 50 nm. The image has a jitter of
{CAMERA.jitter} px, and the calibration is known to 1 % and 1°. The mean errors over the innovation
gain are means over {SEEDS} seeds. The errors are those of the true feature.
"""


def main() -> tuple[Tables, Limits]:
    return {"Innovation gain": innovation_gains(), "Rendered and fast loop": modes()}, []
