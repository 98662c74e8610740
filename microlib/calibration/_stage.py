"""Affine map from stage positions to the image, fitted to a few moves, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Result, inverse_normal
from microlib.calibration._points import plane_points
from microlib.calibration._uncertainty import reciprocal_estimate
from microlib.estimate import Estimate


@dataclass(frozen=True, eq=False, repr=False)
class StageAffine(Result):
    """Affine map from stage positions to the image.

    Attributes
    ----------
    matrix : ndarray, shape (2, 3)
        Image point in px = matrix[:, :2] @ position in µm + matrix[:, 2].
    covariance : ndarray, shape (6, 6)
        Covariance of the elements of `matrix`, row by row; NaN for three moves, which leave no
        residual.
    um_per_pixel : Estimate
        Square root of the area of a pixel on the stage, µm/px. The upper limit of its interval is
        infinite if the moves do not determine it. Three moves leave its uncertainty and its limits
        NaN.
    angle : float
        Angle from the x axis of the image to that of the stage, rad, positive from x to y.
    mirrored : bool
        True if the image shows the axes of the stage with the opposite orientation.
    residuals : ndarray, shape (N, 2)
        Image points minus the map, px.
    """

    matrix: Array
    covariance: Array
    um_per_pixel: Estimate
    angle: float
    mirrored: bool
    residuals: Array

    @property
    def micro_manager(self) -> str:
        """Micro-Manager's PixelSizeAffine: six numbers "a;b;0;c;d;0" from px to µm of the stage."""
        (a, b), (c, d) = np.linalg.inv(self.matrix[:, :2])
        return ";".join(f"{float(n):.9g}" for n in (a, b, 0, c, d, 0))


def stage_affine(stage: ArrayLike, image: ArrayLike) -> StageAffine:
    """Fit the affine map from stage positions to the image by least squares.

    Parameters
    ----------
    stage : array_like, shape (N, 2)
        Positions that the stage reports, µm; at least three, not on one line.
    image : array_like, shape (N, 2)
        Image points (x, y) of one detail of the sample at these positions, px.

    Returns
    -------
    StageAffine

    Raises
    ------
    ValueError
        If shapes disagree, there are fewer than three positions, or they or their images lie on one
        line.

    Notes
    -----
    Micro-Manager's pixel calibrator fits the same map without uncertainty. Four positions or more
    leave residuals, which give the uncertainty. They contain the backlash of the stage if positions
    are reached from both sides.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import stage_affine
    >>> moves = np.array([[0.0, 0], [50, 0], [0, 50], [50, 50], [-50, 0], [0, -50]])
    >>> found = stage_affine(moves, moves @ np.array([[0.0, 2.0], [-2.0, 0.0]]) + [320, 240])
    >>> round(found.um_per_pixel.value, 6), round(found.angle / np.pi, 6), found.mirrored
    (0.5, 0.5, False)
    """
    stage, image = plane_points(3, stage=stage, image=image)  # parameters of each coordinate
    middle = np.eye(3)
    middle[2, :2] = -stage.mean(axis=0)  # subtracts the mean position
    design = np.column_stack([stage, np.ones(len(stage))]) @ middle
    best = np.linalg.lstsq(design, image, rcond=None)[0]
    residuals = image - design @ best
    dof = 2 * (len(stage) - 3)
    variance = float((residuals**2).sum()) / dof if dof else np.nan
    matrix = (middle @ best).T
    each = middle @ inverse_normal(design) @ middle.T  # of the three numbers of a row
    covariance = variance * np.kron(np.eye(2), each)
    linear = matrix[:, :2]
    pixel = 1 / np.sqrt(np.abs(np.linalg.det(linear)))
    by = 0.5 * np.linalg.inv(linear).T.ravel()  # d log √|det A| = ½ tr(A⁻¹ dA)
    relative = np.sqrt(by @ covariance[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])] @ by)
    return StageAffine(
        matrix=matrix,
        covariance=covariance,
        um_per_pixel=reciprocal_estimate(float(pixel), float(relative), dof, "µm/px"),
        angle=float(np.arctan2(linear[1, 0], linear[0, 0])),
        mirrored=bool(np.linalg.det(linear) < 0),
        residuals=residuals,
    )
