"""Simulation-based inference from the eighteen numbers of Tables 5.3 and 5.4.

The eight experiments are independent given a model's numbers and the readings of the words. What an
experiment's numbers say is the mean over its repetitions of a product of kernels in log y; the
readings are summed exactly. The particles are moved by a density-tempered sampler with an unbiased
estimate of the likelihood (Duan and Fulop 2015): each particle keeps its estimate, each proposal
draws fresh noise, and the target and the evidence are those of the exact likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from compendium import thesis
from compendium.experiments.section_5_4 import PATH_RESULTS, STEP_RESULTS
from compendium.experiments.servo_loop import EXPERIMENTS, compiled, simulated
from compendium.experiments.servo_models import RARE, priors, settings
from compendium.ledger import claim

#: The experiments as (zoom, kind), steps first, and what each prints.
BLOCKS = tuple((zoom, "step") for zoom in thesis.ZOOMS) + tuple(
    (zoom, kind) for zoom in thesis.ZOOMS for kind in EXPERIMENTS[1:]
)
NUMBERS = tuple(
    f"table-5.3/{zoom}/{what}" if kind == "step" else f"table-5.4/{zoom}/{kind}/{what}"
    for zoom, kind in BLOCKS
    for what in (STEP_RESULTS if kind == "step" else PATH_RESULTS)
)
#: Scale of the kernel in log y: what a model of the loop leaves out, about a tenth; a settling time
#: is a count of frames and has half. Student's t with four degrees, so that no single number rules.
SCALE, SETTLING_SCALE = 0.08, 0.05
SCALES = np.array([SETTLING_SCALE if id.endswith("settling-time") else SCALE for id in NUMBERS])
#: Runs of a step, of a path, and of a path with a rare disturbance behind one estimate of the
#: likelihood: what is chance needs more than a mean of hundreds of frames. The logarithm then has a
#: deviation near one, where such samplers work best (benchmark of servo inference, "Noise").
STEP_RUNS, PATH_RUNS, RARE_PATH_RUNS = 48, 4, 12
#: Particles, moves after each warming, and share of the particles that a warming leaves effective.
PARTICLES, MOVES, SHARE = 500, 3, 0.5
#: Moves at the end.
LAST_MOVES = 4
#: Share of the proposals that adapting aims at, and the first length of a move.
ACCEPTED, FIRST_LENGTH = 0.25, 0.6


def printed() -> NDArray[np.float64]:
    """Return the eighteen numbers in the order of `NUMBERS`, s and µm."""
    return np.array([claim(id).value for id in NUMBERS])


def places(block: int) -> slice:
    """Return where a block's numbers stand in `NUMBERS`."""
    steps = min(block, 2)
    start = 3 * steps + 2 * (block - steps)
    return slice(start, start + (3 if block < 2 else 2))


@dataclass(frozen=True)
class Problem:
    """A model, and the numbers that it is to explain.

    Attributes
    ----------
    model : str
        One of `servo_models.MECHANISMS`.
    numbers : ndarray, shape (18,)
        In the order of `NUMBERS`.
    left_out : int
        Place of the number that is not used; −1 for none.
    """

    model: str
    numbers: NDArray[np.float64]
    left_out: int = -1

    def log_likelihood(self, normal: NDArray, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return an unbiased estimate's logarithm for each row of standard normal numbers."""
        blocks = [self.of_block(normal, block, rng) for block in range(len(BLOCKS))]
        steps, paths = np.sum(blocks[:2], axis=0), np.sum(blocks[2:], axis=0)
        return _mean_of_readings(steps) + _mean_of_readings(paths)

    def of_block(self, normal: NDArray, block: int, rng: np.random.Generator) -> NDArray:
        """Return what one experiment's numbers say, (N, readings), logarithms."""
        with np.errstate(divide="ignore"):
            return np.log(self.runs(normal, block, rng)[1].mean(axis=1))

    def runs(
        self, normal: NDArray, block: int, rng: np.random.Generator
    ) -> tuple[NDArray, NDArray]:
        """Return a block's runs as `simulated` does, and the product of each one's kernels."""
        zoom, kind = BLOCKS[block]
        rows = settings(self.model, normal, zoom, kind)
        path_runs = RARE_PATH_RUNS if self.model in RARE else PATH_RUNS
        found = simulated(kind, rows, STEP_RUNS if kind == "step" else path_runs, rng)
        at = places(block)
        used = np.arange(len(NUMBERS))[at] != self.left_out
        product = np.empty(found.shape[:3])
        _kernel_products(found, np.log(self.numbers[at]), SCALES[at], used, product)
        return found, product


def _mean_of_readings(by_reading: NDArray) -> NDArray:
    return logsumexp(by_reading, axis=1) - np.log(by_reading.shape[1])


@compiled
def _kernel_products(
    found: NDArray, logs: NDArray, scales: NDArray, used: NDArray, product: NDArray
) -> None:
    """Write the product over numbers of Student's t₄ densities in log y; 0 where one is NaN."""
    particles, repetitions, readings, numbers = found.shape
    for i in range(particles):
        for r in range(repetitions):
            for reading in range(readings):
                density = 1.0 if found[i, r, reading, 0] > 0 else 0.0
                if density > 0:
                    for n in range(numbers):
                        if used[n]:
                            off = (np.log(found[i, r, reading, n]) - logs[n]) / scales[n]
                            part = 1.0 + 0.25 * off * off
                            density *= 0.375 / (scales[n] * part * part * np.sqrt(part))
                product[i, r, reading] = density


@dataclass(frozen=True)
class Posterior:
    """What the numbers leave of a model's unknowns.

    Attributes
    ----------
    problem : Problem
        What was asked.
    normal : ndarray, shape (N, D)
        Particles of equal weight, as standard normal numbers a priori.
    log_evidence : float
        Logarithm of the numbers' density in log y under the model.
    accepted : float
        Share of the last moves that was accepted.
    """

    problem: Problem
    normal: NDArray[np.float64]
    log_evidence: float
    accepted: float


def infer(problem: Problem, seed: int | list[int], particles: int = PARTICLES) -> Posterior:
    """Warm particles from the prior to the posterior.

    Parameters
    ----------
    problem : Problem
        Model and numbers.
    seed : int or list of int
        Of all draws.
    particles : int
        How many.

    Returns
    -------
    Posterior
        Particles and evidence.

    Raises
    ------
    ValueError
        If no particle of the prior can give numbers at all.
    """
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((particles, len(priors(problem.model))))
    logs = problem.log_likelihood(normal, rng)
    alive = np.isfinite(logs)
    if not alive.any():
        raise ValueError(f"particles must be more than {particles}: no draw of the prior settles")
    heat, log_evidence, length, accepted = 0.0, float(np.log(alive.mean())), FIRST_LENGTH, 0.0
    chosen = _resampled(alive / alive.sum(), rng)
    normal, logs = normal[chosen], logs[chosen]
    while heat < 1:
        added = _warming(logs, 1 - heat)
        heat += added
        log_evidence += float(logsumexp(added * logs) - np.log(particles))
        chosen = _resampled(np.exp(added * logs - logsumexp(added * logs)), rng)
        normal, logs = normal[chosen], logs[chosen]
        for _ in range(MOVES if heat < 1 else LAST_MOVES):
            normal, logs, accepted = _move(problem, normal, logs, heat, length, rng)
            length = float(np.clip(length * np.exp(accepted - ACCEPTED), 0.05, 1.0))
    return Posterior(problem, normal, log_evidence, accepted)


def _warming(logs: NDArray, most: float) -> float:
    """Return how much warmer leaves `SHARE` of the particles effective."""

    def effective(added: float) -> float:
        weight = np.exp(added * (logs - logs.max()))
        return float(weight.sum() ** 2 / (weight**2).sum() / len(logs))

    if effective(most) >= SHARE:
        return most
    low, high = 0.0, most
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if effective(middle) > SHARE else (low, middle)
    return high


def _resampled(weight: NDArray, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return places drawn by weight, evenly spaced."""
    at = (np.arange(len(weight)) + rng.random()) / len(weight)
    return np.searchsorted(np.cumsum(weight) / weight.sum(), at).clip(max=len(weight) - 1)


def _move(
    problem: Problem,
    normal: NDArray,
    logs: NDArray,
    heat: float,
    length: float,
    rng: np.random.Generator,
) -> tuple[NDArray, NDArray, float]:
    """Propose towards and around the particles' own normal distribution; keep by Metropolis.

    ``x' = m + √(1 − length²) (x − m) + length · noise`` leaves N(m, C) as it is, so that the
    acceptance compares the target with that distribution.
    """
    mean, covariance = normal.mean(axis=0), np.cov(normal.T) + 1e-6 * np.eye(normal.shape[1])
    root = np.linalg.cholesky(covariance)
    noise = rng.standard_normal(normal.shape) @ root.T
    proposed = mean + np.sqrt(1 - length**2) * (normal - mean) + length * noise
    new_logs = problem.log_likelihood(proposed, rng)

    def log_target(x: NDArray, log_likelihood: NDArray) -> NDArray:
        off = np.linalg.solve(root, (x - mean).T)
        return heat * log_likelihood - (x**2).sum(axis=1) / 2 + (off**2).sum(axis=0) / 2

    gain = log_target(proposed, new_logs) - log_target(normal, logs)
    keep = np.log(rng.random(len(normal))) < gain
    return (
        np.where(keep[:, None], proposed, normal),
        np.where(keep, new_logs, logs),
        float(keep.mean()),
    )
