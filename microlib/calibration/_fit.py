"""Nonlinear fit of all views of one pattern through one lens (bundle adjustment).

The views share the lens: the principal distance T_op + f, the distortion and, where several views
determine them, a second distortion coefficient and the principal point. Each view has its own
magnification and pose. The fit starts from the closed form of (2.13)–(2.19): the pose by radial
alignment, then magnification and distortion by linear least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from microlib._common import Array
from microlib.calibration._linear import linear_intrinsics, radial_alignment
from microlib.microscope import euler_rotation, project_points

#: Parameters of the lens: 1/(T_op + f) in 1/µm, those of `Microscope` that are the same in all
#: views, and the height of a pixel over that of a pixel with the given pitch.
LENS = (
    *("inverse_principal", "distortion", "distortion_k2", "principal_x", "principal_y"),
    "pixel_aspect",
)
#: Parameters of a view: M, α, β, γ in rad, and T_x, T_y in µm.
POSE = ("magnification", "alpha", "beta", "gamma", "tx", "ty")
#: Relative rounding error of an image point: one operation makes 1e-16, another order of the same
#: sums up to 1e-15. No decision depends on a smaller difference.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Photographs:
    """Corresponding points of the pattern and of its images, and what is known of the camera.

    Parameters
    ----------
    world : list of ndarray, shape (N_v, 2)
        Points of the pattern in each view, µm.
    image : list of ndarray, shape (N_v, 2)
        Their images (x, y), px.
    image_size : (int, int)
        Width and height of the images, px.
    pixel_pitch : ndarray, shape (2,)
        That of the sensor, µm; (1, 1) if it is not known, and lengths on the sensor are then
        in px.
    focal_length : float or None
        Focal length, µm, if it is given.
    mark_places : ndarray, shape (N, 2), or None
        Grid coordinates of the mark of each point of all views, if marks have several points.
    """

    world: list[Array]
    image: list[Array]
    image_size: tuple[int, int]
    pixel_pitch: Array
    focal_length: float | None
    mark_places: Array | None = None

    @property
    def middle(self) -> Array:
        """Middle of the images, (x, y) px."""
        return (np.asarray(self.image_size) - 1) / 2

    @property
    def refusal(self) -> ValueError:
        """The error for points that no microscope fits."""
        if self.focal_length is None:
            return ValueError("world and image must fit one microscope, none was found")
        return ValueError(
            f"focal_length must fit each view in focus, got {self.focal_length:g} µm: "
            "better leave it out"
        )

    def subset(self, which: ArrayLike) -> Photographs:
        """The views with the given indices."""
        world, image = ([each[v] for v in np.asarray(which)] for each in (self.world, self.image))
        return replace(self, world=world, image=image, mark_places=None)

    def rounding_variance(self, poses: Array) -> float:
        """Variance of a coordinate by rounding alone, px²: a floor for every stated variance."""
        scaled = [
            pose[0] * world / self.pixel_pitch
            for pose, world in zip(poses, self.world, strict=True)
        ]
        return float((_ROUNDING * max(np.abs(at).max() for at in (*scaled, *self.image))) ** 2)

    def residual_variance(self, fit: Fit) -> float:
        """Variance of a coordinate estimated from the residuals of a fit, px²."""
        return fit.rss / max(fit.dof, 1) + self.rounding_variance(fit.poses)

    def predict(self, lens: Array, poses: Array) -> tuple[Array, Array]:
        """Image points of all views, (N, 2), and their derivatives, (N, 2, 6 + 6 V).

        The first six derivatives are those by `LENS`; then follow six by the pose of each view.
        """
        points, jacobians = [], []
        for v, (pose, world) in enumerate(zip(poses, self.world, strict=True)):
            projected, by = self._project(lens, pose, world)
            first = len(LENS) + v * len(POSE)
            jacobian = np.zeros((len(world), 2, len(LENS) + poses.size))
            jacobian[..., : len(LENS)] = by[..., : len(LENS)]
            jacobian[..., first : first + len(POSE)] = by[..., len(LENS) :]
            points.append(projected)
            jacobians.append(jacobian)
        return np.concatenate(points), np.concatenate(jacobians)

    def _project(self, lens: Array, pose: Array, world: Array) -> tuple[Array, Array]:
        """Image points of one view, and their derivatives by `LENS` and `POSE`, (N, 2, 12)."""
        view = dict(zip((*LENS, *POSE), (*lens, *pose), strict=True))
        inverse_principal, magnification = view.pop("inverse_principal"), view["magnification"]
        aspect = view.pop("pixel_aspect")
        # The convergence: h = 1/(f + d) = M/(T_op + f), and T_op + f = f (1 + M) in focus.
        h_by_inverse_principal, h_by_magnification = magnification, inverse_principal
        if self.focal_length is not None:
            inverse_principal = 1 / (self.focal_length * (1 + magnification))
            h_by_inverse_principal = 0.0
            h_by_magnification = inverse_principal / (1 + magnification)
        view["convergence"] = magnification * inverse_principal
        pitch = self.pixel_pitch * [1.0, aspect]
        points, by = project_points(world, pitch, view, derivatives=True)
        by["pixel_aspect"] = np.stack([0 * points[1], (view["principal_y"] - points[1]) / aspect])
        by["inverse_principal"] = by["convergence"] * h_by_inverse_principal
        by["magnification"] = by["magnification"] + by["convergence"] * h_by_magnification
        jacobian = np.array([by[name] for name in (*LENS, *POSE)]).transpose(2, 1, 0)
        return points.T + self.middle, jacobian


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit of views.

    Parameters
    ----------
    lens : ndarray, shape (6,)
        Parameters of the lens as in `LENS`.
    poses : ndarray, shape (V, 6)
        Parameters of the views as in `POSE`.
    free : list of int
        Indices of the fitted parameters in `lens` and `poses`, flat and joined. The first is that
        of the first view's magnification.
    residuals : ndarray, shape (2 N,)
        Image points minus their projection, px.
    jacobian : ndarray, shape (2 N, p)
        Derivatives of the projection by the fitted parameters.
    """

    lens: Array
    poses: Array
    free: list[int]
    residuals: Array
    jacobian: Array

    @property
    def rss(self) -> float:
        """Residual sum of squares, px²."""
        return float(self.residuals @ self.residuals)

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return len(self.residuals) - len(self.free)

    @property
    def estimate(self) -> Array:
        """Values of the fitted parameters."""
        return np.concatenate([self.lens, self.poses.ravel()])[self.free]

    @property
    def lens_free(self) -> list[str]:
        """Names of the fitted parameters of the lens."""
        return [name for k, name in enumerate(LENS) if k in self.free]

    @property
    def names(self) -> list[str]:
        """Names of the fitted parameters; from the second view on they end in its number."""
        each = [n if v == 0 else f"{n}_{v + 1}" for v in range(len(self.poses)) for n in POSE]
        return [[*LENS, *each][k] for k in self.free]


class InconsistentViews(ValueError):
    """The error for views that do not fit one microscope; `views` are their numbers, from zero."""

    def __init__(self, views: Sequence[int]) -> None:
        super().__init__(views)
        self.views = tuple(views)

    def __str__(self) -> str:
        names = ", ".join(str(view + 1) for view in self.views)
        return f"world and image must fit one microscope: leave out view {names}, counted from 1"


def fit_each_view(photographs: Photographs) -> list[list[Fit]]:
    """Fit each view alone from both signs of its tilt; the better fit comes first."""
    base = ["distortion"] if photographs.focal_length else ["inverse_principal", "distortion"]
    alone, failed = [], []
    for v in range(len(photographs.world)):
        view = photographs.subset([v])
        try:
            fits = [least_squares_fit(view, *start, base) for start in _starts(view)]
            alone.append(sorted(fits, key=lambda fit: fit.rss))
        except ValueError:
            if len(photographs.world) == 1:
                raise
            failed.append(v)
    if failed:
        raise InconsistentViews(failed)
    return alone


def fit_together(photographs: Photographs, alone: list[list[Fit]]) -> Fit:
    """Fit all views together, from the fits of each view alone."""
    if len(alone) == 1:
        return alone[0][0]
    lens = np.median([pair[0].lens for pair in alone], axis=0)
    poses = np.concatenate([pair[0].poses for pair in alone])
    return least_squares_fit(photographs, lens, poses, alone[0][0].lens_free)


def least_squares_fit(
    photographs: Photographs, lens: Array, poses: Array, lens_free: Sequence[str]
) -> Fit:
    """Fit all poses and the given parameters of the lens by Levenberg–Marquardt from a start."""
    start = np.concatenate([lens, poses.ravel()])
    first = len(LENS)
    free = [first, *sorted(map(LENS.index, lens_free)), *range(first + 1, len(start))]
    image = np.concatenate(photographs.image)

    def split(values: Array) -> tuple[Array, Array]:
        full = start.copy()
        full[free] = values
        return full[: len(LENS)], full[len(LENS) :].reshape(poses.shape)

    @lru_cache(maxsize=1)  # SciPy asks for the derivatives where it has asked for the residuals
    def evaluate(values: bytes) -> tuple[Array, Array]:
        """Projection minus image points, and its derivatives."""
        points, jacobian = photographs.predict(*split(np.frombuffer(values)))
        return (points - image).ravel(), jacobian.reshape(-1, len(start))[:, free]

    if not np.isfinite(evaluate(start[free].tobytes())[0]).all():
        # The linear κ of a wide-angle lens may lie outside the domain of the distortion model.
        start[LENS.index("distortion")] = 0.0
    if not np.isfinite(evaluate(start[free].tobytes())[0]).all():
        raise photographs.refusal
    found = least_squares(
        lambda values: evaluate(values.tobytes())[0],
        start[free],
        lambda values: evaluate(values.tobytes())[1],
        method="lm",
        x_scale="jac",
        ftol=_ROUNDING,
        xtol=_ROUNDING,
        gtol=_ROUNDING,
        max_nfev=200,
    )
    # Parallel views determine no focal length: the search does not end in the flat valley of their
    # minimum, where its residuals are those of the noise. Here they are above a pixel, rms.
    if found.status == 0 and len(poses) > 1 and found.cost > len(image):
        raise photographs.refusal
    differences, jacobian = evaluate(found.x.tobytes())
    lens, poses = split(found.x)
    signs, principal = np.ones(len(start)), LENS.index("inverse_principal")
    pose_signs = signs[first:].reshape(poses.shape)
    behind = (poses[:, 0] < 0) & (photographs.focal_length is None)
    # The image of a plane is equal with −M, −T_x, −T_y, the opposite tilt (β, γ), and α + π.
    pose_signs[behind] = [-1, 1, -1, -1, -1, -1]
    if lens[principal] < 0:
        # The images are equal with −1/(T_op + f) and the opposite tilts.
        signs[principal] = -1
        pose_signs[:, 2:4] *= -1
    over = np.cos(poses[:, 2]) < 0  # the rotations (α, β, γ) and (α + π, π − β, γ + π) are equal
    pose_signs[over, 2] *= -1
    lens, poses = split(found.x * signs[free])
    poses[behind, 1] += np.pi
    poses[over, 1:4] += np.pi
    poses[:, 1:4] = np.angle(np.exp(1j * poses[:, 1:4]))  # to (−π, π]
    return Fit(lens, poses, free, -differences, jacobian * signs[free])


def _starts(photograph: Photographs) -> list[tuple[Array, Array]]:
    """Lens and pose of a single view in closed form, for each sign of the tilt."""
    world, offset = photograph.world[0], photograph.image[0] - photograph.middle
    sensor = offset * photograph.pixel_pitch
    alpha, beta, gamma, tx, ty = radial_alignment(world, sensor)
    starts = []
    for sign in (1, -1):
        rotation = euler_rotation(alpha, sign * beta, sign * gamma)
        turned = world @ rotation[:, :2].T
        depth = turned[:, 2] if photograph.focal_length is None else np.zeros(len(world))
        flat = turned[:, :2] + [tx, ty]
        magnification, distortion, inverse_depth = linear_intrinsics(flat, depth, sensor).tolist()
        known = {"inverse_principal": abs(inverse_depth / magnification), "distortion": distortion}
        known["pixel_aspect"] = 1.0
        lens = np.array([known.get(name, 0.0) for name in LENS])
        starts.append((lens, np.array([[magnification, alpha, sign * beta, sign * gamma, tx, ty]])))
    return starts
