"""Bands of rows, against the map as a whole."""

import numpy as np
import pytest

from microlib.focus.common import bands, blur


@pytest.mark.parametrize("rows", [5, 64, 129, 150])
def test_map_computed_in_bands_equals_that_computed_as_a_whole(rows):
    image = np.random.default_rng(rows).random((rows, 40))
    whole, joined = blur(image, 1.0), np.full_like(image, np.nan)
    for band in bands(rows, 64, 3):  # a border of at least the three rows that the filter reaches
        joined[band.rows] = blur(image[band.padded], 1.0)[band.own]
        assert len(image[band.padded]) <= 64 + 2 * 3
    np.testing.assert_allclose(joined, whole, rtol=1e-12)
