"""Each erratum proven: the right form passes its proof, and the printed form does not.

A form is given here as the proof computes with it, and must stand in the entry of errata.toml, so
that a right form that is replaced by the print fails.
"""

from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp
from scipy.spatial.transform import Rotation

from compendium import ledger, thesis
from compendium.experiments import chapter_3
from microlib.curvature import hk_labels
from microlib.membrane import elastic_modulus

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
DIMPLE = {"thickness": 3.0, "poisson_ratio": 0.5}


def printed(id: str) -> float:
    return ledger.claim(id).value


def column(name: str) -> dict[str, float]:
    """Return one column of Table 5.1; angles in degrees, lengths in µm."""
    names = ("M", "T_op", "f", "d", "kappa", "alpha", "beta", "gamma", "T_z")
    return {key: printed(f"table-5.1/{name}/{key}") for key in names}


def probe_gives_the_modulus(zeta: float) -> bool:
    """A probe of this relative width exists and leads to the printed modulus, to its last digit."""
    if not 0 < zeta < 1:
        return False
    force, a, depth = (printed(f"table-5.6/{k}") for k in ("F", "a", "w_d"))
    modulus = elastic_modulus(force, a, depth, probe_half_width=zeta * a, **DIMPLE)
    # Half a unit in the last place of ζ moves the modulus by 0.0003 MPa.
    return abs(modulus - printed("table-5.6/E")) < 0.0004


def count_of_maxima(count: int) -> bool:
    return len(thesis.outline_curve().extrema()[0]) == count


def profile_from_the_balance(sign: int) -> bool:
    """(4.1) with sin θ = sign · dw/dr, integrated from w(a) = 0, is the printed (4.2)."""
    r, a, force, h, stress = sp.symbols("r a F h sigma_d", positive=True)
    sine = (force - sp.pi * r**2 * force / (sp.pi * a**2)) / (stress * 2 * sp.pi * r * h)
    inward = sp.Symbol("t", positive=True)
    profile = sign * sp.integrate(sine.subs(r, inward), (inward, a, r))
    printed = -force / (4 * sp.pi * stress * h) * (1 - (r / a) ** 2 + sp.log((r / a) ** 2))
    return bool(sp.simplify(sp.expand_log(profile - printed, force=True)) == 0)


def depth_at_the_probe(depth: float) -> bool:
    """The printed curve is this deep (µm) at r = c from its lowest point, below its left rim."""
    curve = thesis.outline_curve()
    x = np.linspace(125.0, 200.0, 750_001)
    y, c = curve(x), thesis.MEMBRANE["probe_half_width"] / thesis.EMBRYO_PIXEL
    bottom = x[x > 150][y[x > 150].argmin()]
    at_edge = thesis.EMBRYO_PIXEL * float(y.max() - curve(bottom - c))
    radius = thesis.EMBRYO_PIXEL * float(bottom - x[y.argmax()])
    modulus = thesis.modulus(radius, at_edge)
    return (
        abs(at_edge - depth) < 0.05 and abs(modulus - 3.03) < 0.005 and abs(radius - 246.5) < 0.05
    )


def denominator_of_strain(divisor: float) -> bool:
    """The integral of r from c to a is the area of the annulus over this number."""
    r, a, c = sp.symbols("r a c", positive=True)
    area = sp.pi * (a**2 - c**2)
    return bool(sp.simplify(sp.integrate(r, (r, c, a)) - area / sp.nsimplify(divisor)) == 0)


def row_of_alignment(row: tuple[str, ...]) -> bool:
    """The row times the unknowns of (2.15) is u, where (2.14) holds."""
    u, v, x, y, tx, ty = sp.symbols("u v X_w Y_w T_x T_y")
    r11, r12, r21, r22 = sp.symbols("r11 r12 r21 r22")
    alignment = u * (r21 * x + r22 * y + ty) - v * (r11 * x + r12 * y + tx)
    unknowns = [r11, r12, tx, r21, r22]
    names = {"u": u, "v": v, "X": x, "Y": y}
    terms = [sp.sympify(term, locals=names) for term in row]
    left = sum(term * unknown for term, unknown in zip(terms, unknowns, strict=True)) / ty
    return bool(sp.simplify(left - u + alignment / ty) == 0)


def row_of_intrinsics(second: str) -> bool:
    """The row times (T_op/f, κ) is u + v, where (2.18) holds."""
    p, q, m, kappa, u, v, r = sp.symbols("p q m kappa u v r")
    names = {"u": u, "v": v, "r": r, "kappa": kappa}
    left = (p + q) * m + sp.sympify(second, locals=names) * kappa
    return bool(sp.expand(left - (m * (p + q) - kappa * (u + v) * r**2)) == 0)


def magnifications(pairs: list[tuple[float, float]] | None) -> bool:
    """The two quotients of (2.12) are these; None for the same in all columns."""
    for k, name in enumerate(thesis.COLUMNS):
        c = column(name)
        both = c["T_op"] / c["f"], (c["T_op"] + c["f"]) / (c["f"] + c["d"])
        wanted = (c["M"], c["M"]) if pairs is None else pairs[k]
        if not np.allclose(both, wanted, atol=6e-5, rtol=0):
            return False
    return True


def distance_of_the_plane(t_z: float) -> bool:
    """T_z = f + d, and (T_op + f)/T_z is a magnification near the printed one."""
    c = column("square-4X")
    return (
        abs(t_z - c["f"] - c["d"]) < 0.6
        and abs((c["T_op"] + c["f"]) / t_z - printed("table-5.1/square-4X/M")) < 0.01
    )


def deviations(stds: tuple[float, float]) -> bool:
    """Five numbers between 0 and m with the mean a can have these standard deviations (n − 1)."""
    pairs = [
        [printed(f"table-5.2/square-{zoom}/{key}") for key in ("mean", "max")]
        for zoom in ("1X", "4X")
    ]
    return all(
        s - 5e-4 <= np.sqrt(5 / 4 * a * (m - a)) for s, (a, m) in zip(stds, pairs, strict=True)
    )


def error_share(share: float) -> bool:
    """The error at 1X is at most this share of the printed distance, rounded as the share is."""
    return printed("table-5.3/1X/accuracy") / printed("section-5.4/distance-1X") < share + 0.0005


def spectrum_of(exponent: Callable[[np.ndarray, float], np.ndarray]) -> bool:
    """The kernel's discrete transform is (3.9), exp(−σ²ω²/2)."""
    x, sigma = np.arange(-40, 41), 2.5
    kernel = np.exp(exponent(x, sigma))
    omega = 2 * np.pi * np.fft.rfftfreq(len(x))
    spectrum = np.abs(np.fft.rfft(kernel / kernel.sum()))
    return bool(np.abs(spectrum - np.exp(-(sigma**2) * omega**2 / 2)).max() < 1e-9)


def spikes_go(inside: bool) -> bool:
    """Replacing by the median inside (outside) of its band removes a spike and keeps the rest."""
    depth = np.array([4.0, 4.2, 3.9, 4.1, 40.0, 4.05, 3.95, 4.15, 4.0])
    median = np.median(depth)
    near = np.abs(depth - median) <= 2 * depth.std()
    result = np.where(near if inside else ~near, median, depth)
    return bool(result.max() < 5 and np.array_equal(np.delete(result, 4), np.delete(depth, 4)))


def second_derivative(divisor: float) -> bool:
    t = np.arange(-3, 4)
    window = np.array([5, 0, -3, -4, -3, 0, 5]) / divisor
    fitted = np.polynomial.polynomial.polyfit(t, t**2, 2)[2]  # the coefficient a20
    return bool(np.isclose(window @ t**2, 2 * fitted) and np.isclose(window @ t**2, 2.0))


def threshold_of_k(k_zero: float) -> bool:
    """No ball is taken for a cylinder: K = H² passes its threshold wherever H does."""
    h = np.linspace(1.001 * printed("section-5.5/h-threshold"), 1, 1000)
    return bool((h**2 > k_zero).all())


def lowest_at(x: float) -> bool:
    """The curve is nowhere lower between the centers of its outermost Gaussians."""
    curve = thesis.outline_curve()
    places = np.linspace(curve.centers.min(), curve.centers.max(), 4000)
    return bool(curve(places).min() >= curve(x) - 0.01)


def displacement_at_the_corner(pixels: float) -> bool:
    """κ r³ at the sensor's corner, to the printed place."""
    radius = np.hypot(656, 491) / 2 * 9.9
    moved = abs(column("circle-1X")["kappa"]) * radius**3 / 9.9
    return abs(moved - pixels) < 0.1


def test_relative_displacement_at_corner_is_small():
    percent = [
        100 * abs(column(name)["kappa"]) * (9.9 * np.hypot(656, 491) / 2) ** 2
        for name in thesis.COLUMNS
    ]
    np.testing.assert_allclose(percent, [1.4, 0.02, 0.35, 0.25], atol=0.05, rtol=0)


def test_printed_ratio_of_probe_gives_712_000_mpa():
    """(5.2) as the rows and the erratum state it, with the half-width ζ a."""
    force, a, depth = (printed(f"table-5.6/{k}") for k in ("F", "a", "w_d"))
    zeta = printed("table-5.6/zeta")
    log, square = np.log(zeta**2), zeta**2
    bracket = (1 - square) * (1 - square + log) ** 3 / (3 - 4 * square + square**2 + 2 * log)
    modulus = force * a**2 * 0.5 / (2 * np.pi * 3.0 * depth**3) * bracket
    assert abs(modulus) == pytest.approx(712_000, abs=500)
    assert round(depth / a, 2) == 0.49  # section-4/contact-mechanics


def seen_from_one_side(gamma: float) -> bool:
    """All four patterns are mirrored in their images, or none is."""
    gammas = [column(name)["gamma"] for name in thesis.COLUMNS if name != "circle-4X"]
    return len({np.sign(np.cos(np.deg2rad(g))) for g in [*gammas, gamma]}) == 1


def one_magnification(tolerance: float) -> bool:
    """No two patterns of one zoom differ by more than this; the printed ones do."""
    gaps = [abs(column(f"circle-{z}")["M"] / column(f"square-{z}")["M"] - 1) for z in ("1X", "4X")]
    errors = [
        printed(f"table-5.2/{p}-{z}/mean") for p in ("circle", "square") for z in ("1X", "4X")
    ]
    # What a magnification that is off by the gap does over 3 mm, beside the printed errors, µm.
    return min(gaps) > tolerance and 3000 * min(gaps) > 10 * max(errors)


def length_of_step(lengths: tuple[float, float]) -> bool:
    """A step of 50 px along both axes is as long, to 1 µm, with the pixel sizes of section 5.4."""
    step = np.hypot(printed("table-5.3/1X/step"), printed("table-5.3/1X/step"))
    pixels = [printed(f"section-5.4/pixel-{zoom}") for zoom in ("1X", "4X")]
    return bool(np.allclose(step * np.array(pixels), lengths, atol=1.0))


def coordinate_in_pixels(divisor: float) -> bool:
    """The length (2.21) over this divisor (µm) is the coordinate (2.22)."""
    magnification, pitch = column("circle-1X")["M"], printed("section-5.1/basler-pixel-pitch")
    return abs(magnification / divisor - magnification / pitch) < 1e-9


def pixel_of_jacobian(length: float) -> bool:
    """(2.22) maps the width of a pixel on the sample, 9.9 µm over M, to one pixel."""
    magnification = column("circle-1X")["M"]
    x = printed("section-5.1/basler-pixel-pitch") / magnification
    return abs(magnification / length * x - 1) < 1e-9


def slope_of_ramp(sign: int) -> bool:
    """The sign times (3.20), read as a convolution with (3.18), is the slope of R = x."""
    window = np.arange(-3, 4) / 28
    return bool(np.allclose(sign * np.convolve(np.arange(20.0), window, mode="valid"), 1.0))


def saddle_ridge(gaussian_sign: int) -> bool:
    """A surface with H < 0 and this sign of K has the label of a saddle ridge in Table 3.1."""
    label = hk_labels([-1.0], [0.5 * gaussian_sign], h_zero=0.0, k_zero=0.0)[0]
    return chapter_3.TABLE_3_1[int(label) - 1] == "saddle ridge"


ROW_PRINTED = ("u*X", "v*Y", "v", "-u*X", "v*Y")
ROW_RIGHT = ("v*X", "v*Y", "v", "-u*X", "-u*Y")
PAIRS = [(1.5893, 1.5941), (6.3858, 6.3795), (1.6236, 1.6262), (6.4438, 6.4446)]
FIRST, SECOND = (", ".join(map(str, quotients)) for quotients in zip(*PAIRS, strict=True))

#: Each erratum's proof, and for the printed and the right form what stands in the entry and what
#: the proof is given.
PROOFS: dict[str, tuple[Callable, tuple[str, object], tuple[str, object]]] = {
    "table-5.6-zeta": (probe_gives_the_modulus, ("44.78", 44.78), ("ζ = 0.1012", 0.1012)),
    "section-5.6-maxima": (count_of_maxima, ("two local maximum", 2), ("three", 3)),
    "section-4.1-sign": (profile_from_the_balance, ("dw/dr ≈ sin θ", 1), ("sin θ ≈ −dw/dr", -1)),
    "section-5.6-depth": (depth_at_the_probe, ("121.22 µm", 121.22), ("91.8 µm", 91.8)),
    "equation-4.5": (
        denominator_of_strain,
        ("denominator is the area", 1),
        ("divided by 2π", 2 * sp.pi),
    ),
    "equation-2.15": (
        row_of_alignment,
        ("[uX_w, vY_w, v, −uX_w, vY_w]", ROW_PRINTED),
        ("[vX_w, vY_w, v, −uX_w, −uY_w]", ROW_RIGHT),
    ),
    "equation-2.19": (
        row_of_intrinsics,
        ("[p + q, κ(u + v)r²]", "kappa*(u + v)*r**2"),
        ("[p + q, −(u + v)r²]", "-(u + v)*r**2"),
    ),
    "table-5.1-magnification": (
        magnifications,
        ("M = T_op/f = (T_op + f)/(f + d)", None),
        (f"T_op/f is {FIRST}, and (T_op + f)/(f + d) is {SECOND}", PAIRS),
    ),
    "table-5.1-square-4X-Tz": (distance_of_the_plane, ("203610", 203610.0), ("36007.5", 36007.5)),
    "table-5.2-squares": (
        deviations,
        ("2.9101", (2.9101, 0.5316)),
        ("2.318 and 0.461", (2.318, 0.461)),
    ),
    "section-5.4-error-share": (error_share, ("less than 3%", 0.03), ("3.2 %", 0.032)),
    "section-5.4-distance": (length_of_step, ("311 µm and 77 µm", (311, 77)), ("440", (440, 110))),
    "section-2.2.2-pixel-size": (pixel_of_jacobian, ("6.23 µm", 6.23), ("9.9 µm", 9.9)),
    "equation-2.22": (coordinate_in_pixels, ("x_s ≈ x′_s =", 1.0), ("x_s ≈ x′_s/s_x", 9.9)),
    "equation-3.20": (slope_of_ramp, ("D_x ∗ S ∗ R", 1), ("−D_x ∗ S ∗ R", -1)),
    "section-5.5-saddle-convex": (saddle_ridge, ("also convex", 1), ("K < 0", -1)),
    "equation-3.7": (
        spectrum_of,
        ("(2σ_g))", lambda x, sigma: -(x**2) / (2 * sigma)),
        ("(2σ_g²))", lambda x, sigma: -(x**2) / (2 * sigma**2)),
    ),
    "equation-3.14": (spikes_go, ("df ∈", True), ("df ∉", False)),
    "equation-3.19": (second_derivative, ("(1/84)", 84.0), ("(1/42)", 42.0)),
    "section-5.5-thresholds": (
        threshold_of_k,
        ("0.03 and 0.015", 0.015),
        ("ε_K ≤ ε_H² = 0.0009", 0.0009),
    ),
    "section-5.6-global-minimum": (lowest_at, ("(194.71, 62.8384)", 194.71), ("f_m(48.01)", 48.01)),
    "section-5.2-distortion": (displacement_at_the_corner, ("very small", 0.0), ("5.7 px", 5.7)),
    "table-5.1-mirrored": (seen_from_one_side, ("0.9088", 0.9088), ("γ near 180°", 180.0)),
    "table-5.1-two-patterns": (
        one_magnification,
        ("1.5893 6.3859 1.6236", abs(1.5893 / 1.6236 - 1)),
        ("one magnification", 0.001),
    ),
}


@pytest.mark.parametrize("name", ledger.errata())
def test_corrected_form_passes_proof_and_printed_form_fails(name):
    entry = ledger.errata()[name]
    proof, (wrong_text, wrong), (right_text, right) = PROOFS[name]
    assert wrong_text in entry["printed"]
    assert right_text in entry["corrected"]
    assert proof(right)
    assert not proof(wrong)


def test_proofs_and_errata_correspond():
    assert set(PROOFS) == set(ledger.errata())


def test_mirrored_numbering_of_pattern_gives_pose_of_erratum():
    def pose(*angles: float) -> np.ndarray:
        return Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()[:, :2]

    c = column("circle-4X")
    alpha, beta, gamma = c["alpha"], c["beta"], c["gamma"]
    seen = pose(alpha, beta, gamma)
    np.testing.assert_allclose(pose(alpha, beta, gamma + 180), seen * [1, -1], atol=1e-12)
    np.testing.assert_allclose(pose(alpha + 180, -beta, 180 - gamma), seen * [-1, 1], atol=1e-12)


def test_halved_derivatives_quarter_k_only_without_mixed_derivative():
    """(3.22) and (3.23) of second derivatives, R_xx and R_yy halved as by the printed window."""

    def h_and_k(xx: float, yy: float, xy: float) -> np.ndarray:
        p, q = 0.5, -0.3  # slopes along the columns and along the rows
        area = 1 + p**2 + q**2
        h = ((1 + p**2) * yy - 2 * p * q * xy + (1 + q**2) * xx) / (2 * area**1.5)
        return np.array([h, (xx * yy - xy**2) / area**2])

    np.testing.assert_allclose(h_and_k(1.0, 0.5, 0.0) / h_and_k(2.0, 1.0, 0.0), [0.5, 0.25])
    right, printed = h_and_k(2.0, 1.0, 1.0), h_and_k(1.0, 0.5, 1.0)
    assert right[1] > 0 > printed[1]
