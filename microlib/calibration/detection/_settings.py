"""Measured settings of the detection, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectionSettings:
    """Settings of the steps from an image to points on a lattice, in their order.

    Numbers that can be doubled and halved without effect stand in the code as round numbers.

    Parameters
    ----------
    max_pixels : float
        Number of pixels of an image above which marks are searched in the image at half, a third …
        of its size, and fitted at full size. An image of 12 megapixels without a pattern takes 3 s
        instead of 25 s. In the smaller image marks must have 5 px.
    min_reduced_side : float
        Side of a mark (px, the root of its area) in the smaller image, below which the image is
        searched at full size if the lattice has `many_marks`. Of circles with a side of 9 px in the
        smaller image, up to half were lost.
    many_marks : int
        Number of small marks in the smaller image that are no clutter.
    levels : int
        Number of evenly spaced grey levels of contours, and of levels by rank. A mark is found if
        one of them separates it from its background all around.
    min_contour : int
        Length of the contour of a mark of 5 px, px.
    max_area : float
        Area of a mark over that of the image. At least four marks must lie in the image.
    ellipse_ratio : (float, float)
        Limits of the area of a mark over that of the ellipse with its moments: 1 for an ellipse and
        0.955 for a square, with the error of contours of few pixels.
    max_slope_scatter : float
        Standard deviation of the gradient along the contour of a mark, over its mean. Noise, uneven
        light and pixels scatter the gradient of a mark by up to 0.35.
    max_region_ratio : float
        Ratio of the area of a dark region to the median area of the regions, or its inverse.
    only_pattern : float
        Fraction of the dark regions on a lattice above which the image shows nothing else.
    neighbors : int
        Number of the nearest marks among which those of the lattice are searched. The eight nearest
        marks of a square lattice and four others are searched.
    step_tolerance : float
        Distance of a mark from the place that the step before predicts, in steps.
    saddle_blurs : (float, float)
        Blurs with which corners are searched, px: for small fields, and for noisy and blurred ones.
        With the smaller one alone, 12 of 50 photographed chessboards are rejected instead of 1.
    min_saddle : float
        Strength of a saddle point over that of the strongest.
    max_saddles : int
        Number of the strongest saddle points that are used, which limits the time. A board of 40 ×
        28 fields has 1053 corners.
    max_boards : int
        Number of the largest lattices of saddle points that are compared with a drawn board. In 20
        drawings of a board of 12 corners before a busy ground it is among the 13 largest, and the
        largest in 5. Those after the largest must have more than eight corners of a board.
    corner_neighbors : (int, int)
        The same as `neighbors` for the corners of chessboards and of ChArUco boards. Most saddle
        points of a ChArUco board belong to its markers.
    max_edge_curvature : float
        Second derivative of the image along the step to the next corner, relative to the length of
        the matrix of second derivatives. It is zero along an edge and 1/√2 across the fields.
    max_corner_product : float
        Product of the matrices of second derivatives at neighboring corners. It is −1 for a board
        without perspective.
    corner_tolerance : float
        The same as `step_tolerance` for corners. Under a strong distortion one step differs from
        the next by a quarter.
    corner_correlations : tuple of float
        Correlations of the image around a corner with the drawn board, one limit after the other.
        False corners bend the map by which others are judged, so that the worst ones are left out
        first. Of 36 photographs by a wide-angle lens, one or two limits reject two photographs, and
        three limits one.
    edge_width : float
        Width of the strips along the edges of a ChArUco board that are compared with the drawn
        board, in fields. The fields contain markers beyond.
    field_margin : float
        Distance of the middle of a field from its edges, in fields. The edges are blurred.
    min_marker_scatter : float
        Difference of the scatters of grey levels in fields of the two colors, over the contrast,
        from which on the fields of one color contain markers. Of 60 photographed chessboards it is
        0.02 at most, of ChArUco boards 0.19 at least; where the markers are blurred beyond
        recognition, 0.03.
    min_correlation : float
        Correlation of the image around a mark with the drawn pattern, and of the rows of a scale.
    min_contrast : float
        Contrast of an added mark over that of the nearest one. At the edge of a chessboard, where
        one of four fields is dark, it is a half.
    max_moment_scatter : float
        Relative scatter of the second moments of marks on the plane of a lattice, above which the
        marks are not fitted. It is 0.12 at most for the marks of boards, and 0.35 to 0.7 for most
        accidental lattices.
    max_round_rms : float
        Residuals of the outlines over the contrast of the image, above which marks are neither
        round nor square. Noise of three fifths of the contrast leaves such a residual. A fit of all
        marks of this size, as the fields of a ChArUco board with markers, takes many iterations.
    max_shift : float
        Distance of a fitted mark from the place where it was found, in widths of the mark.
    max_blur : float
        Blur of a mark in its widths. A larger blur is that of several marks.
    max_rms_ratio, max_uncertainty_ratio : float
        Residual and uncertainty of the fit of a mark over the medians of all marks. A limit of the
        residual of 5 accepts 2 wrong points of 1961 that 3 rejects, and a limit of 2 rejects 12
        right ones.
    max_uncertainty : float
        Uncertainty of a mark in its widths.
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
    neighbor_iterations : int
        Fits with the light that the neighbors take. For a gap of 2.8 blurs the error is 0.085 px
        without iteration, 0.0092 px after two iterations, 0.0074 px after three and 0.0070 px after
        six.
    max_chi2_deviation : float
        Deviation of the reduced χ² of a parameter from 1, in its standard deviations √(2/dof),
        above which the parameter does not vary smoothly. Without smoothing, the error of rendered
        patterns is 1.2 to 1.6 times as large.
    max_band : float
        Half-width of the band around an outline, px. Bands of 4, 5, 7 and 10 px give errors of
        1.06, 1.02, 1 and 0.99, and contain more and more dirt.
    min_band : (float, float)
        Least width of the band outside and inside of the outline, px. If the band crosses the
        middle of a narrow gap, corners err by 0.010 instead of 0.005 px.
    corner_width : (float, float)
        Half-width of the patch around a corner of a chessboard and of a ChArUco board, in fields.
        The patch must not contain the next edges, a field away, with their blur and foreshortening,
        nor the markers in the fields.
    max_patch : float
        Half-width of the patch around a corner of a board, px. Larger ones contain more distortion.
    max_residual : float
        Rms deviation of points from a smooth image of a lattice, in pitches. Printed patterns need
        0.01, and most accidental lattices deviate by more than 0.03.
    max_board_residual : float
        The same for boards, all of whose corners correlate with the drawn board. They need 0.0083
        on 60 photographs, and 0.015 where a lens distorts fields of 14 px beyond the smooth image.
    max_noise_ratio, max_noise_residual : float
        Rms deviation over the uncertainty of the points, up to which the noise of the points
        explains it, and the rms deviation in pitches up to which the noise is accepted. Holes of a
        grating, 10 px apart and uneven by 0.35 px, deviate by 0.018 to 0.021 of their distance.
    min_kept : float
        Fraction of the marks that are no outliers.
    outlier_limit : float
        Deviation of an outlier in standard deviations, with a probability of 1e-8 by chance.
    prior_residuals : float
        Number of residuals that the uncertainty by the fits of the outlines counts as.
    angle_range, angle_count : float, int
        Range of directions of a scale on both sides of the mean gradient, rad, and their number.
    min_peak : float
        Prominence of a line in the mean profile of a scale, over the contrast of the profile.
        Numerals and dirt have lower peaks.
    line_reach : float
        Distance from a line within which its darkness is measured, in divisions.
    max_line_residual : float
        Rms deviation of the lines of a scale from a smooth curve, in divisions. Scales are ruled to
        0.01 to 0.05, and other stripes are rarely regular to 0.05.
    min_lines : int
        Number of lines of a scale. Three lines leave one residual.
    min_regular : float
        Fraction of the lines of an image that lie at equal distances.
    """

    max_pixels: float = 2.5e6
    min_reduced_side: float = 14.0
    many_marks: int = 64
    levels: int = 20
    min_contour: int = 14
    max_area: float = 1 / 16
    ellipse_ratio: tuple[float, float] = (0.90, 1.02)
    max_slope_scatter: float = 0.5
    max_region_ratio: float = 4.0
    only_pattern: float = 0.7
    neighbors: int = 12
    step_tolerance: float = 1 / 4
    saddle_blurs: tuple[float, float] = (1.5, 3.0)
    min_saddle: float = 0.01
    max_saddles: int = 4000
    max_boards: int = 16
    corner_neighbors: tuple[int, int] = (12, 50)
    max_edge_curvature: float = 1 / 4
    max_corner_product: float = -1 / 2
    corner_tolerance: float = 1 / 3
    corner_correlations: tuple[float, ...] = (0.4, 0.6, 0.7)
    edge_width: float = 1 / 12
    field_margin: float = 0.15
    min_marker_scatter: float = 0.05
    min_correlation: float = 0.7
    min_contrast: float = 0.7
    max_moment_scatter: float = 0.3
    max_round_rms: float = 1 / 4
    max_shift: float = 1 / 6
    max_blur: float = 1 / 3
    max_rms_ratio: float = 3.0
    max_uncertainty_ratio: float = 4.0
    max_uncertainty: float = 1 / 20
    max_shape_scatter: float = 0.08
    max_skew: float = 0.1
    min_fill: float = 0.6
    initial_blur: float = 1.2
    max_iterations: int = 100
    shape_iterations: int = 12
    cost_tolerance: float = 1e-6
    neighbor_iterations: int = 3
    max_chi2_deviation: float = 6.0
    max_band: float = 7.0
    min_band: tuple[float, float] = (1.0, 2.0)
    corner_width: tuple[float, float] = (0.45, 1 / 8)
    max_patch: float = 12.0
    max_residual: float = 0.012
    max_board_residual: float = 0.03
    max_noise_ratio: float = 3.0
    max_noise_residual: float = 0.015
    min_kept: float = 3 / 4
    outlier_limit: float = 6.0
    prior_residuals: float = 8.0
    angle_range: float = 0.1
    angle_count: int = 81
    min_peak: float = 1 / 3
    line_reach: float = 2 / 5
    max_line_residual: float = 0.05
    min_lines: int = 3
    min_regular: float = 3 / 4
