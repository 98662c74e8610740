"""What the default depth is set to, and why."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the default depth, each with its reason.

    Lengths along the axis are in steps, which are averaged frames; lengths across it are in px of
    every second pixel. Where nothing else is said, the reason is the table "twice and half of a
    setting" of benchmarks/focus.py: it gets worse by more than 2 % on some row. `speck`, `finer`,
    `doubtful` and `most_relief` move none of its few stacks, but narrow bars or two real stacks.
    """

    #: Equivalent width of a peak, in averaged frames, to which frames are averaged: the error is
    #: flat from 2.8 to 4.5, table "frames averaged into one" of benchmarks/focus_depth.py.
    width: float = 3.7
    #: Smoothing of the second differences at full size and at half, px of each grid, and their
    #: windows: the fine scale places the peak on a slope, the coarse one holds it on weak texture.
    fine: float = 0.8
    coarse: float = 1.0
    fine_window: float = 0.6
    coarse_window: float = 1.15
    #: Radius of the mean from which the edge measure takes a pixel's deviation.
    edge_mean: float = 2.0
    #: Side of the wide window, of every fourth pixel: wider than the halo of a strong edge.
    wide: int = 13
    #: Difference in depth that is a step: nothing is smoothed beyond it.
    jump: float = 1.5
    #: Radius over which a depth needs others around it.
    surroundings: float = 3.0
    #: Radius over which the blur of a strong edge outshines weak texture, and the share of the
    #: peaks around that its own stay below.
    halo: float = 5.0
    faint: float = 0.2
    #: Largest area that is no surface of its own, px.
    speck: int = 12
    #: Side of the square in which the wide depth is looked for.
    nearby: int = 11
    #: Mean distance of the depths by two measures from which they may be of blurred light, and from
    #: which they have no peak in common: on narrow bars 95 % of the pixels lie below 0.16, and 95 %
    #: of a real board's halos above 0.15.
    doubtful: float = 0.16
    erratic: float = 0.3
    #: Difference from the wide depth from which an erratic depth is wrong, if the wide one takes
    #: its place, and if nothing does.
    erratic_gap: float = 0.4
    lone_gap: float = 0.8
    #: Share of fine detail in coarse that blurred light stays below, and how often the noise the
    #: fine detail is: for sure, as JPEG leaves sharp traces, too, and probably. 95 % of the halos
    #: of five photographs and of lettering have shares below 0.4, of faint texture above 0.6.
    sharp: tuple[float, float] = (0.8, 8.0)
    finer: tuple[float, float] = (0.4, 4.0)
    #: Weight of a depth by the wide window, whose error is some seven times the others'.
    wide_weight: float = 0.02
    #: Radius of the smoothing by planes.
    radius: float = 3.5
    #: How far a pixel's own depth may lie from the smoothed one to tell of relief, and how far that
    #: may rise: with a whole jump for both, a real board is 8 % worse.
    own: float = 1.2
    most_relief: float = 1.6
    #: Standard deviations by which a covariance must exceed that of noise to begin to count as
    #: relief, and to count in full.
    doubt: float = 2.5
    sure: float = 4.5
    #: Logarithm of what a measure's windows take from relief, over its mean squared slope, px².
    taken: float = 0.35
    #: At full size a lost depth returns where it is within this distance of that by the edge
    #: measure, and its peak above this share of the strongest in a square of this side, px.
    agrees: float = 0.4
    share: float = 0.3
    strongest: int = 21
