"""Least squares behind :func:`microlib.calibration.calibrate` for several views of one pattern.

The views share the lens: the principal distance T_op + f, the distortion and, where the views can
tell them, a second term of it and the point where the optical axis meets the sensor. Each has its
own magnification and pose.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from microlib._common import Array, inverse_normal
from microlib.calibration._discrepancy import Discrepancy, discrepancy, smooth_fields
from microlib.calibration._microscope_fit import Problem, jackknife, start_values
from microlib.microscope import Microscope

#: Numbers of a view: M, α, β, γ, T_x, T_y; and of the lens: 1/(T_op + f), κ, the distortion's
#: second term in 1/µm⁴, and the axis' place from the middle of the image, px.
VIEW = ("magnification", "alpha", "beta", "gamma", "tx", "ty")
LENS = ("power", "distortion", "distortion_2", "principal_x", "principal_y")
#: Of `project_plane`'s numbers (M, h, κ, α, β, γ, T_x, T_y) those of a view.
_OF_VIEW = [0, 3, 4, 5, 6, 7]
#: Terms that may be added, by their places in `LENS`.
_TERMS = ([2], [3, 4])
#: How often a start is taken from the views' fits with a common lens.
_STARTS = 2
_TOLERANCE = 1e-13
#: Of a fit: those of the tests' views end within 33.
_MOST_STEPS = 200
#: Rounds in which the second term is taken off: each leaves four times its part of the first, a
#: few hundredths.
_INVERTED = 8


@dataclass(frozen=True)
class Views:
    """Points of several views, from the middle of the image.

    Parameters
    ----------
    world, seen : list of ndarray, shape (N_v, 2)
        µm, and px from the image's middle.
    cell : ndarray, shape (2,)
        Pitch of the sensor cells, µm.
    focal_length : float or None
        µm, where it is known.
    """

    world: list[Array]
    seen: list[Array]
    cell: Array
    focal_length: float | None

    def rounding(self, poses: Array) -> float:
        """Least variance of a coordinate, px²."""
        return max(
            Problem(world, seen, self.cell, np.arange(8)).rounding(pose)
            for world, seen, pose in zip(self.world, self.seen, poses, strict=True)
        )

    def predict(self, lens: Array, poses: Array) -> tuple[Array, Array]:
        """Image points of all views, (N, 2), and their derivatives, (N, 2, 5 + 6 V)."""
        points, rows = [], []
        for v, (pose, world) in enumerate(zip(poses, self.world, strict=True)):
            magnification = pose[0]
            if self.focal_length is None:
                convergence, by_magnification, by_power = magnification * lens[0], lens[0], pose[0]
            else:  # h = M/(f (1 + M)), as a plane in focus has it
                f = self.focal_length
                convergence = magnification / (f * (1 + magnification))
                by_magnification, by_power = 1 / (f * (1 + magnification) ** 2), 0.0
            visible = np.concatenate([[magnification, convergence, lens[1]], pose[1:]])
            at, by = Microscope.project_plane(visible, world, self.cell)
            own = by[..., _OF_VIEW].copy()
            own[..., 0] += by_magnification * by[..., 1]
            row = np.zeros((*at.shape, len(LENS) + len(VIEW) * len(poses)))
            row[..., 0], row[..., 1] = by_power * by[..., 1], by[..., 2]
            first = len(LENS) + len(VIEW) * v
            row[..., first : first + len(VIEW)] = own
            sensor = at * self.cell
            square = (sensor**2).sum(axis=1)[:, None]
            # The second term, and what it makes of a point's displacement.
            turn = lens[2] * 4 * square[..., None] * at[:, :, None] * (sensor * self.cell)[:, None]
            stretch = (1 + lens[2] * square**2)[..., None] * np.eye(2) + turn
            row = stretch @ row
            row[..., 2] = square**2 * at
            row[:, 0, 3] = row[:, 1, 4] = 1
            points.append(at * (1 + lens[2] * square**2) + lens[3:])
            rows.append(row)
        return np.concatenate(points), np.concatenate(rows)


@dataclass(frozen=True)
class Joint:
    """One fit of all views.

    Parameters
    ----------
    lens : ndarray, shape (5,)
        As in `LENS`.
    poses : ndarray, shape (V, 6)
        As in `VIEW`.
    free : ndarray of int, shape (p,)
        What was fitted of both, counted through.
    residuals : ndarray, shape (2 N,)
        Projection minus image points, px.
    jacobian : ndarray, shape (2 N, p)
        Their derivatives.
    """

    lens: Array
    poses: Array
    free: NDArray[np.intp]
    residuals: Array
    jacobian: Array

    @property
    def cost(self) -> float:
        """Sum of squares, px²."""
        return float(self.residuals @ self.residuals)


def fit_views(views: Views) -> Joint:
    """Fit all views together, and add terms to the lens as far as they are justified.

    A term is justified if the sum of squares falls by more than log(2 N) variances for each of its
    numbers (Schwarz' criterion).
    """
    base = [1] if views.focal_length is not None else [0, 1]
    lens, poses = _start(views)
    best = _fit(views, lens, poses, base)
    terms = list(_TERMS)
    while terms:
        lens_free = [k for k in best.free.tolist() if k < len(LENS)]
        trials: list[tuple[Joint, list[int]]] = []
        for term in terms:
            with suppress(ValueError):  # what is not found is not justified
                trials.append((_fit(views, best.lens, best.poses, lens_free + term), term))
        if not trials:
            break
        trial, term = min(trials, key=lambda each: each[0].cost)
        count = len(trial.residuals)
        variance = trial.cost / max(count - len(trial.free), 1) + views.rounding(best.poses)
        if best.cost - trial.cost <= len(term) * np.log(count) * variance:
            break
        best = trial
        terms.remove(term)
    return best


def _fit(views: Views, lens: Array, poses: Array, lens_free: list[int]) -> Joint:
    start = np.concatenate([lens, poses.ravel()])
    free = np.array([*sorted(lens_free), *range(len(LENS), len(start))], dtype=np.intp)
    seen = np.concatenate(views.seen)

    def split(values: Array) -> tuple[Array, Array]:
        full = start.copy()
        full[free] = values
        return full[: len(LENS)], full[len(LENS) :].reshape(poses.shape)

    def residuals(values: Array) -> Array:
        return (views.predict(*split(values))[0] - seen).ravel()

    def jacobian(values: Array) -> Array:
        return views.predict(*split(values))[1].reshape(-1, len(start))[:, free]

    if not np.isfinite(residuals(start[free])).all():
        raise ValueError(
            "world and image must fit one microscope in all views, got points beyond the reach of "
            "its distortion"
        )
    found = least_squares(
        residuals,
        start[free],
        jacobian,
        method="lm",
        x_scale="jac",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_MOST_STEPS,
    )
    if found.status == 0:
        raise ValueError(
            "world and image must fit one microscope in all views, with the focal_length if it is "
            f"given: none was found in {_MOST_STEPS} steps"
        )
    lens, poses = split(found.x)
    if lens[0] < 0:  # the same images, seen with all tilts turned over
        lens, poses = lens * [-1, 1, 1, 1, 1], poses * [1, 1, -1, -1, 1, 1]
    at, by = views.predict(lens, poses)
    by = by.reshape(-1, len(start))[:, free]
    return Joint(lens, poses, free, (at - seen).ravel(), by)


def _start(views: Views) -> tuple[Array, Array]:
    """Each view alone; then each with the lens that most of them agree on."""
    every = np.array([0, 2, 3, 4, 5, 6, 7] if views.focal_length is not None else range(8))
    problems = [
        Problem(world, seen, views.cell, every)
        for world, seen in zip(views.world, views.seen, strict=True)
    ]
    alone = [_best(problem, start_values(problem, views.focal_length)) for problem in problems]
    lens = np.zeros(len(LENS))
    lens[1] = np.median([theta[2] for theta in alone])
    if views.focal_length is None:
        lens[0] = np.median([theta[1] / (1 + theta[0]) for theta in alone])
        held = np.array([0, 3, 4, 5, 6, 7])
        for _ in range(_STARTS):
            alone = [
                _best(
                    replace(problem, free=held),
                    [
                        np.array([m, lens[0] * (1 + m), lens[1], a, sign * b, sign * c, x, y])
                        for sign in (1, -1)
                    ],
                )
                for problem, (m, _, _, a, b, c, x, y) in zip(problems, alone, strict=True)
            ]
    return lens, np.array([theta[[0, 3, 4, 5, 6, 7]] for theta in alone])


def _best(problem: Problem, starts: list[Array]) -> Array:
    return min((problem.fit(start, "linear") for start in starts), key=lambda fit: fit.cost).theta


def without_terms(lens: Array, seen: Array, cell: Array) -> Array:
    """Image points as if the axis met the sensor's middle and the distortion had one term, px."""
    at = seen - lens[3:]
    free = at
    for _ in range(_INVERTED):
        free = at / (1 + lens[2] * ((free * cell) ** 2).sum(axis=1, keepdims=True) ** 2)
    return free


def views_covariance(fit: Joint, groups: NDArray, rounding: float) -> tuple[Array, int]:
    """Covariance of the free numbers and its degrees of freedom; errors of one mark of the pattern
    may be the same in all views. The least variance of a coordinate is that of `rounding`, px²."""
    inverse = inverse_normal(fit.jacobian)
    freedom = len(fit.residuals) - len(fit.free)
    marks = len(np.unique(groups))
    if marks <= len(fit.free):
        return inverse * (fit.cost / freedom + rounding), freedom
    spread = jackknife(fit.jacobian, fit.residuals, inverse, groups)
    return spread + inverse * rounding, marks - 1


def views_discrepancy(fit: Joint, views: Views) -> Discrepancy:
    """Smooth part of the residuals: of one displacement in all views and of each view's own."""
    ends = np.cumsum([len(seen) for seen in views.seen])
    points = np.concatenate(views.seen) + fit.residuals.reshape(-1, 2)
    parts = np.split(points, ends[:-1])
    common = smooth_fields(points)
    own = [smooth_fields(part) for part in parts]
    fields = np.zeros((2 * len(points), common.shape[1] + sum(each.shape[1] for each in own)))
    # In a common field each view has the length that it has in one of its own.
    fields[:, : common.shape[1]] = common * np.sqrt(len(parts))
    row, column = 0, common.shape[1]
    for each in own:
        fields[row : row + len(each), column : column + each.shape[1]] = each
        row, column = row + len(each), column + each.shape[1]
    return discrepancy(fit.residuals, fit.jacobian, fields)
