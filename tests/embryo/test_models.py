"""The models of one dimple: each by its own function, and those that cannot have it left out."""

from __future__ import annotations

import pytest

from microlib.embryo import _models
from microlib.membrane import capsule_modulus, disc_modulus, elastic_modulus

SIZES = {"thickness": 3.0, "probe_half_width": 25.0}
DIMPLE = (197.24, 247.0, 95.0)


@pytest.mark.filterwarnings("ignore:w_d/a")  # (4.7) is compared, not believed
def test_every_model_has_its_own_law_pressure_and_ratio() -> None:
    found = _models.moduli_by_model(*DIMPLE, radius=600.0, poisson_ratio=0.4, **SIZES)
    neo = {"law": "neo-hooke", "poisson_ratio": 0.5, **SIZES}
    hooke = {"law": "hooke", "poisson_ratio": 0.4, **SIZES}
    expected = {
        "point load": float(elastic_modulus(*DIMPLE, poisson_ratio=0.4, **SIZES)),
        "disc, neo-hooke": disc_modulus(*DIMPLE, pressure="balance", **neo),
        "disc, neo-hooke, no pressure": disc_modulus(*DIMPLE, pressure=0.0, **neo),
        "capsule, neo-hooke": capsule_modulus(*DIMPLE, radius=600.0, **neo).modulus,
        "disc, hooke": disc_modulus(*DIMPLE, pressure="balance", **hooke),
        "disc, hooke, no pressure": disc_modulus(*DIMPLE, pressure=0.0, **hooke),
        "capsule, hooke": capsule_modulus(*DIMPLE, radius=600.0, **hooke).modulus,
    }
    assert found == pytest.approx(expected, rel=1e-9)
    assert list(found) == list(expected)  # a disc with its pressure before that without, by law


def test_a_model_that_cannot_have_the_dimple_is_left_out(monkeypatch) -> None:
    def disc(force, rim_radius, depth, *, pressure, law, **others):
        if pressure == "balance":
            raise ValueError("no such disc")
        return {"neo-hooke": 1.0, "hooke": 2.0}[law]

    def capsule(force, rim_radius, depth, *, radius, law, **others):
        if law == "neo-hooke":
            raise ValueError("no such capsule")
        return type("Shell", (), {"modulus": 3.0})()

    monkeypatch.setattr(_models, "disc_modulus", disc)
    monkeypatch.setattr(_models, "capsule_modulus", capsule)
    found = _models.moduli_by_model(*DIMPLE, radius=600.0, poisson_ratio=0.5, **SIZES)
    del found["point load"]
    assert found == {
        "disc, neo-hooke, no pressure": 1.0,
        "disc, hooke, no pressure": 2.0,
        "capsule, hooke": 3.0,
    }
    found = _models.moduli_by_model(*DIMPLE, radius=None, poisson_ratio=0.5, **SIZES)
    assert not any("capsule" in name for name in found)
