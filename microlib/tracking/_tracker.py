"""Template tracking by efficient second-order minimization (§5.3)."""

from __future__ import annotations

from copy import deepcopy
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import (
    ArgumentError,
    Array,
    as_array,
    as_choice,
    as_image,
    as_instance,
    as_region,
    luminance,
)
from microlib.tracking._esm import Template, check_texture, make_level
from microlib.tracking._geometry import GENERATORS, cut_around, translate
from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._sampling import SearchFrame, half_pixel
from microlib.tracking._settings import TrackerSettings
from microlib.tracking._track import Track
from microlib.tracking.robust import (
    ATTEMPTS,
    Candidate,
    Search,
    Sighting,
    find_template,
    make_search_template,
)


class ESMTracker:
    """Track a template through frames by efficient second-order minimization.

    Efficient second-order minimization (ESM) [1]_ [2]_ aligns the template with each frame,
    starting from the expected pose. The template is then divided into blocks, which are compared
    with the frame. If too many blocks differ by more than the noise, a second alignment starts
    from this pose, with a model of changes of light, blur and the camera's response curve. Hidden
    parts get less weight, by Tukey's function [3]_. If this result is not accepted, further
    attempts start from other poses. Chapter 2 of the book explains the attempts.

    The first result whose estimated probability of being right is at least 0.7, and whose position
    is unambiguous, is accepted. If there is no such result, the template is reported as lost. In
    the following frames, a lost template is searched for in the whole frame, or, with a Kalman
    filter, near the predicted position.

    A visible template may be reported as lost, for example in these cases:

    - A large part of the template is hidden or covered by a reflection.
    - Another object in the frame resembles the template.
    - The template contains an object and textured ground that moves differently (``"two
      motions"``). What moves with the surroundings of the box counts as ground and is not followed.
      Draw the box tightly around the object, or give a `mask` that excludes the ground.
    - The texture is periodic in the box and around it, and the motion between two frames is large.
      Keep the motion below a third of the period: motion by a whole period cannot be distinguished
      from rest.


    Parameters
    ----------
    image : array_like, shape (H, W) or (H, W, 3)
        Frame that shows the template. Color is converted to luminance.
    box : tuple of int
        (x, y, width, height) of the template in px: columns x … x + width − 1, rows y … y + height
        − 1.
    motion : {"homography", "affine", "translation"}
        Kind of transformation between the template and a frame.
    kalman : KalmanFilter, optional
        Filter that predicts where the search in each frame starts. The filter also limits the
        region in which a lost template is searched for. The tracker uses a copy, so that the filter
        can serve for other films. By default a search starts at the last accepted pose.
    mask : array_like, shape (H, W) or (H, W, 3), optional
        Not 0 (or True) where the frame shows the object. Only these pixels of the box are tracked.
        By default all pixels of the box are used.

    Attributes
    ----------
    kalman : KalmanFilter or None
        The copy of the filter, which may be exchanged between two frames; it is copied again.

    Raises
    ------
    ValueError
        If the box extends beyond the image or has a side below 6 px. If the position of the
        template is undetermined, because it has no texture or texture in one direction only. If the
        texture is so fine that the smoothing before the alignment removes it.

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

    #: A subclass may have other settings, and other attempts in another order.
    _settings, _attempts = TrackerSettings(), ATTEMPTS

    def __init__(
        self,
        image: ArrayLike,
        box: tuple[int, int, int, int],
        motion: str = "homography",
        *,
        kalman: KalmanFilter | None = None,
        mask: ArrayLike | None = None,
    ) -> None:
        frame = np.ascontiguousarray(as_image("image", luminance("image", image)))
        motion = as_choice("motion", motion, tuple(GENERATORS))
        x, y, width, height = self._box = as_region("box", box, frame.shape, least=6)
        weight, self._object = None, np.ones((height, width), bool)
        if mask is not None:
            whole = as_array("mask", luminance("mask", mask), shape=frame.shape) != 0
            self._object, weight = whole[y : y + height, x : x + width], whole.astype(np.float32)
            pixels = np.count_nonzero(self._object)
            if pixels < 36:
                raise ArgumentError("mask", f"must hold at least 36 px of the box, got {pixels}")
        # The power of two that brings the template's contrast to 32 … 64 grey levels.
        contrast = float(frame[y : y + height, x : x + width].std(dtype=np.float64))
        self._grey_scale = np.float32(2.0 ** (5 - np.floor(np.log2(contrast))) if contrast else 1)
        frame = frame * self._grey_scale
        self._shape, self._seen, self._parted = frame.shape, True, False
        self.kalman = kalman
        size = max(width, height) / 2
        self._start = np.array(
            [[size, 0, x + (width - 1) / 2], [0, size, y + (height - 1) / 2], [0, 0, 1.0]]
        )
        self._pose = self._start
        settings = self._settings
        cut = partial(
            make_level,
            box=self._box,
            pose=self._start,
            motion=motion,
            settings=settings,
            mask=weight,
        )
        plain = Template(
            smooth=cut(frame, smoothing=settings.smoothing),
            sharp=cut(half_pixel(frame), density=2, smoothing=0.0),
        )
        check_texture(plain)
        # At least what rounding to whole numbers and interpolation leave.
        rounded = float(self._grey_scale) / np.sqrt(12) * (np.asarray(image).dtype.kind in "bui")
        self._least_noise = max(0.01 * plain.sharp.contrast, rounded)
        self._template = make_search_template(
            plain,
            SearchFrame(frame, self._least_noise),
            box=self._box,
            pose=self._start,
            motion=motion,
            settings=settings,
            mask=weight,
        )
        self._last = Sighting(frame, self._pose)

    @property
    def kalman(self) -> KalmanFilter | None:
        return self._kalman

    @kalman.setter
    def kalman(self, kalman: KalmanFilter | None) -> None:
        if kalman is not None:
            kalman = deepcopy(as_instance("kalman", kalman, KalmanFilter))
        self._kalman = kalman

    def track(self, frame: ArrayLike) -> Track:
        """Find the template in the next frame.

        Parameters
        ----------
        frame : array_like, shape (H, W) or (H, W, 3)
            Frame of the same size as the first. Color is converted to luminance.

        Returns
        -------
        Track
            ``lost`` is true if the template was not found, and ``reason`` states why. The template
            is then searched for in the whole next frame, or near the prediction of the Kalman
            filter.

        Raises
        ------
        ValueError
            If the frame is not an image of the size of the first frame, or is not finite where the
            template is searched for.
        """
        frame = luminance("frame", frame)
        if frame.shape != self._shape:
            raise ValueError(f"frame must have shape {self._shape}, got {frame.shape}")
        if self.kalman is not None:
            center = self._corners().mean(axis=0)
            self._pose = translate(self._pose, self.kalman.predict() - center)
        corners = self._corners()
        margin = np.ptp(corners, axis=0).max()
        if not self._seen:  # anywhere, or within five standard deviations of the prediction
            sigma = np.inf if self.kalman is None else np.sqrt(self.kalman.covariance[0, 0])
            margin = max(margin, 5 * sigma)
        region, origin = cut_around(frame, corners, margin)
        if min(region.shape) < 2:
            return self._lost("out of view")
        image = np.ascontiguousarray(as_image("frame", region) * self._grey_scale)
        last_region, _ = cut_around(self._last.image, corners, margin)
        search = Search(
            template=self._template,
            frame=SearchFrame(image, self._least_noise),
            pose=translate(self._pose, -origin),
            seen=self._seen,
            last=Sighting(last_region, translate(self._last.pose, -origin)),
            parted=self._parted,
        )
        best = find_template(search, self._attempts)
        self._parted |= best.reason == "two motions"
        if best.reason:
            return self._lost(best.reason, best.confidence)
        self._seen, self._pose = True, translate(best.fit.pose, origin)
        self._last = Sighting(frame.astype(np.float32) * self._grey_scale, self._pose)
        return self._found(best)

    def _found(self, best: Candidate) -> Track:
        fit, corners = best.fit, self._corners()
        if self.kalman is not None:
            self.kalman.update(corners.mean(axis=0))
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
            covariance=best.corner_covariance.reshape(4, 2, 4, 2).mean(axis=(0, 2)),
            confidence=best.confidence,
            hidden=best.hidden & self._object,
        )

    def _lost(self, reason: str, confidence: float = 0.0) -> Track:
        self._seen = False
        return Track(
            corners=self._corners(),
            lost=True,
            reason=reason,
            confidence=confidence,
            hidden=self._object.copy(),
        )

    def _corners(self) -> Array:
        return self._template.plain.corners_of(self._pose)
