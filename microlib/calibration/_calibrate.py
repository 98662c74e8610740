"""Calibrate a microscope from images of a plane pattern (2.13–2.20).

Radial alignment gives the pose up to the sign of the tilt, and a linear fit gives the magnification
and the distortion. Nonlinear least squares refines all parameters together. Parameters that the
points do not determine are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, positive, scalar
from microlib.calibration._calibration import Calibration
from microlib.calibration._detection import Detection
from microlib.calibration._stage import plane_points
from microlib.calibration._uncertainty import KILOMETER, noise_covariance
from microlib.calibration._views import (
    POSE,
    Fit,
    Views,
    fit_views,
)
from microlib.calibration.adequacy._held_out import held_out_errors
from microlib.calibration.adequacy._lack_of_fit import check_fit
from microlib.calibration.adequacy._lens_terms import add_lens_terms
from microlib.microscope import Microscope


def calibrate(
    world: ArrayLike | Sequence[ArrayLike] | Detection | Sequence[Detection],
    image: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    pixel_pitch: float | tuple[float, float],
    pitch: float | None = None,
    focal_length: float | None = None,
    image_size: tuple[int, int] | None = None,
) -> Calibration:
    """Calibrate magnification, pose and distortion from images of a plane pattern.

    Parameters
    ----------
    world : Detection or array_like, shape (N, 2), or a list of either
        Detection of a pattern, or points of the pattern in µm. A detection needs `pitch`. Several
        views are given as a list.
    image : array_like, shape (N, 2), or a list of them, optional
        Image points (x, y) of the points in `world`, px. Not needed for a detection, which contains
        the image points.
    pixel_pitch : float or (float, float)
        Distance of neighboring pixels on the sensor (pixel pitch), µm.
    pitch : float, optional
        Distance of neighboring marks of a detected pattern, µm.
    focal_length : float, optional
        Focal length f of the objective as the manufacturer states it, µm. By default f is
        estimated, which needs a tilted pattern (see Notes).
    image_size : (int, int), optional
        Width and height of the image, px. Required for points; a detection contains the size.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If shapes disagree, if there are fewer than 5 points, if points lie on one line or outside
        the image, or if no microscope fits the points.

    Notes
    -----
    *Focal length.* The model has three lengths, as in chapter 2: the tube length T_op, the focal
    length f, and the distance d of the object plane from the focal point. The image of a plane
    determines only two combinations of these lengths, T_op + f and f + d. Without the perspective
    of a tilted pattern, the image determines only the ratio of the two combinations, which is the
    magnification. The thesis therefore starts from the f of the manufacturer. The plane is in
    focus, so the thesis computes d = f²/T_op (2.20). This function assumes (2.20) as well. A given
    `focal_length` is kept fixed. Without `focal_length`, f is estimated, with an uncertainty that
    increases as the tilt decreases. If the estimate of 1/(T_op + f) is less than four of its
    standard deviations above zero, the attribute `undetermined` of the result lists f and the
    angles of the tilt.

    *Uncertainty.* The covariance includes the image noise. It also includes the correlation of the
    errors of points that belong to one mark, such as the corners of a square. With several views it
    also includes the errors of the printed pattern, which are the same in all views. If a
    lack-of-fit test of the residuals has a p-value below 0.1, the covariance also includes the
    model discrepancy, which is the smooth part of the residuals that the noise does not explain.

    *Several views* share the distortion and, without a given `focal_length`, the length T_op + f.
    Each view has its own magnification M and its own pose. From the second view on, the names of
    these parameters end in the number of the view. In focus T_op + f is equal to f (1 + M), so an
    estimated f differs between views of different magnification. The result contains the f of the
    first view.

    With several views, two additions to the model with one distortion coefficient κ are tested,
    first the principal point and then a second coefficient κ₂. An addition is kept if it lowers the
    Bayesian information criterion. The names of the additional parameters are "distortion_k2"
    (1/µm⁴), and "principal_x" and "principal_y" (px from the middle of the image). Let u be the
    image point of the model with κ alone, in µm from the principal point. With κ₂, the image point
    is u (1 + κ₂ r⁴), where r = ‖u‖. The principal point of a single view is the middle of the
    image, as in the thesis.

    *Sign of the tilt.* Without perspective, the tilts (β, γ) and (−β, −γ) would give the same
    image. The fit is made with both pairs of angles. If the residuals do not show which pair is
    right, the attribute `undetermined` lists "beta" and "gamma".

    Examples
    --------
    >>> from microlib.calibration import calibrate, detect_circles
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> truth = Microscope(2e5, 126000, 79380, alpha=0.1, beta=0.03, tx=-900, ty=-700,
    ...                    pixel_pitch=9.9, image_size=(656, 491))
    >>> photograph = render_circles(truth, pitch=280.0)
    >>> found = calibrate(
    ...     detect_circles(photograph), pitch=280, pixel_pitch=9.9, focal_length=126000)
    >>> round(found.microscope.magnification, 3), round(found.microscope.beta, 3)
    (1.587, 0.03)
    """
    positive("pixel_pitch", pixel_pitch)
    if focal_length is not None:
        focal_length = scalar("focal_length", focal_length, above=0)
    worlds, images, marks, size = _inputs(world, image, pitch, image_size)
    frame = Microscope(1.0, 1.0, 1.0, pixel_pitch=pixel_pitch, image_size=size)
    pairs = [_checked_points(w, i, frame) for w, i in zip(worlds, images, strict=True)]
    views = Views([w for w, _ in pairs], [i for _, i in pairs], frame, focal_length)
    fit, alone = fit_views(views)
    fit = add_lens_terms(views, fit)
    # Wrong units lead to a magnification below zero, or to residuals as large as the image.
    if not (fit.poses[:, 0] > 0).all() or np.sqrt(views.residual_variance(fit)) > max(size) / 20:
        raise views.refusal
    return _build_result(views, fit, alone, _mark_numbers(views, fit, marks))


def _inputs(
    world: Any, image: Any, pitch: float | None, image_size: Any
) -> tuple[list[Any], list[Any], Array | None, tuple[int, int]]:
    """World and image points of each view, the grid coordinates of the mark of each point if marks
    have several points, and the size of the images."""
    several = isinstance(world, (list, tuple)) and (
        isinstance(world[0], Detection) or np.ndim(world[0]) > 1
    )
    worlds = list(world) if several else [world]
    found = [each for each in worlds if isinstance(each, Detection)]
    if not found:
        if pitch is not None:
            raise ValueError("pitch must be left out with points in µm, got one")
        if image_size is None:
            raise ValueError("image_size must be given, (width, height) in px, got none")
        if several and (not isinstance(image, (list, tuple)) or len(image) != len(worlds)):
            raise ValueError(f"image must hold one array for each of the {len(worlds)} views")
        return worlds, list(image) if several else [image], None, image_size
    if image is not None or image_size is not None:
        raise ValueError("image and image_size must not be given with a detection")
    if len(found) < len(worlds):
        raise ValueError("world must hold either detections or points, got both")
    if pitch is None:
        raise ValueError("pitch must be given with a detection, µm from mark to mark, got none")
    pitch = scalar("pitch", pitch, above=0)
    size = found[0].image_size
    if any(each.image_size != size for each in found):
        raise ValueError("world must hold detections in images of one size, got several")
    squares = any(len(np.unique(each.group)) < len(each.group) for each in found)
    marks = np.concatenate([each.grid // 2 for each in found]) if squares else None
    return [pitch * each.positions for each in found], [e.points for e in found], marks, size


def _checked_points(world: Any, image: Any, frame: Microscope) -> tuple[Array, Array]:
    """World points of one view and its image points from the middle of the image."""
    # Radial alignment has six unknowns up to scale and one equation for each point.
    world, image = plane_points(5, world=world, image=image)
    outside = ((image < -1) | (image > frame.image_size)).any(axis=1)
    if outside.any():
        raise ValueError(
            f"image must lie in the image_size of (width, height) = {frame.image_size} px, got "
            f"{int(outside.sum())} of {len(image)} points beyond it, one at {image[outside][0]}"
        )
    return world, image - frame.principal_point


def _mark_numbers(views: Views, fit: Fit, marks: Array | None) -> NDArray[np.intp] | None:
    """Number of the mark of each point, None if all points are independent.

    Points of several views belong to one mark if they have one place in the pattern. With no more
    marks than parameters, the scatter of the marks gives no covariance.
    """
    if marks is None and len(views.world) > 1:
        marks = np.round(np.concatenate(views.world), 6)
    if marks is None:
        return None
    numbers = np.unique(marks, axis=0, return_inverse=True)[1].ravel()
    return numbers if numbers.max() >= len(fit.free) else None


def _build_result(
    views: Views, fit: Fit, alone: list[list[Fit]], marks: NDArray[np.intp] | None
) -> Calibration:
    """Estimates with their covariance, the undetermined ones, and a microscope for each view."""
    test = check_fit(views, fit, marks)
    inner = noise_covariance(views, fit, marks) + test.covariance
    undetermined = _undetermined(fit, alone, np.sqrt(np.diag(inner)), views.residual_variance(fit))
    names, lens, estimate = np.array(fit.names), fit.lens.copy(), fit.estimate
    if "focal_length" in names[undetermined]:  # an infinite one is reported as a kilometer
        lens[0] = max(lens[0], 1 / (KILOMETER * (1 + fit.poses[0, 0])))
    scopes = [_microscope(views, lens, pose) for pose in fit.poses]
    by_fitted = np.eye(len(estimate))
    if "focal_length" in names:  # f = 1/((1 + M) p) replaces the fitted p = 1/(T_op + f)
        f = estimate[1] = scopes[0].focal_length
        by_fitted[1, :2] = -f / (1 + estimate[0]), -f / lens[0]
    outer = by_fitted @ np.where(np.isfinite(inner), inner, 0.0) @ by_fitted.T
    outer[undetermined] = outer[:, undetermined] = np.nan
    outer[undetermined, undetermined] = np.inf
    residuals = -fit.residuals.reshape(-1, 2)
    ends = np.cumsum([len(world) for world in views.world])[:-1]
    # Beside the thesis' projection of a point, so that the other lens terms need no inverse.
    plane_residuals = [
        scope.back_project(scope.project(world) + part) - world
        for scope, world, part in zip(scopes, views.world, np.split(residuals, ends), strict=True)
    ]
    return Calibration(
        microscope=scopes[0],
        parameters=tuple(fit.names),
        estimate=estimate,
        covariance=outer,
        undetermined=tuple(names[undetermined].tolist()),
        dof=fit.dof if marks is None else int(marks.max()),
        residuals=residuals,
        plane_residuals=np.concatenate(plane_residuals),
        misfit=test.misfit,
        p_value=test.p_value,
        views=tuple(scopes),
        held_out=held_out_errors(views, fit, alone),
    )


def _microscope(views: Views, lens: Array, pose: Array) -> Microscope:
    """The microscope of a view, in focus."""
    magnification, *rest = pose.tolist()
    f = views.focal_length or 1 / (lens[0] * (1 + magnification))
    lengths = {"tube_length": magnification * f, "focal_length": f, "distance": f / magnification}
    return replace(
        views.frame, distortion=lens[1], **lengths, **dict(zip(POSE[1:], rest, strict=True))
    )


def _undetermined(
    fit: Fit, alone: list[list[Fit]], sigma: Array, variance: float
) -> NDArray[np.bool_]:
    """Which parameters the points do not determine, of `Fit.estimate` with its standard errors."""
    kinds = np.array([name.split("_")[0] for name in fit.names])
    undetermined = np.isinf(sigma)
    focal = kinds == "focal"
    if focal.any():
        # As the sign of the tilt is free, 1/(T_op + f) is never negative. Of 150 noisy views
        # without tilt the largest was 2.2 standard errors; four allow for a larger scatter.
        if not fit.estimate[focal] > 4 * sigma[focal]:
            undetermined |= np.isin(kinds, ["focal", "beta", "gamma"])
        return undetermined
    tilts = np.flatnonzero(np.isin(kinds, ["beta", "gamma"])).reshape(-1, 2)
    for tilt, (best, other) in zip(tilts, alone, strict=True):
        difference = np.abs(np.angle(np.exp(1j * (best.poses - other.poses)[0, 2:4])))
        # The two minima differ by three standard errors of the tilt, and their sums of squares by
        # less than (2 σ)² of the noise: nothing prefers one of them.
        if (difference > 3 * sigma[tilt]).any() and other.rss - best.rss < 4 * variance:
            undetermined[tilt] = True
    return undetermined
