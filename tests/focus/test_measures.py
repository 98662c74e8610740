"""Focus measures against sums over (3.11) and (3.12), and what holds for each that has a name."""

from itertools import product

import numpy as np
import pytest

from microlib.focus import depth_from_focus, sum_modified_laplacian
from tests.scenes.focus import MEASURES


def printed_sml(image: np.ndarray, w: int, step: int, threshold: float) -> np.ndarray:
    """(3.11) and (3.12) with shifted images, mirrored about the outermost pixel."""
    rows, cols = image.shape

    def at(a, y, x):
        padded = np.pad(a, 24, mode="reflect")
        return padded[24 + y : 24 + y + rows, 24 + x : 24 + x + cols]

    image = image.astype(float)
    ml = np.abs(2 * image - at(image, -step, 0) - at(image, step, 0))
    ml += np.abs(2 * image - at(image, 0, -step) - at(image, 0, step))
    ml = np.where(ml > threshold, ml, 0)
    return sum(at(ml, u, v) for u, v in product(range(-w, w + 1), repeat=2))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize(
    ("w", "step", "threshold"), [(1, 1, 0), (2, 1, 90), (2, 2, 33.5), (4, 3, 0), (20, 2, 7)]
)
def test_sml_equals_equations_3_11_and_3_12(dtype, w, step, threshold):
    rng = np.random.default_rng(w + step)
    image = 15 * rng.integers(0, 18, (14, 17)).astype(dtype)  # some values equal the threshold
    ours = sum_modified_laplacian(image, window=2 * w + 1, step=step, threshold=threshold)
    # Sums of integers below 2²⁴ are exact in float32 too; the last window exceeds the image.
    np.testing.assert_array_equal(ours, printed_sml(image, w, step, threshold))


def test_largest_sml_does_not_overflow():
    board = (255 * (np.indices((20, 20)).sum(axis=0) % 2)).astype(np.uint8)
    for window in (5, 7, 9):
        ours = sum_modified_laplacian(board, window=window)
        assert ours[10, 10] == 4 * 255 * window**2
        assert ours.dtype == (np.uint16 if window <= 7 else np.float32)


def test_every_measure_is_documented_where_it_is_chosen():
    for name in MEASURES:
        assert f'"{name}"' in str(depth_from_focus.__doc__).split("measure : ")[1].split("\n")[0]
