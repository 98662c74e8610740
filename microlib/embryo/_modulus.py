"""Elastic modulus of a chorion from one image of its indentation by a known force.

The steps are those of section 5.6 of the thesis, without marking by hand: outline, dimple, and
point-load model. Lengths are in µm, forces in µN, moduli in MPa.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import FlatResult, as_physical, as_poisson_ratio
from microlib.embryo._boundary import MIN_SIDE, Boundary, extract_boundary
from microlib.embryo._dimple import DimpleFit, fit_dimple
from microlib.estimate import Estimate
from microlib.membrane import elastic_modulus, model_moduli, modulus_uncertainty

#: Number of standard deviations on either side of a normal 95 % interval.
_NORMAL_95 = 1.959964


@dataclass(frozen=True, eq=False, repr=False)
class ImageEstimate(FlatResult):
    """Modulus measured in an image, from `modulus_from_image`.

    Attributes
    ----------
    modulus : Estimate
        Elastic modulus E by (5.2), in MPa. Its uncertainty and its interval follow from the errors
        of the outline, and hold for this model only.
    force : float
        Indentation force F as given, in µN.
    dimple : DimpleFit
        Fit of the profile (4.2) with its covariance.
    boundary : Boundary
        Outline of the embryo.
    given : dict
        thickness and probe_half_width as given, in µm, and poisson_ratio.

    Notes
    -----
    The interval of `modulus` covers the noise of the outline, the distance of the outline from the
    fitted curve, and the distance of the probe's end from the fitted bottom. It does not cover the
    errors of the given force, of the thickness or of the probe's width, nor the bias of the model:
    a clamped disc, whose stress is not uniform, has 0.4 to 1.0 of the modulus of (5.2), depending
    on the pressure, the depth and the law. `model_moduli` and `model_interval` compare the models,
    and `repr` states the range over them. They are computed at the first access, which takes half
    a second. `relative_rms` measures how well the profile (4.2) fits the outline. The :ref:`table
    of models <which-model>` says which model suits which dimple.
    """

    modulus: Estimate
    force: float
    dimple: DimpleFit
    boundary: Boundary
    given: dict[str, Any]

    def __repr__(self) -> str:
        return f"ImageEstimate({self._headline}, rms {self.relative_rms:.1%} of the depth)"

    @property
    def _headline(self) -> str:
        low, high = self.model_interval
        models = f"{len(self.model_moduli)} models"
        return f"E = {low:.2g} to {high:.2g} MPa over {models}, by (5.2) {self.modulus}"

    def plot(self, ax: Any = None) -> Any:
        """Draw the outline and the fitted dimple with Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw in, by default those of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from microlib._plots import outline

        title = self._headline.replace(", by", ",\nby")
        return outline(self.boundary.x, self.boundary.y, self.dimple.curve, {}, title, ax)

    @property
    def relative_rms(self) -> float:
        """Root mean square distance of the outline from the model, divided by the dimple's depth.

        Noise alone gives less than 0.01."""
        return self.dimple.rms_px * self.dimple.pixel_size / self.dimple.dimple_depth

    @cached_property
    def model_moduli(self) -> dict[str, float]:
        """Modulus of this dimple by each model with a solution, in MPa, by the name of the model.

        The models are those of `microlib.membrane.model_moduli`. The capsule has the radius of the
        outline if both of its ends are steep, and it is omitted otherwise. The modulus of (5.2) may
        be four times that of the capsule, or more (benchmarks/capsule_embryo.py).
        """
        radius = _egg_radius(self.boundary, self.dimple.pixel_size)
        dimple = (self.dimple.rim_radius, self.dimple.dimple_depth)
        return model_moduli(self.force, *dimple, **self.given, capsule_radius=radius)

    @property
    def model_interval(self) -> tuple[float, float]:
        """Range of the modulus over all models, in MPa, with the interval of each.

        The relative interval of each model is that of `modulus`.
        """
        moduli, by_outline = self.model_moduli.values(), self.modulus
        low, high = np.divide(by_outline.interval, by_outline.value).tolist()
        return min(moduli) * low, max(moduli) * high


def modulus_from_image(
    image: ArrayLike,
    force: float,
    *,
    pixel_size: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    direction: str = "auto",
) -> ImageEstimate:
    """Compute the elastic modulus of the shell (chorion) of an egg from one image of its dimple.

    The function fits the profile (4.2) to the dimple (`fit_dimple`) and computes the modulus by
    (5.2).

    The interval of this modulus covers only the errors of the outline. The interval does not cover
    the errors of the force, the thickness and the width of the probe. It does not cover the choice
    of the model either, which is often the largest uncertainty: (5.2) assumes a uniform stress and
    small slopes. Use `model_interval` of the result unless you know that (5.2) describes your
    dimple.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey or color image of the egg under a probe that enters through one edge of the image.
    force : float
        Force F of the probe, in µN.
    pixel_size : float
        Size of a pixel in the object plane, in µm.
    thickness, probe_half_width, poisson_ratio : float
        Thickness h of the chorion and half-width c of the probe, in µm, and Poisson ratio ν, as for
        `microlib.membrane.elastic_modulus`.
    direction : {"auto", "top", "bottom", "left", "right"}
        Edge of the image through which the probe enters; by default it is detected.

    Returns
    -------
    ImageEstimate
        The `modulus` with its uncertainty and interval, the `dimple` and the `boundary`.
        `model_moduli` contains the modulus by each model that has a solution, and `model_interval`
        the range of these moduli with their intervals.

    Raises
    ------
    ValueError
        If an argument is out of range, or if `extract_boundary` or `fit_dimple` rejects the image
        or its outline.

    Warns
    -----
    SmallSlopeWarning
        If the depth of the dimple exceeds a tenth of its radius, because (4.2) and (5.2) assume
        small slopes. See `model_moduli` of the result for models without this assumption.
    UserWarning
        If the modulus is below 10⁻⁵ MPa or above 2·10⁵ MPa, which wrong units can cause.

    Examples
    --------
    >>> from microlib.embryo import modulus_from_image
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo(modulus=1.2, force=1.2, rim_radius=240.0)
    >>> scene = embryo_image(embryo, rng=1, shape=(480, 640))
    >>> estimate = modulus_from_image(
    ...     scene.image, 1.2, pixel_size=scene.pixel_size, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5,
    ... )
    >>> estimate.modulus.low < 1.2 < estimate.modulus.high, estimate.modulus.uncertainty < 0.06
    (True, True)
    """
    load, size = as_physical("force", force), as_physical("pixel_size", pixel_size)
    given = {
        "thickness": as_physical("thickness", thickness),
        "probe_half_width": as_physical("probe_half_width", probe_half_width),
        "poisson_ratio": as_poisson_ratio(poisson_ratio),
    }
    boundary = extract_boundary(image, direction=direction)
    try:
        dimple = fit_dimple(boundary, pixel_size=size, probe_half_width=given["probe_half_width"])
    except ValueError as error:
        raise ValueError(
            "image must show a dimple of the model for this pixel_size and probe_half_width: "
            f"{error}"
        ) from None
    sizes = {"rim_radius": dimple.rim_radius, "dimple_depth": dimple.dimple_depth}
    inputs = {"force": load, **sizes, **given}
    modulus = float(elastic_modulus(**inputs))
    uncertainty = modulus_uncertainty(inputs, {}, dimple_covariance=dimple.covariance)
    # The error of a product of powers is nearly log-normal.
    factor = float(np.exp(_NORMAL_95 * uncertainty / modulus))
    return ImageEstimate(
        modulus=Estimate(modulus, uncertainty, modulus / factor, modulus * factor, "MPa"),
        force=load,
        dimple=dimple,
        boundary=boundary,
        given=given,
    )


def _egg_radius(boundary: Boundary, pixel_size: float) -> float | None:
    """Return the radius, µm, of the sphere with the slopes and the distance of the outline's ends.

    It is None if the ends are flat. The radius of a pressed capsule is nearly that of the sphere:
    its equator grows by at most 2 %, which is less than the uncertainty of the directions of the
    ends.
    """
    points = np.stack([boundary.x, boundary.y])
    ends = np.stack([points[:, :MIN_SIDE], points[:, -MIN_SIDE:]])
    middle = ends.mean(axis=-1, keepdims=True)
    # The sine of the direction of each end, which is its first principal axis.
    sine = np.abs(np.linalg.svd(ends - middle, full_matrices=False)[0][:, 1, 0])
    # At 60°, an error of one degree changes the radius by 1 %.
    if sine.min() < np.sqrt(3 / 4):
        return None
    return pixel_size * float(np.ptp(middle[:, 0]) / sine.sum())
