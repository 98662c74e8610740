"""Shape from focus: focus measures, and the depth of every pixel of a focal stack."""

from microlib.focus._correction import correct_spikes, smooth_depth
from microlib.focus._depth import FocusResult, depth_from_focus, survey_focus
from microlib.focus._measures import sum_modified_laplacian
from microlib.focus._peaks import three_point_peak
from microlib.focus._survey import FocusSurvey
from microlib.focus._to_zarr import depth_to_zarr

__all__ = [
    "FocusResult",
    "FocusSurvey",
    "correct_spikes",
    "depth_from_focus",
    "depth_to_zarr",
    "smooth_depth",
    "sum_modified_laplacian",
    "survey_focus",
    "three_point_peak",
]
