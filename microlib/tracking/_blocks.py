"""The template's parts: do they agree about a pose, and what do they say together?"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from microlib._common import Image
from microlib.tracking._loops import block_sums, judge_blocks

# The benchmark of tracking in bad light, table "Constants", says what the following are worth.

#: Cells along each side of a template, and the least px of one; a block is 2×2 cells and overlaps
#: its neighbors by half.
_CELLS, _LEAST_CELL = 9, 4

#: Information (nats) that chance gives a block that shows something else.
_CHANCE = 0.25

#: Residual, in standard deviations of the noise, that halves a block's say.
_ODD = 3.0

#: Residual variance, in that of the noise and in that of the block, up to which a block agrees.
_AGREEING, _RELATIVE = 3.0, 0.02

#: Largest say of one block in the share of blocks that agree: its variance over that of the noise.
_LARGEST_SAY = 50.0


@lru_cache(maxsize=64)
def edges(length: int, step: int = 1) -> NDArray[np.int64]:
    """Return where the cells of a side of `length` px begin and end, in px of every `step`."""
    cells = min(_CELLS, max(2, length * step // _LEAST_CELL))
    return np.rint(np.linspace(0, length, cells + 1)).astype(np.int64)


@dataclass(frozen=True)
class Agreement:
    """What the blocks of the template say of a pose.

    Attributes
    ----------
    score : float
        Information (nats) in which template and image agree, summed over the blocks.
    share : float
        Share of the blocks that have any.
    agreeing : float
        Share of the blocks, weighted by their texture over the noise, whose residual is noise.
    texture : float
        Sum of those weights.
    drift : float
        Root mean square, weighted alike, of the blocks' mean residuals about the one gain and bias
        of all, grey levels.
    """

    score: float
    share: float
    agreeing: float
    texture: float
    drift: float


def agreement(grey: Image, template: Image, share: Image, noise: float) -> Agreement:
    """Compare template and image block by block.

    Parameters
    ----------
    grey, template : ndarray, shape (H, W)
        Image under the warp, and template.
    share : ndarray, shape (H, W)
        How far each pixel counts, 0 to 1.
    noise : float
        Standard deviation of the noise of either.
    """
    down, across = edges(grey.shape[0]), edges(grey.shape[1])
    sums = np.empty((len(down) - 2, len(across) - 2, 6))
    block_sums(grey, template, share, across, down, sums)
    return Agreement(
        *judge_blocks(
            sums.reshape(-1, 6),
            2.0 * noise**2,
            _CHANCE,
            _ODD**2,
            _AGREEING,
            _RELATIVE,
            _LARGEST_SAY,
        )
    )
