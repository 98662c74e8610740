"""The sampler of section 5.4 against known truth: evidence, posterior, moves, and runs by noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.stats import norm

from compendium.experiments import servo_models, servo_sampler
from compendium.experiments.servo_inference import BLOCKS, Problem, log_likelihood, printed
from compendium.experiments.servo_loop import MOST_FRAMES
from compendium.experiments.servo_sampler import FIRST_RUNS, MOST_RUNS, NOISE

SIZE = len(servo_models.BASE)


@dataclass(frozen=True)
class Known(Problem):
    """Two measurements of two unknowns with normal errors; estimates of one path are noisy."""

    model: str = "base"
    numbers: np.ndarray = field(default_factory=printed)
    noise: float = 0.0

    def of_block(
        self, normal: np.ndarray, block: int, rng: np.random.Generator, runs: int
    ) -> np.ndarray:
        exact = np.zeros(len(normal))
        if block == 2:  # the first unknown has a part in the experiments at 1X
            exact = norm.logpdf(1.5, normal[:, 0], 0.03)
            # The mean of exp(−σ²/2 + σ n) is one: the estimate has no bias.
            spread = self.noise * np.sqrt(FIRST_RUNS[2] / runs)
            exact += spread * rng.standard_normal(len(normal)) - spread**2 / 2
        if block == 5:
            exact = norm.logpdf(-0.5, normal[:, 1], 0.05)
        return exact[:, None]


@pytest.mark.parametrize("noise", [0.0, 1.5])
def test_the_evidence_and_the_posterior_are_the_exact_ones(noise: float) -> None:
    """A normal prior and normal errors: both are known, with the likelihood noisy or not."""
    found = [servo_sampler.infer(Known(noise=noise), seed, 360) for seed in range(4)]
    exact = norm.logpdf(1.5, 0, np.hypot(1, 0.03)) + norm.logpdf(-0.5, 0, np.hypot(1, 0.05))
    # The mean of four runs; one varies by 0.14, or 0.26 with noise.
    assert np.mean([each.log_evidence for each in found]) == pytest.approx(exact, abs=0.25)
    normal = np.concatenate([each.normal for each in found])
    share = 1 / (1 + 0.03**2)
    assert normal[:, 0].mean() == pytest.approx(1.5 * share, abs=0.01)
    assert normal[:, 0].std() == pytest.approx(np.sqrt(1 - share), rel=0.2)
    assert normal[:, 2:].mean(axis=0) == pytest.approx(np.zeros(SIZE - 2), abs=0.25)
    assert normal[:, 2:].std(axis=0) == pytest.approx(np.ones(SIZE - 2), rel=0.2)
    # A deviation of 1.5 at first asks for (1.5 / 1)² times the runs, and its median for no more.
    wanted = FIRST_RUNS[2] * max(1.0, (noise / NOISE) ** 2)
    assert np.median([each.runs[2] for each in found]) == pytest.approx(wanted, rel=0.3)
    assert all((np.delete(each.runs, 2) == np.delete(FIRST_RUNS, 2)).all() for each in found)


def test_what_is_moved_together_has_the_same_experiments() -> None:
    for model in servo_models.MECHANISMS:
        parts = servo_sampler.groups(model)
        places = np.concatenate([each for each, _ in parts])
        assert sorted(places) == list(range(len(servo_models.priors(model))))
        assert sum(len(blocks) == len(BLOCKS) for _, blocks in parts) == 1
    names = [prior.name for prior in servo_models.priors("base")]
    assert ["speed on the sinusoid", "sinusoid height"] in [
        [names[place] for place in each] for each, _ in servo_sampler.groups("base")
    ]


def test_what_a_run_may_not_show_has_more_runs_at_first() -> None:
    steps, paths = [12] * 2, [2] * 6
    assert servo_sampler.first_runs("lost frames").tolist() == steps + paths
    for model in servo_models.RAREST:
        assert servo_sampler.first_runs(model).tolist() == steps + [8] * 6
        # Once a run, or at the least rate less than once in a path of three hundred frames.
        rates = [p for p in servo_models.priors(model) if p.name.endswith("rate")]
        assert all(rate.low * MOST_FRAMES < 1 for rate in rates)
        assert rates or model in ("start off the path", "dropped frames")
    for model in servo_models.RAREST_IN_STEPS:
        assert servo_sampler.first_runs(model).tolist() == [48] * 2 + [8] * 6


@pytest.mark.parametrize("length", [0.3, 1.0])
def test_a_proposal_leaves_the_normal_distribution_as_it_is(length: float) -> None:
    """Mean and covariance of 40000 draws, known to 2 %; numbers that are not moved stay."""
    rng = np.random.default_rng(0)
    mean, root = np.array([1.0, -2.0, 0.5]), np.array([[1.0, 0, 0], [0.8, 0.6, 0], [-0.5, 0.5, 1]])
    around = servo_sampler._Normal(mean, np.linalg.inv(root @ root.T))
    x = mean + rng.standard_normal((40000, 3)) @ root.T
    moved = around.proposed(x, np.array([0, 2]), length, rng)
    assert (moved[:, 1] == x[:, 1]).all()
    assert moved.mean(axis=0) == pytest.approx(mean, abs=0.03)
    assert np.cov(moved.T) == pytest.approx(root @ root.T, abs=0.04)
    # Given the rest, a draw keeps √(1 − length²) of what it was.
    inner = np.linalg.inv(np.linalg.inv(root @ root.T)[np.ix_([0, 2], [0, 2])])
    apart = np.cov((moved - x).T)[np.ix_([0, 2], [0, 2])]
    assert apart == pytest.approx(2 * (1 - np.sqrt(1 - length**2)) * inner, abs=0.05)


def test_runs_that_are_added_count_like_the_first() -> None:
    """Two runs that say a, four that say b: (2a + 4b) / 6, and evidence by what that changes."""
    first, later = np.array([1.0, 3.0, 0.0]), np.array([2.0, 0.5, 1.0])

    @dataclass(frozen=True)
    class Given(Known):
        def of_block(
            self, normal: np.ndarray, block: int, rng: np.random.Generator, runs: int
        ) -> np.ndarray:
            assert (block, runs) == (3, 4)
            return np.log(later)[:, None]

    with np.errstate(divide="ignore"):
        said = [np.zeros((3, 1))] * 3 + [np.log(first)[:, None]] + [np.zeros((3, 1))] * 4
    states = servo_sampler._States(np.zeros((3, SIZE)), tuple(said))
    alive = states.at(np.array([0, 1]))
    later = later[:2]
    runs, more = np.full(8, 2), np.array([2, 2, 2, 6, 2, 2, 2, 2])
    rng = np.random.default_rng(0)
    new, gained = servo_sampler._with_more(Given(), alive, runs, more, 0.5, rng)
    pooled = (2 * first[:2] + 4 * later) / 6
    assert gained == pytest.approx(np.log(np.mean(np.sqrt(pooled / first[:2]))))
    assert set(np.round(np.exp(log_likelihood(new.said)), 9)) <= set(np.round(pooled, 9))


def test_noise_beyond_all_runs_has_the_most() -> None:
    states = servo_sampler._States(np.zeros((40, SIZE)), (np.zeros((40, 1)),) * 8)
    runs, rng = FIRST_RUNS, np.random.default_rng(0)
    for _ in range(6):
        runs = servo_sampler._needed(Known(noise=1e3), states, runs, 1.0, rng)
    assert runs[2] == MOST_RUNS[2]
    assert (np.delete(runs, 2) == np.delete(FIRST_RUNS, 2)).all()


def test_no_draw_that_settles_is_refused() -> None:
    @dataclass(frozen=True)
    class Silent(Known):
        def of_block(
            self, normal: np.ndarray, block: int, rng: np.random.Generator, runs: int
        ) -> np.ndarray:
            return np.full((len(normal), 1), -np.inf)

    with pytest.raises(ValueError, match="particles must be more than 6"):
        servo_sampler.infer(Silent(), 0, 6)
