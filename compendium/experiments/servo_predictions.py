"""What the inference of §5.4 is worth: numbers predicted without themselves; calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import kstest

from compendium.experiments.servo_inference import (
    BLOCKS,
    NUMBERS,
    SCALES,
    Problem,
    places,
    printed,
)
from compendium.experiments.servo_loop import PATH_READINGS, STEP_READINGS, simulated
from compendium.experiments.servo_models import priors, settings
from compendium.experiments.servo_sampler import Posterior, infer

#: Quantiles of every interval here: 90 % lie between the ends.
QUANTILES = (0.05, 0.5, 0.95)
#: Predicted numbers drawn for each particle.
_DRAWS = 8
#: Data sets tried until one settles; of the prior's draws more than a third do.
_TRIES = 1000


def predicted(posterior: Posterior, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return draws of the number that a posterior was left without.

    Parameters
    ----------
    posterior : Posterior
        Of a problem whose `left_out` is not −1.
    rng : numpy.random.Generator
        Of all draws.

    Returns
    -------
    ndarray
        As many for each particle, s or µm. A run counts by what the other numbers of its experiment
        say, a reading by what those of all experiments of its kind do; the kernel is drawn, too.
    """
    problem, place = posterior.problem, posterior.problem.left_out
    (block,) = [b for b in range(len(BLOCKS)) if places(b).start <= place < places(b).stop]
    alike = [b for b in range(len(BLOCKS)) if (b < 2) == (block < 2) and b != block]
    others = np.sum(
        [problem.of_block(posterior.normal, b, rng, posterior.runs[b]) for b in alike], axis=0
    )
    found, kernels = problem.runs(posterior.normal, block, rng, posterior.runs[block])
    weight = kernels * np.exp(others - others.max(axis=1, keepdims=True))[:, None, :]
    weight = weight.reshape(len(weight), -1)
    numbers = found[..., place - places(block).start].reshape(len(weight), -1)
    told = weight.sum(axis=1) > 0  # where no run of a particle settled, nothing is known
    cumulative = np.cumsum(weight[told], axis=1)
    at = rng.random((len(cumulative), _DRAWS)) * cumulative[:, -1:]
    chosen = (cumulative[:, None, :] < at[:, :, None]).sum(axis=2)
    drawn = np.take_along_axis(numbers[told], chosen, axis=1).ravel()
    return drawn * np.exp(SCALES[place] * rng.standard_t(4, len(drawn)))


def left_out(model: str, place: int, seed: int, particles: int) -> list[float]:
    """Return `QUANTILES` of a printed number that the model is rerun without, s or µm."""
    posterior = infer(Problem(model, printed(), place), [seed, place], particles)
    drawn = predicted(posterior, np.random.default_rng([seed, place, 1]))
    return [float(value) for value in np.quantile(drawn, QUANTILES)]


def drawn_tables(model: str, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Draw unknown numbers from the prior, and the eighteen numbers that they might have given.

    Parameters
    ----------
    model : str
        One of `servo_models.MECHANISMS`.
    rng : numpy.random.Generator
        Of all draws.

    Returns
    -------
    normal : ndarray, shape (D,)
        The unknown numbers, standard normal.
    numbers : ndarray, shape (18,)
        In the order of `NUMBERS`; draws that never settle are drawn again.

    Raises
    ------
    RuntimeError
        If hardly any draw settles.
    """
    for _ in range(_TRIES):
        normal = rng.standard_normal((1, len(priors(model))))
        reading = {
            "step": rng.integers(len(STEP_READINGS)),
            "path": rng.integers(len(PATH_READINGS)),
        }
        parts = []
        for zoom, kind in BLOCKS:
            found = simulated(kind, settings(model, normal, zoom, kind), 1, rng)
            parts.append(found[0, 0, reading.get(kind, reading["path"])])
        numbers = np.concatenate(parts) * np.exp(SCALES * rng.standard_t(4, len(NUMBERS)))
        if np.isfinite(numbers).all():
            return normal[0], numbers
    raise RuntimeError(f"no draw of the prior of {model} settles")


def rank(model: str, seed: int | list[int], particles: int) -> list[float]:
    """Return where drawn unknowns lie in the posterior of their own numbers, 0 to 1 each.

    If the inference is right, these are uniform over many seeds (Talts et al. 2018).
    """
    rng = np.random.default_rng(seed)
    normal, numbers = drawn_tables(model, rng)
    found = infer(Problem(model, numbers), [*np.atleast_1d(seed), 1], particles)
    below = (found.normal < normal).sum(axis=0)
    return [float(each) for each in (below + rng.random(len(below))) / (len(found.normal) + 1)]


def uniform(ranks: NDArray) -> NDArray[np.float64]:
    """Return the probability, by Kolmogorov and Smirnov, of each column's ranks if uniform."""
    return np.array([kstest(column, "uniform").pvalue for column in np.transpose(ranks)])


@dataclass(frozen=True)
class Readings:
    """How likely the readings of the words are after all eighteen numbers.

    Attributes
    ----------
    steps, paths : ndarray
        Probabilities in the order of `STEP_READINGS` and `PATH_READINGS`.
    """

    steps: NDArray[np.float64]
    paths: NDArray[np.float64]


def readings(posterior: Posterior, rng: np.random.Generator) -> Readings:
    """Return the probabilities of the readings, the mean over the particles."""
    shares, runs = [], posterior.runs
    for blocks in (range(2), range(2, len(BLOCKS))):
        told = [posterior.problem.of_block(posterior.normal, b, rng, runs[b]) for b in blocks]
        logs = np.sum(told, axis=0)
        logs = logs[np.isfinite(logs).any(axis=1)]
        shares.append(np.exp(logs - logsumexp(logs, axis=1, keepdims=True)).mean(axis=0))
    return Readings(*shares)
