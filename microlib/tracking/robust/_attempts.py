"""The attempts to find a template in a frame, from the fastest to the most thorough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from microlib._common import Array
from microlib.tracking._esm import Alignment
from microlib.tracking._sampling import View
from microlib.tracking.robust._blocks import compare
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
    """

    fit: Alignment
    corner_covariance: Array
    confidence: float
    hidden: NDArray[np.bool_]


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
    """

    search: RobustSearch
    view: View
    pose: Array
    seen: bool

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
        """ESM alignment that starts from where the points flow."""
        if not self.flow_poses:
            return self.from_pose
        return self.search.template.align(self.view.image, self.flow_poses[0])

    @cached_property
    def best(self) -> Alignment:
        """The one of these alignments with the higher correlation."""
        return max(self.from_pose, self.from_flow, key=lambda fit: fit.correlation)


def align_from_pose(scene: Scene) -> Found | None:
    """Align from the expected pose."""
    return _without_search(scene, scene.from_pose)


def align_from_flow(scene: Scene) -> Found | None:
    """Align from where the points of the template flow."""
    return _without_search(scene, scene.from_flow) if scene.flow_poses else None


def search_nearby(scene: Scene) -> Found | None:
    """Search robustly from these poses; from anywhere in the frame if the template was lost."""
    coarse = scene.search.align_coarsely(scene.view, scene.pose)
    starts = [scene.pose, coarse.pose, scene.best.pose, *scene.flow_poses]
    if not scene.seen:
        starts += scene.search.match_poses(scene.view, scene.pose)
    return _searched(scene, starts, far=not scene.seen)


def search_far(scene: Scene) -> Found | None:
    """Search robustly from distorted and distant poses, if the template was not lost before."""
    if not scene.seen:
        return None
    return _searched(scene, scene.search.far_poses(scene.view, scene.pose), far=True)


ATTEMPTS: tuple[Callable[[Scene], Found | None], ...] = (
    align_from_pose,
    align_from_flow,
    search_nearby,
    search_far,
)


def _without_search(scene: Scene, plain: Alignment) -> Found | None:
    """Return an alignment if its blocks agree: as it is, or with the photometric model."""
    if plain.reason:
        return None
    search, settings = scene.search, scene.search.settings
    sharp = search.template.sharp
    if _blocks_agree(scene, plain, settings.steady_light):
        covariance = corner_covariance(sharp, plain, plain.weight)
        if largest_sigma(covariance) < settings.certain:
            return Found(plain, covariance, 1.0, plain.weight == 0)
    fit = search.polish(scene.view, plain.pose)
    if fit is None:
        return None
    covariance = search.covariance(fit)
    off = search.corners_of(fit.pose) - search.corners_of(plain.pose)
    confirmed = max(np.abs(off).max(), largest_sigma(covariance)) < settings.confirmed
    if _is_clear(scene, fit, covariance) or (
        confirmed and _blocks_agree(scene, plain, settings.changed_ground)
    ):
        return _found(scene, fit, covariance, 1.0)
    return None


def _blocks_agree(scene: Scene, fit: Alignment, limit: tuple[float, float]) -> bool:
    """Return whether all blocks of the template agree with an alignment of one gain and bias."""
    search, sharp = scene.search, scene.search.template.sharp
    agreement = compare(fit.grey, sharp.grey, fit.weight, search.noise).agreement()
    most = limit[0] * search.noise + limit[1] * abs(fit.gain) * sharp.contrast
    return search.is_enough(agreement) and agreement.residual <= most


def _searched(scene: Scene, starts: list[Array], *, far: bool) -> Found | None:
    """Return what the robust search finds, with its confidence."""
    finding = scene.search.search(scene.view, scene.pose, starts, far=far)
    if finding is None or finding.fit.reason:
        return None
    covariance = scene.search.covariance(finding.fit)
    clear = _is_clear(scene, finding.fit, covariance)
    return _found(scene, finding.fit, covariance, 1.0 if clear else confidence(finding))


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


def find_template(
    scene: Scene, attempts: tuple[Callable[[Scene], Found | None], ...] = ATTEMPTS
) -> Found | None:
    """Return the first pose that is confident enough, else the most probable, or None."""
    most_probable = None
    for attempt in attempts:
        found = attempt(scene)
        if found is None:
            continue
        if found.confidence >= scene.search.settings.threshold:
            return found
        if most_probable is None or found.confidence > most_probable.confidence:
            most_probable = found
    return most_probable
