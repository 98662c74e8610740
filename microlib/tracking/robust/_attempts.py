"""The attempts to find a template in a frame, from the fastest to the most thorough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image
from microlib.tracking._esm import Alignment
from microlib.tracking._geometry import TINY
from microlib.tracking._sampling import View
from microlib.tracking.robust._confidence import confidence
from microlib.tracking.robust._covariance import corner_covariance, largest_sigma
from microlib.tracking.robust._photometric import PhotometricFit
from microlib.tracking.robust._search import Finding, RobustSearch


@dataclass(frozen=True, eq=False)
class Found:
    """The most probable pose of the template in a frame.

    Attributes
    ----------
    fit : Alignment
        Pose, gain, bias and correlation.
    corner_covariance : ndarray, shape (8, 8)
        Covariance of the corners in px².
    hidden : ndarray of bool, shape (height, width)
        Pixels of the template that the frame does not show.
    confidence : float
        Probability that the pose is right within a pixel.
    reason : str
        Empty, or why the template counts as lost.
    """

    fit: Alignment
    corner_covariance: Array
    hidden: NDArray[np.bool_]
    confidence: float
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Sighting:
    """The last frame in which the template was found.

    Attributes
    ----------
    search : RobustSearch
        The template.
    image : ndarray, shape (H, W)
        The whole frame, its grey levels scaled as those of the template.
    pose : ndarray, shape (3, 3)
        Where the template was.
    """

    search: RobustSearch
    image: Image
    pose: Array

    @cached_property
    def lookalikes(self) -> Array:
        """Where else the template correlates, as offsets from its place (px)."""
        return self.search.lookalikes(self.image, self.pose)


@dataclass(frozen=True, eq=False)
class Scene:
    """A frame in which a template is searched; each alignment is computed when it is first needed.

    Attributes
    ----------
    search : RobustSearch
        The template.
    view : View
        The frame, or its part around the template.
    pose : ndarray, shape (3, 3)
        Expected pose, in px of the view.
    seen : bool
        Whether the template was found in the frame before.
    last : Sighting
        The last frame in which it was found.
    """

    search: RobustSearch
    view: View
    pose: Array
    seen: bool
    last: Sighting

    @cached_property
    def flow_poses(self) -> list[Array]:
        """Pose to which most points of the template flow, if there is one."""
        return self.search.flow_poses(self.view, self.pose)

    @cached_property
    def from_pose(self) -> Alignment:
        """ESM alignment that starts from the expected pose."""
        return self.search.template.align(self.view.image, self.pose)

    @cached_property
    def from_flow(self) -> Alignment:
        """ESM alignment that starts from the flow pose, unless `from_pose` ended there."""
        plain = self.from_pose
        for start in self.flow_poses:
            if plain.reason or self.search.distance(start, plain.pose) > 1:
                return self.search.template.align(self.view.image, start)
        return plain

    @cached_property
    def best(self) -> Alignment:
        """The one of these alignments with the higher correlation."""
        return max(self.from_pose, self.from_flow, key=lambda fit: fit.correlation)

    @cached_property
    def photometric_from_pose(self) -> PhotometricFit | None:
        """`from_pose`, continued with the photometric model."""
        return self.search.continue_photometrically(self.view, self.from_pose)

    @cached_property
    def photometric_from_flow(self) -> PhotometricFit | None:
        """`from_flow`, continued with the photometric model, if it ended elsewhere."""
        if self.from_flow is self.from_pose:
            return None
        return self.search.continue_photometrically(self.view, self.from_flow)

    @cached_property
    def nearby(self) -> Finding | None:
        """What the robust search finds from these poses, or from matches of a lost template."""
        search, view = self.search, self.view
        matches = [] if self.seen else search.match_poses(view, self.pose)
        starts = [self.pose, *(match for match in matches if uniqueness(self, match) > 0.5)]
        # A match is a pixel of the coarsest level, too far off for fine texture to agree.
        starts = [self.pose, *search.align_starts(view, starts), self.best.pose, *self.flow_poses]
        fits = [self.photometric_from_pose, self.photometric_from_flow]
        return search.search(view, self.pose, starts, [fit for fit in fits if fit is not None])


def align_from_pose(scene: Scene) -> Found | None:
    """Align from the expected pose."""
    if found := _plain(scene, scene.from_pose):
        return found
    return _confirmed(scene, scene.from_pose, scene.photometric_from_pose)


def align_from_flow(scene: Scene) -> Found | None:
    """Align from where the points of the template flow, if that is elsewhere."""
    if scene.from_flow is scene.from_pose:
        return None
    if found := _plain(scene, scene.from_flow):
        return found
    return _confirmed(scene, scene.from_flow, scene.photometric_from_flow)


def search_nearby(scene: Scene) -> Found | None:
    """Search robustly from these poses; from anywhere in the frame if the template was lost.

    A pose that most points of the template leave may be that of a part that resembles it. It is
    left to the search far away.
    """
    finding = scene.nearby
    if finding is None or (scene.seen and finding.inlier_ratio <= 1 / 2):
        return None
    return _judged(scene, finding)


def search_far(scene: Scene) -> Found | None:
    """Search robustly from distorted and distant poses, if the template was not lost before."""
    if not scene.seen:
        return None
    known = [] if scene.nearby is None else [scene.nearby.fit]
    starts = scene.search.far_poses(scene.view, scene.pose)
    finding = scene.search.search(scene.view, scene.pose, starts, known)
    return None if finding is None else _judged(scene, finding)


#: An attempt returns what it finds with its confidence, or None.
Attempt = Callable[[Scene], Found | None]

ATTEMPTS: tuple[Attempt, ...] = (align_from_pose, align_from_flow, search_nearby, search_far)


def find_template(scene: Scene, attempts: tuple[Attempt, ...]) -> Found:
    """Return the first pose that is confident enough, else the most probable, with the reason."""
    threshold = scene.search.settings.threshold
    most_probable: Found | None = None
    for attempt in attempts:
        found = attempt(scene)
        if found is None:
            continue
        unique = uniqueness(scene, found.fit.pose)
        probability = found.confidence * unique
        if probability >= threshold:
            return replace(found, confidence=probability)
        if most_probable is None or probability > most_probable.confidence:
            reason = "ambiguous" if unique < threshold else "no agreement"
            most_probable = replace(found, confidence=probability, reason=reason)
    return most_probable or Found(
        fit=scene.best,
        corner_covariance=np.full((8, 8), np.nan),
        hidden=np.ones(scene.search.shape, bool),
        confidence=0.0,
        reason=scene.best.reason or "no agreement",
    )


def uniqueness(scene: Scene, pose: Array) -> float:
    """Return the probability that a pose is not that of a lookalike.

    The template moves by a from the expected place, the nearest lookalike by b from its own, and
    the result is b/(a + b). A move by less than a quarter of the template meets only lookalikes
    that its first frame shows. These repeat on all sides in a periodic texture: 1 − a/b.
    """
    search = scene.search
    offset = search.displacement(scene.pose, pose)
    near = scene.seen and np.hypot(*offset) < search.side / 4
    lookalikes = search.first_lookalikes if near else scene.last.lookalikes
    if not len(lookalikes):
        return 1.0
    nearest = np.linalg.norm(lookalikes - offset, axis=1).min()
    ratio = float(np.hypot(*offset) / max(nearest, TINY))
    return max(0.0, 1 - ratio) if near else 1 / (1 + ratio)


def _plain(scene: Scene, plain: Alignment) -> Found | None:
    """Return an alignment of one gain and bias if all blocks agree within the noise."""
    search, settings = scene.search, scene.search.settings
    if not search.blocks_agree(plain, settings.steady_light):
        return None
    covariance = corner_covariance(search.template.sharp, plain, plain.weight)
    if largest_sigma(covariance) >= settings.max_sigma:
        return None
    return Found(fit=plain, corner_covariance=covariance, hidden=plain.weight == 0, confidence=1.0)


def _confirmed(scene: Scene, plain: Alignment, fit: PhotometricFit | None) -> Found | None:
    """Return a photometric fit in which all blocks agree, or which confirms a plain alignment."""
    if fit is None:
        return None
    search, covariance = scene.search, scene.search.covariance(fit)
    difference = max(search.distance(fit.pose, plain.pose), largest_sigma(covariance))
    confirms = difference < search.settings.max_difference and search.blocks_agree(plain)
    if confirms or _is_clear(scene, fit, covariance):
        return _found(scene, fit, covariance, 1.0)
    return None


def _judged(scene: Scene, finding: Finding) -> Found | None:
    """Return what a robust search finds, with its confidence."""
    if finding.fit.reason:
        return None
    covariance = scene.search.covariance(finding.fit)
    clear = _is_clear(scene, finding.fit, covariance)
    probability = 1.0 if clear else confidence(finding, largest_sigma(covariance))
    return _found(scene, finding.fit, covariance, probability)


def _is_clear(scene: Scene, fit: PhotometricFit, covariance: Array) -> bool:
    """Return whether all blocks of the template agree with a fit of the photometric model."""
    settings = scene.search.settings
    precise = largest_sigma(covariance) < settings.max_sigma and fit.noise < settings.max_residual
    return precise and scene.search.is_enough(fit.blocks.agreement())


def _found(scene: Scene, fit: PhotometricFit, covariance: Array, probability: float) -> Found:
    """Return a fit of the photometric model, with its hidden pixels at full resolution."""
    size = scene.search.shape[::-1]
    hidden = cv2.resize(fit.hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return Found(fit=fit, corner_covariance=covariance, hidden=hidden > 0, confidence=probability)
