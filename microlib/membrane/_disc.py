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
from scipy.optimize import brentq

from microlib._common import Array, scalar
from microlib.membrane._laws import Law, law_of
from microlib.membrane._point_load import warn_of_units
from microlib.membrane._solver import Guess, MembraneState, Problem, gauss_points, in_units

_NODES = 60


@dataclass(frozen=True)
class _Disc(Problem):
    """The problem without units: lengths in rim radii, forces in E h a."""

    law: Law
    force: float
    pressure: float
    initial: float  # stretch before the probe
    inner: float  # undeformed radius of the probe's edge
    outer: float  # undeformed radius of the rim
    unit: float  # E h a in µN, for messages

    # Relative residual of the collocation; the depth is then good to about 1e-9.
    tolerance = 1e-8
    most_nodes = 3000

    @property
    def said(self) -> str:
        return (
            f": {self.force * self.unit:.4g} µN, {self.force:.3g} of modulus × thickness × radius, "
            f"with a pressure of {self.pressure:.3g} modulus × thickness / radius"
        )

    @property
    def scales(self) -> tuple[float, float, float]:
        """Sizes of the displacement, of the horizontal force and of the height."""
        load = self.force + np.pi * self.pressure
        rim = 1 / self.outer  # the stretch that the edges alone would give
        height = max(load ** (1 / 3), 1e-12)
        if rim < 1:
            # A slack disc hangs as deep as its meridians are long, however small the force.
            height += np.sqrt(self.outer**2 - 1)
        tension = self.law.even_stress(max(rim, 1.0)) + load / height
        # Below 1e-8 rounding would be resolved.
        return max(height**2, abs(self.initial - rim), 1e-8), tension, load / tension + 1e-12

    def material(self, t: Array) -> Array:
        """Undeformed radius, graded towards the probe as the logarithm of the dimple is."""
        return self.inner * (self.outer / self.inner) ** t

    def unpack(self, t: Array, y: Array) -> tuple[Array, Array, Array, Array]:
        """Return undeformed and deformed radius, horizontal and vertical force a radian."""
        move, tension, _ = self.scales
        x = self.material(t)
        r = x * self.initial + move * y[0]
        return x, r, tension * y[1], self.force / (2 * np.pi) - self.pressure * r**2 / 2

    def slopes(self, t: Array, y: Array, k: Any = None) -> Array:
        """Right-hand side of the equilibrium over t."""
        move, tension, height = self.scales
        x, r, horizontal, vertical = self.unpack(t, y)
        size = np.hypot(horizontal, vertical)
        first, hoop = self.law.meridian(size / x, r / x)
        # The direction of a slack meridian is undetermined, and its size is then zero.
        size = np.maximum(size, np.finfo(float).tiny)
        rise = first * vertical / size
        per_x = np.array(
            [
                (first * horizontal / size - self.initial) / move,
                (hoop + self.pressure * r * rise) / tension,
                rise / height,
            ]
        )
        return per_x * x * np.log(self.outer / self.inner)

    def edges(self, left: Array, right: Array, k: Any = None) -> Array:
        """Residual: the edges where they are held, the rim at height zero."""
        move, _, _ = self.scales
        rim = (1 - self.outer * self.initial) / move
        return np.array([left[0], right[0] - rim, right[2]])

    def guess(self) -> Guess:
        """Return a state near enough for a moderate force: evenly stretched, in balance."""
        move, tension, height = self.scales
        t = np.linspace(0.0, 1.0, _NODES)
        x = self.material(t)
        vertical = self.force / (2 * np.pi) - self.pressure * x**2 / (2 * self.outer**2)
        rise = np.clip(vertical / (0.5 * tension * x), -2, 2)
        steps = (rise[1:] + rise[:-1]) / 2 * np.diff(x)
        z = np.concatenate([[0.0], np.cumsum(steps)])
        rim = (1 - self.outer * self.initial) / move
        return t, np.array([rim * t, 0.5 * x, (z - z[-1]) / height]), None

    def stages(self) -> Iterator[_Disc]:
        """Yield problems of a load that grows to this one's."""
        for share in 3.0 ** -np.arange(8, -1, -1):
            yield replace(self, force=share * self.force, pressure=share * self.pressure)

    def virtual_work(self, solution: Any) -> float:
        """Return the imbalance of virtual work for a swelling of the whole shape, relative."""
        move, _, height = self.scales
        t, weight = gauss_points(solution.x)
        y, rate = solution.sol(t), solution.sol(t, 1)
        x, r, _, _ = self.unpack(t, y)
        per_t = x * np.log(self.outer / self.inner)
        r_rate = self.initial + move * rate[0] / per_t
        z, z_rate = height * y[2], height * rate[2] / per_t
        first, second = np.hypot(r_rate, z_rate), r / x
        along, across = self.law.relaxed_stress(first, second)
        area = x * per_t * weight
        inside = np.sum((along * first + across * second) * area)
        push = self.pressure * np.sum((r_rate * z - z_rate * r) * r * per_t * weight)
        ends = self.unpack(solution.x[[0, -1]], solution.y[:, [0, -1]])
        outward = ends[2][1] * ends[1][1] - ends[2][0] * ends[1][0]
        down = -ends[3][0] * height * solution.y[2, 0]
        work = outward + down + push
        parts = abs(inside) + abs(outward) + abs(down)
        return float(abs(inside - work) / parts) if parts else 0.0


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
        Force F of the probe, in µN; zero or positive.
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
        [0, 0.5); `radius` is what is left.

    Returns
    -------
    MembraneState
        `depth` of the probe's edge below the rim, which equals `approach` (µm); the meridian `r`,
        `z` from the probe to the rim (µm), with `stretches` and nominal `stresses` (MPa) along it
        and around the axis, (2, N) each; the `rim_radius` a (µm); `pressure`
        (MPa); elastic `energy` (pJ); `volume` below the rim's plane (µm³).

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

    A solution is returned only if a second integration of the equations and the balance of virtual
    work for a uniform swelling agree with it to 1e-5.

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
    load = scalar("force", force, least=0)
    stiffness, h = scalar("modulus", modulus, above=0), scalar("thickness", thickness, above=0)
    a = scalar("radius", radius, above=0)
    c = scalar("probe_half_width", probe_half_width, within=(0.0, a))
    initial = 1 + scalar("pretension", pretension, least=0)
    inset = scalar("rim_inset", rim_inset, least=0)
    if inset >= 0.5:
        raise ValueError(f"rim_inset must lie in [0, 0.5), got {inset:g}")
    below = load / (np.pi * a**2)
    if not isinstance(pressure, str):
        below = scalar("pressure", pressure, least=0)
    elif pressure != "balance":
        raise ValueError(f"pressure must be 'balance' or a number, got {pressure!r}")
    outer = 1 / (initial * (1 - inset))
    if outer <= 1.01 * c / a / initial:
        raise ValueError(f"probe_half_width must leave a membrane to its rim, got {c:g} of {a:g}")
    problem = _Disc(
        law=law_of(law, poisson_ratio),
        force=load / (stiffness * h * a),
        pressure=below * a / (stiffness * h),
        initial=initial,
        inner=c / a / initial,
        outer=outer,
        unit=stiffness * h * a,
    )
    if load == 0 and below == 0:
        if inset == 0:
            # The disc that nothing presses, evenly stretched.
            r, same = np.geomspace(c / a, 1.0, _NODES), np.ones((2, _NODES))
            stress, energy = problem.law.even_stress(initial), problem.law.even_energy(initial)
            flat = np.vstack([r, 0 * r, initial * same, stress * same])
            stored = np.pi * energy / initial**2
            return in_units(flat, stiffness, h, a, rim_radius=1.0, energy=stored)
        if initial * (1 - inset) <= 1:
            raise ValueError(
                f"force must be positive where rim_inset {inset:g} leaves a slack disc, got 0"
            )
    _, solution = problem.find()
    _, _, horizontal, _ = problem.unpack(solution.x, solution.y)
    if (horizontal <= 0).any():
        where = "below the probe" if horizontal[0] <= 0 else "over its rim"
        raise ValueError(
            f"force must leave the membrane upright, got one that folds it {where}{problem.said}"
        )
    return _state(problem, solution, stiffness, a, h)


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
        As for `elastic_modulus`, if the modulus is that of no membrane.

    Notes
    -----
    `indent_disc` is solved for the modulus whose depth is `depth`; the depth falls as the modulus
    grows.

    Examples
    --------
    >>> from microlib.membrane import disc_modulus
    >>> modulus = disc_modulus(50.0, 250.0, 60.58, thickness=3.0, probe_half_width=25.0)
    >>> print(f"{modulus:.2f} MPa")
    1.30 MPa
    """
    load, a = scalar("force", force, above=0), scalar("rim_radius", rim_radius, above=0)
    target = scalar("depth", depth, above=0)

    def excess(log_modulus: float) -> float:
        state = indent_disc(
            load,
            modulus=float(np.exp(log_modulus)),
            radius=a,
            thickness=thickness,
            probe_half_width=probe_half_width,
            poisson_ratio=poisson_ratio,
            law=law,
            pressure=pressure,
            pretension=pretension,
            rim_inset=rim_inset,
        )
        return (state.depth - target) / a

    # F = E h w³/a² up to a factor: within a few e-foldings of any law and load.
    start = np.log(load * a**2 / (scalar("thickness", thickness, above=0) * target**3))
    low, high = _bracket(excess, start, target)
    found = float(np.exp(brentq(excess, low, high)))
    warn_of_units(found)
    return found


def _bracket(excess: Any, start: float, depth: float) -> tuple[float, float]:
    """Return log moduli of a deeper and of a shallower dimple than the one measured."""
    above = start
    try:
        while excess(above) > 0:
            above += 1.0
            if above > start + 12:
                raise ValueError("the stiffest membrane tried hangs deeper")
    except ValueError as reason:
        raise ValueError(
            f"depth must be one that some modulus gives, got {depth:g} µm: {reason}"
        ) from None
    below, step = above, 1.0
    # A dimple within 1 % of the deepest is refused.
    while above - below < 25 and step > 0.02:
        try:
            if excess(below - step) >= 0:
                return below - step, below
            below -= step
        except ValueError:
            # Softer ones fold; the one that is deep enough may lie before them.
            step /= 2
    raise ValueError(
        f"depth must be one that some modulus gives, got {depth:g} µm: softer membranes are not "
        "deep enough or fold"
    )


def _state(problem: _Disc, solution: Any, modulus: float, a: float, h: float) -> MembraneState:
    _, _, height = problem.scales
    t, weight = gauss_points(solution.x)
    y = solution.sol(t)
    x, r, horizontal, vertical = problem.unpack(t, y)
    stretch, _ = problem.law.meridian(np.hypot(horizontal, vertical) / x, r / x)
    area = x**2 * np.log(problem.outer / problem.inner) * weight
    energy = 2 * np.pi * np.sum(problem.law.energy(stretch, r / x) * area)
    energy += np.pi * problem.inner**2 * problem.law.even_energy(problem.initial)
    # Shells between the axis and the membrane, one above the other, from the probe to the rim.
    volume = np.pi * np.sum(r**2 * height * solution.sol(t, 1)[2] * weight)
    x, r, horizontal, vertical = problem.unpack(solution.x, solution.y)
    along = np.hypot(horizontal, vertical) / x
    first, across = problem.law.meridian(along, r / x)
    z = height * solution.y[2]
    return in_units(
        np.array([r, z, first, r / x, along, across]),
        modulus,
        h,
        a,
        depth=-z[0],
        approach=-z[0],
        rim_radius=1.0,
        pressure=problem.pressure,
        energy=energy,
        volume=volume,
    )
