"""Calibrate a microscope from images of a plane pattern (2.13–2.20).

Radial alignment gives the pose up to the sign of the tilt, and a linear fit gives the magnification
and the distortion. Nonlinear least squares refines all parameters together. Parameters that the
points do not determine are named.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import PHYSICAL_RANGES, Array, as_scalar
from microlib.calibration._calibration import Calibration
from microlib.calibration._detection import Detection
from microlib.calibration._fit import (
    LENS,
    POSE,
    Fit,
    InconsistentViews,
    Photographs,
    fit_each_view,
    fit_together,
)
from microlib.calibration._points import photographs_of
from microlib.calibration._uncertainty import (
    KILOMETER,
    noise_covariance,
    reciprocal_estimate,
    student_quantile,
)
from microlib.calibration.adequacy._held_out import agreeing_views, held_out_errors
from microlib.calibration.adequacy._lack_of_fit import check_fit
from microlib.calibration.adequacy._lens_terms import add_lens_terms, print_aspect
from microlib.estimate import Estimate
from microlib.microscope import Microscope, pitch_pair

#: Names of the two parameters of the result that are lengths on the sensor, or over one, with and
#: without the pixel pitch. They replace 1/(T_op + f) and the magnification.
_IN_UM, _IN_PX = ("focal_length", "magnification"), ("principal_distance", "px_per_um")
#: Unit of each parameter; "sensor" is the unit of lengths on the sensor.
_UNITS = {
    "magnification": "",
    "px_per_um": "px/µm",
    "focal_length": "µm",
    "principal_distance": "px",
    "distortion": "1/sensor²",
    "distortion_k2": "1/sensor⁴",
    **dict.fromkeys(("principal_x", "principal_y"), "px"),
    "pixel_aspect": "",
    **dict.fromkeys(("alpha", "beta", "gamma"), "rad"),
    **dict.fromkeys(("tx", "ty"), "µm"),
}


def calibrate(
    world: ArrayLike | Sequence[ArrayLike] | Detection | Sequence[Detection],
    image: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    pixel_pitch: float | tuple[float, float] | None = None,
    pitch: float | tuple[float, float] | None = None,
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
    pixel_pitch : float or (float, float), optional
        Distance of neighboring pixels on the sensor (pixel pitch), µm, along x and y. Without it,
        the pixels are taken to be square, and the result contains neither a magnification nor
        a focal length in µm (see Notes).
    pitch : float or (float, float), optional
        Distance of neighboring marks of a detected pattern, µm, along the first and the second
        coordinate of its grid, which point right and down in the image.
    focal_length : float, optional
        Focal length f of the objective as the manufacturer states it, µm. By default f is
        estimated, which needs a tilted pattern (see Notes). `focal_length` needs `pixel_pitch`.
    image_size : (int, int), optional
        Width and height of the image, px. Required for points; a detection contains the size.

    Returns
    -------
    Calibration
        The `parameters` with their uncertainties, angles in radians, the `microscope`, and tests
        of the fit.

    Raises
    ------
    ValueError
        If shapes disagree, if there are fewer than 5 points, if points lie on one line or outside
        the image, or if no microscope fits the points. If views must be left out, the attribute
        `views` of the error contains their numbers, counted from zero.

    Notes
    -----
    *Focal length.* The model has three lengths, as in chapter 2: the tube length T_op, the focal
    length f, and the distance d of the object plane from the focal point. The image of a tilted
    plane determines two combinations of these lengths, T_op + f and f + d. Without visible
    perspective, the image determines only the magnification M = (T_op + f)/(f + d). The thesis
    therefore starts from the f of the manufacturer. This function assumes, like the thesis, that
    the plane is in focus, d = f²/T_op (2.20). A given `focal_length` is kept fixed. Without
    `focal_length`, f is estimated, with an uncertainty that increases as the tilt decreases. If the
    perspective is not significant, that is, if 1/(T_op + f) is less than four times its standard
    deviation, the attribute `undetermined` lists f and the angles of the tilt.

    *Without the pixel pitch* an image determines neither the magnification M nor the focal length.
    It determines M divided by the pixel pitch, which is the scale in px/µm, and the principal
    distance T_op + f in px, which OpenCV calls the focal length. These parameters are named
    "px_per_um" and "principal_distance"; they replace "magnification" and "focal_length". The unit
    of the distortion κ is then 1/px², and that of its second coefficient is 1/px⁴.

    *Uncertainty.* The covariance accounts for

    - the noise of the image, which is correlated between points of one mark, such as the corners
      of a square;
    - with several views, the errors of single printed marks, which are the same in all views;
    - the smooth part of the residuals that the noise does not explain, if a test finds such a lack
      of fit (p < 0.1).

    The covariance does not account for an error of `pitch`: if `pitch` is 1 % too large, M is 1 %
    too small, and an estimated f is M/(1 + M) % too large, because T_op + f does not change.

    *Several views* share the distortion and, without a given `focal_length`, the length T_op + f.
    Each view has its own magnification M and its own pose. From the second view on, the names of
    these parameters end in the number of the view. In focus, the shared length T_op + f is
    f (1 + M). An estimated f therefore differs between views of different M; the result contains
    that of the first view.

    For a single view, the principal point is assumed in the middle, as in the thesis. With several
    views, three extensions of the model are tried. Each is kept if it lowers the
    Bayesian information criterion:

    - "distortion_k2" (1/µm⁴), a second coefficient of distortion, see
      :func:`microlib.microscope.undistort`;
    - "principal_x" and "principal_y", the principal point in px from the middle of the image;
    - "pixel_aspect", the height of a pixel divided by its width, both relative to `pixel_pitch`. In
      addition, it must differ from 1 by more than 0.003.

    *A stretched print*: many printers stretch the pattern in one direction. `print_aspect` is the
    estimated stretch. It is given only if the stretch explains at least half of the squared
    residuals of several views. Measure the print
    along both directions, and give both numbers as `pitch`.

    *Inconsistent views*: `inconsistent` lists views that contradict the largest set of views that
    agree on one lens, such as a grating in the background or a mirrored print. If no fit is
    possible, the error lists these views. Leave them out.

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
    if focal_length is not None:
        focal_length = as_scalar("focal_length", focal_length, above=0)
        if pixel_pitch is None:
            raise ValueError("pixel_pitch must be given with focal_length, µm, got none")
    camera = {
        "pixel_pitch": pitch_pair("pixel_pitch", 1.0 if pixel_pitch is None else pixel_pitch),
        "focal_length": focal_length,
    }
    photographs = photographs_of(world, image, pitch, image_size, **camera)
    alone = fit_each_view(photographs)
    agree = agreeing_views(photographs, alone)
    try:
        fit = add_lens_terms(photographs, fit_together(photographs, alone))
        # Wrong units lead to a magnification below zero, or to residuals as large as the image.
        largest = max(photographs.image_size) / 20
        if not (fit.poses[:, 0] > 0).all() or np.sqrt(photographs.residual_variance(fit)) > largest:
            raise photographs.refusal
    except ValueError as fault:
        if agree.all() or agree.sum() < 2:
            raise
        raise InconsistentViews(np.flatnonzero(~agree).tolist()) from fault
    if pixel_pitch is not None:
        magnification = fit.poses[0, POSE.index("magnification")]
        _, least, most = PHYSICAL_RANGES["magnification"]
        if not least <= magnification <= most:
            raise ValueError(
                f"pitch and pixel_pitch give a magnification of {magnification:.4g}, and a "
                f"microscope has {least:g} to {most:g}: must both be in µm"
            )
    return _build_result(photographs, fit, alone, agree, pixel_pitch is not None)


def _mark_numbers(photographs: Photographs, fit: Fit) -> NDArray[np.intp] | None:
    """Number of the mark of each point, None if all points are independent.

    Points of several views belong to one mark if they have one place in the pattern. With no more
    marks than parameters, the scatter of the marks gives no covariance.
    """
    places = photographs.mark_places
    if places is None and len(photographs.world) > 1:
        world = np.concatenate(photographs.world)
        places = np.round(world / np.abs(world).max(), 9)
    if places is None:
        return None
    numbers = np.unique(places, axis=0, return_inverse=True)[1].ravel()
    return numbers if numbers.max() >= len(fit.free) else None


def _build_result(
    photographs: Photographs,
    fit: Fit,
    alone: list[list[Fit]],
    agree: NDArray[np.bool_],
    in_um: bool,
) -> Calibration:
    """Estimates with their covariance, the undetermined ones, and a microscope for each view.

    `agree` states which views have one lens, and `in_um` whether the pixel pitch is known, and with
    it lengths on the sensor in µm.
    """
    mark_numbers = _mark_numbers(photographs, fit)
    test = check_fit(photographs, fit, mark_numbers)
    noise = noise_covariance(photographs, fit, mark_numbers)
    inner = noise + test.covariance
    undetermined = _undetermined(
        fit, alone, np.sqrt(np.diag(inner)), photographs.residual_variance(fit)
    )
    if "inverse_principal" in np.array(fit.names)[undetermined]:
        # 1/(T_op + f) may be zero, and `Microscope` has no infinite f: f is a kilometer at most.
        least = 1 / (KILOMETER * (1 + fit.poses[0, POSE.index("magnification")]))
        fit = replace(fit, lens=np.maximum(fit.lens, [least, *np.full(len(LENS) - 1, -np.inf)]))
    names, values, by_fitted = _reported(fit, in_um)
    covariance = by_fitted @ np.where(np.isfinite(inner), inner, 0.0) @ by_fitted.T
    covariance[undetermined] = covariance[:, undetermined] = np.nan
    covariance[undetermined, undetermined] = np.inf
    dof = fit.dof if mark_numbers is None else int(mark_numbers.max())
    std = np.sqrt(np.diag(covariance)).tolist()
    scopes = [_microscope(photographs, fit.lens, pose) for pose in fit.poses]
    pairs = list(zip(scopes, photographs.world, photographs.image, strict=True))
    return Calibration(
        microscope=scopes[0],
        parameters={
            name: _estimate(name, value, each, dof, in_um)
            for name, value, each in zip(names, values.tolist(), std, strict=True)
        },
        covariance=covariance,
        undetermined=tuple(np.array(names)[undetermined].tolist()),
        dof=dof,
        residuals=np.concatenate([seen - s.project(world) for s, world, seen in pairs]),
        plane_residuals=np.concatenate([s.back_project(seen) - w for s, w, seen in pairs]),
        lack_of_fit=test.lack_of_fit,
        p_value=test.p_value,
        widening=float(np.sqrt(1 + test.covariance[0, 0] / noise[0, 0])),  # of the magnification
        views=tuple(scopes),
        held_out=held_out_errors(photographs, fit, alone, agree),
        inconsistent=tuple(np.flatnonzero(~agree).tolist()) if agree.sum() > 1 else (),
        print_aspect=1.0 if test.p_value > 0.1 else print_aspect(photographs, fit),
    )


def _reported(fit: Fit, in_um: bool) -> tuple[list[str], Array, Array]:
    """Names and values of the parameters of the result, and their derivatives by the fitted ones.

    The focal length f = 1/((1 + M) p), or the principal distance 1/p, replaces p = 1/(T_op + f).
    """
    values, by_fitted = fit.estimate, np.eye(len(fit.free))
    if "inverse_principal" in fit.names:
        p, m = fit.names.index("inverse_principal"), fit.names.index("magnification")
        distance = values[p] = 1 / (values[p] * ((1 + values[m]) if in_um else 1.0))
        by_fitted[p, p] = -distance / fit.lens[LENS.index("inverse_principal")]
        by_fitted[p, m] = -distance / (1 + values[m]) if in_um else 0.0
    principal, scale = _IN_UM if in_um else _IN_PX
    names = [name.replace("inverse_principal", principal) for name in fit.names]
    return [name.replace("magnification", scale) for name in names], values, by_fitted


def _estimate(name: str, value: float, std: float, dof: int, in_um: bool) -> Estimate:
    """Estimate of a parameter with its interval from Student's distribution."""
    kind = re.sub(r"_\d+$", "", name)  # without the number of the view
    unit = _UNITS[kind].replace("sensor", "µm" if in_um else "px")
    least = 0.0 if kind in (*_IN_UM, *_IN_PX) else -np.inf
    if np.isinf(std):
        return Estimate(np.nan, np.inf, least, np.inf, unit)
    if kind in (_IN_UM[0], _IN_PX[0]):  # the error of the reciprocal is nearly normal
        return reciprocal_estimate(value, std / value, dof, unit)
    half = student_quantile(dof) * std
    return Estimate(value, std, max(value - half, least), value + half, unit)


def _microscope(photographs: Photographs, lens: Array, pose: Array) -> Microscope:
    """The microscope of a view, in focus."""
    view = dict(zip((*LENS, *POSE), (*lens.tolist(), *pose.tolist()), strict=True))
    magnification, inverse_principal = view.pop("magnification"), view.pop("inverse_principal")
    pitch = photographs.pixel_pitch * [1.0, view.pop("pixel_aspect")]
    f = photographs.focal_length or 1 / (inverse_principal * (1 + magnification))
    return Microscope(
        tube_length=magnification * f,
        focal_length=f,
        distance=f / magnification,
        principal_offset=(view.pop("principal_x"), view.pop("principal_y")),
        pixel_pitch=tuple(pitch.tolist()),
        image_size=photographs.image_size,
        **view,
    )


def _undetermined(
    fit: Fit, alone: list[list[Fit]], std: Array, variance: float
) -> NDArray[np.bool_]:
    """Which parameters the points do not determine, of `Fit.estimate` with its uncertainties."""
    tilted = np.array([name.startswith(("beta", "gamma")) for name in fit.names])
    undetermined = np.isinf(std)
    if "inverse_principal" in fit.names:
        p = fit.names.index("inverse_principal")
        # As the sign of the tilt is free, 1/(T_op + f) is never negative. Of 150 noisy views
        # without tilt the largest was 2.2 standard errors; four allow for a larger scatter.
        if not fit.estimate[p] > 4 * std[p]:
            undetermined |= tilted
            undetermined[p] = True
        return undetermined
    angles = [POSE.index("beta"), POSE.index("gamma")]
    for tilt, (best, other) in zip(np.flatnonzero(tilted).reshape(-1, 2), alone, strict=True):
        difference = np.abs(np.angle(np.exp(1j * (best.poses - other.poses)[0, angles])))
        # The two minima differ by three standard errors of the tilt, and their sums of squares by
        # less than (2 σ)² of the noise: nothing prefers one of them.
        if (difference > 3 * std[tilt]).any() and other.rss - best.rss < 4 * variance:
            undetermined[tilt] = True
    return undetermined
