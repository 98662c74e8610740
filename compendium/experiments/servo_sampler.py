"""From the prior to the posterior of §5.4's unknown numbers, where likelihoods are only estimated.

A density-tempered sampler (Duan and Fulop 2015) in which every state of every chain counts
(waste-free: Dau and Chopin 2022). Each state keeps its estimates of what the experiments say, and
each proposal draws fresh noise, so that the target and the evidence are those of the exact
likelihood. An unknown number has a part in some of the experiments only: what is moved are the
numbers of the same experiments, and those experiments alone are simulated anew (block
pseudo-marginal: Tran et al. 2016). How many runs are behind an estimate follows from its noise,
which differs a hundredfold from table to table: too noisy, and a few lucky states carry all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from compendium.experiments.servo_inference import BLOCKS, Problem, log_likelihood, touched
from compendium.experiments.servo_loop import MOST_FRAMES, STEP_FRAMES
from compendium.experiments.servo_models import RAREST, RAREST_IN_STEPS

#: States, sweeps of a chain at each heat, and share of the states that a warming leaves effective.
#: Readings of the words make modes between which no chain moves, so that many chains count for
#: more than long ones.
PARTICLES, SWEEPS, SHARE = 480, 3, 0.5
#: Draws of the prior for each state: they cost little, and a mode is missed less easily.
DRAWS = 8
#: Deviation of the log likelihood at a heat: 1.0 to 1.7 is best for a chain (Doucet et al. 2015).
NOISE = 1.0
#: Runs of each experiment at first, and at most; what a run costs, in frames; how many times more
#: runs a heat may take than the one before, since noise far above one is not well told.
FIRST_RUNS = np.array([12 if kind == "step" else 2 for _, kind in BLOCKS])
MOST_RUNS = 64 * FIRST_RUNS
#: Times as many runs at first where one may show nothing of the disturbance: from few
#: runs, what is rare seems unlikely until the last heats, and the evidence comes late and varies.
RAREST_RUNS = 4
_COST = np.array([STEP_FRAMES if kind == "step" else MOST_FRAMES for _, kind in BLOCKS])
_GROWTH = 4
#: Share of the proposals that adapting aims at, and ends of a move's length.
ACCEPTED, LENGTHS = 0.15, (0.3, 1.0)


@dataclass(frozen=True)
class Posterior:
    """What the numbers leave of a model's unknowns.

    Attributes
    ----------
    problem : Problem
        What was asked.
    normal : ndarray, shape (N, D)
        States of equal weight, as standard normal numbers a priori; chain by chain in each sweep.
    log_evidence : float
        Logarithm of the numbers' density in log y under the model.
    accepted : float
        Share of the last moves that was accepted.
    runs : ndarray, shape (8,)
        Of each experiment, behind the last estimates.
    """

    problem: Problem
    normal: NDArray[np.float64]
    log_evidence: float
    accepted: float
    runs: NDArray[np.intp]


@dataclass(frozen=True)
class _States:
    """Unknown numbers (N, D) and what each of `BLOCKS` says of them, (N, readings) each."""

    normal: NDArray[np.float64]
    said: tuple[NDArray[np.float64], ...]

    @property
    def logs(self) -> NDArray[np.float64]:
        return log_likelihood(self.said)

    def at(self, places: NDArray) -> _States:
        return _States(self.normal[places], tuple(each[places] for each in self.said))


@dataclass(frozen=True)
class _Normal:
    """A normal distribution: mean (D,) and inverse covariance (D, D)."""

    mean: NDArray[np.float64]
    precision: NDArray[np.float64]

    def log_density(self, x: NDArray) -> NDArray[np.float64]:
        """Return the logarithm but for a constant."""
        off = x - self.mean
        return -np.einsum("ni,ij,nj->n", off, self.precision, off) / 2

    def proposed(
        self, x: NDArray, places: NDArray, length: float, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Draw some of the numbers anew, given the others, in a way that leaves this as it is.

        ``x' = m + √(1 − length²) (x − m) + length · noise`` leaves N(m, C) as it is; here m and C
        are those of the numbers at `places` given the rest.
        """
        rest = np.setdiff1d(np.arange(len(self.mean)), places)
        covariance = np.linalg.inv(self.precision[np.ix_(places, places)])
        slope = -self.precision[np.ix_(rest, places)] @ covariance
        middle = self.mean[places] + (x[:, rest] - self.mean[rest]) @ slope
        noise = rng.standard_normal(middle.shape) @ np.linalg.cholesky(covariance).T
        found = x.copy()
        found[:, places] = middle + np.sqrt(1 - length**2) * (x[:, places] - middle)
        found[:, places] += length * noise
        return found


def infer(problem: Problem, seed: int | list[int], particles: int = PARTICLES) -> Posterior:
    """Warm states from the prior to the posterior.

    Parameters
    ----------
    problem : Problem
        Model and numbers.
    seed : int or list of int
        Of all draws.
    particles : int
        How many states, of which as many are kept as `SWEEPS` divides.

    Returns
    -------
    Posterior
        States and evidence.

    Raises
    ------
    ValueError
        If no state of the prior can give numbers at all.
    """
    rng = np.random.default_rng(seed)
    every, runs = range(len(BLOCKS)), first_runs(problem.model)
    normal = rng.standard_normal((DRAWS * particles, len(touched(problem.model))))
    states = _States(normal, tuple(problem.of_block(normal, b, rng, runs[b]) for b in every))
    alive = np.isfinite(states.logs)
    if not alive.any():
        raise ValueError(f"particles must be more than {particles}: no draw of the prior settles")
    states, log_evidence, heat = states.at(alive), float(np.log(alive.mean())), 0.0
    parts = groups(problem.model)
    lengths = np.full(len(parts), LENGTHS[1])
    while heat < 1:
        logs = states.logs
        added = _warming(logs, 1 - heat, SHARE * min(particles, len(logs)))
        heat += added
        log_evidence += float(logsumexp(added * logs) - np.log(len(logs)))
        weight = np.exp(added * logs - logsumexp(added * logs))
        around = _fitted(states.normal, weight)
        states = states.at(_resampled(weight, particles // SWEEPS, rng))
        more = _needed(problem, states, runs, heat, rng)
        states, gained = _with_more(problem, states, runs, more, heat, rng)
        runs, log_evidence = more, log_evidence + gained
        chains = []
        for _ in range(SWEEPS):
            accepted = np.empty(len(parts))
            for k, (places, blocks) in enumerate(parts):
                proposed = around.proposed(states.normal, places, lengths[k], rng)
                states, accepted[k] = _moved(
                    problem, states, proposed, blocks, heat, around, runs, rng
                )
            lengths = np.clip(lengths * np.exp(accepted - ACCEPTED), *LENGTHS)
            chains.append(states)
        states = _States(
            np.concatenate([each.normal for each in chains]),
            tuple(np.concatenate([each.said[b] for each in chains]) for b in every),
        )
    return Posterior(problem, states.normal, log_evidence, float(accepted.mean()), runs)


def first_runs(model: str) -> NDArray[np.intp]:
    """Return how many runs of each experiment are behind the first estimates."""
    paths = np.array([kind != "step" for _, kind in BLOCKS])
    rare = (paths & (model in RAREST)) | (model in RAREST_IN_STEPS)
    return FIRST_RUNS * np.where(rare, RAREST_RUNS, 1)


def groups(model: str) -> list[tuple[NDArray[np.intp], tuple[int, ...]]]:
    """Return which unknown numbers are moved together: those of the same experiments; and these."""
    shared = touched(model)
    return [
        (np.array([place for place, blocks in enumerate(shared) if blocks == each]), each)
        for each in dict.fromkeys(shared)
    ]


def _moved(
    problem: Problem,
    states: _States,
    proposed: NDArray,
    blocks: tuple[int, ...],
    heat: float,
    around: _Normal,
    runs: NDArray,
    rng: np.random.Generator,
) -> tuple[_States, float]:
    """Keep proposals by Metropolis, with new estimates of the experiments that they change.

    Proposing leaves `around` as it is, so that the target is compared with that.
    """
    said = list(states.said)
    for block in blocks:
        said[block] = problem.of_block(proposed, block, rng, runs[block])
    new = _States(proposed, tuple(said))

    def log_target(these: _States) -> NDArray:
        x = these.normal
        return heat * these.logs - (x**2).sum(axis=1) / 2 - around.log_density(x)

    keep = np.log(rng.random(len(proposed))) < log_target(new) - log_target(states)
    chosen = tuple(
        np.where(keep[:, None], after, before) if block in blocks else before
        for block, (before, after) in enumerate(zip(states.said, said, strict=True))
    )
    normal = np.where(keep[:, None], proposed, states.normal)
    return _States(normal, chosen), float(keep.mean())


def _needed(
    problem: Problem, states: _States, runs: NDArray, heat: float, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Return how many runs of each experiment keep the noise at a heat to `NOISE`.

    The variance of a block is v/R for R runs that cost c each; the least Σ c R of all that add up
    to the same variance is at R ∝ √(v/c).
    """
    variance = np.empty(len(BLOCKS))
    for block in range(len(BLOCKS)):
        told = []
        for _ in range(2):
            said = list(states.said)
            said[block] = problem.of_block(states.normal, block, rng, runs[block])
            told.append(log_likelihood(said))
        with np.errstate(invalid="ignore"):
            apart = np.nan_to_num(np.abs(told[0] - told[1]), nan=np.inf)
        # Of a normal variable the quarter that is farthest is 1.15 deviations away; so are two
        # estimates by √2. The noise of the noisier states counts: there a chain would stick.
        variance[block] = min(np.quantile(apart, 0.75) / 1.15, 10.0) ** 2 / 2 * runs[block]
    least = np.sqrt(variance / _COST) * np.sqrt(variance * _COST).sum() * (heat / NOISE) ** 2
    wanted = np.ceil(np.minimum(least, _GROWTH * runs)).astype(int)
    return np.clip(wanted, runs, MOST_RUNS)


def _with_more(
    problem: Problem,
    states: _States,
    runs: NDArray,
    more: NDArray,
    heat: float,
    rng: np.random.Generator,
) -> tuple[_States, float]:
    """Add runs to the estimates, weigh by what they change, and return what the evidence gains."""
    said = list(states.said)
    for block in map(int, np.flatnonzero(more > runs)):
        added = int(more[block] - runs[block])
        new = problem.of_block(states.normal, block, rng, added) + np.log(added)
        said[block] = np.logaddexp(said[block] + np.log(runs[block]), new) - np.log(more[block])
    change = heat * (log_likelihood(said) - states.logs)
    gained = float(logsumexp(change) - np.log(len(change)))
    weight = np.exp(change - logsumexp(change))
    return _States(states.normal, tuple(said)).at(_resampled(weight, len(change), rng)), gained


def _fitted(normal: NDArray, weight: NDArray) -> _Normal:
    """Return mean and covariance of weighted states, the latter drawn towards its diagonal.

    As much as if as many states as there are numbers knew of no correlation: of few states alone,
    a covariance is too narrow in some direction.
    """
    size = normal.shape[1]
    mean = weight @ normal
    covariance = (normal - mean).T @ ((normal - mean) * weight[:, None])
    apart = size / (size + 1 / (weight**2).sum())
    covariance = (1 - apart) * covariance + apart * np.diag(np.diag(covariance) + 1e-6)
    return _Normal(mean, np.linalg.inv(covariance))


def _warming(logs: NDArray, most: float, states: float) -> float:
    """Return how much warmer leaves so many states effective."""

    def effective(added: float) -> float:
        weight = np.exp(added * (logs - logs.max()))
        return float(weight.sum() ** 2 / (weight**2).sum())

    if effective(most) >= states:
        return most
    low, high = 0.0, most
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if effective(middle) > states else (low, middle)
    return high


def _resampled(weight: NDArray, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return places drawn by weight, evenly spaced."""
    at = (np.arange(count) + rng.random()) / count
    return np.searchsorted(np.cumsum(weight) / weight.sum(), at).clip(max=len(weight) - 1)
