"""A number with its uncertainty."""

import numpy as np
import pytest

from microlib.estimate import Estimate


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((0.50217, 0.00042, 0.50134, 0.503), "0.50217 MPa (95 %: 0.50134 to 0.50300)"),
        ((1254.3, 130.0, 980.2, 1610.9), "1254 MPa (95 %: 980 to 1611)"),
        ((2.01234, 0.0, 2.0, 2.0), "2.01234 MPa (95 %: 2 to 2)"),
        ((np.nan, np.inf, -np.inf, np.inf), "not determined"),
        ((-8.4e-8, 1.5e-9, -8.43e-8, -8.37e-8), "-8.4e-08 MPa (95 %: -8.43e-08 to -8.37e-08)"),
        ((3.14159, 0.02, 3.1, np.inf), "3.142 MPa (95 %: 3.100 to inf)"),
    ],
)
def test_estimate_shows_two_digits_of_its_uncertainty(numbers, text):
    found = Estimate(*numbers, "MPa")
    assert str(found) == text
    assert found.interval == (numbers[2], numbers[3]) or np.isnan(numbers[0])
