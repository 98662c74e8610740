"""Template tracking by efficient second-order minimization (§5.3)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    Array,
    Image,
    Tidy,
    as_image,
    as_region,
    flat_row,
    luminance,
    of_kind,
    one_of,
)
from microlib.tracking._blocks import Agreement, compare
from microlib.tracking._covariance import corner_covariance, largest_sigma
from microlib.tracking._esm import Alignment, Level, make_level
from microlib.tracking._geometry import GENERATORS, ROUNDING, apply_homography, cut_around, shifted
from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._light import LitFit
from microlib.tracking._sampling import View, half_pixel
from microlib.tracking._search import Finding, RobustSearch
from microlib.tracking._settings import Settings
from microlib.tracking._verdict import confidence


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Track(Tidy):
    """Where the template is in one frame.

    Attributes
    ----------
    corners : ndarray, shape (4, 2)
        Corners of the box as (x, y) in px, in the order of the box: first row left and right, last
        row right and left. When `lost` those where it was last seen (moved on by the Kalman filter,
        if there is one); all numbers below but `confidence` are then NaN.
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
        Steps of the attempt that was kept, all resolutions together; 0 when `lost`.
    covariance : ndarray, shape (2, 2)
        Covariance of `center` in px², from the residual of the alignment and how it varies over the
        template.
    corner_covariance : ndarray, shape (8, 8)
        The same of the corners, x and y of the first one first.
    confidence : float
        Probability that the pose is right within a pixel: 1 where every part of the template agrees
        within the noise, else an estimate from what the parts say, fitted to photographs. A pose
        below 0.65 is not believed, and the template lost. That refuses 0.4 % of the right findings
        on photographs that nothing was fitted to, partly hidden or in another light, and 2.6 % on
        those that it was fitted to, which move further; 1 frame of 270 is then wrong by more than
        3 px without being called lost (1 of 30 where it is blurred). A lost one keeps the
        probability of what was found, 0 if nothing was.
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
    correlation: float = np.nan
    homography: Array = field(default_factory=lambda: np.full((3, 3), np.nan))
    gain: float = np.nan
    bias: float = np.nan
    visible: float = np.nan
    iterations: int = 0
    covariance: Array = field(default_factory=lambda: np.full((2, 2), np.nan))
    corner_covariance: Array = field(default_factory=lambda: np.full((8,) * 2, np.nan))
    confidence: float
    hidden: NDArray[np.bool_]

    _large = ("corner_covariance", "hidden")

    def to_dict(self) -> dict[str, Any]:
        """Return the track as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            The fields but `corner_covariance`, `center`, and the share of the box that is `hidden`;
            when `lost` nothing but that and the `reason`.
        """
        share = {"center": self.center, "hidden": float(np.mean(self.hidden))}
        row = super().to_dict() | flat_row(share)
        return dict.fromkeys(row) | {"lost": True, "reason": self.reason} if self.lost else row

    @property
    def center(self) -> Array:
        """Mean of the corners, (x, y) in px: the feature that §5.4 servos on."""
        return self.corners.mean(axis=0)


@dataclass(frozen=True, eq=False)
class Found:
    """What an attempt found."""

    fit: Alignment
    corner_covariance: Array
    confidence: float
    hidden: NDArray[np.bool_]
    plain: bool = False


class Sight:
    """A frame on its way through the attempts, with what they learn.

    Attributes
    ----------
    view : View
        The frame, or its part around the template.
    start : ndarray, shape (3, 3)
        Pose in which the template was last, in px of the view.
    best : Alignment
        The best one with one gain and bias so far.
    flowing : list of ndarray, shape (3, 3)
        Poses to which the template's points flow.
    doubt : float
        Largest confidence of what was found and not believed.
    """

    best: Alignment

    def __init__(self, view: View, start: Array) -> None:
        self.view, self.start = view, start
        self.flowing: list[Array] = []
        self.doubt = 0.0


class ESMTracker:
    """Track a template through frames by efficient second-order minimization.

    Each frame goes through a list of attempts, from the cheapest to the most patient, until one is
    believed:

    1. From where the template was: align with one gain and bias, smoothed in the template's
       coordinates and then at half pixels, which removes most of the error of bilinear
       interpolation. Believed if the blocks of the template agree to within the noise, which is
       estimated from the frames; else once more in a light that varies smoothly, through a blur and
       a tone curve, with Tukey's weights [3]_.
    2. The same from where its points flow to.
    3. From all these poses robustly: in local illumination, then in smooth light. What the blocks
       agree in, what they agree in elsewhere, and how many points stay there say how probable it is
       that this is the template. One that was lost is sought in the whole frame.
    4. If it was seen in the frame before: robustly from what its points flow to when it is
       distorted, in 32 ways, or shifted to where it correlates best.
    5. What has texture agrees, though the ground between it has changed.

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

    _stages: ClassVar[tuple[str, ...]] = (
        "_from_last_pose",
        "_from_flow",
        "_in_steady_light",
        "_robustly",
        "_from_far_away",
        "_by_texture",
    )
    _settings: ClassVar[Settings] = Settings()

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
        x, y, width, height = self._box = as_region("box", box, frame.shape, least=6)
        if kalman is not None:
            of_kind("kalman", kalman, KalmanFilter)
        self._gauge = _gauge_of(frame[y : y + height, x : x + width])
        frame = frame * self._gauge
        self._shape, self._kalman, self._seen = frame.shape, kalman, True
        size = max(width, height) / 2
        self._start = np.array(
            [[size, 0, x + (width - 1) / 2], [0, size, y + (height - 1) / 2], [0, 0, 1.0]]
        )
        self._pose = self._start
        cut = partial(make_level, box=self._box, pose=self._start, motion=motion)
        self._smooth = cut(frame, smoothing=self._settings.smoothing)
        self._sharp = cut(half_pixel(frame), density=2, smoothing=0.0)
        _check_texture(self._smooth, self._sharp)
        # At least what rounding to whole numbers and interpolation leave.
        rounded = float(self._gauge) / np.sqrt(12) * (np.asarray(image).dtype.kind in "bui")
        self._least_noise = max(0.01 * self._sharp.contrast, rounded)
        view = View(frame, self._least_noise)
        self._noise, self._gain = view.noise, 1.0
        self._robust = RobustSearch(view, self._box, self._start, motion, self._settings)

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
            return self._lost("out of view")
        image = np.ascontiguousarray(as_image("frame", region) * self._gauge)
        sight = Sight(View(image, self._least_noise), shifted(self._pose, -origin))
        for stage in self._stages:
            if found := getattr(self, stage)(sight):
                return self._seen_at(found, origin)
        return self._lost(self._reason(sight.best) or "no agreement", sight.doubt)

    def _seen_at(self, found: Found, origin: Array) -> Track:
        """Keep what was found in a part of the frame that begins at `origin`."""
        fit = found.fit
        self._seen, self._pose = True, shifted(fit.pose, origin)
        if found.plain:
            self._gain = fit.gain
        corners = self._corners()
        if self._kalman is not None:
            self._kalman.update(corners.mean(axis=0))
        homography = self._pose @ np.linalg.inv(self._start)
        return Track(
            corners=corners,
            lost=False,
            reason="",
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

    def _lost(self, reason: str, confidence: float = 0.0) -> Track:
        self._seen = False
        return Track(
            corners=self._corners(),
            lost=True,
            reason=reason,
            confidence=confidence,
            hidden=np.ones(self._box[:1:-1], bool),
        )

    def _from_last_pose(self, sight: Sight) -> Found | None:
        """Align from where the template was."""
        sight.best = self._align(sight.view.image, sight.start)
        return self._nearby(sight.view, sight.best)

    def _from_flow(self, sight: Sight) -> Found | None:
        """Align from where its points flow to."""
        sight.flowing = self._robust.flowing(sight.view, sight.start)
        if not sight.flowing:
            return None
        fit = self._align(sight.view.image, sight.flowing[0])
        if found := self._nearby(sight.view, fit):
            return found
        better = not fit.failure and fit.correlation > sight.best.correlation
        if sight.best.failure or better:
            sight.best = fit
        return None

    def _in_steady_light(self, sight: Sight) -> Found | None:
        """Believe the best one if all parts agree, though it does not correlate well."""
        return self._plain(sight.best, self._settings.steady)

    def _robustly(self, sight: Sight) -> Found | None:
        """Search from all these poses; if it was lost, from anywhere in the frame."""
        anywhere = [] if self._seen else self._robust.places(sight.view, sight.start)
        starts = [sight.start, sight.best.pose, *sight.flowing, *anywhere]
        return self._searched(sight, starts, far=not self._seen)

    def _from_far_away(self, sight: Sight) -> Found | None:
        """Search from distorted and distant poses, if it was there a frame ago."""
        if not self._seen:
            return None
        return self._searched(sight, self._robust.far_starts(sight.view, sight.start), far=True)

    def _by_texture(self, sight: Sight) -> Found | None:
        """Believe the best one if what has texture agrees, though the ground between it changed."""
        return self._plain(sight.best, self._settings.unsteady)

    def _nearby(self, view: View, plain: Alignment) -> Found | None:
        """Return an alignment if it is convincing, as it is or in smooth light."""
        if self._reason(plain):
            return None
        found = None
        if plain.correlation > self._settings.convincing:
            found = self._plain(plain, self._settings.steady)
        return found or self._in_smooth_light(view, plain)

    def _align(self, image: Image, pose: Array) -> Alignment:
        """Refine a pose smoothed, and then between the pixels."""
        first = self._smooth.align(image, pose, tolerance=0.5, gain=self._gain)
        if self._reason(first):
            return first
        corners = apply_homography(first.pose, self._sharp.corners)
        near, offset = cut_around(image, corners, 4.0)
        start = shifted(first.pose, -offset)
        last = self._sharp.align(half_pixel(near), start, tolerance=0.05, gain=first.gain)
        steps = first.iterations + last.iterations
        return replace(last, pose=shifted(last.pose, offset), iterations=steps)

    def _plain(self, fit: Alignment, drift: tuple[float, float]) -> Found | None:
        """Return the alignment as the result if all parts of the template agree with it."""
        if self._reason(fit) or not self._agreeing(fit, drift):
            return None
        covariance = corner_covariance(self._sharp, fit, fit.weight, None)
        if not largest_sigma(covariance) < self._settings.certain:
            return None
        return Found(fit, covariance, 1.0, fit.weight == 0, plain=True)

    def _agreeing(self, fit: Alignment, drift: tuple[float, float]) -> bool:
        """Return whether all parts of the template agree with an alignment."""
        said = compare(fit.grey, self._sharp.grey, fit.weight, self._noise).agreement()
        steady = drift[0] * self._noise + drift[1] * abs(fit.gain) * self._sharp.contrast
        return self._enough(said) and said.drift <= steady

    def _enough(self, said: Agreement) -> bool:
        return said.agreeing >= self._settings.agreed and said.texture >= self._settings.texture

    def _in_smooth_light(self, view: View, plain: Alignment) -> Found | None:
        """Return the fit in smooth light if all parts agree with it, or it with the plain one."""
        fit = self._robust.polish(view, plain.pose)
        if fit is None:
            return None
        covariance, limit = self._robust.covariance(fit), self._settings.confirmed
        corners = self._sharp.corners
        off = np.abs(apply_homography(fit.pose, corners) - apply_homography(plain.pose, corners))
        confirmed = (
            off.max() < limit
            and largest_sigma(covariance) < limit
            and self._agreeing(plain, self._settings.unsteady)
        )
        if confirmed or self._clear(fit, covariance):
            return self._believed(fit, covariance, 1.0)
        return None

    def _searched(self, sight: Sight, starts: list[Array], *, far: bool) -> Found | None:
        """Return what the robust search finds if it is believed to be the template."""
        finding = self._robust.search(sight.view, sight.start, starts, far=far)
        if finding is None or self._reason(finding.fit):
            return None
        covariance = self._robust.covariance(finding.fit)
        probability = self._probability(sight, finding, covariance)
        if probability < self._settings.believed:
            sight.doubt = max(sight.doubt, probability)
            return None
        return self._believed(finding.fit, covariance, probability)

    def _probability(self, sight: Sight, finding: Finding, covariance: Array) -> float:
        """Return how probable it is that what a search found in a frame is the template."""
        return 1.0 if self._clear(finding.fit, covariance) else confidence(finding)

    def _clear(self, fit: LitFit, covariance: Array) -> bool:
        """Return whether all parts of the template agree in smooth light."""
        sure = largest_sigma(covariance) < self._settings.certain
        return sure and fit.noise < self._settings.clear and self._enough(fit.blocks.agreement())

    def _believed(self, fit: LitFit, covariance: Array, probability: float) -> Found:
        """Return a fit in smooth light as the result."""
        size, hidden = self._box[2:], fit.hidden
        if hidden.shape != size[::-1]:
            bits = hidden.astype(np.uint8)
            hidden = cv2.resize(bits, size, interpolation=cv2.INTER_NEAREST) > 0
        return Found(fit, covariance, probability, hidden)

    def _reason(self, fit: Alignment) -> str:
        """Return why an alignment does not count as the template, or nothing if it does."""
        low = fit.correlation < self._settings.least_correlation
        return fit.failure or ("low correlation" if low else "")

    def _corners(self) -> Array:
        return apply_homography(self._pose, self._sharp.corners)


def _gauge_of(template: Image) -> np.float32:
    """Return the power of two that brings a template's contrast to 32 … 64 grey levels."""
    contrast = float(template.std(dtype=np.float64))
    return np.float32(2.0 ** (5 - np.floor(np.log2(contrast))) if contrast > 0 else 1)


def _check_texture(smooth: Level, sharp: Level) -> None:
    """Refuse a template that a translation leaves unchanged in some direction."""
    if smooth.contrast < 0.01 * sharp.contrast:
        raise ValueError(
            f"box must hold details of more than a px, got a contrast of {sharp.contrast:.3g} of "
            f"which a blur of {smooth.smoothing:g} px leaves {smooth.contrast:.3g}"
        )
    gradient = sharp.slope.astype(np.float64)
    weak, strong = np.linalg.eigvalsh(gradient @ gradient.T)
    # A gradient that single precision may make of none; an edge with a noise of 0.5 % has 0.002.
    if strong <= (ROUNDING * np.abs(sharp.grey).max()) ** 2 * sharp.grey.size:
        raise ValueError("box must hold a textured template, got a flat one")
    if weak < 1e-4 * strong:
        raise ValueError(
            "box must hold gradients in two directions, got a template that slides along its edges"
        )
