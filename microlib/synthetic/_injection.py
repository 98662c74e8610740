"""A pipette over an egg, from before contact on: the capsule of `indent_capsule` at any depth.

Lengths are in µm, forces in µN, moduli in MPa; image coordinates in px.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtr

from microlib._common import Array, as_array, generator, image_shape, one_of, scalar
from microlib.membrane import indent_capsule

# What the scene looks like is a choice; grey levels of 255 under even light.
_GROUND, _FLUID, _YOLK, _WALL, _GLASS = 195.0, 168.0, 120.0, 60.0, 42.0
#: Yolk in radii of the egg, how far it fades, µm, and its grain: grey levels, blur in px.
_YOLK_RADIUS, _YOLK_FADE, _GRAIN, _GRAIN_BLUR = 0.62, 20.0, 8.0, 3.0
#: The scene is drawn on a finer grid with edges of this width, px of the sensor, and then blurred.
_FINE, _EDGE, _BLUR = 2, 0.45, 1.0
#: Least side of an image, px; largest departure of the light from its mean; share of the image's
#: height above the egg.
_SMALLEST, _UNEVEN, _ABOVE = 160, 0.08, 0.45
#: Directions from the egg's center in which the outline is kept: 0.2 µm apart on an egg of 600 µm.
_ANGLES = 6001
#: Forces of the solved states over E h R, from where the flattened top is narrower than any probe
#: to twice what fills a dimple; between them depth and outline are interpolated.
_LEAST_FORCE, _STATES = 3e-5, 24
#: Pixels in an egg's radius, at most: as many as the largest images have on a side.
_MOST_PIXELS = 1 << 16
#: A capsule that does not carry its load at some step has it at the next.
_MOST_MISSING = 6


@dataclass(frozen=True)
class _Indented:
    """States of one egg, from untouched on.

    Attributes
    ----------
    approach : ndarray, shape (n,)
        How far the probe has come since contact, µm.
    force, depth : ndarray, shape (n,)
        Force, µN, and depth of the dimple, µm.
    radius : ndarray, shape (n, angles)
        Distance of the outline from the center of the untouched egg, µm, by the angle from above.
    """

    approach: Array
    force: Array
    depth: Array
    radius: Array


class InjectionScene:
    """An egg on a plate, seen from the side, and a pipette that comes from above.

    The egg is the fluid-filled capsule of `microlib.membrane.indent_capsule`. Where the pipette is
    decides everything: before contact the egg is round, and from there on force and shape follow
    the pipette without a jump. What is drawn is the meridian.

    Parameters
    ----------
    rng : numpy.random.Generator or int
        Source of light, grain and noise, or its seed.
    modulus : float
        Elastic modulus E of the egg's wall, MPa.
    radius, thickness, probe_half_width : float
        R and h of the wall, and half of the pipette's width c, µm.
    inflation : float
        Stretch of the wall before the test.
    law : {"neo-hooke", "mooney-rivlin"}
        Of the wall.
    strongest : float
        Largest force that the scene can show, in µN per MPa of modulus.
    rupture : float, optional
        Force at which the wall gives way, µN; the egg is then round again, with the pipette in it.
    pixel_size : float
        µm.
    shape : tuple of int
        Rows and columns of the image.
    noise : float
        Standard deviation, grey levels of 255.

    Attributes
    ----------
    home : ndarray, shape (2,)
        Where the pipette's end is at the start: (x, y) in px, beside the egg's axis and above.
    contact : ndarray, shape (2,)
        Where it touches on the axis, px.
    deepest : float
        How far the scene can be pressed, µm.

    Raises
    ------
    ValueError
        If an argument is out of range, or such a capsule has no states to interpolate.

    Notes
    -----
    Up to the force that lays the wall on the whole of the pipette's face the states are those of a
    face without friction, then of a bonded one; at that force both agree to a fiftieth of a µm. A
    pipette beside the axis presses as if on it: keep it within a few px.

    Examples
    --------
    >>> scene = InjectionScene(0, modulus=1.0, strongest=30.0)
    >>> [round(scene.force(scene.contact + (0, y / scene.pixel_size)), 1) for y in (-5, 0, 20)]
    [0.0, 0.0, 7.0]
    >>> scene.frame(scene.home).shape
    (260, 360)
    """

    def __init__(
        self,
        rng: np.random.Generator | int,
        *,
        modulus: float,
        radius: float = 600.0,
        thickness: float = 3.0,
        probe_half_width: float = 25.0,
        inflation: float = 1.05,
        law: str = "neo-hooke",
        strongest: float = 100.0,
        rupture: float | None = None,
        pixel_size: float = 4.65 / 1.2,
        shape: tuple[int, int] = (260, 360),
        noise: float = 2.0,
    ) -> None:
        self._rng = generator("rng", rng)
        self._modulus = scalar("modulus", modulus, above=0)
        self._thickness = scalar("thickness", thickness, above=0)
        self._half_width = scalar("probe_half_width", probe_half_width, above=0)
        self._size = scalar("radius", radius, above=self._half_width)
        # An egg is larger than a pixel, and smaller than any image holds pixels.
        self.pixel_size = scalar(
            "pixel_size", pixel_size, least=self._size / _MOST_PIXELS, most=self._size
        )
        self._shape = image_shape("shape", shape, least=_SMALLEST)
        self._noise = scalar("noise", noise, least=0, most=255.0)
        self._rupture = None if rupture is None else scalar("rupture", rupture, above=0)
        stiffness = scalar("strongest", strongest, above=0)
        self._states = _solve(
            self._size,
            stiffness,
            self._thickness,
            self._half_width,
            scalar("inflation", inflation, least=1.0),
            one_of("law", law, ("neo-hooke", "mooney-rivlin")),
        )
        self._force = PchipInterpolator(self._states.approach, self._states.force)
        self._outline = PchipInterpolator(self._states.approach, self._states.radius)
        self._depth = PchipInterpolator(self._states.approach, self._states.depth)
        self.deepest = float(self._states.approach[-1])
        rows, columns = self._shape
        axis = (columns - 1) / 2 + self._rng.uniform(-8, 8)
        crown = _ABOVE * rows + self._rng.uniform(-4, 4)
        self.contact = np.array([axis, crown])
        self.home = self.contact + self._rng.uniform((-20, -45), (20, -35))
        self._light = _light(self._shape, self._rng)
        self._draw_still()

    def approach(self, tip: ArrayLike) -> float:
        """Return how far the pipette's end has come since contact, µm; negative before.

        Parameters
        ----------
        tip : array_like, shape (2,)
            Middle of the pipette's end, (x, y) in px.

        Returns
        -------
        float

        Raises
        ------
        ValueError
            If `tip` is no point.

        Examples
        --------
        >>> scene = InjectionScene(0, modulus=1.0, strongest=5.0)
        >>> round(scene.approach(scene.contact + (0.0, 2.0)), 2)
        7.75
        """
        place = as_array("tip", tip, shape=(2,))
        return float(place[1] - self.contact[1]) * self.pixel_size

    def force(self, tip: ArrayLike) -> float:
        """Return the force on a pipette whose end is at `tip`, µN.

        Parameters
        ----------
        tip : array_like, shape (2,)
            Middle of the pipette's end, (x, y) in px.

        Returns
        -------
        float
            Zero before contact and in an egg that has given way.

        Raises
        ------
        ValueError
            If the egg cannot be pressed so far.

        Examples
        --------
        >>> scene = InjectionScene(0, modulus=1.0, strongest=5.0)
        >>> scene.force(scene.home)
        0.0
        """
        pressed = self._pressed(tip)
        return 0.0 if self._torn(pressed) else self._modulus * float(self._force(pressed))

    def depth(self, tip: ArrayLike) -> float:
        """Return the depth of the dimple under a pipette whose end is at `tip`, µm.

        Parameters
        ----------
        tip : array_like, shape (2,)
            Middle of the pipette's end, (x, y) in px.

        Returns
        -------
        float
            Zero as long as the top of the egg is only flattened.

        Raises
        ------
        ValueError
            If the egg cannot be pressed so far.

        Examples
        --------
        >>> scene = InjectionScene(0, modulus=1.0, strongest=5.0)
        >>> scene.depth(scene.home)
        0.0
        """
        pressed = self._pressed(tip)
        return 0.0 if self._torn(pressed) else float(self._depth(pressed))

    def frame(self, tip: ArrayLike) -> NDArray[np.uint8]:
        """Draw the scene with the pipette's end at `tip`.

        Parameters
        ----------
        tip : array_like, shape (2,)
            Middle of the pipette's end, (x, y) in px.

        Returns
        -------
        ndarray of uint8, shape (rows, columns)

        Raises
        ------
        ValueError
            If the egg cannot be pressed so far.

        Examples
        --------
        >>> scene = InjectionScene(0, modulus=1.0, strongest=5.0)
        >>> scene.frame(scene.home).dtype.name
        'uint8'
        """
        x, y = as_array("tip", tip, shape=(2,))
        pressed = self._pressed(tip)
        outline = self._outline(0.0 if self._torn(pressed) else pressed)
        scene = self._with_wall(outline)
        u, v = self._grid
        bar = ndtr((self._half_width / self.pixel_size - np.abs(u - x)) / _EDGE)
        end = ndtr((y - v) / _EDGE)
        scene += np.outer(end, bar).astype(np.float32) * (np.float32(_GLASS) - scene)
        rest = np.sqrt(_BLUR**2 - _EDGE**2) * _FINE
        blurred = cv2.GaussianBlur(scene, (0, 0), float(rest), borderType=cv2.BORDER_REPLICATE)
        clean = cv2.resize(blurred, self._shape[::-1], interpolation=cv2.INTER_AREA)
        noise = self._noise * self._rng.standard_normal(self._shape, dtype=np.float32)
        return np.clip(np.rint(clean * self._light + noise), 0, 255).astype(np.uint8)

    def _pressed(self, tip: ArrayLike) -> float:
        pressed = max(self.approach(tip), 0.0)
        if pressed > self.deepest:
            raise ValueError(
                f"tip must be at most {self.deepest:.1f} µm deep, as far as strongest goes, got "
                f"{pressed:.1f} µm"
            )
        return pressed

    def _torn(self, pressed: float) -> bool:
        force = self._modulus * float(self._force(pressed))
        return self._rupture is not None and force >= self._rupture

    def _draw_still(self) -> None:
        """Prepare what no frame changes: the finer grid, the ground and the yolk."""
        rows, columns = self._shape
        # Centers of the fine cells: pixel k of the sensor covers k − ½ to k + ½.
        u, v = ((np.arange(n * _FINE) + 0.5) / _FINE - 0.5 for n in (columns, rows))
        self._grid = u, v
        x = (u - self.contact[0])[np.newaxis, :] * self.pixel_size
        top = (self.contact[1] - v)[:, np.newaxis] * self.pixel_size
        # The probe's end touches the outside of the wall, whose middle is the outline.
        y = top + self._size + self._thickness / 2
        self._distance = np.hypot(x, y).astype(np.float32)
        angle = np.arctan2(np.abs(x), y)
        self._place = (angle / np.pi * (_ANGLES - 1)).astype(np.float32)
        grain = self._rng.standard_normal(self._distance.shape, dtype=np.float32)
        grain = cv2.GaussianBlur(grain, (0, 0), _GRAIN_BLUR * _FINE)
        yolk = ndtr((_YOLK_RADIUS * self._size - self._distance) / _YOLK_FADE)
        grey = yolk * (_YOLK - _FLUID + _GRAIN * grain / grain.std())
        self._inner = (_FLUID + grey).astype(np.float32)

    def _with_wall(self, outline: Array) -> NDArray[np.float32]:
        """Draw the egg; the signed distance is exact near the wall, where all depends on it."""
        slope = np.gradient(outline, np.pi / (_ANGLES - 1)) / outline
        upright = (1 / np.hypot(1.0, slope)).astype(np.float32)
        index = np.rint(self._place).astype(np.intp)
        own = outline.astype(np.float32)
        inside = (own[index] - self._distance) * upright[index] / np.float32(self.pixel_size)
        half = np.float32(self._thickness / self.pixel_size / 2)
        scene = np.where(inside > 0, self._inner, np.float32(_GROUND))
        near = np.abs(inside) < half + 6 * _EDGE
        d = inside[near]
        body = ndtr(d / _EDGE)
        grey = _GROUND + (self._inner[near] - _GROUND) * body
        line = ndtr((d + half) / _EDGE) - ndtr((d - half) / _EDGE)
        scene[near] = grey + line * (_WALL - grey)
        return scene


@lru_cache(maxsize=8)  # two seconds, and often the same egg again
def _solve(
    radius: float,
    strongest: float,
    thickness: float,
    probe_half_width: float,
    inflation: float,
    law: str,
) -> _Indented:
    """Solve an egg of 1 MPa from untouched to the strongest force."""
    egg: dict[str, Any] = {
        "modulus": 1.0,
        "radius": radius,
        "thickness": thickness,
        "probe_half_width": probe_half_width,
        "inflation": inflation,
        "law": law,
    }
    unit = thickness * radius
    forces = np.geomspace(_LEAST_FORCE * unit, max(strongest, 2 * _LEAST_FORCE * unit), _STATES)
    # Pressing raises the pressure, so that less force never lays the wall on the whole face.
    whole_face = np.pi * probe_half_width**2 * indent_capsule(0.0, **egg).pressure
    last = _pressed(egg, forces[-1], whole_face)  # refuses the rest, if at all
    angle = np.linspace(0.0, np.pi, _ANGLES)
    states = [(0.0, 0.0, 0.0, np.full(_ANGLES, radius))]
    missing = 0
    for force in forces:
        try:
            state = last if force == forces[-1] else _pressed(egg, force, whole_face)
        except ValueError:
            state = None
        if state is None or state.approach <= states[-1][0]:
            missing += 1
            if missing > _MOST_MISSING or force == forces[-1]:
                raise ValueError(
                    f"strongest must suit the capsule: {missing} of {_STATES} forces up to "
                    f"{forces[-1]:.3g} µN have no deeper shape than those before"
                )
            continue
        # The middle under the probe, then the meridian down to the plate.
        r, z = np.append(0.0, state.r), np.append(state.z[0], state.z)
        around = np.arctan2(r, z - radius)
        order = np.argsort(around, kind="stable")
        own = np.interp(angle, around[order], np.hypot(r, z - radius)[order])
        states.append((state.approach, float(force), state.depth, own))
    approach, force, depth, outlines = zip(*states, strict=True)
    return _Indented(np.array(approach), np.array(force), np.array(depth), np.array(outlines))


def _pressed(egg: dict[str, Any], force: float, whole_face: float) -> Any:
    """Return the state under a bonded face, or a sliding one if the wall lies on part of it."""
    if force >= whole_face:
        with suppress(ValueError):
            return indent_capsule(float(force), **egg, punch="bonded")
    try:
        return indent_capsule(float(force), **egg, punch="frictionless")
    except ValueError as error:
        raise ValueError(f"strongest must suit the capsule: {error}") from None


def _light(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a slope of light of random direction around 1."""
    down, right = (np.linspace(-1.0, 1.0, n) for n in shape)
    turn = rng.uniform(0, 2 * np.pi)
    field = 1 + _UNEVEN * (np.cos(turn) * right[np.newaxis, :] + np.sin(turn) * down[:, np.newaxis])
    return np.asarray(field, dtype=np.float32)
