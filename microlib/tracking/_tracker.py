"""Template tracking by efficient second-order minimization over a pyramid (§5.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import hadamard

from microlib._common import (
    Array,
    Image,
    Tidy,
    as_array,
    as_image,
    items,
    of_kind,
    one_of,
    scalar,
    whole,
)
from microlib.tracking._esm import (
    MOTIONS,
    Alignment,
    Level,
    apply_homography,
    half_pixel,
    make_level,
)
from microlib.tracking._kalman import KalmanFilter

# What each of these is worth is in the benchmark of tracking, table "Constants", where they are
# changed one at a time; success means there templates of 50 px whose corners moved by 15 px.

#: Least width and height (px) of the coarsest template, and of any: `levels` chooses otherwise. The
#: same results from 4 to 12; with 24 (one halving) 4 % fewer homographies are found.
_COARSEST = 6

#: Below this width or height (px) a template says where it is, but not how it is deformed. With 6
#: only 66 % instead of 92 % of the homographies are found, with 24 88 %.
_DEFORMABLE = 12

#: Corner step (px of the level) that ends a coarse level, and the last one: the next step of a
#: second-order method is smaller than the square of it. From half to twice the one, and from a
#: fifth to ten times the other, only the number of steps changes.
_TOLERANCE, _LAST_TOLERANCE = 0.5, 0.05

#: Most steps of one level: a converging one takes 1 to 6. The same success from 8 to 30; with 4 3 %
#: fewer homographies are found.
_MOST_STEPS = 15

#: Correlation that an attempt must reach to be convincing, whatever the noise. 0.8 is as good here;
#: 0.95 rejects 3 % of the homographies.
_CONVINCING = 0.9

#: An attempt must also come as near to 1 as the last accepted one, within this factor. From 1 to 4
#: the same results; without it only half of the jumps along a gripper's jaws are found.
_NOISE_FACTOR = 2.0

#: Loss of correlation that interpolation alone may cause, where there is no noise. The same
#: success from 0 to 0.01.
_INTERPOLATION_LOSS = 0.002

#: Side (px) above which a template is halved for the search by correlation, at twice this once. It
#: saves time only: a template of 200 px that jumped by 150 px is found in 10 ms, in 13 ms unhalved.
_LARGEST_MATCHED = 64

#: How far a distorted start moves each corner coordinate, in sides of the template. Without
#: distorted starts 76 % of the homographies are found, with half and with twice the distance 90 %
#: and 88 %.
_DISTORTION = 0.17

#: Correlation below which a distorted start is given up at a coarse resolution; right ones have
#: more. At 0.9 2 % fewer homographies are found; without it a lost frame takes a third longer.
_PROMISING = 0.8

#: Margin (px) around the template that the last level samples; it starts a fraction of a pixel
#: away. The same results from 3 on; without it errors are 15 % larger.
_LAST_MARGIN = 6.0

#: Least share of the template's contrast that a resolution must keep to be used: white noise keeps
#: 22 % at the finest and 1.6 % after three halvings, a chessboard of 2 px none after one. The same
#: results from 0 to 0.1 on textures of 1 px: a guard against following noise.
_LEAST_CONTRAST = 0.01

#: Least ratio of the weaker to the stronger eigenvalue of the gradients' second moments: textures
#: and grippers have 0.2 to 0.9, a straight edge has none. A guard against edges without noise only:
#: with one of 0.5 % of the step's height an edge has 0.002.
_LEAST_CORNERNESS = 1e-4

#: A move of a corner, in half template sizes, that is none but for rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Track(Tidy):
    """Where the template is in one frame.

    Attributes
    ----------
    corners : ndarray, shape (4, 2)
        Corners of the box as (x, y) in px, in the order of the box: first row left and right, last
        row right and left. The last good ones (moved on by the Kalman filter, if there is one) when
        `lost`.
    lost : bool
        Whether the template was not found.
    reason : str
        Empty, or why it was not: ``"singular"``, ``"diverged"``, ``"out of view"`` or ``"low
        correlation"``.
    correlation : float
        Normalized correlation of the template and the frame under the warp, −1 to 1.
    homography : ndarray, shape (3, 3)
        Maps px of the template's frame to px of this frame.
    gain, bias : float
        The frame's grey values are ``gain``·template + ``bias``.
    visible : float
        Share of the template's pixels inside the frame.
    iterations : int
        Steps of the attempt that was kept, all resolutions together.
    covariance : ndarray, shape (2, 2)
        Covariance of `center` in px², from the residual of the alignment; NaN when `lost`.
    """

    corners: Array
    lost: bool
    reason: str
    correlation: float
    homography: Array
    gain: float
    bias: float
    visible: float
    iterations: int
    covariance: Array

    @property
    def center(self) -> Array:
        """Mean of the corners, (x, y) in px: the feature that §5.4 servos on."""
        return self.corners.mean(axis=0)


class ESMTracker:
    """Track a template through grey frames by efficient second-order minimization.

    Gain and bias are estimated along with the motion, on a template and a warped frame smoothed in
    the template's coordinates. A search begins at the finest resolution; while the correlation is
    not convincing it begins again from coarser ones, and in the end from the best match by
    correlation in the surroundings. A template that may deform, and was seen in the frame before,
    is not given up until the search has begun from 32 distortions of it. Resolutions with fewer
    than 12 px a side estimate the translation only. A last level without smoothing samples the
    frame at half pixels, which removes most of the error of bilinear interpolation.

    Parameters
    ----------
    image : array_like, shape (H, W)
        The frame with the template, grey.
    box : tuple of int
        (x, y, width, height) of the template in px: columns x … x + width − 1, rows y … y + height
        − 1.
    motion : {"homography", "affine", "translation"}
        Group of warps.
    levels : int, optional
        Resolutions of the pyramid, each half of the one before; 1 means none. By default as many as
        leave the coarsest template at least 6 px wide and high.
    smoothing : float, optional
        Standard deviation of the Gaussian in px of each resolution. Without a pyramid about 3 px
        reach as far as the default with one.
    least_correlation : float, optional
        Normalized correlation below which the template counts as lost.
    kalman : KalmanFilter, optional
        Predicts where each frame's search starts. By default a search starts where the last one
        ended.

    Raises
    ------
    ValueError
        If the box leaves the image or is smaller than 6 px, or the template is flat, has a gradient
        along one direction only, so that it cannot be located, or is so fine that the smoothing
        leaves nothing of it.

    References
    ----------
    .. [1] E. Malis, "Improving vision-based control using efficient second-order minimization
       techniques", IEEE International Conference on Robotics and Automation, 2004.
    .. [2] S. Benhimane and E. Malis, "Real-time image-based tracking of planes using efficient
       second-order minimization", IEEE/RSJ International Conference on Intelligent Robots and
       Systems, 2004.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> image = cv2.GaussianBlur(rng.uniform(0, 255, (120, 120)).astype(np.float32), (0, 0), 2)
    >>> tracker = ESMTracker(image, (40, 30, 50, 50))
    >>> track = tracker.track(np.roll(image, (3, -5), axis=(0, 1)))
    >>> track.lost, (track.corners[0] - (40, 30)).round(2) + 0.0
    (False, array([-5.,  3.]))
    """

    def __init__(
        self,
        image: ArrayLike,
        box: tuple[int, int, int, int],
        motion: str = "homography",
        *,
        levels: int | None = None,
        smoothing: float = 1.25,
        least_correlation: float = 0.7,
        kalman: KalmanFilter | None = None,
    ) -> None:
        frame = as_image("image", image)
        motion = one_of("motion", motion, MOTIONS)
        x, y, width, height = self._box = _checked_box(box, frame.shape)
        if levels is None:
            levels = 1 + int(np.log2(min(width, height) / _COARSEST))
        levels = whole("levels", levels, least=1)
        if min(width, height) < _COARSEST * 2 ** (levels - 1):
            raise ValueError(
                f"levels must leave {_COARSEST} px of a box of {width}×{height} px, got {levels}"
            )
        smoothing = scalar("smoothing", smoothing, above=0, most=1e3)
        if kalman is not None:
            of_kind("kalman", kalman, KalmanFilter)
        self._least_correlation = scalar("least_correlation", least_correlation, within=(0.0, 1.0))
        self._shape = frame.shape
        self._kalman = kalman
        self._last_correlation, self._gain = 1.0, 1.0
        self._found = True
        size = max(width, height) / 2
        self._start = np.array(
            [[size, 0, x + (width - 1) / 2], [0, size, y + (height - 1) / 2], [0, 0, 1.0]]
        )
        self._pose = self._start
        self._levels = [
            make_level(
                layer,
                self._box,
                self._start,
                step=2**halvings,
                density=1,
                smoothing=smoothing,
                motion=motion if min(width, height) >= _DEFORMABLE * 2**halvings else "translation",
            )
            for halvings, layer in enumerate(_pyramid(frame, levels))
        ]
        self._refinement = make_level(
            half_pixel(frame),
            self._box,
            self._start,
            step=1,
            density=2,
            smoothing=0.0,
            motion=motion,
        )
        _check_texture(self._refinement)
        least = _LEAST_CONTRAST * self._refinement.contrast
        if self._levels[0].contrast < least:
            raise ValueError(
                f"smoothing must leave {100 * _LEAST_CONTRAST:g} % of the template's contrast of "
                f"{self._refinement.contrast:.3g}, got {self._levels[0].contrast:.3g} "
                f"with {smoothing:g} px"
            )
        while self._levels[-1].contrast < least:
            self._levels.pop()  # a texture too fine for this resolution, which would follow noise
        sizes = [len(level.basis) for level in self._levels]
        self._deformable = sizes.count(len(self._refinement.basis))
        # At the finest resolution alone each would cost as much as a whole search.
        several = self._deformable > 1
        self._distortions = _distortions(self._refinement.corners, motion) if several else []

    def track(self, frame: ArrayLike) -> Track:
        """Find the template in the next frame.

        Parameters
        ----------
        frame : array_like, shape (H, W)
            Grey frame of the size of the first one.

        Returns
        -------
        Track
            ``lost`` says if the template was not found, and ``reason`` why; the next search then
            starts from the last good pose, moved on by the Kalman filter if there is one.

        Raises
        ------
        ValueError
            If the frame is no grey image of that size, or not finite where the template is sought.
        """
        if type(frame) is not np.ndarray:
            frame = as_array("frame", frame)
        if frame.shape != self._shape:
            raise ValueError(f"frame must have shape {self._shape}, got {frame.shape}")
        if self._kalman is not None:
            self._move_to(self._kalman.predict())
        alignment = self._search(frame)
        reason = self._reason(alignment)
        self._found = not reason
        if not reason:
            self._pose = alignment.pose
            self._last_correlation, self._gain = alignment.correlation, alignment.gain
            if self._kalman is not None:
                self._kalman.update(self._corners().mean(axis=0))
        return Track(
            corners=self._corners(),
            lost=bool(reason),
            reason=reason,
            correlation=alignment.correlation,
            homography=_unit(self._pose @ np.linalg.inv(self._start)),
            gain=alignment.gain,
            bias=alignment.bias,
            visible=alignment.visible,
            iterations=alignment.iterations,
            covariance=np.full((2, 2), np.nan) if reason else self._center_covariance(alignment),
        )

    def _search(self, frame: NDArray) -> Alignment:
        """Align from ever more distant starts until one is convincing, and return the best.

        The first start is at the finest resolution: one close to the truth is thus never led astray
        by a coarse resolution, where the surroundings of the template weigh most, and costs little.
        Only a distant one pays for the pyramid, and only one beyond the reach of any gradient for a
        search by correlation.
        """
        corners = self._corners()
        region, origin = _cut(frame, corners, np.ptp(corners, axis=0).max())
        if min(region.shape) < 2:
            return Alignment(self._pose, failure="out of view")
        image = as_image("frame", region)
        start = _shifted(self._pose, -origin)
        best = Alignment(start, failure="diverged", correlation=-1.0)
        for pose, layers in self._starts(start, image):
            alignment = self._align(layers, pose)
            if best.failure or (not alignment.failure and alignment.correlation > best.correlation):
                best = alignment
            if not best.failure and best.correlation > self._convincing():
                break
        if self._found and self._distortions and self._reason(best):
            best = self._align_distorted(image, start) or best
        return replace(best, pose=_shifted(best.pose, origin))

    def _reason(self, alignment: Alignment) -> str:
        """Return why an alignment does not count as the template, or nothing if it does."""
        return alignment.failure or (
            "low correlation" if alignment.correlation < self._least_correlation else ""
        )

    def _convincing(self) -> float:
        """Return the correlation at which no further start is tried.

        It follows the last one that was accepted: where much of a template is alike, a wrong place
        may correlate to 0.95, but the noise of the camera sets how far the right one falls below 1.
        """
        noise = _NOISE_FACTOR * (1.0 - self._last_correlation)
        return max(_CONVINCING, 1.0 - noise - _INTERPOLATION_LOSS)

    def _starts(self, pose: Array, image: Image) -> Iterator[tuple[Array, list[Image]]]:
        """Yield starting poses and the resolutions to refine them through, the finest first."""
        layers: list[Image] = []
        for _ in self._levels:
            layers.append(_halved(layers[-1]) if layers else image)
            yield pose, layers
        halvings = min(int(np.log2(max(self._box[2:]) / _LARGEST_MATCHED)), len(layers) - 1)
        halvings = max(halvings, 0)
        reach = max(self._box[2:]) // 2**halvings
        matched = self._levels[halvings].correlate(layers[halvings], pose, reach)
        yield matched, layers[: halvings + 1]

    def _align_distorted(self, image: Image, pose: Array) -> Alignment | None:
        """Align from distortions of the template, and return the first alignment that convinces."""
        layers = _pyramid(image, self._deformable)
        for distortion in self._distortions:
            alignment = self._align(layers, pose @ distortion, promising=_PROMISING)
            if not alignment.failure and alignment.correlation > max(
                self._least_correlation, _CONVINCING
            ):
                return alignment
        return None

    def _align(self, layers: list[Image], pose: Array, promising: float = -1.0) -> Alignment:
        """Refine a pose from the last of the layers to the first, and then between the pixels."""
        gain, iterations = self._gain, 0
        for level, layer in reversed(list(zip(self._levels, layers, strict=False))):
            tolerance = _TOLERANCE / level.to_image[0, 0]
            alignment = level.align(
                layer, pose, tolerance=tolerance, iterations=_MOST_STEPS, gain=gain
            )
            iterations += alignment.iterations
            pose, gain = alignment.pose, alignment.gain
            if alignment.failure or alignment.correlation < promising:
                return replace(alignment, iterations=iterations)
        if alignment.correlation > self._least_correlation:
            near, offset = _cut(
                layers[0], apply_homography(pose, self._refinement.corners), _LAST_MARGIN
            )
            alignment = self._refinement.align(
                half_pixel(near),
                _shifted(pose, -offset),
                tolerance=_LAST_TOLERANCE,
                iterations=_MOST_STEPS,
                gain=gain,
            )
            alignment = replace(alignment, pose=_shifted(alignment.pose, offset))
            iterations += alignment.iterations
        return replace(alignment, iterations=iterations)

    def _corners(self) -> Array:
        return apply_homography(self._pose, self._refinement.corners)

    def _move_to(self, center: Array) -> None:
        self._pose = _shifted(self._pose, center - self._corners().mean(axis=0))

    def _center_covariance(self, alignment: Alignment) -> Array:
        """Carry the covariance of the motion parameters over to the mean of the corners."""
        if alignment.covariance is None:
            return np.full((2, 2), np.nan)
        level = self._refinement
        corners = np.column_stack([level.corners, np.ones(4)])
        mapped = corners @ alignment.pose.T
        velocity = np.einsum("ij,njk,ck->nci", alignment.pose, level.basis, corners)
        depth = mapped[:, 2:]
        slope = (velocity[..., :2] - mapped[:, :2] / depth * velocity[..., 2:]) / depth
        jacobian = slope.mean(axis=1)
        return jacobian.T @ alignment.covariance @ jacobian


def _checked_box(
    box: tuple[int, int, int, int], shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    left, top, across, down = items("box", box, 4)
    x, y = whole("box x", left, least=0), whole("box y", top, least=0)
    width = whole("box width", across, least=_COARSEST)
    height = whole("box height", down, least=_COARSEST)
    if x + width > shape[1] or y + height > shape[0]:
        raise ValueError(
            f"box must lie inside the image of {shape[1]}×{shape[0]} px, got {tuple(box)}"
        )
    return x, y, width, height


def _check_texture(level: Level) -> None:
    """Refuse a template that a translation leaves unchanged in some direction."""
    gradient = level.gradient.astype(np.float64)
    weak, strong = np.linalg.eigvalsh(gradient @ gradient.T)
    if strong == 0:
        raise ValueError("box must hold a textured template, got a flat one")
    if weak < _LEAST_CORNERNESS * strong:
        raise ValueError(
            "box must hold gradients in two directions, got a template that slides along its edges"
        )


def _distortions(corners: Array, motion: str) -> list[Array]:
    """Return warps of the template that move every coordinate of its corners, up or down.

    Their signs are the rows of a Hadamard matrix and these rows with two signs changed, which is
    as far apart as 32 patterns of eight signs can be.
    """
    if motion == "translation":
        return []
    rows = hadamard(8)
    changed = rows * [-1, 1, 1, 1, 1, 1, 1, -1]
    signs = np.concatenate([rows, -rows, changed, -changed]).reshape(-1, 4, 2)
    moves = _DISTORTION * np.ptp(corners, axis=0) * signs
    if motion == "affine":  # the nearest ones to these, but for those that are none at all
        design = np.column_stack([corners, np.ones(4)])
        moves = design @ np.linalg.pinv(design) @ moves
        moves = moves[np.abs(moves).max(axis=(1, 2)) > _ROUNDING]
    first = corners.astype(np.float32)
    moved = (corners + moves).astype(np.float32)
    return [np.asarray(cv2.getPerspectiveTransform(first, target)) for target in moved]


def _halved(image: Image) -> Image:
    """Return the image at half its resolution; its pixels are the even ones of the image."""
    return cv2.pyrDown(image).astype(np.float32, copy=False)


def _pyramid(image: Image, levels: int) -> list[Image]:
    """Return the image and its successive halves."""
    layers = [image]
    for _ in range(levels - 1):
        layers.append(_halved(layers[-1]))
    return layers


def _cut(image: NDArray, corners: Array, margin: float) -> tuple[NDArray, Array]:
    """Return the part of an image around some corners and where its first pixel was, (x, y)."""
    size = np.array(image.shape[::-1])
    first = np.clip(np.floor(corners.min(axis=0) - margin), 0, size).astype(int)
    last = np.clip(np.ceil(corners.max(axis=0) + margin) + 1, 0, size).astype(int)
    return image[first[1] : last[1], first[0] : last[0]], first.astype(np.float64)


def _unit(homography: Array) -> Array:
    return homography / homography[2, 2]


def _shifted(pose: Array, by: Array) -> Array:
    """Return the pose followed by a translation of the image."""
    shift = np.eye(3)
    shift[:2, 2] = by
    return shift @ pose
