"""Every drawing of `compendium.figures` on small inputs that are alike in nothing.

No two numbers, sides or names of an input are equal unless they have to be, so that exchanged ones
show. `test_figures.py` draws each of them.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

mpl.use("agg")
import matplotlib.pyplot as plt

from compendium import thesis
from compendium.experiments.section_5_6 import compare_shape
from compendium.figures import (
    automation,
    calibration,
    dimple,
    focus_stages,
    mechanics,
    overview,
    panels,
    servoing,
    shape_from_focus,
    sketches,
    surfaces,
    workstation,
)

RUN: Any = SimpleNamespace(
    time=np.array([0.0, 0.1, 0.2]),
    reference=np.array([[5.0, 7.0], [15.0, 7.5], [25.0, 9.0]]),
    feature=np.array([[4.0, 6.0], [9.0, 6.5], [14.0, 6.7]]),
    measured=np.array([[4.1, 6.2], [9.2, 6.4], [14.3, 6.6]]),
    command=np.array([[100.0, -3.0], [50.0, -2.0], [20.0, -1.0]]),
)


def picture(rows: int, cols: int, seed: float = 0.0) -> NDArray:
    """Return grey levels in which no two places are alike."""
    y, x = np.mgrid[:rows, :cols]
    return 128 + 100 * np.sin(0.7 * x + 0.11 * y * x + seed) * np.cos(0.4 * y - seed)


def heights(rows: int, cols: int) -> NDArray:
    y, x = np.mgrid[:rows, :cols]
    return 40 * np.exp(-(((x - 0.4 * cols) / 6) ** 2) - ((y - 0.6 * rows) / 4) ** 2) + 0.3 * x


def types(rows: int, cols: int, *kinds: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[:rows, :cols]
    return np.array(kinds, np.uint8)[(x // 3 + 2 * (y // 4)) % len(kinds)]


def microscope() -> Figure:
    figure, axes = plt.subplots()
    world = np.array([[300, 500], [0, -100.0]])
    calibration.draw_microscope(axes, thesis.microscope("circle-1X"), world)
    return figure


def injection() -> Figure:
    log = pd.DataFrame(
        {"time_s": [0.0, 1.0, 2.0], "true_force": [0.0, 5.5, 9.5], "true_depth": [0.0, 4.5, 8.5]}
        | {"force_uN": [np.nan, 5.0, 9.0], "depth_um": [np.nan, 4.0, 8.0]}
    )
    pictures = [picture(4, 5, k) for k in range(3)]
    return automation.draw_injection({"log": log, "contact": 1.0, "pictures": pictures})


def focal_length_study() -> Figure:
    study = {"tilt": [0.0, 1.0], "lost": [1.0, 0.0], "bound": [0.3, 0.2], "stated": [0.31, 0.21]}
    return calibration.draw_focal_length_study(
        pd.DataFrame(study | {"scatter": [0.32, 0.22], "M": [1e-4, 2e-4]})
    )


def scene() -> Any:
    truth = SimpleNamespace(dimple_radius=200.0)
    image = picture(768, 1024).astype(np.uint8)
    return SimpleNamespace(image=image, center=(512.4, 300.6), pixel_size=4.0, embryo=truth)


def boundary() -> Any:
    x = np.arange(400.0, 625.0, 5.0)
    return SimpleNamespace(
        points=np.column_stack([x, 300 + 0.001 * (x - 500) ** 2]),
        under_probe=np.abs(x - 512) < 20,
        probe=SimpleNamespace(tip=(512.0, 330.0)),
        x=np.arange(50.0, 260.0),
        y=780 + 72 * np.sin(np.arange(210.0) / 41),
    )


def rendered_outline() -> Figure:
    columns, profile = np.linspace(60, 250, 20), 780 + 70 * np.sin(np.linspace(0, 5, 20))
    middle = vars(scene()) | {"center": (189.0, 60.0)}
    return dimple.draw_rendered_outline(
        SimpleNamespace(**middle), boundary(), columns, thesis.outline_curve(), profile
    )


def image_study() -> Figure:
    study = pd.DataFrame(
        {"depth": [20.0, 40.0], "thesis": [2.0, 1.5], "fitted": [1.3, 1.4]}
        | {"low": [0.4, 1.35], "high": [3.6, 1.42]}
    )
    return dimple.draw_image_study(study)


def felt() -> pd.DataFrame:
    names = ["time", "force", "low", "high", "elastic"]
    return pd.DataFrame(
        [[1.0, 70.0, 68.0, 73.0, 75.0], [8.0, 97.0, 92.0, 99.0, 150.0]], columns=names
    )


def posterior() -> Figure:
    moduli = {"capsule": np.geomspace(0.5, 0.9, 200), "disc": np.geomspace(1.5, 2.5, 50)}
    return mechanics.draw_posterior({name: pd.DataFrame({"E": e}) for name, e in moduli.items()})


def eight_types() -> Figure:
    return sketches.draw_types({f"type {k}": (picture(9, 9), k) for k in range(1, 9)})


def label_maps() -> Figure:
    labels = (picture(30, 40) % 9 + 1).astype(np.uint8)
    return sketches.draw_label_maps({"one": labels, "other": labels})


def stability() -> Figure:
    delays, gains = np.linspace(0, 1, 5), np.linspace(0.1, 2, 7)
    moduli = pd.DataFrame(gains[:, None] * (0.9 + 0.3 * delays), gains, delays)
    loops = pd.DataFrame({"delay": [0.2, 0.7], "gain": [1.9, 0.4], "decays": [False, True]})
    return servoing.draw_stability(moduli, loops, 0.99)


def kalman_step() -> Figure:
    names = ["frame", "true", "measured", "predicted", "predicted_std", "estimated"]
    rows = [[1, 0.0, 0.5, 0.0, 30.0, 0.5, 1.0], [2, 2.0, 2.5, 1.0, 2.0, 2.2, 0.9]]
    track = pd.DataFrame(rows, columns=[*names, "estimated_std"])
    return servoing.draw_kalman_step(track, 1.0)


def track(shift: float = 0.0) -> Any:
    square = np.array([[40.0, 20.0], [60.0, 22.0], [58.0, 42.0], [38.0, 43.0]])
    corners = square + np.array([shift, shift / 2])
    return SimpleNamespace(corners=corners, center=corners.mean(axis=0))


def esm_step() -> Figure:
    errors = {"template": [9.0, 1.0, 0.5], "image": [9.0, 4.0, 2.0], "mean": [9.0, 0.1, 0.01]}
    return servoing.draw_esm_step(pd.DataFrame(errors))


def focus() -> Figure:
    scene: Any = SimpleNamespace(frames=np.stack([picture(20, 30, k) for k in range(4)]))
    pictures = (picture(20, 30, 9), heights(20, 30), {"one": 0, "other": 3})
    return shape_from_focus.draw_focus(scene, *pictures, pixel_size=2.0, turned=True)


def patterns() -> Figure:
    grid = np.stack(np.meshgrid([0, 1, 4, 6], [0, 4, 6]), axis=-1).reshape(-1, 2)
    examples: Any = {
        name: SimpleNamespace(
            image=picture(90, 80, k),
            found=SimpleNamespace(points=10.0 * grid[k:] + k, grid=grid[k:]),
        )
        for k, name in enumerate(("circle-1X", "circle-4X", "square-1X", "square-4X"))
    }
    return workstation.draw_patterns(examples)


def printed_and_recomputed() -> Figure:
    ids = ["table-5.3/1X/accuracy", "table-5.3/4X/accuracy", "table-5.3/4X/precision"]
    table = pd.DataFrame({"claim": ids, "value": [9.0, 1.5, 0.5], "input": [False, True, False]})
    table = table.assign(low=[8.0, 1.4, 0.3], high=[12.0, 1.7, 0.9])
    return workstation.draw_printed_and_recomputed({"one": table, "two": table[:2]})


def in_percent() -> Figure:
    panels = {}
    for column in ("circle-1X", "square-1X"):
        ids = [f"table-5.1/{column}/{name}" for name in ("M", "d")]
        table = pd.DataFrame({"claim": ids, "input": [True, False], "value": [1.6, 8e4]})
        panels[column] = table.assign(low=[1.5, 7e4], high=[1.7, 9e4])
    return workstation.draw_printed_and_recomputed(panels, percent=True)


CURVE = thesis.outline_curve
CASES: dict[str, Callable[[], Figure]] = {
    "automation.draw_injection": injection,
    "calibration.draw_microscope": microscope,
    "calibration.draw_focal_length_study": focal_length_study,
    "dimple.draw_dimple_section": lambda: dimple.draw_dimple_section(246.95, 121.22, 25.0),
    "dimple.draw_printed_outline": lambda: dimple.draw_printed_outline(CURVE()),
    "dimple.draw_embryo": lambda: dimple.draw_embryo(scene()),
    "dimple.draw_outline_steps": lambda: dimple.draw_outline_steps(
        scene(), picture(768, 1024, 1.0), boundary()
    ),
    "dimple.draw_rendered_outline": rendered_outline,
    "dimple.draw_image_study": image_study,
    "dimple.draw_relaxing_force": lambda: dimple.draw_relaxing_force(felt()),
    "mechanics.draw_posterior": posterior,
    "mechanics.draw_shape": lambda: mechanics.draw_shape(CURVE(), compare_shape(CURVE())),
    "focus_stages.draw_focus_stages": focus_stages.draw_focus_stages,
    "overview.draw_system": overview.draw_system,
    "overview.draw_scale": overview.draw_scale,
    "panels.images": lambda: panels.images({"one": picture(9, 9), "other": picture(9, 9)})[0],
    "sketches.draw_cells": lambda: sketches.draw_cells(np.random.default_rng(0)),
    "sketches.draw_egg": lambda: sketches.draw_egg(np.random.default_rng(0)),
    "sketches.draw_label_maps": label_maps,
    "sketches.draw_solids": sketches.draw_solids,
    "sketches.draw_types": eight_types,
    "servoing.draw_esm_step": esm_step,
    "servoing.draw_kalman_step": kalman_step,
    "servoing.draw_loop": servoing.draw_loop,
    "servoing.draw_path_runs": lambda: servoing.draw_path_runs({"circle": RUN, "square": RUN}),
    "servoing.draw_stability": stability,
    "servoing.draw_step_runs": lambda: servoing.draw_step_runs({"1X": RUN, "4X": RUN}, 0.05),
    "shape_from_focus.draw_focus": focus,
    "shape_from_focus.draw_thresholds": shape_from_focus.draw_thresholds,
    "shape_from_focus.draw_types-ball": lambda: shape_from_focus.draw_types(
        {"found": types(180, 180, 1, 5), "clean": types(180, 180, 5, 9)}, ball=True
    ),
    "surfaces.draw_lens": surfaces.draw_lens,
    "surfaces.draw_sinking_stage": surfaces.draw_sinking_stage,
    "workstation.draw_blur_study": lambda: workstation.draw_blur_study(
        pd.DataFrame({"circles": [0.01, 0.02], "squares": [0.1, 0.2], "other": [1, 2]}, [0.5, 3.0])
    ),
    "workstation.draw_patterns": patterns,
    "workstation.draw_printed_and_recomputed": printed_and_recomputed,
    "workstation.draw_printed_and_recomputed-percent": in_percent,
    "workstation.draw_speed_study": lambda: workstation.draw_speed_study(
        pd.DataFrame({"with": [1.0, 0.5], "without": [0.9, 0.0]}, [200.0, 1500.0])
    ),
    "workstation.draw_tracks": lambda: workstation.draw_tracks(
        [(f"t = {k}", picture(90, 160, k).astype(np.uint8), track(7 * k)) for k in range(4)]
    ),
    "workstation.draw_workstation": workstation.draw_workstation,
}
