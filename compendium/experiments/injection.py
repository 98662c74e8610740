"""A pipette that is led by sight onto a simulated egg and presses it to a force.

Chapter 6 of the thesis names microinjection as what comes next; nothing of this is in the thesis.
Lengths are in µm, forces in µN, moduli in MPa; image coordinates in px, y down.
"""

from __future__ import annotations

from contextlib import suppress
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
from microlib.membrane import fit_capsule, indent_capsule
from microlib.servoing import CameraTiming, SimulatedWorkstation, StageModel, servo

#: Pixel in the object plane; rows and columns of a frame; its noise in grey levels of 255.
PIXEL_SIZE, SHAPE, NOISE = 4.65 / 1.2, (260, 360), 2.0
#: Grey levels of what is drawn, and the width of its edges, px.
_GROUND, _FLUID, _YOLK, _WALL, _GLASS, _EDGE = 195.0, 168.0, 120.0, 60.0, 42.0, 0.9
#: Directions in which the outline is kept, and solved states between which it is interpolated.
_ANGLES, _STATES = 6001, 24
#: The force of the strongest state over E h R.
_STRONGEST = 0.06
#: The pipette is led to so many px over the egg, by test moves of so many px.
_HOVER, _TEST = 10.0, 10.0
#: Small steps begin so many px above the egg, µm long.
_STANDOFF, _STEP = 3.0, 0.5
#: Contact: the outline lies so many standard deviations, and px, below the untouched one, twice.
_SIGMAS, _LEAST_SINK, _STILL_FRAMES = 4.0, 0.015, 5
#: Dimple from which a capsule is fitted, px: at 2 px the force is open by 5 %.
_LEAST_DIMPLE = 4.0
#: Share of the way to the target, as a power law foretells it, that a step takes.
_SHARE = 0.85


class Egg:
    """The capsule of `indent_capsule` under a pipette, from before contact on.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the egg, the pipette, their places and the noise.

    Attributes
    ----------
    known : dict
        What a user would know: ``modulus``, ``thickness``, ``probe_half_width``, ``law``.
    contact, home : ndarray, shape (2,)
        Where the pipette's end touches on the axis, and where it is at the start, px.
    force, depth : PchipInterpolator
        Force and depth of the dimple over the way since contact.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._radius, self._thickness = rng.uniform(520.0, 660.0), 3.0
        self._half_width = rng.uniform(18.0, 32.0)
        self.known: dict[str, Any] = {
            "modulus": rng.uniform(0.5, 2.0),
            "thickness": self._thickness,
            "probe_half_width": self._half_width,
            "law": "neo-hooke" if rng.random() < 0.5 else "mooney-rivlin",
        }
        way, force, depth, outline = self._solve(rng.uniform(1.01, 1.08))
        self.force, self.depth, self._outline = (
            PchipInterpolator(way, values) for values in (force, depth, outline)
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

    def _solve(self, inflation: float) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return way, force, depth and outline of the states from untouched on."""
        egg = self.known | {"radius": self._radius, "inflation": inflation}
        unit = egg["modulus"] * self._thickness * self._radius
        # Pressing raises the pressure, so that less force never lays the wall on the whole face.
        whole_face = np.pi * self._half_width**2 * indent_capsule(0.0, **egg).pressure
        angle = np.linspace(0.0, np.pi, _ANGLES)
        states = [(0.0, 0.0, 0.0, np.full(_ANGLES, self._radius))]
        # Until the wall lies on the whole face, 3 to 8 µm after the first touch, the states are
        # interpolated: forces there are up to 0.1 µN off those of a face on which it slides.
        for force in np.geomspace(1.02 * whole_face, _STRONGEST * unit, _STATES):
            try:
                state = indent_capsule(float(force), **egg)
            except ValueError:  # what does not carry its load at some step does at the next
                continue
            # The middle under the probe, then the meridian down to the plate.
            r, z = np.append(0.0, state.r), np.append(state.z[0], state.z) - self._radius
            order = np.argsort(np.arctan2(r, z), kind="stable")
            own = np.interp(angle, np.arctan2(r, z)[order], np.hypot(r, z)[order])
            states.append((state.approach, float(force), state.depth, own))
        way, forces, depth, outline = zip(*states, strict=True)
        return np.array(way), np.array(forces), np.array(depth), np.array(outline)

    def way(self, tip: NDArray) -> float:
        """Return how far a pipette whose end is at `tip` has come since contact; zero before."""
        return max(0.0, float(tip[1] - self.contact[1]) * PIXEL_SIZE)

    def frame(self, tip: NDArray) -> NDArray[np.uint8]:
        """Draw the scene with the pipette's end at `tip`, px."""
        outline = self._outline(self.way(tip))
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
    """What one frame shows: the pipette's end, the wall's outline and the circle through it, px."""

    tip: NDArray
    outline: NDArray
    center: NDArray
    radius: float

    def sunk(self, reference: Sight) -> float:
        """Return how far the outline near the pipette lies below another's circle, px."""
        x, y = self.outline.T
        across = x - reference.center[0]
        near = np.abs(across) < 0.25 * reference.radius
        circle = reference.center[1] - np.sqrt(reference.radius**2 - across[near] ** 2)
        return float(np.mean(y[near] - circle))


def see(image: NDArray) -> Sight:
    """Find pipette and egg; a `ValueError` of `extract_boundary` says what is not there."""
    found = extract_boundary(image, direction="top", dimple=False)
    seen = ~found.under_probe
    x, y = found.x[seen], found.image_height - 1 - found.y[seen]
    # x² + y² = 2 x x₀ + 2 y y₀ + (R² − x₀² − y₀²), linear in what is sought.
    design = np.column_stack([2 * x, 2 * y, np.ones_like(x)])
    x0, y0, rest = np.linalg.lstsq(design, x**2 + y**2, rcond=None)[0]
    radius = float(np.sqrt(rest + x0**2 + y0**2))
    return Sight(np.array(found.probe.tip), np.column_stack([x, y]), np.array([x0, y0]), radius)


class TipTracker:
    """Finds the pipette's end in each frame anew, in the form that `servo` takes."""

    def track(self, frame: NDArray) -> Any:
        """Return the pipette's end, px, known to 0.02 px."""
        try:
            tip, reason = see(frame).tip, ""
        except ValueError as error:
            tip, reason = np.full(2, np.nan), str(error)
        return SimpleNamespace(
            center=tip, lost=bool(reason), reason=reason, covariance=4e-4 * np.eye(2)
        )


def press(seed: int, *, press_step: float = 15.0) -> dict[str, Any]:
    """Bring a pipette over an egg, down to contact, and press it to a force.

    Parameters
    ----------
    seed : int
        Of egg, pipette, target and the camera's mounting.
    press_step : float
        Longest step after contact, µm.

    Returns
    -------
    dict
        ``log`` (a data frame: time, phase, way, force and depth as seen and as they truly are),
        ``pictures`` (at the start, at contact and at the target), ``late`` (how far after the true
        contact it was seen, µm), ``force error`` and ``depth error`` (relative, at the target), and
        the number of ``frames``.

    Raises
    ------
    ValueError
        If the pipette or the egg is not seen, contact does not come where it should, or the target
        was passed by a tenth.
    """
    rng = np.random.default_rng([seed, 81])
    egg = Egg(rng)
    last = 0.85 * float(egg.force.x[-1])  # of the ways that the states reach
    ways = np.linspace(0.0, last, 400)
    target = float(egg.force(np.interp(rng.uniform(18.0, egg.depth(last)), egg.depth(ways), ways)))
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
        raise ValueError(f"the pipette was not brought over the egg: {run.reason}")
    origin = workstation.stage.position()
    down = np.linalg.solve(run.jacobian, (0.0, 1.0 / PIXEL_SIZE))
    rows: list[dict[str, Any]] = []
    pictures = [first]

    def look(advance: float, phase: str) -> tuple[Sight, dict[str, Any]]:
        """Bring the pipette forward to `advance`, µm from above the egg, and look."""
        workstation.stage.move_to(origin + down * advance)
        while workstation.stage.moving():
            workstation.clock.sleep(0.002)
        frame, time = workstation.camera.snap()
        pictures.append(frame)
        way = egg.way(workstation.feature)
        true = {"true_force": float(egg.force(way)), "true_depth": float(egg.depth(way))}
        rows.append({"time_s": time, "phase": phase, "force_uN": np.nan, "depth_um": np.nan} | true)
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
            raise ValueError("no contact is seen where the egg should be touched")
        advance += _STEP
    touched, late = advance - _STEP, egg.way(workstation.feature)
    at_contact = len(pictures) - 1

    known: list[tuple[float, float]] = []
    fit: Any = None
    step, unread = PIXEL_SIZE, 0
    while not known or known[-1][1] < 0.98 * target:
        advance += step
        sight, row = look(advance, "press")
        if (sight.tip[1] - sight.outline[:, 1].min()) < _LEAST_DIMPLE:
            continue
        found = _capsule(sight, reference, egg.known, fit, advance - touched)
        if found is None:
            unread += 1
            if unread == 3:
                raise ValueError("no capsule has the outline in three frames")
            continue
        fit = found
        row |= {"force_uN": egg.known["modulus"] / fit.modulus, "depth_um": fit.state.depth}
        known.append((advance - touched, row["force_uN"]))
        if known[-1][1] > 1.1 * target:
            raise ValueError(f"the target was passed: {known[-1][1]:.3g} µN")
        power = 1.5
        if len(known) > 1:
            longer, stronger = np.diff(np.log(known[-2:]), axis=0)[0]
            power = float(np.clip(stronger / longer, 1.0, 3.0))
        left = known[-1][0] * (target / known[-1][1]) ** (1 / power) - known[-1][0]
        step = float(np.clip(_SHARE * left, _STEP, press_step))
    reached = rows[-1]
    at_target = len(pictures) - 1
    for back in np.linspace(advance, 0.0, 5)[1:]:
        look(float(back), "withdraw")
    return {
        "log": pd.DataFrame(rows),
        "pictures": [pictures[k] for k in (0, at_contact, at_target)],
        "contact": rows[at_contact - 1]["time_s"],
        "late": late,
        "force error": reached["force_uN"] / reached["true_force"] - 1,
        "depth error": reached["depth_um"] / reached["true_depth"] - 1,
        "frames": len(run.log) + len(rows),
    }


def _capsule(sight: Sight, reference: Sight, known: dict[str, Any], before: Any, way: float) -> Any:
    """Return the capsule that has this outline and the dimple that is seen; None if none has.

    Of a force of 1 µN the shape knows only F/(E h R), so that the modulus is that over the force.
    """
    seen = (sight.tip[1] - sight.outline[:, 1].min()) * PIXEL_SIZE
    starts = [(before.modulus, before.inflation)] if before else []
    starts += [(1 / (f * known["thickness"] * way), s) for f, s in ((0.07, 1.03), (0.14, 1.06))]
    for start in starts:
        with suppress(ValueError):  # no capsule is like it, from there
            fit = fit_capsule(
                1.0,
                PIXEL_SIZE * sight.outline[:: max(1, len(sight.outline) // 160)] * (1, -1),
                thickness=known["thickness"],
                probe_half_width=known["probe_half_width"],
                radius=reference.radius * PIXEL_SIZE,
                law=known["law"],
                start=start,
            )
            if abs(fit.state.depth / seen - 1) < 0.5:  # a search that lost its way is far off
                return fit
    return None
