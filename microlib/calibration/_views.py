"""The fit behind :func:`microlib.calibration.calibrate`: views of one pattern through one lens.

The views share the lens: the principal distance T_op + f, the distortion and, of several views
where these can tell them, a second term of it and the point where the optical axis meets the
sensor. Each view has its own magnification and pose. The start is in closed form: pose by radial
alignment, then magnification and distortion (2.13–2.19).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from microlib._common import Array, as_array, same_length
from microlib.microscope import Microscope, euler_rotation

#: Numbers of the lens: of the focal length the inverse φ = 1/f, κ, the distortion's second term in
#: 1/µm⁴, and the axis' place from the middle of the image, px. Of a view: M, α, β, γ, T_x, T_y.
LENS = ("focal_length", "distortion", "distortion_2", "principal_x", "principal_y")
VIEW = ("magnification", "alpha", "beta", "gamma", "tx", "ty")
#: Terms that may be added to the lens of several views, by their places in `LENS`.
_TERMS = ([3, 4], [2])
#: Of `project_plane`'s numbers (M, h, κ, α, β, γ, T_x, T_y) those of a view.
_OF_VIEW = [0, 3, 4, 5, 6, 7]
#: Error of a point that is given exactly, as a part of the largest coordinate: rounding makes
#: 1e-16 of it, another order of the same sums up to 1e-15. Nothing smaller decides anything.
_ROUNDING = 1e-13
#: A singular value below this part of the largest is rounding: the points determine no pose, or
#: no depths tell the convergence.
_DEGENERATE = 1e-9


@dataclass(frozen=True, eq=False)
class Views:
    """Points of views, from the middle of the image.

    Parameters
    ----------
    world, seen : list of ndarray, shape (N_v, 2)
        µm, and px from the image's middle.
    frame : Microscope
        Of any lengths, with the sensor of all views.
    focal_length : float or None
        µm, where it is known.
    """

    world: list[Array]
    seen: list[Array]
    frame: Microscope
    focal_length: float | None

    def some(self, which: ArrayLike) -> Views:
        """A part of the views."""
        world, seen = ([each[v] for v in np.asarray(which)] for each in (self.world, self.seen))
        return replace(self, world=world, seen=seen)

    def rounding(self, poses: Array) -> float:
        """Least variance of a coordinate, px²: no point is known better than it is written."""
        scaled = [
            pose[0] * world / self.frame.cell for pose, world in zip(poses, self.world, strict=True)
        ]
        return float((_ROUNDING * max(np.abs(at).max() for at in (*scaled, *self.seen))) ** 2)

    def variance(self, fit: Fit) -> float:
        """Of a coordinate, px²."""
        return fit.cost / max(fit.freedom, 1) + self.rounding(fit.poses)

    def predict(self, lens: Array, poses: Array) -> tuple[Array, Array]:
        """Image points of all views, (N, 2), and their derivatives, (N, 2, 5 + 6 V)."""
        points, rows = [], []
        for v, (pose, world) in enumerate(zip(poses, self.world, strict=True)):
            # The view of which φ = (1 + M)/(T_op + f) is: each one's own, in focus, if f is given;
            # else the first, and all have its T_op + f.
            tie = 0 if self.focal_length is None else v
            # h = 1/(f + d) = M/(T_op + f) = M φ/(1 + M of the view that φ is of).
            beyond = 1 + poses[tie, 0]
            by_lens, by_pose = pose[0] / beyond, lens[0] / beyond
            visible = np.concatenate([[pose[0], pose[0] * by_pose, lens[1]], pose[1:]])
            at, by = Microscope.project_plane(visible, world, self.frame.cell)
            row = np.zeros((*at.shape, len(LENS) + len(VIEW) * len(poses)))
            row[..., 0], row[..., 1] = by_lens * by[..., 1], by[..., 2]
            own, tied = (len(LENS) + len(VIEW) * k for k in (v, tie))
            row[..., own : own + len(VIEW)] = by[..., _OF_VIEW]
            row[..., own] += by_pose * by[..., 1]
            row[..., tied] -= by_lens * by_pose * by[..., 1]
            if len(poses) > 1:  # of one view these terms are zero and held
                sensor = at * self.frame.cell
                square = (sensor**2).sum(axis=1)[:, None]
                # The second term, and what it makes of a point's displacement.
                turn = 4 * square[..., None] * at[:, :, None] * (sensor * self.frame.cell)[:, None]
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
        What was fitted of both, counted through, the first view's magnification first.
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

    @property
    def freedom(self) -> int:
        """Coordinates less what was fitted to them."""
        return len(self.residuals) - len(self.free)

    @property
    def names(self) -> list[str]:
        """What was fitted; from the second view on names end in the view's number."""
        each = [n if v == 0 else f"{n}_{v + 1}" for v in range(len(self.poses)) for n in VIEW]
        return [[*LENS, *each][k] for k in self.free]


def fit_views(views: Views) -> tuple[Fit, list[list[Fit]]]:
    """Fit all views together, and add terms to the lens of several as far as they are justified.

    A term is justified if the sum of squares falls by more than log(2 N) variances for each of its
    numbers (Schwarz' criterion). Also the fits of each view alone from both signs of the tilt, the
    better one first.
    """
    base = [1] if views.focal_length is not None else [0, 1]
    every = [views.some([v]) for v in range(len(views.world))]
    fits = [[_fit(one, *start, base) for start in _starts(one)] for one in every]
    alone = [sorted(pair, key=lambda fit: fit.cost) for pair in fits]
    if len(every) == 1:
        return alone[0][0], alone
    lens = np.median([pair[0].lens for pair in alone], axis=0)  # that most views agree on
    best = _fit(views, lens, np.concatenate([pair[0].poses for pair in alone]), base)
    for term in _TERMS:
        lens_free = [k for k in best.free if k < len(LENS)]
        with suppress(ValueError):  # what is not found is not justified
            trial = _fit(views, best.lens, best.poses, lens_free + term)
            price = len(term) * np.log(len(trial.residuals))
            if best.cost - trial.cost > price * views.variance(trial):
                best = trial
    return best, alone


def held_out(views: Views, fit: Fit, alone: list[list[Fit]]) -> Array:
    """Reprojection error of each view, rms in px, through the lens that other views give.

    A fifth of the views is left out at a time, and each of them gets a pose of its own. Views that
    the lens of most views fits ten times worse than the others take no part. NaN where no lens or
    pose fits, and for fewer than three views.
    """
    every = np.arange(len(views.world))
    lenses, poses = (np.array([getattr(pair[0], n) for pair in alone]) for n in ("lens", "poses"))
    lens = np.median(lenses, axis=0)
    # Of views through one lens φ/(1 + M) is the same; a focal length that is given is so itself.
    powers = np.median(lenses[:, 0] / (1 + poses[:, 0, 0])) * (1 + poses[:, 0, 0])
    own = np.full(len(every), np.inf)
    for v in every:
        lens[0] = powers[v] if views.focal_length is None else lens[0]
        with suppress(ValueError):
            own[v] = _fit(views.some([v]), lens, poses[v], []).cost / len(views.world[v])
    sound = own <= 100 * max(np.median(own), views.rounding(fit.poses))
    errors = np.full(len(every), np.nan)
    if len(every) < 3 or sound.sum() < 3:
        return errors
    lens_free = [k for k in fit.free if k < len(LENS)]
    starts = np.concatenate(poses)
    for fold in range(min(len(every), 5)):
        rest = every[(every % 5 != fold) & sound]
        lens = np.median(lenses[rest], axis=0)
        with suppress(ValueError):
            others = _fit(views.some(rest), lens, starts[rest], lens_free)
            for v in every[every % 5 == fold]:
                both = np.stack([others.poses[0], starts[v]])
                moved = _fit(views.some([rest[0], v]), others.lens, both, [], fixed=len(VIEW))
                errors[v] = np.sqrt(2 * (moved.residuals[-2 * len(views.world[v]) :] ** 2).mean())
    return errors


def _fit(views: Views, lens: Array, poses: Array, lens_free: list[int], fixed: int = 0) -> Fit:
    """Fit poses, all but the first `fixed` of their numbers, and what is free of the lens."""
    start = np.concatenate([lens, poses.ravel()])
    first = len(LENS) + fixed
    free = [first, *sorted(lens_free), *range(first + 1, len(start))]
    seen = np.concatenate(views.seen)

    def split(values: Array) -> tuple[Array, Array]:
        full = start.copy()
        full[free] = values
        return full[: len(LENS)], full[len(LENS) :].reshape(poses.shape)

    @lru_cache(maxsize=1)  # the derivatives are asked for where the residuals were
    def at(values: bytes) -> tuple[Array, Array]:
        points, by = views.predict(*split(np.frombuffer(values)))
        return (points - seen).ravel(), by.reshape(-1, len(start))[:, free]

    known = views.focal_length
    need = "world and image must fit one microscope, none was found: leave out the odd views"
    if known is not None:
        need = f"focal_length must fit each view in focus, got {known:g} µm: better leave it out"
    refusal = ValueError(need)
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
    world, sensor = one.world[0], one.seen[0] * one.frame.cell
    alpha, beta, gamma, tx, ty = radial_alignment(world, sensor)
    starts = []
    for sign in (1, -1):
        rotation = euler_rotation(alpha, sign * beta, sign * gamma)
        turned = world @ rotation[:, :2].T
        depth = turned[:, 2] if one.focal_length is None else np.zeros(len(world))
        found = linear_intrinsics(turned[:, :2] + [tx, ty], depth, sensor)
        magnification, distortion, convergence = found.tolist()
        power = abs(convergence) * (1 + magnification) / magnification
        if one.focal_length is not None:
            power = 1 / one.focal_length
        lens = np.array([power, distortion, 0.0, 0.0, 0.0])
        starts.append((lens, np.array([[magnification, alpha, sign * beta, sign * gamma, tx, ty]])))
    return starts


def without_terms(lens: Array, seen: Array, cell: Array) -> Array:
    """Image points as if the axis met the sensor's middle and the distortion had one term, px."""
    at = seen - lens[3:]
    free = at
    for _ in range(8):  # each leaves four times the term's part of the first, some hundredths
        free = at / (1 + lens[2] * ((free * cell) ** 2).sum(axis=1, keepdims=True) ** 2)
    return free


def radial_alignment(world: ArrayLike, sensor: ArrayLike) -> Array:
    """Pose of a plane pattern from directions in the image alone.

    Perspective and radial distortion move an image point along its radius only, so that (u, v)
    stays parallel to (X, Y) whatever M, h and κ are (2.13).

    Parameters
    ----------
    world : array_like, shape (N, 2)
        Points of the pattern, µm.
    sensor : array_like, shape (N, 2)
        Their images (u, v), distorted, in µm from the principal point.

    Returns
    -------
    ndarray, shape (5,)
        (α, β, γ, T_x, T_y), rad and µm. (α, −β, −γ, T_x, T_y) explains the directions equally well.

    Raises
    ------
    ValueError
        If shapes disagree, or the points do not determine the pose.

    Notes
    -----
    From (2.13) and (2.5) with Z_w = 0, each point gives (2.14),

        u (r21 X_w + r22 Y_w + T_y) − v (r11 X_w + r12 Y_w + T_x) = 0.

    The thesis divides by T_y, as Tsai (1987) does; its printed row (2.15) should then read
    [v X_w, v Y_w, v, −u X_w, −u Y_w]. Here the six unknowns are kept and found up to scale by a
    singular value decomposition, which also serves when T_y is zero. The scale follows from the
    upper left block of a rotation having the singular values 1 and the absolute cosine of the tilt,
    the same condition that Tsai solves as a quadratic equation.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import radial_alignment
    >>> world = np.array([[0.0, 0], [300, 0], [0, 300], [300, 300], [150, -200]])
    >>> radial_alignment(world, 2 * (world + [50, -20])).round(6) + 0.0
    array([  0.,   0.,   0.,  50., -20.])
    """
    world = as_array("world", world, shape=(None, 2))
    sensor = as_array("sensor", sensor, shape=(None, 2))
    same_length(("world", "sensor"), world, sensor)
    center = world.mean(axis=0)
    scale = np.abs(world - center).max() or 1.0
    (x, y), (u, v) = ((world - center) / scale).T, (sensor / (np.abs(sensor).max() or 1.0)).T
    rows = np.column_stack([-v * x, -v * y, -v, u * x, u * y, u])
    # Of five points the sixth direction is in the full decomposition only.
    triangle = np.linalg.qr(rows, mode="r")
    singular, directions = np.linalg.svd(triangle)[1:]
    if len(world) < 5 or not singular[4] > _DEGENERATE * singular[0]:
        raise ValueError(
            f"world and sensor must determine a pose, got {len(world)} degenerate points"
        )
    r11, r12, tx, r21, r22, ty = directions[5]
    block, shift = np.array([[r11, r12], [r21, r22]]), scale * np.array([tx, ty])
    size = np.linalg.svd(block, compute_uv=False)[0]
    outward = ((block @ np.stack([x, y]) + [[tx], [ty]]) * np.stack([u, v])).sum()
    block, shift = block / np.copysign(size, outward), shift / np.copysign(size, outward)

    return np.concatenate([_angles(block), shift - block @ center])


def _angles(block: Array) -> Array:
    """(α, β, γ) of the rotation that is nearest to one with this upper left block, (2, 2)."""
    below = np.sqrt(np.maximum(1 - (block**2).sum(axis=0), 0))  # |r31|, |r32|
    below[1] = np.copysign(below[1], -(block[:, 0] @ block[:, 1]))
    columns = np.vstack([block, below])
    left, _, right = np.linalg.svd(np.column_stack([columns, np.cross(*columns.T)]))
    r = left @ right
    beta = np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2]))
    return np.array([np.arctan2(r[1, 0], r[0, 0]), beta, np.arctan2(r[2, 1], r[2, 2])])


def linear_intrinsics(flat: ArrayLike, depth: ArrayLike, sensor: ArrayLike) -> Array:
    """Magnification, distortion and convergence from a known pose, by linear least squares.

    Parameters
    ----------
    flat : array_like, shape (N, 2)
        (p, q) of (2.17): the points in the objective frame, X and Y, µm.
    depth : array_like, shape (N,)
        Z − T_z of the points, µm.
    sensor : array_like, shape (N, 2)
        (u, v), distorted, in µm from the principal point.

    Returns
    -------
    ndarray, shape (3,)
        M, κ in 1/µm², and h = 1/T_z in 1/µm; h is zero if all depths are.

    Raises
    ------
    ValueError
        If shapes disagree.

    Notes
    -----
    The thesis neglects the depth, (2.16), and adds the rows of u and v:
    M (p + q) − κ (u + v) r² = u + v (2.18), which makes the row of (2.19) [p + q, −(u + v) r²]:
    the κ printed in it is the unknown, and the sign is lost. A sum loses the points near the line
    p + q = 0, so here u and v keep their own rows; h adds a third column, −u (Z − T_z); its product
    with κ, a thousandth of either, is neglected.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.calibration import linear_intrinsics
    >>> flat = np.array([[100.0, 0], [0, 200], [-300, 50]])
    >>> linear_intrinsics(flat, np.zeros(3), 1.6 * flat).round(6) + 0.0
    array([1.6, 0. , 0. ])
    """
    flat = as_array("flat", flat, shape=(None, 2))
    depth = as_array("depth", depth, shape=(None,))
    sensor = as_array("sensor", sensor, shape=(None, 2))
    same_length(("flat", "sensor"), flat, sensor)
    same_length(("flat", "depth"), flat, depth)
    radius2 = (sensor**2).sum(axis=1, keepdims=True)
    rows = np.stack([flat, -sensor * radius2, -sensor * depth[:, None]], axis=-1).reshape(-1, 3)
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    return np.linalg.lstsq(rows / scale, sensor.ravel(), rcond=_DEGENERATE)[0] / scale
