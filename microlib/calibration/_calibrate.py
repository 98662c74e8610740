"""Calibrate a microscope from one image of a plane pattern (2.13–2.20).

Radial alignment gives the pose up to the sign of the tilt, a linear fit the magnification and
distortion, and nonlinear least squares refines all of them together. What the points cannot
determine is held or named, never made up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t as student

from microlib._common import Array, Tidy, as_array, between, flat_row, one_of, same_length, scalar
from microlib.calibration._discrepancy import BY_CHANCE
from microlib.calibration._export import to_json
from microlib.calibration._microscope_fit import (
    NAMES,
    Minimum,
    Problem,
    axis_errors,
    start_values,
)
from microlib.calibration._several_views import (
    LENS,
    VIEW,
    Joint,
    Views,
    fit_views,
    views_covariance,
    views_discrepancy,
    without_terms,
)
from microlib.calibration._straighten import straighten_image, straighten_points
from microlib.microscope import Microscope

#: Standard errors by which 1/f must exceed zero to be told from it. As the sign of the tilt is
#: free, 1/f is never negative; 150 noisy views without tilt came to 2.2 at most, and the rest is
#: kept for errors that are less even than noise.
_CERTAIN = 4.0
#: Where 1/f is lost it may come out as zero; then f is held at a kilometer, 1/µm.
_SMALLEST_POWER = 1e-9
#: World or image points are on one line if they spread across it by less than this part of its
#: length, a thousandth of a pixel.
_THINNEST = 1e-6
#: The two tilts are two minima if an angle differs by so many standard errors: 0.3 % by chance.
_APART = 3.0
#: The better of the two is told from the other if its sum of squares is smaller by more than this
#: many variances, the 95 % quantile of χ² with one degree of freedom.
_TOLD = 3.84
#: The optical axis meets the sensor so far from its middle, standard deviation in widths of the
#: image: 1 to 2 % in the camera modules and published calibrations that one finds.
_AXIS_ASIDE = 0.02
#: Below this chance a model is said not to fit.
_IMPROBABLE = 1e-3

#: A kilometer, µm, and a thousand times the longest row of a sensor, px: nothing is calibrated
#: beyond, and the fits lose their way there.
_FARTHEST, _FARTHEST_PIXEL = 1e9, 1e8


@dataclass(frozen=True)
class ErrorSummary(Tidy):
    """Statistics of the distances between two sets of points, as in Table 5.2.

    Parameters
    ----------
    mean, std, max, rms : float
        In the unit of the points.
    """

    mean: float
    std: float
    max: float
    rms: float

    @classmethod
    def of(cls, differences: Array) -> ErrorSummary:
        """Summarize differences of points, shape (N, 2)."""
        distance = np.hypot(*as_array("differences", differences, shape=(None, 2)).T)
        return cls(
            float(distance.mean()),
            float(distance.std()),
            float(distance.max()),
            float(np.sqrt((distance**2).mean())),
        )


@dataclass(frozen=True)
class Calibration(Tidy):
    """A calibrated microscope and how well it is known.

    Parameters
    ----------
    microscope : Microscope
        With the estimated parameters, in focus: d = f²/T_op (2.20).
    parameters : tuple of str
        What was estimated, in the order of `estimate` and `covariance`; lengths in µm, angles in
        rad, κ in 1/µm².
    estimate : ndarray, shape (p,)
        The estimates.
    covariance : ndarray, shape (p, p)
        Their covariance. Variances of parameters in `unobservable` are infinite, covariances beside
        them NaN.
    unobservable : tuple of str
        Parameters that these points do not determine, whatever `estimate` says.
    freedom : int
        Degrees of freedom behind the residual's variance.
    condition : float
        Largest over smallest singular value of the Jacobian with its columns scaled to one length.
    weakest : ndarray, shape (p,)
        Direction of the smallest one, in parameters so scaled: what the points determine worst.
    residuals : ndarray, shape (N, 2)
        Image points minus their projection, px.
    plane_residuals : ndarray, shape (N, 2)
        Image points projected back to the pattern minus the world points, µm.
    misfit : float
        Smooth part of the residuals over what noise makes of it: about one for a model that fits.
        NaN for fewer than 24 points, which cannot tell.
    misfit_chance : float
        Probability of so much by noise alone. Below a tenth the covariance allows for it: what the
        model lacks, a distortion or a bend of the pattern, is taken to be as large in the
        directions that the parameters absorb as in those that show.
    views : tuple of Microscope
        One for each view; `microscope` is the first.
    """

    _samples = ("residuals", "plane_residuals")
    _large = ("microscope", "parameters", "estimate", "covariance", "weakest")

    microscope: Microscope
    parameters: tuple[str, ...]
    estimate: Array
    covariance: Array
    unobservable: tuple[str, ...]
    freedom: int
    condition: float
    weakest: Array
    residuals: Array
    plane_residuals: Array
    misfit: float
    misfit_chance: float
    views: tuple[Microscope, ...]

    @property
    def fits(self) -> bool:
        """False if the residuals contradict the model: noise alone would make so much of them
        smooth in less than a thousandth of all images."""
        return self.misfit_chance >= _IMPROBABLE

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            Every parameter of the microscope by its name, its standard deviation as ``…_sigma``
            where it was estimated, the fields with one value, and both summaries of the errors.
        """
        sigma = {f"{name}_sigma": value for name, value in self.sigma.items()}
        errors = {"reprojection": self.reprojection, "plane_error": self.plane_error}
        scope = {**vars(self.microscope), "magnification": self.microscope.magnification}
        return flat_row({**scope, **sigma, **errors}) | super().to_dict()

    @property
    def reprojection(self) -> ErrorSummary:
        """Distances in the image, px."""
        return ErrorSummary.of(self.residuals)

    @property
    def plane_error(self) -> ErrorSummary:
        """Distances on the pattern plane, µm (Table 5.2)."""
        return ErrorSummary.of(self.plane_residuals)

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each parameter."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def principal_point(self) -> Array:
        """Where the optical axis meets the sensor, (x, y) px: the middle, unless it was found."""
        aside = np.array([self._value("principal_x"), self._value("principal_y")])
        return self.microscope.principal_point + aside

    def um_per_pixel(self, level: float = 0.95) -> tuple[float, float, float]:
        """Width on the pattern of a pixel at the optical axis, µm, and its confidence interval.

        The cell's width over the magnification, of the first view; the pattern stands for the
        sample in focus.

        Parameters
        ----------
        level : float
            Probability that the interval holds it.

        Returns
        -------
        value, low, high : float
        """
        low, high = self.interval("magnification", level)
        cell = float(self.microscope.cell[0])
        return cell / self.microscope.magnification, cell / high, cell / low

    def to_json(self) -> str:
        """Text in JSON from which OpenCV, Micro-Manager and ImageJ can be set up.

        OpenCV's camera matrix and distortion coefficients (with the most that they are off the
        model in the image), rotation and translation of each view; Micro-Manager's and ImageJ's
        size of a pixel with its 95 % interval; standard deviations, null where a parameter is not
        determined.

        Returns
        -------
        str
        """
        second = self._value("distortion_2")
        return to_json(self.views, self.principal_point, second, self.um_per_pixel(), self.sigma)

    def undistort(self, points: ArrayLike) -> Array:
        """Where image points would be seen through a lens without distortion.

        Parameters
        ----------
        points : array_like, shape (N, 2)
            px.

        Returns
        -------
        ndarray, shape (N, 2)
            px, at the scale on the optical axis; NaN beyond the fold of (2.10).

        Raises
        ------
        ValueError
            If the points are no finite pairs.
        """
        return straighten_points(
            self.microscope,
            self.principal_point,
            self._value("distortion_2"),
            as_array("points", points, shape=(None, 2), largest=_FARTHEST_PIXEL),
        )

    def undistort_image(self, image: ArrayLike) -> NDArray:
        """Resample an image of the calibrated microscope to one without distortion.

        Parameters
        ----------
        image : array_like, shape (height, width) or (height, width, channels)
            Of the size that the calibration has.

        Returns
        -------
        ndarray, shape and type of `image`
            At the scale on the optical axis, by bicubic interpolation; zero where the image does
            not reach. Floating-point images become single precision.

        Raises
        ------
        ValueError
            If the image has another size.
        """
        second = self._value("distortion_2")
        return straighten_image(self.microscope, self.principal_point, second, image)

    def _value(self, parameter: str) -> float:
        """The estimate of a parameter, zero if it was not estimated."""
        found = parameter in self.parameters
        return float(self.estimate[self.parameters.index(parameter)]) if found else 0.0

    def interval(self, parameter: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter, from Student's distribution.

        That of the focal length is the interval of 1/f, turned over: 1/f is what the points see,
        with a nearly normal error.

        Raises
        ------
        ValueError
            If `parameter` was not estimated or `level` is not in (0, 1).
        """
        k = self.parameters.index(one_of("parameter", parameter, self.parameters))
        level = scalar("level", level, within=(0, 1))
        std = float(np.sqrt(self.covariance[k, k]))
        # Half of an infinite interval is infinite at any level.
        half = std if np.isinf(std) else float(student.ppf(0.5 + level / 2, self.freedom)) * std
        value = float(self.estimate[k])
        if parameter == "focal_length" and np.isfinite(half):
            relative = half / value
            return value / (1 + relative), value / (1 - relative)
        return value - half, value + half


def calibrate(
    world: ArrayLike | Sequence[ArrayLike],
    image: ArrayLike | Sequence[ArrayLike],
    *,
    focal_length: float | None = None,
    pixel_size: float | tuple[float, float],
    image_size: tuple[int, int],
    loss: str = "linear",
    groups: ArrayLike | Sequence[ArrayLike] | None = None,
    axis_sigma: float | None = None,
) -> Calibration:
    """Pose, magnification and distortion of a microscope from images of a plane pattern.

    Parameters
    ----------
    world : array_like, shape (N, 2), or a list of them
        Points of the pattern, µm; of several views, one array for each.
    image : array_like, shape (N, 2), or a list of them
        Where they are seen, (x, y) px.
    focal_length : float, optional
        Focal length f of the objective as its manufacturer gives it, µm. Without it f is estimated
        too, which needs a tilted pattern: see Notes.
    pixel_size : float or (float, float)
        Pitch of the sensor cells, µm.
    image_size : (int, int)
        Width and height of the image, px; the optical axis meets its center.
    loss : {"linear", "huber"}
        Least squares, or Huber's loss at 1.345 robust standard deviations against outliers.
    groups : array_like of int, shape (N,), optional
        Points of one number have correlated errors, as the corners of one square have
        (``group`` of :class:`microlib.calibration.Detection`). The covariance then allows for it.
        Without `groups` all errors are taken as independent and alike. Of several views, one array
        for each, and a number means the same mark in all; without them that is a world point: a
        mark that was made beside its place is so in every view.
    axis_sigma : float, optional
        Standard deviation with which the optical axis meets the image's middle, px: the intervals
        then allow for it, but for those of T_x and T_y, which count from the middle. By default the
        axis is trusted, as in the thesis, as long as the residuals look like noise; else 2 % of the
        image's width are allowed for.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If shapes disagree, there are fewer than 5 points or no more groups than parameters, points
        lie on one line, or they fit no microscope.

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

    Examples
    --------
    >>> truth = Microscope(200000, 126000, 79380, 2e-10, 1.5, 0.03, 3.1, -300, 200)
    >>> x, y = np.meshgrid(np.arange(-4, 5) * 280.0, np.arange(-3, 4) * 280.0)
    >>> world = np.column_stack([x.ravel(), y.ravel()])
    >>> found = calibrate(world, truth.project(world), focal_length=126000,
    ...                   pixel_size=9.9, image_size=(656, 491))
    >>> round(found.microscope.tube_length, 3), round(found.microscope.gamma, 6)
    (200000.0, 3.1)
    """
    one_of("loss", loss, ("linear", "huber"))
    frame = Microscope(1.0, 1.0, 1.0, pixel_size=pixel_size, image_size=image_size)
    between("pixel_size", pixel_size, 1 / _FARTHEST, _FARTHEST)
    free = [0, 2, 3, 4, 5, 6, 7] if focal_length is not None else list(range(8))
    if focal_length is not None:
        focal_length = scalar(
            "focal_length", focal_length, above=0, least=1 / _FARTHEST, most=_FARTHEST
        )
    if axis_sigma is not None:
        axis_sigma = scalar("axis_sigma", axis_sigma, least=0, most=_FARTHEST_PIXEL)
    if _are_several(world):
        if loss != "linear":
            raise ValueError(f'loss must be "linear" for several views, got {loss!r}')
        return _of_views(world, image, frame, focal_length, groups, axis_sigma)
    world, image = _points(world, image, image_size)
    if groups is None:
        label = None
    else:
        label = as_array("groups", cast(ArrayLike, groups), shape=(len(world),))
        if len(np.unique(label)) <= len(free):
            raise ValueError(
                f"groups must be more than the {len(free)} parameters, got {len(np.unique(label))}"
            )

    problem = Problem(world, image - frame.principal_point, frame.cell, np.array(free))
    fits = [problem.fit(start, loss) for start in start_values(problem, focal_length)]
    best, other = sorted(fits, key=lambda fit: fit.cost)
    magnification = best.theta[0]
    if not magnification > 0:
        raise ValueError(
            f"world and image must fit a microscope, got magnification {magnification}"
        )
    return _report(problem, best, other, frame, label, axis_sigma)


def _points(world: Any, image: Any, image_size: tuple[int, int]) -> tuple[Array, Array]:
    """Checked points of one view."""
    world = as_array("world", world, shape=(None, 2))
    image = as_array("image", image, shape=(None, 2))
    same_length(("world", "image"), world, image)
    between("world", world, -_FARTHEST, _FARTHEST)
    between("image", image, -_FARTHEST_PIXEL, _FARTHEST_PIXEL)
    if len(world) < 5:  # radial alignment has six unknowns up to scale, one equation a point
        raise ValueError(f"world must hold at least 5 points, got {len(world)}")
    for name, points in (("world", world), ("image", image)):
        triangle = np.linalg.qr(points - points.mean(axis=0), mode="r")
        spread = np.linalg.svd(triangle, compute_uv=False)
        if not spread[0] > 1 / _FARTHEST:
            raise ValueError(f"{name} must extend over more than {1 / _FARTHEST:g}, got less")
        if not spread[1] > _THINNEST * spread[0]:
            raise ValueError(f"{name} must not lie on one line, got {len(points)} points that do")
    beyond = ((image < -1) | (image > image_size)).any(axis=1)
    if beyond.any():
        width, height = image_size
        raise ValueError(
            f"image must lie in the image_size of (width, height) = ({width}, {height}) px, got "
            f"{int(beyond.sum())} of {len(image)} points beyond it, one at {image[beyond][0]}"
        )
    return world, image


def _are_several(world: ArrayLike | Sequence[ArrayLike]) -> bool:
    """True for a sequence of arrays of points, False for the points of one view."""
    if isinstance(world, np.ndarray):
        return world.ndim == 3
    if not isinstance(world, (list, tuple)) or len(world) == 0:
        return False
    try:
        return np.ndim(world[0]) == 2
    except ValueError:  # ragged: told by the checks of one view
        return False


def _of_views(
    world: Any,
    image: Any,
    frame: Microscope,
    focal_length: float | None,
    groups: Any,
    axis_sigma: float | None,
) -> Calibration:
    """Calibration from several views."""
    for name, each in (("image", image), ("groups", world if groups is None else groups)):
        listed = isinstance(each, (list, tuple)) or (isinstance(each, np.ndarray) and each.ndim)
        if not listed or len(each) != len(world):
            raise ValueError(f"{name} must hold one array for each of the {len(world)} views")
    pairs = [_points(w, i, frame.image_size) for w, i in zip(world, image, strict=True)]
    middle = frame.principal_point
    views = Views([w for w, _ in pairs], [i - middle for _, i in pairs], frame.cell, focal_length)
    if groups is None:
        _, marks = np.unique(np.round(np.concatenate(views.world), 6), axis=0, return_inverse=True)
    else:
        marks = np.concatenate(
            [
                as_array("groups", g, shape=(len(w),))
                for g, w in zip(groups, views.world, strict=True)
            ]
        )
    fit = fit_views(views)
    if not (fit.poses[:, 0] > 0).all():
        raise ValueError(
            f"world and image must fit a microscope, got magnifications {fit.poses[:, 0]}"
        )
    return _report_views(views, fit, marks.ravel(), frame, axis_sigma)


def _report_views(
    views: Views, fit: Joint, marks: NDArray, frame: Microscope, axis_sigma: float | None
) -> Calibration:
    """Covariance in f instead of the power, what is lost, and a microscope for each view."""
    count = len(fit.poses)
    every = [*LENS, *(n if v == 0 else f"{n}_{v + 1}" for v in range(count) for n in VIEW)]
    every[0] = "focal_length"
    names = tuple(every[k] for k in fit.free)
    covariance, freedom = views_covariance(fit, marks, views.rounding(fit.poses))
    smooth = views_discrepancy(fit, views)
    covariance = covariance + smooth.covariance
    if axis_sigma is None:
        axis_sigma = _AXIS_ASIDE * frame.image_size[0] if smooth.chance < BY_CHANCE else 0.0
    if axis_sigma > 0 and "principal_x" not in names:
        shifted = [k for k, name in enumerate(names) if name[:2] in ("tx", "ty")]
        covariance = covariance + axis_errors(
            fit.jacobian, fit.residuals, shifted, axis_sigma, views.rounding(fit.poses)
        )
    estimate = np.concatenate([fit.lens, fit.poses.ravel()])[fit.free]
    lost = {name for name, v in zip(names, np.diag(covariance), strict=True) if np.isinf(v)}
    if "focal_length" in names:
        magnification, power = fit.poses[0, 0], fit.lens[0]
        turn = np.eye(len(names))
        turn[0, 0], turn[0, names.index("magnification")] = 1 + magnification, power
        power *= 1 + magnification
        covariance = turn @ covariance @ turn.T
        if not power > _CERTAIN * np.sqrt(covariance[0, 0]):
            lost |= {n for n in names if n.startswith(("focal", "beta", "gamma"))}
        else:
            _refuse_least_power(power)
        power = max(power, _SMALLEST_POWER)
        estimate[0] = 1 / power
        to_length = np.ones(len(names))
        to_length[0] = -1 / power**2
        covariance = covariance * np.outer(to_length, to_length)
    for k in (names.index(name) for name in lost):
        covariance[k] = covariance[:, k] = np.nan
        covariance[k, k] = np.inf
    scopes = tuple(_scope(frame, views, fit, v) for v in range(count))
    condition, weakest = _weakest(fit.jacobian)
    return Calibration(
        scopes[0],
        names,
        estimate,
        covariance,
        tuple(name for name in names if name in lost),
        freedom,
        condition,
        weakest,
        -fit.residuals.reshape(-1, 2),
        np.concatenate(
            [
                scope.back_project(
                    without_terms(fit.lens, seen, frame.cell) + frame.principal_point
                )
                - world
                for scope, seen, world in zip(scopes, views.seen, views.world, strict=True)
            ]
        ),
        smooth.misfit,
        smooth.chance,
        scopes,
    )


def _scope(frame: Microscope, views: Views, fit: Joint, view: int) -> Microscope:
    """The microscope of a view, in focus."""
    magnification, *pose = fit.poses[view].tolist()
    if views.focal_length is None:
        focal_length = 1 / (max(fit.lens[0], _SMALLEST_POWER) * (1 + magnification))
    else:
        focal_length = views.focal_length
    return replace(
        frame,
        tube_length=magnification * focal_length,
        focal_length=focal_length,
        distance=focal_length / magnification,
        distortion=float(fit.lens[1]),
        **dict(zip(VIEW[1:], pose, strict=True)),
    )


def _weakest(jacobian: Array) -> tuple[float, Array]:
    """Condition of a Jacobian with columns of one length, and its weakest direction."""
    length = np.linalg.norm(jacobian, axis=0)
    triangle = np.linalg.qr(jacobian / np.where(length > 0, length, 1.0), mode="r")
    _, singular, directions = np.linalg.svd(triangle, full_matrices=False)
    with np.errstate(divide="ignore"):
        return float(singular[0] / singular[-1]), directions[-1]


def _report(
    problem: Problem,
    best: Minimum,
    other: Minimum,
    frame: Microscope,
    groups: Array | None,
    axis_sigma: float | None,
) -> Calibration:
    """Covariance in f instead of 1/f, what is lost, and the microscope."""
    free = problem.free
    names = tuple(NAMES[k] for k in free)
    covariance, freedom = problem.covariance(best, groups)
    smooth = problem.discrepancy(best, groups)
    covariance = covariance + smooth.covariance
    if axis_sigma is None:
        axis_sigma = _AXIS_ASIDE * frame.image_size[0] if smooth.chance < BY_CHANCE else 0.0
    residuals, every = problem.at(best.theta)
    jacobian = every[:, free]
    if axis_sigma > 0:
        shifted = [names.index("tx"), names.index("ty")]
        covariance = covariance + axis_errors(
            jacobian, residuals, shifted, axis_sigma, problem.rounding(best.theta)
        )
    lost = {name for name, v in zip(names, np.diag(covariance), strict=True) if np.isinf(v)}
    theta = best.theta.copy()
    if "focal_length" in names:
        if not theta[1] > _CERTAIN * np.sqrt(covariance[1, 1]):
            lost |= {"focal_length", "beta", "gamma"}
        else:
            _refuse_least_power(theta[1])
        theta[1] = max(theta[1], _SMALLEST_POWER)
        to_length = np.ones(len(free))
        to_length[1] = -1 / theta[1] ** 2
        covariance = covariance * np.outer(to_length, to_length)
    elif _two_tilts(best, other, covariance, best.cost / freedom + problem.rounding(best.theta)):
        lost |= {"beta", "gamma"}
    for k in (names.index(name) for name in lost):
        covariance[k] = covariance[:, k] = np.nan
        covariance[k, k] = np.inf

    theta[3:6] = np.angle(np.exp(1j * theta[3:6]))
    magnification, power, *others = theta.tolist()
    microscope = replace(
        frame,
        tube_length=magnification / power,
        focal_length=1 / power,
        distance=1 / (power * magnification),
        **dict(zip(NAMES[2:], others, strict=True)),
    )
    condition, weakest = _weakest(jacobian)
    return Calibration(
        microscope,
        names,
        np.array([magnification, 1 / power, *others])[free],
        covariance,
        tuple(name for name in names if name in lost),
        freedom,
        condition,
        weakest,
        -residuals.reshape(-1, 2),
        microscope.back_project(problem.seen + frame.principal_point) - problem.world,
        smooth.misfit,
        smooth.chance,
        (microscope,),
    )


def _refuse_least_power(power: float) -> None:
    """Refuse a power, which the points tell for certain, that is less than any objective's."""
    if power < _SMALLEST_POWER:
        raise ValueError(
            "world and pixel_size must be in µm, got points that tell a focal length of "
            f"{1 / power:.3g} µm, more than {1 / _SMALLEST_POWER:g} µm"
        )


def _two_tilts(best: Minimum, other: Minimum, covariance: Array, variance: float) -> bool:
    """True if the opposite tilt is another minimum, and not worse by more than noise."""
    angles = slice(3, 5)  # β and γ among the parameters without f
    apart = np.abs(np.angle(np.exp(1j * (best.theta[4:6] - other.theta[4:6]))))
    distinct = (apart > _APART * np.sqrt(np.diag(covariance)[angles])).any()
    return bool(distinct and other.cost - best.cost < _TOLD * variance)
