"""The fit behind :func:`microlib.calibration.calibrate`: views of one pattern through one lens.

The views share the lens: the principal distance T_op + f, the distortion and, of several views
where these can tell them, a second term of it and the point where the optical axis meets the
sensor. Each view has its own magnification and pose.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares

from microlib._common import Array
from microlib.calibration._radial_alignment import linear_intrinsics, radial_alignment
from microlib.microscope import Microscope, euler_rotation

#: Numbers of the lens: 1/(T_op + f), κ, the distortion's second term in 1/µm⁴, and the axis' place
#: from the middle of the image, px. Of a view: M, α, β, γ, T_x, T_y.
LENS = ("power", "distortion", "distortion_2", "principal_x", "principal_y")
VIEW = ("magnification", "alpha", "beta", "gamma", "tx", "ty")
#: Terms that may be added to the lens of several views, by their places in `LENS`.
_TERMS = ([3, 4], [2])
#: Of `project_plane`'s numbers (M, h, κ, α, β, γ, T_x, T_y) those of a view.
_OF_VIEW = [0, 3, 4, 5, 6, 7]
#: Error of a point that is given exactly, as a part of the largest coordinate: rounding makes
#: 1e-16 of it, another order of the same sums up to 1e-15. Nothing smaller decides anything.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Views:
    """Points of views, from the middle of the image.

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
        """Least variance of a coordinate, px²: no point is known better than it is written."""
        scaled = [
            pose[0] * world / self.cell for pose, world in zip(poses, self.world, strict=True)
        ]
        return float((_ROUNDING * max(np.abs(at).max() for at in (*scaled, *self.seen))) ** 2)

    def alone(self, view: int) -> Views:
        """One of the views, and of many points some: random ones, for every n-th could be in a row.

        The start comes as near as a fifteenth of the noise, in a part of the time."""
        world, seen = self.world[view], self.seen[view]
        if len(world) > 2000:
            some = np.random.default_rng(0).choice(len(world), 1000, replace=False)
            world, seen = world[some], seen[some]
        return Views([world], [seen], self.cell, self.focal_length)

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
            row = np.zeros((*at.shape, len(LENS) + len(VIEW) * len(poses)))
            row[..., 0], row[..., 1] = by_power * by[..., 1], by[..., 2]
            first = len(LENS) + len(VIEW) * v
            row[..., first : first + len(VIEW)] = by[..., _OF_VIEW]
            row[..., first] += by_magnification * by[..., 1]
            if lens[2:].any() or len(poses) > 1:
                sensor = at * self.cell
                square = (sensor**2).sum(axis=1)[:, None]
                # The second term, and what it makes of a point's displacement.
                turn = 4 * square[..., None] * at[:, :, None] * (sensor * self.cell)[:, None]
                row = ((1 + lens[2] * square**2)[..., None] * np.eye(2) + lens[2] * turn) @ row
                row[..., 2] = square**2 * at
                row[:, 0, 3] = row[:, 1, 4] = 1
                at = at * (1 + lens[2] * square**2) + lens[3:]
            points.append(at)
            rows.append(row)
        return np.concatenate(points), np.concatenate(rows)


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum.

    Parameters
    ----------
    lens : ndarray, shape (5,)
        As in `LENS`.
    poses : ndarray, shape (V, 6)
        As in `VIEW`.
    free : list of int
        What was fitted of both, counted through.
    residuals : ndarray, shape (2 N,)
        Projection minus image points, px.
    jacobian : ndarray, shape (2 N, p)
        Their derivatives.
    """

    lens: Array
    poses: Array
    free: list[int]
    residuals: Array
    jacobian: Array

    @property
    def cost(self) -> float:
        """Sum of squares, px²."""
        return float(self.residuals @ self.residuals)


def fit_views(views: Views) -> tuple[Fit, list[list[Fit]]]:
    """Fit all views together, and add terms to the lens of several as far as they are justified.

    A term is justified if the sum of squares falls by more than log(2 N) variances for each of its
    numbers (Schwarz' criterion). Also the fits of each view alone from both signs of the tilt, the
    better one first.
    """
    base = [1] if views.focal_length is not None else [0, 1]
    every = [views.alone(v) for v in range(len(views.world))]
    fits = [[_fit(one, *start, base) for start in _starts(one)] for one in every]
    alone = [sorted(pair, key=lambda fit: fit.cost) for pair in fits]
    first = [pair[0] for pair in alone]
    lens = np.median([fit.lens for fit in first], axis=0)  # that most views agree on
    poses = np.concatenate([fit.poses for fit in first])
    best = _fit(views, lens, poses, base)
    for term in _TERMS if len(every) > 1 else ():
        lens_free = [k for k in best.free if k < len(LENS)]
        with suppress(ValueError):  # what is not found is not justified
            trial = _fit(views, best.lens, best.poses, lens_free + term)
            count = len(trial.residuals)
            variance = trial.cost / max(count - len(trial.free), 1) + views.rounding(best.poses)
            if best.cost - trial.cost > len(term) * np.log(count) * variance:
                best = trial
    return best, alone


def _fit(views: Views, lens: Array, poses: Array, lens_free: list[int]) -> Fit:
    start = np.concatenate([lens, poses.ravel()])
    free = [*sorted(lens_free), *range(len(LENS), len(start))]
    seen = np.concatenate(views.seen)

    def split(values: Array) -> tuple[Array, Array]:
        full = start.copy()
        full[free] = values
        return full[: len(LENS)], full[len(LENS) :].reshape(poses.shape)

    @lru_cache(maxsize=1)  # the derivatives are asked for where the residuals were
    def at(values: bytes) -> tuple[Array, Array]:
        points, by = views.predict(*split(np.frombuffer(values)))
        return (points - seen).ravel(), by.reshape(-1, len(start))[:, free]

    refusal = ValueError("world, image and focal_length must fit one microscope, none was found")
    if not np.isfinite(at(start[free].tobytes())[0]).all():  # beyond the reach of its distortion
        raise refusal
    found = least_squares(
        lambda values: at(values.tobytes())[0],
        start[free],
        lambda values: at(values.tobytes())[1],
        method="lm",
        x_scale="jac",
        ftol=_ROUNDING,
        xtol=_ROUNDING,
        gtol=_ROUNDING,
        max_nfev=200,
    )
    if found.status == 0 and len(poses) > 1:
        raise refusal
    lens, poses = split(found.x)
    residuals, jacobian = at(found.x.tobytes())
    if lens[0] < 0:  # the same images, seen with all tilts turned over
        flip = np.concatenate([[-1, 1, 1, 1, 1], np.tile([1, 1, -1, -1, 1, 1], len(poses))])
        lens, poses = lens * flip[: len(LENS)], poses * flip[len(LENS) :].reshape(poses.shape)
        jacobian = jacobian * flip[free]
    return Fit(lens, poses, free, residuals, jacobian)


def _starts(one: Views) -> list[tuple[Array, Array]]:
    """Lens and pose of one view in closed form, for each sign of the tilt."""
    world, sensor = one.world[0], one.seen[0] * one.cell
    alpha, beta, gamma, tx, ty = radial_alignment(world, sensor)
    starts = []
    for sign in (1, -1):
        rotation = euler_rotation(alpha, sign * beta, sign * gamma)
        turned = world @ rotation[:, :2].T
        depth = turned[:, 2] if one.focal_length is None else np.zeros(len(world))
        found = linear_intrinsics(turned[:, :2] + [tx, ty], depth, sensor)
        magnification, distortion, convergence = found.tolist()
        lens = np.array([abs(convergence) / magnification, distortion, 0.0, 0.0, 0.0])
        starts.append((lens, np.array([[magnification, alpha, sign * beta, sign * gamma, tx, ty]])))
    return starts


def without_terms(lens: Array, seen: Array, cell: Array) -> Array:
    """Image points as if the axis met the sensor's middle and the distortion had one term, px."""
    at = seen - lens[3:]
    free = at
    for _ in range(8):  # each leaves four times the term's part of the first, some hundredths
        free = at / (1 + lens[2] * ((free * cell) ** 2).sum(axis=1, keepdims=True) ** 2)
    return free
