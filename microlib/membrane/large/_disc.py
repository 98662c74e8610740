r"""A flat disc with a clamped rim under a flat-ended probe, at any depth.

The model of the thesis, (4.1)–(4.7), assumes a uniform stress and small slopes. The disc has a
constitutive law, a clamped rim and an edge bonded to the probe, and its equilibrium is solved
without these two assumptions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from microlib._common import Array, as_scalar, positive_scalars
from microlib.membrane._point_load import check_bending, warn_if_implausible
from microlib.membrane.large._laws import Law, constitutive_law
from microlib.membrane.large._solver import (
    Guess,
    MembraneState,
    Segment,
    collocate,
    dimensional_state,
    equilibrium,
    meridian_curve,
    segment,
)


@dataclass(frozen=True)
class _Disc:
    """The dimensionless problem: lengths in rim radii a, forces in E h a.

    The state has three rows, each divided by its scale: the displacement r − λ₀X, which is zero at
    both edges, the horizontal tension H of the meridian per radian, and the height z.
    """

    law: Law
    force: float
    pressure: float
    prestretch: float  # λ₀, before contact
    inner: float  # undeformed radius of the probe's edge
    #: If given, force and pressure are initial values, and a common factor of both is unknown.
    depth: float | None = None

    @property
    def scales(self) -> tuple[float, float, float]:
        """Scales of the displacement, of the horizontal tension and of the height."""
        total = self.force + np.pi * self.pressure  # of the forces on the disc
        # Without pretension w/a grows as (F/(E h a))^⅓, see the closed form of `indent_disc`; the
        # displacement along the radius grows as the square of the slope.
        height = max(total ** (1 / 3), np.finfo(float).eps)
        tension = self.law.equibiaxial_stress(self.prestretch) + total / height
        displacement = max(height**2, 1e-8)  # a scale below 1e-8 would resolve rounding
        return displacement, tension, total / tension + 1e-12

    def undeformed(self, t: Array) -> tuple[Array, Array]:
        """Return X(t) and dX/dt, in equal ratios as the dimple is about logarithmic in r."""
        ratio = -np.log(self.inner * self.prestretch)
        x = self.inner * np.exp(ratio * t)
        return x, ratio * x

    def segment(self, t: Array, y: Array, k: Any) -> Segment:
        """Return the state at the nodes, with V = F/2π − p r²/2 as in the notes of `indent_disc`.

        Force and pressure enter with the opposite sign, because `segment` assumes a meridian that
        begins at a plate with the pressure above it. The meridian of a disc begins at the probe,
        and the pressure is below it.
        """
        displacement, tension, height = self.scales
        x, x_rate = self.undeformed(t)
        r, z = x * self.prestretch + displacement * y[0], height * y[2]
        factor = 1.0 if k is None else np.exp(k[0])
        force, pressure = factor * self.force, factor * self.pressure
        return segment(x, x_rate, r, z, tension * y[1], -force, -pressure)

    def right_hand_side(self, t: Array, y: Array, k: Any = None) -> Array:
        """Return dy/dt in equilibrium."""
        displacement, tension, height = self.scales
        disc = self.segment(t, y, k)
        r_rate, z_rate, horizontal_rate = equilibrium(self.law, disc)
        moved = (r_rate - self.prestretch * disc.arc_rate) / displacement
        return np.array([moved, horizontal_rate / tension, z_rate / height])

    def boundary_residual(self, left: Array, right: Array, k: Any = None) -> Array:
        """Return the residual of r at the probe, of r and z at the rim, and of a given depth."""
        depth = [] if self.depth is None else [left[2] + self.depth / self.scales[2]]
        return np.array([left[0], right[0], right[2], *depth])

    def initial_guess(self) -> Guess:
        """Return the shape of small slopes under the load, at an even stretch.

        H is that of the prestretch, proportional to X, and that of the closed form of `indent_disc`
        for the depth `height`, about height²/4 X^⅓.
        """
        _, tension, height = self.scales
        t = np.linspace(0.0, 1.0, 60)
        x, _ = self.undeformed(t)
        vertical = self.force / (2 * np.pi) - self.pressure * (x * self.prestretch) ** 2 / 2
        even = self.law.equibiaxial_stress(self.prestretch)
        horizontal = even * x + (tension - even) / 4 * np.cbrt(x)
        z = cumulative_trapezoid(np.clip(vertical / horizontal, -2, 2), x, initial=0.0)
        k = None if self.depth is None else np.zeros(1)
        return t, np.array([np.zeros(t.size), horizontal / tension, (z - z[-1]) / height]), k

    def of_modulus(self, modulus: float) -> _Disc:
        """Return the problem of a disc of another modulus under the same load."""
        return replace(self, force=self.force / modulus, pressure=self.pressure / modulus)

    def solve(self) -> Any:
        """Return the solution, or raise if H is negative somewhere, where the disc folds."""
        # The relative residual of 1e-8 makes the error of the depth about 1e-9.
        solution = collocate(
            self.right_hand_side, self.boundary_residual, self.initial_guess(),
            tolerance=1e-8, max_nodes=3000,
        )  # fmt: skip
        if solution is None:
            size = f"w_d/a = {self.depth:.2g}" if self.depth else f"F/(E h a) = {self.force:.2g}"
            fold = (
                "; under pressure the membrane folds beyond w_d/a = 1.5 at c/a = 0.1 and 0.3 at "
                "0.9, and pressure=0 allows any depth"
            ) * bool(self.pressure > 0)
            ratio = self.inner * self.prestretch
            raise ValueError(f"the solver does not converge at {size}, c/a = {ratio:.2g}{fold}")
        if (solution.y[1] <= 0).any():
            raise ValueError("the membrane folds")
        return solution


def indent_disc(
    force: float,
    rim_radius: float,
    *,
    modulus: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    law: str = "neo-hooke",
    pressure: float | str = "balance",
    pretension: float = 0.0,
) -> MembraneState:
    r"""Compute shape and stress of a clamped flat disc under a bonded flat-ended probe.

    Parameters
    ----------
    force : float
        Force F of the probe, in µN; positive.
    rim_radius : float
        Radius a of the clamped rim, in µm.
    modulus : float
        Elastic modulus E at small strain, in MPa.
    thickness : float
        Thickness h of the membrane free of stress, in µm.
    probe_half_width : float
        Radius c of the probe's flat end, in µm, below `rim_radius`. The
        membrane is bonded to it.
    poisson_ratio : float
        ν, in (−1, 0.5] for ``"hooke"``, and 0.5 for the incompressible laws.
    law : {"neo-hooke", "hooke", "mooney-rivlin"}, optional
        Constitutive law, see Notes.
    pressure : "balance" or float, optional
        Pressure p from below, in MPa. ``"balance"`` is the pressure :math:`F/(\pi a^2)` of the
        thesis, which makes the membrane level at its rim. 0 is an open hole.
    pretension : float, optional
        Equibiaxial stretch of the membrane before contact, minus 1. The part below the probe keeps
        this stretch.

    Returns
    -------
    MembraneState
        `depth` of the probe's edge below the rim, which equals `approach` (µm). Meridian `r`, `z`
        from the probe to the rim (µm). `stretches` and nominal `stresses` (MPa) along the meridian
        and around the axis, (2, N) each. `rim_radius` a (µm). `pressure` (MPa).

    Raises
    ------
    ValueError
        If an argument is out of its range, if no equilibrium is found, or if the membrane would
        fold below the probe or over its rim.

    See Also
    --------
    disc_modulus : The inverse.
    model_moduli : The same dimple by several models.

    Notes
    -----
    A point at the undeformed radius X moves to r(X) and the height z(X). Its stretches are
    :math:`\lambda_1 = \sqrt{r'^2 + z'^2}` and :math:`\lambda_2 = r/X`. The tension of the meridian
    per radian has a vertical part V and a horizontal part H,

    .. math::

        V &= \frac{F}{2\pi} - \frac{p r^2}{2},\\
        H' &= h N_2 + p\, r z',\\
        \sqrt{H^2 + V^2} &= h X N_1,\\
        (r', z') &= \lambda_1 (H, V)/\sqrt{H^2 + V^2}

    with the nominal stresses :math:`N_i = \partial W/\partial\lambda_i` (derived here; the last
    equation is solved for :math:`\lambda_1`). The edges are at :math:`r = c`, :math:`X = c/(1 +
    \text{pretension})` and at :math:`r = a`, :math:`X = a/(1 + \text{pretension})`. The hoop stress
    is never negative, because the membrane wrinkles (relaxed energy of tension-field theory).

    The energies per volume, with :math:`e_i = \lambda_i - 1`:

    - ``"hooke"``: :math:`W = \frac{E}{2(1-\nu^2)}(e_1^2 + e_2^2 + 2\nu e_1 e_2)`. Linear
      elasticity of other strain or stress measures has other forces at large depths.
    - ``"neo-hooke"``: :math:`W = \frac{E}{6}(\lambda_1^2 + \lambda_2^2 +
      (\lambda_1\lambda_2)^{-2} - 3)`
    - ``"mooney-rivlin"``: :math:`W = C_1(I_1 - 3) + C_2(I_2 - 3)`, :math:`C_2 = 0.2\,C_1`,
      :math:`E = 6(C_1 + C_2)`

    For p = 0, ν = 1/3, the law ``"hooke"`` and small slopes the force is
    :math:`F = \frac{\pi}{3} E h w^3 / (a^2 (1 - (c/a)^{2/3})^3)` (derived here).

    Examples
    --------
    >>> from microlib.membrane import indent_disc
    >>> state = indent_disc(
    ...     50.0, 250.0, modulus=1.3, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{state.depth:.2f} µm")
    60.58 µm
    """
    load, a, stiffness, h = positive_scalars(
        force=force, rim_radius=rim_radius, modulus=modulus, thickness=thickness
    )
    support = {"pressure": pressure, "pretension": pretension}
    material = constitutive_law(law, poisson_ratio)
    free = _dimensionless_disc(load, a, h, probe_half_width, material, **support)
    disc = free.of_modulus(stiffness)
    try:
        solution = disc.solve()
    except ValueError as reason:
        raise ValueError(
            f"force must be one that a disc holds, got {load:g} µN: {reason}"
        ) from None
    curve = meridian_curve(material, disc.segment(solution.x, solution.y, solution.p))
    depth = -curve[1, 0]
    sizes = {"depth": depth, "approach": depth, "rim_radius": 1.0, "pressure": disc.pressure}
    return dimensional_state(curve, stiffness, h, a, **sizes)


def disc_modulus(
    force: float,
    rim_radius: float,
    depth: float,
    *,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    law: str = "neo-hooke",
    pressure: float | str = "balance",
    pretension: float = 0.0,
) -> float:
    """Return the elastic modulus of a clamped flat disc from its depth under a force.

    Parameters
    ----------
    force : float
        Force F, in µN.
    rim_radius : float
        Radius a of the clamped rim, in µm.
    depth : float
        Depth w_d of the probe's edge below the rim, in µm.
    thickness, probe_half_width, poisson_ratio, law, pressure, pretension
        As for `indent_disc`.

    Returns
    -------
    float
        Modulus E at small strain, in MPa.

    Raises
    ------
    ValueError
        As for `indent_disc`, if no modulus gives this depth, or if a disc without pretension is
        less deep than thick.

    Warns
    -----
    UserWarning
        As for `elastic_modulus`: if a disc without pretension is less deep than two thicknesses, or
        if the modulus is outside the range of membranes.

    Notes
    -----
    The equations of `indent_disc` are solved for a given depth and unknown F/(E h a). The model
    assumes that the whole rim is clamped and that pressure and pretension are known.

    Examples
    --------
    >>> from microlib.membrane import disc_modulus
    >>> modulus = disc_modulus(
    ...     50.0, 250.0, 60.58, thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5
    ... )
    >>> print(f"{modulus:.2f} MPa")
    1.30 MPa
    """
    load, a, target, h = positive_scalars(
        force=force, rim_radius=rim_radius, depth=depth, thickness=thickness
    )
    support = {"pressure": pressure, "pretension": pretension}
    material = constitutive_law(law, poisson_ratio)
    disc = _dimensionless_disc(load, a, h, probe_half_width, material, **support)
    if disc.prestretch == 1:  # the tension of a stretched disc carries the force at any depth
        check_bending("depth", target, h)
    # The initial modulus is that of F = E h a (π/3 (w/a)³/(1 − ζ^⅔)³ + 2π N w/a/ln(1/ζ)): the
    # closed form of small slopes, and the stiffness of a drumhead of the prestretch's stress N.
    steepness, zeta = target / a, disc.inner * disc.prestretch
    drum = 2 * np.pi * disc.law.equibiaxial_stress(disc.prestretch) * steepness / -np.log(zeta)
    start = disc.force / (np.pi / 3 * (steepness / (1 - zeta ** (2 / 3))) ** 3 + drum)
    try:
        solution = replace(disc.of_modulus(start), depth=steepness).solve()
    except ValueError as reason:
        raise ValueError(
            f"depth must be one that some modulus gives, got {target:g} µm: {reason}"
        ) from None
    modulus = float(start / np.exp(solution.p[0]))
    warn_if_implausible(modulus)
    return modulus


def _dimensionless_disc(
    load: float, a: float, h: float, probe_half_width: float, law: Law, **support: Any
) -> _Disc:
    """Return the problem of a disc of modulus 1 MPa, rim radius a and thickness h under a load."""
    c = as_scalar("probe_half_width", probe_half_width, above=0, below=a)
    prestretch = 1 + as_scalar("pretension", support["pretension"], least=0)
    pressure = support["pressure"]
    if not isinstance(pressure, str):
        pressure = as_scalar("pressure", pressure, least=0)
    elif pressure == "balance":
        pressure = load / (np.pi * a**2)
    else:
        raise ValueError(f"pressure must be 'balance' or a number, got {pressure!r}")
    return _Disc(
        law=law,
        force=load / (h * a),
        pressure=pressure * a / h,
        prestretch=prestretch,
        inner=c / a / prestretch,
    )
