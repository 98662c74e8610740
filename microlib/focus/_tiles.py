"""The default depth in tiles: of a stack larger than memory, or on several machines."""

from __future__ import annotations

from microlib.focus._multiscale import Maps, depth_steps, seen_around
from microlib.focus._questions import answered
from microlib.focus._replay import Replay
from microlib.focus._survey import FocusSurvey, answers_of, axis_of_survey, held
from microlib.focus._window import Window

__all__ = ["tile_maps", "tiles_of"]


def tiles_of(window: Window, side: int) -> list[Window]:
    """Return squares of that side, px, and what is left at the window's end.

    Examples
    --------
    >>> [(tile.top, tile.left, tile.size) for tile in tiles_of(Window.whole((100, 160)), 100)]
    [(0, 0, (100, 100)), (0, 100, (100, 60))]
    """
    bottom, right = window.bottom, window.right
    return [
        Window(top, left, min(top + side, bottom), min(left + side, right), window.shape)
        for top in range(window.top, bottom, side)
        for left in range(window.left, right, side)
    ]


def tile_maps(
    stack: Replay, survey: FocusSurvey, tile: Window, *, points: int, workers: int
) -> Maps:
    """Return the default depth of a tile, as it is in the whole image.

    Parameters
    ----------
    stack : Replay
        All frames.
    survey : FocusSurvey
        Of these frames.
    tile : Window
        What is wanted.
    points, workers : int
        As for `depth_from_focus`.

    Returns
    -------
    Maps
        The depth of the tile.
    """
    window = seen_around(tile, survey.blur_rate)
    part = held(stack.parts([window])[0], window, tile)
    batch = len(survey.positions)
    steps = depth_steps(part, axis_of_survey(survey), points=points, batch=batch, workers=workers)
    return answered([steps], answers_of(survey))[0]
