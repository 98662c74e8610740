"""The picture of an indented outline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._plots._axes import BESIDE, FOUND, OFF, given_axes, new_axes


def outline(
    x: NDArray,
    y: NDArray,
    curve: NDArray,
    points: Mapping[str, tuple[float, float]],
    title: str,
    ax: Any = None,
) -> Any:
    """Draw an outline, px, y up, a fitted curve (x, y) and named points of it.

    An outline that is wider than four times its height is stretched; the axis states the factor.
    """
    ax = new_axes(1, 1, 8, 5)[0, 0] if given_axes(ax) is None else ax
    ax.plot(x, y, ".", ms=3, color="0.6", label="outline")
    ax.plot(*curve, color=BESIDE, label="fitted model")
    for (name, at), color in zip(points.items(), (FOUND, OFF, FOUND), strict=False):
        ax.plot(*at, "o", color=color, label=name)
    factor = max(1, round(np.ptp(x) / np.ptp(y) / 4))
    stretched = f", drawn {factor} times as high" if factor > 1 else ""
    ax.set(xlabel="x (px)", ylabel=f"y, up (px){stretched}", title=title, aspect=factor)
    ax.grid(alpha=0.3)
    ax.legend()
    return ax.figure
