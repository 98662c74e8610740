"""Is it the template? The probability that what a robust search found is right."""

from __future__ import annotations

import numpy as np

from microlib._common import Array
from microlib.tracking._search import Finding

#: Coefficients of a logistic function of `features`. Fitted by maximum likelihood with a ridge of ½
#: on standardized features to 853 poses, 726 of them right, that robust searches found in 945 pairs
#: of warped photographs (scikit-image's camera, astronaut, chelsea, brick, coins,
#: immunohistochemistry, moon and motorcycle; corners moved by 2 and by 6 px, shifts by 12 px):
#: right within 1 px against wrong by more than 3 px or not there
#: (`python -m benchmarks.tracking_evidence --fit`). The first is such that 4 % of the right ones
#: are refused. The benchmark reports other photographs and seeds.
_COEFFICIENTS = np.array([-8.54, 0.88, -2.15, -11.39, -2.31, -2.67, 8.37])

#: Largest standard deviation (px) that is told apart, and the least.
_WORST_SIGMA, _BEST_SIGMA = 3.0, 0.03


def confidence(finding: Finding, sigma: float) -> float:
    """Return the probability that a pose is right within a pixel, 0 to 1.

    Parameters
    ----------
    finding : Finding
        What a search found.
    sigma : float
        Largest standard deviation of a corner coordinate, px.
    """
    exponent = float(_COEFFICIENTS @ features(finding, sigma))
    return float(1.0 / (1.0 + np.exp(-exponent)))


def features(finding: Finding, sigma: float) -> Array:
    """Return what `confidence` weighs."""
    fit = finding.fit
    said, elsewhere = (np.log1p(max(s, 0.0)) for s in (finding.score, finding.rival))
    return np.array(
        [
            1.0,
            said - elsewhere,
            np.log(min(sigma, _WORST_SIGMA) + _BEST_SIGMA),
            min(fit.bend, 2.0),
            min(finding.area, 2.0),
            min(abs(np.log(max(fit.gain, 0.02))), 2.0),
            finding.support,
        ]
    )
