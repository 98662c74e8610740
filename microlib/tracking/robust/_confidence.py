"""Probability that what a robust search found is right."""

from __future__ import annotations

import numpy as np

from microlib.tracking._geometry import TINY
from microlib.tracking.robust._search import Finding

#: Coefficients of the features of `confidence`. Fitted by maximum likelihood with a ridge of ½
#: on standardized features to 445 poses, 352 of them right, that robust searches found on
#: photographs (eight of scikit-image's and eight of OpenCV's): in 432 pairs as those of the
#: tracker's benchmark and in sequences with a sheen or growing saturation; right within 1 px
#: against wrong by more than 3 px or not there. The score did not allow for interpolation then.
COEFFICIENTS = np.array([-3.64, 0.33, 4.16, -9.86, -1.45])


def confidence(finding: Finding, sigma: float) -> float:
    """Return the probability that a pose is right within a pixel, 0 to 1.

    This is a logistic regression, times max(0, 1 − a/b) with the score a of the second motion and
    the score b of the pose: one part of the template may be an object, and the other its
    background. `sigma` is the largest standard deviation of a corner, px.
    """
    best, second = (np.log1p(max(s, 0.0)) for s in (finding.score, finding.second_score))
    displacement, spread = min(finding.displacement, 0.5), np.log(np.clip(sigma, 1e-3, 10.0))
    features = np.array([1.0, best - second, finding.inlier_ratio, displacement, spread])
    one_motion = max(0.0, 1.0 - finding.second_motion_score / max(finding.score, TINY))
    return float(one_motion / (1.0 + np.exp(-COEFFICIENTS @ features)))
