"""The result of tracking one frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, FlatResult, flat_row


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Track(FlatResult):
    """Position of the template in one frame, with its covariance.

    Attributes
    ----------
    corners : ndarray, shape (4, 2)
        Corners of the box as (x, y) in px, in the order of the box: first row left and right, last
        row right and left. When `lost` those where it was last seen (moved on by the Kalman filter,
        if there is one); all numbers below but `confidence` and `iterations` are then NaN.
    lost : bool
        Whether the template was not found.
    reason : str
        Empty, or why it was not: ``"singular"``, ``"diverged"``, ``"out of view"``, ``"low
        correlation"``, ``"no agreement"`` of the template's parts, ``"two motions"``: only the
        ground in the box agrees, because the object moved (then pass a `mask`), or ``"ambiguous"``:
        something looks alike. In a periodic texture that surrounds the template on all sides, these
        are motions by more than 0.38 of the period.
    correlation : float
        Normalized correlation of the template and the frame under the warp, −1 to 1; where only
        parts of the template agree or the light changes, of these parts in that light.
    homography : ndarray, shape (3, 3)
        Maps px of the template's frame to px of this frame.
    gain, bias : float
        The frame's grey values are ``gain``·template + ``bias``; if the light changes differently
        over the template, those at its middle.
    visible : float
        Share of the object's pixels that the frame shows; where the photometric model was fitted,
        without those that are saturated in the frame only.
    iterations : int
        Steps of the accepted alignment: of both levels of a plain one, of the last level of a
        photometric one; 0 when `lost`.
    covariance : ndarray, shape (2, 2)
        Covariance of `center` in px², from the residual of the alignment and how it varies over the
        template.
    confidence : float
        Probability that the pose is right within a pixel. It is 1 where every part of the template
        agrees within the noise, and else an estimate that was fitted to photographs. It is 0 if the
        pose is ambiguous, or that of the ground in the box. Below 0.7 the template counts as lost;
        `confidence` is then that of the most probable pose, or 0.
    hidden : ndarray of bool, shape (height, width)
        Pixels of the object where the frame shows something else, or nothing; all when `lost`.
        The object is the box, or what the mask of the tracker contains of it.
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
    confidence: float
    hidden: NDArray[np.bool_]

    _large = ("hidden",)

    def to_dict(self) -> dict[str, Any]:
        """Return the track as a flat dictionary that JSON can hold.

        Returns
        -------
        dict
            The fields, `center`, and the share of the box that is `hidden`. When `lost` is true,
            all values but `lost`, `reason` and `confidence` are None.
        """
        share = {"center": self.center, "hidden": float(np.mean(self.hidden))}
        row = super().to_dict() | flat_row(share)
        valid = ("lost", "reason", "confidence") if self.lost else row
        return {name: row[name] if name in valid else None for name in row}

    @property
    def center(self) -> Array:
        """Mean of the corners, (x, y) in px: the feature that §5.4 servos on."""
        return self.corners.mean(axis=0)
