"""Visual servoing of a pipette onto a simulated egg, and pressing to a prescribed depth.

Chapter 6 of the thesis names microinjection as future work. Nothing of this is in the thesis.
Lengths are in µm, forces in µN, moduli in MPa; image coordinates in px, y down.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtr

from compendium.experiments.microscope import turned
from microlib.embryo import extract_boundary
from microlib.membrane import indent_capsule
from microlib.servoing import CameraTiming, SimulatedWorkstation, StageModel, servo

#: Size of a pixel in the object plane, µm; rows and columns of a frame; standard deviation of the
#: noise, grey levels.
PIXEL_SIZE, SHAPE, NOISE = 4.65 / 1.2, (260, 360), 2.0
#: Grey levels of the drawn parts, and the standard deviation of the blurred edges, px.
_GROUND, _FLUID, _YOLK, _WALL, _GLASS, _EDGE = 195.0, 168.0, 120.0, 60.0, 42.0, 0.9
#: Number of directions of a stored outline, and number of solved states.
_ANGLES, _STATES = 6001, 24
#: Largest force of a state, in E h R.
_STRONGEST = 0.06
#: Height above the egg to which the pipette is servoed, and length of the test moves, px.
_HOVER, _TEST = 10.0, 10.0
#: Height above the egg at which small steps begin, px, and their length, µm.
_STANDOFF, _STEP = 3.0, 0.5
#: Contact is detected if the outline has sunk by this number of standard deviations and by this
#: number of px in two frames. The standard deviation is that of this number of frames.
_SIGMAS, _LEAST_SINK, _STILL_FRAMES = 4.0, 0.015, 5
#: The dimple deepens by less than the pipette advances, so that a step of this share of the depth
#: that is left does not pass the target.
_SHARE = 0.85


class Egg:
    """A capsule under a pipette, solved by `indent_capsule` and drawn.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the egg, the pipette, their places and the noise.

    Attributes
    ----------
    contact, home : ndarray, shape (2,)
        Positions of the pipette's end at contact and at the start, px.
    depth : PchipInterpolator
        Depth of the dimple against the advance since contact, µm.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._radius, self._thickness = rng.uniform(520.0, 660.0), 3.0
        self._half_width = rng.uniform(18.0, 32.0)
        law = "neo-hooke" if rng.random() < 0.5 else "mooney-rivlin"
        advance, depth, outline = self._solve(rng.uniform(1.01, 1.08), law)
        self.depth, self._outline = (
            PchipInterpolator(advance, values) for values in (depth, outline)
        )
        rows, columns = SHAPE
        self.contact = np.array([(columns - 1) / 2, 0.45 * rows]) + rng.uniform(-6, 6, 2)
        self.home = self.contact + rng.uniform((-20, -45), (20, -35))
        y, x = np.indices(SHAPE, dtype=float)
        across = (x - self.contact[0]) * PIXEL_SIZE
        # The pipette touches the outside of the wall, whose middle is the outline.
        up = (self.contact[1] - y) * PIXEL_SIZE + self._radius + self._thickness / 2
        self._distance = np.hypot(across, up)
        self._place = np.rint(np.arctan2(np.abs(across), up) / np.pi * (_ANGLES - 1)).astype(int)
        yolk = ndtr((0.62 * self._radius - self._distance) / 20.0)
        grain = cv2.GaussianBlur(rng.standard_normal(SHAPE), (0, 0), 3.0)
        self._inner = _FLUID + yolk * (_YOLK - _FLUID + 8.0 * grain / grain.std())

    def _solve(self, inflation: float, law: str) -> tuple[NDArray, NDArray, NDArray]:
        """Return advance since contact, depth and outline of the states.

        The modulus is 1 MPa: the shape depends on the force over the modulus alone.
        """
        egg: Any = {"modulus": 1.0, "capsule_radius": self._radius, "thickness": self._thickness}
        egg |= {"probe_half_width": self._half_width, "inflation": inflation}
        egg |= {"poisson_ratio": 0.5, "law": law}
        # Pressing raises the pressure, so that a smaller force does not flatten the wall on the
        # whole face of the pipette.
        whole_face = np.pi * self._half_width**2 * indent_capsule(0.0, **egg).pressure
        strongest = _STRONGEST * self._thickness * self._radius
        angle = np.linspace(0.0, np.pi, _ANGLES)
        states = [(0.0, 0.0, np.full(_ANGLES, self._radius))]
        # The states are interpolated until the wall is flat on the whole face, 3 to 8 µm after
        # contact.
        for force in np.geomspace(1.02 * whole_face, strongest, _STATES):
            try:
                state = indent_capsule(float(force), **egg)
            except ValueError:  # the solver does not converge for a few forces
                continue
            # The middle under the probe, then the meridian down to the plate.
            r, z = np.append(0.0, state.r), np.append(state.z[0], state.z) - self._radius
            order = np.argsort(np.arctan2(r, z), kind="stable")
            own = np.interp(angle, np.arctan2(r, z)[order], np.hypot(r, z)[order])
            states.append((state.approach, state.depth, own))
        advance, depth, outline = zip(*states, strict=True)
        return np.array(advance), np.array(depth), np.array(outline)

    def advance(self, tip: NDArray) -> float:
        """Return the advance since contact of a pipette whose end is at `tip`, µm, or 0."""
        return max(0.0, float(tip[1] - self.contact[1]) * PIXEL_SIZE)

    def frame(self, tip: NDArray) -> NDArray[np.uint8]:
        """Draw the scene with the pipette's end at `tip`, px."""
        outline = self._outline(self.advance(tip))
        upright = 1 / np.hypot(1.0, np.gradient(outline, np.pi / (_ANGLES - 1)) / outline)
        inside = (outline[self._place] - self._distance) * upright[self._place] / PIXEL_SIZE
        half = self._thickness / PIXEL_SIZE / 2
        scene = _GROUND + (self._inner - _GROUND) * ndtr(inside / _EDGE)
        line = ndtr((inside + half) / _EDGE) - ndtr((inside - half) / _EDGE)
        scene += line * (_WALL - scene)
        y, x = (np.arange(n) for n in SHAPE)
        bar = ndtr((self._half_width / PIXEL_SIZE - np.abs(x - tip[0])) / _EDGE)
        scene += np.outer(ndtr((tip[1] - y) / _EDGE), bar) * (_GLASS - scene)
        noisy = scene + NOISE * self._rng.standard_normal(SHAPE)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Sight:
    """End of the pipette, outline of the wall and circle through the outline in a frame, px."""

    tip: NDArray
    outline: NDArray
    center: NDArray
    radius: float

    @property
    def dimple(self) -> float:
        """Depth of the pipette's end below the crest of the outline, px."""
        return float(self.tip[1] - self.outline[:, 1].min())

    def sunk(self, reference: Sight) -> float:
        """Return the mean depth of the outline near the pipette below a reference circle, px."""
        x, y = self.outline.T
        across = x - reference.center[0]
        near = np.abs(across) < 0.25 * reference.radius
        circle = reference.center[1] - np.sqrt(reference.radius**2 - across[near] ** 2)
        return float(np.mean(y[near] - circle))


def see(image: NDArray) -> Sight:
    """Find pipette and egg. `extract_boundary` raises a `ValueError` if one is missing."""
    boundary = extract_boundary(image, direction="top", dimple=False)
    visible = ~boundary.under_probe
    x, y = boundary.x[visible], boundary.image_height - 1 - boundary.y[visible]
    # x² + y² = 2 x x₀ + 2 y y₀ + (R² − x₀² − y₀²) is linear in the unknowns.
    design = np.column_stack([2 * x, 2 * y, np.ones_like(x)])
    x0, y0, rest = np.linalg.lstsq(design, x**2 + y**2, rcond=None)[0]
    radius = float(np.sqrt(rest + x0**2 + y0**2))
    return Sight(np.array(boundary.probe.tip), np.column_stack([x, y]), np.array([x0, y0]), radius)


class TipTracker:
    """Finds the pipette's end in each frame, with the interface that `servo` expects."""

    def track(self, frame: NDArray) -> Any:
        """Return the pipette's end, px, with a standard deviation of 0.02 px."""
        try:
            tip, reason = see(frame).tip, ""
        except ValueError as error:
            tip, reason = np.full(2, np.nan), str(error)
        return SimpleNamespace(
            center=tip, lost=bool(reason), reason=reason, covariance=4e-4 * np.eye(2)
        )


def press(seed: int, *, press_step: float = 15.0) -> dict[str, Any]:
    """Move a pipette above an egg, lower it to contact, and press to a prescribed depth.

    Parameters
    ----------
    seed : int
        Seed of egg, pipette, target depth and orientation of the camera.
    press_step : float
        Longest step after contact, µm.

    Returns
    -------
    dict
        ``log`` (a data frame: time, phase, measured and true depth), ``pictures`` (at the start, at
        contact and at the target), ``contact`` (time of detection, s), ``late`` (advance since the
        true contact at its detection, µm), ``depth error`` (relative, at the target), ``target``
        (µm) and the number of ``frames``.

    Raises
    ------
    ValueError
        If the pipette or the egg is not found, or no contact is detected near the egg.
    """
    rng = np.random.default_rng([seed, 81])
    egg = Egg(rng)
    last = 0.85 * float(egg.depth.x[-1])  # below the largest advance of the solved states
    target = rng.uniform(18.0, float(egg.depth(last)))
    jacobian = turned(rng.uniform(0, 2 * np.pi), 1 / PIXEL_SIZE, bool(rng.random() < 0.5))
    workstation = SimulatedWorkstation(
        egg.frame,
        jacobian=jacobian,
        home=egg.home,
        stage=StageModel(saturation=400.0),
        camera=CameraTiming(interval=0.03, latency=0.02),
        rng=rng,
    )
    first, _ = workstation.camera.snap()
    start = see(first)
    over = np.array([start.center[0], start.center[1] - start.radius - _HOVER])
    run = servo(
        workstation, TipTracker(), over, travel=600.0, test_move=_TEST * PIXEL_SIZE, tolerance=0.25
    )
    if run.reason:
        raise ValueError(f"the pipette did not reach the egg: {run.reason}")
    origin = workstation.stage.position()
    down = np.linalg.solve(run.jacobian, (0.0, 1.0 / PIXEL_SIZE))
    rows: list[dict[str, Any]] = []
    pictures = [first]

    def look(advance: float, phase: str) -> tuple[Sight, dict[str, Any]]:
        """Move the pipette to `advance`, µm below its position above the egg, and take a frame."""
        workstation.stage.move_to(origin + down * advance)
        while workstation.stage.moving():
            workstation.clock.sleep(0.002)
        frame, time = workstation.camera.snap()
        pictures.append(frame)
        depth = float(egg.depth(egg.advance(workstation.feature)))
        rows.append({"time_s": time, "phase": phase, "depth_um": np.nan, "true_depth_um": depth})
        return see(frame), rows[-1]

    reference, _ = look(0.0, "approach")
    gap = (reference.center[1] - reference.radius - reference.tip[1]) * PIXEL_SIZE
    advance = gap - _STANDOFF * PIXEL_SIZE
    still: list[float] = []
    sinking = 0
    while sinking < 2:
        sunk = look(advance, "approach")[0].sunk(reference)
        if len(still) < _STILL_FRAMES:
            still.append(sunk)
        else:
            scatter = np.std(still, ddof=1) * np.sqrt(1 + 1 / len(still))
            if sunk - np.mean(still) > max(_SIGMAS * scatter, _LEAST_SINK):
                sinking += 1
            else:
                sinking = 0
                still.append(sunk)
        if advance > gap + 2 * PIXEL_SIZE:
            raise ValueError("no contact is detected at the egg")
        advance += _STEP
    late = egg.advance(workstation.feature)
    at_contact = len(pictures) - 1

    seen = 0.0
    while target - seen > _STEP / 2:
        advance += float(np.clip(_SHARE * (target - seen), _STEP, press_step))
        sight, reached = look(advance, "press")
        reached["depth_um"] = seen = sight.dimple * PIXEL_SIZE
    at_target = len(pictures) - 1
    for back in np.linspace(advance, 0.0, 5)[1:]:
        look(float(back), "withdraw")
    return {
        "log": pd.DataFrame(rows),
        "pictures": [pictures[k] for k in (0, at_contact, at_target)],
        "contact": rows[at_contact - 1]["time_s"],
        "late": late,
        "depth error": reached["true_depth_um"] / target - 1,
        "target": target,
        "frames": len(run.log) + len(rows),
    }
