"""The thin lens against its equations, the blur against OpenCV and the Fourier transform."""

import cv2
import numpy as np
import pytest

from microlib import optics
from tests.checks import (
    BROKEN,
    NEGATIVE,
    NO_COUNT,
    each_view,
    follows_view,
    hold_call,
    hold_refused,
    not_finite,
)

#: µm: an objective near the thesis' (f = 31.4 mm, M = 6.4).
LENS = {"focal_length": 31415.0, "sensor_distance": 232000.0, "aperture_radius": 4000.0}
#: Grey levels and blurs (px) without a symmetry.
IMAGE = np.random.default_rng(4).normal(90.0, 25.0, (23, 31))
BLUR = np.linspace(0.3, 2.6, 23)[:, None] + np.linspace(0.0, 1.1, 31) ** 2


DISTANCES = np.array([33000.0, 36000.0, 41000.0, 1e7])
#: A valid call of each function.
CALLS = {
    optics.BlurLadder: lambda: {"image": IMAGE, "largest": 4.0},
    optics.BlurLadder.at: lambda: {"self": optics.BlurLadder(IMAGE, 4.0), "sigma": BLUR},
    optics.blur_radius: lambda: {"object_distance": DISTANCES, **LENS},
    optics.defocus: lambda: {"image": IMAGE, "sigma": 1.7},
    optics.gaussian_kernel: lambda: {"sigma": 1.3, "size": 7},
    optics.gaussian_transfer: lambda: {"u": 0.4, "v": np.array([-0.3, 0.7]), "sigma": 1.3},
    optics.image_distance: lambda: {
        "object_distance": DISTANCES, "focal_length": LENS["focal_length"],
    },
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)
SMALL = np.zeros((4, 5))
LENGTH = [*BROKEN, 0, -1]
#: What is refused in place of each argument.
REFUSED = {
    optics.BlurLadder: {"largest": [*NEGATIVE, 31.1]},
    optics.BlurLadder.at: {"sigma": lambda valid: [*not_finite(valid), SMALL, 4.1]},
    optics.blur_radius: {
        "object_distance": not_finite, "sensor_distance": [*LENGTH, 90.0],
        **dict.fromkeys(("focal_length", "aperture_radius"), LENGTH),
    },
    optics.defocus: {"sigma": [*BROKEN, -1, 31.1, SMALL]},
    optics.gaussian_kernel: {"size": [*NO_COUNT, 6]},
    optics.gaussian_transfer: {"u": BROKEN, "v": not_finite, "sigma": [*BROKEN, -1]},
    optics.image_distance: {"object_distance": lambda valid: [*not_finite(valid), 50.0]},
}  # fmt: skip


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function])


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


@pytest.mark.parametrize("gain", [1 / 255, 257.0])
def test_blurred_grey_levels_follow_gain_and_offset(gain):
    for sigma in (1.7, BLUR):
        wanted = gain * (optics.defocus(IMAGE, sigma) + 27.0)
        found = optics.defocus(gain * (IMAGE + 27.0), sigma)
        np.testing.assert_allclose(found, wanted, rtol=1e-5)  # single precision


@each_view
def test_defocus_follows_flips_and_rotations(view):
    for blur in (BLUR, np.full(IMAGE.shape, 1.7)):
        follows_view(view, optics.defocus, IMAGE, blur, rtol=1e-5)


def test_blur_radius_equals_the_printed_forms():
    """(3.2), (3.4) and (3.5), with the distances d_i of (3.1) and w_d of (3.3)."""
    f, d_s, r = LENS.values()
    d_o = DISTANCES
    d_i, w_d = 1 / (1 / f - 1 / d_o), 1 / (1 / f - 1 / d_s)
    np.testing.assert_allclose(optics.image_distance(d_o, f), d_i, rtol=1e-11)
    ours = optics.blur_radius(d_o, **LENS)
    # Rounding only: a difference of distances that agree to a thousandth loses three digits.
    np.testing.assert_allclose(ours, r * (d_i - d_s) / d_i, rtol=1e-11)
    np.testing.assert_allclose(ours, r * d_s * (1 / d_s + 1 / d_o - 1 / f), rtol=1e-11)
    np.testing.assert_allclose(ours, r * d_s * (1 / d_o - 1 / w_d), rtol=1e-11)


def test_blur_radius_is_zero_in_focus_and_signed_by_side():
    focused = float(optics.image_distance(LENS["sensor_distance"], LENS["focal_length"]))
    near, sharp, far = optics.blur_radius([focused - 100, focused, focused + 100], **LENS)
    assert abs(sharp) < 1e-9  # µm, rounding
    assert near > 1 > -1 > far
    with pytest.raises(ValueError, match="object_distance must exceed the focal length"):
        optics.image_distance([2.0, 1.0] * np.array(LENS["focal_length"]), LENS["focal_length"])


@pytest.mark.parametrize("sigma", [1.0, 2.5])
def test_gaussian_transfer_equals_fourier_transform_of_kernel(sigma):
    kernel = optics.gaussian_kernel(sigma, 65)
    frequency = 2 * np.pi * np.fft.fftfreq(65)
    transform = np.fft.fft2(np.fft.ifftshift(kernel)).real
    ours = optics.gaussian_transfer(frequency[None, :], frequency[:, None], sigma)
    # Aliasing of the sampled Gaussian: exp(-(2 pi - w)^2 sigma^2 / 2) at the highest frequency
    # pi, sigma = 1.
    np.testing.assert_allclose(transform, ours, atol=2.1 * np.exp(-(np.pi**2) / 2))
    low = np.abs(frequency) < 1.0
    np.testing.assert_allclose(transform[np.ix_(low, low)], ours[np.ix_(low, low)], atol=3e-6)


def test_kernel_much_narrower_than_a_pixel_is_one_pixel():
    np.testing.assert_array_equal(optics.gaussian_kernel(1e-300, 3), np.diag([0.0, 1.0, 0.0]))


def test_uniform_defocus_equals_opencv_gaussian_blur():
    for sigma in (0.6, 1.7, 4.0):
        peer = cv2.GaussianBlur(IMAGE, (41, 41), sigma, borderType=cv2.BORDER_REFLECT)
        # float32 sums of 41 terms, and tails beyond five standard deviations
        np.testing.assert_allclose(optics.defocus(IMAGE, sigma), peer, atol=2e-3)
        ladder = optics.defocus(IMAGE, np.full(IMAGE.shape, sigma))
        assert np.sqrt(np.mean((ladder - peer) ** 2)) < 0.05  # the ladder's stated error


def test_varying_defocus_equals_sum_over_kernels_of_pixels():
    sigma = np.tile(np.linspace(0.0, 3.0, 31), (23, 1))
    ours = optics.defocus(IMAGE, sigma)
    padded = np.pad(IMAGE, 16, mode="symmetric")
    for y, x in [(0, 1), (5, 3), (12, 13), (20, 22), (22, 30)]:
        kernel = optics.gaussian_kernel(sigma[y, x], 33)
        direct = np.sum(kernel * padded[y : y + 33, x : x + 33])
        assert ours[y, x] == pytest.approx(direct, abs=0.25)  # five times the ladder's rms error
    sharp = IMAGE.astype(np.float32)
    assert not np.shares_memory(optics.defocus(sharp, 0.0), sharp)
    for widest in (31.0, np.full(IMAGE.shape, 31.0)):  # the longest side leaves nearly the mean
        assert np.ptp(optics.defocus(IMAGE, widest)) < 1


@pytest.mark.parametrize("largest", [0.3, 0.9, 2.0, 4.7, 9.0])
def test_blur_ladder_has_its_ends_exactly(largest):
    """Between two levels of the ladder the blur is mixed; past the last one it would be wrong."""
    image = np.zeros((121, 121), np.float32)
    image[60, 50] = 1.0
    ladder = optics.BlurLadder(image, largest)
    assert ladder.largest == largest
    exact = cv2.GaussianBlur(image, (0, 0), largest, borderType=cv2.BORDER_REFLECT)
    blurred = ladder.at(np.full(image.shape, largest))
    np.testing.assert_allclose(blurred, exact, rtol=0, atol=0.03 * exact.max())
    # The lowest level is the image itself: rounding only.
    left = np.arange(121) < 60
    partly = ladder.at(np.tile(np.where(left, 0.0, largest), (121, 1)))
    np.testing.assert_allclose(partly[:, left], image[:, left], rtol=1e-6)
