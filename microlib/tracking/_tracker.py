"""Template tracking by efficient second-order minimization (§5.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    Image,
    Tidy,
    as_image,
    as_region,
    check_callable,
    flat_row,
    luminance,
    of_kind,
    one_of,
    scalar,
)
from microlib.tracking._blocks import agreement
from microlib.tracking._covariance import corner_covariance, largest_sigma
from microlib.tracking._esm import Alignment, Level, make_level
from microlib.tracking._geometry import GENERATORS, apply_homography, cut_around, shifted
from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._light import LitFit
from microlib.tracking._sampling import View, half_pixel
from microlib.tracking._search import RobustSearch
from microlib.tracking._verdict import confidence

if TYPE_CHECKING:
    import pandas as pd

# What parts of the tracker are worth is in its benchmark on photographs, table "Variants". The
# numbers here were changed one at a time where the first attempt alone decides.

#: Least width and height (px) of a template.
_SMALLEST = 6

#: Standard deviation (px) of the Gaussian at the first level.
_SMOOTHING = 1.25

#: Corner step (px) that ends the first level, and the last one: the next step of a second-order
#: method is smaller than the square of it. From half to twice the one, and from a fifth to ten
#: times the other, only the number of steps changes.
_TOLERANCE, _LAST_TOLERANCE = 0.5, 0.05

#: Most steps of one level: a converging one takes 1 to 6. More only take longer where the template
#: is not to be found.
_MOST_STEPS = 8

#: Margin (px) around the template that the last level samples; it starts a fraction of a pixel
#: away. The same results from 3 on; without it errors are 15 % larger.
_LAST_MARGIN = 6.0

#: Normalized correlation below which the template counts as lost.
_LEAST_CORRELATION = 0.7

#: Correlation that an attempt must reach to be convincing, whatever the noise.
_CONVINCING = 0.9

#: An attempt must also come as near to 1 as the last accepted one, within this factor:
#: else a jump along a gripper's jaws, which are alike everywhere, is taken for none.
_NOISE_FACTOR = 2.0

#: Loss of correlation that interpolation alone may cause, where there is no noise.
_INTERPOLATION_LOSS = 0.002

#: Least share of the template's contrast that the smoothing must leave: of white noise it leaves
#: 22 %, of a chessboard of 1 px nothing. A guard against following noise.
_LEAST_CONTRAST = 0.01

#: Least ratio of the weaker to the stronger eigenvalue of the gradients' second moments: textures
#: and grippers have 0.2 to 0.9, a straight edge has none. A guard against edges without noise only:
#: with one of 0.5 % of the step's height an edge has 0.002.
_LEAST_CORNERNESS = 1e-4

#: Gradient (grey levels a px), in the largest level, that single precision may make of none.
_ROUNDING = 1e-6

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

#: Contrast of a template, the standard deviation of its levels, that is followed as it is: from
#: levels up to 1 to those of 16 bits. Others are multiplied by a power of two; unscaled, levels a
#: millionth of 8 bits' were lost, and ten thousand times as large cost 0.01 px.
_USUAL_CONTRAST = (1 / 64, 16384.0)


@dataclass(frozen=True, eq=False, repr=False)
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
        noise, else an estimate from what the parts say; below ½ the template counts as lost, with
        a confidence of 0.
    hidden : ndarray of bool, shape (height, width)
        Pixels of the box where the frame shows something else, or nothing; all when `lost`.
    """

    _parts = (
        ("corners", ("top_left", "top_right", "bottom_right", "bottom_left"), ("x", "y")),
        ("homography", ("x", "y", "scale"), ("x", "y", "shift")),
        ("covariance", ("x", "y"), ("x", "y")),
    )

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

    def to_layers(self, *, pixel_size: float = 1.0) -> list[tuple[Any, dict[str, Any], str]]:
        """Return the box as a layer of napari: for ``Layer.create(*layer)``.

        Parameters
        ----------
        pixel_size : float
            Side of a pixel, µm, if the frame is shown to scale.

        Returns
        -------
        list of (data, options, type)
        """
        pixel_size = scalar("pixel_size", pixel_size, above=0)
        options = {"name": "lost" if self.lost else "track", "scale": (pixel_size, pixel_size)}
        options |= {"face_color": "transparent", "edge_color": "red" if self.lost else "yellow"}
        return [([self.corners[:, ::-1]], options | {"shape_type": "polygon"}, "shapes")]

    @property
    def center(self) -> Array:
        """Mean of the corners, (x, y) in px: the feature that §5.4 servos on."""
        return self.corners.mean(axis=0)


@dataclass(frozen=True, eq=False)
class Found:
    """What the attempts made of a frame; `reason` says why it is nothing."""

    fit: Alignment
    corner_covariance: Array
    confidence: float
    hidden: NDArray[np.bool_]
    reason: str = ""
    plain: bool = False


class ESMTracker:
    """Track a template through frames by efficient second-order minimization.

    Each frame is a list of attempts, from the cheapest to the most patient:

    1. From where the template was, and from where its points flow to: align with one gain and bias,
       smoothed in the template's coordinates and then at half pixels, which removes most of the
       error of bilinear interpolation. Believed if the blocks of the template agree to within the
       noise, which is estimated from the frames; else once more in a light that varies smoothly,
       through a blur and a tone curve, with Tukey's weights [3]_.
    2. All these poses robustly: in local illumination, then in smooth light. What the blocks agree
       in, what they agree in elsewhere, how many points stay there, and the uncertainty of the
       corners say how probable it is that this is the template. One that was lost is sought in
       the whole frame.
    3. If it was seen in the frame before: robustly from what its points flow to when it is
       distorted, in 32 ways, or shifted to where it correlates best.

    Else it is lost. Templates above 64 px are searched robustly on halved frames.

    Parameters
    ----------
    image : array_like, shape (H, W) or (H, W, 3)
        The frame with the template; color becomes luminance.
    box : tuple of int
        (x, y, width, height) of the template in px: columns x … x + width − 1, rows y … y + height
        − 1.
    motion : {"homography", "affine", "translation"}
        Group of warps.
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
    >>> import cv2
    >>> import numpy as np
    >>> from microlib.tracking import ESMTracker
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
        kalman: KalmanFilter | None = None,
    ) -> None:
        frame = np.ascontiguousarray(as_image("image", luminance("image", image)))
        motion = one_of("motion", motion, tuple(GENERATORS))
        x, y, width, height = self._box = as_region("box", box, frame.shape, least=_SMALLEST)
        if kalman is not None:
            of_kind("kalman", kalman, KalmanFilter)
        self._gauge = _gauge_of(frame[y : y + height, x : x + width])
        frame = frame if self._gauge == 1 else frame * self._gauge
        self._shape, self._kalman, self._seen = frame.shape, kalman, True
        size = max(width, height) / 2
        self._start = np.array(
            [[size, 0, x + (width - 1) / 2], [0, size, y + (height - 1) / 2], [0, 0, 1.0]]
        )
        self._pose, box = self._start, self._box
        self._smooth, self._sharp = (
            make_level(image, box, self._start, density=k, smoothing=sigma, motion=motion)
            for k, sigma, image in ((1, _SMOOTHING, frame), (2, 0.0, half_pixel(frame)))
        )
        _check_texture(self._smooth, self._sharp)
        whole_numbers = np.asarray(image).dtype.kind in "bui"
        rounded = _ROUNDED * float(self._gauge) if whole_numbers else 0.0
        self._least_noise = max(_LEAST_NOISE * self._sharp.contrast, rounded)
        view = View(frame, self._least_noise)
        self._noise, self._gain = view.noise, 1.0
        self._last_correlation = 1.0 - min(self._noise / self._sharp.contrast, 1.0) ** 2
        self._robust = RobustSearch(view, self._box, self._start, motion)

    def track(self, frame: ArrayLike) -> Track:
        """Find the template in the next frame.

        Parameters
        ----------
        frame : array_like, shape (H, W) or (H, W, 3)
            A frame of the size of the first one; color becomes luminance.

        Returns
        -------
        Track
            ``lost`` says if the template was not found, and ``reason`` why; the next search then
            starts from the last good pose, moved on by the Kalman filter if there is one.

        Raises
        ------
        ValueError
            If the frame is no image of that size, or not finite where the template is sought.
        """
        frame = luminance("frame", frame)
        if frame.shape != self._shape:
            raise ValueError(f"frame must have shape {self._shape}, got {frame.shape}")
        if self._kalman is not None:
            center = self._corners().mean(axis=0)
            self._pose = shifted(self._pose, self._kalman.predict() - center)
        region: Image = frame
        origin: Array = np.zeros(2)
        if self._seen:  # else it is sought in the whole frame
            corners = self._corners()
            region, origin = cut_around(frame, corners, np.ptp(corners, axis=0).max())
        if min(region.shape) < 2:
            found = self._lost(Alignment(self._pose, failure="out of view"))
        else:
            image = np.ascontiguousarray(as_image("frame", region))
            view = View(image if self._gauge == 1 else image * self._gauge, self._least_noise)
            found = self._attempt(view, shifted(self._pose, -origin))
        fit, lost = found.fit, bool(found.reason)
        self._seen = not lost
        if not lost:
            self._pose = shifted(fit.pose, origin)
            if found.plain:
                self._last_correlation, self._gain = fit.correlation, fit.gain
            if self._kalman is not None:
                self._kalman.update(self._corners().mean(axis=0))
        homography = self._pose @ np.linalg.inv(self._start)
        return Track(
            corners=self._corners(),
            lost=lost,
            reason=found.reason,
            correlation=fit.correlation,
            homography=homography / homography[2, 2],
            gain=fit.gain,
            bias=fit.bias / float(self._gauge),
            visible=fit.visible,
            iterations=fit.iterations,
            covariance=found.corner_covariance.reshape(4, 2, 4, 2).mean(axis=(0, 2)),
            corner_covariance=found.corner_covariance,
            confidence=found.confidence,
            hidden=found.hidden,
        )

    def _attempt(self, view: View, start: Array) -> Found:
        """Try one thing after another, each only if those before did not convince."""
        # From where it was.
        best = self._align(view.image, start)
        if found := self._nearby(view, best):
            return found
        # From where its points flow to.
        flowing = self._robust.follow(view, start).poses
        if flowing:
            second = self._align(view.image, flowing[0])
            if found := self._nearby(view, second):
                return found
            if best.failure or (not second.failure and second.correlation > best.correlation):
                best = second
        right = not self._reason(best)
        if right and (found := self._plain(best, _STEADY)):
            return found
        # From all of these robustly; if it was lost, from anywhere in the frame.
        anywhere = [] if self._seen else self._robust.places(view, start)
        if found := self._robustly(view, start, [start, best.pose, *flowing, *anywhere]):
            return found
        # From far away, if it was there a frame ago.
        if self._seen and (
            found := self._robustly(view, start, self._robust.far_starts(view, start))
        ):
            return found
        # What has texture agrees, though the ground between it has changed.
        if right and (found := self._plain(best, _UNSTEADY)):
            return found
        return self._lost(best)

    def _nearby(self, view: View, plain: Alignment) -> Found | None:
        """Return an alignment if it is convincing, as it is or in smooth light."""
        if self._reason(plain):
            return None
        found = None
        if plain.correlation > self._convincing():
            found = self._plain(plain, _STEADY)
        return found or self._in_smooth_light(view, plain)

    def _align(self, image: Image, pose: Array) -> Alignment:
        """Refine a pose smoothed, and then between the pixels."""
        first = self._smooth.align(
            image, pose, tolerance=_TOLERANCE, iterations=_MOST_STEPS, gain=self._gain
        )
        if first.failure or first.correlation <= _LEAST_CORRELATION:
            return first
        corners = apply_homography(first.pose, self._sharp.corners)
        near, offset = cut_around(image, corners, _LAST_MARGIN)
        last = self._sharp.align(
            half_pixel(near),
            shifted(first.pose, -offset),
            tolerance=_LAST_TOLERANCE,
            iterations=_MOST_STEPS,
            gain=first.gain,
        )
        steps = first.iterations + last.iterations
        return replace(last, pose=shifted(last.pose, offset), iterations=steps)

    def _plain(self, fit: Alignment, drift: tuple[float, float]) -> Found | None:
        """Return the alignment as the result if all parts of the template agree with it."""
        if not self._agreeing(fit, drift):
            return None
        covariance = corner_covariance(self._sharp, fit, fit.weight, None)
        if not largest_sigma(covariance) < _CERTAIN:
            return None
        return Found(fit, covariance, 1.0, fit.weight == 0, plain=True)

    def _agreeing(self, fit: Alignment, drift: tuple[float, float]) -> bool:
        """Return whether all parts of the template agree with an alignment."""
        if fit.grey.shape != self._sharp.grey.shape:
            return False
        said = agreement(fit.grey, self._sharp.grey, fit.weight, self._noise)
        steady = drift[0] * self._noise + drift[1] * abs(fit.gain) * self._sharp.contrast
        return bool(
            said.agreeing >= _AGREED and said.texture >= _LEAST_TEXTURE and said.drift <= steady
        )

    def _in_smooth_light(self, view: View, plain: Alignment) -> Found | None:
        """Return the fit in smooth light if all parts agree with it, or it with the plain one."""
        fit = self._robust.polish(view, plain.pose)
        if fit is None:
            return None
        covariance = self._robust.covariance(fit)
        corners = self._sharp.corners
        off = np.abs(apply_homography(fit.pose, corners) - apply_homography(plain.pose, corners))
        confirmed = (
            off.max() < _CONFIRMED
            and largest_sigma(covariance) < _CONFIRMED
            and self._agreeing(plain, _UNSTEADY)
        )
        if confirmed or _clear(fit, covariance):
            return self._believed(fit, covariance, 1.0)
        return None

    def _robustly(self, view: View, pose: Array, starts: list[Array]) -> Found | None:
        """Return what the robust search finds if it is believed to be the template."""
        finding = self._robust.search(view, pose, starts, near=self._seen)
        if finding is None or finding.fit.correlation < _LEAST_CORRELATION:
            return None
        covariance = self._robust.covariance(finding.fit)
        clear = _clear(finding.fit, covariance)
        probability = 1.0 if clear else confidence(finding, largest_sigma(covariance))
        if probability < _BELIEVED:
            return None
        return self._believed(finding.fit, covariance, probability)

    def _believed(self, fit: LitFit, covariance: Array, probability: float) -> Found:
        """Return a fit in smooth light as the result."""
        height, width = self._box[3], self._box[2]
        hidden = fit.hidden
        if hidden.shape != (height, width):
            bits = hidden.astype(np.uint8)
            hidden = cv2.resize(bits, (width, height), interpolation=cv2.INTER_NEAREST) > 0
        return Found(fit, covariance, probability, hidden)

    def _lost(self, best: Alignment) -> Found:
        hidden = np.ones((self._box[3], self._box[2]), bool)
        reason = self._reason(best) or "no agreement"
        return Found(best, np.full((8, 8), np.nan), 0.0, hidden, reason)

    def _reason(self, fit: Alignment) -> str:
        """Return why an alignment does not count as the template, or nothing if it does."""
        low = fit.correlation < _LEAST_CORRELATION
        return fit.failure or ("low correlation" if low else "")

    def _convincing(self) -> float:
        """Return the correlation at which no further start is tried.

        It follows the last one that was accepted: where much of a template is alike, a wrong place
        may correlate to 0.95, but the noise of the camera sets how far the right one falls below 1.
        """
        noise = _NOISE_FACTOR * (1.0 - self._last_correlation)
        return max(_CONVINCING, 1.0 - noise - _INTERPOLATION_LOSS)

    def _corners(self) -> Array:
        return apply_homography(self._pose, self._sharp.corners)


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


def _check_texture(smooth: Level, sharp: Level) -> None:
    """Refuse a template that a translation leaves unchanged in some direction."""
    if smooth.contrast < _LEAST_CONTRAST * sharp.contrast:
        raise ValueError(
            f"box must hold details of more than a px, got a contrast of {sharp.contrast:.3g} of "
            f"which a blur of {_SMOOTHING:g} px leaves {smooth.contrast:.3g}"
        )
    gradient = sharp.slope.astype(np.float64)
    weak, strong = np.linalg.eigvalsh(gradient @ gradient.T)
    if strong <= (_ROUNDING * np.abs(sharp.grey).max()) ** 2 * sharp.grey.size:
        raise ValueError("box must hold a textured template, got a flat one")
    if weak < _LEAST_CORNERNESS * strong:
        raise ValueError(
            "box must hold gradients in two directions, got a template that slides along its edges"
        )


def track_all(
    frames: Iterable[ArrayLike],
    box: tuple[int, int, int, int],
    motion: str = "homography",
    *,
    rate: float | None = None,
    kalman: KalmanFilter | None = None,
    progress: Callable[[int], object] | None = None,
) -> pd.DataFrame:
    """Track a template through all frames of a film.

    Parameters
    ----------
    frames : iterable of array_like, shape (H, W) or (H, W, 3)
        Frames one after another, as a list, a stack or `microlib.io.read_frames` gives them; the
        first one shows the template. They are read one at a time, and may be wrapped, by ``tqdm``
        for example.
    box, motion, kalman
        As for `ESMTracker`.
    rate : float, optional
        Frames per second. With it the table has the column ``time_s``.
    progress : callable, optional
        Called with the number of frames done, after each.

    Returns
    -------
    pandas.DataFrame
        A row a frame with the columns of `Track.to_dict`; positions and covariances of a frame in
        which the template is lost are empty.

    Raises
    ------
    ValueError
        If there is no frame; and as `ESMTracker` and `ESMTracker.track`.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.synthetic import texture_sequence
    >>> from microlib.tracking import track_all
    >>> path = [(60.0, 60.0), (62.5, 60.5), (65.0, 61.0)]
    >>> table = track_all(texture_sequence(path, np.random.default_rng(0)), (60, 60, 49, 49))
    >>> table["center_x"].diff().round(1).tolist()[1:]
    [2.5, 2.5]
    """
    import pandas as pd  # here, for it takes a third of the time that importing a subject takes

    if rate is not None:
        rate = scalar("rate", rate, above=0)
    check_callable("progress", progress, optional=True)
    if not np.iterable(frames):
        raise ValueError(f"frames must be images one after another, got {frames!r:.80}")
    rows: list[dict[str, Any]] = []
    for number, frame in enumerate(frames):
        if number == 0:
            as_image("frames", luminance("frames", frame))
            tracker = ESMTracker(frame, box, motion, kalman=kalman)
            track = ESMTracker(frame, box, motion).track(frame)  # nothing to predict
        else:
            try:
                track = tracker.track(frame)
            except ValueError as error:
                raise ValueError(f"frames[{number}]: {error}") from error
        row = track.to_dict()
        if track.lost:
            row |= {name: None for name in row if name.startswith(("corners", "center"))}
        rows.append(row if rate is None else {"time_s": number / rate} | row)
        if progress is not None:
            progress(number + 1)
    if not rows:
        raise ValueError("frames must hold at least one, got none")
    return pd.DataFrame(rows).rename_axis("frame")
