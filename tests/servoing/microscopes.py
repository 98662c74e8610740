"""The workstations that the tests steer: simulated, on the engine, and the engine's own demo."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from microlib.servoing import Camera, MicroManager, SimulatedWorkstation, Stage
from microlib.synthetic import mixed_texture

SHAPE = (160, 200)
#: A box about the middle of the texture, at home.
BOX = (80, 60, 40, 40)
HOME = np.array([99.5, 79.5])
KINDS = ("simulated", "engine")
MISSING = "pymmcore-plus is not installed (pip install microlib[microscope])"


def texture_view(seed: int, noise: float = 1.0):
    """Return a renderer of a texture that moves with the feature, blurred out of focus."""
    rng = np.random.default_rng(seed)
    scene = mixed_texture((SHAPE[0] + 160, SHAPE[1] + 160), rng, std=40.0, scales=2.0)

    def render(feature, focus):
        shift = feature - HOME
        view = np.array([[1.0, 0, 80.0 - shift[0]], [0, 1.0, 80.0 - shift[1]]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        image = cv2.warpAffine(scene, view, SHAPE[::-1], flags=flags)
        if abs(focus) > 0.5:
            image = cv2.GaussianBlur(image, (0, 0), 0.3 * abs(focus))
        image = image + noise * rng.standard_normal(SHAPE)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    return render


def turned(angle: float, scale: float, mirrored: bool) -> np.ndarray:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return scale * turn @ np.diag([1.0, -1.0 if mirrored else 1.0])


def workstation(kind: str = "simulated", *, seed: int = 0, jacobian=None, **options):
    """Return what is to be steered, and the simulation that knows the truth behind it."""
    settings = {
        "jacobian": turned(0.4, 0.5, True) if jacobian is None else jacobian,
        "stage": Stage(saturation=2000.0, travel=400.0),
        "camera": Camera(interval=0.01, latency=0.005),
        "rng": seed,
        "home": HOME,
    } | options
    truth = SimulatedWorkstation(texture_view(seed), **settings)
    if kind == "simulated":
        return truth, truth
    pytest.importorskip("pymmcore_plus", reason=MISSING)
    from compendium.rendered_microscope import rendered_core

    return MicroManager(rendered_core(truth, SHAPE)), truth


def demo() -> MicroManager:
    """Return Micro-Manager's own demo, in the mode whose picture depends on the stage."""
    pytest.importorskip("pymmcore_plus", reason=MISSING)
    from compendium.rendered_microscope import demo_microscope

    return demo_microscope()
