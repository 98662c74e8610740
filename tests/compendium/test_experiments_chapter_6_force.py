"""The relaxing sequence: its truth by hand, and that what is read follows it."""

from __future__ import annotations

import numpy as np

from compendium.experiments import chapter_6_force
from compendium.experiments.chapter_6_force import RELAXATION_TIME, SHARE
from microlib.membrane import viscoelastic_force


def test_true_force_follows_viscoelastic_law():
    time = np.array([0.0, 1.0, 2.0, 5.0, 8.0, 9.0, 10.0])  # with every turn
    law = {"prony_coefficients": [SHARE], "relaxation_times": [RELAXATION_TIME]}
    wanted = viscoelastic_force(time, chapter_6_force.elastic_push(time), **law)
    # Turns that fall within a step of 0.02 s cost 0.01 of the rate.
    np.testing.assert_allclose(chapter_6_force.true_force(time), wanted, atol=0.05)
