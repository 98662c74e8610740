"""The modulus from images of rendered embryos; `benchmarks/capsule_embryo.py` has more images."""

from types import SimpleNamespace

import numpy as np
import pytest

from microlib.embryo import modulus_from_image
from microlib.membrane import capsule_modulus
from microlib.synthetic import Embryo, embryo_image
from tests.scenes.embryo import draw_scene

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")


def measured(scene):
    names = ("pixel_size", "thickness", "probe_half_width")
    sizes = {name: getattr(scene, name) for name in names}
    return modulus_from_image(scene.image, scene.force, **sizes, poisson_ratio=0.5)


def draw_of_model(rng: np.random.Generator) -> SimpleNamespace:
    """Render an embryo that obeys (4.2) and (4.7), of random stiffness, dimple, place and light."""
    depth, modulus, rim = rng.uniform((40.0, 0.5, 350.0), (150.0, 2.0, 600.0))
    embryo = Embryo.dented(depth, modulus=modulus, rim_curvature_radius=rim)
    center, tilt = rng.uniform((250.0, 110.0), (390.0, 160.0)), np.deg2rad(rng.uniform(-1.5, 1.5))
    light = rng.uniform(0.0, 0.2)
    around = {"shape": (512, 640), "center": tuple(center), "tilt": tilt, "unevenness": light}
    scene = embryo_image(embryo, rng=rng, **around)
    truth = {"modulus": modulus, "force": embryo.force, "pixel_size": scene.pixel_size}
    return SimpleNamespace(
        image=scene.image, **truth, thickness=embryo.thickness, probe_half_width=25.0
    )


def test_modulus_is_unbiased_and_interval_covers_truth():
    errors, stds, inside = [], [], 0
    for seed in range(510, 520):
        scene = draw_of_model(np.random.default_rng(seed))
        found = measured(scene)
        errors.append(np.log(found.modulus.value / scene.modulus))
        stds.append(found.modulus.uncertainty / found.modulus.value)
        inside += found.modulus.low < scene.modulus < found.modulus.high
    # The mean of ten errors of 1.5 % has the standard deviation 0.5 %; three of those.
    assert abs(np.mean(errors)) < 0.015
    assert np.std(errors) < 0.05
    # Seven or fewer of ten 95 % intervals contain the truth once in 90 trials.
    assert inside >= 8
    # Intervals that are too wide would pass as well: 1.48 is the 0.1 % quantile of χ² of ten errors
    # in standard deviations.
    assert np.sum(np.divide(errors, stds) ** 2) > 1.48


@pytest.fixture(scope="module")
def pressed_capsule():
    """An image that shares no formula with (4.2) or with the renderer of the library."""
    return draw_scene(np.random.default_rng(102), "rod")


def test_model_interval_contains_true_modulus(pressed_capsule):
    scene = pressed_capsule
    found = measured(scene)
    low, high = found.model_interval
    assert low < found.modulus.low < found.modulus.high < high
    assert low < scene.modulus < high
    # The uncertainty of the outline widens the range of the models; it is the same for all.
    widen = np.exp(1.959964 * found.modulus.uncertainty / found.modulus.value)
    moduli = found.model_moduli.values()
    assert (low * widen, high / widen) == pytest.approx((min(moduli), max(moduli)))
    assert found.modulus.high == pytest.approx(found.modulus.value * widen)
    # A capsule's dimple does not follow profile (4.2), so the modulus is uncertain.
    assert found.modulus.uncertainty > 0.2 * found.modulus.value
    assert found.model_moduli["point load"] == found.modulus.value


def test_capsule_is_among_models_if_both_ends_of_outline_are_steep(pressed_capsule):
    """The probe comes from the right; the outline occupies 338 rows from row 153 on."""
    scene = pressed_capsule
    sizes = {"thickness": scene.thickness, "probe_half_width": scene.probe_half_width}
    given = {"pixel_size": scene.pixel_size, **sizes, "poisson_ratio": 0.5}

    def moduli(rows: slice):
        found = modulus_from_image(scene.image[rows], scene.force, **given, direction="right")
        return found.dimple, found.model_moduli

    # The capsule's radius is found within 2 %, hence the modulus within 5 %.
    dimple, steep = moduli(slice(163, 480))
    by_hand = capsule_modulus(
        scene.force,
        dimple.rim_radius,
        dimple.dimple_depth,
        capsule_radius=scene.capsule_radius,
        poisson_ratio=0.5,
        **sizes,
    ).modulus
    assert steep["capsule, neo-hooke"] == pytest.approx(by_hand, rel=0.05)
    for rows in (slice(190, 480), slice(163, 450)):
        assert not any(name.startswith("capsule") for name in moduli(rows)[1])
