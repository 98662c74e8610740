"""Template tracking by efficient second-order minimization over a pyramid (§5.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

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
    flat_row,
    items,
    of_kind,
    one_of,
    scalar,
    whole,
)
from microlib.tracking._blocks import agreement
from microlib.tracking._covariance import (
    corner_jacobian,
    kept_between,
    lag_between,
    largest_sigma,
    sandwich,
    squared_frequency,
)
from microlib.tracking._esm import (
    MOTIONS,
    Alignment,
    Level,
    apply_homography,
    cut_around,
    half_pixel,
    halved,
    make_level,
    pyramid,
    shifted,
)
from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._light import LitFit
from microlib.tracking._noise import ceiling_of, noise_of
from microlib.tracking._search import Finding, RobustSearch, compile_loops
from microlib.tracking._verdict import confidence

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
#: fewer homographies are found. More only take longer where the template is not to be found.
_MOST_STEPS = 8

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

#: Correlation below which a start is given up at a coarse resolution; right ones have more. At 0.9
#: 2 % fewer homographies are found.
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

#: Least noise, in the template's contrast: what interpolation leaves where there is no noise.
_LEAST_NOISE = 0.01

#: Standard deviation of the rounding of whole numbers.
_ROUNDED = 12**-0.5

#: Share of the texture that must agree, and how much of it (blocks' variance over the noise's) and
#: how certain a corner (px) there must be, for a pose to need no further search.
_AGREED, _LEAST_TEXTURE, _CERTAIN = 0.95, 100.0, 0.15

#: Drift of the blocks' grey levels, in the noise and in the contrast, that is no change of light;
#: and that is none of the template, where nothing better is found.
_STEADY, _UNSTEADY = (0.5, 0.02), (1.0, 0.2)

#: Corner distance (px) up to which two alignments in different light say the same, and their
#: standard deviation.
_CONFIRMED = 0.5

#: Residual in smooth light, in the noise, up to which nothing is hidden.
_CLEAR = 1.5

#: Probability of being right from which on a pose is believed.
_BELIEVED = 0.5

#: Nats that an alignment from a distortion must promise to be finished.
_PROMISED = 5.0

#: Side (px) of the template where it is sought in the whole frame, and how many places are tried.
_SOUGHT, _PLACES = 12, 6

#: A pixel is hidden where the mean square residual about it, over 1.5 px, exceeds nine times the
#: noise's and a quarter of the template's variance about it, over 3.5 px.
_HIDDEN, _HIDDEN_SHARE, _ABOUT, _ABOUT_TEMPLATE = 9.0, 0.25, 1.5, 3.5

#: Contrast of a template, the standard deviation of its levels, that is followed as it is: from
#: levels up to 1 to those of 16 bits. Others are multiplied by a power of two; unscaled, levels a
#: millionth of 8 bits' were lost, and ten thousand times as large cost 0.01 px.
_USUAL_CONTRAST = (1 / 64, 16384.0)

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
        Empty, or why it was not: ``"singular"``, ``"diverged"``, ``"out of view"``, ``"low
        correlation"`` or ``"no agreement"`` of the template's parts.
    correlation : float
        Normalized correlation of the template and the frame under the warp, −1 to 1; where only
        parts of the template agree or the light changes, of these parts in that light.
    homography : ndarray, shape (3, 3)
        Maps px of the template's frame to px of this frame.
    gain, bias : float
        The frame's grey values are ``gain``·template + ``bias``.
    visible : float
        Share of the template's pixels inside the frame.
    iterations : int
        Steps of the attempt that was kept, all resolutions together.
    covariance : ndarray, shape (2, 2)
        Covariance of `center` in px², from the residual of the alignment and how it varies over the
        template; NaN when `lost`.
    corner_covariance : ndarray, shape (8, 8)
        The same of the corners, x and y of the first one first.
    confidence : float
        Probability that the pose is right: 1 where every part of the template agrees within the
        noise, else an estimate from what the parts say; below ½ the template counts as lost.
    hidden : ndarray of bool, shape (height, width)
        Pixels of the box where the frame shows something else, or nothing; all when `lost`.
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
    corner_covariance: Array
    confidence: float
    hidden: NDArray[np.bool_]

    _large = ("corner_covariance", "hidden")

    def to_dict(self) -> dict[str, Any]:
        """Return the track as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            The fields but `corner_covariance`, `center`, and the share of the box that is `hidden`.
        """
        share = {"center": self.center, "hidden": float(np.mean(self.hidden))}
        return super().to_dict() | flat_row(share)

    @property
    def center(self) -> Array:
        """Mean of the corners, (x, y) in px: the feature that §5.4 servos on."""
        return self.corners.mean(axis=0)


@dataclass(frozen=True)
class Found:
    """What the search made of a frame."""

    alignment: Alignment
    reason: str
    corner_covariance: Array
    confidence: float
    hidden: NDArray[np.bool_]
    plain: bool = False


class ESMTracker:
    """Track a template through grey frames by efficient second-order minimization.

    Gain and bias are estimated along with the motion, on a template and a warped frame smoothed in
    the template's coordinates. A search begins at the finest resolution; while the correlation is
    not convincing it begins again from coarser ones, and in the end from the best match by
    correlation in the surroundings. Resolutions with fewer than 12 px a side estimate the
    translation only. A last level without smoothing samples the frame at half pixels, which removes
    most of the error of bilinear interpolation.

    That pose is believed if the blocks of the template agree with it to within the noise, which is
    estimated from the frames. Else the frame is searched robustly: the blocks vote for shifts, the
    best of which are aligned in local illumination and then in a light that varies smoothly,
    through a blur and a tone curve, with Tukey's weights [3]_. What the blocks agree in, what they
    agree in elsewhere, the residuals and the uncertainty of the corners then say how probable it is
    that this is the template; without evidence it is lost. A template that may deform, and was seen
    in the frame before, is not given up until the search has begun from 32 distortions of it; one
    that was lost is sought in the whole frame. Templates above 64 px are searched robustly on
    halved frames.

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
    mask : array_like of bool, shape (height, width), optional
        Pixels of the box that belong to the template. By default all of them.
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
    .. [3] P. J. Huber and E. M. Ronchetti, "Robust Statistics", 2nd edition, Wiley, 2009.

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
        mask: ArrayLike | None = None,
        kalman: KalmanFilter | None = None,
    ) -> None:
        frame = np.ascontiguousarray(as_image("image", image))
        motion = one_of("motion", motion, MOTIONS)
        x, y, width, height = self._box = _checked_box(box, frame.shape)
        self._gauge = _gauge_of(frame[y : y + height, x : x + width])
        frame = frame if self._gauge == 1 else frame * self._gauge
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
        counts = _checked_mask(mask, (height, width))
        self._shape = frame.shape
        self._kalman = kalman
        self._last_correlation, self._gain = 1.0, 1.0
        self._found = True
        self._whole = np.asarray(image).dtype.kind in "bui"
        size = max(width, height) / 2
        self._start = np.array(
            [[size, 0, x + (width - 1) / 2], [0, size, y + (height - 1) / 2], [0, 0, 1.0]]
        )
        self._pose = self._start
        layers = pyramid(frame, levels)
        self._levels = [
            make_level(
                layer,
                self._box,
                self._start,
                step=2**halvings,
                density=1,
                smoothing=smoothing,
                motion=motion if min(width, height) >= _DEFORMABLE * 2**halvings else "translation",
                mask=counts,
            )
            for halvings, layer in enumerate(layers)
        ]
        self._refinement = make_level(
            half_pixel(frame),
            self._box,
            self._start,
            step=1,
            density=2,
            smoothing=0.0,
            motion=motion,
            mask=counts,
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
        several = [len(level.basis) for level in self._levels].count(
            len(self._refinement.basis)
        ) > 1
        self._distortions = _distortions(self._refinement.corners, motion) if several else []
        self._prepare_judgement(frame, motion, counts)

    def _prepare_judgement(
        self, frame: Image, motion: str, counts: NDArray[np.bool_] | None
    ) -> None:
        """Keep what is needed to judge a pose, and to search where it does not convince."""
        x, y, width, height = self._box
        compile_loops()
        self._noise = self._noise_of(frame)
        weight = np.ones((height, width)) if counts is None else counts
        self._robust = RobustSearch(
            frame, self._box, self._start, motion, np.asarray(weight, np.float32)
        )
        # Some of the template's pixels: enough to average over their places between pixels.
        rows, columns = np.mgrid[y + 2 : y + height : 5, x + 2 : x + width : 5]
        some = np.column_stack([columns.ravel(), rows.ravel()])
        self._lattice = apply_homography(np.linalg.inv(self._start), some)
        gradient = self._refinement.gradient.reshape(2, height, width)
        self._fineness = squared_frequency(gradient.astype(np.float64))
        self._nothing_hidden = np.zeros((height, width), bool)
        self._nothing_hidden.flags.writeable = False

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
        found = self._search(frame)
        alignment, lost = found.alignment, bool(found.reason)
        self._found = not lost
        if not lost:
            self._pose = alignment.pose
            if found.plain:
                self._last_correlation, self._gain = alignment.correlation, alignment.gain
            if self._kalman is not None:
                self._kalman.update(self._corners().mean(axis=0))
        corner_covariance = np.full((8, 8), np.nan) if lost else found.corner_covariance
        return Track(
            corners=self._corners(),
            lost=lost,
            reason=found.reason,
            correlation=alignment.correlation,
            homography=_unit(self._pose @ np.linalg.inv(self._start)),
            gain=alignment.gain,
            bias=alignment.bias / float(self._gauge),
            visible=alignment.visible,
            iterations=alignment.iterations,
            covariance=_of_mean(corner_covariance),
            corner_covariance=corner_covariance,
            confidence=found.confidence,
            hidden=found.hidden,
        )

    def _search(self, frame: NDArray) -> Found:
        """Align from ever more distant starts, and search robustly if the parts do not agree.

        The first start is at the finest resolution: one close to the truth is thus never led astray
        by a coarse resolution, where the surroundings of the template weigh most, and costs little.
        Only a distant one pays for the pyramid, and only one beyond the reach of any gradient for a
        search by correlation. A template that was lost is sought in the whole frame.
        """
        region: Image = frame
        origin: Array = np.zeros(2)
        if self._found:
            corners = self._corners()
            region, origin = cut_around(frame, corners, np.ptp(corners, axis=0).max())
        if min(region.shape) < 2:
            return self._lost(Alignment(self._pose, failure="out of view"), "out of view")
        image = np.ascontiguousarray(as_image("frame", region))
        if self._gauge != 1:
            image = image * self._gauge
        return self._search_in(image, shifted(self._pose, -origin), origin)

    def _search_in(self, image: Image, start: Array, origin: Array) -> Found:
        best = Alignment(start, failure="diverged", correlation=-1.0)
        for pose, layers in self._starts(start, image):
            alignment = self._align(layers, pose, _PROMISING if len(layers) > 1 else -1.0)
            if best.failure or (not alignment.failure and alignment.correlation > best.correlation):
                best = alignment
            if not best.failure and best.correlation > self._convincing():
                break
        best = replace(best, pose=shifted(best.pose, origin))
        if not self._reason(best):
            plain = self._plain(best, _STEADY)
            if plain is not None:
                return plain
        found = self._search_robustly(image, start, best, origin)
        if found.reason and not self._reason(best):
            # What has texture agrees, though the ground between it has changed.
            found = self._plain(best, _UNSTEADY) or found
        return found

    def _plain(self, alignment: Alignment, drift: tuple[float, float]) -> Found | None:
        """Return the alignment as the result if all parts of the template agree with it."""
        level = self._refinement
        rows = self._agreeing(alignment, drift)
        if rows is None or alignment.design is None:
            return None
        template, ones, grey = rows
        n, shape = len(level.basis), grey.shape
        bias = alignment.bias - level.mean * (1.0 - alignment.gain)
        residual = grey - np.float32(alignment.gain) * template - np.float32(bias) * ones
        places = apply_homography(alignment.pose, self._lattice)
        counts, k = ones.ravel(), kept_between(places)
        covariance = sandwich(
            alignment.design[: n + 2], residual.ravel(), counts, counts, (1.0, k), shape, n
        )
        jacobian = corner_jacobian(alignment.pose, level.basis, level.corners)
        lag = np.tile(lag_between(places) * self._fineness, 4)
        covariance = jacobian.T @ covariance @ jacobian + np.outer(lag, lag)
        if not covariance.diagonal().max() < _CERTAIN**2:
            return None
        hidden = self._nothing_hidden if alignment.visible == 1.0 else ones == 0
        return Found(alignment, "", covariance, 1.0, hidden, plain=True)

    def _agreeing(self, alignment: Alignment, drift: tuple[float, float]) -> list[Image] | None:
        """Return template, visibility and image of an alignment if all parts agree with it."""
        level = self._refinement
        if alignment.design is None or alignment.design.shape[1] != level.template.size:
            return None
        shape = self._box[3], self._box[2]
        rows = [
            row.astype(np.float32).reshape(shape) for row in alignment.design[len(level.basis) :]
        ]
        template, ones, grey = rows
        said = agreement(grey, template, ones, self._noise)
        steady = drift[0] * self._noise + drift[1] * abs(alignment.gain) * level.contrast
        if said.agreeing < _AGREED or said.texture < _LEAST_TEXTURE or said.drift > steady:
            return None
        return rows

    def _confirms(self, fit: LitFit, covariance: Array, plain: Alignment, origin: Array) -> bool:
        """Return whether smooth light leads to where one gain and bias did, and all parts agree."""
        corners = self._refinement.corners
        moved = apply_homography(shifted(fit.pose, origin), corners)
        off = np.abs(moved - apply_homography(plain.pose, corners)).max()
        return bool(
            off < _CONFIRMED
            and self._agreeing(plain, _UNSTEADY) is not None
            and largest_sigma(covariance) < _CONFIRMED
        )

    def _search_robustly(self, image: Image, start: Array, best: Alignment, origin: Array) -> Found:
        """Search among the starts, what they led to, and where the blocks of the template point."""
        robust = self._robust
        noise = self._noise_of(image)
        ceiling = ceiling_of(image, noise)
        layers = pyramid(image, robust.coarsest + 1)
        others = [] if self._found else self._anywhere(layers)
        if not best.failure:
            others.append(shifted(best.pose, -origin))
            if not self._reason(best):
                fit = robust.polish(layers[robust.finest], others[-1], noise, ceiling)
                if fit is not None:
                    spread = robust.corner_covariance(fit)
                    if _clear(fit, spread) or self._confirms(fit, spread, best, origin):
                        return self._believed(fit, spread, 1.0, origin, noise)
        finding = robust.search(layers, start, others, noise, ceiling, near=self._found)
        found = self._judged(finding, best, origin, noise)
        if found.reason and self._found and self._distortions:
            second = self._search_distorted(layers, start, best, origin, noise, ceiling)
            found = found if second.reason else second
        return found

    def _search_distorted(
        self,
        layers: list[Image],
        start: Array,
        best: Alignment,
        origin: Array,
        noise: float,
        ceiling: float,
    ) -> Found:
        """Search from distortions of the template."""
        starts = [start @ distortion for distortion in self._distortions]
        finding = self._robust.search(
            layers, start, starts, noise, ceiling, vote=False, hopeless=_PROMISED
        )
        if finding is not None:
            alignment = self._align(layers[:1], finding.pose)
            moved = replace(alignment, pose=shifted(alignment.pose, origin))
            plain = self._plain(moved, _STEADY)
            if plain is not None and not self._reason(alignment):
                return plain
        return self._judged(finding, best, origin, noise)

    def _anywhere(self, layers: list[Image]) -> list[Array]:
        """Return the pose shifted to where the template correlates best in the whole frame."""
        small = [min(self._box[2:]) >= _SOUGHT * 2**k for k in range(len(self._levels))]
        halvings = max(sum(small) - 1, 0)
        while len(layers) <= halvings:
            layers.append(halved(layers[-1]))
        middle = self._corners().mean(axis=0)
        places = self._levels[halvings].places(layers[halvings], _PLACES)
        return [shifted(self._pose, place - middle) for place in places]

    def _judged(
        self, finding: Finding | None, best: Alignment, origin: Array, noise: float
    ) -> Found:
        """Return what was found if it is believed to be the template, else that it is lost."""
        if finding is not None and finding.fit is not None:
            spread = self._robust.corner_covariance(finding.fit)
            if _clear(finding.fit, spread):
                probability = 1.0
            else:
                probability = confidence(
                    finding, largest_sigma(spread), size=max(self._box[2:]), near=self._found
                )
            if probability >= _BELIEVED:
                found = self._believed(finding.fit, spread, probability, origin, noise)
                if found.alignment.correlation >= self._least_correlation:
                    return found
            return self._lost(best, self._reason(best) or "no agreement", probability)
        return self._lost(best, self._reason(best) or "no agreement")

    def _lost(self, alignment: Alignment, reason: str, probability: float = 0.0) -> Found:
        hidden = np.ones_like(self._nothing_hidden)
        return Found(alignment, reason, np.full((8, 8), np.nan), probability, hidden)

    def _believed(
        self, fit: LitFit, covariance: Array, probability: float, origin: Array, noise: float
    ) -> Found:
        """Return a fit in smooth light as the result."""
        height, width = self._box[3], self._box[2]
        hidden = _hidden(fit, noise * self._robust.kept_noise)
        if hidden.shape != (height, width):
            hidden = cv2.resize(
                hidden.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
            ).astype(bool)
        alignment = Alignment(
            pose=shifted(fit.pose, origin),
            correlation=fit.correlation,
            gain=fit.gain,
            bias=fit.bias,
            visible=fit.visible,
            iterations=fit.iterations,
        )
        return Found(alignment, "", covariance, probability, hidden)

    def _noise_of(self, image: Image) -> float:
        """Return the noise of a frame, at least that of rounding and of interpolation."""
        rounded = _ROUNDED * float(self._gauge) if self._whole else 0.0
        least = max(_LEAST_NOISE * self._refinement.contrast, rounded)
        return max(noise_of(image), least)

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
            layers.append(halved(layers[-1]) if layers else image)
            yield pose, layers
        halvings = min(int(np.log2(max(self._box[2:]) / _LARGEST_MATCHED)), len(layers) - 1)
        halvings = max(halvings, 0)
        reach = max(self._box[2:]) // 2**halvings
        matched = self._levels[halvings].correlate(layers[halvings], pose, reach)
        yield matched, layers[: halvings + 1]

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
            near, offset = cut_around(
                layers[0], apply_homography(pose, self._refinement.corners), _LAST_MARGIN
            )
            alignment = self._refinement.align(
                half_pixel(near),
                shifted(pose, -offset),
                tolerance=_LAST_TOLERANCE,
                iterations=_MOST_STEPS,
                gain=gain,
            )
            alignment = replace(alignment, pose=shifted(alignment.pose, offset))
            iterations += alignment.iterations
        return replace(alignment, iterations=iterations)

    def _corners(self) -> Array:
        return apply_homography(self._pose, self._refinement.corners)

    def _move_to(self, center: Array) -> None:
        self._pose = shifted(self._pose, center - self._corners().mean(axis=0))


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


def _checked_mask(mask: ArrayLike | None, shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    if mask is None:
        return None
    as_array("mask", mask, shape=shape)
    counts = np.asarray(mask)
    if counts.dtype != bool:
        raise ValueError(f"mask must hold True and False, got {counts.dtype}")
    if counts.sum() < _COARSEST**2:
        raise ValueError(f"mask must keep {_COARSEST**2} pixels, got {counts.sum()}")
    return counts


def _clear(fit: LitFit, covariance: Array) -> bool:
    """Return whether all parts of the template agree in smooth light."""
    said = fit.agreement
    return (
        said.agreeing >= _AGREED
        and said.texture >= _LEAST_TEXTURE
        and fit.noise < _CLEAR
        and largest_sigma(covariance) < _CERTAIN
    )


def _gauge_of(template: Image) -> np.float32:
    """Return the power of two that brings a template's contrast to a usual one, from 1 to 2."""
    contrast = float(template.std(dtype=np.float64))
    if contrast == 0 or _USUAL_CONTRAST[0] <= contrast <= _USUAL_CONTRAST[1]:
        return np.float32(1)
    return np.float32(2.0 ** -np.floor(np.log2(contrast)))


def _hidden(fit: LitFit, noise: float) -> NDArray[np.bool_]:
    """Return the pixels whose residual is neither noise nor small beside the template."""
    square = cv2.GaussianBlur(fit.residual**2, (0, 0), _ABOUT)
    mean = cv2.GaussianBlur(fit.model, (0, 0), _ABOUT_TEMPLATE)
    variance = cv2.GaussianBlur(fit.model**2, (0, 0), _ABOUT_TEMPLATE) - mean**2
    return np.asarray(square > _HIDDEN * noise**2 + _HIDDEN_SHARE * variance)


def _of_mean(covariance: Array) -> Array:
    """Return the covariance of the mean of the corners from that of all of them."""
    return covariance.reshape(4, 2, 4, 2).mean(axis=(0, 2))


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


def _unit(homography: Array) -> Array:
    return homography / homography[2, 2]
