"""From image to modulus on rendered embryos; `benchmarks/capsule_embryo.py` on more."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from benchmarks.capsule_embryo import draw_scene
from microlib.embryo import _modulus, force_from_image, modulus_from_image
from microlib.embryo._modulus import _egg_radius
from microlib.membrane import disc_modulus
from microlib.synthetic import Embryo, embryo_image

MEMBRANE = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
pytestmark = pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning")


def draw(seed: int):
    rng = np.random.default_rng(seed)
    embryo = Embryo.dented(
        rng.uniform(40.0, 150.0), modulus=rng.uniform(0.5, 2.0), rim_radius=rng.uniform(350, 600)
    )
    return embryo_image(
        embryo,
        rng=rng,
        shape=(360, 600),  # the dimple's side
        center=(rng.uniform(230.0, 370.0), rng.uniform(90.0, 130.0)),
        tilt=np.deg2rad(rng.uniform(-1.5, 1.5)),
        unevenness=rng.uniform(0.0, 0.2),
    )


@pytest.fixture(scope="module")
def study() -> pd.DataFrame:
    """ln(E / truth) and its deviation of ten embryos."""
    rows = []
    for seed in range(500, 510):
        scene = draw(seed)
        truth = scene.embryo
        found = modulus_from_image(scene.image, truth.force, pixel_size=3.875, **MEMBRANE)
        low, high = found.interval
        error = np.log(found.modulus / truth.modulus)
        rows.append((error, found.relative_std, low < truth.modulus < high))
    return pd.DataFrame(rows, columns=["error", "std", "inside"])


def test_modulus_is_unbiased_and_interval_covers_truth(study):
    # The mean of ten errors of 1.5 % is known to 0.5 %: three of those.
    assert abs(study["error"].mean()) < 0.015
    assert study["error"].std() < 0.05
    # Of ten intervals of 95 % seven or fewer hold once in 90.
    assert study["inside"].sum() >= 8
    # Intervals too wide would hold as well: the pulls must not be small (χ², ten pulls, 0.1 %).
    assert np.sum((study["error"] / study["std"]) ** 2) > 1.48


def test_force_and_modulus_have_same_relative_error():
    scene = draw(7)
    truth = scene.embryo
    by_force = modulus_from_image(scene.image, truth.force, pixel_size=scene.pixel_size, **MEMBRANE)
    by_modulus = force_from_image(
        scene.image, truth.modulus, pixel_size=scene.pixel_size, **MEMBRANE
    )
    assert by_force.modulus / truth.modulus == pytest.approx(truth.force / by_modulus.force)
    assert by_force.relative_std == pytest.approx(by_modulus.relative_std)
    low, high = by_modulus.interval
    assert np.log(high / low) == pytest.approx(2 * 1.959964 * by_modulus.relative_std)


@pytest.fixture(scope="module")
def pressed_capsule():
    """An image that shares no formula with (4.2) or with the renderer of the library."""
    return draw_scene(np.random.default_rng(102), "rod")


def of_capsule(scene, **options):
    return modulus_from_image(
        scene.image,
        scene.force,
        pixel_size=scene.pixel_size,
        thickness=scene.thickness,
        probe_half_width=scene.probe_half_width,
        poisson_ratio=0.5,
        **options,
    )


def test_capsule_method_recovers_modulus_and_radius(pressed_capsule):
    found = of_capsule(pressed_capsule, method="capsule")
    # Its own standard deviation is 0.8 %; fifty images of each probe are in the benchmark.
    assert found.modulus == pytest.approx(pressed_capsule.modulus, rel=0.025)
    assert found.interval[0] < pressed_capsule.modulus < found.interval[1]
    assert 0.003 < found.relative_std < 0.02
    assert found.dimple.radius == pytest.approx(pressed_capsule.radius, abs=2.0)
    # The fitted law's own modulus again, from radius and depth alone.
    assert found.model_moduli["capsule, neo-hooke"] == pytest.approx(found.modulus, rel=1e-3)


def test_capsule_method_calls_fit_capsule_with_given_sizes(pressed_capsule, monkeypatch):
    """As neo-Hookean, tilted, with points of the outline from the probe's end on."""
    asked = []
    capsule = SimpleNamespace(modulus=1.7, modulus_std=0.02)
    monkeypatch.setattr(
        _modulus, "fit_capsule", lambda *given, **how: asked.append((*given, how)) or capsule
    )
    scene = pressed_capsule
    found = of_capsule(scene, method="capsule")
    force, points, how = asked.pop()
    given = {"thickness": scene.thickness, "probe_half_width": scene.probe_half_width}
    given |= {"poisson_ratio": 0.5}
    assert how == given | {"fit_tilt": True}
    assert (force, found.given) == (scene.force, given)
    assert np.ptp(points[:, 0]) / 2 == pytest.approx(scene.radius, rel=0.05)
    assert points[:, 1].max() == pytest.approx(scene.depth, abs=2 * scene.pixel_size)
    # Of the wall's middle, which is not quite that of its profile: half a percent.
    assert found.relative_std == pytest.approx(np.hypot(0.02 / 1.7, 0.005))


def test_model_interval_contains_true_modulus(pressed_capsule):
    scene = pressed_capsule
    found = of_capsule(scene)
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


def arcs(angle: float, radius: float = 100.0) -> SimpleNamespace:
    t = np.linspace(-angle, angle, 400)
    return SimpleNamespace(x=150 + radius * np.sin(t), y=radius * np.cos(t))


def test_egg_radius_needs_steep_ends():
    # 60.5° over chords of 20 points: the sine of the fall is a bit below that of the end.
    for angle in (75.0, 63.5):
        assert _egg_radius(arcs(np.deg2rad(angle)), 2.0) == pytest.approx(200.0, rel=1e-3)
    assert _egg_radius(arcs(np.deg2rad(60.0)), 2.0) is None
    whole = arcs(np.deg2rad(75.0))
    for part in (slice(100, None), slice(None, -100)):
        assert _egg_radius(SimpleNamespace(x=whole.x[part], y=whole.y[part]), 2.0) is None
