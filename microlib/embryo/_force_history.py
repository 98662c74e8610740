"""The force on an embryo over time, from its outlines, where the chorion relaxes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from microlib._common import Array, Tidy, as_array, measured, of_kind, one_of, scalar
from microlib.embryo._modulus import NORMAL_95, force_from_image, given_lengths
from microlib.embryo._view import DIRECTIONS
from microlib.membrane import viscoelastic_force


@dataclass(frozen=True, eq=False, repr=False)
class ForceHistory(Tidy):
    """Forces read off a sequence of images, from `force_over_time`.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Of the images, in s.
    force, std : ndarray, shape (n,)
        Force with what has relaxed, and its standard deviation, in µN; NaN after the last image
        that shows a dimple.
    low, high : ndarray, shape (n,)
        Ends of the 95 % interval of the force, in µN.
    elastic_force : ndarray, shape (n,)
        Force of each outline as if nothing had relaxed, in µN; NaN where the image shows no dimple.
    reasons : tuple of str
        Why an image shows none; empty where it does.
    """

    _samples = ("time", "force", "std", "low", "high", "elastic_force", "reasons")

    time: Array
    force: Array
    std: Array
    low: Array
    high: Array
    elastic_force: Array
    reasons: tuple[str, ...]


def force_over_time(
    images: Sequence[ArrayLike],
    time: ArrayLike,
    modulus: float,
    *,
    shares: ArrayLike,
    relaxation_times: ArrayLike,
    modulus_std: float = 0.0,
    pixel_size: float,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    direction: str = "auto",
) -> ForceHistory:
    """Measure the force on an embryo in a sequence of images, with the relaxation of its chorion.

    Parameters
    ----------
    images : sequence of array_like, n of shape (rows, columns)
        As for `force_from_image`; the first at the latest when the probe touches.
    time : array_like, shape (n,)
        When each was taken, ascending, in s.
    modulus : float
        Instantaneous elastic modulus E, in MPa.
    shares, relaxation_times : array_like, shape (k,)
        Of the wall, see `microlib.membrane.viscoelastic_force`.
    modulus_std : float
        Standard deviation of `modulus`, in MPa. It is the same in all images.
    pixel_size, thickness, probe_half_width, poisson_ratio, direction
        As for `force_from_image`.

    Returns
    -------
    ForceHistory
        The `force` at each time with its `std` and the ends of its 95 % interval, `low` and `high`;
        with the `elastic_force` of each outline.

    Raises
    ------
    ValueError
        If `images` and `time` differ in number, an argument is out of range, or no image shows a
        dimple.

    Warns
    -----
    SmallSlopeWarning
        As for `force_from_image`.

    Notes
    -----
    A held dimple looks the same while its force falls, so one image does not tell the force: all
    that came before do. Each outline gives the force of (4.7) as if nothing had relaxed; the law of
    `viscoelastic_force` is linear in these, and carries their errors, independent from image to
    image, exactly. Images that show no dimple yet are taken as on the line from no force at the
    first image to the next outline, or between two outlines, uncertain by what an even
    distribution between the two ends of that line is, (difference)/√12. Errors of the shares and
    times, and of the model (4.7), are not in the interval.

    Examples
    --------
    >>> import numpy as np
    >>> from microlib.embryo import force_over_time
    >>> from microlib.synthetic import Embryo, embryo_image
    >>> free, pressed = Embryo(1.2, 0.0, 240.0), Embryo(1.2, 1.2, 240.0)
    >>> scenes = [embryo_image(each, rng=1, shape=(480, 640)) for each in (free, pressed, pressed)]
    >>> found = force_over_time(
    ...     [scene.image for scene in scenes], [0.0, 1.0, 5.0], 1.2,
    ...     shares=[0.4], relaxation_times=[2.0], pixel_size=scenes[0].pixel_size,
    ...     thickness=3.0, probe_half_width=25.0, poisson_ratio=0.5,
    ... )
    >>> relaxed = 1.2 * (0.6 + 0.4 * 0.787 * np.exp(-2.0))  # pressed within 1 s, held for 4 s
    >>> bool(found.low[2] < relaxed < found.high[2] < found.elastic_force[2])
    True
    """
    when = as_array("time", time, shape=(None,))
    of_kind("images", images, Iterable)
    if getattr(images, "ndim", 3) == 0:  # an array all the same, and so of the kind
        raise ValueError("images must be a sequence of images, got a single value")
    frames = list(images)
    if len(frames) != when.size:
        raise ValueError(f"images must be as many as the times, got {len(frames)} and {when.size}")
    stiffness = measured("modulus", modulus, "MPa")
    common = scalar("modulus_std", modulus_std, least=0) / stiffness
    # Wrong arguments are refused here: what one image refuses below is that image's.
    size = measured("pixel_size", pixel_size, "µm/px")
    lengths = given_lengths(thickness, probe_half_width, poisson_ratio, None)
    settings = lengths | {"direction": one_of("direction", direction, ("auto", *DIRECTIONS))}
    law = {"shares": shares, "relaxation_times": relaxation_times}
    # Column j is the force over time of a unit at time j.
    response = viscoelastic_force(when, np.eye(when.size), **law).T
    elastic, spread = np.full(when.size, np.nan), np.full(when.size, np.nan)
    reasons = [""] * when.size
    for k, image in enumerate(frames):
        try:
            found = force_from_image(image, stiffness, pixel_size=size, **settings)
            elastic[k], spread[k] = found.force, found.force * found.relative_std
        except ValueError as reason:
            reasons[k] = str(reason)
    seen = np.isfinite(elastic)
    if not seen.any():
        raise ValueError(f"images must show a dimple in one of them at least, got {reasons[0]}")
    # Nothing presses at the first time unless it is seen, and a line leads from outline to outline.
    filled, deviation = elastic.copy(), spread.copy()
    if not seen[0]:
        filled[0] = deviation[0] = 0.0
    known, gaps = np.flatnonzero(np.isfinite(filled)), np.flatnonzero(np.isnan(filled))
    rise = np.append(np.diff(filled[known]), 0.0)[np.searchsorted(known, gaps) - 1]
    filled[gaps] = np.interp(when[gaps], when[known], filled[known])
    deviation[gaps] = np.abs(rise) / (2 * np.sqrt(3))
    force = response @ filled
    std = np.hypot(np.sqrt(response**2 @ deviation**2), common * force)
    after = np.flatnonzero(seen)[-1] + 1
    force[after:] = std[after:] = np.nan
    reach = NORMAL_95 * std
    return ForceHistory(when, force, std, force - reach, force + reach, elastic, tuple(reasons))
