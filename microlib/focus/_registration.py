"""Undo what moves and flickers while the focus is moved: shift, rotation, scale, brightness.

Neighboring frames are compared, and those two apart; see `microlib.focus._links`. A first pass
leaves the change of blur free but smooth. It serves for a first depth, and with that the second
pass knows the change of blur of every pixel but for one factor.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.focus._links import (
    LAG_TWO,
    Link,
    basis,
    fit_link,
    laplacian,
    motion_columns,
    spread_over_stack,
)
from microlib.focus._poses import Frame, Geometry, reduced
from microlib.focus._registered import SATURATED, Registered

__all__ = ["register"]

#: Frames at hand and their positions to a depth of each pixel.
Depth = Callable[[NDArray, Array], NDArray]

#: Least shorter side of the frames that are compared, px: they are halved as long as it stays
#: above, but not more often than `_MOST_HALVINGS`. Table "working size" of benchmarks/registration.
_LEAST_SIDE, _MOST_HALVINGS = 90, 3
#: Least side of a frame that can be registered, px: what is smaller has no band of frequencies.
_SMALLEST = 32
#: Least shorter side of the coarsest level, and how often the links are fitted at each level in the
#: first pass, px and 1: half a pixel of the coarsest is what one fit can find.
_COARSEST_SIDE, _FITS = 20, 3
#: Band of spatial frequencies that motion is found from: standard deviations of the Gaussians,
#: full px. What is finer is noise, what is coarser is light.
_FINE, _COARSE = 1.0, 30.0
#: Smoothing before brightness is compared, px of the second level: what is finer differs by blur.
_SMOOTH = 1.5
#: Change of half the blur's variance at which a pixel counts half, px² of the level: the model of
#: small changes holds below.
_BLUR_CHANGE = 0.4
#: Share of the links, those nearest to focus, that tell how fast the blur grows, %.
_NEAR_FOCUS = 20
#: Typical offset between neighbors, over the mean grey level, from which on there is one. Fits on
#: stacks without offsets find up to 0.009; a neglected one costs what 1 % of flicker does.
_OFFSET = 0.01
#: A link is trusted if its frames correlate by more and its motion departs by less from that of the
#: links beside it, 1 and px of the first pass's last level. Noise and foreign frames: below 0.2 and
#: above 0.5; frames whose blur differs much, in the stack pcb: 0.85 and 0.04.
_CORRELATION, _CLOSURE = 0.5, 0.125
#: Correlation that a link is given at least, so that it still ties its frames together.
_LEAST_CORRELATION = 0.01


@dataclass(frozen=True)
class _Level:
    """All frames at one size, with where they may be compared."""

    geometry: Geometry
    images: list[NDArray[np.float32]]
    usable: list[NDArray[np.float32]]

    def corrected(self, frames: Sequence[Frame]) -> tuple[list[NDArray], list[NDArray]]:
        """Return the images as the reference's camera would have taken them, and their weights."""
        images, weights = [], []
        for image, usable, frame in zip(self.images, self.usable, frames, strict=True):
            warped = self.geometry.warped(image, frame, flags=cv2.INTER_CUBIC)
            images.append((warped - np.float32(frame.offset)) / self.geometry.gain(frame))
            seen = self.geometry.warped(usable, frame, flags=cv2.INTER_LINEAR) > 1 - 1e-3
            weight = (seen & self.geometry.inside(frame)).astype(np.float32)
            # The outermost pixels have no derivatives.
            weight[[0, -1]] = weight[:, [0, -1]] = 0
            weights.append(weight)
        return images, weights

    def halved(self) -> _Level:
        """Return the level of half the size."""
        return _Level(
            Geometry(self.geometry.shape, 2 * self.geometry.factor),
            [reduced(image, 2) for image in self.images],
            [(reduced(usable, 2) > 1 - 1e-3).astype(np.float32) for usable in self.usable],
        )


def register(source: Iterator[Image], positions: Array, depth: Depth) -> Registered:
    """Find how the frames of a stack lie beside each other, relative to the middle one.

    Parameters
    ----------
    source : iterator of ndarray, shape (rows, cols)
        The frames, which are held at reduced size.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    depth : callable
        Depths of a stack of reduced frames from it and its positions, in the same unit; NaN where
        they are not known.

    Returns
    -------
    Registered

    Raises
    ------
    ValueError
        If there are not as many frames as positions, or less than half of the frames are tied to
        each other by links that can be trusted; the others are named.

    Warns
    -----
    UserWarning
        If some frames are left out for that reason.
    """
    work, saturation = _read(source, len(positions))
    levels = [work]
    while min(levels[-1].geometry.small) >= 2 * _COARSEST_SIDE:
        levels.append(levels[-1].halved())
    count = len(positions)
    links = [(k, k + lag) for lag in (1, 2) for k in range(count - lag)]
    frames = [Frame.same()] * count
    coarsest = levels[-1]
    frames = _equally_bright(coarsest, frames, links)
    for level in levels[:0:-1] or levels:
        for _ in range(_FITS):
            frames, left, correlation = _aligned(level, frames, links)
    kept = _kept(links, left, correlation, count, level.geometry)
    links = [(k, k + lag) for lag in (1, 2) for k in range(len(kept) - lag)]
    frames = _from_reference([frames[k] for k in kept])
    z = positions[kept]
    levels = [_chosen(level, kept) for level in levels[:2]]
    work = levels[0]
    frames = _equally_bright(levels[-1], frames, links)
    found = _filled(depth(np.stack(work.corrected(frames)[0]), z))
    frames = _equally_bright_at(levels[-1], frames, links, z, found)
    frames = _aligned_at(work, frames, links, z, found)
    return Registered(
        frames, kept, correlation[: count - 1], Geometry(work.geometry.shape, 1), saturation
    )


def _read(source: Iterator[Image], count: int) -> tuple[_Level, float]:
    """Return the frames at the working size, and the level at which the camera saturates."""
    images, brightest, full = [], [], []
    factor = 1
    for k, image in enumerate(source):
        if k == 0:
            if min(image.shape) < _SMALLEST:
                raise ValueError(
                    f"frames must be at least {_SMALLEST} px on each side to be registered, "
                    f"got {image.shape}"
                )
            for _ in range(_MOST_HALVINGS):
                factor *= 2 if min(image.shape) >= 2 * factor * _LEAST_SIDE else 1
            geometry = Geometry((image.shape[0], image.shape[1]), factor)
        images.append(reduced(image, factor))
        most = float(image.max())
        brightest.append(most)
        small = tuple(slice(None, n * factor) for n in geometry.small)
        # A pixel is as bright as the brightest of its block.
        full.append(_block_maximum(image[small], factor))
    if len(images) != count:
        raise ValueError(f"frames and positions must be as many, got {len(images)} and {count}")
    saturation = _saturation(image.dtype, brightest, full)
    usable = [(block < SATURATED * saturation).astype(np.float32) for block in full]
    return _Level(geometry, images, usable), saturation


def _block_maximum(image: Image, factor: int) -> Image:
    result = image[::factor, ::factor].copy()
    for dy in range(factor):
        for dx in range(factor):
            np.maximum(result, image[dy::factor, dx::factor], out=result)
    return result


#: Least share of a frame's pixels at the highest level for the camera to be saturated there.
_PLATEAU = 1e-4


def _saturation(dtype: np.dtype, brightest: Sequence[float], blocks: Sequence[Image]) -> float:
    """Return the level at which the camera saturates: the top of 8 bits, or a plateau below 16."""
    most = max(brightest)
    if dtype.kind != "u" or (dtype == np.uint8 and most < np.iinfo(np.uint8).max):
        return float("inf")
    share = max(np.mean(block >= most) for block in blocks)
    return most if share >= _PLATEAU else float("inf")


def _aligned(
    level: _Level, frames: list[Frame], links: Sequence[Link]
) -> tuple[list[Frame], Array, Array]:
    """Fit the motion of all links with a smooth change of blur.

    Also returned are what is left of each link's motion, and the correlation of its frames.
    """
    images, weights = level.corrected(frames)
    bands = [_band(image, level.geometry.factor) for image in images]
    x, y = level.geometry.coordinates()
    shapes = basis(*_unit(level.geometry))
    factor = np.float32(level.geometry.factor)
    motions, correlation = np.zeros((len(links), 4)), np.zeros(len(links))
    for k, (i, j) in enumerate(links):
        mean, difference = (bands[i] + bands[j]) / 2, bands[j] - bands[i]
        weight = weights[i] * weights[j]
        columns = motion_columns(mean, x / factor, y / factor)
        columns += [mean, *(shapes * laplacian(mean))]
        found = fit_link(columns, difference, weight)[:4]
        motions[k] = found * (1, 1, factor, factor)
        correlation[k] = _correlation(bands[i], bands[j], weight)
    # A foreign frame shall not move those around it.
    sure = _weights(links) * np.maximum(correlation, _LEAST_CORRELATION) ** 4
    steps = spread_over_stack(len(frames), links, motions, sure, len(frames) // 2)
    i, j = np.transpose(links)
    left = motions - (steps[j] - steps[i])
    return _moved(frames, steps), left, correlation


def _aligned_at(
    level: _Level, frames: list[Frame], links: Sequence[Link], positions: Array, depth: NDArray
) -> list[Frame]:
    """Fit the motion of all links where the blur of each pixel is known but for one factor."""
    images, weights = level.corrected(frames)
    bands = [_band(image, level.geometry.factor) for image in images]
    x, y = level.geometry.coordinates()
    factor = np.float32(level.geometry.factor)

    def columns(i: int, j: int, mean: NDArray) -> list[NDArray]:
        return [*motion_columns(mean, x / factor, y / factor), mean]

    found = _fit_near_focus(bands, weights, links, positions, depth, columns)
    motions = found[:, :4] * np.array([1, 1, factor, factor], float)
    return _moved(frames, _steps(len(frames), links, motions))


def _equally_bright(level: _Level, frames: list[Frame], links: Sequence[Link]) -> list[Frame]:
    """Give the frames gains that make the smoothed ones alike."""
    images, weights = level.corrected(frames)
    smooth = [cv2.GaussianBlur(image, (0, 0), _SMOOTH) for image in images]
    weights = [_away(weight) for weight in weights]
    shapes = basis(*_unit(level.geometry))
    found = np.zeros((len(links), 6))
    for k, (i, j) in enumerate(links):
        mean = (smooth[i] + smooth[j]) / 2
        found[k] = fit_link(list(shapes * mean), smooth[j] - smooth[i], weights[i] * weights[j])
    gains = spread_over_stack(len(frames), links, found, _weights(links), len(frames) // 2)
    return [frame.brighter(gain, 0.0) for frame, gain in zip(frames, gains, strict=True)]


def _equally_bright_at(
    level: _Level, frames: list[Frame], links: Sequence[Link], positions: Array, depth: NDArray
) -> list[Frame]:
    """Give the frames gains and, if there are any, offsets, from what blurs known."""
    images, weights = level.corrected(frames)
    smooth = [cv2.GaussianBlur(image, (0, 0), _SMOOTH) for image in images]
    weights = [_away(weight) for weight in weights]
    shapes = basis(*_unit(level.geometry))
    rows, cols = level.geometry.small
    small = cv2.resize(depth, (cols, rows), interpolation=cv2.INTER_AREA)

    def columns(i: int, j: int, mean: NDArray) -> list[NDArray]:
        return [*(shapes * mean), np.ones_like(mean)]

    found = _fit_near_focus(smooth, weights, links, positions, small, columns)[:, :7]
    mean = float(np.mean([image.mean() for image in smooth]))
    offsets = np.array([frame.offset for frame in frames])
    i, j = np.transpose(links)
    if np.median(np.abs(found[:, 6] + offsets[j] - offsets[i])) < _OFFSET * abs(mean):
        found = _fit_near_focus(
            smooth, weights, links, positions, small, lambda i, j, m: list(shapes * m)
        )
        found[:, 6] = 0
    values = spread_over_stack(len(frames), links, found, _weights(links), len(frames) // 2)
    return [frame.brighter(v[:6], v[6]) for frame, v in zip(frames, values, strict=True)]


def _away(weight: NDArray) -> NDArray:
    """Return the weights without pixels into which the smoothing brings saturated ones."""
    side = 2 * round(2 * _SMOOTH) + 1
    return np.asarray(cv2.erode(weight, np.ones((side, side), np.uint8)))


def _fit_near_focus(
    images: Sequence[NDArray],
    weights: Sequence[NDArray],
    links: Sequence[Link],
    positions: Array,
    depth: NDArray,
    columns: Callable[[int, int, NDArray], list[NDArray]],
) -> Array:
    """Fit all links with pixels weighted by how little their blur changes.

    Half the variance of the blur changes between positions p and p' of a surface at z by
    s·((p' − z)² − (p − z)²)/2, with one s for the stack.
    """
    distances = [((position - depth) ** 2).astype(np.float32) / 2 for position in positions]
    growth = _blur_growth(images, weights, links, distances)
    rows = []
    for i, j in links:
        mean, difference = (images[i] + images[j]) / 2, images[j] - images[i]
        blur = np.float32(growth) * (distances[j] - distances[i])
        second = laplacian(mean)
        # Blur of no Gaussian differs by the fourth derivative too.
        fourth = np.float32(growth) * (distances[i] + distances[j]) * blur * laplacian(second)
        weight = weights[i] * weights[j] / (1 + (blur / np.float32(_BLUR_CHANGE)) ** 2)
        rows.append(fit_link([*columns(i, j, mean), blur * second, fourth], difference, weight))
    return np.array(rows)


def _blur_growth(
    images: Sequence[NDArray],
    weights: Sequence[NDArray],
    links: Sequence[Link],
    distances: Sequence[NDArray],
) -> float:
    """Return half the variance of the blur, px², at one unit of squared distance from focus."""
    near, found = [], []
    for i, j in links:
        change = distances[j] - distances[i]
        mean = (images[i] + images[j]) / 2
        weight = weights[i] * weights[j]
        size = float(np.abs(change).mean()) or 1.0
        columns = [mean, change * laplacian(mean)]
        weight = weight / (1 + (change / size) ** 2)
        found.append(fit_link(columns, images[j] - images[i], weight)[1])
        near.append(np.median(distances[i] + distances[j]))
    use = np.array(near) <= np.percentile(near, _NEAR_FOCUS)
    return max(float(np.median(np.array(found)[use])), 0.0)


def _steps(count: int, links: Sequence[Link], motions: Array) -> Array:
    return spread_over_stack(count, links, motions, _weights(links), count // 2)


def _moved(frames: list[Frame], steps: Array) -> list[Frame]:
    return [frame.moved(step) for frame, step in zip(frames, steps, strict=True)]


def _weights(links: Sequence[Link]) -> Array:
    return np.array([1.0 if j == i + 1 else LAG_TWO for i, j in links])


def _from_reference(frames: list[Frame]) -> list[Frame]:
    """Return the frames relative to the middle one."""
    middle = frames[len(frames) // 2]
    return [
        Frame(
            frame.turn / middle.turn,
            frame.shift - frame.turn / middle.turn * middle.shift,
            frame.log_gain - middle.log_gain,
            0.0,
        )
        for frame in frames
    ]


def _chosen(level: _Level, kept: NDArray[np.intp]) -> _Level:
    return _Level(level.geometry, [level.images[k] for k in kept], [level.usable[k] for k in kept])


def _unit(geometry: Geometry) -> tuple[NDArray, NDArray]:
    x, y = geometry.coordinates()
    half = np.float32(max(geometry.shape) / 2)
    return x / half, y / half


def _band(image: NDArray, factor: int) -> NDArray:
    """Return the spatial frequencies that motion is found from."""
    fine = cv2.GaussianBlur(image, (0, 0), max(_FINE, factor / 2) / factor)
    wide = cv2.GaussianBlur(image, (0, 0), _COARSE / factor)
    return np.asarray(fine - wide)


def _correlation(first: NDArray, second: NDArray, weight: NDArray) -> float:
    a, b = first * weight, second * weight
    norm = float(np.sqrt(np.vdot(a, a))) * float(np.sqrt(np.vdot(b, b)))
    return float(np.vdot(a, b)) / norm if norm > 0 else 0.0


def _kept(
    links: Sequence[Link], left: Array, correlation: Array, count: int, geometry: Geometry
) -> NDArray[np.intp]:
    """Return the frames that trusted links tie to the middle of the stack, or refuse the stack.

    A trusted link correlates, and agrees with the links beside it: what is left of its motion after
    all have been fitted is small, at the border of the image too.
    """
    half = max(geometry.shape) / 2
    off = np.abs(left) @ (half, half, 1, 1) / geometry.factor
    trusted = (correlation > _CORRELATION) & (off < _CLOSURE)
    group = np.arange(count)
    for (i, j), good in zip(links, trusted, strict=True):
        if good:
            group[group == group[j]] = group[i]
    largest = np.bincount(group).argmax()
    kept = np.flatnonzero(group == largest)
    if len(kept) == count:
        return kept
    broken = [
        (i, j) for (i, j), good in zip(links, trusted, strict=True) if not good and j == i + 1
    ]
    names = ", ".join(f"{i}–{j}" for i, j in broken[:5]) + (" …" if len(broken) > 5 else "")
    what = f"frames {names} cannot be registered to each other"
    if len(kept) < max(3, count / 2):
        raise ValueError(
            f"frames must show one scene to be registered, got {len(kept)} of {count} that do; "
            f"{what}"
        )
    out = ", ".join(str(k) for k in np.setdiff1d(np.arange(count), kept))
    warnings.warn(f"{what}: left out: {out}", stacklevel=6)
    return kept


def _filled(depth: NDArray) -> NDArray:
    """Return the depth with its median where it is not known: there is little to see there."""
    known = np.isfinite(depth)
    if not known.any():
        return np.zeros_like(depth, np.float32)
    return np.where(known, depth, np.median(depth[known])).astype(np.float32)
