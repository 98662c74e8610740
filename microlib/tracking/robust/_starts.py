"""Poses to start from: optical flow of points, peaks of the correlation, and distortions."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from microlib._common import Array, Image
from microlib.tracking._esm import Level
from microlib.tracking._geometry import GENERATORS, TINY, apply_homography, retract, translate
from microlib.tracking._sampling import padding, sample


class PointFlow:
    """Points of the template that pyramidal Lucas–Kanade follows in images of local contrast.

    Of a shadow or a highlight, an image of local contrast shows only the edges.
    """

    def __init__(self, level: Level, image: Image, pose: Array, margin: int) -> None:
        self._level, self._margin, settings = level, margin, level.settings
        self._min_points, spacing = settings.min_points, settings.point_spacing
        rows, columns = (
            np.arange(2 + (side - 5) % spacing // 2, side - 2, spacing) for side in level.grey.shape
        )
        place = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        self._points = place[level.weight[tuple(place.T[::-1])] > 0].astype(np.float32)
        self._error = settings.point_error / level.to_image[0, 0]
        self._template = self._contrasts(image, pose)

    def inlier_ratio(self, image: Image, pose: Array) -> float:
        """Return the share of the points in view that stay when they are followed from a pose."""
        here, there = self._followed(image, pose)
        last = np.subtract(image.shape[::-1], 1) / self._level.to_image[0, 0]
        in_view = ((here >= 0) & (here <= last)).all(axis=1)
        stay = in_view & (np.abs(there - here).max(axis=1) < 2 * self._error)
        return float(stay.sum() / max(in_view.sum(), min(len(here), self._min_points), 1))

    def flow_pose(self, image: Image, pose: Array) -> Array | None:
        """Return the pose in which most points agree when they are followed from a pose."""
        here, there = self._followed(image, pose)
        known = np.isfinite(there).all(axis=1)
        here, there = here[known].astype(np.float32), there[known].astype(np.float32)
        if len(here) < self._min_points:
            return None
        motion, inliers = _ransac(here, there, len(self._level.basis), self._error)
        return None if motion is None or inliers.sum() < self._min_points else motion @ pose

    def ground_evidence(
        self, image: Image, pose: Array, hidden: NDArray[np.bool_]
    ) -> tuple[float, float, float]:
        """Compare local contrasts to find out whether a pose is that of the ground in the box.

        Returns
        -------
        around : float
            Correlation of the surroundings of the template, up to half its longer side, with the
            image under the pose.
        elsewhere : float
            By how much more the hidden part of the template correlates with one place nearby than
            with all others: a part that moved is there, one that is covered is not.
        around_there : float
            Correlation of the surroundings if the template were at that place.
        """
        near = self._margin // 2
        far = self._margin - near
        template, wide = (
            each.astype(np.float32) - 128 for each in (self._template, self._contrasts(image, pose))
        )
        template, seen = template[far:-far, far:-far], wide[far:-far, far:-far]
        inside = np.s_[near:-near, near:-near]
        part = cv2.resize(hidden.astype(np.float32), self._level.grey.shape[::-1])
        own, outside = template[inside] * part, np.ones_like(template)
        outside[inside] = 0
        # The power is at least that of rounding to whole levels.
        least = max(float(part.sum()), 1.0)
        power = np.maximum(cv2.matchTemplate(seen * seen, part, cv2.TM_CCORR), least)
        power *= max(float(np.square(own).sum()), least)
        scores = cv2.matchTemplate(seen, own, cv2.TM_CCORR) / np.sqrt(power)
        y, x = np.unravel_index(scores.argmax(), scores.shape)
        best, moved = scores[y, x], np.hypot(y - near, x - near) / self._level.to_image[0, 0] > 1
        scores[max(0, y - 3) : y + 4, max(0, x - 3) : x + 4] = 0
        top, left = y + far - near, x + far - near
        there = wide[top : top + len(seen), left : left + len(seen.T)]
        around, around_there = (
            _correlation(template * outside, each * outside) for each in (seen, there)
        )
        return around, float(best - scores.max()) * moved, around_there

    def _followed(self, image: Image, pose: Array) -> tuple[Array, Array]:
        """Return the points under a pose, and where they go, infinite where they are lost."""
        after, ok, _ = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
            self._template,
            self._contrasts(image, pose),
            self._points + np.float32(self._margin),
            None,
            winSize=(15,) * 2,
            maxLevel=int(np.ceil(np.log2(max(2, self._margin / 8)))),
        )
        to_frame = self._level.to_template.copy()
        to_frame[:2, 2] += to_frame[0, 0] * padding(self._level.smoothing)
        to_frame = pose @ to_frame
        there = apply_homography(to_frame, after - np.float32(self._margin))
        return apply_homography(to_frame, self._points), np.where(ok > 0, there, np.inf)

    def _contrasts(self, image: Image, pose: Array) -> Image:
        """Return the image under a pose and the margin about it, in local contrast, 8 bits."""
        level, margin = self._level, self._margin
        begin = np.eye(3)
        begin[:2, 2] = padding(level.smoothing) - margin
        rows, columns = level.grey.shape
        warp = level.to_image @ pose @ level.to_template @ begin
        seen, _ = sample(image, warp, (columns + 2 * margin, rows + 2 * margin))
        off = seen - cv2.GaussianBlur(seen, (0, 0), 4)
        # A tenth of the template's contrast counts as noise; the usual contrast becomes 40 levels.
        faint = max(level.contrast / 10, TINY) ** 2
        size = np.sqrt(cv2.GaussianBlur(off * off, (0, 0), 4) + faint)
        return np.clip(128 + 40 * off / size, 0, 255).astype(np.uint8)


def _ransac(
    here: Image, there: Image, n: int, error: float
) -> tuple[Array | None, NDArray[np.bool_]]:
    """Return the motion of `n` parameters with most inliers, and which these are."""
    if n == len(GENERATORS["translation"]):
        moves = there - here
        near = np.square(moves[:, None] - moves).sum(axis=2) < error**2
        inliers = near[near.sum(axis=1).argmax()]
        return translate(np.eye(3), moves[inliers].mean(axis=0)), inliers
    estimate: Any = cv2.estimateAffine2D if n == len(GENERATORS["affine"]) else cv2.findHomography
    options = {"method": cv2.RANSAC, "ransacReprojThreshold": error, "maxIters": 200}
    matrix, inliers = estimate(here, there, **options)
    motion = None if matrix is None else np.vstack([matrix, [0, 0, 1]])[:3]
    return motion, np.asarray(inliers).ravel() > 0


def ncc_peaks(
    level: Level, image: Image, pose: Array, *, apart: int, least: float = 0.0
) -> list[Array]:
    """Return a pose translated to the peaks of the normalized cross-correlation, best first.

    The peaks in an image of the template's level are at least `least` and so many px `apart`.
    """
    from skimage.feature import peak_local_max  # imported here because it takes long

    if min(np.subtract(image.shape, level.grey.shape)) < 0:
        return []
    smooth = cv2.GaussianBlur(image, (0, 0), level.smoothing) if level.smoothing else image
    mask = None if level.mask is None else level.weight
    scores = cv2.matchTemplate(smooth, level.grey, cv2.TM_CCOEFF_NORMED, mask=mask)
    scores = np.where(np.isfinite(scores), scores, -1.0)  # a flat part of the image under a mask
    peaks = peak_local_max(scores, min_distance=apart, threshold_abs=least, exclude_border=False)
    middle = (np.array(level.grey.shape[::-1]) - 1) / 2
    places = (peaks[:, ::-1] + middle) / level.to_image[0, 0]
    center = apply_homography(pose, level.corners).mean(axis=0)
    return [translate(pose, place - center) for place in places]


def distortions(basis: Array, size: float) -> list[Array]:
    """Return warps that step by ± `size` along every generator of a group of deformations.

    The signs are the rows of a Hadamard matrix and these rows with two signs changed, which is as
    far apart as 32 patterns of eight signs can be.
    """
    if len(basis) == len(GENERATORS["translation"]):
        return []
    rows = hadamard(8)
    changed = rows * [-1, 1, 1, 1, 1, 1, 1, -1]
    signs = np.concatenate([rows, -rows, changed, -changed])[:, : len(basis)]
    return list(retract(np.eye(3), size * signs, basis))


def _correlation(one: Image, other: Image) -> float:
    return float((one * other).sum() / np.sqrt(max((one**2).sum() * (other**2).sum(), TINY)))
