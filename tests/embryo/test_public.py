"""The laws of every public name of `microlib.embryo`."""

import numpy as np
import pytest

from microlib.embryo import (
    GaussianSum,
    dimple_geometry,
    extract_boundary,
    fit_dimple,
    modulus_from_image,
)
from tests import fuzz
from tests.embryo import test_outline
from tests.laws import (
    NUMBER,
    SAME,
    MPa,
    Row,
    TestedBy,
    Units,
    estimate,
    hold_same_as_new,
    laws_of,
    px,
    um,
    uN,
)

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
#: Amplitudes, centers and widths of an outline whose rims differ, and its range of x, px.
HILLS = np.array([[61.0, 55.0, 5.0], [52.0, 147.0, 190.0], [38.0, 43.0, 12.0]])
DOMAIN = np.array([5.0, 203.0])
SUM = {
    "amplitudes": px,
    "centers": px.counted_from("x0"),
    "widths": px,
    "domain": px.counted_from("x0"),
}
GEOMETRY = {
    "rim_radius": um, "dimple_depth": um, "covariance": um**2,
    "rim": px.counted_from("x0", None), "bottom": px.counted_from("x0", None),
}  # fmt: skip
FIT = {
    "rim_radius": um, "dimple_depth": um, "covariance": um**2, "rim_curvatures": 1 / um,
    "pixel_size": um, "probe_half_width": um, "center": NUMBER, "tilt": NUMBER, "rms_px": NUMBER,
    "curve": NUMBER,
}  # fmt: skip
#: µm. Only the pixel size, these lengths and the force give the results their units.
SIZES = {"thickness": 2.6, "probe_half_width": 25.0}
EGG = fuzz.egg().image.astype(np.float32)  # the library uses float32 without a copy


def film(u) -> dict:
    sizes = {name: value * u.um for name, value in SIZES.items()}
    return sizes | {"poisson_ratio": 0.31, "pixel_size": 7.75 * u.um, "direction": "top"}


def hills(u) -> GaussianSum:
    a, b, c = HILLS * u.px + [[0.0], [u.x0], [0.0]]
    return GaussianSum(a, b, c, domain=tuple(DOMAIN * u.px + u.x0))


ESTIMATE = {
    "modulus": estimate(MPa), "model_interval": MPa, "force": uN,
    "relative_rms": NUMBER, "boundary": SAME, "dimple": FIT,
    "model_moduli": dict.fromkeys(
        ("point load", "disc, neo-hooke", "disc, neo-hooke, no pressure", "disc, hooke",
         "disc, hooke, no pressure"), MPa),
    "given": {"thickness": um, "probe_half_width": um, "poisson_ratio": NUMBER},
}  # fmt: skip
LAWS = {
    "embryo.GaussianSum": Row(
        lambda u: {
            "amplitudes": HILLS[0] * u.px, "centers": u.x0 + HILLS[1] * u.px,
            "widths": HILLS[2] * u.px, "domain": tuple(DOMAIN * u.px + u.x0),
        },
        SUM,
    ),
    **{
        f"embryo.GaussianSum.{name}": Row(
            lambda u: {"self": hills(u), "x": u.x0 + np.array([30.0, 77.0]) * u.px}, unit
        )
        for name, unit in (("__call__", px), ("slope", NUMBER), ("second_derivative", 1 / px))
    },
    # Roots are found to 1e-12 of x, which is large for a distant origin.
    "embryo.GaussianSum.extrema": Row(
        lambda u: {"self": hills(u)}, px.counted_from("x0"), within=1e-8
    ),
    "embryo.dimple_geometry": Row(
        lambda u: {"curve": hills(u), "pixel_size": 3.9 * u.um / u.px, "rim": "right"},
        GEOMETRY,
        within=1e-6,
    ),
    "embryo.dimple_from_outline": TestedBy(
        test_outline.test_dimple_does_not_depend_on_order_origin_and_unit
    ),
    "embryo.read_outline": TestedBy(test_outline.test_read_outline_accepts_common_forms),
    # The search ends at a relative change of 1e-8 of its sum of squares, most of which is noise.
    "embryo.fit_gaussians": Row(
        lambda u: {
            "x": u.x0 + np.arange(60.0) * 3.3 * u.px,
            "y": hills(u)(u.x0 + np.arange(60.0) * 3.3 * u.px)
            + np.random.default_rng(0).normal(0, 0.1, 60) * u.px,
            "terms": 2,
        },
        SUM,
        within=1e-3,
    ),
    "embryo.loess": Row(
        lambda u: {
            "x": u.t0 + np.arange(40.0) ** 1.1 * u.s,
            "y": u.x0 + np.random.default_rng(1).normal(0, 3, 40) * u.px,
            "span": 0.4, "degree": 1,
        },
        px.counted_from("x0"),
    ),
    "embryo.extract_boundary": Row(
        lambda u: {"image": EGG * (0.6 * u.grey), "direction": "top"},
        {
            **dict.fromkeys(("x", "y", "uncertainty", "blur", "points"), NUMBER),
            **dict.fromkeys(("under_probe", "image_height", "rotation"), SAME),
            "probe": dict.fromkeys(("tip", "slope", "half_width", "taper"), NUMBER),
        },
        within=1e-4,  # grey levels in single precision
    ),
    "embryo.fit_dimple": Row(
        lambda u: {
            "boundary": fuzz.outline(), "pixel_size": 7.75 * u.um, "probe_half_width": 25.0 * u.um
        },
        FIT,
        within=1e-6,
    ),
    # Models are solved to 1e-6.
    "embryo.modulus_from_image": Row(
        lambda u: {"image": EGG, "force": 143.0 * u.uN, **film(u)}, ESTIMATE, within=1e-5
    ),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


def test_model_interval_is_range_of_models_widened_by_uncertainty_of_outline():
    found = modulus_from_image(EGG, 0.8, pixel_size=7.75, **SIZES, poisson_ratio=0.5)
    low, high = found.model_interval
    modulus = found.modulus
    assert low < modulus.low < modulus.value < modulus.high < high
    # The uncertainty of the outline is the same for all models.
    widen = np.exp(1.959964 * modulus.uncertainty / modulus.value)
    assert modulus.interval == pytest.approx((modulus.value / widen, modulus.value * widen))
    assert low * widen == pytest.approx(min(found.model_moduli.values()))
    assert high / widen == pytest.approx(max(found.model_moduli.values()))


@pytest.mark.parametrize(
    ("make", "uses"),
    [
        (lambda: hills(Units()), [lambda s: s.extrema(), lambda s: s(4.0), lambda s: s("four"),
                       lambda s: dimple_geometry(s, pixel_size=3.9)]),
        (lambda: extract_boundary(EGG), [lambda s: s.without_probe(EGG), lambda s: s.points,
            lambda s: s.without_probe("image"), lambda s: s.probe.axis(12.0),
            lambda s: fit_dimple(s, pixel_size=7.75, probe_half_width=25.0)]),
        (lambda: modulus_from_image(EGG, 143.0, pixel_size=7.75, **SIZES, poisson_ratio=0.5),
            [lambda s: s.model_interval, lambda s: s.relative_rms, repr, lambda s: s.model_moduli]),
    ],
    ids=["sum", "outline", "estimate"],
)  # fmt: skip
def test_results_do_not_depend_on_earlier_use(make, uses):
    """In either order, also after a rejected call; the caller's image is not changed."""
    image = EGG.copy()
    for before in (uses, uses[::-1]):
        hold_same_as_new(make, before[0], *before[1:], *before[:1])
    np.testing.assert_array_equal(EGG, image)
