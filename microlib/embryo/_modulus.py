"""Elastic modulus of a known force, or force of a known modulus, from one image of an indentation.

The steps are those of section 5.6 of the thesis, without marking by hand: outline, dimple, and
point-load model. Lengths are in µm, forces in µN, moduli in MPa.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Tidy, measured, one_of, poisson
from microlib.embryo._boundary import MIN_SIDE, Boundary, extract_boundary
from microlib.embryo._dimple import DimpleFit, check_probe_width, fit_dimple
from microlib.membrane import (
    SmallSlopeWarning,
    capsule_modulus,
    disc_modulus,
    elastic_modulus,
    fit_capsule,
    indentation_force,
    modulus_std,
)

#: Number of standard deviations on either side of a normal 95 % interval.
NORMAL_95 = 1.959964
#: Relative standard deviation of a capsule's modulus from an error that all points of an outline
#: have in common: the fitted middle of the wall's blurred profile is not exactly that of the wall.
#: The errors of 30 rendered capsules whose wall is darker outside than inside are most likely for
#: 0.0045, and nearly as likely for 0.003 to 0.006 (seeds 700 to 729 of
#: benchmarks/capsule_embryo.py).
_OUTLINE_STD = 0.005


@dataclass(frozen=True, eq=False, repr=False)
class ImageEstimate(Tidy):
    """Modulus or force measured in an image, from `modulus_from_image` or `force_from_image`.

    Attributes
    ----------
    force, modulus : float
        Indentation force F, in µN, and elastic modulus E, in MPa. One of the two is given, and the
        other is computed.
    found : {"modulus", "force"}
        Name of the quantity that was computed.
    relative_std : float
        Standard deviation of the logarithm of the computed quantity, from the errors of the
        outline.
    interval : tuple of float
        95 % interval of the computed quantity, from `relative_std`.
    dimple : DimpleFit or CapsuleFit
        Fit of the profile (4.2) with its covariance, or of `microlib.membrane.fit_capsule`.
    boundary : Boundary
        Outline of the embryo.
    given : dict
        thickness and probe_half_width as given, in µm, and poisson_ratio.

    Notes
    -----
    `interval` covers the noise of the outline and the distance of the outline from the fitted
    curve. It does not cover the errors of the given force or modulus, of the thickness or of the
    probe's width, nor the whole bias of a model that does not suit the object. `misfit` measures
    how well the model fits the outline. `model_moduli` and `model_interval` compare other models of
    the same dimple. They are computed at the first access, which takes half a second.
    """

    force: float
    modulus: float
    found: str
    relative_std: float
    interval: tuple[float, float]
    dimple: Any
    boundary: Boundary
    given: dict[str, Any]

    def __repr__(self) -> str:
        return f"ImageEstimate({self._summary}, misfit {self.misfit:.1%} of the dimple's depth)"

    @property
    def _summary(self) -> str:
        (low, high), unit = self.interval, {"force": "µN", "modulus": "MPa"}[self.found]
        value = getattr(self, self.found)
        return f"{self.found} {value:.4g} {unit}, 95 % within {low:.4g} … {high:.4g}"

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

        curve = self.dimple if isinstance(self.dimple, DimpleFit) else None
        return outline(self.boundary.x, self.boundary.y, curve, {}, self._summary, ax)

    @property
    def misfit(self) -> float:
        """Root mean square distance of the outline from the model, divided by the dimple's depth.

        Noise alone gives less than 0.01."""
        if isinstance(self.dimple, DimpleFit):
            return self.dimple.misfit * self.dimple.pixel_size / self.dimple.dimple_depth
        return float(self.dimple.misfit / self.dimple.state.depth)

    @cached_property
    def model_moduli(self) -> dict[str, float]:
        """Modulus of this dimple by each model that can have it, in MPa, by the name of the model.

        The models are the point load (4.7), a flat disc with and without the pressure F/(π a²), and
        a closed capsule. Discs and capsules have a neo-Hookean and a Hookean law. The capsule has
        the fitted radius, or the radius of the outline if both of its ends are steep, and it is
        omitted otherwise. The modulus of (4.7) may be four times that of the capsule, or more
        (benchmarks/capsule_embryo.py).
        """
        lengths = {name: self.given[name] for name in ("thickness", "probe_half_width")}
        nu = self.given["poisson_ratio"]
        if isinstance(self.dimple, DimpleFit):
            dimple = (self.dimple.dimple_radius, self.dimple.dimple_depth)
            radius = _egg_radius(self.boundary, self.dimple.pixel_size)
        else:
            dimple = (self.dimple.state.rim_radius, self.dimple.state.depth)
            radius = self.dimple.radius
        with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
            point_load = elastic_modulus(self.force, *dimple, **lengths, poisson_ratio=nu)
        found = {"point load": float(point_load)}
        for law, ratio in (("neo-hooke", 0.5), ("hooke", nu)):
            settings: dict[str, Any] = {"law": law, "poisson_ratio": ratio, **lengths}
            for suffix, pressure in (("", "balance"), (", no pressure", 0.0)):
                with suppress(ValueError):  # no such disc has this dimple
                    modulus = disc_modulus(self.force, *dimple, pressure=pressure, **settings)
                    found[f"disc, {law}{suffix}"] = modulus
            if radius is not None:
                with suppress(ValueError):  # no such capsule has this dimple
                    capsule = capsule_modulus(self.force, *dimple, radius=radius, **settings)
                    found[f"capsule, {law}"] = capsule.modulus
        return found

    @property
    def model_interval(self) -> tuple[float, float]:
        """Range of the quantity found over all models, widened as `interval` is, in MPa or µN.

        The force of a dimple is proportional to the modulus in every model. A model with half the
        modulus for a given force has therefore twice the force for a given modulus.
        """
        moduli = np.array([self.modulus, *self.model_moduli.values()])
        values = moduli if self.found == "modulus" else self.force * self.modulus / moduli
        return _interval(float(values.min()), float(values.max()), self.relative_std)


def modulus_from_image(
    image: ArrayLike,
    force: float,
    *,
    pixel_size: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    method: str = "membrane",
    direction: str = "auto",
) -> ImageEstimate:
    """Measure the elastic modulus of a chorion in one image of its indentation.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey or color image of an embryo under a probe that enters through one edge of the image.
    force : float
        Force F of the probe, in µN.
    pixel_size : float
        Size of a pixel in the object plane, in µm.
    thickness, probe_half_width, poisson_ratio : float
        Thickness h of the chorion and half-width c of the probe, in µm, and Poisson ratio ν, as for
        `microlib.membrane.elastic_modulus`.
    method : {"membrane", "capsule"}
        ``"membrane"`` fits the profile (4.2) to the dimple (`fit_dimple`) and computes the modulus
        by (5.2). ``"capsule"`` fits the outline of a closed capsule of rubber-like (neo-Hookean)
        material to the whole outline (`microlib.membrane.fit_capsule`). The radius of the capsule
        and the direction of the force are fitted as well. This fit takes several seconds, and the
        outline must contain the widest part of the egg.
    direction : {"auto", "top", "bottom", "left", "right"}
        Edge of the image through which the probe enters; by default it is detected.

    Returns
    -------
    ImageEstimate
        The `modulus` with its `relative_std` and `interval`, the `dimple` and the `boundary`.
        The property `model_moduli` contains the moduli by other models of the same dimple.

    Raises
    ------
    ValueError
        If an argument is out of range, or if `extract_boundary`, `fit_dimple` or
        `microlib.membrane.fit_capsule` rejects the image or its outline.

    Warns
    -----
    SmallSlopeWarning
        If the depth of the dimple exceeds a tenth of its radius: (4.2) and (5.2) assume small
        slopes. Only with "membrane".
    UserWarning
        If the modulus is below 10⁻⁵ MPa or above 2·10⁵ MPa, which wrong units can cause.

    Examples
    --------
    >>> from microlib.embryo import modulus_from_image
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo(modulus=1.2, force=1.2, dimple_radius=240.0)
    >>> scene = embryo_image(embryo, rng=1, shape=(480, 640))
    >>> estimate = modulus_from_image(
    ...     scene.image, 1.2, pixel_size=scene.pixel_size, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5,
    ... )
    >>> estimate.interval[0] < 1.2 < estimate.interval[1], estimate.relative_std < 0.05
    (True, True)
    """
    load = measured("force", force, "µN")
    one_of("method", method, ("membrane", "capsule"))
    size, given = _check_sizes(pixel_size, thickness, probe_half_width, poisson_ratio)
    boundary = extract_boundary(image, direction=direction)
    if method == "membrane":
        return _point_load_estimate("modulus", load, boundary, size, given)
    check_probe_width(boundary, given["probe_half_width"] / size, size)
    points = size * _points_along_probe(boundary)
    capsule = fit_capsule(load, points, fit_tilt=True, **given)
    std = float(np.hypot(capsule.modulus_std / capsule.modulus, _OUTLINE_STD))
    return ImageEstimate(
        force=load,
        modulus=capsule.modulus,
        found="modulus",
        relative_std=std,
        interval=_interval(capsule.modulus, capsule.modulus, std),
        dimple=capsule,
        boundary=boundary,
        given=given,
    )


def force_from_image(
    image: ArrayLike,
    modulus: float,
    *,
    pixel_size: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    direction: str = "auto",
) -> ImageEstimate:
    """Measure the force on an embryo of known modulus in one image, without a force sensor.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        As for `modulus_from_image`.
    modulus : float
        Elastic modulus E, in MPa.
    pixel_size, thickness, probe_half_width, poisson_ratio, direction
        As for `modulus_from_image`.

    Returns
    -------
    ImageEstimate
        The `force` with its `relative_std` and `interval`, the `dimple` and the `boundary`.
        `model_moduli` contains the moduli of other models.

    Raises
    ------
    ValueError
        As for `modulus_from_image`.

    Warns
    -----
    SmallSlopeWarning
        As for `modulus_from_image`.

    Examples
    --------
    >>> from microlib.embryo import force_from_image
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo(modulus=1.2, force=1.2, dimple_radius=240.0)
    >>> scene = embryo_image(embryo, rng=1, shape=(480, 640))
    >>> estimate = force_from_image(
    ...     scene.image, 1.2, pixel_size=scene.pixel_size, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5,
    ... )
    >>> estimate.interval[0] < 1.2 < estimate.interval[1]
    True
    """
    stiffness = measured("modulus", modulus, "MPa")
    size, given = _check_sizes(pixel_size, thickness, probe_half_width, poisson_ratio)
    boundary = extract_boundary(image, direction=direction)
    return _point_load_estimate("force", stiffness, boundary, size, given)


def _check_sizes(
    pixel_size: float, thickness: float, probe_half_width: float, poisson_ratio: float
) -> tuple[float, dict[str, Any]]:
    """Return the checked size of a pixel, and the other sizes by name."""
    return measured("pixel_size", pixel_size, "µm/px"), {
        "thickness": measured("thickness", thickness, "µm"),
        "probe_half_width": measured("probe_half_width", probe_half_width, "µm"),
        "poisson_ratio": poisson(poisson_ratio),
    }


def _point_load_estimate(
    found: str, known: float, boundary: Boundary, size: float, given: dict[str, Any]
) -> ImageEstimate:
    """Return the modulus of a known force, or the force of a known modulus, by (4.7)."""
    half_width = given["probe_half_width"]
    try:
        dimple = fit_dimple(boundary, pixel_size=size, probe_half_width=half_width)
    except ValueError as error:
        raise ValueError(
            "image must show a dimple of the model for this pixel_size and probe_half_width: "
            f"{error}"
        ) from None
    sizes = {"dimple_radius": dimple.dimple_radius, "dimple_depth": dimple.dimple_depth}
    inputs = given | sizes
    value = float((elastic_modulus if found == "modulus" else indentation_force)(known, **inputs))
    force, modulus = (known, value) if found == "modulus" else (value, known)
    # E is F times a function of the dimple, so that ln E and ln F have the same error.
    std = modulus_std({"force": force, **inputs}, {}, dimple_covariance=dimple.covariance) / modulus
    return ImageEstimate(
        force=force,
        modulus=modulus,
        found=found,
        relative_std=std,
        interval=_interval(value, value, std),
        dimple=dimple,
        boundary=boundary,
        given=given,
    )


def _interval(least: float, largest: float, std: float) -> tuple[float, float]:
    """Return a range widened by the 95 % interval of a logarithm of this standard deviation."""
    factor = float(np.exp(NORMAL_95 * std))
    return least / factor, largest * factor


def _points_along_probe(boundary: Boundary) -> Array:
    """Return the visible outline across and along the probe, from its end, (n, 2) px."""
    probe, visible = boundary.probe, ~boundary.under_probe
    right = boundary.x[visible] - probe.tip[0]
    up = boundary.y[visible] - (boundary.image_height - 1 - probe.tip[1])
    rotated = np.stack([right + probe.slope * up, up - probe.slope * right], axis=1)
    return rotated / np.hypot(1.0, probe.slope)


def _egg_radius(boundary: Boundary, pixel_size: float) -> float | None:
    """Return the radius of the sphere with the ends of the outline, µm, or None if they are flat.

    The radius of a pressed capsule is nearly that of the sphere: its equator grows by at most 2 %,
    which is less than the uncertainty of the directions of the ends.
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
