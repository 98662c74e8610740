"""Settings of the default depth, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FocusSettings:
    """Settings of the default depth.

    Lengths along the axis are in averaged frames; lengths across it are in px of every second
    pixel. A sigma is the standard deviation of a Gaussian. Where nothing else is said, the reason
    is the table "twice and half of a setting" of benchmarks/focus.py: some row gets worse by more
    than 5 %. `mtf_correction`, `sure_detail` and `end_share` change less there, but relief of
    focus_depth.py, narrow bars, and surfaces outside of the stack.
    """

    #: Equivalent width of a peak, in averaged frames, to which frames are averaged: the error is
    #: flat from 2.8 to 4.5 with 4 and 20 times the frames. Without averages, 6 % of the depths of a
    #: real board are wrong where its peaks are 5.5 frames wide, instead of 0.2 %. With infinity no
    #: frames are averaged.
    width: float = 3.5
    #: Smoothing of the second derivatives of the frame, px of the frame: the fine scale locates the
    #: peak on a slope.
    fine_sigma: float = 0.8
    #: Smoothing of the second derivatives of the frame at half size, px of that: the coarse scale
    #: stabilizes the peak on weak texture.
    coarse_sigma: float = 1.0
    #: Window over which the fine measure is averaged.
    fine_window_sigma: float = 0.6
    #: Window over which the coarse measure is averaged.
    coarse_window_sigma: float = 1.15
    #: Mean from which the edge measure takes a pixel's deviation.
    edge_sigma: float = 2.0
    #: Side of the wide window, in every fourth pixel: wider than the halo of a strong edge.
    wide: int = 13
    #: Difference in depth that is a step. Neighbors that differ by more are not averaged; fine
    #: relief is clipped to it.
    jump: float = 1.5
    #: Neighborhood of which half needs a depth. A separate piece of surface of half the area of a
    #: circle of this radius, or less, is removed.
    neighborhood_sigma: float = 3.0
    #: Extent of the halo of a strong edge, in which its blur exceeds weak texture, and difference
    #: from the mean depth there from which a depth may be of the halo.
    halo_sigma: float = 5.0
    halo_gap: float = 2.0
    #: Share of the height of the peaks around below which a peak may be a halo.
    faint: float = 0.2
    #: Side of the square over which wide depths, disagreements and heights are compared.
    local_window: int = 11
    #: Mean disagreement of the depths by two measures from which a peak is none of the surface.
    #: From half of it, it may be a halo: on narrow bars 95 % of the pixels lie below 0.16, and 95 %
    #: of a real board's halos above 0.15.
    disagreement: float = 0.3
    #: Distance within which depths by two measures are the same, so that one confirms the other.
    agreement: float = 0.4
    #: Difference from the wide depth from which the wide depth replaces a depth that both measures
    #: confirm: of 1.2 depths of field a narrow depth beside lettering on a real board is wrong.
    wide_gap: float = 1.2
    #: Difference from the wide depth from which a depth with high disagreement is wrong, if the
    #: wide depth does not replace it.
    reject_gap: float = 0.8
    #: Ratio of fine to coarse measure, and the fine one's signal-to-noise ratio, that no defocused
    #: detail has for sure, as JPEG leaves sharp traces, too. It has half of them with little
    #: probability: 95 % of the halos of five photographs and of lettering have ratios below 0.4, of
    #: faint texture above 0.6.
    sure_detail: tuple[float, float] = (0.8, 8.0)
    #: Slope of the wide depth, frames per px, from which its window spans both sides of a step.
    wide_slope: float = 0.5
    #: Share of the pixels around, sharpest in an end frame, from which a depth near that frame may
    #: be of a surface outside of the stack.
    end_share: float = 0.25
    #: Weight of a depth by the wide window, whose error is some seven times the others'.
    wide_weight: float = 0.02
    #: Smoothing by planes.
    smoothing_sigma: float = 3.5
    #: Signal-to-noise ratio of a covariance from which relief is restored, and is so in full.
    snr_low: float = 2.5
    snr_high: float = 4.5
    #: Logarithm of a measure's attenuation of relief, over its mean squared slope, px².
    mtf_correction: float = 0.35
    #: Errors that the uncertainty states: by texture that moves a depth along a slope, px of the
    #: full image; beside a step that is lower than two jumps, as a share of its height; at a sharp
    #: bend, as a share of the distance from the mean. They were found on drawn texture and
    #: photographs, and the table of stated errors in benchmarks/focus_depth.py tests them.
    slope_error: float = 0.12
    low_step_error: float = 0.17
    bend_error: float = 0.2
