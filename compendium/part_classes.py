"""Learn what tells parts apart and write it beside the method: ``make parts``.

Draws the parts of `compendium.part_shapes` as height maps with noise, with smooth errors, and
through focus; describes each as `recognize_part` does; fits a small network and, for each kind, the
spread of its descriptions. The same seed and the same library give the same file.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize

import microlib
from compendium import part_shapes
from microlib.curvature import PART_KINDS, surface_curvature
from microlib.curvature._descriptor import Description, describe
from microlib.curvature._grid import on_grid
from microlib.curvature._recognition import probabilities, standardized
from microlib.focus import depth_from_focus
from microlib.synthetic import focal_stack, mixed_texture

SEED = 318
PATH = Path(microlib.__file__).parent / "curvature" / "_part_classes.json"
#: Examples of each kind and of each other shape, without focus and through it.
EACH = (400, 130, 200, 60)
#: Units of the hidden layer, networks whose mean counts, and the penalty of the weights: chosen on
#: examples of other seeds, where half or twice of each changed less than one in a hundred.
HIDDEN, NETS, DECAY = 24, 3, 3e-4
#: Axes of the distance, and share of a kind's own examples within its reach.
AXES, REACH = 20, 0.998
#: Sides of the maps, px, of those through focus, and threshold over the part's |H|, from and to.
SIDES, FOCUS_SIDES, RATIOS = (64, 161), (112, 145), (0.02, 2.0)
#: Standard errors that make the threshold of the labels, and the standard error of H on the flat
#: for heights of unit noise and pixel, with the windows of 7 px.
ERRORS = 3.5
FLAT_ERROR = float(surface_curvature(np.zeros((13, 13)), 1.0, noise=1.0).mean_error[6, 6])

Rng = np.random.Generator


def noisy(part: part_shapes.Part, rng: Rng, ratio: float) -> tuple[NDArray, float]:
    """Return heights in px with white noise, and its deviation, from threshold over |H|."""
    n = len(part.height)
    sigma = ratio * part.bend / n / (ERRORS * FLAT_ERROR)
    return n * part.height + sigma * rng.standard_normal((n, n)), sigma


def wavy(part: part_shapes.Part, rng: Rng) -> tuple[NDArray, None]:
    """Return heights in px with errors that are alike over a few pixels."""
    n = len(part.height)
    error = gaussian_filter(rng.standard_normal((n, n)), rng.uniform(0.7, 2.5))
    size = 10 ** rng.uniform(-1.7, -0.4)
    return n * part.height + size * error / error.std(), None


def focused(part: part_shapes.Part, rng: Rng) -> tuple[NDArray, float | None]:
    """Return heights in px found from a rendered focal stack."""
    z = len(part.height) * part.height
    # Steeper than a step or so a pixel, no depth from focus is of use.
    step = max(np.ptp(z) / rng.uniform(6, 14), 0.006 * len(z))
    positions = np.arange(z.min() - 3 * step, z.max() + 3 * step, step)
    stack = focal_stack(
        mixed_texture(z.shape, rng),
        z,
        positions,
        blur_rate=rng.uniform(0.7, 1.2) / step,
        noise=rng.uniform(0.5, 3.0),
        rng=rng,
    )
    found = depth_from_focus(stack, positions)
    told = float(np.nanmedian(found.uncertainty)) if rng.random() < 0.5 else None
    return found.depth, told


def example(kind: str, rng: Rng, *, by_focus: bool) -> Description:
    """Draw a part, measure it, through focus or not, and describe it."""
    if by_focus:
        z, told = focused(part_shapes.draw(kind, int(rng.integers(*FOCUS_SIDES)), rng), rng)
    else:
        part = part_shapes.draw(kind, int(rng.integers(*SIDES)), rng)
        if rng.random() < 0.8:
            z, sigma = noisy(part, rng, 10 ** rng.uniform(*np.log10(RATIOS)))
            told = sigma if rng.random() < 0.5 else None
        else:
            z, told = wavy(part, rng)
    grid = on_grid(z, 1.0, told)
    return describe(grid.height, grid.pixel_size, grid.noise)


def examples(each: tuple[int, int, int, int]) -> tuple[NDArray, NDArray, list[str]]:
    """Return descriptions (m, features), the number of each one's class, and the features' names.

    `each` counts the examples of a known kind and of another shape without focus, and the same two
    through focus.
    """
    rows, classes = [], []
    for number, kind in enumerate((*part_shapes.KNOWN, *part_shapes.OTHERS)):
        other = kind not in part_shapes.KNOWN
        for by_focus in (False, True):
            for seed in range(each[2 * by_focus + other]):
                rng = np.random.default_rng([SEED, number, seed, by_focus])
                found = example(kind, rng, by_focus=by_focus)
                rows.append(list(found.features.values()))
                classes.append(min(number, len(PART_KINDS)))
    return np.array(rows), np.array(classes), list(found.features)


def fit_network(unit: NDArray, classes: NDArray, seed: int) -> dict[str, NDArray]:
    """Fit a network with one hidden layer by its cross entropy with a penalty of its weights."""
    rng = np.random.default_rng(seed)
    wanted = np.eye(len(PART_KINDS) + 1)[classes]
    shapes = {
        "inner": (unit.shape[1], HIDDEN),
        "inner_bias": (HIDDEN,),
        "outer": (HIDDEN, wanted.shape[1]),
        "outer_bias": (wanted.shape[1],),
    }
    cuts = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])

    def parts(flat: NDArray) -> dict[str, NDArray]:
        pieces = np.split(flat, cuts[:-1])
        return {k: v.reshape(s) for (k, s), v in zip(shapes.items(), pieces, strict=True)}

    def loss(flat: NDArray) -> tuple[float, NDArray]:
        net = parts(flat)
        hidden = np.tanh(unit @ net["inner"] + net["inner_bias"])
        miss = probabilities(unit, [net])
        cross = -np.mean(np.log(np.sum(miss * wanted, axis=1) + 1e-12))
        weight = np.sum(net["inner"] ** 2) + np.sum(net["outer"] ** 2)
        outer = (miss - wanted) / len(unit)
        inner = (outer @ net["outer"].T) * (1 - hidden**2)
        slopes = (
            unit.T @ inner + DECAY * net["inner"],
            inner.sum(axis=0),
            hidden.T @ outer + DECAY * net["outer"],
            outer.sum(axis=0),
        )
        return float(cross + DECAY * weight / 2), np.concatenate([s.ravel() for s in slopes])

    start = rng.standard_normal(cuts[-1])
    scale = {"inner": unit.shape[1] ** -0.5, "outer": HIDDEN**-0.5}
    first = {k: v * scale.get(k, 0.0) for k, v in parts(start).items()}
    flat = np.concatenate([v.ravel() for v in first.values()])
    return parts(minimize(loss, flat, jac=True, method="L-BFGS-B", options={"maxiter": 400}).x)


def spreads(unit: NDArray, classes: NDArray) -> dict[str, NDArray]:
    """Return common axes, and for each kind its center and what makes its reach 1 on them."""
    known = unit[classes < len(PART_KINDS)]
    axes = np.linalg.svd(known - known.mean(axis=0), full_matrices=False)[2][:AXES].T
    centers, whiteners = [], []
    for number in range(len(PART_KINDS)):
        on_axes = unit[classes == number] @ axes
        center = on_axes.mean(axis=0)
        # A tenth of the mean variance keeps axes on which a kind hardly varies from refusing it.
        spread = np.cov(on_axes.T)
        spread += 0.1 * np.trace(spread) / AXES * np.eye(AXES)
        whitener = np.linalg.cholesky(np.linalg.inv(spread))
        reach = np.quantile(np.linalg.norm((on_axes - center) @ whitener, axis=1), REACH)
        centers.append(center)
        whiteners.append(whitener / reach)
    return {"axes": axes, "centers": np.array(centers), "whiteners": np.array(whiteners)}


def learn(features: NDArray, classes: NDArray, names: list[str]) -> dict[str, Any]:
    """Return all that ``_part_classes.json`` holds, from `examples`."""
    middle, spread = features.mean(axis=0), features.std(axis=0) + 1e-6
    unit = standardized(features, middle, spread)
    nets = [fit_network(unit, classes, seed) for seed in range(NETS)]
    return {
        "features": names,
        "middle": middle,
        "spread": spread,
        "nets": nets,
        **spreads(unit, classes),
    }


def _plain(value: Any) -> Any:
    """Return lists of numbers of four digits: the network is no more exact."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if isinstance(value, np.ndarray):
        return [_plain(one) for one in value]
    return value if isinstance(value, str) else float(f"{value:.4g}")


if __name__ == "__main__":
    learned = json.dumps(_plain(learn(*examples(EACH))), separators=(",", ":"))
    PATH.write_text(learned + "\n", encoding="utf-8")
