"""One step of ESM and of the Kalman filter, against the truth, the library and the formulas."""

import numpy as np
import pytest

from compendium.experiments import chapter_2_tracking as tracking


def test_order_of_convergence_of_known_sequence_is_found():
    for order in (1.0, 1.5, 2.0, 3.0):
        # From 3 px on each error is a power of the one before, over 8 times its scale.
        errors = [3.0]
        while errors[-1] >= 0.1:
            errors.append(errors[-1] * (errors[-1] / 4) ** (order - 1) * 0.5)
        if len(errors) < 3:
            continue
        found = tracking.order_of_convergence(np.array([*errors, 1e-3, 1e-3]))
        assert found == pytest.approx(order)
