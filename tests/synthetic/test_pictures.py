"""The ends of what the renderers take."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from microlib import synthetic
from microlib.microscope import Microscope

SMALL = Microscope(2e5, 1e5, 5e4, tx=-700, ty=-560, pixel_pitch=9.9, image_size=(300, 240))
STRAIGHT = Microscope(2e5, 126e3, 79380.0, tx=-60, ty=-60, pixel_pitch=9.9, image_size=(21, 21))


def test_center_pixel_of_a_square_is_dark():
    """Its middle is as far from either side: that leaked a division by zero."""
    image = synthetic.render_squares(STRAIGHT, side=120.0)
    assert STRAIGHT.project([[60.0, 60.0]]).round(9).tolist() == [[10.0, 10.0]]
    assert image[10, 10] == image.min()


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


def box_edge(x, edge, blur):
    """Share of pixel `x` to the right of a straight edge with Gaussian blur: its mean over the
    pixel."""

    def integral(t):
        return t * ndtr(t) + np.exp(-t * t / 2) / np.sqrt(2 * np.pi)

    upper, lower = (x + 0.5 - edge) / blur, (x - 0.5 - edge) / blur
    return blur * (integral(upper) - integral(lower))


def test_rendered_edge_equals_its_exact_integral():
    image = synthetic.render_squares(
        SMALL, side=20 * 9.9 / 2, counts=(1, 1), imaging=synthetic.ImagingConditions(blur=1.3)
    )
    left, right = SMALL.project([[0.0, 0.0], [99.0, 0.0]])[:, 0]
    row = int(SMALL.project([[0.0, 49.5]])[0, 1])
    x = np.arange(300)
    covered = box_edge(x, left, 1.3) - box_edge(x, right, 1.3)
    # The renderer samples the Gaussian every third of a pixel and cuts it off at 4.2 standard
    # deviations, which changes grey levels by 2e-4 of the contrast of 150.
    np.testing.assert_allclose(image[row], 200 - 150 * covered, atol=0.03)


@given(turn=st.floats(0, 2 * np.pi), x=st.floats(-3, 3), y=st.floats(-3, 3))
@settings(deadline=None, max_examples=15)
def test_rendered_area_of_a_circle_is_exact(turn, x, y):
    """Without blur, the dark area is that of the circle on the sensor."""
    scope = Microscope(2e5, 1e5, 5e4, alpha=turn, tx=x, ty=y, pixel_pitch=9.9, image_size=(80, 80))
    sharp = synthetic.ImagingConditions(blur=0.0)
    image = synthetic.render_circles(scope, radius=80, counts=(1, 1), imaging=sharp)
    # Edges are straight within cells of a third of a pixel, a relative error of (1/3)²/(24 r²) with
    # r = 16 px; the rest is rounding to float32.
    area = ((200 - image) / 150).sum() * (9.9 / 2) ** 2
    assert area == pytest.approx(np.pi * 80**2, rel=4e-5)
