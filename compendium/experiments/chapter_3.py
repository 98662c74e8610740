"""Chapter 3: the surface types of Table 3.1 and the windows of (3.15) to (3.19)."""

from __future__ import annotations

import numpy as np

from microlib.curvature import curvature_windows, hk_labels, surface_curvature

#: Table 3.1's types as surfaces z = (a x² + b y²)/100, bent as their names say: a dome is convex
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
    "s": (1, 6, 15, 20, 15, 6, 1),
    "d0": (1, 1, 1, 1, 1, 1, 1),
    "d1": (-3, -2, -1, 0, 1, 2, 3),
    "d2": (5, 0, -3, -4, -3, 0, 5),
}


def labels_by_name() -> dict[str, int]:
    """Return the label of each type of Table 3.1, from a surface that its name describes.

    Returns
    -------
    dict of str to int
        Labels of `microlib.curvature.hk_labels` by name. ``none``, H = 0 and K > 0, is no
        surface's; its label is that of the formula (3.25).

    Examples
    --------
    >>> labels_by_name()["saddle ridge"]
    3
    """
    y, x = np.mgrid[-20:21, -20:21]
    found = {}
    for name, (a, b) in BENT.items():
        bend = surface_curvature((a * x**2 + b * y**2) / 100, 1.0)
        labels = hk_labels(bend.mean, bend.gaussian, h_zero=1e-3, k_zero=1e-5)
        found[name] = int(labels[20, 20])
    return found | {"none": int(hk_labels([0.0], [1.0], h_zero=0.5, k_zero=0.5)[0])}


def surface_types() -> set[int]:
    """Return the labels that a surface can have: those of all pairs of principal curvatures.

    Examples
    --------
    >>> sorted(set(range(1, 10)) - surface_types())
    [4]
    """
    first, second = np.meshgrid(np.arange(-2.0, 3.0), np.arange(-2.0, 3.0))
    return set(hk_labels((first + second) / 2, first * second, 0.0, 0.0).ravel().tolist())


def window_divisors() -> dict[str, float]:
    """Return by what the library's windows must be multiplied to give the printed numbers.

    Returns
    -------
    dict of str to float
        By name in `PRINTED_WINDOWS`: the ratio of a printed number to the window's, at the pixel
        where it departs most from the median of them; 0 if one has a zero where the other has none.

    Examples
    --------
    >>> round(window_divisors()["s"], 9)
    64.0
    """
    windows = curvature_windows(7)
    ours = {
        "s": windows.smooth,
        "d0": windows.mean,
        "d1": windows.slope,
        "d2": windows.second_derivative,
    }
    found = {}
    for name, integers in PRINTED_WINDOWS.items():
        printed, window = np.array(integers, float), ours[name]
        filled = printed != 0
        if not np.array_equal(filled, np.abs(window) > 1e-12):
            found[name] = 0.0
            continue
        ratios = printed[filled] / window[filled]
        found[name] = float(ratios[np.abs(ratios - np.median(ratios)).argmax()])
    return found
