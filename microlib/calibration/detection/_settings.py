"""Measured settings of the detection, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of the steps from an image to points on a lattice, in their order.

    Parameters
    ----------
    levels : int
        Number of evenly spaced grey levels of contours, and of levels by rank. A mark is found if
        one of them separates it from its background all around.
    min_contour : int
        Length of the contour of a mark of 5 px, px.
    ellipse_ratio : (float, float)
        Limits of the area of a mark over that of the ellipse with its moments: 1 for an ellipse and
        0.955 for a square, with the error of contours of few pixels.
    only_pattern : float
        Fraction of the dark regions on a lattice above which the image shows nothing else.
    saddle_blurs : (float, float)
        Blurs with which corners are searched, px: for small fields, and for noisy and blurred ones.
        With the smaller one alone, 12 of 50 photographed chessboards are rejected instead of 1.
    min_correlation : float
        Correlation of the image around a mark with the drawn pattern.
    min_contrast : float
        Contrast of an added mark over that of the nearest one. At the edge of a chessboard, where
        one of four fields is dark, it is a half.
    max_shape_scatter : float
        Relative scatter of the shapes of marks. It is 0.033 at most on photographed boards, and
        mostly more than 0.2 for accidental lattices.
    max_skew : float
        Deviation of the ratio of the steps of a lattice from 1, and of the cosine of their angle
        from 0. On a hexagonal lattice the cosine is ½.
    min_fill : float
        Fraction of the lattice points in the convex hull of the marks that have a mark. It is a
        fifth to a half for accidental lattices in photographs.
    initial_blur : float
        Blur at the start of a fit, px. A start of 2.5 px may end in a wrong minimum.
    max_iterations : int
        Iterations of a fit. Nine of ten rendered outlines are at their minimum after 5; one in ten
        photographed circles needs more than 15, and one in five corners of photographed chessboards
        more than 25. One in a hundred corners of drawings without blur needs more than 50, because
        the derivative by the blur is zero there.
    shape_iterations : int
        Iterations after which circles and squares are compared. The right shape is then at its
        minimum, and the other far above.
    cost_tolerance : float
        Relative change of the sum of squares at which a fit ends. The last step is then a sixtieth
        of the standard deviation for 250 pixels.
    max_chi2_deviation : float
        Deviation of the reduced χ² of a parameter from 1, in its standard deviations √(2/dof),
        above which the parameter does not vary smoothly. Without smoothing, the error of rendered
        patterns is 1.2 to 1.6 times as large.
    max_band : float
        Half-width of the band around an outline, px. Bands of 4, 5, 7 and 10 px give errors of
        1.06, 1.02, 1 and 0.99, and contain more and more dirt.
    max_patch : float
        Half-width of the patch around a corner of a board, px. Larger ones contain more distortion.
    max_residual : float
        Rms deviation of points from a smooth image of a lattice, in pitches. Printed patterns need
        0.01, and most accidental lattices deviate by more than 0.03.
    max_board_residual : float
        The same for boards, all of whose corners correlate with the drawn board. They need 0.0083
        on 60 photographs, and 0.015 where a lens distorts fields of 14 px beyond the smooth image.
    outlier_sigmas : float
        Deviation of an outlier in standard deviations, with a probability of 1e-8 by chance.
    angle_range, angle_count : float, int
        Range of directions of a scale on both sides of the mean gradient, rad, and their number.
    max_line_residual : float
        Rms deviation of the lines of a scale, in divisions. Scales are ruled to 0.01, and other
        stripes are rarely regular to 0.05.
    """

    levels: int = 20
    min_contour: int = 14
    ellipse_ratio: tuple[float, float] = (0.90, 1.02)
    only_pattern: float = 0.7
    saddle_blurs: tuple[float, float] = (1.5, 3.0)
    min_correlation: float = 0.7
    min_contrast: float = 0.7
    max_shape_scatter: float = 0.08
    max_skew: float = 0.1
    min_fill: float = 0.6
    initial_blur: float = 1.2
    max_iterations: int = 100
    shape_iterations: int = 12
    cost_tolerance: float = 1e-6
    max_chi2_deviation: float = 6.0
    max_band: float = 7.0
    max_patch: float = 12.0
    max_residual: float = 0.012
    max_board_residual: float = 0.03
    outlier_sigmas: float = 6.0
    angle_range: float = 0.1
    angle_count: int = 81
    max_line_residual: float = 0.02
