"""Tell circles from squares where blur has made their outlines alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from microlib.calibration._dark_regions import DarkRegions
from microlib.calibration._ellipses import fit_ellipses
from microlib.calibration._quads import fit_quads

#: Area over that of the ellipse of the same moments: 1 for ellipses, 0.955 for squares, and up to
#: 0.991 where blur of a fifth of a side rounds them. In between the grey levels decide, not the
#: outline at one of them.
_SURELY_SQUARE, _SURELY_ROUND = 0.965, 0.992
#: Regions that are asked, evenly among all: each has hundreds of pixels to tell by.
_ASKED = 6


def are_round(regions: DarkRegions, index: NDArray[np.intp]) -> bool:
    """Say whether ellipses fit the regions' grey levels better than quadrilaterals do.

    Parameters
    ----------
    regions : DarkRegions
        From an image.
    index : ndarray of int, shape (N,)
        Those to look at.

    Returns
    -------
    bool
    """
    fullness = float(np.median(regions.fullness[index]))
    if not _SURELY_SQUARE < fullness < _SURELY_ROUND:
        return fullness >= _SURELY_ROUND
    index = index[:: -(-len(index) // _ASKED)]
    ellipses, _ = fit_ellipses(regions, index)
    quads, _ = fit_quads(regions, index)
    both = np.isfinite(ellipses.rms) & np.isfinite(quads.rms)
    if not both.any():
        return bool(np.isfinite(ellipses.rms).sum() > np.isfinite(quads.rms).sum())
    return bool(np.median(ellipses.rms[both] / quads.rms[both]) < 1)
