"""Chapter 3: depth of a rendered dome, and surfaces whose type and curvature are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from microlib.curvature import curvature_windows, hk_labels, surface_curvature
from microlib.focus import FocusResult, depth_from_focus, sum_modified_laplacian, three_point_peak
from microlib.focus.multiscale import RULES, FocusSettings, multiscale_depth
from microlib.synthetic import focal_stack, mixed_texture

#: Table 3.1's types as surfaces z = (a x² + b y²)/100, as the names say: a dome is convex
#: and has its top towards the viewer, so a < 0.
BENT = {
    "convex elliptic": (-1, -1),
    "convex cylindric": (-1, 0),
    "saddle ridge": (-2, 1),
    "planar": (0, 0),
    "minimal surface": (1, -1),
    "concave elliptic": (1, 1),
    "concave cylindric": (1, 0),
    "saddle valley": (2, -1),
}
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
            "beyond one spacing (%)": 100 * np.mean(np.abs(error) > 1),
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


def labelled_patches() -> dict[str, tuple[NDArray, int]]:
    """Return by type of Table 3.1 a surface as its name says, and the label found in its middle."""
    y, x = np.mgrid[-20:21, -20:21]
    found = {}
    for name, (a, b) in BENT.items():
        height = (a * x**2 + b * y**2) / 100
        bend = surface_curvature(height, 1.0)
        labels = hk_labels(bend.mean, bend.gaussian, h_zero=1e-3, k_zero=1e-5)
        found[name] = height, int(labels[20, 20])
    return found


def labels_by_name() -> dict[str, int]:
    """Return the label of each type; ``none``, H = 0 and K > 0, is no surface's: by (3.25)."""
    none = int(hk_labels([0.0], [1.0], h_zero=0.5, k_zero=0.5)[0])
    return {name: label for name, (_, label) in labelled_patches().items()} | {"none": none}


def surface_types() -> set[int]:
    """Return the labels that a surface can have: those of all pairs of principal curvatures."""
    first, second = np.meshgrid(np.arange(-2.0, 3.0), np.arange(-2.0, 3.0))
    return set(hk_labels((first + second) / 2, first * second, 0.0, 0.0).ravel().tolist())


def window_divisors() -> dict[str, float]:
    """Return by what the library's windows must be multiplied to give the printed numbers."""
    windows = vars(curvature_windows(7))
    return {
        name: float(np.dot(integers, integers) / np.dot(integers, windows[field]))
        for name, (field, integers) in PRINTED_WINDOWS.items()
    }


def change_with_viewpoint() -> float:
    """Return the largest change, with the viewpoint, of H of a cylinder and of K of a sphere.

    Both have the radius 1, so that H = −1/2 and K = 1 by (3.22) and (3.23) at every viewpoint. The
    cylinder is seen at a tilt φ of its axis, with the height z = (x sin φ + √(1 − y²))/cos φ. A
    point of the sphere is seen at another pixel, with z = √(1 − x² − y²).
    """
    tilt, y = np.meshgrid(np.radians([0.0, 20, 40, 60]), [0.0, 0.3, 0.6])
    side = np.sqrt(1 - y**2)
    z_x, z_y, z_yy = np.tan(tilt), -y / (side * np.cos(tilt)), -1 / (side**3 * np.cos(tilt))
    mean = (1 + z_x**2) * z_yy / (2 * (1 + z_x**2 + z_y**2) ** 1.5)  # z_xx = z_xy = 0
    x, y = np.meshgrid(y[:, 0], y[:, 0])
    z = np.sqrt(1 - x**2 - y**2)
    bends = (1 - y**2) * (1 - x**2) - (x * y) ** 2  # (z_xx z_yy − z_xy²) z⁶
    gaussian = bends / z**6 / (1 + (x**2 + y**2) / z**2) ** 2
    return float(max(np.ptp(mean), np.ptp(gaussian)))


def noisy_labels(noise: float, rng: np.random.Generator) -> tuple[dict[str, NDArray], pd.Series]:
    """Label a ball, a saddle and a plane with noise (µm) at 3.5 standard errors.

    Returns the label maps by name, and the share of right labels within 15 px of the middle.
    """
    y, x = np.mgrid[-40:41, -40:41].astype(float)
    pieces = {
        "ball": (np.sqrt(90.0**2 - x**2 - y**2), 1),
        "saddle": ((x**2 - y**2) / 120, 6),
        "plane": (0 * x, 5),
    }
    maps, shares = {}, {}
    for name, (height, label) in pieces.items():
        bend = surface_curvature(height + noise * rng.standard_normal(x.shape), 1.0, noise=noise)
        maps[name] = hk_labels(bend)
        near = (maps[name] > 0) & (np.hypot(x, y) < 15)
        shares[name] = float(np.mean(maps[name][near] == label))
    return maps, pd.Series(shares)
