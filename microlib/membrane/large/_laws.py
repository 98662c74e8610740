r"""The laws of a stretched membrane: tensions, and the stretch that bears a given tension.

A law is a strain energy :math:`W(\lambda_1, \lambda_2)` per undeformed volume, of the stretches
along the meridian and around the axis. Its derivatives :math:`N_i = \partial W/\partial\lambda_i`
are nominal stresses: force per undeformed section. All are taken for a modulus of 1; stresses grow
in proportion to it.

A membrane too thin to bear compression wrinkles instead, which tension-field theory describes by
the *relaxed* energy: where the hoop stress would be negative, it is zero, and the meridian bears
its tension as in a strip that contracts freely.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from microlib._common import Array, one_of, poisson

#: C₂/C₁ of the Mooney–Rivlin law: an assumption, one value between rubber-like and stiffening.
MOONEY_RATIO = 0.2


class Law:
    """A membrane's stresses for a modulus of 1.

    `stress` gives the nominal stresses of two stretches, before any wrinkling; `strip` that of one
    that contracts freely across; `meridian` the meridian's stretch under a nominal stress and the
    hoop stress, wrinkles included.
    """

    stress: Callable[[Array, Array], tuple[Array, Array]]
    strip: Callable[[Array], Array]
    meridian: Callable[[Array, Array], tuple[Array, Array]]

    def even_stress(self, stretch: float) -> float:
        """Return the nominal stress of a stretch that is the same in all directions."""
        return float(self.stress(np.array(stretch), np.array(stretch))[0])

    def relaxed_stress(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return the nominal stresses of two stretches, with wrinkles in place of compression."""
        along, across = self.stress(first, second)
        strip = self.strip(first), self.strip(second)
        wrinkled = (across < 0) & (strip[0] > 0), (along < 0) & (strip[1] > 0)
        slack = (first <= 1) & (second <= 1)
        along = np.select([slack, *wrinkled], [0.0, strip[0], 0.0], along)
        across = np.select([slack, *wrinkled], [0.0, 0.0, strip[1]], across)
        return along, across


class Hooke(Law):
    r"""
    Linear elasticity of the stretches, exact in rotations.

    :math:`W = (e_1^2 + e_2^2 + 2\nu e_1 e_2)/(2(1-\nu^2))` with :math:`e_i = \lambda_i - 1`.
    """

    def __init__(self, poisson_ratio: float) -> None:
        self.poisson_ratio = poisson_ratio
        self._plane = 1 - poisson_ratio**2

    def stress(self, first: Array, second: Array) -> tuple[Array, Array]:
        e1, e2 = first - 1, second - 1
        nu = self.poisson_ratio
        return (e1 + nu * e2) / self._plane, (e2 + nu * e1) / self._plane

    def strip(self, stretch: Array) -> Array:
        return stretch - 1

    def meridian(self, stress: Array, hoop: Array) -> tuple[Array, Array]:
        e2 = hoop - 1
        e1 = self._plane * stress - self.poisson_ratio * e2
        across = e2 + self.poisson_ratio * stress
        wrinkled = (across < 0) & (stress > 0)
        return 1 + np.where(wrinkled, stress, e1), np.where(wrinkled, 0.0, across)


class MooneyRivlin(Law):
    r"""
    Incompressible rubber; neo-Hookean where the second constant is zero.

    :math:`W = C_1(I_1 - 3) + C_2(I_2 - 3)` with :math:`I_1 = \lambda_1^2 + \lambda_2^2 +
    (\lambda_1\lambda_2)^{-2}`, :math:`I_2 = \lambda_1^{-2} + \lambda_2^{-2} +
    (\lambda_1\lambda_2)^2` and :math:`C_1 + C_2 = 1/6`, the modulus 1 at small strain.
    """

    def __init__(self, ratio: float) -> None:
        self.first_constant = 1 / (6 * (1 + ratio))
        self.second_constant = ratio * self.first_constant

    def stress(self, first: Array, second: Array) -> tuple[Array, Array]:
        return (
            2 * self._stiffness(second) * (first - 1 / (first**3 * second**2)),
            2 * self._stiffness(first) * (second - 1 / (second**3 * first**2)),
        )

    def meridian(self, stress: Array, hoop: Array) -> tuple[Array, Array]:
        first = _solve_biaxial(stress / (2 * self._stiffness(hoop)), hoop)
        across = self.stress(first, hoop)[1]
        wrinkled = (across < 0) & (stress > 0)
        if wrinkled.any():
            first = first.copy()
            first[wrinkled] = self._solve_strip(stress[wrinkled])
            across = np.where(wrinkled, 0.0, across)
        return first, across

    def strip(self, stretch: Array) -> Array:
        return 2 * (self.first_constant + self.second_constant / stretch) * (stretch - stretch**-2)

    def _stiffness(self, other: Array) -> Array:
        return self.first_constant + self.second_constant * other**2

    def _solve_strip(self, stress: Array) -> Array:
        """Return λ of 2(C₁ + C₂/λ)(λ − λ⁻²) = N, concave and rising, 0 at λ = 1."""
        c1, c2 = self.first_constant, self.second_constant
        stretch = 1 + stress
        # Newton on a concave function squares the error with each step: the one after a step of the
        # root of a rounding is a rounding.
        for _ in range(20):
            inverse = 1 / stretch
            value = c1 * (stretch - inverse**2) + c2 * (1 - inverse**3)
            step = (stress / 2 - value) / (c1 + inverse**3 * (2 * c1 + 3 * c2 * inverse))
            stretch = stretch + step
            if np.all(np.abs(step) < np.sqrt(np.finfo(float).eps) * stretch):
                break
        return stretch


def _solve_biaxial(ratio: Array, hoop: Array) -> Array:
    """Return λ of λ − λ⁻³λ₂⁻² = `ratio`, rising and 0 at λ = λ₂^(−1/2)."""
    natural = hoop**-0.5
    # ξ − ξ⁻³ = s with ξ = λ/λ₂^(−1/2): one curve for all. The start is right at both of its ends;
    # Halley's third steps are below rounding for s > −1.
    s = ratio / natural
    root = s / 4 + np.sqrt(1 + (3 / 4 * s) ** 2)
    for _ in range(3):
        inverse = 1 / root
        fourth = (inverse * inverse) ** 2
        miss = root * (1 - fourth) - s
        slope = 1 + 3 * fourth
        root = root - miss * slope / (slope**2 + 6 * miss * fourth * inverse)
    return natural * root


def law_of(name: str, poisson_ratio: float) -> Law:
    """Return the law called `name`, or refuse a Poisson ratio that it cannot have."""
    law = one_of("law", name, ("hooke", "neo-hooke", "mooney-rivlin"))
    nu = poisson(poisson_ratio)
    if law == "hooke":
        return Hooke(nu)
    if nu != 0.5:
        raise ValueError(f"poisson_ratio must be 0.5, since {law} is incompressible, got {nu:g}")
    return MooneyRivlin(0.0 if law == "neo-hooke" else MOONEY_RATIO)
