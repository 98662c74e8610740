"""The laws of every public name of synthetic: scenes obey the units and turns that they draw."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from microlib import synthetic
from microlib.microscope import Microscope
from tests.laws import (
    NUMBER,
    VIEWS,
    MPa,
    Row,
    Units,
    follows_origins,
    grey,
    laws_of,
    scales_with_units,
    second_call_gives_the_same,
    um,
    uN,
)
from tests.test_microscope import SCOPE

SHAPE = (21, 34)
TEXTURE = synthetic.mixed_texture((26, 33), 5)
RELIEF = np.linspace(-4.0, 9.0, 26)[:, None] + 2.0 * np.sin(np.arange(33) / 5.0)
FOCI = np.array([7.0, 1.5, -2.0, 11.0])


def membrane(u) -> dict:
    return {
        "modulus": 1.3 * u.MPa,
        "thickness": 4.0 * u.um,
        "probe_half_width": 30.0 * u.um,
        "poisson_ratio": 0.4,
        "radius": 560.0 * u.um,
    }


def embryo(u, **changes) -> synthetic.Embryo:
    given = {"force": 160.0 * u.uN, "rim_radius": 230.0 * u.um, **membrane(u)}
    return synthetic.Embryo(**given | changes)


def pressed(u) -> dict:
    return {"rim_curvature_radius": 420.0 * u.um, **membrane(u)}


def scope(u, **changes) -> Microscope:
    upright = dict.fromkeys(("alpha", "beta", "gamma"), 0.0)
    place = {"tx": -310.0 * u.um, "ty": -190.0 * u.um, "image_size": (110, 80)}
    place["principal_offset"] = (2.0, -1.5)
    lengths = {n: getattr(SCOPE, n) * u.um for n in ("tube_length", "focal_length", "distance")}
    place["pixel_pitch"] = (9.9 * u.um, 8.3 * u.um)
    kappa = {"distortion": SCOPE.distortion / u.um**2, "distortion_k2": 3e-17 / u.um**4}
    return replace(SCOPE, **lengths, **kappa, **upright | place | changes)


def imaging(u) -> synthetic.ImagingConditions:
    return synthetic.ImagingConditions(
        blur=0.8,
        dark=40.0 * u.grey,
        bright=150.0 * u.grey,
        vignetting=0.2,
        gradient=(0.15, -0.1),
        noise=1.5 * u.grey,
    )


def pattern(u) -> dict:
    return {"microscope": scope(u), "counts": (3, 2), "imaging": imaging(u), "rng": 3}


def place(u) -> dict:
    return {"pixel_size": 9.0 * u.um, "shape": (150, 170), "center": (85.3, 12.2), "tilt": 0.1}


def tilted(u) -> synthetic.EmbryoImage:
    return synthetic.embryo_image(embryo(u), rng=2, **place(u))


def jaws(u) -> dict:
    return {"pixel_size": 6.1 * u.um, "gap": 90.0 * u.um, "shape": (60, 80), "reach": 5}


def gripper(u) -> synthetic.GripperScene:
    return synthetic.gripper_scene(0, **jaws(u))


EMBRYO = {
    "modulus": MPa,
    "force": uN,
    "poisson_ratio": NUMBER,
    **dict.fromkeys(("rim_radius", "thickness", "probe_half_width", "radius"), um),
    **dict.fromkeys(("dimple_depth", "height"), um),
}
#: Grey levels in single precision, or with the scene's distances in pixels of 1e-12 behind them.
SINGLE = {"within": 1e-5}
#: Pictures have grey levels up to 255.
EIGHT_BITS = {"laws": (scales_with_units, follows_origins, second_call_gives_the_same)}
#: One grey level of 255, where the last digit of a scene decides what it is rounded to.
ROUNDED = {"within": 1 / 250}

LAWS = {
    "synthetic.Embryo": Row(lambda u: vars(embryo(u)), EMBRYO),
    "synthetic.Embryo.pressed": Row(lambda u: {"force": 160.0 * u.uN, **pressed(u)}, EMBRYO),
    "synthetic.Embryo.dented": Row(lambda u: {"depth": 90.0 * u.um, **pressed(u)}, EMBRYO),
    "synthetic.Embryo.outline": Row(lambda u: {"self": embryo(u), "spacing": 7.0 * u.um}, um,
        within=1e-7),
    "synthetic.EmbryoImage.to_pixels": Row(lambda u: {"self": tilted(u),
        "points": np.array([[120.0, -40.0], [-300.0, 15.0]]) * u.um}, NUMBER),
    "synthetic.GripperScene.box": Row(lambda u: {"self": gripper(u), "size": 20,
        "shift": (2.2, -1.4)}, NUMBER),
    "synthetic.GripperScene.frame": Row(lambda u: {"self": gripper(u), "shift": (2.2, -1.4),
        "rng": 4, "noise": 1.5, "gain": 0.9}, NUMBER, **ROUNDED),
    "synthetic.ImagingConditions": Row(lambda u: vars(imaging(u)),
        {**dict.fromkeys(("blur", "vignetting", "gradient"), NUMBER),
        **dict.fromkeys(("dark", "bright", "noise"), grey)}, **EIGHT_BITS),
    "synthetic.cone": Row(lambda u: {"shape": SHAPE, "height": 9.0 * u.um, "radius": 8.0}, um),
    "synthetic.embryo_image": Row(lambda u: {"embryo": embryo(u), "rng": 2, **place(u)},
        {**dict.fromkeys(("image", "center", "tilt"), NUMBER), "embryo": EMBRYO, "pixel_size": um},
        **ROUNDED),
    "synthetic.focal_stack": Row(lambda u: {"texture": TEXTURE, "height": u.z0 + RELIEF * u.um,
        "positions": u.z0 + FOCI * u.um, "blur_rate": 0.2 / u.um, "noise": 1.0, "rng": 1}, NUMBER,
        **ROUNDED),
    "synthetic.gripper_scene": Row(lambda u: {"rng": 0, **jaws(u)},
        dict.fromkeys(("shape", "home", "opening", "drawing", "cover", "ground"), NUMBER),
        **SINGLE),
    "synthetic.mixed_texture": Row(lambda u: {"shape": SHAPE, "rng": 0, "mean": u.grey0,
        "std": 30.0 * u.grey, "scales": (0.8, 3.0)}, grey.counted_from("grey0"), **SINGLE),
    "synthetic.parabolic_cylinder": Row(lambda u: {"shape": SHAPE, "height": 9.0 * u.um,
        "width": 25.0}, um),
    "synthetic.paraboloid": Row(lambda u: {"shape": SHAPE, "height": 9.0 * u.um}, um),
    "synthetic.render_circles": Row(lambda u: {**pattern(u), "radius": 60.0 * u.um,
        "pitch": 200.0 * u.um}, grey, **SINGLE, **EIGHT_BITS),
    "synthetic.render_squares": Row(lambda u: {**pattern(u), "side": 110.0 * u.um}, grey,
        **SINGLE, **EIGHT_BITS),
    "synthetic.sphere_on_plane": Row(lambda u: {"shape": SHAPE, "radius": 30.0 * u.um,
        # a root near zero at the edge of the ball
        "pixel_size": 4.0 * u.um}, um, within=1e-6),
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


def test_transposed_shape_gives_transposed_surface():
    """Transposed, the shape is; and what runs along x runs along y."""
    for draw in (synthetic.paraboloid, lambda shape, h: synthetic.cone(shape, h, 9.0)):
        np.testing.assert_allclose(draw(SHAPE[::-1], 9.0), draw(SHAPE, 9.0).T)
    ball, other = (synthetic.sphere_on_plane(s, 30.0, 4.0) for s in (SHAPE, SHAPE[::-1]))
    np.testing.assert_allclose(other, ball.T)


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_focal_stack_follows_flips_and_rotations(view):
    given = {"positions": FOCI, "blur_rate": 0.2}
    one = synthetic.focal_stack(TEXTURE, RELIEF, **given)
    other = synthetic.focal_stack(view.image(TEXTURE), view.image(RELIEF), **given)
    wanted = np.array([view.image(frame) for frame in one], float)
    np.testing.assert_allclose(other, wanted, atol=1)  # one level, where a half is rounded


@pytest.mark.parametrize("draw", [synthetic.render_circles, synthetic.render_squares])
def test_rendered_pattern_follows_transposed_camera(draw):
    """Light, counts, cells and place swapped between the axes make the picture transposed."""
    light = replace(imaging(Units()), noise=0.0)
    one = draw(scope(Units()), counts=(3, 2), imaging=light)
    swapped = {"tx": -190.0, "ty": -310.0, "principal_offset": (-1.5, 2.0)}
    turned = scope(Units(), **swapped, pixel_pitch=(8.3, 9.9), image_size=(80, 110))
    other = draw(turned, counts=(2, 3), imaging=replace(light, gradient=light.gradient[::-1]))
    np.testing.assert_allclose(other, one.T, atol=2e-3)  # rows and columns in single precision


def test_light_and_counts_follow_their_axes():
    """Beside the pattern the ground is the light; the pattern has its rows and columns."""
    light = {"bright": 150.0, "dark": 40.0, "blur": 0.0}
    uneven = synthetic.ImagingConditions(vignetting=0.2, gradient=(0.15, -0.1), **light)
    far = synthetic.render_squares(scope(Units(), tx=9e4), counts=(1, 1), imaging=uneven)
    top_left, top_right, bottom_left = far[0, 0], far[0, -1], far[-1, 0]
    assert top_left == pytest.approx(150.0 * 0.8 * (1 - 0.075 + 0.05), rel=1e-5)
    assert top_right == pytest.approx(150.0 * 0.8 * (1 + 0.075 + 0.05), rel=1e-5)
    assert bottom_left == pytest.approx(150.0 * 0.8 * (1 - 0.075 - 0.05), rel=1e-5)
    even = synthetic.ImagingConditions(**light)
    dark = synthetic.render_squares(scope(Units()), side=110.0, counts=(3, 2), imaging=even) < 95
    size = np.ptp(np.argwhere(dark), axis=0)[::-1] + 1  # of 5 and 3 sides, to a pixel
    np.testing.assert_allclose(size, [5 * 110 * 1.588 / 9.9, 3 * 110 * 1.588 / 8.3], atol=1.1)


@pytest.mark.parametrize("draw", [synthetic.render_circles, synthetic.render_squares])
def test_blur_of_rendered_pattern_is_gaussian(draw):
    sharp, soft = (
        draw(scope(Units()), imaging=synthetic.ImagingConditions(blur=b)) for b in (0.7, 2.0)
    )
    again = gaussian_filter(sharp, np.sqrt(2.0**2 - 0.7**2))
    assert np.abs(again - soft)[12:-12, 12:-12].max() < 1.0
    assert np.ptp(sharp) > 100


def test_gripper_frame_scales_with_gain():
    scene = synthetic.gripper_scene(1, pixel_size=6.23)
    first, second = (scene.frame((1.3, -2.1), 2, noise=0.0, gain=gain) for gain in (1.0, 1.2))
    dim = (first > 20) & (first < 200)  # not clipped
    assert (second[dim] / first[dim]).mean() == pytest.approx(1.2, abs=0.01)
