"""The inference of section 5.4 against known truth: likelihood, predictions, ranks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, t

from compendium.experiments import (
    servo_inference,
    servo_models,
    servo_predictions,
    servo_sampler,
)
from compendium.experiments.servo_inference import BLOCKS, NUMBERS, SCALES, Problem, places
from compendium.experiments.servo_loop import COLUMNS, EXPERIMENTS, STEP_READINGS, simulated
from compendium.experiments.servo_sampler import FIRST_RUNS
from compendium.ledger import claim

SIZE = len(servo_models.BASE)


def test_blocks_hold_every_number_once() -> None:
    order = [place for block in range(len(BLOCKS)) for place in range(18)[places(block)]]
    assert order == list(range(18))
    assert len(set(NUMBERS)) == 18
    for block, (zoom, kind) in enumerate(BLOCKS):
        for id in NUMBERS[places(block)]:
            assert f"/{zoom}/" in id
            assert ("table-5.3" in id) == (kind == "step")
            assert kind == "step" or f"/{kind}/" in id
    assert (servo_inference.printed() == [claim(id).value for id in NUMBERS]).all()


def test_what_runs_say_is_the_mean_of_their_kernels() -> None:
    """By SciPy's density, a number at a time; the one that is left out says nothing."""
    rng = np.random.default_rng(0)
    normal = np.zeros((3, SIZE))
    for block, place in ((0, 1), (1, -1), (4, 8)):
        problem = Problem("base", servo_inference.printed(), place)
        found, product = problem.runs(normal, block, rng, 5)
        assert found.shape[:2] == (3, 5)
        expected = np.ones(product.shape)
        for k, number in enumerate(range(18)[places(block)]):
            if number != place:
                off = np.log(found[..., k] / problem.numbers[number])
                expected *= t.pdf(off / SCALES[number], 4) / SCALES[number]
        np.testing.assert_allclose(product, np.nan_to_num(expected), rtol=1e-9)


def test_the_likelihood_sums_readings_and_multiplies_experiments() -> None:
    given = np.random.default_rng(1).standard_normal((8, 5, 32))
    said = [given[block][:, : 32 if block < 2 else 8] for block in range(8)]
    like = np.exp(given)
    expected = (like[0] * like[1]).mean(axis=1) * like[2:, :, :8].prod(axis=0).mean(axis=1)
    np.testing.assert_allclose(np.exp(servo_inference.log_likelihood(said)), expected)


@pytest.mark.parametrize("model", ["base", "start off the path", "own speeds at 4X"])
def test_a_number_touches_what_changes_with_it(model: str) -> None:
    """Simulated: the same draws with another number give other results there, and only there."""
    shared = servo_inference.touched(model)
    middle = np.full((1, len(shared)), 0.1)
    for block, (zoom, kind) in enumerate(BLOCKS):

        def runs(normal: np.ndarray, zoom: str = zoom, kind: str = kind) -> np.ndarray:
            rows = servo_models.settings(model, normal, zoom, kind)
            return simulated(kind, rows, 2, np.random.default_rng(4))

        for place, blocks in enumerate(shared):
            other = middle.copy()
            other[0, place] = -2.5  # a speed limit is felt where it is low
            same = np.array_equal(runs(middle), runs(other), equal_nan=True)
            assert same == (block not in blocks), (model, place, block)


def test_each_model_puts_its_numbers_where_the_loop_reads_them() -> None:
    normal = np.random.default_rng(0).standard_normal((4, 20))
    for model, added in servo_models.MECHANISMS.items():
        size = SIZE + len(added)
        for zoom, kind in BLOCKS:
            base = servo_models.settings("base", normal[:, :SIZE], zoom, kind)
            rows = servo_models.settings(model, normal[:, :size], zoom, kind)
            assert rows.shape == (4, len(COLUMNS))
            differ = {COLUMNS[k] for k in np.flatnonzero((rows != base).any(axis=0))}
            expected = {
                "stage jumps": {"jump rate", "jump size"},
                "lost frames": {"lost"},
                "dropped frames": {"dropped"},
                "bursts": {"burst rate", "burst size"},
                "one-axis noise": {"noise y"},
                "start off the path": {"start"},
                "own speeds at 4X": {"speed"} if zoom == "4X" and kind != "step" else set(),
            }.get(model, {model} if model != "base" else set())
            assert differ == expected
    middle = dict(
        zip(
            COLUMNS,
            servo_models.settings("base", np.zeros((1, SIZE)), "4X", "circle")[0],
            strict=True,
        )
    )
    assert middle["latency"] == pytest.approx(0.5 / 33)
    assert middle["speed"] == pytest.approx(np.sqrt(5 * 100))
    assert middle["scale"] == 1


def test_priors_keep_their_ranges_and_shapes() -> None:
    normal = norm.ppf((np.arange(1000) + 0.5) / 1000)
    for model in servo_models.MECHANISMS:
        for prior in servo_models.priors(model):
            value = prior.value(normal)
            assert (np.diff(value) > 0).all()
            if prior.shape == "normal":
                assert value.mean() == pytest.approx(prior.low, abs=1e-9)
                assert value.std() == pytest.approx(prior.high, rel=0.01)
                continue
            scaled = np.log(value / prior.low) if prior.shape == "log" else value - prior.low
            assert np.diff(scaled) == pytest.approx(np.diff(scaled)[0] * np.ones(999))
            assert value[0] == pytest.approx(prior.low, abs=0.002 * prior.high)
            assert value[-1] == pytest.approx(prior.high, rel=0.01)
    table = servo_models.table()
    assert len(table) == SIZE + sum(map(len, servo_models.MECHANISMS.values()))
    assert table["reason"].str.len().min() > 5


def test_a_drawn_table_is_found_again() -> None:
    """What its numbers tell, the particles gather around; a table is the same from its seed."""
    truth, numbers = servo_predictions.drawn_tables("base", np.random.default_rng(7))
    again = servo_predictions.drawn_tables("base", np.random.default_rng(7))
    np.testing.assert_array_equal(again[1], numbers)
    found = servo_sampler.infer(Problem("base", numbers), 0, 60)
    off = np.sqrt(((found.normal - truth) ** 2).mean(axis=0))
    # Before the numbers, particles are √(1 + truth²) away; limit, noise and three speeds are told.
    assert (off / np.sqrt(1 + truth**2))[[0, 3, 4, 5, 6]].mean() < 0.3


def test_ranks_are_of_the_drawn_unknowns(monkeypatch) -> None:
    truth = np.linspace(-1, 1, SIZE)

    def infer(problem: Problem, seed: list[int], particles: int) -> servo_sampler.Posterior:
        assert (seed, particles) == ([3, 7, 1], 99)
        normal = np.repeat(np.linspace(-2, 2, 99)[:, None], SIZE, axis=1)
        return servo_sampler.Posterior(problem, normal, 0.0, 0.0, FIRST_RUNS)

    monkeypatch.setattr(servo_predictions, "drawn_tables", lambda *_: (truth, np.ones(18)))
    monkeypatch.setattr(servo_predictions, "infer", infer)
    rank = servo_predictions.rank("base", [3, 7], 99)
    np.testing.assert_allclose(rank, (truth + 2) / 4, atol=0.02)


def test_a_number_is_predicted_by_the_others_of_its_experiment(monkeypatch) -> None:
    """Two kinds of runs; the printed settling time tells which, and so its accuracy."""
    numbers = servo_inference.printed()
    problem = Problem("base", numbers, left_out=1)

    def simulated(kind, rows, repetitions, rng):
        found = np.ones((len(rows), 2, len(STEP_READINGS), 3))
        found[:, 0] = numbers[0], 7.0, numbers[2]
        found[:, 1] = 10 * numbers[0], 70.0, numbers[2]
        return found

    monkeypatch.setattr(servo_inference, "simulated", simulated)
    monkeypatch.setattr(Problem, "of_block", lambda *_: np.zeros((5, len(STEP_READINGS))))
    posterior = servo_sampler.Posterior(problem, np.zeros((5, SIZE)), 0.0, 0.0, FIRST_RUNS)
    drawn = servo_predictions.predicted(posterior, np.random.default_rng(0))
    assert len(drawn) == 40
    assert np.median(drawn) == pytest.approx(7.0, rel=0.05)
    # Student's t with four degrees times the kernel's scale, in the logarithm.
    assert np.log(drawn).std() == pytest.approx(0.08 * np.sqrt(2), rel=0.5)


def test_uniform_ranks_are_told_from_others() -> None:
    rng = np.random.default_rng(0)
    even, narrow = rng.random(100), 0.5 + 0.4 * (rng.random(100) - 0.5)
    chance = servo_predictions.uniform(np.column_stack([even, narrow, even**2]))
    assert chance[0] > 0.05
    assert (chance[1:] < 1e-3).all()


def test_readings_are_shares_of_one() -> None:
    problem = Problem("base", servo_inference.printed())
    posterior = servo_sampler.Posterior(problem, np.zeros((6, SIZE)), 0.0, 0.0, 4 * FIRST_RUNS)
    found = servo_predictions.readings(posterior, np.random.default_rng(0))
    assert found.steps.sum() == pytest.approx(1)
    assert found.paths.sum() == pytest.approx(1)
    assert len(found.steps) == len(STEP_READINGS)
    assert EXPERIMENTS[0] == "step"
