"""The focal stack that most tests of reading write into files."""

import numpy as np
import pytest

from microlib import synthetic
from tests.scenes import tilted_plane

COUNT, SHAPE = 12, (48, 56)


@pytest.fixture(scope="session")
def stack():
    """Return twelve frames, at positions 0 to 11, of a tilted plane near position 5.3."""
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(0))
    height = 5.3 + tilted_plane(SHAPE, 0.05, 0.02)
    frames = synthetic.focal_stack(texture, height, np.arange(float(COUNT)), blur_rate=1.0)
    frames.flags.writeable = False  # all tests share them
    return frames
