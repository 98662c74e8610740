"""Result of a calibration: the microscope, its parameters with their covariance, and its files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from microlib._common import Array, Result, as_array, one_of, scalar
from microlib.calibration._uncertainty import reciprocal_interval, student_quantile
from microlib.microscope import Microscope, distort

if TYPE_CHECKING:
    import pandas as pd

#: Fields with numbers that may be infinite or NaN, which JSON can hold as texts only.
_NUMBERS = (
    *("estimate", "covariance", "residuals", "plane_residuals"),
    *("misfit", "p_value", "held_out"),
)


@dataclass(frozen=True)
class ErrorSummary(Result):
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
        rms = np.sqrt((distance**2).mean())
        return cls(float(distance.mean()), float(distance.std()), float(distance.max()), float(rms))


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """A calibrated microscope with the covariance of its parameters.

    Parameters
    ----------
    microscope : Microscope
        Microscope with the estimated parameters, in focus: d = f²/T_op (2.20).
    parameters : tuple of str
        Names of the estimated parameters, in the order of `estimate` and `covariance`. Lengths are
        in µm, angles in rad, κ in 1/µm².
    estimate : ndarray, shape (p,)
        Estimates of the parameters.
    covariance : ndarray, shape (p, p)
        Covariance of the estimates. Undetermined parameters have infinite variances and NaN
        covariances.
    undetermined : tuple of str
        Parameters that the points do not determine. Their estimates have no meaning.
    dof : int
        Degrees of freedom of the covariance, for Student's distribution.
    residuals : ndarray, shape (N, 2)
        Image points minus their projection, px.
    plane_residuals : ndarray, shape (N, 2)
        Image points projected back to the pattern minus the world points, µm.
    misfit : float
        Size of the smooth part of the residuals over its size by noise alone, the root of the
        ratio of the lack-of-fit F test. About one for an adequate model, NaN for fewer than 24
        marks.
    p_value : float
        Probability of a larger misfit by noise alone, 1 if `misfit` is NaN. Below 0.1 the
        covariance includes the model discrepancy, for example another distortion or a bent pattern.
        The part of it that changes the parameters is assumed to be as large as the part that
        remains in the residuals.
    views : tuple of Microscope
        Microscope of each view; the first one is `microscope`.
    held_out : ndarray, shape (V,)
        Reprojection error of each view, rms in px, with a lens fitted to other views and a pose
        fitted to this one (cross-validation in five folds). NaN for fewer than three views, or
        where the fit fails.
    """

    microscope: Microscope
    parameters: tuple[str, ...]
    estimate: Array
    covariance: Array
    undetermined: tuple[str, ...]
    dof: int
    residuals: Array
    plane_residuals: Array
    misfit: float
    p_value: float
    views: tuple[Microscope, ...]
    held_out: Array

    def __repr__(self) -> str:
        value, low, high = self.um_per_pixel()
        span = f"in {low:.6g} … {high:.6g}" if high < np.inf else f"above {low:.6g}"
        lines = [
            f"Calibration of {len(self.residuals)} points in {len(self.views)} view(s), "
            f"{self.reprojection.rms:.3g} px rms residual",
            f"  {value:.6g} µm per pixel at the origin of the{' first' * (len(self.views) > 1)} "
            f"pattern, {'95 % ' + span if low else 'undetermined'}",
            f"  magnification {self.microscope.magnification:.6g}, "
            f"focal length {self.microscope.focal_length:.6g} µm, "
            f"tilt {np.rad2deg(self.microscope.tilt):.3g}°",
        ]
        if self.undetermined:
            lines.append(f"  undetermined: {', '.join(self.undetermined)}")
        if np.isfinite(self.held_out).any():
            median = np.nanmedian(self.held_out)
            lines.append(
                f"  {median:.3g} px rms in held-out views, at most {np.nanmax(self.held_out):.3g}"
            )
        if not self.adequate:
            lines.append(f"  the model is not adequate: misfit {self.misfit:.3g}")
        elif np.isnan(self.misfit):
            lines.append("  too few marks to test whether the model is adequate")
        return "\n".join(lines)

    @property
    def adequate(self) -> bool:
        """False if the residuals contradict the model: `p_value` is below 0.001.

        It is True where the marks are too few for a test. `misfit` is then NaN, and the intervals
        contain no error of the model, such as distortion of a higher order.
        """
        return self.p_value >= 1e-3

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

    def interval(self, parameter: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter, from Student's distribution.

        The interval of the focal length is the reciprocal of that of 1/f, whose error is nearly
        normal. Lower limits of focal length and magnification are at least zero.

        Parameters
        ----------
        parameter : str
            One of `parameters`.
        level : float
            Confidence level.

        Returns
        -------
        low, high : float
            Limits in the unit of the parameter.

        Raises
        ------
        ValueError
            If `parameter` was not estimated or `level` is not in (0, 1).
        """
        k = self.parameters.index(one_of("parameter", parameter, self.parameters))
        level = scalar("level", level, above=0, below=1)
        std = float(np.sqrt(self.covariance[k, k]))
        # Half of an infinite interval is infinite at any level.
        half = std if np.isinf(std) else student_quantile(self.dof, level) * std
        value = float(self.estimate[k])
        if parameter == "focal_length":
            return reciprocal_interval(value, half / value)
        least = 0.0 if parameter.startswith("magnification") else -np.inf
        return max(value - half, least), value + half

    def um_per_pixel(self, level: float = 0.95) -> tuple[float, float, float]:
        """Width of a pixel at the distance of the pattern's origin, µm, with its interval.

        It is the width of a sensor pixel over the magnification of the first view. The origin is
        the point (0, 0) of `world`: of a `Detection`, the mark (0, 0) of the grid. Other points of
        a tilted pattern are nearer to the lens or farther away, and their pixels are smaller or
        larger: by up to tan(tilt) times the distance from the origin over that from the lens. The
        interval does not contain these differences.

        Parameters
        ----------
        level : float
            Confidence level.

        Returns
        -------
        value, low, high : float
        """
        low, high = self.interval("magnification", level)
        pixel_pitch = float(self.microscope.pitch[0])
        low = pixel_pitch / low if low else np.inf
        return pixel_pitch / self.microscope.magnification, pixel_pitch / high, low

    def to_frame(self) -> pd.DataFrame:
        """Return the parameters as a table.

        Returns
        -------
        pandas.DataFrame
            A row for each parameter with the estimate, its standard deviation, the limits of its
            95 % interval, and whether the points determine it. Lengths are in µm, angles in rad, κ
            in 1/µm².
        """
        import pandas as pd  # here, as it takes long to import

        spans = np.array([self.interval(name) for name in self.parameters])
        return pd.DataFrame(
            {
                "estimate": self.estimate,
                "sigma": list(self.sigma.values()),
                "low": spans[:, 0],
                "high": spans[:, 1],
                "determined": [name not in self.undetermined for name in self.parameters],
            },
            index=pd.Index(self.parameters, name="parameter"),
        )

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
        """
        from microlib._plots import marks

        several = isinstance(found, (list, tuple))
        pictures = images if several or images is None else [images]
        return marks(found if several else [found], pictures, self.residuals, ax)

    def to_json(self) -> str:
        """Return the calibration as JSON for `from_json` and for other programs.

        * ``opencv``: camera matrix and distortion coefficients as ``cv2.undistort`` takes them,
          their largest deviation from this model in the image, and rotation and translation of
          each view.
        * ``imagej``: width and height of a pixel, as in `um_per_pixel` at the pattern's origin.
        * ``micro_manager``: pixel size, the root of width times height. Its 95 % interval is in
          ``pixel_size_interval_um``; an infinite upper limit is null.
        * ``calibration``: all fields. Numbers that may be infinite or NaN are texts.

        Returns
        -------
        str
        """
        scope = self.microscope
        center = scope.principal_point + np.array([self._value(f"principal_{c}") for c in "xy"])
        distance = (scope.tube_length + scope.focal_length) / scope.pitch
        terms, worst = self._brown()
        width, *ends = self.um_per_pixel()
        height = width * scope.pitch[1] / scope.pitch[0]
        pixel = np.sqrt(width * height)
        own = {n: v for n, v in vars(self).items() if n != "microscope"}
        own |= {n: np.array(own[n]).astype(str) for n in _NUMBERS}
        content = {
            "opencv": {
                "image_width": scope.image_size[0],
                "image_height": scope.image_size[1],
                "camera_matrix": [
                    [distance[0], 0, center[0]],
                    [0, distance[1], center[1]],
                    [0, 0, 1],
                ],
                "distortion_coefficients": terms,
                "distortion_model_error_px": worst,
                "rotation_vectors": [cv2.Rodrigues(v.rotation)[0].ravel() for v in self.views],
                "translation_vectors_um": [v.translation for v in self.views],
            },
            "micro_manager": {"PixelSizeUm": pixel},
            "imagej": {"unit": "µm", "pixel_width": width, "pixel_height": height},
            "pixel_size_interval_um": [
                pixel / width * end if end < np.inf else None for end in ends
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
            own["views"] = [Microscope(**view) for view in own["views"]]
            own |= {n: tuple(v) for n, v in own.items() if isinstance(v, list)}
            return cls(microscope=own["views"][0], **own)
        except (TypeError, LookupError, ValueError) as fault:
            raise ValueError(f"text must be what to_json wrote, got {str(text)[:40]!r}") from fault

    def _value(self, parameter: str) -> float:
        """The estimate of a parameter, zero if it was not estimated."""
        return dict(zip(self.parameters, self.estimate.tolist(), strict=True)).get(parameter, 0.0)

    def _brown(self) -> tuple[list[float], float]:
        """OpenCV's k₁, k₂, p₁, p₂, k₃ for this model, and their largest deviation from it, px.

        OpenCV's polynomial leads from undistorted to distorted points, with the radius in principal
        distances. The polynomial of this model is its inverse.
        """
        scope = self.microscope
        distance = scope.tube_length + scope.focal_length
        corner = float(np.linalg.norm(scope.pitch * scope.image_size)) / 2
        radius = np.linspace(0, corner)[1:]
        seen = distort(np.column_stack([radius, 0 * radius]), scope.distortion)[:, 0]
        stretch = seen / radius * (1 + self._value("distortion_k2") * seen**4) - 1
        reached = np.isfinite(stretch)
        radius, wanted = radius[reached, None], (stretch * radius)[reached]
        powers = 2 * np.arange(1, 4)
        design = radius * (radius / corner) ** powers
        best = np.linalg.lstsq(design, wanted, rcond=None)[0]
        worst = np.abs(design @ best - wanted).max() / scope.pitch.min()
        k1, k2, k3 = (best * (distance / corner) ** powers).tolist()
        return [k1, k2, 0.0, 0.0, k3], float(worst)
