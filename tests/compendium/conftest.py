"""What several of the experiments on servoing are tried with."""

import pytest

from compendium.experiments.section_5_4 import Workstation


@pytest.fixture(scope="session")
def station() -> Workstation:
    """A workstation near the one that is found, at round values."""
    return Workstation(
        saturation={"1X": 390.0, "4X": 172.0},
        jitter=0.12,
        path_speed={"circle": 40.0, "square": 32.0, "sinusoid": 27.0},
        seed=5,
    )
