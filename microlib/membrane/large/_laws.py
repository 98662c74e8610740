r"""Constitutive laws of a thin membrane: nominal stresses of its principal stretches, and inverses.

A law is a strain energy :math:`W(\lambda_1, \lambda_2)` per undeformed volume, of the stretches
along the meridian (1) and around the axis (2, the hoop direction). Its derivatives :math:`N_i =
\partial W/\partial\lambda_i` are nominal stresses, force per undeformed section. All laws have the
modulus E = 1 at small strain, because stresses are proportional to E.

A thin membrane cannot bear compression: it wrinkles. Tension-field theory describes a wrinkled
membrane by the *relaxed* energy. Where the hoop stress would be negative, it is zero, and the
meridian is in uniaxial stress.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from microlib._common import Array, as_choice, as_poisson_ratio

#: C₂/C₁ of the Mooney–Rivlin law: an assumption, one value between rubber-like and stiffening.
MOONEY_RATIO = 0.2


class Law(ABC):
    """Nominal stresses of a membrane of modulus 1."""

    @abstractmethod
    def biaxial_stress(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return the nominal stresses of two principal stretches, without wrinkling."""

    @abstractmethod
    def invert_meridian_stress(self, stress: Array, hoop: Array) -> tuple[Array, Array]:
        """Return meridian stretch and hoop stress of a meridian stress and hoop stretch.

        The membrane may wrinkle.
        """

    def equibiaxial_stress(self, stretch: float) -> float:
        """Return the nominal stress of a stretch that is the same in all directions."""
        return float(self.biaxial_stress(np.array(stretch), np.array(stretch))[0])


class Hooke(Law):
    r"""Linear elasticity of the principal stretches, exact for any rotation.

    :math:`W = (e_1^2 + e_2^2 + 2\nu e_1 e_2)/(2(1-\nu^2))` with :math:`e_i = \lambda_i - 1`.
    """

    def __init__(self, poisson_ratio: float) -> None:
        self.poisson_ratio = poisson_ratio

    def biaxial_stress(self, first: Array, second: Array) -> tuple[Array, Array]:
        e1, e2, nu = first - 1, second - 1, self.poisson_ratio
        return (e1 + nu * e2) / (1 - nu**2), (e2 + nu * e1) / (1 - nu**2)

    def invert_meridian_stress(self, stress: Array, hoop: Array) -> tuple[Array, Array]:
        e2, nu = hoop - 1, self.poisson_ratio
        e1 = (1 - nu**2) * stress - nu * e2
        across = e2 + nu * stress
        wrinkled = (across < 0) & (stress > 0)
        return 1 + np.where(wrinkled, stress, e1), np.where(wrinkled, 0.0, across)


class MooneyRivlin(Law):
    r"""Incompressible Mooney–Rivlin rubber, which is neo-Hookean for C₂ = 0.

    :math:`W = C_1(I_1 - 3) + C_2(I_2 - 3)` with :math:`I_1 = \lambda_1^2 + \lambda_2^2 +
    (\lambda_1\lambda_2)^{-2}`, :math:`I_2 = \lambda_1^{-2} + \lambda_2^{-2} +
    (\lambda_1\lambda_2)^2` and :math:`C_1 + C_2 = 1/6`, so that the modulus at small strain is 1.
    """

    def __init__(self, ratio: float) -> None:
        self.c1 = 1 / (6 * (1 + ratio))
        self.c2 = ratio * self.c1

    def biaxial_stress(self, first: Array, second: Array) -> tuple[Array, Array]:
        along = 2 * (self.c1 + self.c2 * second**2) * (first - 1 / (first**3 * second**2))
        across = 2 * (self.c1 + self.c2 * first**2) * (second - 1 / (second**3 * first**2))
        return along, across

    def invert_meridian_stress(self, stress: Array, hoop: Array) -> tuple[Array, Array]:
        # N₁/(2(C₁ + C₂λ₂²)) = λ₁ − λ₁⁻³λ₂⁻², solved for λ₁.
        first = _invert_biaxial(stress / (2 * (self.c1 + self.c2 * hoop**2)), hoop)
        across = self.biaxial_stress(first, hoop)[1]
        wrinkled = (across < 0) & (stress > 0)
        if wrinkled.any():
            first = first.copy()
            first[wrinkled] = self._invert_uniaxial(stress[wrinkled])
            across = np.where(wrinkled, 0.0, across)
        return first, across

    def _invert_uniaxial(self, stress: Array) -> Array:
        """Return λ of the uniaxial stress N = 2(C₁ + C₂/λ)(λ − λ⁻²), a concave function of λ."""
        stretch = 1 + stress
        # Newton's method converges quadratically for a concave function, so that the error after a
        # step of √ε is ε.
        for _ in range(20):
            inverse = 1 / stretch
            value = self.c1 * (stretch - inverse**2) + self.c2 * (1 - inverse**3)
            slope = self.c1 + inverse**3 * (2 * self.c1 + 3 * self.c2 * inverse)
            step = (stress / 2 - value) / slope
            stretch = stretch + step
            if np.all(np.abs(step) < np.sqrt(np.finfo(float).eps) * stretch):
                break
        return stretch


def _invert_biaxial(value: Array, hoop: Array) -> Array:
    """Return λ₁ of `value` = λ₁ − λ₁⁻³λ₂⁻², an increasing function with its zero at λ₂^(−1/2)."""
    zero = hoop**-0.5
    # With ξ = λ₁/λ₂^(−1/2) the equation is ξ − ξ⁻³ = s. The initial value has both asymptotes of ξ,
    # and the error of the third iteration of Halley's method is below rounding for s > −1.
    s = value / zero
    xi = s / 4 + np.sqrt(1 + (3 / 4 * s) ** 2)
    for _ in range(3):
        inverse = 1 / xi
        fourth = (inverse * inverse) ** 2
        residual = xi * (1 - fourth) - s
        slope = 1 + 3 * fourth
        xi = xi - residual * slope / (slope**2 + 6 * residual * fourth * inverse)
    return zero * xi


def constitutive_law(name: str, poisson_ratio: float) -> Law:
    """Return the law called `name`, with a Poisson ratio that it can have."""
    law = as_choice("law", name, ("hooke", "neo-hooke", "mooney-rivlin"))
    nu = as_poisson_ratio(poisson_ratio)
    if law == "hooke":
        return Hooke(nu)
    if nu != 0.5:
        raise ValueError(f"poisson_ratio must be 0.5, since {law} is incompressible, got {nu:g}")
    return MooneyRivlin(0.0 if law == "neo-hooke" else MOONEY_RATIO)
