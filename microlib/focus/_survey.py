"""What the depth of a pixel owes to the whole image: measured once, and told to every tile."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microlib._common import Array, Image, Tidy
from microlib.focus._errors import NoiseCurve
from microlib.focus._flicker import watched
from microlib.focus._multiscale import Axis, Part, depth_steps
from microlib.focus._questions import answered
from microlib.focus._replay import Replay
from microlib.focus._scale import peak_width, square_windows, width_of_squares
from microlib.focus._window import Window

__all__ = [
    "MOST_PIXELS",
    "FocusSurvey",
    "answers_of",
    "axis_of",
    "axis_of_survey",
    "check_survey",
    "held",
    "survey_of",
]

#: Pixels up to which an image is surveyed as a whole; of a larger one patches are.
MOST_PIXELS = 2**22
#: Patches and their side, px: together a million pixels, with a hundred thousand independent ones
#: among them.
_PATCHES, _SIDE = 9, 384


@dataclass(frozen=True)
class FocusSurvey(Tidy):
    """What the default depth of a pixel owes to the whole stack.

    With it a tile has the depth of the whole image to the last bit, wherever it is computed.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the frames, px.
    positions : ndarray, shape (n,)
        Position of each frame, µm.
    points : int
        Frames in the fit of a peak.
    levels : ndarray, shape (n,)
        Mean grey level of each frame.
    width : float
        Width of the peaks of the focus measure, frames.
    noise : float
        Standard deviation of the noise, grey levels.
    silence : float
        Energy of the second differences of the quietest places, squared grey levels.
    blur_rate : float or None
        Growth of the blur at half the frames' size, px a frame; None if no pixel asks for it.
    strength : float or None
        Median inverse variance of a depth, up to a common factor; None from three points.
    weights : ndarray, shape (3,)
        Median weights of the depths by both directions, along rows, and along columns.
    pull : ndarray, shape (3, 4)
        How far these are pulled towards frames: factors of sine and cosine of the place between
        frames, and of twice that.
    noise_curve : NoiseCurve or None
        Variance from noise for how little texture there is; None if no depth is known.
    """

    shape: tuple[int, int]
    positions: Array
    points: int
    levels: Array
    width: float
    noise: float
    silence: float
    weights: Array
    pull: NDArray[np.float32]
    noise_curve: NoiseCurve | None
    blur_rate: float | None = None
    strength: float | None = None

    _samples = ("positions", "levels")
    _large = ("noise_curve", "weights", "pull")


def axis_of_survey(survey: FocusSurvey) -> Axis:
    """Return the frames along the optical axis."""
    return Axis(survey.positions, survey.levels, survey.width)


def answers_of(survey: FocusSurvey) -> dict[str, Any]:
    """Return what a tile asks, by name."""
    return {field.name: getattr(survey, field.name) for field in fields(survey)}


def check_survey(
    survey: FocusSurvey, shape: tuple[int, int], positions: Array, points: int
) -> None:
    """Refuse another stack than the one that was surveyed, and another fit."""
    if survey.points != points:
        raise ValueError(f"points must be {survey.points} as in survey, got {points}")
    if survey.shape != shape or not np.array_equal(survey.positions, positions):
        raise ValueError(
            f"survey must be of these frames, got one of {len(survey.positions)} frames of shape "
            f"{survey.shape} for {len(positions)} of shape {shape}, or of other positions"
        )


def axis_of(stack: Replay, positions: Array) -> Axis:
    """Look at every frame of a stack that is not too large to be surveyed as a whole."""
    levels: list[float] = []
    width = peak_width(watched(stack, levels))
    return Axis(positions, np.array(levels), width)


def survey_of(
    stack: Replay, positions: Array, *, points: int, batch: int, workers: int
) -> FocusSurvey:
    """Return the survey of a stack: of all of it, or of patches if it is large.

    Patches lie where the peaks are lowest and highest and evenly between, so that they stand for
    all of the image and hold what texture there is. Each is taken for an image of its own.
    """
    shape = stack.shape
    turn: dict[str, Any] = {"points": points, "batch": batch, "workers": workers}
    if shape[0] * shape[1] <= MOST_PIXELS:
        axis = axis_of(stack, positions)
        parts = [depth_steps(_whole(stack, shape), axis, **turn)]
    else:
        squares = square_windows(shape)
        width, height = width_of_squares(stack.parts(squares), shape)
        ranks = np.linspace(0, len(squares) - 1, _PATCHES).round().astype(int)
        chosen = [squares[k] for k in np.argsort(height, kind="stable")[ranks]]
        patches = stack.parts([_patch(square) for square in chosen])
        levels = np.array([[frame.mean() for frame in patch] for patch in patches]).mean(axis=0)
        axis = Axis(positions, levels, width)
        parts = [depth_steps(held(patch), axis, **turn, thorough=True) for patch in patches]
    answers: dict[str, Any] = {}
    answered(parts, answers)
    return FocusSurvey(shape, positions, points, axis.levels, axis.width, **answers)


def held(frames: list[Image], window: Window | None = None, wanted: Window | None = None) -> Part:
    """Return a part of a stack whose frames are held, by itself an image of its own."""
    seen = window or Window.whole(frames[0].shape)
    return Part(lambda: iter(frames), seen, wanted or seen)


def _whole(stack: Replay, shape: tuple[int, int]) -> Part:
    window = Window.whole(shape)
    return Part(lambda: iter(stack), window, window)


def _patch(square: Window) -> Window:
    """Return the patch around a square, inside the image."""
    begin = []
    for first, last, count in zip(
        (square.top, square.left), (square.bottom, square.right), square.shape, strict=True
    ):
        begin.append(int(np.clip((first + last - _SIDE) // 2, 0, max(count - _SIDE, 0))))
    rows, cols = (min(_SIDE, count) for count in square.shape)
    return Window(begin[0], begin[1], begin[0] + rows, begin[1] + cols, square.shape)
