"""The compiled measures beside SciPy's filters in double precision."""

import numpy as np
import pytest
from scipy import ndimage

from microlib.focus import _filters, _measures


def smooth(image, sigma):
    """A Gaussian cut off as OpenCV does, or two boxes of its variance."""
    if sigma < 4:
        return ndimage.gaussian_filter(
            image, sigma, mode="mirror", radius=round(8 * sigma + 1) // 2
        )
    n = 2 * round((np.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1
    for _ in range(2):
        image = ndimage.uniform_filter(image, n, mode="mirror")
    return image


def second(image, axis):
    return np.abs(ndimage.correlate1d(image, [-1.0, 2.0, -1.0], axis=axis, mode="mirror"))


def product(image, noise):
    result = 1.0
    for scale in _measures._SCALES:
        fine = smooth(image, scale.smooth)
        laplacian = second(fine, 0) + second(fine, 1)
        result = result * (smooth(laplacian, scale.spread) + noise * scale.gain)
    return result


def edge(image, noise):
    deviation = np.abs(image - smooth(image, _measures._EDGE_MEAN))
    floor = noise * np.sqrt(2 / np.pi)
    return (smooth(deviation, _measures._EDGE_FINE) + floor) * (
        smooth(deviation, _measures._EDGE_COARSE) + floor
    )


#: Smaller than any filter, a tile and some, and two tiles in each direction.
SHAPES = [(9, 7), (1, 40), (70, 33), (150, 530)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("make", "expected"),
    [(_measures.multiscale_measure, product), (_measures.edge_measure, edge)],
)
def test_measures_are_the_documented_filters(shape, make, expected):
    image = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    found = make(1.5)(image, slice(0, shape[0]))
    # Sums of some hundred products in single precision.
    np.testing.assert_allclose(found, expected(image.astype(float), 1.5), rtol=3e-5)


@pytest.mark.parametrize("make", [_measures.multiscale_measure, _measures.edge_measure])
def test_a_pixel_does_not_depend_on_the_rows_that_are_asked_for(make):
    image = np.random.default_rng(1).normal(100, 20, (160, 40)).astype(np.float32)
    measure = make(2.0)
    whole = measure(image, slice(0, 160))
    for rows in (slice(0, 5), slice(37, 121), slice(150, 160)):
        np.testing.assert_array_equal(measure(image, rows), whole[rows])


@pytest.mark.parametrize("side", range(1, 2 * _filters.MOST_REACH + 4, 2))
def test_a_box_is_the_mean_of_its_square(side):
    """Every side is made of other sums, of which one may be wrong."""
    image = np.random.default_rng(side).normal(size=(70, 60)).astype(np.float32)
    expected = ndimage.uniform_filter(image.astype(float), side, mode="mirror")
    # A few dozen sums in float32 of numbers around 1, over the square.
    np.testing.assert_allclose(_measures.box(image, side), expected, atol=1e-6)


def test_every_filter_fits_into_the_margin_of_a_tile():
    for measure in (_measures.multiscale_measure(1.0), _measures.edge_measure(1.0)):
        assert measure.reach <= _filters.MOST_REACH


def test_rows_of_a_tile_begin_with_a_cache_line():
    room = _filters.own_room()
    first = room[:, _filters.FRONT :: _filters.STRIDE]
    assert room.ctypes.data % 64 == 0
    assert all(step % 64 == 0 for step in first.strides)
    assert 4 * _filters.FRONT % 64 == 0
