"""Chapter 2: the steps of ESM, one by one, for the figures.

The minimization is written here by its equations, for the text. A test compares the minimization of
`microlib.tracking` with this one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.ndimage import gaussian_filter, map_coordinates

from microlib.synthetic import mixed_texture
from microlib.tracking import ESMTracker

#: Half the side of the template, px, and the middle of the image, (x, y) in px.
HALF, MIDDLE = 32, np.array([80.0, 80.0])
#: Rim of the template, px, that is not compared, because its derivatives would need pixels beyond
#: the edge.
RIM = 4
#: Which gradients make the step: shares of the template's and of the warped image's.
GRADIENTS = {"template": (1.0, 0.0), "image": (0.0, 1.0), "mean of both (ESM)": (0.5, 0.5)}
#: Elementary motions Bᵢ on coordinates from −1 to 1: shifts, and the four of a linear map.
MOTIONS = np.zeros((6, 3, 3))
for _motion, _entry in zip(MOTIONS, [(0, 2), (1, 2), (0, 0), (0, 1), (1, 0), (1, 1)], strict=True):
    _motion[_entry] = 1.0


@dataclass(frozen=True)
class Target:
    """A textured square, and an image that shows it shifted, turned and stretched.

    Attributes
    ----------
    template : ndarray, shape (N, N)
        The square as it was at first, grey levels.
    image : ndarray, shape (H, W)
        Grey levels.
    warp : ndarray, shape (3, 3)
        The true G: from coordinates of the template, −1 to 1, to those of the image.
    """

    template: NDArray[np.float64]
    image: NDArray[np.float64]
    warp: NDArray[np.float64]


def render_target(seed: int, noise: float = 2.0) -> Target:
    """Render the square on a plain ground, moved by 6 px, turned and stretched."""
    rng = np.random.default_rng(seed)
    side = 2 * HALF + 1
    texture = gaussian_filter(mixed_texture((side, side), rng).astype(float), 2.0)
    # Turn, stretch and shear, and a shift. With 1.4 times as much, ESM fails on some textures.
    motion = 0.7 * np.array([[0.12, 0.13, 0.22], [-0.10, -0.08, -0.17]])
    warp = expm(np.vstack([motion, np.zeros(3)]))
    rows, cols = np.indices((160, 160), dtype=float)
    seen = (np.stack([cols, rows], axis=-1) - MIDDLE) / HALF
    place = (seen - warp[:2, 2]) @ np.linalg.inv(warp[:2, :2]).T
    index = HALF * (place[..., ::-1] + 1)
    image = map_coordinates(texture, np.moveaxis(index, -1, 0), order=3, cval=60.0)
    return Target(texture, image + rng.normal(0, noise, image.shape), warp)


def warped(image: NDArray, warp: NDArray) -> NDArray:
    """Return the image at the pixels of the template, moved by `warp`."""
    steps = np.linspace(-1, 1, 2 * HALF + 1)
    x, y = np.meshgrid(steps, steps)
    moved = np.stack([x, y], axis=-1) @ warp[:2, :2].T + warp[:2, 2]
    points = MIDDLE + HALF * moved
    return map_coordinates(image, [points[..., 1], points[..., 0]], order=3, mode="nearest")


def corners(warp: NDArray) -> NDArray:
    """Return the corners of the warped template in the image, 4×2 px."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return MIDDLE + HALF * (square @ warp[:2, :2].T + warp[:2, 2])


def align(target: Target, gradients: tuple[float, float], iterations: int) -> list[NDArray]:
    """Minimize the difference between template and warped image, from the pose before the motion.

    Parameters
    ----------
    target : Target
        Template and image.
    gradients : tuple of float
        Shares of the gradients of the template and of the warped image, as in `GRADIENTS`.
    iterations : int
        Number of steps.

    Returns
    -------
    list of ndarray
        The identity, from which the minimization starts, and the warp after each step.
    """
    inside = np.s_[..., RIM:-RIM, RIM:-RIM]
    template = target.template
    steps = np.linspace(-1, 1, 2 * HALF + 1)
    x, y = np.meshgrid(steps, steps)
    moves = np.einsum("nij,jrc->nirc", MOTIONS, np.stack([x, y, np.ones_like(x)]))[:, :2]
    warps = [np.eye(3)]
    for _ in range(iterations):
        current = warped(target.image, warps[-1])
        # Of the template and of the warped image, along x and y.
        slopes = [np.stack([*np.gradient(g, steps, steps)][::-1]) for g in (template, current)]
        slope = gradients[0] * slopes[0] + gradients[1] * slopes[1]
        change = np.einsum("irc,nirc->rcn", slope[inside], moves[inside])
        jacobian, residual = change.reshape(-1, len(MOTIONS)), (template - current)[inside].ravel()
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        warps.append(warps[-1] @ expm(np.einsum("n,nij->ij", step, MOTIONS)))
    return warps


def errors_by_gradient(target: Target, iterations: int) -> pd.DataFrame:
    """Return the mean error of the corners, px, after each step and for each of `GRADIENTS`."""
    true = corners(target.warp)
    table = pd.DataFrame(index=pd.RangeIndex(iterations + 1, name="iteration"))
    for name, shares in GRADIENTS.items():
        warps = align(target, shares, iterations)
        table[name] = [np.linalg.norm(corners(warp) - true, axis=1).mean() for warp in warps]
    return table


def order_of_convergence(errors: NDArray) -> float:
    """Return the order at which errors fall, from the first below a tenth and the two before.

    Examples
    --------
    >>> round(order_of_convergence(np.array([2.0, 0.5, 0.03125])), 6)  # each is the square over 8
    2.0
    """
    last = int((errors < 0.1).argmax())
    before, middle, end = np.log(errors[last - 2 : last + 1])
    return float((end - middle) / (middle - before))


def library_error(seed: int) -> float:
    """Return the error (px) of the corners that `ESMTracker` finds in the square without noise."""
    target = render_target(seed, noise=0.0)
    first = np.full(target.image.shape, 60.0, np.float32)
    side, (left, top) = 2 * HALF + 1, (MIDDLE - HALF).astype(int)
    first[top : top + side, left : left + side] = target.template
    box = (int(left) + RIM, int(top) + RIM, side - 2 * RIM, side - 2 * RIM)
    track = ESMTracker(first, box, "affine").track(target.image.astype(np.float32))
    inner = np.diag([1 - RIM / HALF, 1 - RIM / HALF, 1.0])
    return float(np.abs(track.corners - corners(target.warp @ inner)).max())
