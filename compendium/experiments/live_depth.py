"""Depth while the stack is acquired: scenes and a simulated focus drive.

Chapter 6 of the thesis names real-time reconstruction as what comes next.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from microlib.automation import acquire_depth
from microlib.focus import depth_from_focus
from microlib.servoing import Camera, SimulatedWorkstation, Stage
from microlib.synthetic import cone, focal_stack, mixed_texture, parabolic_cylinder, step

#: Rows and columns of the frames, and positions of the focus drive, µm: planned for whatever lies
#: under the objective.
SHAPE = (128, 128)
POSITIONS = np.arange(-60.0, 460.0, 12.0)
#: Blur for each µm out of focus, px/µm, and noise, grey levels.
BLUR_RATE, NOISE = 0.06, 2.0
#: Frames from one coarse look to the next, 36 µm: what is in focus half-way has 1 px of blur more.
COARSE = 3
#: Side and height of the small part, px and µm.
PART, PART_HEIGHT = 12, 100.0


def small_part(height: NDArray) -> NDArray:
    """Put a part of 12 px on a surface, 100 µm above its highest point.

    Examples
    --------
    >>> float(small_part(np.zeros((64, 64))).max())
    100.0
    """
    found = height.copy()
    top, left = (n // 4 for n in height.shape)
    found[top : top + PART, left : left + PART] = height.max() + PART_HEIGHT
    return found


#: Heights of the scenes, µm.
SCENES: dict[str, Callable[[], NDArray]] = {
    "cylinder": lambda: parabolic_cylinder(SHAPE, height=150.0),
    "cone": lambda: cone(SHAPE, height=150.0, radius=55.0),
    "step": lambda: step(SHAPE, height=120.0),
    "fills the range": lambda: parabolic_cylinder(SHAPE, height=390.0),
    "small part": lambda: small_part(parabolic_cylinder(SHAPE, height=120.0)),
}


def frames_of(name: str, seed: int) -> NDArray[np.uint8]:
    """Return the whole stack of one of `SCENES`.

    Parameters
    ----------
    name : str
        One of `SCENES`.
    seed : int
        Of texture and noise.

    Returns
    -------
    ndarray of uint8, shape (n, rows, cols)
    """
    rng = np.random.default_rng([seed, 82])
    texture = mixed_texture(SHAPE, rng)
    look: dict[str, Any] = {"blur_rate": BLUR_RATE, "noise": NOISE}
    return focal_stack(texture, SCENES[name](), POSITIONS, rng=rng, **look)


def microscope(stack: NDArray[np.uint8]) -> SimulatedWorkstation:
    """Return a focus drive over a stack: each picture is the frame nearest to where it stands.

    Parameters
    ----------
    stack : ndarray of uint8, shape (n, rows, cols)
        The frames at `POSITIONS`.

    Returns
    -------
    SimulatedWorkstation
        Its drive goes at 2000 µm/s, in increments of 0.05 µm.
    """
    return SimulatedWorkstation(
        lambda feature, z: stack[int(np.abs(POSITIONS - z).argmin())],
        jacobian=np.eye(2),
        stage=Stage(saturation=100.0),
        camera=Camera(interval=0.005),
        rng=0,
        focus_drive=Stage(saturation=2000.0),
    )


def saved(seed: int) -> pd.DataFrame:
    """Acquire every scene with its greatest height given, and after a coarse look.

    Parameters
    ----------
    seed : int
        Of textures and noise.

    Returns
    -------
    DataFrame
        ``scene``; ``way``, ``farthest`` or ``coarse``; ``saved``, % of the positions; ``seen``,
        whether the highest part has had its peak; the error ``rms`` and that of the whole
        stack, ``rms of all``, µm.
    """
    rows = []
    for name, make in SCENES.items():
        height, stack = make(), frames_of(name, seed)
        # Two positions beyond the highest point the peak is seen from both sides.
        enough = height.max() + 2 * np.diff(POSITIONS)[0]
        whole = depth_from_focus(stack, POSITIONS).depth
        given: dict[str, Any] = {"farthest": float(height.max()), "coarse": COARSE}
        for way, value in given.items():
            run = acquire_depth(microscope(stack), POSITIONS, **{way: value})
            assert run.result is not None, run.reason
            share = 100 * (1 - run.frames / len(POSITIONS))
            rms = [np.sqrt(np.nanmean((z - height) ** 2)) for z in (run.result.depth, whole)]
            rows.append((name, way, share, run.positions[-1] >= enough, *rms))
    columns = ["scene", "way", "saved", "seen", "rms", "rms of all"]
    return pd.DataFrame(rows, columns=columns)
