"""The inference of section 5.4 against known truth: evidence, posterior, predictions, ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm, t

from compendium.experiments import servo_inference, servo_models, servo_predictions
from compendium.experiments.servo_inference import BLOCKS, NUMBERS, SCALES, Problem, places
from compendium.experiments.servo_loop import COLUMNS, EXPERIMENTS, STEP_READINGS
from compendium.ledger import claim

SIZE = len(servo_models.BASE)


@dataclass(frozen=True)
class Known:
    """Two measurements of the first two unknowns with normal errors, estimated with noise."""

    model: str = "base"
    noise: float = 1.0

    def log_likelihood(self, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        exact = norm.logpdf(1.5, normal[:, 0], 0.3) + norm.logpdf(-0.5, normal[:, 1], 0.5)
        # The mean of exp(−σ²/2 + σ n) is one: the estimate has no bias.
        return exact + self.noise * rng.standard_normal(len(normal)) - self.noise**2 / 2


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_the_evidence_and_the_posterior_are_the_exact_ones(noise: float) -> None:
    """A normal prior and normal errors: both are known, with the likelihood noisy or not."""
    found = [servo_inference.infer(Known(noise=noise), seed, 400) for seed in range(4)]  # type: ignore[arg-type]
    exact = norm.logpdf(1.5, 0, np.hypot(1, 0.3)) + norm.logpdf(-0.5, 0, np.hypot(1, 0.5))
    # Four runs whose evidence varies by a tenth or two.
    assert np.mean([each.log_evidence for each in found]) == pytest.approx(exact, abs=0.25)
    normal = np.concatenate([each.normal for each in found])
    share = 1 / (1 + 0.3**2)
    assert normal[:, 0].mean() == pytest.approx(1.5 * share, abs=0.06)
    assert normal[:, 0].std() == pytest.approx(np.sqrt(1 - share), rel=0.2)
    assert normal[:, 2:].mean(axis=0) == pytest.approx(np.zeros(SIZE - 2), abs=0.25)
    assert normal[:, 2:].std(axis=0) == pytest.approx(np.ones(SIZE - 2), rel=0.2)


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
        found, product = problem.runs(normal, block, rng)
        expected = np.ones(product.shape)
        for k, number in enumerate(range(18)[places(block)]):
            if number != place:
                off = np.log(found[..., k] / problem.numbers[number])
                expected *= t.pdf(off / SCALES[number], 4) / SCALES[number]
        np.testing.assert_allclose(product, np.nan_to_num(expected), rtol=1e-9)


def test_the_likelihood_sums_readings_and_multiplies_experiments(monkeypatch) -> None:
    given = np.random.default_rng(1).standard_normal((8, 5, 32))

    def of_block(self, normal, block, rng):
        return given[block][:, : 32 if block < 2 else 8]

    monkeypatch.setattr(Problem, "of_block", of_block)
    found = Problem("base", servo_inference.printed()).log_likelihood(
        np.zeros((5, SIZE)), np.random.default_rng(0)
    )
    like = np.exp(given)
    expected = (like[0] * like[1]).mean(axis=1) * like[2:, :, :8].prod(axis=0).mean(axis=1)
    np.testing.assert_allclose(np.exp(found), expected)


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
    found = servo_inference.infer(Problem("base", numbers), 0, 50)
    off = np.sqrt(((found.normal - truth) ** 2).mean(axis=0))
    # Before the numbers, particles are √(1 + truth²) away; limit, noise and three speeds are told.
    assert (off / np.sqrt(1 + truth**2))[[0, 3, 4, 5, 6]].mean() < 0.3


def test_ranks_are_of_the_drawn_unknowns(monkeypatch) -> None:
    truth = np.linspace(-1, 1, SIZE)

    def infer(problem: Problem, seed: list[int], particles: int) -> servo_inference.Posterior:
        assert (seed, particles) == ([3, 7, 1], 99)
        normal = np.repeat(np.linspace(-2, 2, 99)[:, None], SIZE, axis=1)
        return servo_inference.Posterior(problem, normal, 0.0, 0.0)

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
    posterior = servo_inference.Posterior(problem, np.zeros((5, SIZE)), 0.0, 0.0)
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
    posterior = servo_inference.Posterior(
        Problem("base", servo_inference.printed()), np.zeros((6, SIZE)), 0.0, 0.0
    )
    found = servo_predictions.readings(posterior, np.random.default_rng(0))
    assert found.steps.sum() == pytest.approx(1)
    assert found.paths.sum() == pytest.approx(1)
    assert len(found.steps) == len(STEP_READINGS)
    assert EXPERIMENTS[0] == "step"


def test_no_draw_that_settles_is_refused() -> None:
    @dataclass(frozen=True)
    class Silent(Known):
        def log_likelihood(self, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
            return np.full(len(normal), -np.inf)

    with pytest.raises(ValueError, match="particles must be more than 5"):
        servo_inference.infer(Silent(), 0, 5)  # type: ignore[arg-type]
