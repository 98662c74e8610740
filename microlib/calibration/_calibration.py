"""Result of a calibration: the microscope, its parameters with their covariance, and its files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from microlib._common import ArgumentError, Array, Result, as_instance
from microlib.calibration._detection import Detection
from microlib.calibration._uncertainty import reciprocal_estimate
from microlib.estimate import Estimate
from microlib.microscope import Microscope, undistort

if TYPE_CHECKING:
    import pandas as pd

#: Deviation, px, of five distortion coefficients of OpenCV above which eight are fitted.
_FEW_TERMS_ERROR = 0.1
#: Fields with numbers that may be infinite or NaN, which JSON can hold as texts only.
_NUMBERS = (
    *("covariance", "residuals", "plane_residuals", "lack_of_fit", "p_value", "widening"),
    "held_out",
)


@dataclass(frozen=True)
class ErrorSummary(Result):
    """Statistics of the distances between two sets of points, as in Table 5.2.

    Attributes
    ----------
    mean, std, max, rms : float
        In the unit of the points.
    """

    mean: float
    std: float
    max: float
    rms: float


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """A calibrated microscope with the covariance of its parameters.

    Attributes
    ----------
    microscope : Microscope
        Microscope with the estimated parameters, in focus: d = f²/T_op (2.20). Without the pixel
        pitch it is one with pixels of 1 µm that makes the same images: its `principal_distance`,
        its pose and all projections are right, but not its magnification, tube length, focal length
        and distance. Its values for `undetermined` parameters are arbitrary: they reproduce these
        points only.
    parameters : dict of str to Estimate
        The estimated parameters by name, with uncertainty, 95 % interval and unit. The uncertainty
        of a parameter that the points do not determine is infinite and its value is NaN.
    covariance : ndarray, shape (p, p)
        Covariance of the parameters, in their order. Undetermined parameters have infinite
        variances and NaN covariances.
    undetermined : tuple of str
        Parameters that the points do not determine.
    dof : int
        Degrees of freedom of the covariance, for Student's distribution: the number of marks minus
        one if errors are correlated within a mark or between views; 2 N − p if the points are
        independent, or if there are no more marks than parameters.
    residuals : ndarray, shape (N, 2)
        Image points minus their projection by the microscopes in `views`, px.
    plane_residuals : ndarray, shape (N, 2)
        Image points projected back to the pattern by these microscopes minus the world points, µm.
    lack_of_fit : float
        Size of the smooth part of the residuals over its size by noise alone, the root of the
        ratio of the lack-of-fit F test. About one for an adequate model. NaN if all
        views together have fewer than 24 marks, where a mark counts once in each view.
    p_value : float
        Probability of a larger lack of fit by noise alone, 1 if `lack_of_fit` is NaN. Below 0.1 the
        covariance includes the model discrepancy, for example another distortion or a bent pattern.
        The part of it that changes the parameters is assumed to be as large as the part that
        remains in the residuals.
    widening : float
        Factor by which the model discrepancy increases the uncertainty of `um_per_pixel`, 1 if
        there is none.
    views : tuple of Microscope
        Microscope of each view; the first one is `microscope`.
    held_out : ndarray, shape (V,)
        Reprojection error of each view, rms in px, with a lens fitted to other views and a pose
        fitted to this one (cross-validation in five folds). NaN for fewer than three views, or
        where the fit fails.
    inconsistent : tuple of int
        Numbers, from zero, of the views that have another lens than the largest set of views with
        a common lens. They are to be left out.
    print_aspect : float
        Distance of neighboring marks along the second coordinate of the pattern over that along the
        first, both over the stated ones; 1 unless another ratio halves the squares of the residuals
        of several views.
    """

    microscope: Microscope
    parameters: dict[str, Estimate]
    covariance: Array
    undetermined: tuple[str, ...]
    dof: int
    residuals: Array
    plane_residuals: Array
    lack_of_fit: float
    p_value: float
    widening: float
    views: tuple[Microscope, ...]
    held_out: Array
    inconsistent: tuple[int, ...]
    print_aspect: float

    def __repr__(self) -> str:
        pixel, scope = self.um_per_pixel, self.microscope
        focal = self.parameters.get("focal_length", f"{scope.focal_length:.6g} µm")
        lens = f"magnification {scope.magnification:.6g}, focal length {focal}"
        if self.pixel_pitch is None:
            lens = f"principal distance {self.principal_distance}"
        tilt = f", tilt {np.rad2deg(scope.tilt):.3g}°"
        lines = [
            f"Calibration of {len(self.residuals)} points in {len(self.views)} view(s), "
            f"{self.reprojection.rms:.3g} px rms residual",
            f"  {pixel} at the origin of the{' first' * (len(self.views) > 1)} pattern",
            f"  {lens}{tilt if self._tilt_is_determined(0) else ''}",
        ]
        if self.undetermined:
            lines.append(f"  undetermined: {', '.join(self.undetermined)}")
        if np.isfinite(self.held_out).any():
            median = np.nanmedian(self.held_out)
            lines.append(
                f"  held-out views: median {median:.3g} px rms, most {np.nanmax(self.held_out):.3g}"
            )
        if self.inconsistent:
            numbers = ", ".join(str(view + 1) for view in self.inconsistent)
            lines.append(f"  inconsistent, to be left out: view {numbers}, counted from 1")
        aspect = self.parameters.get("pixel_aspect")
        if self.print_aspect != 1:
            remedy = "pitch must be the distances of marks along both directions of the pattern"
            lines.append(f"  the print is not square: ratio {self.print_aspect:.4f}; {remedy}")
        elif aspect and not aspect.low <= 1 <= aspect.high:
            lines.append(f"  the pixels or the print are not square: ratio {aspect}")
        if not self.adequate:
            lines.append(
                f"  the model is not adequate: lack of fit {self.lack_of_fit:.3g}, error in the "
                f"pattern's plane {self.plane_error.rms:.2g} µm rms; the interval of the pixel "
                f"size is {self.widening:.2g} times as wide as from noise alone"
            )
        elif np.isnan(self.lack_of_fit):
            lines.append("  too few marks to test whether the model is adequate")
        return "\n".join(lines)

    def _tilt_is_determined(self, view: int) -> bool:
        """Whether the points determine both angles of the tilt of a view, with their sign."""
        ending = f"_{view + 1}" if view else ""
        return not {f"beta{ending}", f"gamma{ending}"} & set(self.undetermined)

    @property
    def adequate(self) -> bool:
        """False if the residuals contradict the model: `p_value` is below 0.001.

        It is True where the marks are too few for a test. `lack_of_fit` is then NaN, and the
        intervals contain no error of the model, such as distortion of a higher order.
        """
        return self.p_value >= 1e-3

    @property
    def reprojection(self) -> ErrorSummary:
        """Distances in the image, px."""
        return _summary(self.residuals)

    @property
    def plane_error(self) -> ErrorSummary:
        """Distances on the pattern plane, µm (Table 5.2)."""
        return _summary(self.plane_residuals)

    @property
    def pixel_pitch(self) -> float | tuple[float, float] | None:
        """Pixel pitch of the sensor that was given, µm, along y times "pixel_aspect"."""
        return self.microscope.pixel_pitch if "magnification" in self.parameters else None

    @property
    def um_per_pixel(self) -> Estimate:
        """Width of a pixel at the distance of the pattern's origin, µm/px.

        It is the pixel pitch over the magnification of the first view. The origin is the point
        (0, 0) of `world`: of a `Detection`, the mark (0, 0) of the grid. Other points of a tilted
        pattern are nearer to the lens or farther away, and their pixels are smaller or larger: by
        up to tan(tilt) times the distance from the origin over that from the lens. The interval
        does not contain these differences.
        """
        scale = self.parameters["px_per_um" if self.pixel_pitch is None else "magnification"]
        pitch = float(self.microscope.pitch[0])
        high = pitch / scale.low if scale.low > 0 else np.inf
        uncertainty = pitch * scale.uncertainty / scale.value**2
        return Estimate(pitch / scale.value, uncertainty, pitch / scale.high, high, "µm/px")

    @property
    def principal_distance(self) -> Estimate:
        """Principal distance T_op + f along x, px: the focal length f_x of OpenCV's camera."""
        if "principal_distance" in self.parameters:
            return self.parameters["principal_distance"]
        # T_op + f = f (1 + M)
        relative = {"magnification": 1 / (1 + self.microscope.magnification)}
        if "focal_length" in self.parameters:
            relative["focal_length"] = 1 / self.microscope.focal_length
        gradient = np.array([relative.get(name, 0.0) for name in self.parameters])
        if set(relative) & set(self.undetermined):
            return Estimate(np.nan, np.inf, 0.0, np.inf, "px")
        used = gradient != 0
        variance = gradient[used] @ self.covariance[np.ix_(used, used)] @ gradient[used]
        value = float(self.microscope.principal_distance[0])
        return reciprocal_estimate(value, float(np.sqrt(variance)), self.dof, "px")

    def to_frame(self) -> pd.DataFrame:
        """Return the parameters as a table.

        Returns
        -------
        pandas.DataFrame
            A row for each parameter with the estimate, its uncertainty, the limits of its 95 %
            interval, its unit, and whether the points determine it.
        """
        import pandas as pd  # here, as it takes long to import

        rows = [vars(each) for each in self.parameters.values()]
        names = pd.Index(self.parameters, name="parameter")
        determined = [name not in self.undetermined for name in self.parameters]
        return pd.DataFrame(rows, index=names).assign(determined=determined)

    def plot(self, ax: Any = None, *, found: Any, images: Any = None) -> Any:
        """Draw the points with their places in the grid and the residuals, by Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw the first view; by default every view is a panel of a new figure.
        found : Detection or list of Detection
            What the calibration was made from.
        images : ndarray or list of ndarray, optional
            The photographs.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        ValueError
            If `found` does not have the points of the calibration.
        """
        from microlib._plots import marks

        several = isinstance(found, (list, tuple))
        detections = found if several else [found]
        points = sum(len(as_instance("found", each, Detection).points) for each in detections)
        if (len(detections), points) != (len(self.views), len(self.residuals)):
            raise ArgumentError(
                "found",
                f"must hold the detections of the {len(self.views)} calibrated views with "
                f"{len(self.residuals)} points, got {len(detections)} with {points} points",
            )
        pictures = images if several or images is None else [images]
        return marks(detections, pictures, self.residuals, ax)

    def to_json(self) -> str:
        """Return the calibration as JSON for `from_json` and for other programs.

        * ``opencv``: camera matrix and distortion coefficients as ``cv2.undistort`` takes them,
          five or, if those deviate by 0.1 px from this model, eight; their largest deviation from
          this model in the image; and rotation and translation of each view. A given focal length
          makes T_op + f differ between views of different magnification; the camera matrix is that
          of the first view, and the translations are those for this matrix. What the points do not
          determine is null: the rotation of a view whose tilt is undetermined, and without the
          principal distance also the camera matrix, the distortion and the translations.
        * ``imagej``: width and height of a pixel, as in `um_per_pixel` at the pattern's origin.
        * ``micro_manager``: pixel size, the root of width times height. Its 95 % interval is in
          ``pixel_size_interval_um``; an infinite upper limit is null.
        * ``calibration``: all fields. Numbers that may be infinite or NaN are texts.

        Returns
        -------
        str
        """
        scope, pixel = self.microscope, self.um_per_pixel
        distance, center = scope.principal_distance, scope.principal_point
        terms, worst = _opencv_distortion(scope)
        known = not {"focal_length", "principal_distance"} & set(self.undetermined)
        camera_matrix = [[distance[0], 0, center[0]], [0, distance[1], center[1]], [0, 0, 1]]
        rotations = [
            cv2.Rodrigues(view.rotation)[0].ravel() if self._tilt_is_determined(v) else None
            for v, view in enumerate(self.views)
        ]
        # Of the root of the area, and of the height.
        mean, height = np.sqrt(scope.pitch[1] / scope.pitch[0]), scope.pitch[1] / scope.pitch[0]
        # One camera matrix serves all views, so the depth of each is that of its magnification.
        sensor_distance = scope.tube_length + scope.focal_length
        translations = [[v.tx, v.ty, sensor_distance / v.magnification] for v in self.views]
        own = {n: v for n, v in vars(self).items() if n != "microscope"}
        own |= {n: np.array(own[n]).astype(str) for n in _NUMBERS}
        own["parameters"] = {
            name: {key: str(number) for key, number in vars(each).items()}
            for name, each in self.parameters.items()
        }
        content = {
            "opencv": {
                "image_width": scope.image_size[0],
                "image_height": scope.image_size[1],
                "camera_matrix": camera_matrix if known else None,
                "distortion_coefficients": terms if known else None,
                "distortion_model_error_px": worst if known else None,
                "rotation_vectors": rotations,
                "translation_vectors_um": translations if known else [None] * len(self.views),
            },
            "micro_manager": {"PixelSizeUm": mean * pixel.value},
            "imagej": {
                "unit": "µm",
                "pixel_width": pixel.value,
                "pixel_height": height * pixel.value,
            },
            "pixel_size_interval_um": [
                mean * end if end < np.inf else None for end in pixel.interval
            ],
            "calibration": own | {"views": [vars(view) for view in self.views]},
        }
        return json.dumps(content, indent=2, ensure_ascii=False, default=np.ndarray.tolist)

    @classmethod
    def from_json(cls, text: str) -> Calibration:
        """Read what `to_json` wrote.

        Parameters
        ----------
        text : str
            The text of the file, with all digits.

        Returns
        -------
        Calibration

        Raises
        ------
        ValueError
            If `text` holds no calibration.
        """
        try:
            own = json.loads(text)["calibration"]
            own |= {n: np.array(own[n]).astype(float)[()] for n in _NUMBERS}
            for name, each in own["parameters"].items():
                value, uncertainty, low, high, unit = each.values()
                numbers = float(value), float(uncertainty), float(low), float(high)
                own["parameters"][name] = Estimate(*numbers, unit)
            own["views"] = [Microscope(**view) for view in own["views"]]
            own |= {n: tuple(v) for n, v in own.items() if isinstance(v, list)}
            return cls(microscope=own["views"][0], **own)
        except (TypeError, LookupError, ValueError) as fault:
            raise ValueError(f"text must be what to_json wrote, got {str(text)[:40]!r}") from fault


def _summary(differences: Array) -> ErrorSummary:
    """Statistics of the lengths of differences of points, shape (N, 2)."""
    distance = np.hypot(*differences.T)
    rms = np.sqrt((distance**2).mean())
    return ErrorSummary(
        float(distance.mean()), float(distance.std()), float(distance.max()), float(rms)
    )


def _opencv_distortion(scope: Microscope) -> tuple[list[float], float]:
    """OpenCV's k₁, k₂, p₁, p₂, k₃ for a microscope, and their largest deviation from it, px.

    OpenCV's polynomial leads from undistorted to distorted points, with the radius in principal
    distances. The polynomial of this model is its inverse, which bends too much for OpenCV's at a
    wide angle: then k₄, k₅ and k₆ follow, those of OpenCV's quotient of two polynomials.
    """
    distance = scope.tube_length + scope.focal_length
    ends = np.array([[-0.5, -0.5], np.array(scope.image_size) - 0.5]) - scope.principal_point
    corner = float(np.linalg.norm(np.abs(ends).max(axis=0) * scope.pitch))
    seen = np.linspace(0, corner)[1:]
    points = np.column_stack([seen, 0 * seen])
    radius = undistort(points, scope.distortion, scope.distortion_k2)[:, 0]
    reached = np.isfinite(radius)  # up to the fold of the distortion
    seen, radius = seen[reached], radius[reached]
    powers = 2 * np.arange(1, 4)
    even = (radius[:, None] / corner) ** powers
    design = np.hstack([radius[:, None] * even, -seen[:, None] * even])
    fits = []
    for count in (3, 6):
        best = np.zeros(6)
        best[:count] = np.linalg.lstsq(design[:, :count], seen - radius, rcond=None)[0]
        divisor = 1 + even @ best[3:]
        error = np.abs(radius * (1 + even @ best[:3]) / divisor - seen).max() / scope.pitch.min()
        fits.append((float(error) if (divisor > 0).all() else np.inf, count, best))
    worst, count, best = fits[0] if fits[0][0] < _FEW_TERMS_ERROR else min(fits)
    k1, k2, k3, *more = (best[:count] * (distance / corner) ** np.resize(powers, count)).tolist()
    return [k1, k2, 0.0, 0.0, k3, *more], worst
