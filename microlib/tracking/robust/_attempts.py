"""The attempts to find a template in a frame, from the fastest to the most thorough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from microlib.tracking.robust._decision import Candidate, judge_photometric, judge_plain
from microlib.tracking.robust._search import Search

#: An attempt takes the candidates of the attempts before, and returns its own one, if it has one.
Attempt = Callable[[Search, Sequence[Candidate]], Candidate | None]


def align_from_pose(search: Search, before: Sequence[Candidate]) -> Candidate:
    """Align from the expected pose; continue with the photometric model if blocks disagree.

    If the alignment fails, it is repeated from the pose that the optical flow gives. Without this,
    a translation by a quarter of the template takes twice as long, because the search finds it.
    """
    template, image = search.template, search.frame.image
    plain = template.plain.align(image, search.pose)
    if plain.reason and search.flow_pose is not None:
        plain = template.plain.align(image, search.flow_pose)
    candidate = judge_plain(template, plain)
    if candidate.confidence or plain.reason:
        return candidate
    fit = template.align_photometric(search.frame, plain.pose)
    return candidate if fit is None else judge_photometric(template, fit, plain)


def search_nearby(search: Search, before: Sequence[Candidate]) -> Candidate | None:
    """Search from the expected pose, the optical flow and the poses of the candidates before.

    A template that was lost is searched for in the whole frame. A pose that most points of the
    template leave may be that of a part that resembles it. It is left to the search far away.
    """
    settings = search.template.settings
    starts = [search.pose, *(search.pose @ period for period in search.template.periods)]
    if not search.seen:
        starts += [pose for pose in search.match_poses() if not search.ambiguous(pose)]
    # A match is a pixel of the coarsest level, too far off for fine texture to agree.
    starts = [search.pose, *search.align_starts(starts)]
    starts += [] if search.flow_pose is None else [search.flow_pose]
    starts += [candidate.fit.pose for candidate in before]
    best = search.best_candidate(starts, before)
    if best is None:
        return None
    candidate, inlier_ratio = best
    most_stay = inlier_ratio > settings.min_inlier_ratio
    return candidate if most_stay or not search.seen else replace(candidate, confidence=0.0)


def search_far(search: Search, before: Sequence[Candidate]) -> Candidate | None:
    """Search from distorted and distant poses, if the template was not lost before."""
    if not search.seen:
        return None
    best = search.best_candidate(search.far_poses(), before)
    return None if best is None else best[0]


ATTEMPTS: tuple[Attempt, ...] = (align_from_pose, search_nearby, search_far)


def find_template(search: Search, attempts: Sequence[Attempt]) -> Candidate:
    """Return the first pose that is confident enough, with no reason for a loss.

    If there is none, return the most probable pose with the reason; of equally probable ones that
    of the last attempt.
    """
    threshold = search.template.settings.threshold
    candidates: list[Candidate] = []
    for attempt in attempts:
        candidate = attempt(search, candidates)
        if candidate is None:
            continue
        if candidate.confidence >= threshold:
            if not search.ambiguous(candidate.fit.pose):
                return replace(candidate, reason="")
            candidate = replace(candidate, confidence=0.0, reason="ambiguous")
        if candidate.reason == "two motions":
            return candidate
        candidates.append(candidate)
    candidates = candidates or [align_from_pose(search, [])]
    return max(reversed(candidates), key=lambda candidate: candidate.confidence)
