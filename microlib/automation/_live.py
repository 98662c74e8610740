"""The depth of a focal stack while it is acquired, and whether more frames are needed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import Array, Image, as_image, scalar
from microlib.focus import (
    FocusResult,
    check_options,
    depth_from_focus,
    sum_modified_laplacian,
    three_point_peak,
)

#: Side of the window of the measure that is followed, px: a part of 12 px has pixels whose window
#: sees nothing else, and noise changes the mean over 49 pixels by a tenth.
_WINDOW = 7
#: A pixel has texture if its best measure is so many times the median of all pixels' least ones.
#: From 2.5 to 3.5 every part is found and a quarter of the frames saved; at 4 one part of eight is
#: missed.
STANDS_OUT = 2.5
#: A peak has passed if its best frame lies so many frames back, and the measure has fallen half-way
#: to the ground since.
BACK = 3
#: Why nothing can be said of parts that have not come into focus yet.
UNKNOWN = (
    "whether a part comes into focus further on cannot be known: give farthest, or let "
    "acquire_depth look coarsely first"
)


class Peaks:
    """The best measure of every pixel so far, and what lay around it.

    Attributes
    ----------
    count : int
        Frames so far.
    index : ndarray of uint16, shape (rows, cols)
        Number of the best frame.
    best, least : ndarray of float32, shape (rows, cols)
        Largest and smallest measure.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = 0
        self.index = np.zeros(shape, np.uint16)
        self.best = np.full(shape, -1, np.float32)
        self.least = np.full(shape, np.inf, np.float32)
        self._before, self._after = np.zeros((2, *shape), np.float32)
        self._last = np.zeros(shape, np.float32)
        self._lowest_since = np.zeros(shape, np.float32)

    def push(self, frame: NDArray) -> None:
        """Take in the next frame."""
        measure = sum_modified_laplacian(frame, window=_WINDOW).astype(np.float32, copy=False)
        better = measure > self.best
        next_to = (self.index + 1 == self.count) & ~better
        np.copyto(self._after, measure, where=next_to)
        np.copyto(self._after, 0, where=better)
        np.copyto(self._before, self._last, where=better)
        np.copyto(self.best, measure, where=better)
        np.copyto(self.index, self.count, where=better)
        np.minimum(self.least, measure, out=self.least)
        np.minimum(self._lowest_since, measure, out=self._lowest_since)
        np.copyto(self._lowest_since, measure, where=better)
        self._last = measure
        self.count += 1

    @property
    def floor(self) -> float:
        """What the measure is of a pixel out of focus."""
        return float(np.median(self.least))

    def textured(self) -> NDArray[np.bool_]:
        """Return which pixels have a peak that stands out."""
        # Sums of whole grey levels may be equal, and rounding shall not decide then.
        return self.best > (1 + 1e-5) * STANDS_OUT * self.floor

    def passed(self) -> NDArray[np.bool_]:
        """Return which pixels have had their peak."""
        faded = self._lowest_since < (self.best + self.floor) / 2
        return faded & (self.count - 1 - self.index.astype(np.int64) >= BACK)

    def depth(self, positions: Array) -> NDArray[np.float32]:
        """Return the vertex through the best frame and its neighbors where one stands out."""
        window = np.stack([self._before, self.best, self._after])
        found = three_point_peak(window, self.index, positions)
        found[~self.textured()] = np.nan
        return found


class LiveDepth:
    """The depth of a focal stack as its frames come, and an end as soon as all has been seen.

    Every frame is kept. `result` is what `microlib.focus.depth_from_focus` makes of them;
    `depth` is a quick look that is there after every frame.

    Parameters
    ----------
    farthest : float, optional
        Last position along the scan at which any part can be in focus, µm: the greatest height if
        positions rise, the least if they fall. Without it nothing says that a small part does not
        come into focus in the next frame, and `done` stays False.
    **options
        Of `microlib.focus.depth_from_focus`, for `result`, without `spacing`. What depends on the
        size of the frames is checked at the first of them.

    Attributes
    ----------
    frames : int
        Frames so far.
    images : tuple of ndarray, shape (rows, cols)
        These frames.
    done : bool
        Whether the scan is beyond `farthest` and every pixel with texture has had its peak.
    reason : str
        Why not yet, or what `done` rests on.

    Raises
    ------
    ValueError
        If `farthest` is no number, or an option none that `depth_from_focus` takes.

    Notes
    -----
    The quick look is the vertex (3.13) of the sum-modified-Laplacian in a window of 7 px, NaN where
    the measure has no peak of at least 2.5 times the median of all pixels' least values. A pixel
    has had its peak when the best frame is three frames back and the measure has fallen half-way
    from its best value to that median since.

    With Micro-Manager's acquisition connect `push` to its signal, and end the sequence::

        live = LiveDepth(farthest=300.0)
        core.mda.events.frameReady.connect(lambda frame, event: live.push(frame, event.z_pos))
        core.mda.run(MDAEvent(z_pos=z) for z in positions if not live.done)

    Take ``event.z_pos`` and not the drive's own position, which hardware sequences run ahead of.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib import synthetic
    >>> from microlib.automation import LiveDepth
    >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
    >>> positions = np.arange(0.0, 200.0, 10.0)
    >>> stack = synthetic.focal_stack(texture, np.full((48, 48), 42.0), positions, blur_rate=0.1)
    >>> live = LiveDepth(farthest=50.0)
    >>> for frame, z in zip(stack, positions, strict=True):
    ...     live.push(frame, z)
    ...     if live.done:
    ...         break
    >>> live.frames, round(float(np.median(live.depth))), round(float(live.result().depth[24, 24]))
    (8, 41, 42)
    """

    def __init__(self, *, farthest: float | None = None, **options: Any) -> None:
        self._farthest = None if farthest is None else scalar("farthest", farthest)
        # A wrong option is refused now, one that does not suit the frames at the first of them.
        self._options, self._checked = options, check_options(**options)
        self._frames: list[Image] = []
        self._positions: list[float] = []
        self._peaks: Peaks | None = None
        self.done = False
        self.reason = "no frame yet"

    @property
    def frames(self) -> int:
        """Frames so far."""
        return len(self._frames)

    @property
    def images(self) -> tuple[Image, ...]:
        """These frames."""
        return tuple(self._frames)

    @property
    def positions(self) -> Array:
        """Their positions, µm."""
        return np.array(self._positions)

    @property
    def depth(self) -> NDArray[np.float32]:
        """A quick look at the depth so far, µm, shape (rows, cols).

        Raises
        ------
        ValueError
            Before the third frame.
        """
        if self._peaks is None or self.frames < 3:
            raise ValueError(f"frames must be at least three for a depth, got {self.frames}")
        return self._peaks.depth(self.positions)

    def push(self, frame: ArrayLike, z: float) -> None:
        """Take in the next frame.

        Parameters
        ----------
        frame : array_like, shape (rows, cols)
            Grey, of the size and type of those before.
        z : float
            Its position, µm, further along the scan than the one before.

        Raises
        ------
        ValueError
            If the frame is of another size or type, has a single row or column, is too small for an
            option, or `z` does not go on.

        Examples
        --------
        >>> import numpy as np
        >>> from microlib.automation import LiveDepth
        >>> live = LiveDepth()
        >>> live.push(np.zeros((16, 16)), 0.0)
        >>> live.frames, live.done
        (1, False)
        """
        as_image("frame", frame, smallest=2)
        image = np.array(frame)  # a camera may write the next one into the same place
        if image.dtype == bool:
            raise ValueError("frame must hold grey levels, got truth values")
        # Beyond, single precision has no digits left.
        place = scalar("z", z, within=(-1e12, 1e12))
        first = self._frames[0] if self._frames else image
        if (image.shape, image.dtype) != (first.shape, first.dtype):
            raise ValueError(
                f"frame must be {first.shape} {first.dtype} as those before, got {image.shape} "
                f"{image.dtype}"
            )
        if self._positions:
            start, last = self._positions[0], self._positions[-1]
            if place == last or (place - last) * (last - start) < 0:
                raise ValueError(f"z must go on from {last:g} µm in one direction, got {z:g} µm")
        if self._peaks is None:
            self._checked.check_frame(image)
            self._peaks = Peaks(image.shape)
        self._peaks.push(image)
        self._frames.append(image)
        self._positions.append(place)
        self._judge(self._peaks)

    def result(self) -> FocusResult:
        """Return the depth of the frames so far.

        Returns
        -------
        FocusResult
            What `microlib.focus.depth_from_focus` returns for these frames and positions.

        Raises
        ------
        ValueError
            If there are fewer than three frames, or as for `depth_from_focus`.

        Examples
        --------
        >>> import numpy as np
        >>> from microlib import synthetic
        >>> from microlib.automation import LiveDepth
        >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
        >>> live = LiveDepth()
        >>> for z in (0.0, 10.0, 20.0, 30.0):
        ...     flat = np.full((48, 48), 14.0)
        ...     live.push(synthetic.focal_stack(texture, flat, [z], blur_rate=0.1)[0], z)
        >>> round(float(live.result().depth[24, 24]))
        14
        """
        if self.frames < 3:
            raise ValueError(f"frames must be at least three for a depth, got {self.frames}")
        return depth_from_focus(self._frames, self._positions, **self._options)

    def _judge(self, peaks: Peaks) -> None:
        """Say whether more frames are needed."""
        if self._farthest is None:
            self.reason = UNKNOWN
            return
        if self.frames < 3:
            self.reason = "too few frames"
            return
        way = np.sign(self._positions[-1] - self._positions[0])
        if way * (self._positions[-1] - self._farthest) < 0:
            self.reason = f"farthest, {self._farthest:g} µm, is not reached"
            return
        textured = peaks.textured()
        waiting = int(np.count_nonzero(textured & ~peaks.passed()))
        self.done = bool(textured.any()) and waiting == 0
        self.reason = (
            f"every pixel with texture has had its peak, and none lies beyond {self._farthest:g} µm"
            if self.done
            else f"{waiting} pixels with texture have not had their peak"
        )


def coarse_range(frames: list[Image], every: int, count: int) -> tuple[int, int] | None:
    """Return the first and the last of `count` fine frames that can hold a peak.

    Parameters
    ----------
    frames : list of ndarray, shape (rows, cols)
        Every `every`-th frame.
    every, count : int
        Distance of the coarse frames in fine ones, and number of the fine ones.

    Returns
    -------
    tuple of int or None
        With the coarse step to either side in which a peak may lie, and the frames behind it that
        show that it has passed; None if nothing stands out.
    """
    peaks = Peaks(frames[0].shape)
    for frame in frames:
        peaks.push(frame)
    index = peaks.index[peaks.textured()]
    if index.size == 0:
        return None
    margin = every + BACK
    first, last = int(index.min()) * every - margin, int(index.max()) * every + margin
    return max(first, 0), min(last, count - 1)
