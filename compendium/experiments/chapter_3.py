"""Chapter 3: what the thesis prints, errors of depths, and the stages of the default depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from microlib.focus import FocusResult, depth_from_focus, sum_modified_laplacian, three_point_peak
from microlib.focus.multiscale import RULES, FocusSettings, multiscale_depth
from microlib.synthetic import focal_stack, mixed_texture

#: The whole numbers that (3.15), (3.17), (3.18) and (3.19) print, each divided by one number.
PRINTED_WINDOWS = {
    "s": ("smooth", (1, 6, 15, 20, 15, 6, 1)),
    "d0": ("mean", (1, 1, 1, 1, 1, 1, 1)),
    "d1": ("slope", (-3, -2, -1, 0, 1, 2, 3)),
    "d2": ("second_derivative", (5, 0, -3, -4, -3, 0, 5)),
}


#: The types of Table 3.1 in the order of its labels, from 1 to 9; the fourth is no surface.
TABLE_3_1 = (
    *("convex elliptic", "convex cylindric", "saddle ridge"),
    *("none", "planar", "minimal surface"),
    *("concave elliptic", "concave cylindric", "saddle valley"),
)


def depths(
    frames: NDArray, positions: ArrayLike, truth: NDArray, methods: Mapping[str, dict[str, Any]]
) -> tuple[dict[str, FocusResult], pd.DataFrame]:
    """Return each method's result, and its error off the border in frame spacings."""
    spacing = float(np.diff(positions)[0])
    results = {name: depth_from_focus(frames, positions, **how) for name, how in methods.items()}
    rows = {}
    for name, result in results.items():
        error = (result.depth - truth)[10:-10, 10:-10] / spacing
        rows[name] = {
            "RMS error (frame spacings)": np.sqrt(np.nanmean(error**2)),
            "share above one spacing (%)": 100 * np.mean(np.abs(error) > 1),
        }
    return results, pd.DataFrame(rows).T


@dataclass(frozen=True)
class FocusStages:
    """What the stages of the default depth make of one rendered stack.

    Attributes
    ----------
    truth : ndarray, shape (rows, cols)
        The true heights, µm: a slope with fine ridges beside a step, and a plane.
    frame, averaged, measure : ndarray, shape (rows, cols)
        A frame, the mean of it and its next neighbors, and the product of two modified
        Laplacians of the mean.
    centers, products : ndarray
        Positions of the averaged frames, µm, and the product in each of them.
    fitted, smooth, final, uncertainty : ndarray, shape (rows, cols)
        The peaks of the product, the result without relief, the result, and its uncertainty, µm.
    chosen, kept : ndarray, shape (rows / 2, cols / 2)
        The heights of the clear peaks, µm, before and after the rules that reject peaks.
    """

    truth: NDArray
    frame: NDArray
    averaged: NDArray
    measure: NDArray
    centers: NDArray
    products: NDArray
    fitted: NDArray
    chosen: NDArray
    kept: NDArray
    smooth: NDArray
    final: NDArray
    uncertainty: NDArray


def product_measure(frame: NDArray) -> NDArray:
    """Return a fine times a coarse modified Laplacian, each summed over a small window."""
    fine = sum_modified_laplacian(ndimage.gaussian_filter(frame, 0.8), window=5)
    coarse = sum_modified_laplacian(ndimage.gaussian_filter(frame, 2.0), window=9, step=2)
    return fine * coarse


def focus_stages() -> FocusStages:
    """Render a slope with fine ridges, a step and a patch without texture, and follow its depth.

    A rule of the default depth sees the peaks that the stages before it have left. One rule before
    the others and one behind them, which reject nothing, keep the peaks.
    """
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:144, :192]
    truth = np.where(x < 96, 40 + 1.2 * x + 4 * np.sin(2 * np.pi * y / 20), 60.0)
    texture = mixed_texture(x.shape, rng)
    texture[np.hypot(x - 144, y - 72) < 34] = texture.mean()  # without texture
    positions = np.arange(0.0, 210.0, 5.0)
    frames = focal_stack(texture, truth, positions, blur_rate=0.05, noise=4.0, rng=rng)
    seen = []

    def keep(peaks: Any, settings: FocusSettings) -> NDArray[np.bool_]:
        seen.append(peaks.depth)
        return np.zeros(peaks.depth.shape, bool)

    final = multiscale_depth([*frames], positions, rules=[keep, *RULES, keep])
    without_relief = FocusSettings(snr_low=1e9, snr_high=2e9)
    smooth = multiscale_depth([*frames], positions, settings=without_relief).depth
    together = round(final.spacing / 5.0)  # frames that were averaged
    means = np.array([np.mean(group, axis=0) for group in np.split(frames, 42 // together)])
    centers = positions.reshape(len(means), -1).mean(axis=1)
    products = np.array([product_measure(mean) for mean in means])
    best = products.argmax(axis=0)
    around = np.clip(best + np.arange(-1, 2)[:, None, None], 0, len(means) - 1)
    fitted = three_point_peak(np.take_along_axis(products, around, axis=0), best, centers)
    middle = len(means) // 3
    chosen, kept = (centers[0] + final.spacing * depth for depth in seen)
    return FocusStages(
        truth=truth,
        frame=frames[middle * together],
        averaged=means[middle],
        measure=products[middle],
        centers=centers,
        products=products,
        fitted=fitted,
        chosen=chosen,
        kept=kept,
        smooth=smooth,
        final=final.depth,
        uncertainty=final.uncertainty,
    )
