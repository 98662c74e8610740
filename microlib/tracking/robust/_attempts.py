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
from microlib.tracking.robust._search import RobustSearch


@dataclass(frozen=True, eq=False)
class Found:
    """A pose that an attempt found.

    Attributes
    ----------
    fit : Alignment
        Pose, gain, bias and correlation.
    corner_covariance : ndarray, shape (8, 8)
        Covariance of the corners in px².
    confidence : float
        Probability that the pose is right within a pixel.
    hidden : ndarray of bool, shape (height, width)
        Pixels of the template that the frame does not show.
    ambiguous : bool
        Whether it may be a lookalike, or the template moved by another period of its texture.
    """

    fit: Alignment
    corner_covariance: Array
    confidence: float
    hidden: NDArray[np.bool_]
    ambiguous: bool = False


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
        """Poses to which the points of the template flow."""
        return self.search.flow_poses(self.view, self.pose)

    @cached_property
    def from_pose(self) -> Alignment:
        """ESM alignment that starts from the expected pose."""
        return self.search.template.align(self.view.image, self.pose)

    @cached_property
    def from_flow(self) -> Alignment:
        """ESM alignment that starts from where the points flow, if that is not where it is."""
        plain = self.from_pose
        for start in self.flow_poses[:1]:
            if plain.reason or self._distance(start, plain.pose) > 1:
                return self.search.template.align(self.view.image, start)
        return plain

    @cached_property
    def photometric_from_pose(self) -> PhotometricFit | None:
        """The first of these alignments continued with the photometric model."""
        plain = self.from_pose
        return None if plain.reason else self.search.polish(self.view, plain.pose)

    @cached_property
    def photometric_from_flow(self) -> PhotometricFit | None:
        """The second of these alignments continued with the photometric model."""
        plain = self.from_flow
        if plain is self.from_pose or plain.reason:
            return self.photometric_from_pose
        return self.search.polish(self.view, plain.pose)

    def _distance(self, pose: Array, other: Array) -> float:
        """Return the largest coordinate by which the corners of two poses differ, px."""
        return float(np.abs(self.search.corners_of(pose) - self.search.corners_of(other)).max())

    @cached_property
    def best(self) -> Alignment:
        """The one of these alignments with the higher correlation."""
        return max(self.from_pose, self.from_flow, key=lambda fit: fit.correlation)


def align_from_pose(scene: Scene) -> Found | None:
    """Align from the expected pose."""
    return _without_search(scene, scene.from_pose, lambda: scene.photometric_from_pose)


def align_from_flow(scene: Scene) -> Found | None:
    """Align from where the points of the template flow."""
    if scene.from_flow is scene.from_pose:
        return None
    return _without_search(scene, scene.from_flow, lambda: scene.photometric_from_flow)


def search_nearby(scene: Scene) -> Found | None:
    """Search robustly from these poses; from anywhere in the frame if the template was lost."""
    matches = [] if scene.seen else scene.search.match_poses(scene.view, scene.pose)
    starts = [scene.pose, *(match for match in matches if uniqueness(scene, match) > 0.5)]
    # A match is a pixel of the coarsest level, which is too far off for fine texture to agree.
    aligned = scene.search.align_starts(scene.view, starts)
    fits = [scene.photometric_from_pose, scene.photometric_from_flow]
    return _searched(scene, [scene.pose, *aligned, scene.best.pose, *scene.flow_poses], fits)


def search_far(scene: Scene) -> Found | None:
    """Search robustly from distorted and distant poses, if the template was not lost before."""
    if not scene.seen:
        return None
    return _searched(scene, scene.search.far_poses(scene.view, scene.pose), [])


ATTEMPTS: tuple[Callable[[Scene], Found | None], ...] = (
    align_from_pose,
    align_from_flow,
    search_nearby,
    search_far,
)


def _without_search(
    scene: Scene, plain: Alignment, photometric: Callable[[], PhotometricFit | None]
) -> Found | None:
    """Return an alignment if its blocks agree: as it is, or with the photometric model."""
    if plain.reason:
        return None
    search, settings = scene.search, scene.search.settings
    sharp = search.template.sharp
    if search.blocks_agree(plain, settings.steady_light):
        covariance = corner_covariance(sharp, plain, plain.weight)
        if largest_sigma(covariance) < settings.certain:
            return Found(plain, covariance, 1.0, plain.weight == 0)
    fit = photometric()
    if fit is None:
        return None
    covariance = search.covariance(fit)
    off = search.corners_of(fit.pose) - search.corners_of(plain.pose)
    confirmed = max(np.abs(off).max(), largest_sigma(covariance)) < settings.confirmed
    if _is_clear(scene, fit, covariance) or (confirmed and search.blocks_agree(plain)):
        return _found(scene, fit, covariance, 1.0)
    return None


def _searched(scene: Scene, starts: list[Array], fits: list[PhotometricFit | None]) -> Found | None:
    """Return what the robust search finds, with its confidence."""
    ended = [fit for fit in fits if fit is not None]
    finding = scene.search.search(scene.view, scene.pose, starts, ended)
    if finding is None or finding.fit.reason:
        return None
    covariance = scene.search.covariance(finding.fit)
    clear = _is_clear(scene, finding.fit, covariance)
    return _found(
        scene,
        finding.fit,
        covariance,
        1.0 if clear else confidence(finding, largest_sigma(covariance)),
    )


def _is_clear(scene: Scene, fit: PhotometricFit, covariance: Array) -> bool:
    """Return whether all blocks of the template agree with a fit of the photometric model."""
    settings = scene.search.settings
    precise = largest_sigma(covariance) < settings.certain and fit.noise < settings.clear
    return precise and scene.search.is_enough(fit.blocks.agreement())


def _found(scene: Scene, fit: PhotometricFit, covariance: Array, probability: float) -> Found:
    """Return a fit of the photometric model, with its hidden pixels at full resolution."""
    rows, columns = scene.search.template.sharp.grey.shape
    hidden = cv2.resize(
        fit.hidden.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST
    )
    return Found(fit, covariance, probability, hidden > 0)


def uniqueness(scene: Scene, pose: Array) -> float:
    """Return how sure it is that a pose is not that of a lookalike, 0 to 1.

    The template moves by a from the expected place, the nearest lookalike by b from its own, and
    the result is b/(a + b). A move by less than a quarter of the template meets only lookalikes
    that its first frame shows. These repeat on all sides in a periodic texture: 1 − a/b.
    """
    search = scene.search
    moved = search.moved(scene.pose, pose)
    near = scene.seen and np.hypot(*moved) < search.side / 4
    offsets = search.own_lookalikes if near else scene.last.lookalikes
    if not len(offsets):
        return 1.0
    other = np.linalg.norm(offsets - moved, axis=1).min()
    ratio = float(np.hypot(*moved) / max(other, TINY))
    return max(0.0, 1 - ratio) if near else 1 / (1 + ratio)


def find_template(
    scene: Scene, attempts: tuple[Callable[[Scene], Found | None], ...]
) -> Found | None:
    """Return the first pose that is confident enough, else the most probable, or None."""
    most_probable = None
    for attempt in attempts:
        found = attempt(scene)
        if found is None:
            continue
        unique = uniqueness(scene, found.fit.pose)
        ambiguous = unique < scene.search.settings.threshold
        found = replace(found, confidence=found.confidence * unique, ambiguous=ambiguous)
        if found.confidence >= scene.search.settings.threshold:
            return found
        if most_probable is None or found.confidence > most_probable.confidence:
            most_probable = found
    return most_probable
