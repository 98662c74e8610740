"""Shape from focus: the height of every pixel from its sharpest frame (3.10 to 3.14)."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Frames, as_integer
from microlib.focus import multiscale
from microlib.focus._measures import FocusMeasure, single_measure
from microlib.focus._registration import register as find_registration
from microlib.focus._result import FocusResult, build_result
from microlib.focus._stack import (
    Progress,
    bad_frames,
    grey_levels,
    margin_mask,
    read_stack,
    warn_of_changes,
    with_frames,
)
from microlib.focus._three_point import three_point_depth
from microlib.io import read_frames


def depth_from_focus(
    frames: Frames,
    positions: ArrayLike | None = None,
    *,
    spacing: float | None = None,
    measure: str | FocusMeasure = "multiscale",
    window: int | None = None,
    workers: int = 1,
    register: bool = False,
    region: tuple[int, int, int, int] | None = None,
    reduce: int = 1,
    progress: Progress | None = None,
) -> FocusResult:
    """Return the depth of every pixel of a focal stack.

    Parameters
    ----------
    frames : array_like, path or iterable
        At least three frames, grey or in color, of 8 or 16 bits or floating point. The frames may
        be an array, a multi-page TIFF or OME-TIFF, a folder or file-name pattern of images, a
        video, or an iterable of images or image files, such as a generator;
        `microlib.io.read_frames` describes these forms. Color frames are converted to luminance.
        All frames are held in memory.
    positions : array_like, shape (n,), optional
        Position of each frame along the optical axis, µm. Positions increase or decrease, and their
        spacing may vary. By default the positions are read from a TIFF's OME or ImageJ metadata.
    spacing : float, optional
        Distance between adjacent frames, µm, given instead of `positions`. The first frame is at 0.
    measure : {"multiscale", "sml"} or callable
        Focus measure. "multiscale" combines several focus measures; "sml" is the thesis'
        sum-modified-Laplacian. A callable takes a frame and returns a non-negative measure of the
        same shape, such as ``functools.partial(sum_modified_laplacian, threshold=7)``.
    window : int, optional
        Side of the square over which the measure is summed, px, odd; by default 5. Not accepted
        with "multiscale", which chooses its windows itself, and not with a callable.
    workers : int
        Number of threads. The result does not depend on this number.
    register : bool
        Whether to correct shift, rotation, scale and brightness that change from frame to frame.
        The result is aligned with the middle frame. A pixel has no depth if an
        aligned frame near the best focus of the pixel does not cover the pixel.
    region : tuple of four ints, optional
        Part of the frames that is used: (x, y, width, height) in px.
    reduce : int
        Side of the square blocks of pixels that are averaged to one pixel, for a quick preview.
    progress : callable, optional
        Function that is called with the number of finished parts of the work and the number of all
        parts. The reading of a frame is one part, and the computation of the depth has as many
        parts as there are frames. An exception from the function ends the work.

    Returns
    -------
    FocusResult
        Depth in µm with its uncertainty, and the all-in-focus image.

    Raises
    ------
    ValueError
        If there are fewer than three frames. If frames differ in size or type, are not images,
        differ in time or channel instead of focus, or have values that are not finite or exceed
        ±10¹⁰. If the number of positions differs from that of the frames, or if positions are not
        finite, not strictly monotonic, or not known. If a file cannot be read. If an option is out
        of range or does not apply to this measure. With `register`, if fewer than half of
        the frames show the same scene.

    Warns
    -----
    UserWarning
        If `register` leaves out frames that show another scene; if frames are left out that are
        uniform, repeated or of another brightness than those around them; if the brightness or the
        position or scale of the image changes from frame to frame and `register` is not set; if
        frames have black margins.

    Notes
    -----
    "multiscale" assumes that the object has texture, and that the focus measure of a pixel is
    nearly a Gaussian function of the distance of the pixel from focus. The second assumption
    follows from (3.9) if the blur is proportional to this distance. The page *How the library is
    built* lists the stages of "multiscale" and their settings. Except at steps of the surface, the
    depth is smoothed by planes whose weights are a Gaussian of σ = 7 px. A depth is NaN where noise
    alone can cause the peak, where different focus measures contradict each other, and in small
    isolated regions.

    With any other measure, the peak follows from three frames by (3.13). A depth is then NaN where
    there is no peak or where noise alone can cause the peak. The depth of the result can be passed
    to `correct_spikes` and `smooth_depth`.

    The uncertainty accounts for the random error, and for the bias that arises where the shape of a
    peak deviates from a Gaussian. At a step, the uncertainty also accounts for the possibility that
    the pixel lies on the other side. If a peak may be noise but the pixel keeps its depth, the
    stated uncertainty is that of a uniform distribution over the scan.

    Depths may be wrong and have a small stated uncertainty in these cases:

    - Surfaces without texture. In tests with smoothed, quantized and JPEG frames, the mean share of
      such pixels was at most 2 %. In JPEG frames that were resized, the share was up to 14 %.
    - Objects that are narrow in the image. On bars, the share of such pixels was 10 % at a width of
      3 px, 3 to 5 % at 4 px, and less than 1 % at 5 px or more.

    If the sharpest frame of a pixel is the first or the last frame, the pixel is flagged in
    `at_end`. Its depth is the position of that frame, or the peak that "multiscale" fits. If the
    depth is less than half a frame spacing from an end, also inside the scan, the standard
    deviation of a uniform distribution over the scan is added to the uncertainty in quadrature. If
    several frames have the same maximum, the first of these frames is the sharpest frame.

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
    single = single_measure(measure, window)
    threads = as_integer("workers", workers, least=1)
    report = progress or (lambda done, count: None)
    source = read_frames(frames, region=region, reduce=reduce, color=True)
    stack = read_stack(source, positions, spacing, report)
    grey = grey_levels(stack)
    count, dtype, margin = len(grey), stack.dtype, margin_mask(grey)
    registration = find_registration(grey) if register else None
    if registration is None:
        kept = np.flatnonzero(~bad_frames(grey))
        images, grey = ([frames[k] for k in kept] for frames in (list(stack), grey))
        warn_of_changes(grey, margin)
    else:
        kept, grey = registration.kept, registration.images(grey)
        images = registration.images(list(stack)) if stack.color else grey
    z = np.asarray(stack.positions)[kept]
    stack = with_frames(stack, images, z)

    def done(share: float) -> None:
        report(round(count * (1 + share)), 2 * count)

    if single is None:
        found = multiscale.multiscale_depth(grey, z, workers=threads, done=done)
    else:
        found = three_point_depth(grey, z, single, done)
    if margin.any():
        warnings.warn("frames have black margins: no depth there", stacklevel=2)
    return build_result(found, stack, kept, dtype, registration=registration, margin=margin)
