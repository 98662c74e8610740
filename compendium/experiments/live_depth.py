"""Depth while the stack is acquired: scenes, a simulated focus drive, Micro-Manager's acquisition.

Chapter 6 of the thesis names real-time reconstruction as what comes next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from compendium.rendered_microscope import rendered_core
from microlib.automation import LiveDepth, acquire_depth
from microlib.focus import FocusResult, depth_from_focus
from microlib.servoing import Camera, MicroManager, SimulatedWorkstation, Stage
from microlib.synthetic import (
    cone,
    focal_stack,
    mixed_texture,
    parabolic_cylinder,
    step,
)

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
    return focal_stack(
        texture, SCENES[name](), POSITIONS, blur_rate=BLUR_RATE, noise=NOISE, rng=rng
    )


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


def acquire_by_engine(stack: NDArray[np.uint8], farthest: float) -> LiveDepth:
    """Let Micro-Manager's acquisition take the frames, and end its sequence early.

    Parameters
    ----------
    stack : ndarray of uint8, shape (n, rows, cols)
        The frames at `POSITIONS`.
    farthest : float
        As of `LiveDepth`, µm.

    Returns
    -------
    LiveDepth
        With what was acquired.

    Raises
    ------
    ImportError
        If ``pymmcore-plus`` is not installed.
    """
    from useq import MDAEvent

    # The adapter switches off the shutter that there is none of.
    core = MicroManager(rendered_core(microscope(stack), stack.shape[1:])).core
    live = LiveDepth(farthest=farthest)
    faults: list[Exception] = []

    def take(frame: NDArray, event: Any) -> None:
        try:  # the engine swallows what is raised here
            live.push(frame, event.z_pos)
        except Exception as fault:
            faults.append(fault)

    core.mda.events.frameReady.connect(take)
    core.mda.run(MDAEvent(z_pos=float(z)) for z in POSITIONS if not (live.done or faults))
    if faults:
        raise faults[0]
    return live


def same(first: FocusResult, second: FocusResult) -> bool:
    """Return whether two results agree in every field, to the last bit.

    Parameters
    ----------
    first, second : FocusResult
        As of `depth_from_focus`.

    Returns
    -------
    bool
    """
    for field in fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if a is None or b is None:
            if a is not b:
                return False
        elif a.dtype != b.dtype or not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            return False
    return True


def saved(seed: int) -> pd.DataFrame:
    """Acquire every scene with its greatest height given, and after a coarse look.

    Parameters
    ----------
    seed : int
        Of textures and noise.

    Returns
    -------
    DataFrame
        ``scene``; ``way``, ``farthest`` or ``coarse``; ``saved``, % of the positions; ``same``,
        whether the result is that of `depth_from_focus` on the same frames to the last bit;
        ``seen``, whether the highest part has had its peak; the error ``rms`` and that of the whole
        stack, ``rms of all``, µm.
    """
    rows = []
    for name, make in SCENES.items():
        height, stack = make(), frames_of(name, seed)
        whole = depth_from_focus(stack, POSITIONS)
        given: dict[str, dict[str, Any]] = {
            "farthest": {"farthest": float(height.max())},
            "coarse": {"coarse": COARSE},
        }
        for way, options in given.items():
            run = acquire_depth(microscope(stack), POSITIONS, **options)
            assert run.result is not None, run.reason
            taken = np.searchsorted(POSITIONS, run.positions)
            error, all_error = run.result.depth - height, whole.depth - height
            rows.append(
                {
                    "scene": name,
                    "way": way,
                    "saved": 100 * (1 - run.frames / len(POSITIONS)),
                    "same": same(run.result, depth_from_focus(stack[taken], run.positions)),
                    # Two positions beyond the highest point the peak is seen from both sides.
                    "seen": bool(run.positions[-1] >= height.max() + 2 * np.diff(POSITIONS)[0]),
                    "rms": float(np.sqrt(np.nanmean(error**2))),
                    "rms of all": float(np.sqrt(np.nanmean(all_error**2))),
                }
            )
    return pd.DataFrame(rows)
