"""The experiments on small inputs and few seeds, whose results are written down.

What `servo_record` reads is a file that is made anew by itself: it is not held here.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd

from compendium import thesis
from compendium.experiments import (
    chapter_2,
    chapter_2_tracking,
    chapter_3,
    chapter_4,
    chapter_6_force,
    injection,
    live_depth,
    microscope,
    paths,
    section_5_2,
    section_5_3,
    section_5_4,
    section_5_5,
    section_5_6,
    section_5_6_mechanics,
    servo_explanations,
    servo_inference,
    servo_loop,
    servo_models,
    servo_predictions,
    servo_sampler,
)
from microlib.calibration import calibrate
from microlib.membrane import SmallSlopeWarning
from microlib.microscope import Microscope
from tests.snapshots import describe_data

#: One text a module.
FOLDER = Path(__file__).parent / "experiments"
EXPERIMENTS = (
    *(chapter_2, chapter_2_tracking, chapter_4, chapter_6_force, live_depth, microscope),
    *(section_5_2, section_5_3, section_5_4, section_5_5, section_5_6, section_5_6_mechanics),
)
SCOPE = Microscope(159000, 100000, 62893, -8e-10, 1.58, 0.02, 3.07, 30.0, -50.0)


def small(module: Any, make: Callable[[], object], **constants: object) -> Callable[[], object]:
    """Run an experiment with other constants of its module."""

    def made() -> object:
        with patch.multiple(module, **constants):
            return make()

    return made


def noisy_points() -> tuple[np.ndarray, np.ndarray]:
    world = chapter_2.grid_in_view(SCOPE)
    return world, SCOPE.project(world) + np.random.default_rng(1).normal(0, 0.1, world.shape)


def steps() -> pd.DataFrame:
    fit = calibrate(
        *noisy_points(),
        focal_length=SCOPE.focal_length,
        pixel_size=SCOPE.pixel_size,
        image_size=SCOPE.image_size,
    )
    return chapter_2.calibration_steps(SCOPE, np.arange(7) + 0.5, fit)


@cache
def target() -> chapter_2_tracking.Target:
    return chapter_2_tracking.render_target(1)


@cache
def draws() -> dict[str, list[section_5_2.CalibrationDraw]]:
    return {
        column: [section_5_2.calibration_draw(column, [3, draw]) for draw in range(2)]
        for column in ("square-4X",)
    }


STATION = section_5_4.Workstation(
    saturation={"1X": 390.0, "4X": 172.0},
    jitter=0.12,
    path_speed={"circle": 40.0, "square": 32.0, "sinusoid": 27.0},
    seed=7,
)
OTHER = replace(
    STATION,
    jitter=0.2,
    assumed=section_5_4.Assumed(latency=0.03, size=1.2, height=0.8, faster=2.0, shakier=1.5),
)
PATH = paths.circle_path(20.0, 80.0, thesis.FRAME_INTERVAL)[:40]


def ran() -> Any:
    return STATION.run("4X", PATH, draw=2)


@cache
def ridge_height() -> np.ndarray:
    """The shape of section 5.5's ridge on uneven ground."""
    height = section_5_5.render_ridge(1).height
    y, x = np.indices(height.shape)
    return height + 3 * np.sin(x / 17) * np.cos(y / 23)


@cache
def ball_depth() -> np.ndarray:
    away = section_5_5.from_ball_center() * section_5_5.BALL_PIXEL
    cap = np.sqrt(np.clip(section_5_5.BALL_RADIUS**2 - away**2, 0, None))
    return cap + np.random.default_rng(6).normal(0, 1.0, cap.shape)


def rig(seed: int, **options: Any) -> dict[str, object]:
    made = injection.make_rig(seed, **options)
    tip = np.add(made.scene.contact, [0.0, 4.0])
    return {
        "known": made.known,
        "target": made.target,
        "jacobian": made.jacobian,
        "rupture": made.scene._rupture,
        "truth": made.truth(made.workstation.stage.position()),
        "frame": made.scene.frame(tip),
    }


def normal(model: str) -> np.ndarray:
    """Three draws of a model's unknown numbers."""
    return np.random.default_rng(4).standard_normal((3, len(servo_models.priors(model))))


def of_models(zoom: str, kind: str) -> dict[str, np.ndarray]:
    return {
        model: servo_models.settings(model, normal(model), zoom, kind)
        for model in servo_models.MECHANISMS
    }


def measured(kind: str) -> dict[str, np.ndarray]:
    return {
        model: servo_loop.simulated(kind, given, 2, np.random.default_rng(9))
        for model, given in of_models("4X", kind).items()
    }


def predicted(place: int) -> np.ndarray:
    """What a few states say of a number, and what other runs of its experiments say of them."""
    numbers = servo_inference.printed() * np.linspace(0.9, 1.1, 18)
    states = servo_sampler.Posterior(
        servo_inference.Problem("base", numbers, place), normal("base"), 0.0, 0.2, np.full(8, 60)
    )
    return servo_predictions.predicted(states, np.random.default_rng(place))


def study() -> pd.DataFrame:
    rng = np.random.default_rng(8)
    depth = np.tile([40.0, 60.0, 80.0], 4)
    return pd.DataFrame(
        {"depth": depth, "force": depth**3 / 3000, "modulus": 1.3}
        | {"thesis": rng.normal(1.6, 0.1, 12), "fitted": rng.normal(1.3, 0.05, 12)}
        | {"low": rng.normal(1.2, 0.02, 12), "high": rng.normal(1.4, 0.02, 12)}
    )


CASES: dict[str, Callable[[], object]] = {
    "chapter_2.grid_in_view": lambda: chapter_2.grid_in_view(SCOPE, 333.0),
    "chapter_2.tilted": lambda: chapter_2.tilted(SCOPE, 3.0),
    "chapter_2.calibration_steps": steps,
    "chapter_2.residuals_by_focal_length": small(
        chapter_2,
        lambda: chapter_2.residuals_by_focal_length(SCOPE, 0.03, np.random.default_rng(2)),
        VALLEY_TILTS=(2.0, 20.0),
        RATIOS=(0.6, 1.0, 1.5),
    ),
    "chapter_2.focal_length_study": small(
        chapter_2,
        lambda: chapter_2.focal_length_study(SCOPE, 0.03, 3, np.random.default_rng(2)),
        STUDY_TILTS=(0.0, 10.0),
        PARALLEL_RUNS=1,
    ),
    "chapter_2.jacobian_comparison": lambda: chapter_2.jacobian_comparison(
        SCOPE, (700.0, 400.0, SCOPE.translation[2])
    ),
    "chapter_2.simulated_loops": small(
        chapter_2,
        lambda: chapter_2.simulated_loops(0.03, 3),
        DELAYS=(0.5, 1.4),
        GAINS=(0.7, 1.5),
    ),
    "chapter_2_tracking.render_target": target,
    "chapter_2_tracking.corners": lambda: chapter_2_tracking.corners(target().warp),
    "chapter_2_tracking.warped": lambda: chapter_2_tracking.warped(target().image, target().warp),
    "chapter_2_tracking.align": lambda: chapter_2_tracking.align(target(), (0.3, 0.7), 3),
    "chapter_2_tracking.errors_by_gradient": lambda: chapter_2_tracking.errors_by_gradient(
        target(), 2
    ),
    "chapter_2_tracking.kalman_step": lambda: chapter_2_tracking.kalman_step(
        4, interval=0.04, acceleration=900.0, noise=0.7
    ),
    "chapter_3.labels_by_name": chapter_3.labels_by_name,
    "chapter_3.surface_types": lambda: sorted(chapter_3.surface_types()),
    "chapter_3.window_divisors": chapter_3.window_divisors,
    "chapter_4.modulus_ratio": lambda: [
        chapter_4.modulus_ratio(disc, 0.4) for disc in chapter_4.DISCS
    ],
    "chapter_6_force.elastic_push": lambda: chapter_6_force.elastic_push(np.linspace(0, 9, 20)),
    "chapter_6_force.true_force": lambda: chapter_6_force.true_force(np.linspace(0, 9, 20)),
    "injection.make_rig": lambda: rig(5),
    "injection.make_rig-other": lambda: rig(6, rupture=False, radius=560.0),
    "live_depth.frames_of": lambda: {
        name: live_depth.frames_of(name, 2)[::9] for name in live_depth.SCENES
    },
    "live_depth.saved": small(
        live_depth,
        lambda: live_depth.saved(20),
        SHAPE=(40, 40),
        SCENES={"step": live_depth.SCENES["step"]},
    ),
    "live_depth.small_part": lambda: live_depth.small_part(np.zeros((100, 120))),
    "microscope.turned": lambda: [
        microscope.turned(0.3, 1.7, mirrored) for mirrored in (True, False)
    ],
    "microscope.reach": lambda: microscope.reach("simulated", 4),
    "microscope.reach-velocity": lambda: microscope.reach("simulated", 5, drive="velocity"),
    "paths.circle_path": lambda: paths.circle_path(30.0, 40.0, 0.05),
    "paths.square_path": lambda: paths.square_path(30.0, 40.0, 0.05),
    "paths.sinusoid_path": lambda: paths.sinusoid_path(60.0, 9.0, 40.0, 0.05),
    "paths.sinusoid_path-periods": lambda: paths.sinusoid_path(60.0, 9.0, 40.0, 0.05, periods=3.0),
    "section_5_2.photograph": lambda: {
        column: section_5_2.photograph(column, np.random.default_rng(4))
        for column in ("circle-4X", "square-1X")
    },
    "section_5_2.dependent_entries": lambda: {
        column: section_5_2.dependent_entries(column) for column in thesis.COLUMNS
    },
    "section_5_2.calibration_draw": lambda: draws()["square-4X"][0],
    "section_5_2.over_draws": lambda: section_5_2.over_draws([3.0, 4.0, 4.5, 7.0]),
    "section_5_2.over_positive_draws": lambda: section_5_2.over_positive_draws([3.0, 4.0, 7.0]),
    "section_5_2.recovered_parameters": lambda: section_5_2.recovered_parameters(draws()),
    "section_5_2.pattern_errors": lambda: section_5_2.pattern_errors(draws()),
    "section_5_2.beside_print": lambda: section_5_2.beside_print(
        section_5_2.pattern_errors(draws())
    ),
    "section_5_2.printed_means": section_5_2.printed_means,
    "section_5_2.squares_over_circles": lambda: section_5_2.squares_over_circles(
        section_5_2.printed_means()
    ),
    "section_5_2.coverage": lambda: section_5_2.coverage(draws(), 6, 4),
    "section_5_2.blur_study": lambda: section_5_2.blur_study(1, [1.0, 2.5]),
    "section_5_2.corner_shift": lambda: section_5_2.corner_shift("square-4X"),
    "section_5_3.gripper_tracks": lambda: section_5_3.gripper_tracks(3),
    "section_5_3.largest_error": lambda: [
        section_5_3.largest_error(250.0, [2, 0], predict) for predict in (True, False)
    ],
    "section_5_3.fastest_followed": lambda: section_5_3.fastest_followed(
        pd.Series([1.0, 1.0, 0.9, 1.0], index=[100.0, 200.0, 300.0, 400.0])
    ),
    "section_5_4.gains": section_5_4.gains,
    "section_5_4.table": STATION.table,
    "section_5_4.path": lambda: {
        f"{name} {zoom}": OTHER.path(name, zoom)
        for name in section_5_4.PATHS
        for zoom in thesis.ZOOMS
    },
    "section_5_4.run": ran,
    "section_5_4.run-other": lambda: OTHER.run("1X", PATH, draw=1),
    "section_5_4.path_errors": lambda: [
        station.path_errors(zoom, "sinusoid", 2)
        for station in (STATION, OTHER)
        for zoom in thesis.ZOOMS
    ],
    "section_5_4.step": lambda: [STATION.step("1X", 3), OTHER.step("4X", 0)],
    "section_5_4.path_error": lambda: section_5_4.path_error("4X", ran(), 2),
    "section_5_4.lag": lambda: section_5_4.lag("4X", ran()),
    "section_5_4.median_and_ends": lambda: section_5_4.median_and_ends(
        np.array([3.0, np.nan, 1.0, 8.0, 5.5])
    ),
    "section_5_4.nearest": lambda: section_5_4.nearest(
        np.array([1.0, 2.0, 3.0, 4.0]), [0.9, 0.7, np.nan, 0.4], 0.65
    ),
    "section_5_4.within": lambda: section_5_4.within(
        np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.3, 0.5, 0.7, 0.8]), 0.65
    ),
    "section_5_4.step_table": lambda: section_5_4.step_table(STATION, 3),
    "section_5_4.path_table": lambda: section_5_4.path_table(STATION, 2),
    "section_5_4.over_images": lambda: section_5_4.over_images(STATION, "4X", PATH[:8]),
    "section_5_4.step_frames": lambda: section_5_4.step_frames(STATION, ran())[0][::9],
    "section_5_4.explanations": lambda: section_5_4.explanations(
        3,
        section_5_4.SettlingTimes(
            np.array([100.0, 400.0]),
            np.array([2.0, 1.0]),
            {"1X": 390.0, "4X": 172.0},
            np.array([0.0, 0.1]),
            np.array([1.0, 2.0]),
            0.05,
            {"1X": 1.0, "4X": 1.0},
        ),
        draws=4,
    ),
    "section_5_4.saturated_share": lambda: section_5_4.saturated_share(STATION, 2),
    "section_5_4.printed_in_pixels": section_5_4.printed_in_pixels,
    "section_5_4.printed_ratios": section_5_4.printed_ratios,
    "section_5_4.compare_controllers": lambda: section_5_4.compare_controllers(STATION, 1),
    "section_5_5.thesis_curvature": lambda: [
        section_5_5.thesis_curvature(ridge_height()[:40, :50], corrected=corrected)
        for corrected in (True, False)
    ],
    "section_5_5.thesis_labels": lambda: section_5_5.thesis_labels(ridge_height()[40:90, 60:]),
    "section_5_5.inside_ridge": section_5_5.inside_ridge,
    "section_5_5.from_ball_center": section_5_5.from_ball_center,
    "section_5_5.ridge_sentences": lambda: section_5_5.ridge_sentences(
        ridge_height(), section_5_5.thesis_labels(ridge_height())
    ),
    "section_5_5.ball_sentences": lambda: section_5_5.ball_sentences(
        section_5_5.thesis_labels(ball_depth())
    ),
    "section_5_5.ball_labels_by_window": lambda: section_5_5.ball_labels_by_window(
        section_5_5.render_ball(2), (5, 9)
    ),
    "section_5_5.ball_shape": lambda: section_5_5.ball_shape(ball_depth()),
    "section_5_5.steepest_step": lambda: section_5_5.steepest_step(section_5_5.render_ridge(1)),
    "section_5_5.render_ball": lambda: section_5_5.render_ball(2),
    "section_5_6.rounding_draws": lambda: section_5_6.rounding_draws(2, 12),
    "section_5_6.rendered_embryo": lambda: section_5_6.rendered_embryo(np.random.default_rng(2)),
    "section_5_6.image_study": lambda: section_5_6.image_study(np.random.default_rng(2), 1, 2),
    "section_5_6.force_sequence": lambda: section_5_6.force_sequence(
        np.random.default_rng(2), np.array([1.0, 2.5])
    ),
    "section_5_6.rounding_reach": section_5_6.rounding_reach,
    "section_5_6.read_off": lambda: section_5_6.read_off(0.3),
    "section_5_6.printed_dimple": section_5_6.printed_dimple,
    "section_5_6.probe_half_widths": lambda: section_5_6.probe_half_widths(247.0, 121.0),
    "section_5_6.compare_shape": lambda: section_5_6.compare_shape(thesis.outline_curve()),
    "section_5_6.table_5_7": lambda: section_5_6.table_5_7(np.random.default_rng(3), study(), 40),
    "section_5_6_mechanics.shape_misfits": lambda: section_5_6_mechanics.shape_misfits(
        thesis.outline_curve()
    ),
    "section_5_6_mechanics.lengths": lambda: [
        section_5_6_mechanics._lengths(
            "capsule", "hooke", {"load": 0.05, "slenderness": 0.04, "inflation": 1.02}
        ),
        section_5_6_mechanics._lengths(
            "disc", "neo-hooke", {"load": 0.05, "slenderness": 0.1, "pressure": 0.3}
        ),
    ],
    "section_5_6_mechanics.fit_shoulder": lambda: section_5_6_mechanics.fit_shoulder(
        thesis.outline_curve()
    ),
    "section_5_6_mechanics.crest_reach": lambda: section_5_6_mechanics.crest_reach(
        thesis.outline_curve()
    ),
    "servo_explanations.path_numbers": lambda: [
        servo_explanations.path_numbers(STATION, zoom, name, {"stage noise": 0.4}, 2)
        for zoom, name in (("1X", "circle"), ("4X", "square"))
    ],
    "servo_inference.printed": servo_inference.printed,
    "servo_inference.touched": lambda: {
        model: [list(each) for each in servo_inference.touched(model)]
        for model in servo_models.MECHANISMS
    },
    "servo_loop.simulated-step": lambda: measured("step"),
    "servo_loop.simulated-square": lambda: measured("square"),
    "servo_loop.simulated-sinusoid": lambda: measured("sinusoid"),
    "servo_models.settings-step": lambda: of_models("1X", "step"),
    "servo_models.settings-circle": lambda: of_models("4X", "circle"),
    "servo_models.table": servo_models.table,
    "servo_predictions.drawn_tables": lambda: servo_predictions.drawn_tables(
        "stage jumps", np.random.default_rng(1)
    ),
    "servo_predictions.predicted": lambda: [predicted(place) for place in (2, 9)],
    "servo_predictions.uniform": lambda: servo_predictions.uniform(
        np.random.default_rng(2).random((40, 3)) ** 1.2
    ),
}


def told(name: str) -> str:
    """Run a case in this process and return what comes of it."""
    with contextlib.ExitStack() as stack:
        for module in EXPERIMENTS:
            if hasattr(module, "in_processes"):
                stack.enter_context(patch.object(module, "in_processes", in_turn))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore", SmallSlopeWarning)
        return "\n".join(describe_data(CASES[name](), "gives")) + "\n"


def in_turn(function: Callable[..., object], arguments: Iterable[tuple]) -> list[object]:
    return [function(*each) for each in arguments]
