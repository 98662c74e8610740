"""Calibrate a microscope from images of a plane pattern (2.13–2.20).

Radial alignment gives the pose up to the sign of the tilt, a linear fit the magnification and
distortion, and nonlinear least squares refines all of them together. What the points cannot
determine is held or named, never made up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from microlib._common import Array, as_array, between, inverse_normal, same_length, scalar
from microlib.calibration._calibration import Calibration
from microlib.calibration._detection import Detection
from microlib.calibration._stage import span_plane
from microlib.calibration._uncertainty import (
    BY_CHANCE,
    FARTHEST,
    axis_errors,
    discrepancy,
    fields_of_views,
    jackknife,
)
from microlib.calibration._views import LENS, VIEW, Fit, Views, fit_views, without_terms
from microlib.microscope import Microscope

#: The optical axis meets the sensor so far from its middle, standard deviation in widths of the
#: image: 1 to 2 % in the camera modules and published calibrations that one finds.
_AXIS_ASIDE = 0.02


def calibrate(
    world: ArrayLike | Sequence[ArrayLike] | Detection | Sequence[Detection],
    image: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    pixel_size: float | tuple[float, float],
    pitch: float | None = None,
    focal_length: float | None = None,
    image_size: tuple[int, int] | None = None,
    groups: ArrayLike | Sequence[ArrayLike] | None = None,
) -> Calibration:
    """Pose, magnification and distortion of a microscope from images of a plane pattern.

    Parameters
    ----------
    world : Detection or array_like, shape (N, 2), or a list of either
        What a detector found, which needs `pitch` and holds the other points, the size of the image
        and the groups; or points of the pattern, µm. Of several views, a list.
    image : array_like, shape (N, 2), or a list of them
        Where points of the pattern are seen, (x, y) px.
    pixel_size : float or (float, float)
        Pitch of the sensor cells, µm.
    pitch : float
        Of a detection: distance of neighboring marks, µm.
    focal_length : float, optional
        Focal length f of the objective as its manufacturer gives it, µm. Without it f is estimated
        too, which needs a tilted pattern: see Notes.
    image_size : (int, int)
        Width and height of the image, px; the optical axis meets its center.
    groups : array_like of int, shape (N,), or a list of them, optional
        Points of one number have correlated errors, as the corners of one square have. The
        covariance then allows for it. Without `groups` the errors of one view are taken as
        independent and alike. Of several views a number means the same mark in all; without them
        that is a world point: a mark that was made beside its place is so in every view.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If shapes disagree, there are fewer than 5 points or no more groups than parameters, points
        lie on one line or beyond the image, or they fit no microscope.

    Notes
    -----
    From one plane, only T_op + f and f + d can be seen, and the perspective that tells them apart
    fades with the tilt. The thesis therefore takes f from the manufacturer and lets (2.12) tie d to
    it: the plane is in focus. Without `focal_length` the same tie makes f the one number that the
    perspective determines. If 1/f is less than four standard errors from zero, f and the tilt's
    angles are named in `unobservable`.

    Several views share the lens: T_op + f and the distortion. Each has a magnification and a pose
    of its own; their names end in the view's number from the second view on, and f is that of the
    first. Where the views hold them, that is where Schwarz' criterion is in favor, a second term of
    the distortion and the point where the optical axis meets the sensor are estimated too
    ("distortion_2" in 1/µm⁴; "principal_x" and "principal_y" in px from the image's middle): with
    u from that point, the image has u (1 + κ₂ r⁴) where one term alone has u.

    Tilts (β, γ) and (−β, −γ) give the same image but for perspective. Both are tried. If the better
    one is not better by more than noise, "beta" and "gamma" are named in `unobservable`.

    The axis is trusted to meet the middle of the image, as in the thesis, as long as the residuals
    look like noise; else the intervals, but for those of T_x and T_y, which count from the middle,
    allow for 2 % of the image's width.

    Examples
    --------
    >>> from microlib.calibration import calibrate, detect_circles
    >>> from microlib.microscope import Microscope
    >>> from microlib.synthetic import render_circles
    >>> truth = Microscope(2e5, 126000, 79380, alpha=0.1, beta=0.03, tx=-900, ty=-700)
    >>> photograph = render_circles(truth, pitch=280.0)
    >>> found = calibrate(
    ...     detect_circles(photograph), pitch=280, pixel_size=9.9, focal_length=126000)
    >>> round(found.microscope.magnification, 3), round(found.microscope.beta, 3)
    (1.587, 0.03)
    """
    between("pixel_size", pixel_size, 1 / FARTHEST, FARTHEST)
    if focal_length is not None:
        focal_length = scalar("focal_length", focal_length, least=1 / FARTHEST, most=FARTHEST)
    detections = [world] if isinstance(world, Detection) else world
    if isinstance(detections, (list, tuple)) and any(isinstance(d, Detection) for d in detections):
        if any(given is not None for given in (image, image_size, groups)):
            raise ValueError("image, image_size and groups must not be given beside a detection")
        worlds, images, labels, image_size = _of_detections(list(detections), pitch)
    else:
        if pitch is not None:
            raise ValueError("pitch must be left out with points in µm, got one")
        each: Any = (world, image, groups)
        worlds, images, labels = each if _are_several(world) else ([x] for x in each)
        labels = None if groups is None else labels
        for name, given in (("image", images), ("groups", worlds if labels is None else labels)):
            listed = isinstance(given, (list, tuple)) or np.ndim(given) > 0
            if not listed or len(given) != len(worlds):
                raise ValueError(f"{name} must hold one array for each of the {len(worlds)} views")
    if image_size is None:
        raise ValueError("image_size must be given, (width, height) in px, got none")
    frame = Microscope(1.0, 1.0, 1.0, pixel_size=pixel_size, image_size=image_size)
    pairs = [_points(w, i, image_size) for w, i in zip(worlds, images, strict=True)]
    seen: list[Array] = [i - frame.principal_point for _, i in pairs]
    views = Views([w for w, _ in pairs], seen, frame.cell, focal_length)
    marks = None
    if labels is not None:
        zipped = zip(labels, seen, strict=True)
        checked = [as_array("groups", label, shape=(len(points),)) for label, points in zipped]
        marks = np.unique(np.concatenate(checked), return_inverse=True)[1]
    elif len(pairs) > 1:
        every = np.round(np.concatenate(views.world), 6)
        marks = np.unique(every, axis=0, return_inverse=True)[1].ravel()
    fit, alone = fit_views(views)
    if marks is not None and marks.max() < len(fit.free):
        if groups is not None:
            raise ValueError(
                f"groups must be more than the {len(fit.free)} parameters, got {marks.max() + 1}"
            )
        marks = None
    if not (fit.poses[:, 0] > 0).all():
        raise ValueError(
            f"world and image must fit a microscope, got magnifications {fit.poses[:, 0]}"
        )
    return _report(views, fit, alone, marks, frame)


def _of_detections(found: list[Any], pitch: float | None) -> tuple[Any, Any, Any, tuple[int, int]]:
    """World and image points of each view, the numbers of their squares, and the image's size."""
    if not all(isinstance(each, Detection) for each in found):
        raise ValueError("world must hold either detections or points, got both")
    if pitch is None:
        raise ValueError("pitch must be given with a detection, µm from mark to mark, got none")
    pitch = scalar("pitch", pitch, above=0)
    if any(each.image_size != found[0].image_size for each in found):
        raise ValueError("world must hold detections in images of one size, got several")
    numbers = None
    if any(len(np.unique(each.group)) < len(each.group) for each in found):
        # A square's corners; the same in all views, whatever mark is the first in each.
        cells = np.concatenate([each.grid // 2 for each in found])
        ends = np.cumsum([len(each.grid) for each in found])[:-1]
        numbers = np.split(np.unique(cells, axis=0, return_inverse=True)[1].ravel(), ends)
    points = [each.points for each in found]
    return [pitch * each.positions for each in found], points, numbers, found[0].image_size


def _are_several(world: Any) -> bool:
    """True for a sequence of arrays of points, False for the points of one view."""
    try:
        return np.ndim(world[0]) == 2
    except (TypeError, ValueError, IndexError, KeyError):  # told by the checks of one view
        return False


def _points(world: Any, image: Any, image_size: tuple[int, int]) -> tuple[Array, Array]:
    """Checked points of one view."""
    world = as_array("world", world, shape=(None, 2))
    image = as_array("image", image, shape=(None, 2))
    same_length(("world", "image"), world, image)
    between("world", world, -FARTHEST, FARTHEST)
    if len(world) < 5:  # radial alignment has six unknowns up to scale, one equation a point
        raise ValueError(f"world must hold at least 5 points, got {len(world)}")
    span_plane(world=world, image=image)
    beyond = ((image < -1) | (image > image_size)).any(axis=1)
    if beyond.any():
        raise ValueError(
            f"image must lie in the image_size of (width, height) = {tuple(image_size)} px, got "
            f"{int(beyond.sum())} of {len(image)} points beyond it, one at {image[beyond][0]}"
        )
    return world, image


def _report(
    views: Views,
    fit: Fit,
    alone: list[list[Fit]],
    marks: NDArray[np.intp] | None,
    frame: Microscope,
) -> Calibration:
    """Parameters with their covariance, which are lost, and a microscope for each view."""
    names, jacobian = _in_focal_length(fit)
    known = _covariance(views, fit, names=names, jacobian=jacobian, marks=marks, frame=frame)
    lost = _undetermined(fit, alone, names=names, known=known)
    poses = fit.poses.copy()
    poses[:, 1:4] = np.angle(np.exp(1j * poses[:, 1:4]))
    values = dict(zip(_numbers(fit), [*fit.lens, *poses.ravel()], strict=True))
    power = values["focal_length"] * (1 + values["magnification"])
    if "focal_length" in lost:  # it may come out as zero: then f is held at a kilometer
        power = max(power, 1 / FARTHEST)
    covariance = known.covariance
    if "focal_length" in names:
        values["focal_length"] = 1 / power
        k = names.index("focal_length")
        covariance[k] *= -1 / power**2
        covariance[:, k] *= -1 / power**2
    for k in (names.index(name) for name in lost):
        covariance[k] = covariance[:, k] = np.nan
        covariance[k, k] = np.inf
    scopes = []
    for pose in poses.tolist():
        f = views.focal_length or (1 + poses[0, 0]) / (power * (1 + pose[0]))
        lengths = {"tube_length": pose[0] * f, "focal_length": f, "distance": f / pose[0]}
        angles = dict(zip(VIEW[1:], pose[1:], strict=True))
        scopes.append(replace(frame, distortion=float(fit.lens[1]), **lengths, **angles))
    plane_residuals = [
        scope.back_project(without_terms(fit.lens, seen, frame.cell) + frame.principal_point)
        - world
        for scope, seen, world in zip(scopes, views.seen, views.world, strict=True)
    ]
    return Calibration(
        scopes[0],
        tuple(names),
        np.array([values[name] for name in names]),
        covariance,
        tuple(name for name in names if name in lost),
        known.freedom,
        -fit.residuals.reshape(-1, 2),
        np.concatenate(plane_residuals),
        known.misfit,
        known.chance,
        tuple(scopes),
    )


@dataclass(frozen=True, eq=False)
class _Known:
    """Covariance of the parameters, variance of a residual in px² with its degrees of freedom, and
    how far the model fits, as `Calibration` has it."""

    covariance: Array
    variance: float
    freedom: int
    misfit: float
    chance: float


def _numbers(fit: Fit) -> list[str]:
    """Names of all numbers of the lens and of the views, in the order of a fit."""
    each = [n if v == 0 else f"{n}_{v + 1}" for v in range(len(fit.poses)) for n in VIEW]
    return ["focal_length", *LENS[1:], *each]


def _in_focal_length(fit: Fit) -> tuple[list[str], Array]:
    """Names of the free parameters, the magnification first, and the residuals' derivatives by
    them, of which 1/f stands for 1/(T_op + f)."""
    every = _numbers(fit)
    names, jacobian = [every[k] for k in fit.free], fit.jacobian
    if "focal_length" in names:  # 1/f = (1 + M)/(T_op + f) of the first view
        turn = np.eye(len(names))
        turn[0, 0], turn[0, names.index("magnification")] = 1 + fit.poses[0, 0], fit.lens[0]
        jacobian = np.linalg.solve(turn.T, jacobian.T).T
    order = sorted(range(len(names)), key=lambda k: names[k] != "magnification")
    return [names[k] for k in order], jacobian[:, order]


def _covariance(
    views: Views,
    fit: Fit,
    *,
    names: list[str],
    jacobian: Array,
    marks: NDArray[np.intp] | None,
    frame: Microscope,
) -> _Known:
    """How well the points tell the parameters: noise, what the model lacks, and the axis."""
    residuals, rounding = fit.residuals, views.rounding(fit.poses)
    freedom = len(residuals) - len(names)
    inverse = inverse_normal(jacobian)
    variance = fit.cost / freedom + rounding
    if marks is None:
        covariance = inverse * variance
    else:
        covariance = jackknife(jacobian, residuals, marks) + inverse * rounding
        freedom = int(marks.max())
    misfit, chance, added = _smooth_part(views, residuals, jacobian, marks, rounding)
    covariance = covariance + added
    if chance < BY_CHANCE and "principal_x" not in names:
        shifted = [k for k, name in enumerate(names) if name[:2] in ("tx", "ty")]
        aside = _AXIS_ASIDE * frame.image_size[0]
        covariance = covariance + axis_errors(jacobian, variance, shifted, aside)
    return _Known(covariance, variance, freedom, misfit, chance)


def _undetermined(fit: Fit, alone: list[list[Fit]], *, names: list[str], known: _Known) -> set[str]:
    """Names of the parameters that the points do not determine."""
    sigma = dict(zip(names, np.sqrt(np.diag(known.covariance)), strict=True))
    lost = {name for name, value in sigma.items() if np.isinf(value)}
    if "focal_length" in names:
        # As the sign of the tilt is free, 1/f is never negative: 150 noisy views without tilt came
        # to 2.2 standard errors at most; the rest is for errors that are less even than noise.
        if not fit.lens[0] * (1 + fit.poses[0, 0]) > 4 * sigma["focal_length"]:
            lost |= {name for name in names if name.startswith(("focal", "beta", "gamma"))}
        return lost
    for v, (best, other) in enumerate(alone):
        tilt = _numbers(fit)[len(LENS) + len(VIEW) * v :][2:4]
        apart = np.abs(np.angle(np.exp(1j * (best.poses - other.poses)[0, 2:4])))
        # Two minima three standard errors apart, of which the sums of squares differ by less than
        # two standard deviations of noise, squared, cannot be told from each other.
        distinct = (apart > 3 * np.array([sigma[name] for name in tilt])).any()
        if distinct and other.cost - best.cost < 4 * known.variance:
            lost |= set(tilt)
    return lost


def _smooth_part(
    views: Views,
    residuals: Array,
    jacobian: Array,
    marks: NDArray[np.intp] | None,
    rounding: float,
) -> tuple[float, float, Array]:
    """The discrepancy of the means over the points of a mark in a view, whose errors are
    correlated."""
    # Where the model has the points: fields of the noisy ones would hold their noise.
    points = np.concatenate(views.seen) + residuals.reshape(-1, 2)
    view = np.repeat(np.arange(len(views.seen)), [len(seen) for seen in views.seen])
    if marks is not None:
        both = np.column_stack([view, marks])
        each, label, size = np.unique(both, axis=0, return_inverse=True, return_counts=True)
        label, view = label.ravel(), each[:, 0]
        mean = csr_array((1 / size[label], (label, np.arange(len(label)))))
        points, residuals = mean @ points, (mean @ residuals.reshape(-1, 2)).ravel()
        jacobian = (mean @ jacobian.reshape(len(label), -1)).reshape(-1, jacobian.shape[1])
    fields = fields_of_views([points[view == v] for v in range(len(views.seen))])
    return discrepancy(residuals, jacobian, fields, rounding)
