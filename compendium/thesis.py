"""What the thesis prints of its apparatus and settings, as the numbers that code needs.

Every printed number comes from ``data/thesis/claims.toml``. What the thesis does not print is said
to be from a data sheet, or assumed.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from compendium.ledger import claim
from microlib.embryo import GaussianSum
from microlib.membrane import elastic_modulus
from microlib.microscope import Microscope
from microlib.optics import gaussian_kernel

#: Columns of Tables 5.1 and 5.2, and how the notebooks call them.
COLUMNS = {
    "circle-1X": "circles, 1X",
    "circle-4X": "circles, 4X",
    "square-1X": "squares, 1X",
    "square-4X": "squares, 4X",
}
#: Settings of the zoom.
ZOOMS = ("1X", "4X")

# Section 5.1: cameras and stages

#: Cells of the cameras for servoing (Basler A602fc) and for the embryo (Sony XCD-X710CR), µm.
BASLER_PIXEL_PITCH = claim("section-5.1/basler-pixel-pitch").value
SONY_PIXEL_PITCH = claim("section-5.1/sony-pixel-pitch").value
#: Pixels of their images, (width, height); from the data sheets, not the thesis.
BASLER_IMAGE_SIZE = (656, 491)
#: Smallest step of a stage and opening of the gripper, µm.
STAGE_STEP = claim("section-5.1/stage-step").value / 1000
GRIPPER_GAP = claim("section-5.1/gripper-gap").value

# Sections 5.3 and 5.4: tracking and servoing

#: Time between frames, s, and side of the tracked window, px.
FRAME_INTERVAL = 1 / claim("section-5.3/rate").value
WINDOW = int(claim("section-5.3/window").value)
#: Weights Q of the feature's error and L of the control, with J in px/mm.
FEATURE_WEIGHT = (claim("section-5.4/Q").value,) * 2
CONTROL_WEIGHT = (claim("section-5.4/L-x").value, claim("section-5.4/L-y").value)
#: L with J in px/µm.
CONTROL_WEIGHT_MICROMETER = (CONTROL_WEIGHT[0] * 1e-6, CONTROL_WEIGHT[1] * 1e-6)

# Section 5.5: shape from focus and surface types

#: Height of the ridge and steps of the focus for the ridge and for the solder ball, µm.
RIDGE_HEIGHT = claim("section-5.5/object-height").value
RIDGE_STEP = claim("section-5.5/step-parabola").value
BALL_STEP = claim("section-5.5/step-ball").value
#: Window (px) and threshold δ of (3.14), which corrects spikes, and window of the mean, px.
MEDIAN_WINDOW = int(claim("section-5.5/median-window").value)
DELTA = claim("section-5.5/delta").value
MEAN_WINDOW = int(claim("section-5.5/mean-window").value)
#: Zero thresholds of H and K, printed without units.
H_THRESHOLD = claim("section-5.5/h-threshold").value
K_THRESHOLD = claim("section-5.5/k-threshold").value

# Section 5.6: the embryo

#: Pixel of the Sony camera in the object plane, µm.
EMBRYO_PIXEL = SONY_PIXEL_PITCH / claim("section-5.6/magnification").value
#: Where the curve of Table 5.5 is drawn and searched, px: about the outermost centers of its
#: Gaussians, 48 and 243 px. The thesis prints no ends, and no verdict depends on them.
OUTLINE_DOMAIN = (50.0, 265.0)
#: Of the smoothing by local regression.
LOESS_SPAN = claim("section-5.6/span").value
#: Force of Table 5.6, µN.
FORCE = claim("table-5.6/F").value
#: Width of the probe that section 5.1 names (Nanosensors TL-CONT), µm. The thesis prints no width.
#: The first is the round number with which (5.2) gives the printed modulus. The two ends are an
#: assumed tolerance of 15 %.
PROBE_WIDTH, PROBE_WIDTH_ENDS = 50.0, (42.5, 57.5)
#: Thickness h of the chorion, half-width c of the probe (both µm) and Poisson's ratio.
MEMBRANE: dict[str, Any] = {
    "thickness": claim("table-5.6/h").value,
    "probe_half_width": PROBE_WIDTH / 2,
    "poisson_ratio": claim("table-5.6/nu").value,
}


def table_5_1(column: str, name: str) -> float:
    """Return an entry of Table 5.1 as printed.

    Parameters
    ----------
    column : str
        One of `COLUMNS`.
    name : str
        ``M``, ``T_op``, ``f``, ``d``, ``T_x``, ``T_y``, ``T_z`` (lengths in µm), ``kappa`` (1/µm²),
        ``alpha``, ``beta`` or ``gamma`` (degrees).

    Returns
    -------
    float
        The printed number.

    Raises
    ------
    ValueError
        If the table has no such entry.

    Examples
    --------
    >>> table_5_1("circle-1X", "M")
    1.5893
    """
    return claim(f"table-5.1/{column}/{name}").value


def microscope(column: str) -> Microscope:
    """Return the microscope of one column of Table 5.1.

    T_z, of which the last column's is wrong in print, is f + d (2.8).

    Parameters
    ----------
    column : str
        One of `COLUMNS`.

    Returns
    -------
    Microscope
        With the pixel pitch and the image size of the Basler camera.

    Raises
    ------
    ValueError
        If there is no such column.

    Examples
    --------
    >>> microscope("square-4X").focal_length
    31174.0
    """
    alpha, beta, gamma = (
        float(np.deg2rad(table_5_1(column, name))) for name in ("alpha", "beta", "gamma")
    )
    return Microscope(
        tube_length=table_5_1(column, "T_op"),
        focal_length=table_5_1(column, "f"),
        distance=table_5_1(column, "d"),
        distortion=table_5_1(column, "kappa"),
        alpha=alpha,
        beta=beta,
        gamma=gamma,
        tx=table_5_1(column, "T_x"),
        ty=table_5_1(column, "T_y"),
        pixel_pitch=BASLER_PIXEL_PITCH,
        image_size=BASLER_IMAGE_SIZE,
    )


def pattern_pitch(column: str) -> float:
    """Return the step in µm of the grid of points that a column of Table 5.1 is calibrated on.

    The pitch of the circles is not printed. It is taken as twice their diameter, as on the maker's
    plates; squares stand one side apart.

    Parameters
    ----------
    column : str
        One of `COLUMNS`.

    Returns
    -------
    float
        Distance of neighbouring centers of circles or corners of squares, µm.

    Examples
    --------
    >>> [pattern_pitch(column) for column in COLUMNS]
    [280.0, 280.0, 200.0, 50.0]
    """
    if column.startswith("circle"):
        return 4 * claim("section-5.1/circle-radius").value
    size = "large" if column == "square-1X" else "small"
    return claim(f"section-5.1/square-{size}").value


def effective_pixel(zoom: str) -> float:
    """Return the pixel of the servoing camera on the sample, µm: pixel pitch over magnification.

    Parameters
    ----------
    zoom : str
        ``1X`` or ``4X``; the magnification is that of the circles in Table 5.1.

    Returns
    -------
    float
        Size of a pixel, µm.

    Raises
    ------
    ValueError
        If there is no such zoom.

    Examples
    --------
    >>> round(effective_pixel("1X"), 2)
    6.23
    """
    return BASLER_PIXEL_PITCH / table_5_1(f"circle-{zoom}", "M")


def thesis_stack(texture: ArrayLike, height: ArrayLike, positions: ArrayLike) -> NDArray[np.uint8]:
    """Return a focal stack by the recipe of section 5.5.1.

    A pixel is sharp in the frame nearest to its height and blurred by one 7×7 Gaussian of σ = 1 px
    in all others, however far they are.

    Parameters
    ----------
    texture : array_like, shape (rows, cols)
        Grey levels of the surface in focus.
    height : array_like, shape (rows, cols)
        Height of the surface, µm.
    positions : array_like, shape (n,)
        Height in focus in each frame, µm.

    Returns
    -------
    ndarray of uint8, shape (n, rows, cols)
        The frames.

    Notes
    -----
    Two levels of blur cannot tell where between two frames a surface lies: the best possible depth
    is that of the nearest frame. `microlib.synthetic.focal_stack` blurs by the distance, as a lens
    does.

    Examples
    --------
    >>> texture = np.random.default_rng(0).uniform(0, 255, (16, 16))
    >>> stack = thesis_stack(texture, np.zeros((16, 16)), [0.0, 25.0, 50.0])
    >>> np.array_equal(stack[1], stack[2])
    True
    """
    image = np.asarray(texture, dtype=np.float32)
    surface = np.asarray(height, dtype=np.float64)
    focus = np.asarray(positions, dtype=np.float64)
    window, sigma = (claim(f"section-5.5/blur-{name}").value for name in ("window", "sigma"))
    blurred = cv2.filter2D(image, cv2.CV_32F, gaussian_kernel(sigma, int(window)))
    nearest = np.abs(surface[None] - focus[:, None, None]).argmin(axis=0)
    frames = [np.where(nearest == k, image, blurred) for k in range(len(focus))]
    return np.clip(np.rint(frames), 0, 255).astype(np.uint8)


def outline_curve() -> GaussianSum:
    """Return the outline of the dimple that Table 5.5 prints, (5.1).

    Returns
    -------
    GaussianSum
        Eight Gaussians in px, y up.

    Examples
    --------
    >>> float(outline_curve()(194.69).round(2))
    62.93
    """
    amplitudes, centers, widths = (
        np.array([claim(f"table-5.5/{letter}{i}").value for i in range(1, 9)]) for letter in "abc"
    )
    return GaussianSum(amplitudes, centers, widths, domain=OUTLINE_DOMAIN)


def modulus(
    rim_radius: float,
    dimple_depth: float,
    *,
    force: float = FORCE,
    probe_half_width: float = MEMBRANE["probe_half_width"],
) -> float:
    """Return (5.2), the elastic modulus, with the settings of Table 5.6.

    Parameters
    ----------
    rim_radius, dimple_depth : float
        a and w_d, µm.
    force : float
        µN; that of Table 5.6 by default.
    probe_half_width : float
        µm; half of `PROBE_WIDTH` by default.

    Returns
    -------
    float
        Modulus in MPa.

    Raises
    ------
    ValueError
        As `microlib.membrane.elastic_modulus`.

    Warns
    -----
    SmallSlopeWarning
        For all dimples of the thesis, which are steeper than the model allows.
    """
    settings = MEMBRANE | {"probe_half_width": probe_half_width}
    return float(elastic_modulus(force, rim_radius, dimple_depth, **settings))
