"""Template tracking by efficient second-order minimization (§5.3)."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import (
    Array,
    Image,
    as_image,
    as_region,
    luminance,
    of_kind,
    one_of,
)
from microlib.tracking._esm import Template, make_level
from microlib.tracking._geometry import (
    GENERATORS,
    ROUNDING,
    apply_homography,
    cut_around,
    translate,
)
from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._sampling import View, half_pixel
from microlib.tracking._track import Track
from microlib.tracking.robust import Found, RobustSearch, Scene, find_template

#: Standard deviation (px) of the Gaussian of the smoothed level. With twice as much, fine texture
#: is lost; without it, the search does not reach as far.
_SMOOTHING = 1.25


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
       distorted, in 32 ways, or translated to where it correlates best.
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
        self._grey_scale = _grey_scale_of(frame[y : y + height, x : x + width])
        frame = frame * self._grey_scale
        self._shape, self._kalman, self._seen = frame.shape, kalman, True
        size = max(width, height) / 2
        self._start = np.array(
            [[size, 0, x + (width - 1) / 2], [0, size, y + (height - 1) / 2], [0, 0, 1.0]]
        )
        self._pose = self._start
        cut = partial(make_level, box=self._box, pose=self._start, motion=motion)
        self._template = Template(
            smooth=cut(frame, smoothing=_SMOOTHING),
            sharp=cut(half_pixel(frame), density=2, smoothing=0.0),
        )
        _check_texture(self._template)
        # At least what rounding to whole numbers and interpolation leave.
        rounded = float(self._grey_scale) / np.sqrt(12) * (np.asarray(image).dtype.kind in "bui")
        self._least_noise = max(0.01 * self._template.sharp.contrast, rounded)
        view = View(frame, self._least_noise)
        self._search = RobustSearch(self._template, view, self._box, self._start, motion)

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
            self._pose = translate(self._pose, self._kalman.predict() - center)
        region: Image = frame
        origin: Array = np.zeros(2)
        if self._seen:  # else it is sought in the whole frame
            corners = self._corners()
            region, origin = cut_around(frame, corners, np.ptp(corners, axis=0).max())
        if min(region.shape) < 2:
            return self._lost("out of view")
        image = np.ascontiguousarray(as_image("frame", region) * self._grey_scale)
        view = View(image, self._least_noise)
        scene = Scene(self._search, view, translate(self._pose, -origin), self._seen)
        found = find_template(scene)
        if found is None:
            return self._lost(scene.best.reason or "no agreement")
        if found.confidence < self._search.settings.threshold:
            return self._lost("no agreement", found.confidence)
        return self._accept(found, origin)

    def _accept(self, found: Found, origin: Array) -> Track:
        """Keep what was found in a part of the frame that begins at `origin`."""
        fit = found.fit
        self._seen, self._pose = True, translate(fit.pose, origin)
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
            bias=fit.bias / float(self._grey_scale),
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

    def _corners(self) -> Array:
        return apply_homography(self._pose, self._template.sharp.corners)


def _grey_scale_of(template: Image) -> np.float32:
    """Return the power of two that brings a template's contrast to 32 … 64 grey levels."""
    contrast = float(template.std(dtype=np.float64))
    return np.float32(2.0 ** (5 - np.floor(np.log2(contrast))) if contrast > 0 else 1)


def _check_texture(template: Template) -> None:
    """Refuse a template that a translation leaves unchanged in some direction."""
    smooth, sharp = template.smooth, template.sharp
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
