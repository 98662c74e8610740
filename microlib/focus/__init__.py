"""Shape from focus: focus measures, and the depth of every pixel of a focal stack."""

import microlib._common._opencv  # noqa: F401 – says how to install it
from microlib.focus._correction import correct_spikes, smooth_depth
from microlib.focus._depth import depth_from_focus
from microlib.focus._measures import sum_modified_laplacian
from microlib.focus._result import FocusResult
from microlib.focus._three_point import three_point_peak

__all__ = [
    "FocusResult",
    "correct_spikes",
    "depth_from_focus",
    "smooth_depth",
    "sum_modified_laplacian",
    "three_point_peak",
]
