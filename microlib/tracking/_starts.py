"""Where might the template be? Its points' flow, its best matches, and its distortions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from microlib._common import Array, Image
from microlib.tracking._esm import Level
from microlib.tracking._geometry import TINY, apply_homography, shifted
from microlib.tracking._sampling import padding, sample

#: Standard deviation (px) of the surroundings whose contrast is made one before points are
#: followed, their contrast in the template's that is noise, and grey levels of one such contrast.
_SURROUNDINGS, _FAINT, _LEVELS = 4.0, 0.1, 40.0

#: Side (px) of the window about a point, px between points, and their error (px).
_WINDOW, _EVERY, _ERROR = 15, 5, 1.5

#: Fewest points that make a motion, how many motions are looked for, and most samples for each.
_FEWEST, _MOTIONS, _TRIALS = 8, 2, 200


@dataclass(frozen=True, eq=False)
class Flow:
    """Where the template's points went that were followed from a pose.

    Attributes
    ----------
    points : ndarray, shape (N, 2)
        In normalized coordinates of the template.
    targets : ndarray, shape (N, 2)
        Px of the frame; infinite for a point that was lost.
    pose : ndarray, shape (3, 3)
        From which they were followed.
    error : float
        Of a target, px.
    unknowns : int
        Of the motion.
    """

    points: Array
    targets: Array
    pose: Array
    error: float
    unknowns: int

    def support(self, pose: Array) -> float:
        """Return the share of the points that went where a pose takes them."""
        if not len(self.points):
            return 0.0
        off = np.abs(apply_homography(pose, self.points) - self.targets).max(axis=1)
        return float((off < 2 * self.error).mean())

    @cached_property
    def poses(self) -> list[Array]:
        """Poses that most points agree in, the first one above all."""
        known = np.isfinite(self.targets).all(axis=1)
        here = apply_homography(self.pose, self.points)[known].astype(np.float32)
        there = self.targets[known].astype(np.float32)
        found: list[Array] = []
        while len(found) < _MOTIONS and len(here) >= _FEWEST:
            motion, agree = _agreed(here, there, self.unknowns, self.error)
            if motion is None or agree.sum() < _FEWEST:
                break
            found.append(motion @ self.pose)
            here, there = here[~agree], there[~agree]
        return found


class PointFlow:
    """The template's points, to be followed by pyramidal Lucas–Kanade in local contrast.

    Local contrast leaves neither a shadow nor a highlight, but for their edges.
    """

    def __init__(self, level: Level, image: Image, pose: Array, reach: int) -> None:
        self._level, self._reach = level, reach
        rows, columns = (
            np.arange(2 + (side - 5) % _EVERY // 2, side - 2, _EVERY) for side in level.grey.shape
        )
        place = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        self._points = place.astype(np.float32)
        self._template = self._contrasts(image, pose)

    def follow(self, image: Image, pose: Array) -> Flow:
        """Follow the points from a pose."""
        after, ok, _ = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
            self._template,
            self._contrasts(image, pose),
            self._points + np.float32(self._reach),
            None,
            winSize=(_WINDOW, _WINDOW),
            maxLevel=int(np.ceil(np.log2(max(2, self._reach / 8)))),
        )
        to_template = self._level.to_template.copy()
        to_template[:2, 2] += to_template[0, 0] * padding(self._level.smoothing)
        seen = apply_homography(pose @ to_template, after - np.float32(self._reach))
        return Flow(
            points=apply_homography(to_template, self._points),
            targets=np.where(ok > 0, seen, np.inf),
            pose=pose,
            error=_ERROR / self._level.to_image[0, 0],
            unknowns=len(self._level.basis),
        )

    def _contrasts(self, image: Image, pose: Array) -> Image:
        """Return the image under a pose and the reach about it, in local contrast, 8 bits."""
        level, reach = self._level, self._reach
        begin = np.eye(3)
        begin[:2, 2] = padding(level.smoothing) - reach
        rows, columns = level.grey.shape
        warp = level.to_image @ pose @ level.to_template @ begin
        seen, _ = sample(image, warp, (columns + 2 * reach, rows + 2 * reach))
        off = seen - cv2.GaussianBlur(seen, (0, 0), _SURROUNDINGS)
        faint = (_FAINT * max(level.contrast, 1e-6)) ** 2
        size = np.sqrt(cv2.GaussianBlur(off * off, (0, 0), _SURROUNDINGS) + faint)
        return np.clip(128 + _LEVELS * off / size, 0, 255).astype(np.uint8)


def _agreed(
    here: Image, there: Image, n: int, error: float
) -> tuple[Array | None, NDArray[np.bool_]]:
    """Return the motion of `n` parameters that most points agree in, and which these are."""
    if n == 2:
        moves = there - here
        near = np.square(moves[:, None] - moves).sum(axis=2) < error**2
        agree = near[near.sum(axis=1).argmax()]
        return shifted(np.eye(3), moves[agree].mean(axis=0)), agree
    if n == 6:
        part, inliers = cv2.estimateAffine2D(
            here, there, ransacReprojThreshold=error, maxIters=_TRIALS
        )
        motion = None if part is None else np.vstack([part, [0.0, 0, 1]])
    else:
        motion, inliers = cv2.findHomography(here, there, cv2.RANSAC, error, maxIters=_TRIALS)
    return motion, np.asarray(inliers).ravel() > 0


def best_matches(level: Level, image: Image, pose: Array, count: int) -> list[Array]:
    """Return a pose shifted to where the template correlates best in an image of its level."""
    if min(np.subtract(image.shape, level.grey.shape)) < 0:
        return []
    smooth = cv2.GaussianBlur(image, (0, 0), level.smoothing) if level.smoothing else image
    scores = cv2.matchTemplate(smooth, level.grey, cv2.TM_CCOEFF_NORMED)
    apart = np.ones([2 * (side // 4) + 1 for side in level.grey.shape], np.uint8)
    peaks = (scores == cv2.dilate(scores, apart)) & np.isfinite(scores) & (scores > 0)
    rows, columns = np.nonzero(peaks)
    best = np.argsort(-scores[rows, columns], kind="stable")[:count]
    middle = (np.array(level.grey.shape[::-1]) - 1) / 2
    places = (np.column_stack([columns[best], rows[best]]) + middle) / level.to_image[0, 0]
    center = apply_homography(pose, level.corners).mean(axis=0)
    return [shifted(pose, place - center) for place in places]


def distortions(corners: Array, motion: str, by: float) -> list[Array]:
    """Return warps of the template that move every coordinate of its corners, up or down.

    They move `by` that share of its side. Their signs are the rows of a Hadamard matrix and these
    rows with two signs changed, which is as far apart as 32 patterns of eight signs can be.
    """
    if motion == "translation":
        return []
    rows = hadamard(8)
    changed = rows * [-1, 1, 1, 1, 1, 1, 1, -1]
    signs = np.concatenate([rows, -rows, changed, -changed]).reshape(-1, 4, 2)
    moves = by * np.ptp(corners, axis=0) * signs
    if motion == "affine":  # the nearest ones to these, but for those that are none at all
        design = np.column_stack([corners, np.ones(4)])
        moves = design @ np.linalg.pinv(design) @ moves
        moves = moves[np.abs(moves).max(axis=(1, 2)) > TINY]
    first, moved = corners.astype(np.float32), (corners + moves).astype(np.float32)
    return [np.asarray(cv2.getPerspectiveTransform(first, target)) for target in moved]
