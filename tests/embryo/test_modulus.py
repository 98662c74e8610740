"""From image to modulus on rendered embryos; `benchmarks/capsule_embryo.py` on more."""

import numpy as np
import pytest

from benchmarks.capsule_embryo import by_library, draw_of_model, draw_scene
from microlib.embryo import modulus_from_image
from microlib.membrane import capsule_modulus, disc_modulus

pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")


def test_modulus_is_unbiased_and_interval_covers_truth():
    errors, stds, inside = [], [], 0
    for seed in range(500, 510):
        scene = draw_of_model(np.random.default_rng(seed))
        modulus, std, found = by_library(scene, "membrane")
        errors.append(np.log(modulus / scene.modulus))
        stds.append(std)
        inside += found.interval[0] < scene.modulus < found.interval[1]
    # The mean of ten errors of 1.5 % is known to 0.5 %: three of those.
    assert abs(np.mean(errors)) < 0.015
    assert np.std(errors) < 0.05
    # Of ten intervals of 95 % seven or fewer hold once in 90.
    assert inside >= 8
    # Intervals too wide would hold as well: the pulls must not be small (χ², ten pulls, 0.1 %).
    assert np.sum(np.divide(errors, stds) ** 2) > 1.48


@pytest.fixture(scope="module")
def pressed_capsule():
    """An image that shares no formula with (4.2) or with the renderer of the library."""
    return draw_scene(np.random.default_rng(102), "rod")


def test_capsule_method_recovers_modulus_and_radius(pressed_capsule):
    modulus, std, found = by_library(pressed_capsule, "capsule")
    # Its own standard deviation is 0.8 %; fifty images of each probe are in the benchmark.
    assert modulus == pytest.approx(pressed_capsule.modulus, rel=0.025)
    assert found.interval[0] < pressed_capsule.modulus < found.interval[1]
    # Of the wall's middle, which is not quite that of its profile: half a percent.
    assert std == pytest.approx(np.hypot(found.dimple.modulus_std / modulus, 0.005))
    assert std < 0.02
    assert found.force == pressed_capsule.force
    assert found.dimple.radius == pytest.approx(pressed_capsule.radius, abs=2.0)
    # The force's direction is fitted, and is that of the probe.
    assert 0 < abs(found.dimple.tilt) < 0.01
    # The fitted law's own modulus again, from radius and depth alone.
    assert found.model_moduli["capsule, neo-hooke"] == pytest.approx(modulus, rel=1e-3)


def test_model_interval_contains_true_modulus(pressed_capsule):
    scene = pressed_capsule
    _, _, found = by_library(scene, "membrane")
    assert found.model_interval[0] < scene.modulus < found.model_interval[1]
    # A capsule's dimple is no profile (4.2), and the interval of the modulus says so.
    assert found.relative_std > 0.2
    assert found.model_moduli["point load"] == pytest.approx(found.modulus, rel=1e-9)
    by_hand = disc_modulus(
        scene.force,
        found.dimple.dimple_radius,
        found.dimple.dimple_depth,
        thickness=scene.thickness,
        probe_half_width=scene.probe_half_width,
        law="hooke",
    )
    assert found.model_moduli["disc, hooke"] == pytest.approx(by_hand, rel=1e-9)


def test_capsule_is_among_models_if_both_ends_of_outline_are_steep(pressed_capsule):
    """The probe comes from the right, and the outline is 338 px wide from row 153 on."""
    scene = pressed_capsule
    sizes = {"thickness": scene.thickness, "probe_half_width": scene.probe_half_width}
    given = {"pixel_size": scene.pixel_size, **sizes, "poisson_ratio": 0.5}

    def moduli(rows: slice):
        found = modulus_from_image(scene.image[rows], scene.force, **given, direction="right")
        return found.dimple, found.model_moduli

    # Of the radius, within 2 %.
    dimple, steep = moduli(slice(163, 480))
    by_hand = capsule_modulus(
        scene.force, dimple.dimple_radius, dimple.dimple_depth, radius=scene.radius, **sizes
    ).modulus
    assert steep["capsule, neo-hooke"] == pytest.approx(by_hand, rel=0.05)
    for rows in (slice(190, 480), slice(163, 450)):
        assert not any(name.startswith("capsule") for name in moduli(rows)[1])
