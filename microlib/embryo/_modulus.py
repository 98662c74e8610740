"""From one image and one number to another: force to modulus, or modulus to force.

The whole chain of the thesis' section 5.6, without a hand: outline, dimple, point-load model.
Lengths are in µm, forces in µN, moduli in MPa.
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
from microlib.embryo._boundary import SHORTEST_SIDE, Boundary, extract_boundary
from microlib.embryo._dimple import DimpleFit, fit_dimple, refuse_another_width
from microlib.membrane import (
    SmallSlopeWarning,
    capsule_modulus,
    disc_modulus,
    elastic_modulus,
    fit_capsule,
    indentation_force,
    modulus_std,
)

#: Standard deviations to either side that hold 95 % of a normal distribution.
NORMAL_95 = 1.959964
#: Part of a capsule's relative deviation that the points do not scatter by: the middle of a wall's
#: blurred profile is not quite that of the wall, alike at all points. Of the errors of 30 rendered
#: capsules, whose wall is darker outside than inside, 0.0045 is the most likely, and 0.003 to 0.006
#: are nearly as much (seeds 700 to 729 of benchmarks/capsule_embryo.py).
_OUTLINE_STD = 0.005


@dataclass(frozen=True, eq=False, repr=False)
class ImageEstimate(Tidy):
    """A modulus or a force read off an image, by `modulus_from_image` or `force_from_image`.

    Attributes
    ----------
    force, modulus : float
        Indentation force F, in µN, and elastic modulus E, in MPa: one as given, the other as found.
    found : {"modulus", "force"}
        Which of the two was found.
    relative_std : float
        Standard deviation of its logarithm that the image leaves open. Errors of the other, of the
        thickness and of the probe's width come on top.
    interval : tuple of float
        95 % interval of what was found, from `relative_std`.
    dimple : DimpleFit or CapsuleFit
        Radius and depth with their covariance, or the capsule of `microlib.membrane.fit_capsule`.
    boundary : Boundary
        The outline that was found.
    given : dict
        thickness and probe_half_width as given, in µm, and poisson_ratio.

    Notes
    -----
    `interval` says how well the outline is known, as if the model were right; `misfit` whether the
    outline looks like the model at all, which widens `interval` where it does not. `model_moduli`
    and `model_interval` say what other models make of the same dimple. They are computed when they
    are asked for, which takes half a second.
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
        return f"ImageEstimate({self._said}, misfit {self.misfit:.1%} of the dimple's depth)"

    @property
    def _said(self) -> str:
        (low, high), unit = self.interval, {"force": "µN", "modulus": "MPa"}[self.found]
        value = getattr(self, self.found)
        return f"{self.found} {value:.4g} {unit}, 95 % within {low:.4g} … {high:.4g}"

    def plot(self, ax: Any = None) -> Any:
        """Draw the outline, and the dimple that was fitted to it, by Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw; by default in a new figure.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from microlib._plots import outline

        curve = self.dimple if isinstance(self.dimple, DimpleFit) else None
        return outline(self.boundary.x, self.boundary.y, curve, {}, self._said, ax)

    @property
    def misfit(self) -> float:
        """Root mean square departure of the outline from the model, as a share of the dimple's
        depth. Noise leaves less than 0.01."""
        if isinstance(self.dimple, DimpleFit):
            return self.dimple.misfit * self.dimple.pixel_size / self.dimple.dimple_depth
        return float(self.dimple.misfit / self.dimple.state.depth)

    @cached_property
    def model_moduli(self) -> dict[str, float]:
        """Modulus of this dimple by each model that can have it, in MPa, by the model's name.

        (4.7) with its uniform stress; a flat disc with and without the pressure F/(π a²), and a
        capsule, each for neo-Hooke and Hooke. The capsule's radius is the one that was fitted, or
        that of the outline where both of its ends fall steeply enough; without one no capsule is
        among them, and an egg that is one may have a quarter of the modulus by
        (4.7), or less (benchmarks/capsule_embryo.py).
        """
        sizes = dict(self.given)
        nu = sizes.pop("poisson_ratio")
        state = getattr(self.dimple, "state", None)  # of a capsule
        if state is not None:
            radius, dimple = self.dimple.radius, (state.rim_radius, state.depth)
        else:
            dimple = (self.dimple.dimple_radius, self.dimple.dimple_depth)
            radius = _egg_radius(self.boundary, self.dimple.pixel_size)
        with warnings.catch_warnings():
            # Whoever compares the models sees that this one takes its slopes for small.
            warnings.simplefilter("ignore", SmallSlopeWarning)
            formula = elastic_modulus(self.force, *dimple, **sizes, poisson_ratio=nu)
        found = {"point load": float(formula)}
        for law, ratio in (("neo-hooke", 0.5), ("hooke", nu)):
            settings: dict[str, Any] = {"law": law, "poisson_ratio": ratio, **sizes}
            for end, pressure in (("", "balance"), (", no pressure", 0.0)):
                with suppress(ValueError):  # no such disc has this dimple
                    modulus = disc_modulus(self.force, *dimple, pressure=pressure, **settings)
                    found[f"disc, {law}{end}"] = modulus
            if radius is not None:
                with suppress(ValueError):  # nor has a capsule
                    capsule = capsule_modulus(self.force, *dimple, radius=radius, **settings)
                    found[f"capsule, {law}"] = capsule.modulus
        return found

    @property
    def model_interval(self) -> tuple[float, float]:
        """From the least to the largest by any model, widened as `interval` is, in MPa or µN.

        The modulus is the only stress that is given, so that in every model the force of a dimple
        grows with it: a model by which the egg would be half as stiff has twice the force.
        """
        moduli = np.array([self.modulus, *self.model_moduli.values()])
        values = moduli if self.found == "modulus" else self.force * self.modulus / moduli
        return _around(float(values.min()), float(values.max()), self.relative_std)


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
        Grey or color image; the probe comes from one of its edges onto the embryo.
    force : float
        Force F of the probe, in µN.
    pixel_size : float
        Pixel in the object plane, in µm.
    thickness, probe_half_width, poisson_ratio : float
        As for `microlib.membrane.elastic_modulus`.
    method : {"membrane", "capsule"}
        ``"membrane"`` fits the profile (4.2) to the dimple, see `microlib.embryo.fit_dimple`, and
        takes the modulus of (4.7). ``"capsule"`` fits a closed neo-Hookean capsule to the whole
        outline, and its direction and radius, see `microlib.membrane.fit_capsule`; it takes seconds
        and needs an outline that reaches the egg's widest part.
    direction
        Edge that the probe comes from; see `microlib.embryo.extract_boundary`.

    Returns
    -------
    ImageEstimate
        The `modulus`, its `relative_std` and `interval`, and the `dimple` and `boundary` that it
        was computed from; with the `misfit` of outline and model, and what other models make of the
        same dimple in `model_moduli` and `model_interval`.

    Raises
    ------
    ValueError
        If an argument is out of range or the image does not show what is needed; see
        `microlib.embryo.extract_boundary` and `microlib.embryo.fit_dimple`.

    Warns
    -----
    SmallSlopeWarning
        If the dimple is too steep for the point-load model, whose formula is used all the same.
    UserWarning
        If the modulus is that of no membrane, as `microlib.membrane.elastic_modulus` does.

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
    size = measured("pixel_size", pixel_size, "µm/px")
    given = _given_lengths(thickness, probe_half_width, poisson_ratio)
    boundary = extract_boundary(image, direction=direction)
    if method != "capsule":
        return _estimate("modulus", load, boundary, size, given)
    refuse_another_width(boundary, given["probe_half_width"] / size, size)
    points = size * _seen_from_the_probe(boundary)
    capsule = fit_capsule(load, points, fit_tilt=True, **given)
    std, found = np.hypot(capsule.modulus_std / capsule.modulus, _OUTLINE_STD), capsule.modulus
    around = _around(found, found, float(std))
    return ImageEstimate(load, found, "modulus", float(std), around, capsule, boundary, given)


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
        The `force`, its `relative_std` and `interval`, and the `dimple` and `boundary` that it was
        computed from; with what other models make of the same dimple in `model_interval`.

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
    size = measured("pixel_size", pixel_size, "µm/px")
    given = _given_lengths(thickness, probe_half_width, poisson_ratio)
    boundary = extract_boundary(image, direction=direction)
    return _estimate("force", stiffness, boundary, size, given)


def _given_lengths(
    thickness: float, probe_half_width: float, poisson_ratio: float
) -> dict[str, Any]:
    return {
        "thickness": measured("thickness", thickness, "µm"),
        "probe_half_width": measured("probe_half_width", probe_half_width, "µm"),
        "poisson_ratio": poisson(poisson_ratio),
    }


def _estimate(
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
    # E is F times a function of the dimple, whose error moves ln E and ln F by as much.
    force, modulus = (known, value) if found == "modulus" else (value, known)
    std = modulus_std({"force": force, **inputs}, {}, dimple_covariance=dimple.covariance) / modulus
    around = _around(value, value, std)
    return ImageEstimate(force, modulus, found, std, around, dimple, boundary, given)


def _around(least: float, largest: float, std: float) -> tuple[float, float]:
    """Return an interval of a positive quantity, widened by 95 % of its logarithm's deviation."""
    factor = float(np.exp(NORMAL_95 * std))
    return least / factor, largest * factor


def _seen_from_the_probe(boundary: Boundary) -> Array:
    """Return the outline's points in px across and up along the probe, from its end, (n, 2)."""
    probe, seen = boundary.probe, ~boundary.under_probe
    right = boundary.x[seen] - probe.tip[0]
    up = boundary.y[seen] - (boundary.image_height - 1 - probe.tip[1])
    long = np.hypot(1.0, probe.slope)
    return np.stack([right + probe.slope * up, up - probe.slope * right], axis=1) / long


def _egg_radius(boundary: Boundary, pixel_size: float) -> float | None:
    """Return the radius in µm of the sphere that has the outline's ends, or None if they are flat.

    A pressed capsule is about as wide as the sphere was: its equator grows by 2 % under the largest
    loads, and less than its wall's turn to the vertical is uncertain.
    """
    points = np.stack([boundary.x, boundary.y])
    ends = np.stack([points[:, :SHORTEST_SIDE], points[:, -SHORTEST_SIDE:]])
    middle = ends.mean(axis=-1, keepdims=True)
    # The sine of their direction, which is that of most of their extent.
    fall = np.abs(np.linalg.svd(ends - middle, full_matrices=False)[0][:, 1, 0])
    # Of 60°, at which a degree is 1 % of the radius.
    if fall.min() < np.sqrt(3 / 4):
        return None
    return pixel_size * float(np.ptp(middle[:, 0]) / fall.sum())
