"""Calibrate a microscope from images of a plane pattern (2.13–2.20).

Radial alignment gives the pose up to the sign of the tilt, a linear fit the magnification and
distortion, and nonlinear least squares refines all of them together. What the points cannot
determine is held or named, never made up.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from microlib._common import Array, as_array, between, inverse_normal, scalar
from microlib.calibration._calibration import Calibration
from microlib.calibration._detection import Detection
from microlib.calibration._stage import plane_points
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
    found = [world] if isinstance(world, Detection) else world
    if isinstance(found, (list, tuple)) and any(isinstance(each, Detection) for each in found):
        if any(given is not None for given in (image, image_size, groups)):
            raise ValueError("image, image_size and groups must not be given beside a detection")
        worlds, images, labels, image_size = _of_detections([*found], pitch)
    else:
        if pitch is not None:
            raise ValueError("pitch must be left out with points in µm, got one")
        worlds, images, labels = _lists(world, image, groups)
    if image_size is None:
        raise ValueError("image_size must be given, (width, height) in px, got none")
    frame = Microscope(1.0, 1.0, 1.0, pixel_size=pixel_size, image_size=image_size)
    pairs = [_points(w, i, frame) for w, i in zip(worlds, images, strict=True)]
    views = Views([w for w, _ in pairs], [s for _, s in pairs], frame, focal_length)
    marks = _numbered(views, labels)
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
    return _report(views, fit, alone, marks)


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
        # Of the corners of a square one; the same in all views, whatever mark is the first in each.
        numbers = [(each.grid // 2) @ [1, 1e6] for each in found]
    points = [each.points for each in found]
    return [pitch * each.positions for each in found], points, numbers, found[0].image_size


def _lists(world: Any, image: Any, groups: Any) -> tuple[Any, Any, Any]:
    """World and image points of each view, and the groups where they are given."""
    several = False
    with suppress(TypeError, ValueError, IndexError, KeyError):  # told by the checks of one view
        several = np.ndim(world[0]) == 2
    if not several:
        world, image, groups = [world], [image], None if groups is None else [groups]
    for name, given in (("image", image), ("groups", world if groups is None else groups)):
        listed = isinstance(given, (list, tuple)) or np.ndim(given) > 0
        if not listed or len(given) != len(world):
            raise ValueError(f"{name} must hold one array for each of the {len(world)} views")
    return world, image, groups


def _numbered(views: Views, labels: Any) -> NDArray[np.intp] | None:
    """Number of the mark that each point of the views is of; by default, of several views, one for
    each place in the world."""
    if labels is None and len(views.world) == 1:
        return None
    every: Array = np.round(np.concatenate(views.world), 6)
    if labels is not None:
        zipped = zip(labels, views.seen, strict=True)
        every = np.concatenate([as_array("groups", one, shape=(len(at),)) for one, at in zipped])
    return np.unique(every, axis=0, return_inverse=True)[1].ravel()


def _points(world: Any, image: Any, frame: Microscope) -> tuple[Array, Array]:
    """Checked points of one view, in the image from its middle."""
    # Radial alignment has six unknowns up to scale, one equation a point.
    world, image = plane_points(5, world=world, image=image)
    beyond = ((image < -1) | (image > frame.image_size)).any(axis=1)
    if beyond.any():
        raise ValueError(
            f"image must lie in the image_size of (width, height) = {frame.image_size} px, got "
            f"{int(beyond.sum())} of {len(image)} points beyond it, one at {image[beyond][0]}"
        )
    return world, image - frame.principal_point


def _report(
    views: Views, fit: Fit, alone: list[list[Fit]], marks: NDArray[np.intp] | None
) -> Calibration:
    """Parameters with their covariance, which are lost, and a microscope for each view."""
    every = _numbers(fit)
    order = sorted(range(len(fit.free)), key=lambda k: every[fit.free[k]] != "magnification")
    names = [every[fit.free[k]] for k in order]
    fit = replace(fit, jacobian=fit.jacobian[:, order])
    variance = fit.cost / (len(fit.residuals) - len(names)) + views.rounding(fit.poses)
    covariance, misfit, chance = _covariance(views, fit, names, variance, marks)
    sigma = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    lost = _undetermined(fit, alone, sigma, variance)
    lens, poses = fit.lens.copy(), fit.poses.copy()
    poses[:, 1:4] = np.angle(np.exp(1j * poses[:, 1:4]))
    if "focal_length" in lost:  # it may come out as zero: then f is held at a kilometer
        lens[0] = max(lens[0], 1 / FARTHEST)
    values = dict(zip(every, [1 / lens[0], *lens[1:], *poses.ravel()], strict=True))
    by = np.array([-(values[name] ** 2) if name == "focal_length" else 1.0 for name in names])
    covariance *= np.outer(by, by)
    for k in (names.index(name) for name in lost):
        covariance[k] = covariance[:, k] = np.nan
        covariance[k, k] = np.inf
    scopes = [_microscope(views, lens, poses, v) for v in range(len(poses))]
    plane_residuals = [
        scope.back_project(without_terms(lens, seen, scope.cell) + scope.principal_point) - world
        for scope, seen, world in zip(scopes, views.seen, views.world, strict=True)
    ]
    return Calibration(
        scopes[0],
        tuple(names),
        np.array([values[name] for name in names]),
        covariance,
        tuple(name for name in names if name in lost),
        len(fit.residuals) - len(names) if marks is None else int(marks.max()),
        -fit.residuals.reshape(-1, 2),
        np.concatenate(plane_residuals),
        misfit,
        chance,
        tuple(scopes),
    )


def _microscope(views: Views, lens: Array, poses: Array, view: int) -> Microscope:
    """The microscope of a view, in focus."""
    magnification, *rest = poses[view].tolist()
    f = views.focal_length or (1 + poses[0, 0]) / (lens[0] * (1 + magnification))
    lengths = {"tube_length": magnification * f, "focal_length": f, "distance": f / magnification}
    pose = dict(zip(VIEW[1:], rest, strict=True))
    return replace(views.frame, distortion=lens[1], **lengths, **pose)


def _numbers(fit: Fit) -> list[str]:
    """Names of all numbers of the lens and of the views, in the order of a fit."""
    each = [n if v == 0 else f"{n}_{v + 1}" for v in range(len(fit.poses)) for n in VIEW]
    return [*LENS, *each]


def _covariance(
    views: Views, fit: Fit, names: list[str], variance: float, marks: NDArray[np.intp] | None
) -> tuple[Array, float, float]:
    """How well the points tell the parameters, of the focal length its inverse: by noise, what the
    model lacks, and the axis; the misfit, and the chance of so much by noise alone."""
    rounding = views.rounding(fit.poses)
    inverse = inverse_normal(fit.jacobian)
    if marks is None:
        covariance = inverse * variance
    else:
        covariance = jackknife(fit.jacobian, fit.residuals, marks) + inverse * rounding
    misfit, chance, added = _smooth_part(views, fit, marks, rounding)
    if chance < BY_CHANCE and "principal_x" not in names:
        shifted = [k for k, name in enumerate(names) if name[:2] in ("tx", "ty")]
        added = added + axis_errors(
            fit.jacobian, variance, shifted, _AXIS_ASIDE * views.frame.image_size[0]
        )
    return covariance + added, misfit, chance


def _undetermined(
    fit: Fit, alone: list[list[Fit]], sigma: dict[str, float], variance: float
) -> set[str]:
    """Names of the parameters that the points do not determine."""
    lost = {name for name, value in sigma.items() if np.isinf(value)}
    if "focal_length" in sigma:
        # As the sign of the tilt is free, 1/f is never negative: 150 noisy views without tilt came
        # to 2.2 standard errors at most; the rest is for errors that are less even than noise.
        if not fit.lens[0] > 4 * sigma["focal_length"]:
            lost |= {name for name in sigma if name.startswith(("focal", "beta", "gamma"))}
        return lost
    for v, (best, other) in enumerate(alone):
        tilt = _numbers(fit)[len(LENS) + len(VIEW) * v :][2:4]
        apart = np.abs(np.angle(np.exp(1j * (best.poses - other.poses)[0, 2:4])))
        # Two minima three standard errors apart, of which the sums of squares differ by less than
        # two standard deviations of noise, squared, cannot be told from each other.
        distinct = (apart > 3 * np.array([sigma[name] for name in tilt])).any()
        if distinct and other.cost - best.cost < 4 * variance:
            lost |= set(tilt)
    return lost


def _smooth_part(
    views: Views, fit: Fit, marks: NDArray[np.intp] | None, rounding: float
) -> tuple[float, float, Array]:
    """The discrepancy of the means over the points of a mark in a view, whose errors are
    correlated."""
    residuals, jacobian = fit.residuals, fit.jacobian
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
