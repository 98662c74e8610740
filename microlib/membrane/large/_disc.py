r"""A flat membrane with a clamped rim under a round probe, at any depth.

The thesis' model (4.1)–(4.7) takes one stress for the whole membrane and small slopes. Here the
membrane is free of both: its material obeys a law, its rim and the edge of the probe hold it, and
its equilibrium is solved as it stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from microlib._common import Array, scalar
from microlib.membrane._point_load import warn_if_implausible
from microlib.membrane.large._laws import Law, law_of
from microlib.membrane.large._solver import Guess, MembraneState, Problem, Strip, in_units, strip_of


@dataclass(frozen=True)
class _Disc(Problem):
    """The problem without units: lengths in rim radii, forces in E h a."""

    law: Law
    force: float
    pressure: float
    initial: float  # stretch before the probe
    inner: float  # undeformed radius of the probe's edge
    outer: float  # undeformed radius of the rim
    #: Where it is given, force and pressure are a guess, and by what factor they are off is found.
    depth: float | None = None

    # Relative residual of the collocation; the depth is then good to about 1e-9.
    tolerance = 1e-8
    most_nodes = 3000

    @property
    def scales(self) -> tuple[float, float, float]:
        """Sizes of the displacement, of the horizontal force and of the height."""
        load = self.force + np.pi * self.pressure
        rim = 1 / self.outer  # the stretch that the edges alone would give
        height = max(load ** (1 / 3), np.finfo(float).eps)
        if rim < 1:
            # A slack disc hangs as deep as its meridians are long, however small the force.
            height += np.sqrt(self.outer**2 - 1)
        tension = self.law.even_stress(max(rim, 1.0)) + load / height
        # Below 1e-8 rounding would be resolved.
        return max(height**2, abs(self.initial - rim), 1e-8), tension, load / tension + 1e-12

    def material(self, t: Array) -> tuple[Array, Array]:
        """Return the undeformed radius, graded as the logarithm of the dimple is, and its slope."""
        grade = np.log(self.outer / self.inner)
        x = self.inner * np.exp(grade * t)
        return x, grade * x

    def strips(self, t: Array, y: Array, k: Any) -> list[Strip]:
        """Return the whole disc, with its load turned over: pressed from below, it hangs."""
        move, tension, height = self.scales
        x, rate = self.material(t)
        r, z = x * self.initial + move * y[0], height * y[2]
        load = 1.0 if k is None else np.exp(k[0])
        force, pressure = -load * self.force, -load * self.pressure
        return [strip_of(x, rate, r, z, tension * y[1], force, pressure)]

    def rates(self, t: Array, slope: Array) -> list[tuple[Array, Array]]:
        move, _, height = self.scales
        return [(self.material(t)[1] * self.initial + move * slope[0], height * slope[2])]

    def slopes(self, t: Array, y: Array, k: Any = None) -> Array:
        """Right-hand side of the equilibrium over t."""
        move, tension, height = self.scales
        [strip] = self.strips(t, y, k)
        outward, rise, pull = self.balance(strip)
        return np.array(
            [(outward - self.initial * strip.rate) / move, pull / tension, rise / height]
        )

    def edges(self, left: Array, right: Array, k: Any = None) -> Array:
        """Residual: the edges where they are held, the rim at height zero."""
        move, _, height = self.scales
        rim = (1 - self.outer * self.initial) / move
        depth = [] if self.depth is None else [left[2] + self.depth / height]
        return np.array([left[0], right[0] - rim, right[2], *depth])

    def guess(self) -> Guess:
        """Return a state near enough for a moderate force: evenly stretched, in balance."""
        move, tension, height = self.scales
        t = np.linspace(0.0, 1.0, 60)
        x, _ = self.material(t)
        vertical = self.force / (2 * np.pi) - self.pressure * x**2 / (2 * self.outer**2)
        rise = np.clip(vertical / (0.5 * tension * x), -2, 2)
        z = cumulative_trapezoid(rise, x, initial=0.0)
        rim = (1 - self.outer * self.initial) / move
        known = None if self.depth is None else np.zeros(1)
        return t, np.array([rim * t, 0.5 * x, (z - z[-1]) / height]), known

    def stages(self) -> Iterator[_Disc]:
        """Yield problems of a load that grows to this one's, or of a probe that narrows to it."""
        if self.depth is None:
            for share in 3.0 ** -np.arange(8, -1, -1):
                yield self.of_modulus(1 / share)
        else:
            for inner in np.geomspace(max(self.inner, 0.02), self.inner, 12):
                yield replace(self, inner=float(inner))

    def of_modulus(self, modulus: float) -> _Disc:
        """Return a stiffer disc's problem under the same load."""
        return replace(self, force=self.force / modulus, pressure=self.pressure / modulus)

    def upright(self) -> Any:
        """Return the solution, unless the membrane folds."""
        _, solution = self.find()
        if (solution.y[1] <= 0).any():
            raise ValueError("force must leave the membrane upright, got one that folds it")
        return solution


def indent_disc(
    force: float,
    *,
    modulus: float,
    radius: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float = 0.5,
    law: str = "neo-hooke",
    pressure: float | str = "balance",
    pretension: float = 0.0,
    rim_inset: float = 0.0,
) -> MembraneState:
    r"""
    Shape and stress of a clamped flat membrane under a probe that it sticks to.

    Parameters
    ----------
    force : float
        Force F of the probe, in µN; positive.
    modulus : float
        Elastic modulus E at small strain, in MPa.
    radius : float
        Radius a of the rim as it is under the force, in µm.
    thickness : float
        Thickness h of the membrane free of stress, in µm.
    probe_half_width : float
        Radius c of the probe's flat end, in µm, below `radius`. The membrane sticks to it.
    poisson_ratio : float, optional
        ν, in (−1, 0.5] for ``"hooke"``, and 0.5 for the incompressible laws.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Law of the material, see Notes.
    pressure : "balance" or float, optional
        Pressure p from below, in MPa: ``"balance"`` is the thesis' :math:`F/(\pi a^2)`, which makes
        the membrane level at its rim; 0 is an open hole.
    pretension : float, optional
        Stretch of the membrane before the probe touches, equal in all directions, minus 1. The part
        below the probe keeps it.
    rim_inset : float, optional
        Fraction of its radius by which the rim has been drawn in since the probe touched, in
        [0, 0.5]; `radius` is what is left.

    Returns
    -------
    MembraneState
        `depth` of the probe's edge below the rim, which equals `approach` (µm); the meridian `r`,
        `z` from the probe to the rim (µm), with `stretches` and nominal `stresses` (MPa) along it
        and around the axis, (2, N) each; the `rim_radius` a (µm); `pressure` (MPa).

    Raises
    ------
    ValueError
        If an argument is out of its range, if no equilibrium is found, or if the membrane would
        fold below the probe or over its rim.

    See Also
    --------
    disc_modulus : The inverse.
    elastic_modulus : The thesis' small-slope model of the same membrane.

    Notes
    -----
    A point at the undeformed radius X moves to r(X) and the height z(X). Its stretches are
    :math:`\lambda_1 = \sqrt{r'^2 + z'^2}` and :math:`\lambda_2 = r/X`. The meridian's tension
    a radian has a vertical part V and a horizontal part H,

    .. math::

        V &= \frac{F}{2\pi} - \frac{p r^2}{2},\\
        H' &= h N_2 + p\, r z',\\
        \sqrt{H^2 + V^2} &= h X N_1,\\
        (r', z') &= \lambda_1 (H, V)/\sqrt{H^2 + V^2}

    with the nominal stresses :math:`N_i = \partial W/\partial\lambda_i` (derived here; the last
    equation is solved for :math:`\lambda_1`). The edges are at :math:`r = c`, :math:`X = c/(1 +
    \text{pretension})` and at :math:`r = a`, :math:`X = a/((1 + \text{pretension})(1 -
    \text{rim\_inset}))`. Hoop stress is never negative: the membrane wrinkles (relaxed energy).

    The energies per volume, with :math:`e_i = \lambda_i - 1`:

    - ``"hooke"``: :math:`W = \frac{E}{2(1-\nu^2)}(e_1^2 + e_2^2 + 2\nu e_1 e_2)`; the same
      words with other measures of strain or stress give other forces at large depths.
    - ``"neo-hooke"``: :math:`W = \frac{E}{6}(\lambda_1^2 + \lambda_2^2 +
      (\lambda_1\lambda_2)^{-2} - 3)`
    - ``"mooney-rivlin"``: :math:`W = C_1(I_1 - 3) + C_2(I_2 - 3)`, :math:`C_2 = 0.2\,C_1`,
      :math:`E = 6(C_1 + C_2)`

    A solution is returned only if the balance of virtual work for a uniform swelling agrees with it
    to 1e-5.

    For p = 0, ν = 1/3, Hooke and small slopes there is a closed form (derived here),
    :math:`F = \frac{\pi}{3} E h w^3 / (a^2 (1 - (c/a)^{2/3})^3)`.

    Examples
    --------
    >>> from microlib.membrane import indent_disc
    >>> state = indent_disc(
    ...     50.0, modulus=1.3, radius=250.0, thickness=3.0, probe_half_width=25.0
    ... )
    >>> print(f"{state.depth:.2f} µm")
    60.58 µm
    """
    load, a = scalar("force", force, above=0), scalar("radius", radius, above=0)
    stiffness, h = scalar("modulus", modulus, above=0), scalar("thickness", thickness, above=0)
    free = _unit_disc(
        load, a, h, probe_half_width, poisson_ratio, law, pressure, pretension, rim_inset
    )
    problem = free.of_modulus(stiffness)
    [meridian] = problem.meridian(problem.upright())
    depth = -meridian[1, 0]
    sizes = {"depth": depth, "approach": depth, "rim_radius": 1.0, "pressure": problem.pressure}
    return in_units(meridian, stiffness, h, a, **sizes)


def disc_modulus(
    force: float,
    rim_radius: float,
    depth: float,
    *,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float = 0.5,
    law: str = "neo-hooke",
    pressure: float | str = "balance",
    pretension: float = 0.0,
    rim_inset: float = 0.0,
) -> float:
    """
    Elastic modulus of a clamped flat membrane from the depth under a force.

    Parameters
    ----------
    force : float
        Force F, in µN.
    rim_radius : float
        Radius a of the rim under the force, in µm.
    depth : float
        Depth w_d of the probe's edge below the rim, in µm.
    thickness, probe_half_width, poisson_ratio, law, pressure, pretension, rim_inset
        As for `indent_disc`.

    Returns
    -------
    float
        Modulus E at small strain, in MPa.

    Raises
    ------
    ValueError
        As for `indent_disc`, or if no modulus gives this depth.

    Warns
    -----
    UserWarning
        As for `elastic_modulus`, if the modulus is outside the range of membranes.

    Notes
    -----
    The equations of `indent_disc` are solved with the depth given and F/(E h a) unknown. The depth
    falls as the modulus grows.

    Examples
    --------
    >>> from microlib.membrane import disc_modulus
    >>> modulus = disc_modulus(50.0, 250.0, 60.58, thickness=3.0, probe_half_width=25.0)
    >>> print(f"{modulus:.2f} MPa")
    1.30 MPa
    """
    load, a = scalar("force", force, above=0), scalar("rim_radius", rim_radius, above=0)
    target, h = scalar("depth", depth, above=0), scalar("thickness", thickness, above=0)
    free = _unit_disc(
        load, a, h, probe_half_width, poisson_ratio, law, pressure, pretension, rim_inset
    )
    # The closed form of small slopes, and what a drum bears beside it.
    steep, zeta = target / a, free.inner * free.initial
    drum = 2 * np.pi * free.law.even_stress(free.initial) * steep / -np.log(zeta)
    start = free.force / (np.pi / 3 * (steep / (1 - zeta ** (2 / 3))) ** 3 + drum)
    try:
        solution = replace(free.of_modulus(start), depth=steep).upright()
    except ValueError as reason:
        raise ValueError(
            f"depth must be one that some modulus gives, got {target:g} µm: {reason}"
        ) from None
    found = float(start / np.exp(solution.p[0]))
    warn_if_implausible(found)
    return found


def _unit_disc(
    load: float,
    a: float,
    h: float,
    probe_half_width: float,
    poisson_ratio: float,
    law: str,
    pressure: float | str,
    pretension: float,
    rim_inset: float,
) -> _Disc:
    """Return the problem of a disc whose modulus is 1 MPa."""
    c = scalar("probe_half_width", probe_half_width, above=0, below=a)
    initial = 1 + scalar("pretension", pretension, least=0)
    inset = scalar("rim_inset", rim_inset, least=0, most=0.5)
    below = load / (np.pi * a**2)
    if not isinstance(pressure, str):
        below = scalar("pressure", pressure, least=0)
    elif pressure != "balance":
        raise ValueError(f"pressure must be 'balance' or a number, got {pressure!r}")
    return _Disc(
        law=law_of(law, poisson_ratio),
        force=load / (h * a),
        pressure=below * a / h,
        initial=initial,
        inner=c / a / initial,
        outer=1 / (initial * (1 - inset)),
    )
