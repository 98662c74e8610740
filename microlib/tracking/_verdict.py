"""Is it the template? The probability that what a robust search found is right."""

from __future__ import annotations

import numpy as np

from microlib._common import Array
from microlib.tracking._search import Finding

#: Coefficients of a logistic function of `features`. Fitted by maximum likelihood with a ridge of ½
#: on standardized features to the 1855 of 4050 pairs of warped photographs (scikit-image's camera,
#: astronaut, chelsea, brick, coins, immunohistochemistry, moon and motorcycle; corners moved by 2
#: and by 6 px, shifts by 12 px) that a robust search explained: right within 1 px against wrong by
#: more than 3 px or not there (`python -m benchmarks.tracking_evidence --fit`). The first is such
#: that 4 % of the right ones among them are lost, 1 % of all good frames at the smaller motions.
#: The benchmark reports other photographs and seeds.
_COEFFICIENTS = np.array([-2.96, -0.39, 0.70, -3.03, -0.80, 3.72, 0.51, -3.70, -8.01, -3.83, -2.29])

#: Motion (px) and deformation (px) that count as one, of a template of 50 px.
_MOTION, _DEFORMATION, _TEMPLATE = 15.0, 5.0, 50.0

#: Largest standard deviation (px), and residual over the noise, that are told apart; and the least.
_WORST_SIGMA, _BEST_SIGMA, _WORST_RESIDUAL = 3.0, 0.03, 10.0


def confidence(finding: Finding, sigma: float, *, size: float, near: bool) -> float:
    """Return the probability that a pose is right within a pixel, 0 to 1.

    Parameters
    ----------
    finding : Finding
        With a fit in smooth light.
    sigma : float
        Largest standard deviation of a corner coordinate, px.
    size : float
        Largest side of the template, px.
    near : bool
        Whether the template was seen in the frame before; else its motion says nothing, and counts
        as one standard deviation.
    """
    exponent = float(_COEFFICIENTS @ features(finding, sigma, size=size, near=near))
    return float(1.0 / (1.0 + np.exp(-exponent)))


def features(finding: Finding, sigma: float, *, size: float, near: bool) -> Array:
    """Return what `confidence` weighs, for a finding with a fit."""
    fit = finding.fit
    assert fit is not None
    said, elsewhere = (np.log1p(max(s, 0.0)) for s in (finding.score, finding.rival))
    scale = _TEMPLATE / size
    return np.array(
        [
            1.0,
            said,
            said - elsewhere,
            np.log(min(sigma, _WORST_SIGMA) + _BEST_SIGMA),
            np.log(min(fit.noise, _WORST_RESIDUAL)),
            finding.share,
            scale * finding.deformation / _DEFORMATION,
            scale * finding.motion / _MOTION if near else 1.0,
            min(fit.bend, 2.0),
            min(finding.area, 2.0),
            min(abs(np.log(max(fit.gain, 0.02))), 2.0),
        ]
    )
