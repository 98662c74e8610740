"""Calibrate a microscope from images of a plane pattern (2.13–2.20).

Radial alignment gives the pose up to the sign of the tilt, a linear fit the magnification and
distortion, and nonlinear least squares refines all of them together. What the points cannot
determine is held or named, never made up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, positive, scalar
from microlib.calibration._calibration import Calibration
from microlib.calibration._detection import Detection
from microlib.calibration._stage import plane_points
from microlib.calibration._uncertainty import FARTHEST, covariance
from microlib.calibration._views import VIEW, Fit, Views, fit_views, held_out, without_terms
from microlib.microscope import Microscope


def calibrate(
    world: ArrayLike | Sequence[ArrayLike] | Detection | Sequence[Detection],
    image: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    pixel_size: float | tuple[float, float],
    pitch: float | None = None,
    focal_length: float | None = None,
    image_size: tuple[int, int] | None = None,
) -> Calibration:
    """Pose, magnification and distortion of a microscope from images of a plane pattern.

    Parameters
    ----------
    world : Detection or array_like, shape (N, 2), or a list of either
        What a detector found, which needs `pitch` and holds the other points and the size of the
        image; or points of the pattern, µm. Of several views, a list.
    image : array_like, shape (N, 2), or a list of them, optional
        Where points of the pattern are seen, (x, y) px.
    pixel_size : float or (float, float)
        Pitch of the sensor cells, µm.
    pitch : float, optional
        Of a detection: distance of neighboring marks, µm.
    focal_length : float, optional
        Focal length f of the objective as its manufacturer gives it, µm. Without it f is estimated
        too, which needs a tilted pattern: see Notes.
    image_size : (int, int), optional
        Width and height of the image, px, which points need; the optical axis meets its center.
    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If shapes disagree, there are fewer than 5 points, points lie on one line or beyond the
        image, or they fit no microscope.

    Notes
    -----
    From one plane, only T_op + f and f + d can be seen, and the perspective that tells them apart
    fades with the tilt. The thesis therefore takes f from the manufacturer and lets (2.12) tie d to
    it: the plane is in focus. Without `focal_length` the same tie makes f the one number that the
    perspective determines. If 1/f is less than four standard errors from zero, f and the tilt's
    angles are named in `unobservable`.

    The errors of the corners of one square are correlated, and a mark that was made beside its
    place is so in every view: the covariance allows for both.

    Several views share the lens: T_op + f and the distortion. Each has a magnification and a pose
    of its own; their names end in the view's number from the second view on, and f is that of the
    first. Where the views hold them, that is where Schwarz' criterion is in favor, a second term of
    the distortion and the point where the optical axis meets the sensor are estimated too
    ("distortion_2" in 1/µm⁴; "principal_x" and "principal_y" in px from the image's middle): with
    u from that point, the image has u (1 + κ₂ r⁴) where one term alone has u.

    Tilts (β, γ) and (−β, −γ) give the same image but for perspective. Both are tried. If the better
    one is not better by more than noise, "beta" and "gamma" are named in `unobservable`.

    The axis of one view is trusted to meet the middle of the image, as in the thesis.

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
    positive("pixel_size", pixel_size)
    if focal_length is not None:
        focal_length = scalar("focal_length", focal_length, above=0)
    worlds, images, places, size = _inputs(world, image, pitch, image_size)
    frame = Microscope(1.0, 1.0, 1.0, pixel_size=pixel_size, image_size=size)
    pairs = [_points(w, i, frame) for w, i in zip(worlds, images, strict=True)]
    views = Views([w for w, _ in pairs], [s for _, s in pairs], frame, focal_length)
    fit, alone = fit_views(views)
    if places is None and len(worlds) > 1:
        places = np.round(np.concatenate(views.world), 6)
    marks = None
    if places is not None:
        numbers = np.unique(places, axis=0, return_inverse=True)[1].ravel()
        # With fewer marks than parameters their scatter gives no covariance.
        marks = numbers if numbers.max() >= len(fit.free) else None
    if not (fit.poses[:, 0] > 0).all():
        raise ValueError(
            f"world and image must fit a microscope, got magnifications {fit.poses[:, 0]}"
        )
    return _report(views, fit, alone, marks)


def _inputs(
    world: Any, image: Any, pitch: float | None, image_size: Any
) -> tuple[list[Any], list[Any], Array | None, tuple[int, int]]:
    """World and image points of each view, the place in the pattern of the mark of each point,
    where a mark has several points, and the size of the images."""
    found = [world] if isinstance(world, Detection) else world
    if isinstance(found, (list, tuple)) and any(isinstance(each, Detection) for each in found):
        return _of_detections(found, image, pitch, image_size)
    if pitch is not None:
        raise ValueError("pitch must be left out with points in µm, got one")
    if image_size is None:
        raise ValueError("image_size must be given, (width, height) in px, got none")
    if not isinstance(world, (list, tuple)) or np.ndim(world[0]) < 2:
        return [world], [image], None, image_size
    if not isinstance(image, (list, tuple)) or len(image) != len(world):
        raise ValueError(f"image must hold one array for each of the {len(world)} views")
    return [*world], [*image], None, image_size


def _of_detections(
    found: Sequence[Any], image: Any, pitch: float | None, image_size: Any
) -> tuple[list[Any], list[Any], Array | None, tuple[int, int]]:
    """What `_inputs` returns, from detections."""
    if image is not None or image_size is not None:
        raise ValueError("image and image_size must not be given beside a detection")
    if not all(isinstance(each, Detection) for each in found):
        raise ValueError("world must hold either detections or points, got both")
    if pitch is None:
        raise ValueError("pitch must be given with a detection, µm from mark to mark, got none")
    pitch = scalar("pitch", pitch, above=0)
    size = found[0].image_size
    if any(each.image_size != size for each in found):
        raise ValueError("world must hold detections in images of one size, got several")
    squares = any(len(np.unique(each.group)) < len(each.group) for each in found)
    marks = np.concatenate([each.grid // 2 for each in found]) if squares else None
    return [pitch * e.positions for e in found], [e.points for e in found], marks, size


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
    inner, misfit, chance = covariance(views, fit, marks)
    lost = _undetermined(fit, alone, np.sqrt(np.diag(inner)), views.variance(fit))
    lens, poses = fit.lens.copy(), fit.poses.copy()
    poses[:, 1:4] = np.angle(np.exp(1j * poses[:, 1:4]))
    names = np.array(fit.names)
    if "focal_length" in names[lost]:  # it may come out as zero: then f is held at a kilometer
        lens[0] = max(lens[0], 1 / FARTHEST)
    values = np.concatenate([[1 / lens[0]], lens[1:], poses.ravel()])[fit.free]
    by = np.where(names == "focal_length", -(values**2), 1.0)
    outer = inner * np.outer(by, by)
    outer[lost] = outer[:, lost] = np.nan
    outer[lost, lost] = np.inf
    scopes = [_microscope(views, lens, poses, v) for v in range(len(poses))]
    return Calibration(
        scopes[0],
        tuple(fit.names),
        values,
        outer,
        tuple(names[lost].tolist()),
        fit.freedom if marks is None else int(marks.max()),
        -fit.residuals.reshape(-1, 2),
        np.concatenate([*map(partial(_on_plane, lens), scopes, views.seen, views.world)]),
        misfit,
        chance,
        tuple(scopes),
        held_out(views, fit, alone),
    )


def _microscope(views: Views, lens: Array, poses: Array, view: int) -> Microscope:
    """The microscope of a view, in focus."""
    magnification, *rest = poses[view].tolist()
    f = views.focal_length or (1 + poses[0, 0]) / (lens[0] * (1 + magnification))
    lengths = {"tube_length": magnification * f, "focal_length": f, "distance": f / magnification}
    pose = dict(zip(VIEW[1:], rest, strict=True))
    return replace(views.frame, distortion=lens[1], **lengths, **pose)


def _on_plane(lens: Array, scope: Microscope, seen: Array, world: Array) -> Array:
    """Image points projected back to the pattern, less the world points, µm."""
    return scope.back_project(without_terms(lens, seen, scope.cell) + scope.principal_point) - world


def _undetermined(
    fit: Fit, alone: list[list[Fit]], sigma: Array, variance: float
) -> NDArray[np.bool_]:
    """Which of the parameters the points do not determine."""
    kinds = np.array([name.split("_")[0] for name in fit.names])
    lost = np.isinf(sigma)
    if "focal" in kinds:
        # As the sign of the tilt is free, 1/f is never negative: 150 noisy views without tilt came
        # to 2.2 standard errors at most; the rest is for errors that are less even than noise.
        if not fit.lens[0] > 4 * sigma[kinds == "focal"][0]:
            lost |= np.isin(kinds, ["focal", "beta", "gamma"])
        return lost
    tilts = np.flatnonzero(np.isin(kinds, ["beta", "gamma"])).reshape(-1, 2)
    for tilt, (best, other) in zip(tilts, alone, strict=True):
        apart = np.abs(np.angle(np.exp(1j * (best.poses - other.poses)[0, 2:4])))
        # Two minima three standard errors apart, of which the sums of squares differ by less than
        # two standard deviations of noise, squared, cannot be told from each other.
        if (apart > 3 * sigma[tilt]).any() and other.cost - best.cost < 4 * variance:
            lost[tilt] = True
    return lost
