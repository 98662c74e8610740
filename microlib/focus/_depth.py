"""Shape from focus: the height of every pixel from its sharpest frame (3.10 to 3.14)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microlib._common import ArgumentError, Frames, Image, as_instance, as_integer
from microlib.focus import multiscale
from microlib.focus._measures import FocusMeasure, single_measure
from microlib.focus._registration import Registration
from microlib.focus._registration import register as find_registration
from microlib.focus._result import FocusResult, build_result
from microlib.focus._stack import (
    Progress,
    bad_frames,
    change_between,
    frame_names,
    margin_mask,
    read_stack,
)
from microlib.focus._three_point import three_point_depth
from microlib.focus.common import Frame
from microlib.io import read_frames


def depth_from_focus(
    frames: Frames,
    positions: ArrayLike | None = None,
    *,
    spacing: float | Literal["frame"] | None = None,
    measure: str | FocusMeasure = "multiscale",
    window: int | None = None,
    workers: int = 1,
    register: bool | Literal["auto"] = False,
    region: tuple[int, int, int, int] | None = None,
    reduce: int = 1,
    progress: Progress | None = None,
) -> FocusResult:
    """Return the depth (height) of each pixel of a focal stack, NaN where it is not determined.

    Parameters
    ----------
    frames : array_like, path or iterable
        At least three frames, grey or in color, of 8 or 16 bits or floating point. The frames may
        be an array, a multi-page TIFF or OME-TIFF, a folder or file-name pattern of images, a
        video, or an iterable of images or image files, such as a generator.
        `microlib.io.read_frames` describes these forms. Color frames are converted to luminance.
        The luminance of all frames is held in memory. Color files are read again for the
        all-in-focus image.
    positions : array_like, shape (n,), optional
        Position of each frame along the optical axis, µm. Positions increase or decrease, and their
        spacing may vary. By default the positions are read from a TIFF's OME or ImageJ metadata.
    spacing : float or "frame", optional
        Distance between adjacent frames, µm, given instead of `positions`. The first frame is at 0.
        Give "frame" if the distance is not known: depths are then in frames, not in µm.
    measure : {"multiscale", "sml"} or callable
        Focus measure. "multiscale" combines several focus measures; "sml" is the thesis'
        sum-modified-Laplacian. A callable takes a frame and returns a non-negative measure of the
        same shape, such as ``functools.partial(sum_modified_laplacian, threshold=7)``.
    window : int, optional
        Side of the square over which the measure "sml" is summed, px, odd; by default 5. Other
        measures do not accept it.
    workers : int
        Number of threads. The result does not depend on this number.
    register : bool or "auto"
        Whether to correct shift, rotation, scale and brightness that change from frame to frame.
        The result is aligned with the middle frame. A pixel has no depth if the aligned frames near
        its best focus do not cover it. By default nothing is corrected. With "auto", frames that
        are found to move are registered; otherwise only the brightness is corrected. Motion of less
        than a thousandth of the shorter side of the image from one frame to the next is not
        detected, because it cannot be distinguished from a change of the blur.
    region : tuple of four ints, optional
        Part of the frames that is used: (x, y, width, height) in px.
    reduce : int
        Side of the square blocks of pixels that are averaged to one pixel, for a quick preview.
    progress : callable, optional
        Function that is called with the number of finished parts of the work and the number of all
        parts. Each of reading, registration, depth and all-in-focus image counts one part per
        frame. An exception from the function ends the work.

    Returns
    -------
    FocusResult
        Depth in µm, or in frames, with its uncertainty, and the all-in-focus image.

    Raises
    ------
    ValueError
        If there are fewer than three frames, or a file cannot be read. If frames differ in size or
        type, are not images, or differ in time or channel instead of focus. If a value is not
        finite or exceeds ±10¹⁰. If the positions are not known, not finite, not strictly monotonic,
        or not as many as the frames. If an option is out of range or does not apply to the measure.
        With `register`, if fewer than half of the frames show the same scene.

    Warns
    -----
    UserWarning
        If frames are skipped because they are uniform, repeated, unusually bright or dark, or show
        another scene. If the brightness, the position or the scale of the image changes from frame
        to frame and `register` is not True. If frames have black margins.

    Notes
    -----
    "multiscale" assumes that the object has texture, and that the focus measure of a pixel is
    nearly a Gaussian function of the distance of the pixel from focus. The second assumption
    follows from (3.9) if the blur is proportional to this distance. Chapter 3 of the book explains
    the stages of "multiscale". Except at steps of the surface, the depth is smoothed by fitting
    planes with Gaussian weights (σ = 7 px), so the errors of neighboring pixels are correlated. A
    depth is NaN where a peak cannot be distinguished from noise, where different focus measures
    contradict each other, and in small isolated regions.

    With any other measure, the peak follows from three frames by (3.13). A depth is then NaN where
    there is no peak or where the peak cannot be distinguished from noise. The depth of the result
    can be passed to `correct_spikes` and `smooth_depth`.

    The uncertainty accounts for the random error, and for the bias that arises where the shape of a
    peak deviates from a Gaussian. In a test with a lens that was moved by a focus ring, this bias
    was 0.6 frame spacings, nearly the same for all pixels. At a step, the uncertainty also accounts
    for the possibility that the pixel lies on the other side. Where a peak is only slightly clearer
    than noise, the pixel keeps its depth, but the uncertainty is larger, up to that of a random
    depth: the distance of the first and the last frame, divided by √12. The uncertainty can be too
    large: on a photographed board, depths from two halves of the frames differed by far less.

    Depths may be wrong and have a small stated uncertainty in these cases:

    - Surfaces without texture. In tests with six kinds of noise, this happened at 2 % of the pixels
      or fewer on average, and at more in single stacks of JPEG frames.
    - Objects that are narrow in the image. In tests with bars of a width of 4 to 10 px, this
      happened at less than 5 % of the pixels. On narrower bars the share is larger.
    - Surfaces whose focus lies outside the stack. They get a depth near the first or the last
      frame, and almost all of their pixels a large uncertainty and the flag `at_end`. In a test
      with six photographs as texture, 3 to 11 frames outside, 1.4 % of the pixels had neither.

    A pixel is flagged in `at_end` if its sharpest frame is the first or the last frame. With
    "multiscale" it is also flagged if its depth is within half a frame spacing of that frame, or
    within two frame spacings and a quarter of the pixels around it are flagged. The depth of a
    flagged pixel is the position of that frame, or the peak that "multiscale" fits. If this depth
    is within two frame spacings of the first or the last position, the true depth may lie outside,
    and the uncertainty of a random depth is added in quadrature.

    References
    ----------
    S. K. Nayar and Y. Nakagawa, Shape from focus, IEEE Trans. PAMI 16 (1994) 824.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib import synthetic
    >>> from microlib.focus import depth_from_focus
    >>> texture = synthetic.mixed_texture((48, 48), np.random.default_rng(0))
    >>> positions = np.arange(0.0, 100.0, 10.0)
    >>> height = np.full((48, 48), 42.0)
    >>> stack = synthetic.focal_stack(texture, height, positions, blur_rate=0.1)
    >>> result = depth_from_focus(stack, spacing=10.0)
    >>> round(float(np.median(result.depth)))
    42
    """
    unit, spacing = ("frames", 1.0) if spacing == "frame" else ("µm", spacing)
    single = single_measure(measure, window)
    threads = as_integer("workers", workers, least=1)
    report = as_instance("progress", progress or (lambda done, count: None), Callable)
    if not isinstance(register, bool) and register != "auto":
        raise ArgumentError("register", f'must be True, False or "auto", got {register!r:.80}')
    # Reading, registration, depths, and the all-in-focus image.
    stages = 4 if register else 3
    source = read_frames(frames, region=region, reduce=reduce, color=True)
    grey, colors, z = read_stack(
        source, positions, spacing, lambda done, n: report(done, stages * n)
    )
    count, margin = len(grey), margin_mask(grey)

    def finish(stage: int, share: float) -> None:
        report(round(count * (stage + share)), stages * count)

    names = partial(frame_names, source, count)
    used, kept, registration = _usable_frames(grey, margin, register, names, partial(finish, 1))
    done = partial(finish, stages - 2)
    z, origin = z[kept] - z[0], float(z[0])  # float32 has digits to spare near zero only
    if single is None:
        found = multiscale.multiscale_depth(used, z, workers=threads, done=done)
    else:
        found = three_point_depth(used, z, single, done)
    if margin.any():
        warnings.warn("frames have black margins: no depth there", stacklevel=2)
    known = ((k, image) for k, image in enumerate(colors or grey) if k in kept)
    images = (registration.aligned(f, k) if registration else f for k, f in known)
    del grey, used  # in color no longer needed
    return build_result(
        found,
        images,
        replace(source, positions=z),
        kept,
        origin=origin,
        registration=registration,
        margin=margin,
        done=partial(finish, stages - 1),
        unit=unit,
    )


def _usable_frames(
    grey: list[Image],
    margin: NDArray[np.bool_],
    register: bool | Literal["auto"],
    names: Callable[[NDArray[np.intp]], str],
    done: Callable[[float], object],
) -> tuple[Sequence[Frame], NDArray[np.intp], Registration | None]:
    """Return the frames that are used, aligned if they are registered; their numbers; and how.

    Warns
    -----
    UserWarning
        If frames are left out, or if their light, position or scale changes.
    """
    count = len(grey)
    kept, change = np.arange(count), ""
    if register is not True:
        kept = np.flatnonzero(~bad_frames(grey))
        change = change_between([grey[k] for k in kept], margin)
    if change:
        remedy = "register=True (--register) corrects it"
        if register:
            remedy = "brightness corrected" if change == "light" else "registered"
        warnings.warn(f"frames change in {change} from one to the next: {remedy}", stacklevel=3)
    if register is True or (register and change):
        found = find_registration(grey, names=names, at_rest=change == "light", done=done)
        return [found.aligned(grey[k], k) for k in found.kept], found.kept, found
    if len(kept) < count:
        out = names(np.setdiff1d(np.arange(count), kept))
        reasons = "are uniform, repeated or of another brightness: left out"
        warnings.warn(f"frames {out} {reasons}", stacklevel=3)
    return [grey[k] for k in kept], kept, None
