"""The compiled loop of section 5.4 is the library's, and each disturbance does what it says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from compendium import thesis
from compendium.experiments import section_5_4, servo_loop
from compendium.experiments.servo_loop import PATH_READINGS, STEP_READINGS
from microlib import servoing

CALM = {"saturation": 390.0, "scale": 1.0, "speed": 40.0, "size": 1.0, "height": 1.0}


def row(zoom: str = "1X", **given: float) -> np.ndarray:
    named = {name.replace("_", " "): value for name, value in given.items()}
    every = {"pixel": thesis.effective_pixel(zoom)} | CALM | named
    return np.array([every.get(name, 0.0) for name in servo_loop.COLUMNS])


def by_library(zoom: str, kind: str, settings: np.ndarray, seed: int) -> Any:
    """Return what `microlib.servoing.simulate` says of the same run."""
    at = dict(zip(servo_loop.COLUMNS, settings, strict=True))
    if kind == "step":
        path = section_5_4.STEP_PATH
    else:
        path = section_5_4.PATHS[kind](at["speed"], at["size"], at["height"])
    turn = at["angle"]
    jacobian = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return servoing.simulate(
        servoing.OptimalController(section_5_4.nominal_jacobian(zoom), **section_5_4.LAW),
        path[: servo_loop.MOST_FRAMES],
        jacobian=at["scale"] / at["pixel"] * jacobian,
        stage=servoing.Stage(saturation=at["saturation"], step=thesis.STAGE_STEP),
        camera=servoing.Camera(
            interval=thesis.FRAME_INTERVAL, latency=at["latency"], jitter=at["noise x"]
        ),
        rng=seed,
        start=(0.0, 0.0) if kind == "step" else None,
    )


@pytest.mark.parametrize("zoom", thesis.ZOOMS)
@pytest.mark.parametrize("kind", servo_loop.EXPERIMENTS)
@pytest.mark.parametrize(("latency", "noise"), [(0.0, 0.0), (0.01, 0.2), (0.04, 0.2)])
def test_the_loop_is_the_library_s(zoom: str, kind: str, latency: float, noise: float) -> None:
    """The same draws in the same order: rounding of features within 200 px, without noise or with.

    A latency over a frame, and one within it; an angle and a scale that the controller ignores.
    """
    settings = row(zoom, latency=latency, noise_x=noise, noise_y=noise, angle=0.02, scale=0.98)
    reference, measured = servo_loop.measured_once(kind, settings, np.random.default_rng(3))
    same = by_library(zoom, kind, settings, 3)
    np.testing.assert_allclose(reference, same.reference, rtol=0, atol=1e-10)
    np.testing.assert_allclose(measured, same.measured, rtol=0, atol=1e-10)


def test_a_step_is_measured_as_the_library_does() -> None:
    settings = row("4X", noise_x=0.15, noise_y=0.15, latency=0.01)
    found = servo_loop.simulated("step", settings[None], 1, np.random.default_rng(8))[0, 0]
    run = by_library("4X", "step", settings, 8)
    pixel = thesis.effective_pixel("4X")
    for (band, within, error, accuracy), (time, first, second) in zip(
        STEP_READINGS, found, strict=True
    ):
        if within == "distance within":
            same = servoing.step_metrics(
                run.time, run.measured * pixel, run.reference[0] * pixel, band=band
            )
            # The command came at any time of the frame before.
            assert 0 <= time - same.settling_time < thesis.FRAME_INTERVAL
            if error == "of the distance":
                assert second == pytest.approx(same.precision, rel=1e-9)
                if accuracy == "at settling":
                    assert first == pytest.approx(same.accuracy, rel=1e-9)
        off = np.abs(run.measured - run.reference) * pixel
        inside = (off <= band * 50 * pixel).all(axis=1)
        settled = round((time - time % thesis.FRAME_INTERVAL) / thesis.FRAME_INTERVAL)
        if within == "both axes within":
            assert inside[settled:].all()
            assert not inside[settled - 1]
        if error == "along x":
            assert second == pytest.approx(off[settled:, 0].std(), rel=1e-9)
            if accuracy == "mean after settling":
                assert first == pytest.approx(off[settled:, 0].mean(), rel=1e-9)


def test_a_step_that_never_settles_has_no_numbers() -> None:
    slow = row("1X", saturation=50.0)
    found = servo_loop.simulated("step", slow[None], 1, np.random.default_rng(0))
    assert np.isnan(found).all()


@pytest.mark.parametrize("kind", servo_loop.EXPERIMENTS[1:])
def test_a_path_is_measured_as_its_readings_say(kind: str) -> None:
    settings = row(noise_x=0.3, noise_y=0.1, latency=0.005)
    found = servo_loop.simulated(kind, settings[None], 1, np.random.default_rng(5))[0, 0]
    reference, measured = servo_loop.measured_once(kind, settings, np.random.default_rng(5))
    pixel = thesis.effective_pixel("1X")
    same, following = measured - reference, measured[:-1] - reference[1:]
    run = np.diff(reference, axis=0)
    run = np.vstack([run, run[-1]])
    across = (same[:, 1] * run[:, 0] - same[:, 0] * run[:, 1]) / np.hypot(*run.T)
    expected = []
    for off in (same, following):
        distance = np.hypot(*off.T)
        spread = np.sqrt(off.var(axis=0).sum())
        expected += [(distance.mean(), distance.std()), (distance.mean(), spread)]
        expected += [(np.abs(off[:, 0]).mean(), np.abs(off[:, 0]).std())]
    expected += [
        (np.abs(across).mean(), np.abs(across).std()),
        (np.abs(across).mean(), across.std()),
    ]
    assert len(expected) == len(PATH_READINGS)
    np.testing.assert_allclose(found, pixel * np.array(expected), rtol=1e-9)


@pytest.mark.parametrize("kind", servo_loop.EXPERIMENTS[1:])
def test_ten_seconds_are_like_the_whole_turn(kind: str) -> None:
    """Five times as slow as at 40 px/s, a path is cut; its numbers move by less than 8/3 %."""
    settings = row(noise_x=0.2, noise_y=0.2, speed=10.0)
    found = servo_loop.simulated(kind, settings[None], 40, np.random.default_rng(0))
    place = PATH_READINGS.index(("next reference", "of the distance"))
    cut = np.log(found[0, :, place]).mean(axis=0)
    assert len(servo_loop.measured_once(kind, settings, np.random.default_rng(0))[0]) == 300
    path = section_5_4.PATHS[kind](10.0, 1.0, 1.0)
    exact = section_5_4.Assumed(calibration=0.0, latency=0.0)
    seeds = [[1, draw] for draw in range(20)]
    whole = section_5_4.measured_in_runs(
        "1X", path, seeds, saturation=390.0, jitter=0.2, assumed=exact
    )
    off = np.linalg.norm(whole[:, :-1] - path[1:], axis=2) * thesis.effective_pixel("1X")
    same = np.log([off.mean(axis=1), off.std(axis=1)]).mean(axis=1)
    assert np.abs(cut - same).max() < 0.08 / 3


def deviation(seed: int = 1, **given: float) -> np.ndarray:
    """Return the deviation, px, of each axis about a slow circle's references."""
    settings = row("4X", **({"speed": 5.0} | given))
    reference, measured = servo_loop.measured_once("circle", settings, np.random.default_rng(seed))
    return (measured - reference)[5:].std(axis=0)


def test_stage_noise_is_in_micrometers() -> None:
    """What is seen of noise n is n_k − n_(k−1) + n_(k−1): the dead-beat loop removes the last."""
    assert deviation(stage_noise=1.55) == pytest.approx([np.sqrt(2), np.sqrt(2)], rel=0.2)


def test_one_axis_may_be_noisy_alone() -> None:
    quiet = deviation()[1]
    x, y = deviation(noise_x=1.0)
    assert x > 1
    assert y == pytest.approx(quiet, abs=1e-9)


def test_jumps_and_bursts_are_as_rare_as_they_are_said_to_be() -> None:
    for rate, size, factor in (("jump_rate", "jump_size", 1.0), ("burst_rate", "burst_size", 1.55)):
        settings = row("4X", speed=5.0, **{rate: 0.1, size: 15.5 / factor})
        reference, measured = servo_loop.measured_once("circle", settings, np.random.default_rng(2))
        far = np.hypot(*(measured - reference).T) > 2.0
        # A burst moves the stage away, too, and is seen twice; 300 frames, three deviations.
        assert 0.1 * 300 - 17 < far.sum() < (1 if rate == "jump_rate" else 2) * 0.1 * 300 + 17


def test_a_lost_frame_repeats_the_last_measurement() -> None:
    settings = row(noise_x=0.1, noise_y=0.1, lost=0.25)
    _, measured = servo_loop.measured_once("circle", settings, np.random.default_rng(2))
    repeated = (np.diff(measured, axis=0) == 0).all(axis=1).mean()
    assert repeated == pytest.approx(0.25, abs=0.1)  # 207 frames: three deviations are 0.09


def test_a_dropped_frame_leaves_no_trace() -> None:
    """Neither measured nor counted; the stage goes on at its speed, so that little is amiss."""
    settings = row("4X", noise_x=0.1, noise_y=0.1, dropped=0.25)
    reference, measured = servo_loop.measured_once("circle", settings, np.random.default_rng(2))
    missing = np.isnan(measured[:, 0])
    assert missing.mean() == pytest.approx(0.25, abs=0.1)
    found = servo_loop.simulated("circle", settings[None], 1, np.random.default_rng(2))[0, 0]
    distance = np.hypot(*(measured - reference).T)[~missing] * thesis.effective_pixel("4X")
    assert found[0] == pytest.approx([distance.mean(), distance.std()])
    step = row("4X", noise_x=0.1, noise_y=0.1, dropped=0.25)
    found = servo_loop.simulated("step", step[None], 1, np.random.default_rng(4))[0, 0]
    _, measured = servo_loop.measured_once("step", step, np.random.default_rng(4))
    off = np.hypot(*(measured - 50).T)
    place = STEP_READINGS.index((0.05, "distance within", "of the distance", "at settling"))
    settled = int(found[place, 0] / thesis.FRAME_INTERVAL)
    assert (off[settled:][np.isfinite(off[settled:])] <= 0.05 * 50 * np.sqrt(2)).all()
    pixel = thesis.effective_pixel("4X")
    assert found[place, 1:] == pytest.approx(
        [off[settled] * pixel, np.nanstd(off[settled:]) * pixel]
    )


def first_way(seed: int = 0, **given: float) -> float:
    """Return how far, µm along x, a saturated stage goes in the first frame of a step."""
    _, measured = servo_loop.measured_once("step", row(**given), np.random.default_rng(seed))
    return float(measured[1, 0] * thesis.effective_pixel("1X"))


def test_half_the_backlash_is_lost_at_first() -> None:
    whole = 390.0 * thesis.FRAME_INTERVAL
    assert first_way() == pytest.approx(whole, abs=thesis.STAGE_STEP)
    assert first_way(backlash=3.0) == pytest.approx(whole - 1.5, abs=thesis.STAGE_STEP)
    reference, measured = servo_loop.measured_once(
        "step", row(backlash=3.0), np.random.default_rng(0)
    )
    # The play is taken up once; then the loop knows no more of it.
    assert np.abs(measured[-1] - reference[-1]).max() < 0.02
    # On a circle an axis turns, and the play is taken up anew.
    assert deviation(backlash=3.0)[0] > 1.3 * deviation()[0]


def test_jitter_of_the_latency_adds_its_mean() -> None:
    whole = 390.0 * thesis.FRAME_INTERVAL
    assert first_way(latency=0.01) == pytest.approx(whole - 3.9, abs=thesis.STAGE_STEP)
    late = [whole - first_way(seed, latency_jitter=0.005) for seed in range(400)]
    # An exponential's mean of 400 draws is known to 5 %.
    assert np.mean(late) == pytest.approx(390 * 0.005, rel=0.15)
    assert np.std(late) == pytest.approx(390 * 0.005, rel=0.25)


def test_a_path_may_begin_away_from_its_start() -> None:
    """By two normal numbers, before any other is drawn; a step begins where it always does."""
    settings = row(start=12.0)
    reference, measured = servo_loop.measured_once("circle", settings, np.random.default_rng(9))
    away = 12.0 / thesis.effective_pixel("1X") * np.random.default_rng(9).standard_normal(2)
    np.testing.assert_allclose(measured[0] - reference[0], away)
    _, stepped = servo_loop.measured_once("step", settings, np.random.default_rng(9))
    assert (stepped[0] == 0).all()


def test_with_weights_in_micrometers_no_step_settles() -> None:
    """So that the sum over this reading has one term: even a tenth is not reached in the run."""
    slow = section_5_4.gains().query("unit == 'px/µm'")
    run = servo_loop.STEP_FRAMES * thesis.FRAME_INTERVAL
    assert len(slow) == 2
    # The slower axis has the larger weight; the table is of the faster.
    assert (np.log(10) * slow["time constant (s)"] > run).all()
