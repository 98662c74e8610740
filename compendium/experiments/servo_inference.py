"""What the eighteen numbers of Tables 5.3 and 5.4 say of a model, estimated by simulation.

The eight experiments are independent given a model's numbers and the readings of the words. What an
experiment's numbers say is the mean over its repetitions of a product of kernels in log y; the
readings are summed exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from compendium import thesis
from compendium.experiments.section_5_4 import PATH_RESULTS, STEP_RESULTS
from compendium.experiments.servo_loop import COLUMNS, EXPERIMENTS, IGNORED, compiled, simulated
from compendium.experiments.servo_models import priors, settings
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

    def of_block(
        self, normal: NDArray, block: int, rng: np.random.Generator, runs: int
    ) -> NDArray[np.float64]:
        """Return what one experiment's numbers say, (N, readings), logarithms.

        That is of an unbiased estimate, the mean over so many runs of each row.
        """
        with np.errstate(divide="ignore"):
            return np.log(self.runs(normal, block, rng, runs)[1].mean(axis=1))

    def runs(
        self, normal: NDArray, block: int, rng: np.random.Generator, runs: int
    ) -> tuple[NDArray, NDArray]:
        """Return a block's runs as `simulated` does, and the product of each one's kernels."""
        zoom, kind = BLOCKS[block]
        rows = settings(self.model, normal, zoom, kind)
        found = simulated(kind, rows, runs, rng)
        at = places(block)
        used = np.arange(len(NUMBERS))[at] != self.left_out
        product = np.empty(found.shape[:3])
        _kernel_products(found, np.log(self.numbers[at]), SCALES[at], used, product)
        return found, product


@cache
def touched(model: str) -> tuple[tuple[int, ...], ...]:
    """Return, for each unknown number of a model, which of `BLOCKS` it has a part in."""
    size = len(priors(model))
    found: list[list[int]] = [[] for _ in range(size)]
    for block, (zoom, kind) in enumerate(BLOCKS):
        used = [name not in IGNORED[kind] for name in COLUMNS]
        rows = settings(model, np.vstack([np.zeros(size), np.eye(size)]), zoom, kind)[:, used]
        for place in np.flatnonzero((rows[1:] != rows[0]).any(axis=1)):
            found[place].append(block)
    return tuple(map(tuple, found))


def log_likelihood(said: Sequence[NDArray]) -> NDArray[np.float64]:
    """Return what all experiments say, from what each says by every reading; logarithms."""
    steps, paths = np.sum(said[:2], axis=0), np.sum(said[2:], axis=0)
    return _mean_of_readings(steps) + _mean_of_readings(paths)


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
