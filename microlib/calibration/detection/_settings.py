"""The numbers of the detectors that were measured, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the steps from an image to points on a lattice, in their order.

    A number that can be doubled and halved without a change stands where it is used.

    Parameters
    ----------
    levels : int
        Levels at which contours are drawn, as many evenly spaced as by rank. A mark is found if one
        of them separates it from its ground all round.
    shortest : int
        Contour of a mark of 5 px across, px.
    fullness : (float, float)
        Of an ellipse it is 1, of a square 0.955; contours of few pixels come out a little beside.
    nothing_else : float
        If a lattice holds this part of the dark regions, the image shows it and nothing else.
    saddle_blurs : (float, float)
        With which corners are looked for, px: small fields, then noisy and blurred ones.
    least_alike : float
        Correlation of the image around a mark with the drawn pattern.
    least_contrast : float
        Of a place that is taken for a mark, as a part of that of the nearest one: at the rim of a
        chessboard, where one of four fields is dark, it is a half.
    most_scatter : float
        Of the marks' shapes: photographed boards have up to 0.033 (development images), marks of
        chance mostly more than 0.2.
    most_skew : float
        How far the ratio of the lattice's steps may lie from 1, and the cosine between them from 0
        or ½. Every second place of every second row of a square lattice is nearest to a hexagonal
        one, with a ratio of 1.118 and a cosine of 0.447.
    least_full : float
        Part of the lattice's places inside the marks' convex hull that hold one. False lattices of
        the development images hold a fifth to a half.
    start_blur : float
        With which a fit starts, px. Less does no harm, 2.5 px may end in a wrong minimum.
    steps : int
        Most steps of a fit. In renders of Table 5.1's views nine outlines of ten are at their
        minimum after 5; of photographed circles one in ten needs more than 15, and of corners of
        photographed chessboards one in five more than 25.
    few_steps : int
        Steps after which shapes are told apart: the right one is at its minimum, and the other far
        above it, though it may creep on for long.
    settled : float
        A fit ends when a step changes its sum of squares by less than this part. The step then
        moved the outline by √(1e-6 k) of its standard deviation for k pixels, a sixtieth for 250.
    rough : float
        A parameter is not shared if its misfit, 1 ± √(2/freedom) by chance, is so many of these
        deviations above 1. Without sharing the error of rendered patterns is 1.6 times as large;
        the limit is for lenses whose blur is not smooth.
    widest : float
        Band around an outline, px. Pixels far from it tell its ground: 4, 5, 7 and 10 leave errors
        of 1.06, 1.02, 1 and 0.99, more and more of it for dirt to lie in.
    most_crossing : float
        Half the width of a patch around a board's corner, px: more adds little but distortion.
    most_residual : float
        Of a lattice, in pitches. Printed boards, photographed, lie within 0.01; false lattices
        mostly beyond 0.03.
    stray : float
        A mark so many standard deviations beside the others' map is none of theirs: by chance one
        of 10⁸.
    turn, turns : float, int
        Half of the turn about the gradients' own direction in which the lines of a scale are
        sharpest, rad, and the directions that are tried.
    line_residual : float
        Of a line, in divisions: scales are ruled to a hundredth of one, and stripes that only look
        like one rarely lie within a twentieth.
    """

    levels: int = 20
    shortest: int = 14
    fullness: tuple[float, float] = (0.90, 1.02)
    nothing_else: float = 0.7
    saddle_blurs: tuple[float, float] = (1.5, 3.0)
    least_alike: float = 0.7
    least_contrast: float = 0.7
    most_scatter: float = 0.08
    most_skew: float = 0.1
    least_full: float = 0.6
    start_blur: float = 1.2
    steps: int = 50
    few_steps: int = 12
    settled: float = 1e-6
    rough: float = 6.0
    widest: float = 7.0
    most_crossing: float = 12.0
    most_residual: float = 0.012
    stray: float = 6.0
    turn: float = 0.1
    turns: int = 81
    line_residual: float = 0.02
