"""Track a template through a film: a row for each frame, the table of all rows, and its picture."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import as_image, as_picture, as_scalar, luminance
from microlib._plots import path
from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._tracker import ESMTracker

if TYPE_CHECKING:
    import pandas as pd

#: Columns of a table that most users need; the others follow.
_FIRST = ("center_x", "center_y", "lost", "reason", "confidence")


def track_each(
    frames: Iterable[ArrayLike],
    box: tuple[int, int, int, int],
    motion: str = "homography",
    *,
    rate: float | None = None,
    pixel_size: float | None = None,
    kalman: KalmanFilter | None = None,
    mask: ArrayLike | None = None,
) -> Iterator[dict[str, Any]]:
    """Track a template through a film and yield a row for each frame as soon as it is tracked.

    Parameters
    ----------
    frames : iterable of array_like, shape (H, W) or (H, W, 3)
        Frames one after another, as a list, a stack or `microlib.io.read_frames` gives them; the
        first one shows the template. They are read one at a time, and may be wrapped, by ``tqdm``
        for example; the times of a `microlib.io.Stack` are then lost.
    box, motion, kalman, mask
        As for `ESMTracker`.
    rate : float, optional
        Frames per second, for the column ``time_s``. By default the column has the times of the
        file of a `microlib.io.Stack`, if the file has times.
    pixel_size : float, optional
        Side of a pixel in the object plane, µm, for the columns ``x_um`` and ``y_um``: the
        displacement of the center since the first frame.

    Yields
    ------
    dict
        The number of the frame and the result of `Track.to_dict`. If the template is lost, most
        values are None.

    Raises
    ------
    ValueError
        If there is no frame, or one cannot be read or tracked: as `ESMTracker`.

    Examples
    --------
    >>> from microlib.synthetic import gripper_scene
    >>> from microlib.tracking import track_each
    >>> scene = gripper_scene(0, pixel_size=6.23)
    >>> film = [scene.frame((2.5 * k, 0.5 * k), k) for k in range(3)]
    >>> for row in track_each(film, scene.box(50), rate=20.0, pixel_size=2.0):
    ...     print(f"{row['time_s']} s: {row['x_um'] + 0:.1f} µm")
    0.0 s: 0.0 µm
    0.05 s: 5.0 µm
    0.1 s: 10.0 µm
    """
    interval = None if rate is None else 1 / as_scalar("rate", rate, above=0)
    time_of = getattr(frames, "time", None)

    def clock(number: int) -> float | None:
        if interval is not None:
            return number * interval
        return None if time_of is None else time_of(number)

    size = None if pixel_size is None else as_scalar("pixel_size", pixel_size, above=0)
    if not np.iterable(frames):
        raise ValueError(f"frames must be images one after another, got {frames!r:.80}")
    tracker = None
    for number, frame in enumerate(frames):
        if tracker is None:
            as_image("frames", luminance("frames", frame))
            tracker = ESMTracker(frame, box, motion, mask=mask)
            track = tracker.track(frame)
            start = track.center
            timed = clock(number) is not None
            tracker.kalman = kalman  # it has nothing to predict in the first frame
        else:
            track = tracker.track(frame)
        row: dict[str, Any] = {"frame": number}
        if timed:
            row["time_s"] = clock(number)
        if size is not None:
            x, y = (size * (track.center - start)).tolist()
            row |= {"x_um": None, "y_um": None} if track.lost else {"x_um": x, "y_um": y}
        values = track.to_dict()
        yield row | {name: values[name] for name in _FIRST} | values
    if tracker is None:
        raise ValueError("frames must hold at least one, got none")


def track_all(
    frames: Iterable[ArrayLike],
    box: tuple[int, int, int, int],
    motion: str = "homography",
    *,
    rate: float | None = None,
    pixel_size: float | None = None,
    kalman: KalmanFilter | None = None,
    mask: ArrayLike | None = None,
) -> pd.DataFrame:
    """Track a template through all frames of a film.

    Parameters
    ----------
    frames, box, motion, rate, pixel_size, kalman, mask
        As for `track_each`.

    Returns
    -------
    pandas.DataFrame
        The rows of `track_each`, by the number of the frame. ``attrs["error"]`` says why the film
        ended early, or nothing.

    Raises
    ------
    ValueError
        If there is no frame, or the first one cannot be tracked: as `ESMTracker`.

    Warns
    -----
    UserWarning
        If a later frame cannot be read or tracked. The table has the rows before it.

    Examples
    --------
    >>> from microlib.synthetic import gripper_scene
    >>> from microlib.tracking import track_all
    >>> scene = gripper_scene(0, pixel_size=6.23)
    >>> film = [scene.frame((2.5 * k, 0.5 * k), k) for k in range(3)]
    >>> table = track_all(film, scene.box(50))
    >>> table["center_x"].diff().round(1).tolist()[1:]
    [2.5, 2.5]
    """
    import pandas as pd  # imported here because it takes long

    rows: list[dict[str, Any]] = []
    problem = ""
    try:
        each = track_each(
            frames, box, motion, rate=rate, pixel_size=pixel_size, kalman=kalman, mask=mask
        )
        for row in each:
            rows.append(row)
    except (OSError, ValueError) as error:
        if not rows:
            raise
        problem = f"tracked {len(rows)} frames, then: {error}"
        warnings.warn(problem, stacklevel=2)
    table = pd.DataFrame(rows).set_index("frame")
    table.attrs["error"] = problem
    return table


def plot_track(table: pd.DataFrame, image: ArrayLike, ax: Any = None) -> Any:
    """Plot a track with Matplotlib: its path over a frame, and its position against time.

    Parameters
    ----------
    table : pandas.DataFrame
        The result of `track_all`, or a table of rows of `track_each`.
    image : array_like, shape (H, W) or (H, W, 3)
        A frame of the film, for example the first one.
    ax : matplotlib.axes.Axes, optional
        Axes in which only the path is drawn. By default both are panels of a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If the table is not that of a track, the image is not one frame, or the template is lost in
        all of its frames.

    Examples
    --------
    >>> from microlib.synthetic import gripper_scene
    >>> from microlib.tracking import plot_track, track_all
    >>> scene = gripper_scene(0, pixel_size=6.23)
    >>> film = [scene.frame((2.5 * k, 0.5 * k), k) for k in range(3)]
    >>> figure = plot_track(track_all(film, scene.box(50)), film[0])
    >>> [ax.get_title() for ax in figure.axes][0]
    'path on the first frame'
    """
    columns = [str(name) for name in getattr(table, "columns", ())]
    corners = [name for name in columns if name.startswith("corners_")]
    if not {"center_x", "center_y", "lost"} <= set(columns) or len(corners) != 8:
        problem = "must be that of a track, with its center, lost and corners"
        raise ValueError(f"table {problem}, got {type(table).__name__}")
    if table["lost"].all():
        raise ValueError(f"table must show the template, which is lost in all {len(table)} frames")
    return path(table, as_picture("image", image), ax)
