"""The ends of what the renderers take."""

from dataclasses import replace

import numpy as np
import pytest
from skimage.draw import polygon

from microlib import synthetic
from microlib.microscope import Microscope

STRAIGHT = Microscope(2e5, 126e3, 79380.0, tx=-60, ty=-60, pixel_pitch=9.9, image_size=(21, 21))


def test_center_pixel_of_a_square_is_dark():
    """Its middle is as far from either side: that leaked a division by zero."""
    image = synthetic.render_squares(STRAIGHT, side=120.0)
    assert STRAIGHT.project([[60.0, 60.0]]).round(9).tolist() == [[10.0, 10.0]]
    assert image[10, 10] == image.min()


def test_rendered_edges_equal_dense_sampling():
    """A tilted, distorted square against scikit-image's polygon on a 15-fold finer grid."""
    scope = Microscope(
        2e5, 1e5, 5e4, 5e-8, 0.4, 0.3, -0.2, tx=-60, ty=-80, pixel_pitch=9.9, image_size=(80, 70)
    )
    light = synthetic.ImagingConditions(blur=0.0)
    image = synthetic.render_squares(scope, side=150, counts=(1, 1), imaging=light)
    t = np.linspace(0, 1, 50, endpoint=False)
    side = np.column_stack([t, 0 * t])
    edge = np.concatenate([side, side[:, ::-1] + (1, 0), 1 - side, (0, 1) - side[:, ::-1]])
    seen = 15 * (scope.project(150 * edge) + 0.5) - 0.5
    mask = np.zeros((15 * 70, 15 * 80))
    mask[polygon(seen[:, 1], seen[:, 0], mask.shape)] = 1
    covered = mask.reshape(70, 15, 80, 15).mean(axis=(1, 3))
    # Sampling an edge at 15 points a side errs by up to about 1/15 in a pixel, and averages out.
    difference = image - (200 - 150 * covered)
    assert np.abs(difference).max() < 150 / 15
    assert abs(difference.mean()) < 0.02


@pytest.mark.parametrize(
    "draw",
    [
        lambda flat: synthetic.focal_stack(flat, 0 * flat, [0, 1], blur_rate=1, noise=3, rng=0)[1],
        lambda flat: synthetic.embryo_image(
            synthetic.Embryo(1.0, 0.0, 1.0), rng=3, shape=flat.shape, center=(0.0, 999.0),
            probe=False, noise=3.0, unevenness=0.0,
        ).image,
        lambda flat: np.rint(synthetic.render_squares(
            replace(STRAIGHT, tx=9e4, image_size=flat.shape[::-1]), counts=(1, 1), rng=1,
            imaging=synthetic.ImagingConditions(bright=195.0, noise=3.0),
        )).astype(np.uint8),
    ],
)  # fmt: skip
def test_noise_has_the_given_standard_deviation(draw):
    frame = draw(np.full((200, 210), 195.0))
    assert frame.dtype == np.uint8
    # 42,000 pixels: the mean to 0.015, the spread to 0.4 %; rounding adds 1/12 to the variance.
    assert frame.mean() == pytest.approx(195.0, abs=0.06)
    assert frame.std() == pytest.approx(np.hypot(3.0, 12**-0.5), rel=0.02)
