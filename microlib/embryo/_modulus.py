"""From one image and one number to another: force to modulus, or modulus to force.

The whole chain of the thesis' section 5.6, without a hand: outline, dimple, point-load model.
Lengths are in µm, forces in µN, moduli in MPa.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Tidy, of_kind, one_of, scalar
from microlib.embryo._boundary import Boundary, extract_boundary
from microlib.embryo._dimple import (
    DimpleFit,
    DimpleGeometry,
    dimple_geometry,
    fit_dimple,
    refuse_another_width,
)
from microlib.embryo._gaussian_sum import fit_gaussians
from microlib.embryo._loess import loess
from microlib.embryo._models import moduli_by_model
from microlib.membrane import (
    elastic_modulus,
    fit_capsule,
    indentation_force,
    modulus_std,
)

_LAWS = ("hooke", "neo-hooke", "mooney-rivlin")
_METHODS = ("membrane", "gaussians")
#: Standard deviations to either side that hold 95 % of a normal distribution.
NORMAL_95 = 1.959964
#: Dimple radii to either side that the Gaussians describe, a choice that the thesis leaves open:
#: 1.6 and 2.5 change E by up to 12 and 27 % (benchmarks/embryo.py).
_CROP = 2.0
#: Part of a capsule's relative deviation that the points do not scatter by: the middle of a wall's
#: blurred profile is not quite that of the wall, alike at all points. Of the errors of 30 rendered
#: capsules, whose wall is darker outside than inside, 0.0045 is the most likely, and 0.003 to 0.006
#: are nearly as much (seeds 700 to 729 of benchmarks/capsule_embryo.py).
_OUTLINE_STD = 0.005
#: Points of an outline's end that give its direction, and the sine of its fall from which the egg's
#: radius is read off: at 60° a degree is 1 % of it.
_END_POINTS, _STEEP_END = 15, 0.87
#: Of section 5.6.
_SPAN, _TERMS = 0.25, 8
#: Of any force, modulus or length, in µN, MPa and µm: beyond, products leave the range of numbers.
_MOST = 1e12


@dataclass(frozen=True)
class ModulusEstimate(Tidy):
    """A modulus read off an image.

    Attributes
    ----------
    modulus : float
        Elastic modulus E, in MPa.
    relative_std : float
        Standard deviation of ln E that the image leaves open. Errors of the force, the thickness
        and the probe's width come on top.
    interval : tuple of float
        95 % interval of E from `relative_std`, in MPa.
    dimple : DimpleFit, DimpleGeometry or CapsuleFit
        Radius and depth with their covariance, or the capsule of `microlib.membrane.fit_capsule`.
    boundary : Boundary
        The outline that was found.
    given : dict
        Force, thickness, probe_half_width, poisson_ratio and radius as given, in µN and µm.

    Notes
    -----
    `interval` says how well the outline is known, as if the model were right; `misfit` whether the
    outline looks like the model at all, which widens `interval` where it does not. `model_moduli`
    and `model_interval` say what other models make of the same dimple. They are computed when they
    are asked for, which takes about a second.
    """

    modulus: float
    relative_std: float
    interval: tuple[float, float]
    dimple: Any
    boundary: Boundary
    given: dict[str, Any]

    @property
    def misfit(self) -> float:
        """Root mean square departure of the outline from the model, as a share of the dimple's
        depth; NaN for Gaussians, which follow any outline. Noise leaves less than 0.01."""
        if isinstance(self.dimple, DimpleGeometry):
            return float("nan")
        if isinstance(self.dimple, DimpleFit):
            return self.dimple.misfit * self.dimple.pixel_size / self.dimple.dimple_depth
        return float(self.dimple.misfit / self.dimple.state.depth)

    @cached_property
    def model_moduli(self) -> dict[str, float]:
        """Modulus of this dimple by each model that can have it, in MPa, by the model's name.

        (4.7) with its uniform stress; a flat disc with and without the pressure F/(π a²), and a
        capsule, each for neo-Hooke and Hooke. The capsule's radius is the one that was given or
        fitted, or else the outline's where both of its ends fall steeply enough to tell; without
        one no capsule is among them, and an egg that is one may have a quarter of the modulus by
        (4.7), or less (benchmarks/capsule_embryo.py).
        """
        return _moduli_of(self.dimple, self.boundary, self.given)

    @property
    def model_interval(self) -> tuple[float, float]:
        """From the least of `model_moduli` to the largest, widened as `interval` is, in MPa."""
        return _around([self.modulus, *self.model_moduli.values()], self.relative_std)


@dataclass(frozen=True)
class ForceEstimate(Tidy):
    """A force read off an image.

    Attributes
    ----------
    force : float
        Indentation force F, in µN.
    relative_std : float
        Standard deviation of ln F that the image leaves open. An error of the modulus comes on top.
    interval : tuple of float
        95 % interval of F from `relative_std`, in µN.
    dimple : DimpleFit
        Radius and depth with their covariance.
    boundary : Boundary
        The outline that was found.
    given : dict
        Modulus, thickness, probe_half_width, poisson_ratio and radius as given, in MPa and µm.

    Notes
    -----
    `interval` says how well the outline is known, as if (4.7) were right; `model_forces` and
    `model_interval` what other models make of the same dimple, as those of a `ModulusEstimate`.
    """

    force: float
    relative_std: float
    interval: tuple[float, float]
    dimple: DimpleFit
    boundary: Boundary
    given: dict[str, Any]

    @cached_property
    def model_forces(self) -> dict[str, float]:
        """Force on this dimple by each model that can have it, in µN, by the model's name.

        The modulus is the only stress that is given, so that in every model the force of a dimple
        grows with it: a model by which the egg would be half as stiff has twice the force.
        """
        settings = {name: value for name, value in self.given.items() if name != "modulus"}
        moduli = _moduli_of(self.dimple, self.boundary, {"force": self.force, **settings})
        modulus = self.given["modulus"]
        return {name: self.force * modulus / found for name, found in moduli.items()}

    @property
    def model_interval(self) -> tuple[float, float]:
        """From the least of `model_forces` to the largest, widened as `interval` is, in µN."""
        return _around([self.force, *self.model_forces.values()], self.relative_std)


def modulus_from_image(
    image: ArrayLike,
    force: float,
    *,
    pixel_size: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    method: str = "membrane",
    radius: float | None = None,
    law: str = "neo-hooke",
    direction: str = "auto",
    region: tuple[int, int, int, int] | None = None,
) -> ModulusEstimate:
    """Measure the elastic modulus of a chorion in one image of its indentation.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey image; the probe comes upright to one of its edges onto the embryo.
    force : float
        Force F of the probe, in µN.
    pixel_size : float
        Pixel in the object plane, in µm.
    thickness, probe_half_width, poisson_ratio : float
        As for `microlib.membrane.elastic_modulus`.
    method : {"membrane", "gaussians", "capsule"}
        How the dimple is measured, see `measure_dimple`; ``"capsule"`` fits a closed capsule to the
        whole outline, and its direction, see `microlib.membrane.fit_capsule`; it takes seconds.
    radius : float, optional
        Radius of the egg before the test, in µm. A capsule needs none where the outline reaches the
        egg's widest part: it is then fitted, which also takes up an outline that is off by a
        fraction of the wall's thickness (half a µm would be 2 % of the modulus).
    law : {"neo-hooke", "hooke", "mooney-rivlin"}
        Of a capsule's wall.
    direction, region
        Edge that the probe comes from, and part of the image to look at; see
        `microlib.embryo.extract_boundary`.

    Returns
    -------
    ModulusEstimate
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

    Examples
    --------
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo(modulus=1.2, force=1.2, dimple_radius=240.0)
    >>> scene = embryo_image(embryo, rng=np.random.default_rng(1))
    >>> estimate = modulus_from_image(
    ...     scene.image, 1.2, pixel_size=scene.pixel_size, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5,
    ... )
    >>> estimate.interval[0] < 1.2 < estimate.interval[1], estimate.relative_std < 0.05
    (True, True)
    """
    load = scalar("force", force, above=0, most=_MOST)
    one_of("method", method, (*_METHODS, "capsule"))
    one_of("law", law, _LAWS)
    size = scalar("pixel_size", pixel_size, above=0, most=_MOST)
    membrane = _membrane(thickness, probe_half_width, poisson_ratio)
    egg = None if radius is None else scalar("radius", radius, above=0, most=_MOST)
    given = {"force": load, **membrane, "radius": egg}
    boundary = extract_boundary(image, direction=direction, region=region)
    if method == "capsule":
        refuse_another_width(boundary, membrane["probe_half_width"] / size, size)
        capsule = fit_capsule(
            load,
            size * _seen_from_the_probe(boundary),
            thickness=thickness,
            probe_half_width=probe_half_width,
            radius=egg,
            poisson_ratio=poisson_ratio,
            law=law,
            fit_tilt=True,
        )
        std = float(np.hypot(capsule.modulus_std / capsule.modulus, _OUTLINE_STD))
        return ModulusEstimate(
            capsule.modulus, std, _interval(capsule.modulus, std), capsule, boundary, given
        )
    dimple = _dimple_of(boundary, size, membrane["probe_half_width"], method)
    return ModulusEstimate(
        *_apply(elastic_modulus, load, dimple, membrane), dimple, boundary, given
    )


def force_from_image(
    image: ArrayLike,
    modulus: float,
    *,
    pixel_size: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    radius: float | None = None,
    direction: str = "auto",
    region: tuple[int, int, int, int] | None = None,
) -> ForceEstimate:
    """Measure the force on an embryo of known modulus in one image, without a force sensor.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        As for `modulus_from_image`.
    modulus : float
        Elastic modulus E, in MPa.
    pixel_size, thickness, probe_half_width, poisson_ratio, direction, region
        As for `modulus_from_image`.
    radius : float, optional
        Radius of the egg before the test, in µm: for the capsule among the `model_forces`. Without
        it the outline's ends tell it where they fall steeply enough.

    Returns
    -------
    ForceEstimate
        The `force`, its `relative_std` and `interval`, and the `dimple` and `boundary` that it was
        computed from; with what other models make of the same dimple in `model_forces` and
        `model_interval`.

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
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> embryo = Embryo(modulus=1.2, force=1.2, dimple_radius=240.0)
    >>> scene = embryo_image(embryo, rng=np.random.default_rng(1))
    >>> estimate = force_from_image(
    ...     scene.image, 1.2, pixel_size=scene.pixel_size, thickness=3.0, probe_half_width=25.0,
    ...     poisson_ratio=0.5,
    ... )
    >>> estimate.interval[0] < 1.2 < estimate.interval[1]
    True
    """
    stiffness = scalar("modulus", modulus, above=0, most=_MOST)
    size = scalar("pixel_size", pixel_size, above=0, most=_MOST)
    membrane = _membrane(thickness, probe_half_width, poisson_ratio)
    egg = None if radius is None else scalar("radius", radius, above=0, most=_MOST)
    boundary = extract_boundary(image, direction=direction, region=region)
    dimple = _dimple_of(boundary, size, membrane["probe_half_width"], "membrane")
    assert isinstance(dimple, DimpleFit)
    given = {"modulus": stiffness, **membrane, "radius": egg}
    found = _apply(indentation_force, stiffness, dimple, membrane)
    return ForceEstimate(*found, dimple, boundary, given)


def measure_dimple(
    boundary: Boundary, *, pixel_size: float, probe_half_width: float, method: str = "membrane"
) -> DimpleFit | DimpleGeometry:
    """Measure the dimple of an outline by the membrane's profile or as the thesis does.

    Parameters
    ----------
    boundary : Boundary
        Outline from `microlib.embryo.extract_boundary`.
    pixel_size, probe_half_width : float
        In µm.
    method : {"membrane", "gaussians"}
        ``"membrane"`` fits (4.2), see `microlib.embryo.fit_dimple`. ``"gaussians"`` is the chain of
        section 5.6: LOESS of the second degree with a span of 0.25, eight Gaussians (5.1), and
        their extrema (5.3).

    Returns
    -------
    DimpleFit or DimpleGeometry
        Radius and depth with their covariance.

    Raises
    ------
    ValueError
        If `method` is unknown, or as for `microlib.embryo.fit_dimple` and
        `microlib.embryo.dimple_geometry`.

    Notes
    -----
    The thesis' chain is biased, by an amount that depends on the shape of the dimple: smoothing
    fills the corner at its bottom and moves the flat rim. Its covariance covers random errors only.
    """
    one_of("method", method, _METHODS)
    if method == "membrane":
        return fit_dimple(boundary, pixel_size=pixel_size, probe_half_width=probe_half_width)
    of_kind("boundary", boundary, Boundary)
    scalar("probe_half_width", probe_half_width, above=0, most=_MOST)
    x, y = _crop(boundary)
    # Gaussians die away to zero, so the outline is measured from its own lowest point.
    curve = fit_gaussians(x, loess(x, y - y.min(), span=_SPAN), terms=_TERMS)
    return dimple_geometry(curve, pixel_size=pixel_size)


def _membrane(thickness: float, probe_half_width: float, poisson_ratio: float) -> dict[str, float]:
    return {
        "thickness": scalar("thickness", thickness, above=0, most=_MOST),
        "probe_half_width": scalar("probe_half_width", probe_half_width, above=0, most=_MOST),
        "poisson_ratio": scalar("poisson_ratio", poisson_ratio, within=(-1.0, 1.0)),
    }


def _dimple_of(
    boundary: Boundary, pixel_size: float, probe_half_width: float, method: str
) -> DimpleFit | DimpleGeometry:
    """Measure the dimple of an image, and name the image if it does not fit the lengths."""
    try:
        return measure_dimple(
            boundary, pixel_size=pixel_size, probe_half_width=probe_half_width, method=method
        )
    except ValueError as error:
        raise ValueError(
            "image must show a dimple of the model for this pixel_size and probe_half_width: "
            f"{error}"
        ) from None


def _moduli_of(dimple: Any, boundary: Boundary, given: dict[str, Any]) -> dict[str, float]:
    """Modulus of a dimple by each model that can have it; `given` is the force and the lengths."""
    state = getattr(dimple, "state", None)  # of a capsule
    if state is not None:
        fitted = given | {"radius": dimple.radius}
        return moduli_by_model(rim_radius=state.rim_radius, depth=state.depth, **fitted)
    settings = dict(given)
    if settings["radius"] is None and isinstance(dimple, DimpleFit):
        settings["radius"] = _egg_radius(boundary, dimple.pixel_size)
    return moduli_by_model(rim_radius=dimple.dimple_radius, depth=dimple.dimple_depth, **settings)


def _around(values: list[float], relative_std: float) -> tuple[float, float]:
    """Interval from the least to the largest value, widened by 95 % of their deviation."""
    wider = float(np.exp(NORMAL_95 * relative_std))
    return min(values) / wider, max(values) * wider


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
    ends = []
    for part in (slice(None, _END_POINTS), slice(-_END_POINTS, None)):
        x, y = boundary.x[part], boundary.y[part]
        along = np.linalg.svd(np.stack([x - x.mean(), y - y.mean()]))[0][:, 0]
        ends.append((float(x.mean()), abs(float(along[1]))))
    (left, fall_left), (right, fall_right) = ends
    if min(fall_left, fall_right) < _STEEP_END:
        return None
    return pixel_size * (right - left) / (fall_left + fall_right)


def _crop(boundary: Boundary) -> tuple[Array, Array]:
    """The dimple's side of the outline as one height a column of pixels."""
    middle = boundary.probe.tip[0]
    highest = boundary.x[np.where(boundary.x < middle, boundary.y, -np.inf).argmax()]
    reach = _CROP * (middle - highest)
    first = np.ceil(max(boundary.x[0], middle - reach))
    last = np.floor(min(boundary.x[-1], middle + reach))
    x = np.arange(first, last + 1)
    return x, np.interp(x, boundary.x, boundary.y)


def _apply(
    formula: Callable[..., Array],
    known: float,
    dimple: DimpleFit | DimpleGeometry,
    membrane: dict[str, float],
) -> tuple[float, float, tuple[float, float]]:
    """Modulus of a known force, or force of a known modulus: value, deviation of ln, interval."""
    inputs = {
        "dimple_radius": dimple.dimple_radius,
        "dimple_depth": dimple.dimple_depth,
        **membrane,
    }
    value = float(formula(known, **inputs))
    # E is F times a function of the dimple, whose error moves ln E and ln F by as much.
    force, modulus = (known, value) if formula is elastic_modulus else (value, known)
    std = modulus_std({"force": force, **inputs}, {}, dimple_covariance=dimple.covariance) / modulus
    return value, std, _interval(value, std)


def _interval(value: float, std: float) -> tuple[float, float]:
    """Return the 95 % interval of a positive quantity whose logarithm is normal."""
    factor = float(np.exp(NORMAL_95 * std))
    return value / factor, value * factor
