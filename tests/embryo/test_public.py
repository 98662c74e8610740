"""The calls of every public function of the embryo: their units and what they refuse."""

from functools import partial

import numpy as np
import pytest

from microlib import embryo
from microlib.embryo import (
    GaussianSum,
    dimple_geometry,
    extract_boundary,
    fit_dimple,
    modulus_from_image,
)
from tests.checks import (
    BROKEN,
    NEGATIVE,
    NO_COUNT,
    NOT_POSITIVE,
    Wrong,
    hold_call,
    hold_refused,
    hold_same_as_new,
    hold_scaled,
    no_array,
    not_finite,
)
from tests.scenes.embryo import small_egg, small_outline

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")
#: µm. Only the pixel size, these lengths and the force give the results their units.
SIZES = {"thickness": 2.6, "probe_half_width": 25.0}
EGG = small_egg().image.astype(np.float32)  # the library uses float32 without a copy
ACROSS = np.arange(60.0)
#: A flat outline with one dimple, px.
DENTED = 9.0 - 7.0 * np.exp(-(((ACROSS - 30.0) / 9.0) ** 2)) - (ACROSS - 30.0) ** 2 / 300.0


def hills() -> GaussianSum:
    """Return an outline whose rims differ."""
    return GaussianSum(
        [61.0, 52.0, 38.0], [67.0, 202.0, 55.0], [5.0, 190.0, 12.0], domain=(17.0, 215.0)
    )


def noisy() -> dict:
    x = 12.0 + 3.3 * ACROSS
    return {"x": x, "y": hills()(x) + np.random.default_rng(0).normal(0, 0.1, 60), "terms": 2}


def rough() -> dict:
    y = np.random.default_rng(1).normal(12, 3, 40)
    return {"x": 3.7 + np.arange(40.0) ** 1.1, "y": y, "span": 0.4, "degree": 1}


#: A valid call of each function.
CALLS = {
    GaussianSum: lambda: {
        name: getattr(hills(), name) for name in ("amplitudes", "centers", "widths", "domain")
    },
    GaussianSum.__call__: lambda: {"self": hills(), "x": np.array([42.0, 89.0])},
    GaussianSum.slope: lambda: {"self": hills(), "x": np.array([42.0, 89.0])},
    GaussianSum.second_derivative: lambda: {"self": hills(), "x": np.array([42.0, 89.0])},
    GaussianSum.extrema: lambda: {"self": hills()},
    dimple_geometry: lambda: {"curve": hills(), "pixel_size": 3.9, "rim": "right"},
    embryo.dimple_from_outline: lambda: {"x": ACROSS.copy(), "y": DENTED, "pixel_size": 3.9},
    embryo.fit_gaussians: noisy,
    embryo.loess: rough,
    extract_boundary: lambda: {"image": EGG.copy(), "direction": "top"},
    embryo.Boundary.without_probe: lambda: {"self": small_outline(), "image": EGG.copy()},
    fit_dimple: lambda: {"boundary": small_outline(), "pixel_size": 7.75, "probe_half_width": 25.0},
    modulus_from_image: lambda: {
        "image": EGG.copy(),
        "force": 143.0,
        **SIZES,
        "poisson_ratio": 0.31,
        "pixel_size": 7.75,
        "direction": "top",
    },
}
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)
PIXEL = [*BROKEN, 0, -1]
#: What is refused in place of each argument.
REFUSED = {
    GaussianSum: {
        "widths": lambda valid: [*no_array(valid), 0 * valid, -valid],
        "domain": lambda valid: [*no_array(valid), (1, 1)],
    },
    **{
        function: {"x": not_finite}
        for function in (GaussianSum.__call__, GaussianSum.slope, GaussianSum.second_derivative)
    },
    dimple_geometry: {
        "pixel_size": PIXEL,
        "curve": [GaussianSum([9.0], [0.0], [5.0], domain=(-9, 9)), None, ([1.0], [2.0])],
    },
    embryo.dimple_from_outline: {
        "x": lambda valid: [*no_array(valid), valid[:5]],
        "pixel_size": PIXEL,
    },
    embryo.fit_gaussians: {
        "x": lambda valid: [*no_array(valid), np.full(60, 2.0), valid[:5]],
        "terms": [*NO_COUNT, 21],
    },
    embryo.loess: {
        "x": lambda valid: [*no_array(valid), np.ones(40), np.repeat([0.0, 1.0], 20)],
        "span": [*NOT_POSITIVE, 1.2, 0.02],
        "degree": [*NO_COUNT, 3],
    },
    fit_dimple: {
        "pixel_size": PIXEL,
        "boundary": [None, np.zeros((9, 2))],
        "probe_half_width": [
            *(*NOT_POSITIVE, Wrong(8.0, r"image, got 8 µm where 2\d\.\d µm are seen")),
            Wrong(45.0, "must be that of"),
        ],
    },
    modulus_from_image: {
        "force": [*NEGATIVE, 150e-6],  # in N
        "thickness": [*NOT_POSITIVE, 3e-6],  # in m
        "pixel_size": [*PIXEL, 3.9e-6],
        "probe_half_width": [*NOT_POSITIVE, 45.0],
        "poisson_ratio": [*NEGATIVE, 0.6],
        "direction": ["up", Wrong("bottom", "from the bottom")],
    },
}


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function], exact=("poisson_ratio",), undecided=0.002)


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


def test_dimple_and_modulus_follow_units_of_length_and_force():
    um, uN = 1.7, 0.45
    fit = partial(fit_dimple, small_outline())

    def dimple(by: float) -> dict:
        sizes = ("rim_radius", "dimple_depth", "pixel_size", "probe_half_width")
        return dict.fromkeys(sizes, by) | {"covariance": by**2, "rim_curvatures": 1 / by}

    found = fit(pixel_size=0.0775, probe_half_width=0.25)
    hold_scaled(found, fit(pixel_size=7.75, probe_half_width=25.0), within=1e-6, **dimple(0.01))
    given = CALLS[modulus_from_image]()
    moduli = dict.fromkeys(("modulus", "model_moduli", "model_interval"), uN / um**2)
    sizes = {name: um * given[name] for name in ("pixel_size", *SIZES)}
    found = modulus_from_image(**given | sizes | {"force": 143.0 * uN})
    assumed = {"thickness": um, "probe_half_width": um}
    # Models are solved to 1e-6.
    plain = modulus_from_image(**given)
    hold_scaled(found, plain, within=1e-5, force=uN, dimple=dimple(um), given=assumed, **moduli)


@pytest.mark.parametrize(
    ("make", "uses"),
    [
        (hills, [GaussianSum.extrema, lambda s: s("four"), lambda s: s(4.0)]),
        (lambda: extract_boundary(EGG), [lambda s: s.without_probe(EGG), lambda s: s.points,
            lambda s: s.without_probe("image"),
            lambda s: fit_dimple(s, pixel_size=7.75, probe_half_width=25.0)]),
        (lambda: modulus_from_image(**CALLS[modulus_from_image]()),
            [lambda s: s.model_interval, repr, lambda s: s.model_moduli]),
    ],
    ids=["sum", "outline", "estimate"],
)  # fmt: skip
def test_results_do_not_depend_on_earlier_use(make, uses):
    """In either order, also after a rejected call."""
    for before in (uses, uses[::-1]):
        hold_same_as_new(make, before[0], *before[1:], *before[:1])
