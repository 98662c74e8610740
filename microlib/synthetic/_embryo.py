"""Images of a zebrafish embryo under an AFM probe, as taken by the workstation's Sony camera.

The outline is that of the biomembrane point-load model, so the modulus behind every image is known.
Lengths are in µm, forces in µN, moduli in MPa; image coordinates in px.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scipy.special import beta, ndtr

from microlib._common import (
    Array,
    Result,
    as_array,
    as_generator,
    as_image_shape,
    as_poisson_ratio,
    as_scalar,
)
from microlib.membrane import SmallSlopeWarning, dimple_depth, dimple_profile
from microlib.synthetic._textures import eight_bits


@dataclass(frozen=True)
class _Appearance:
    """Grey levels and proportions of the scene, which are arbitrary.

    Attributes
    ----------
    ground, fluid, yolk, chorion, probe, sensor : float
        Grey levels of 255 under even light.
    sensor_half_width, yolk_half_width, yolk_gap : float
        Half of the widths of the force sensor and the yolk, and the least gap between yolk and
        chorion, in radii of the embryo.
    yolk_fade : float
        Width over which the edge of the yolk fades, px.
    grain, grain_blur : float
        Of the yolk: its standard deviation (grey levels) and its blur (px of the finer grid).
    """

    ground: float = 195.0
    fluid: float = 168.0
    yolk: float = 112.0
    chorion: float = 60.0
    probe: float = 42.0
    sensor: float = 58.0
    sensor_half_width: float = 1 / 10
    yolk_half_width: float = 0.78
    yolk_gap: float = 11 / 120
    yolk_fade: float = 3.0
    grain: float = 8.0
    grain_blur: float = 6.0


_APPEARANCE = _Appearance()

#: Exponent of the superellipse below the equator; 2 is an ellipse, a larger one is flatter below.
_POWER = 2.5

#: The scene is drawn on a grid finer than the sensor's, with edges blurred by this standard
#: deviation (px of the sensor), and blurred further afterwards. Outlines are nearly straight over
#: this width, and the cells of the finer grid, 1.1 of these widths, sample it well enough.
_SUPERSAMPLING = 2
_DRAWN_BLUR = 0.45
#: Largest distance from the outline at which it changes a pixel, px: 17 standard deviations of the
#: drawn blur, or 16 beside a wall one px thick.
_REACH = 8.0


@dataclass(frozen=True)
class Embryo(Result):
    """Shape of a rendered embryo that a probe presses from above.

    Attributes
    ----------
    modulus : float
        Elastic modulus E of the chorion, in MPa.
    force : float
        Force F of the probe, in µN; 0 is an untouched, round embryo.
    rim_radius : float
        Dimple radius a, in µm; without meaning when the force is 0.
    thickness : float
        Thickness h of the chorion, in µm.
    probe_half_width : float
        Half-width c of the probe, in µm.
    poisson_ratio : float
        Poisson ratio ν of the chorion.
    radius : float
        Radius of the untouched sphere and of the equator, in µm.

    Raises
    ------
    ValueError
        If a value is out of range or no embryo of this volume can have such a dimple.

    Notes
    -----
    The outline, the middle of the chorion, is the meridian of a body of revolution in three parts
    that share their tangents: the dimple (4.2) from the probe to the rim; a quarter ellipse from
    the rim to the equator, with the dimple's curvature at the rim; below the equator a superellipse
    of the exponent 2.5, flattened where the sensor holds it, whose depth keeps the volume constant
    (the second assumption of the model). Under the probe the membrane is flat.

    Examples
    --------
    >>> from microlib.synthetic import Embryo
    >>> embryo = Embryo(modulus=1.3237, force=197.24, rim_radius=246.95)
    >>> print(f"{embryo.dimple_depth:.2f} µm")  # Table 5.6 prints 121.22
    121.22 µm
    """

    modulus: float
    force: float
    rim_radius: float
    thickness: float = 3.0
    probe_half_width: float = 25.0
    poisson_ratio: float = 0.5
    radius: float = 600.0

    def __post_init__(self) -> None:
        for name in ("modulus", "rim_radius", "thickness", "probe_half_width", "radius"):
            object.__setattr__(self, name, as_scalar(name, getattr(self, name), above=0))
        object.__setattr__(self, "force", as_scalar("force", self.force, least=0))
        object.__setattr__(self, "poisson_ratio", as_poisson_ratio(self.poisson_ratio))
        if self.force > 0:
            as_scalar("rim_radius", self.rim_radius, above=self.probe_half_width, below=self.radius)
            if self._half_axes()[2] <= self.dimple_depth:
                raise ValueError(
                    f"rim_radius must suit an embryo of {self.radius:g} µm radius, got "
                    f"{self.rim_radius:g} µm with a dimple {self.dimple_depth:.0f} µm deep"
                )

    @classmethod
    def pressed(
        cls,
        force: float,
        *,
        modulus: float,
        rim_curvature_radius: float = 450.0,
        **properties: float,
    ) -> Embryo:
        """Return the embryo whose rim has the radius of curvature `rim_curvature_radius`.

        Parameters
        ----------
        force, modulus : float
            As in `Embryo`; the force is positive.
        rim_curvature_radius : float
            Radius of curvature of the outline at the rim, in µm.
        **properties : float
            The other attributes of `Embryo`.

        Returns
        -------
        Embryo

        Raises
        ------
        ValueError
            If no dimple between the probe's width and the embryo's has such a rim.

        Notes
        -----
        With a constant rim radius the dimple widens as the force rises and w_d grows roughly as √F.
        That is an assumption of the scene; the model itself leaves a free.

        Examples
        --------
        >>> from microlib.synthetic import Embryo
        >>> embryo = Embryo.pressed(197.24, modulus=1.3237)
        >>> print(f"radius {embryo.rim_radius:.0f} µm, depth {embryo.dimple_depth:.0f} µm")
        radius 246 µm, depth 121 µm
        """
        return cls._dimpled("force", force, modulus, rim_curvature_radius, **properties)

    @classmethod
    def dented(
        cls,
        depth: float,
        *,
        modulus: float,
        rim_curvature_radius: float = 450.0,
        **properties: float,
    ) -> Embryo:
        """Return the embryo with a dimple of a given depth; radius and force follow.

        Parameters
        ----------
        depth : float
            Dimple depth w_d, in µm, positive.
        modulus, rim_curvature_radius, **properties : float
            As in `Embryo.pressed`.

        Returns
        -------
        Embryo

        Raises
        ------
        ValueError
            If no dimple between the probe's width and the embryo's has such a depth and rim.

        Examples
        --------
        >>> from microlib.synthetic import Embryo
        >>> embryo = Embryo.dented(121.22, modulus=1.3237)
        >>> print(f"radius {embryo.rim_radius:.0f} µm, force {embryo.force:.0f} µN")
        radius 247 µm, force 198 µN
        """
        return cls._dimpled("depth", depth, modulus, rim_curvature_radius, **properties)

    @classmethod
    def _dimpled(
        cls,
        name: str,
        value: float,
        modulus: float,
        rim_curvature_radius: float,
        **properties: float,
    ) -> Embryo:
        """Return the embryo with a given force or depth, whose radius follows from the rim."""
        value = as_scalar(name, value, above=0)
        rim_curvature_radius = as_scalar("rim_curvature_radius", rim_curvature_radius, above=0)
        untouched = cls(modulus, 0.0, 1.0, **properties)

        def excess(radius: float) -> float:
            depth = _depth(untouched, value, radius) if name == "force" else value
            return (
                _rim_curvature_radius(radius, depth, untouched.probe_half_width)
                - rim_curvature_radius
            )

        # No dimple reaches the probe or the equator.
        narrowest, widest = 1.01 * untouched.probe_half_width, 0.95 * untouched.radius
        if not (narrowest < widest and excess(narrowest) < 0 < excess(widest)):
            raise ValueError(
                f"{name} must suit a dimple between the probe and the equator when the rim's "
                f"radius is {rim_curvature_radius:g} µm, got {value:g}"
            )
        radius = brentq(excess, narrowest, widest)
        # The depth grows with the cube root of the force.
        force = value if name == "force" else (value / _depth(untouched, 1.0, radius)) ** 3
        try:
            return cls(modulus, force, radius, **properties)
        except ValueError as error:
            need = "rim_curvature_radius must be that of a dimple which an embryo can have"
            raise ValueError(f"{need}, got {rim_curvature_radius:g} µm: {error}") from None

    @property
    def dimple_depth(self) -> float:
        """Depth w_d of the membrane under the probe below the rim, in µm."""
        return _depth(self, self.force, self.rim_radius) if self.force > 0 else 0.0

    @property
    def height(self) -> float:
        """Distance from the rim to the far side, in µm."""
        if self.force == 0:
            return 2 * self.radius
        _, upper, lower = self._half_axes()
        return upper + lower

    def outline(self, spacing: float = 0.25) -> Array:
        """Return the closed outline, clockwise from the middle of the dimple.

        Parameters
        ----------
        spacing : float
            Distance of the points, in µm.

        Returns
        -------
        ndarray, shape (N, 2)
            Points (x, y) in µm, x from the probe's axis to the right, y up from the rim.

        Raises
        ------
        ValueError
            If `spacing` is not positive.

        Examples
        --------
        >>> from microlib.synthetic import Embryo
        >>> embryo = Embryo(1.3237, 197.24, 246.95)
        >>> outline = embryo.outline(1.0)
        >>> print(f"from {outline[:, 1].min():.0f} µm to {abs(outline[:, 1].max()):.2f} µm")
        from -1059 µm to 0.00 µm
        """
        spacing = as_scalar("spacing", spacing, above=0, most=self.radius)
        # 0.5 µm apart or less where it is round, which leaves a chord within 0.0001 µm of it.
        count = 4001
        quarter = np.linspace(0.0, np.pi / 2, count)
        if self.force == 0:
            half = self.radius * np.stack([np.sin(2 * quarter), np.cos(2 * quarter) - 1], axis=1)
        else:
            a, c = self.rim_radius, self.probe_half_width
            across, upper, lower = self._half_axes()
            r = np.geomspace(c, a, 2 * count - 1)
            r[0], r[-1] = c, a
            dimple = -dimple_profile(r, a, self.dimple_depth, probe_half_width=c)
            power = 2 / _POWER
            above = [a + across * np.sin(quarter), upper * (np.cos(quarter) - 1)]
            below = [
                self.radius * np.cos(quarter) ** power,
                -upper - lower * np.sin(quarter) ** power,
            ]
            parts = [np.stack(part, 1)[1:] for part in (above, below)]
            tip = [[0.0, -self.dimple_depth]]
            half = np.concatenate([tip, np.stack([r, dimple], axis=1), *parts])
        closed = np.concatenate([half, half[-2::-1] * [-1, 1]])
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
        even = np.arange(0.0, length[-1] - spacing / 2, spacing)
        return np.stack([np.interp(even, length, column) for column in closed.T], axis=1)

    def _half_axes(self) -> tuple[float, float, float]:
        """Return width and height of the outline from rim to equator, and the height below, µm."""
        a, c, depth = self.rim_radius, self.probe_half_width, self.dimple_depth
        across = self.radius - a
        upper = across**2 / _rim_curvature_radius(a, depth, c)
        # Volumes over π. The dimple's integral of w r dr, with (4.2), is elementary.
        zeta2 = (c / a) ** 2
        scale = depth / (zeta2 - 1 - np.log(zeta2))
        bowl = 2 * scale * a**2 * (1 - zeta2**2 + 2 * zeta2 * np.log(zeta2)) / 4 + c**2 * depth
        above = upper * (a**2 + np.pi / 2 * a * across + 2 / 3 * across**2) - bowl
        # ∫ (1 − tⁿ)^(2/n) dt over [0, 1]; 2/3 for an ellipse.
        fullness = beta(1 / _POWER, 1 + 2 / _POWER) / _POWER
        lower = (4 / 3 * self.radius**3 - above) / (fullness * self.radius**2)
        return across, upper, lower


def _depth(embryo: Embryo, force: float, radius: float) -> float:
    """Return the depth by (4.7), also where its assumption of small slopes does not hold."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SmallSlopeWarning)
        return float(
            dimple_depth(
                force,
                radius,
                modulus=embryo.modulus,
                thickness=embryo.thickness,
                probe_half_width=embryo.probe_half_width,
                poisson_ratio=embryo.poisson_ratio,
            )
        )


def _rim_curvature_radius(radius: float, depth: float, probe_half_width: float) -> float:
    """Return the radius of curvature of (4.2) at r = a."""
    zeta2 = (probe_half_width / radius) ** 2
    return radius**2 * (zeta2 - 1 - np.log(zeta2)) / (4 * depth)


@dataclass(frozen=True, eq=False, repr=False)
class EmbryoImage(Result):
    """A rendered embryo with its ground truth.

    Attributes
    ----------
    image : ndarray of uint8, shape (rows, columns)
        Grey levels.
    embryo : Embryo
        The embryo in the image, with modulus, force and dimple.
    pixel_size : float
        Pixel in the object, in µm.
    center : tuple of float
        Where the probe's axis crosses the height of the rim, (x, y) in px.
    tilt : float
        Angle by which the scene is turned clockwise about `center`, in radians.
    """

    image: NDArray[np.uint8]
    embryo: Embryo
    pixel_size: float
    center: tuple[float, float]
    tilt: float

    def to_pixels(self, points: Array) -> Array:
        """Return points in µm of the embryo's frame (y up from the rim) as image points, in px."""
        x, y = as_array("points", points, shape=(None, 2)).T / self.pixel_size
        cos, sin = np.cos(self.tilt), np.sin(self.tilt)
        return np.stack(
            [self.center[0] + cos * x + sin * y, self.center[1] + sin * x - cos * y], axis=1
        )


def embryo_image(
    embryo: Embryo,
    *,
    rng: np.random.Generator | int,
    pixel_size: float = 4.65 / 1.2,
    shape: tuple[int, int] = (768, 1024),
    center: tuple[float, float] | None = None,
    tilt: float = 0.0,
    blur: float = 1.0,
    noise: float = 2.0,
    unevenness: float = 0.1,
    probe: bool = True,
) -> EmbryoImage:
    """Render an embryo between a force-sensing probe (below) and an AFM probe (above).

    Parameters
    ----------
    embryo : Embryo
        The embryo in the image.
    rng : numpy.random.Generator or int
        Random generator of illumination, texture and noise, or its seed.
    pixel_size : float
        Pixel size in the object plane, in µm; by default that of the Sony XCD-X710CR (4.65 µm
        pixels) behind the magnification 1.2.
    shape : tuple of int
        Rows and columns of the image; by default that camera's.
    center : tuple of float, optional
        Point on the axis of the probe at the height of the rim, (x, y) in px; by default the embryo
        is in the middle of the image.
    tilt : float
        Clockwise turn of the scene about `center`, in radians.
    blur : float
        Standard deviation of the Gaussian point spread function, in px, at least 0.5.
    noise : float
        Standard deviation of the noise, in grey levels of 255.
    unevenness : float
        Largest relative deviation of the light from its mean, below 0.5.
    probe : bool
        Whether the two probes are in the scene.

    Returns
    -------
    EmbryoImage
        The `image` and its ground truth: `embryo`, `pixel_size`, `center` and `tilt`. `to_pixels`
        converts points of the embryo to the image.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    The chorion is a dark line of its own thickness around a slightly darker fluid, as in
    transmitted light; each edge is drawn at its exact place and blurred by the point spread
    function and the sensor's square pixels. Only the meridian is drawn. Unlike in a real image, the
    near part of the rim does not cover the dimple.

    Examples
    --------
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> scene = embryo_image(Embryo.pressed(100.0, modulus=1.0), rng=1)
    >>> scene.image.shape, scene.image.dtype.name
    ((768, 1024), 'uint8')
    """
    rng = as_generator("rng", rng)
    pixel_size = as_scalar("pixel_size", pixel_size, above=0)
    rows, columns = as_image_shape("shape", shape, least=64)
    tilt = as_scalar("tilt", tilt, least=-np.pi, most=np.pi)
    blur = as_scalar("blur", blur, least=0.5)  # above the blur of the drawing
    noise = as_scalar("noise", noise, least=0)
    unevenness = as_scalar("unevenness", unevenness, least=0, most=0.5)
    if center is None:
        center = ((columns - 1) / 2, (rows - 1 - embryo.height / pixel_size) / 2)
    x, y = as_array("center", center, shape=(2,)).tolist()
    if not embryo.radius / pixel_size > 4:
        raise ValueError(
            f"pixel_size must show the embryo's radius of {embryo.radius:g} µm by at least 4 px, "
            f"got {pixel_size:g} µm"
        )
    blank = np.zeros((rows, columns), dtype=np.uint8)
    frame = EmbryoImage(blank, embryo, pixel_size, (x, y), tilt)

    remaining = np.sqrt(blur**2 - _DRAWN_BLUR**2) * _SUPERSAMPLING
    drawn = _draw(frame, rng, probe)
    blurred = cv2.GaussianBlur(drawn, (0, 0), remaining, borderType=cv2.BORDER_REPLICATE)
    clean = cv2.resize(blurred, (columns, rows), interpolation=cv2.INTER_AREA)
    lit = clean * _light((rows, columns), unevenness, rng)
    return replace(frame, image=eight_bits(lit + rng.normal(0.0, noise, lit.shape)))


def _draw(frame: EmbryoImage, rng: np.random.Generator, probe: bool) -> NDArray[np.float32]:
    """Return the grey levels of the scene under even light, on the finer grid."""
    embryo, pixel = frame.embryo, frame.pixel_size
    inside = _signed_distance(frame, embryo.outline(embryo.radius / 2400))
    body = ndtr(inside / _DRAWN_BLUR)
    scene = _APPEARANCE.ground + (_APPEARANCE.fluid - _APPEARANCE.ground) * body

    x, y = _embryo_coordinates(frame)
    yolk = body * ndtr(_yolk_depth(embryo, x, y) / (_APPEARANCE.yolk_fade * pixel))
    white = rng.standard_normal(x.shape, dtype=np.float32)
    texture = cv2.GaussianBlur(white, (0, 0), _APPEARANCE.grain_blur)
    scene += yolk * (
        _APPEARANCE.yolk - _APPEARANCE.fluid + _APPEARANCE.grain * texture / np.std(texture)
    )

    half = embryo.thickness / pixel / 2
    line = ndtr((inside + half) / _DRAWN_BLUR) - ndtr((inside - half) / _DRAWN_BLUR)
    scene += line * (_APPEARANCE.chorion - scene)
    if probe:
        tip = -embryo.dimple_depth + embryo.thickness / 2
        seat = -embryo.height - embryo.thickness / 2
        for grey, half_width, depth in (
            (_APPEARANCE.probe, embryo.probe_half_width, y - tip),
            (_APPEARANCE.sensor, _APPEARANCE.sensor_half_width * embryo.radius, seat - y),
        ):
            bar = ndtr((half_width - np.abs(x)) / pixel / _DRAWN_BLUR)
            bar *= ndtr(depth / pixel / _DRAWN_BLUR)
            scene += bar * (grey - scene)
    return scene.astype(np.float32)


def _embryo_coordinates(frame: EmbryoImage) -> tuple[Array, Array]:
    """Return (x, y) of every point of the finer grid in the embryo's frame, µm."""
    rows, columns = frame.image.shape
    # Centers of the fine cells: pixel k of the sensor covers k − ½ to k + ½.
    u = (np.arange(columns * _SUPERSAMPLING) + 0.5) / _SUPERSAMPLING - 0.5 - frame.center[0]
    v = (np.arange(rows * _SUPERSAMPLING) + 0.5) / _SUPERSAMPLING - 0.5 - frame.center[1]
    cos, sin = np.cos(frame.tilt), np.sin(frame.tilt)
    x = cos * u[np.newaxis, :] + sin * v[:, np.newaxis]
    y = sin * u[np.newaxis, :] - cos * v[:, np.newaxis]
    return x * frame.pixel_size, y * frame.pixel_size


def _signed_distance(frame: EmbryoImage, outline: Array) -> Array:
    """Return the distance of the finer grid's points to the outline, px, positive inside.

    It is exact within a few pixels of the outline and clipped beyond, where it has no effect.
    """
    fine = (frame.to_pixels(outline) + 0.5) * _SUPERSAMPLING - 0.5
    rows, columns = (n * _SUPERSAMPLING for n in frame.image.shape)
    mask = np.zeros((rows, columns), dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(fine * 2**4).astype(np.int32)], 1, shift=4)
    distance = np.where(mask > 0, _REACH, -_REACH)

    band = np.zeros((rows, columns), dtype=np.uint8)
    thickness = int(2 * _REACH * _SUPERSAMPLING)
    cv2.polylines(band, [np.rint(fine).astype(np.int32)], True, 1, thickness)
    v, u = np.nonzero(band)
    points = np.stack([u, v], axis=1).astype(np.float64)
    tangent = np.roll(fine, -1, axis=0) - np.roll(fine, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # The outline runs clockwise as seen on the screen, so that the inside is on its right.
    inward = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    _, nearest = cKDTree(fine).query(points)
    offset = points - fine[nearest]
    along_normal = np.einsum("ij,ij->i", offset, inward[nearest])
    distance[v, u] = np.clip(along_normal / _SUPERSAMPLING, -_REACH, _REACH)
    return distance


def _yolk_depth(embryo: Embryo, x: Array, y: Array) -> Array:
    """Return the depth of points inside the yolk, an ellipse inside the chorion, in µm."""
    top = -embryo.dimple_depth - _APPEARANCE.yolk_gap * embryo.radius
    bottom = -embryo.height + _APPEARANCE.yolk_gap * embryo.radius
    half_width = _APPEARANCE.yolk_half_width * embryo.radius
    half_height = min((top - bottom) / 2, half_width)
    level = np.hypot(x / half_width, (y - (top + bottom) / 2) / half_height)
    return (1.0 - level) * min(half_width, half_height)


def _light(shape: tuple[int, int], unevenness: float, rng: np.random.Generator) -> Array:
    """Return the relative illumination: a gradient and a vignette of random strength."""
    v, u = (np.linspace(-1.0, 1.0, n) for n in shape)
    slope_x, slope_y = rng.uniform(-1.0, 1.0, 2)
    fall = rng.uniform(0.0, 1.0)
    field = slope_x * u[np.newaxis, :] + slope_y * v[:, np.newaxis]
    field = field - fall * (u[np.newaxis, :] ** 2 + v[:, np.newaxis] ** 2)
    field = field - field.mean()
    return 1.0 + unevenness * field / np.abs(field).max()
