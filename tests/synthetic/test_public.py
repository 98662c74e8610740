"""The calls of every public function of synthetic: scenes obey the units and turns they draw."""

from dataclasses import fields, replace

import numpy as np
import pytest

from microlib import synthetic
from microlib.microscope import Microscope
from microlib.synthetic import Embryo, EmbryoImage, GripperScene, ImagingConditions
from tests.checks import (
    BROKEN,
    NEGATIVE,
    NO_NUMBER,
    NOT_POSITIVE,
    each_view,
    hold_call,
    hold_refused,
    hold_scaled,
    no_array,
    not_finite,
)

SHAPE = (21, 34)
TEXTURE = synthetic.mixed_texture((26, 33), 5)
RELIEF = np.linspace(-4.0, 9.0, 26)[:, None] + 2.0 * np.sin(np.arange(33) / 5.0)
FOCI = np.array([7.0, 1.5, -2.0, 11.0])


def membrane(um: float = 1.0, uN: float = 1.0) -> dict:
    return {
        "modulus": 1.3 * uN / um**2,
        "thickness": 4.0 * um,
        "probe_half_width": 30.0 * um,
        "poisson_ratio": 0.4,
        "radius": 560.0 * um,
    }


def pressed(um: float = 1.0, uN: float = 1.0) -> dict:
    return {"force": 160.0 * uN, "rim_curvature_radius": 420.0 * um, **membrane(um, uN)}


def dented(um: float = 1.0, uN: float = 1.0) -> dict:
    return {"depth": 90.0 * um, "rim_curvature_radius": 420.0 * um, **membrane(um, uN)}


def egg(um: float = 1.0, uN: float = 1.0) -> Embryo:
    return Embryo(force=160.0 * uN, rim_radius=230.0 * um, **membrane(um, uN))


def scope(um: float = 1.0, **changes: object) -> Microscope:
    """Return a microscope that looks straight down on a pattern, with oblong pixels."""
    lengths = {"tube_length": 200e3, "focal_length": 126e3, "distance": 79e3}
    lengths |= {"tx": -310.0, "ty": -190.0}
    given = {name: length * um for name, length in lengths.items()}
    given |= {"distortion": -8.4e-10 / um**2, "distortion_k2": 3e-17 / um**4}
    given |= {"pixel_pitch": (9.9 * um, 8.3 * um), "principal_offset": (2.0, -1.5)}
    return Microscope(**given | {"image_size": (110, 80)} | changes)


def imaging(grey: float = 1.0) -> ImagingConditions:
    levels = {"dark": 40.0 * grey, "bright": 150.0 * grey, "noise": 1.5 * grey}
    return ImagingConditions(blur=0.8, vignetting=0.2, gradient=(0.15, -0.1), **levels)


def pattern(um: float = 1.0, grey: float = 1.0) -> dict:
    return {"microscope": scope(um), "counts": (3, 2), "imaging": imaging(grey), "rng": 3}


def circles(um: float = 1.0, grey: float = 1.0) -> dict:
    return {**pattern(um, grey), "radius": 60.0 * um, "pitch": 200.0 * um}


def squares(um: float = 1.0, grey: float = 1.0) -> dict:
    return {**pattern(um, grey), "side": 110.0 * um}


def place(um: float = 1.0) -> dict:
    return {"pixel_size": 9.0 * um, "shape": (150, 170), "center": (85.3, 12.2), "tilt": 0.1}


def tilted(um: float = 1.0, uN: float = 1.0) -> EmbryoImage:
    return synthetic.embryo_image(egg(um, uN), rng=2, **place(um))


def jaws(um: float = 1.0) -> dict:
    sizes = {"pixel_size": 6.1 * um, "gap": 90.0 * um}
    return {"rng": 0, "shape": (60, 80), "reach": 5, **sizes}


def gripper(um: float = 1.0) -> GripperScene:
    return synthetic.gripper_scene(**jaws(um))


def focused(um: float = 1.0, z0: float = 42.0) -> dict:
    height, positions = (z0 + RELIEF) * um, (z0 + FOCI) * um
    more = {"blur_rate": 0.2 / um, "noise": 1.0, "rng": 1}
    return {"texture": TEXTURE.copy(), "height": height, "positions": positions, **more}


#: A valid call of each function.
CALLS = {
    Embryo: lambda: {field.name: getattr(egg(), field.name) for field in fields(Embryo)},
    Embryo.pressed: pressed, Embryo.dented: dented,
    Embryo.outline: lambda: {"self": egg(), "spacing": 7.0},
    EmbryoImage.to_pixels: lambda: {
        "self": tilted(), "points": np.array([[120.0, -40.0], [-300.0, 15.0]]),
    },
    GripperScene.box: lambda: {"self": gripper(), "size": 20, "shift": (2.2, -1.4)},
    GripperScene.frame: lambda: {
        **{"self": gripper(), "shift": (2.2, -1.4), "rng": 4, "noise": 1.5},
    },
    ImagingConditions: lambda: dict(vars(imaging())),
    synthetic.cone: lambda: {"shape": SHAPE, "height": 9.0, "radius": 8.0},
    synthetic.embryo_image: lambda: {
        **{"embryo": egg(), "rng": 2, "blur": 1.2, "noise": 2.0, "unevenness": 0.1, **place()},
    },
    synthetic.focal_stack: focused, synthetic.gripper_scene: jaws,
    synthetic.mixed_texture: lambda: {
        **{"shape": SHAPE, "rng": 0, "mean": 20.0, "std": 30.0, "scales": (0.8, 3.0)},
    },
    synthetic.parabolic_cylinder: lambda: {"shape": SHAPE, "height": 9.0, "width": 25.0},
    synthetic.paraboloid: lambda: {"shape": SHAPE, "height": 9.0},
    synthetic.render_circles: circles, synthetic.render_squares: squares,
    synthetic.sphere_on_plane: lambda: {"shape": SHAPE, "radius": 30.0, "pixel_size": 4.0},
}  # fmt: skip
each_call = pytest.mark.parametrize("function", CALLS, ids=lambda f: f.__qualname__)
LENGTHS = ("modulus", "thickness", "probe_half_width", "radius")
EGG = dict.fromkeys(LENGTHS, NOT_POSITIVE) | {"force": NEGATIVE, "poisson_ratio": [*NEGATIVE, 0.6]}
PIXEL = [*BROKEN, 0, -1]


def no_shape(valid):
    return [*no_array(valid), (0, 5), (5, -5)]


#: What is refused in place of each argument.
REFUSED = {
    Embryo: {**EGG, "rim_radius": [*NOT_POSITIVE, 20.0]},
    Embryo.pressed: {**EGG, "force": [*NOT_POSITIVE, 1e-9]},
    Embryo.dented: {
        **{name: wrong for name, wrong in EGG.items() if name != "force"},
        "depth": [*NOT_POSITIVE, 3e3],
    },
    GripperScene.frame: {
        "shift": lambda valid: [*no_array(valid), (90, 0)], "noise": NEGATIVE, "rng": NEGATIVE,
    },
    ImagingConditions: {
        "dark": [*NEGATIVE, 255.5], "bright": [*NEGATIVE, 255.5], "blur": NEGATIVE,
        "noise": NEGATIVE, "vignetting": [*NEGATIVE, 1.1],
    },
    synthetic.cone: {"shape": no_shape},
    synthetic.embryo_image: {
        "shape": lambda valid: [*no_shape(valid), (10, 10)], "pixel_size": PIXEL,
        "tilt": [*NO_NUMBER, 4.0], "blur": [*NEGATIVE, 0.2], "unevenness": [*NEGATIVE, 0.6],
        **dict.fromkeys(("noise", "rng"), NEGATIVE),
    },
    synthetic.focal_stack: {
        "height": lambda valid: [*no_array(valid), np.eye(5)], "blur_rate": [*NOT_POSITIVE, 1e3],
        **dict.fromkeys(("noise", "rng"), NEGATIVE),
    },
    synthetic.gripper_scene: {
        "shape": no_shape, "rng": NEGATIVE, "pixel_size": PIXEL, "gap": [*NOT_POSITIVE, 130.0],
    },
    synthetic.mixed_texture: {
        "shape": no_shape, "scales": lambda valid: [*not_finite(valid), 0.0, (1.0, -1.0)],
        "mean": NO_NUMBER, "std": NEGATIVE, "rng": NEGATIVE,
    },
    synthetic.parabolic_cylinder: {"shape": lambda valid: [*no_shape(valid), (1, 9)]},
    synthetic.paraboloid: {"shape": no_shape},
    synthetic.render_circles: {"counts": no_shape, "rng": NEGATIVE},
    synthetic.render_squares: {"counts": no_shape, "rng": NEGATIVE},
    synthetic.sphere_on_plane: {"shape": no_shape, "pixel_size": PIXEL},
}  # fmt: skip


@each_call
def test_call_gives_the_same_for_the_same_numbers(function):
    hold_call(function, CALLS[function], neighbors=False)  # what is drawn concludes nothing


@each_call
def test_wrong_arguments_are_refused_by_name(function):
    hold_refused(function, CALLS[function](), REFUSED.get(function, {}))


def test_noise_without_a_source_of_numbers_is_refused():
    stack = {"texture": TEXTURE, "height": RELIEF, "positions": FOCI, "blur_rate": 0.2}
    scope = Microscope(4e4, 1e4, 2500.0, pixel_pitch=10.0, image_size=(40, 30))
    board = {"microscope": scope, "imaging": ImagingConditions(noise=2.0)}
    for draw, given in (
        (synthetic.focal_stack, stack | {"noise": 2.0}),
        (synthetic.render_circles, board),
        (synthetic.render_squares, board),
    ):
        with pytest.raises(ValueError, match="rng must be given if there is noise, got None"):
            draw(**given)


#: One grey level of 255, where the last digit of a scene decides what it is rounded to.
LEVEL = 1 / 250


def test_embryos_follow_units_of_length_and_force():
    um, uN = 1.7, 0.45
    by = dict.fromkeys(("rim_radius", "dimple_depth", "height", *LENGTHS[1:]), um)
    by |= {"modulus": uN / um**2, "force": uN}
    hold_scaled(egg(um, uN), egg(), **by)
    for make, given in ((Embryo.pressed, pressed), (Embryo.dented, dented)):
        hold_scaled(make(**given(um, uN)), make(**given()), **by)
    hold_scaled(egg(um, uN).outline(7.0 * um), egg().outline(7.0), um, within=1e-7)
    found, points = tilted(um, uN), np.array([[120.0, -40.0], [-300.0, 15.0]])
    hold_scaled(found, tilted(), within=LEVEL, embryo=by, pixel_size=um)
    hold_scaled(found.to_pixels(um * points), tilted().to_pixels(points))


def test_surfaces_scenes_and_patterns_follow_unit_of_length():
    um = 1.7
    for function, name in (
        *((f, "height") for f in (synthetic.cone, synthetic.paraboloid)),
        (synthetic.parabolic_cylinder, "height"),
        (synthetic.sphere_on_plane, "radius"),
    ):
        given = CALLS[function]()
        lengths = {n: um * given[n] for n in (name, "pixel_size") if n in given}
        # The edge of a ball has a root near zero.
        hold_scaled(function(**given | lengths), function(**given), um, within=1e-6)
    hold_scaled(gripper(um), gripper(), within=1e-5)  # distances in px of 1e-12
    for draw, given in ((synthetic.render_circles, circles), (synthetic.render_squares, squares)):
        hold_scaled(draw(**given(um)), draw(**given()), within=1e-5)  # single precision
    stack = synthetic.focal_stack(**focused())
    for other in (focused(um), focused(z0=-88.0)):
        assert np.abs(synthetic.focal_stack(**other).astype(int) - stack).max() <= 1


def test_grey_levels_follow_their_unit():
    given, grey = CALLS[synthetic.mixed_texture](), 1 / 255
    levels = {"mean": grey * 27.0, "std": grey * 30.0}
    found = synthetic.mixed_texture(**given | levels)
    plain = synthetic.mixed_texture(**given)
    hold_scaled(found, plain, lambda shown: grey * (shown + 7.0), within=1e-5)
    for draw, given in ((synthetic.render_circles, circles), (synthetic.render_squares, squares)):
        hold_scaled(draw(**given(grey=grey)), draw(**given()), grey, within=1e-5)


@each_view
def test_focal_stack_follows_flips_and_rotations(view):
    given = {"positions": FOCI, "blur_rate": 0.2}
    one = synthetic.focal_stack(TEXTURE, RELIEF, **given)
    other = synthetic.focal_stack(view.image(TEXTURE), view.image(RELIEF), **given)
    wanted = np.array([view.image(frame) for frame in one], float)
    np.testing.assert_allclose(other, wanted, atol=1)  # one level, where a half is rounded


@pytest.mark.parametrize("draw", [synthetic.render_circles, synthetic.render_squares])
def test_rendered_pattern_follows_transposed_camera(draw):
    """Light, counts, cells and place swapped between the axes make the picture transposed."""
    light = replace(imaging(), noise=0.0)
    one = draw(scope(), counts=(3, 2), imaging=light)
    swapped = {"tx": -190.0, "ty": -310.0, "principal_offset": (-1.5, 2.0)}
    turned = scope(**swapped, pixel_pitch=(8.3, 9.9), image_size=(80, 110))
    other = draw(turned, counts=(2, 3), imaging=replace(light, gradient=light.gradient[::-1]))
    np.testing.assert_allclose(other, one.T, atol=2e-3)  # rows and columns in single precision


@pytest.mark.parametrize("draw", [synthetic.render_circles, synthetic.render_squares])
def test_edge_of_a_blurred_pattern_equals_the_same_points_in_a_larger_picture(draw):
    blurred = ImagingConditions(blur=3.0)
    larger = draw(scope(image_size=(170, 140)), imaging=blurred)[30:-30, 30:-30]
    np.testing.assert_allclose(draw(scope(), imaging=blurred), larger, atol=0.03)


def test_light_and_counts_of_a_rendered_pattern_follow_x_and_y():
    """Beside the pattern the ground is the light; the pattern has its rows and columns."""
    light = {"bright": 150.0, "dark": 40.0, "blur": 0.0}
    uneven = synthetic.ImagingConditions(vignetting=0.2, gradient=(0.15, -0.1), **light)
    far = synthetic.render_squares(scope(tx=9e4), counts=(1, 1), imaging=uneven)
    wanted = 150.0 * 0.8 * np.array([1 - 0.075 + 0.05, 1 + 0.075 + 0.05, 1 - 0.075 - 0.05])
    np.testing.assert_allclose([far[0, 0], far[0, -1], far[-1, 0]], wanted, rtol=1e-5)
    even = synthetic.ImagingConditions(**light)
    dark = synthetic.render_squares(scope(), side=110.0, counts=(3, 2), imaging=even) < 95
    size = np.ptp(np.argwhere(dark), axis=0)[::-1] + 1  # of 5 and 3 sides, to a pixel
    np.testing.assert_allclose(size, [5 * 110 * 1.588 / 9.9, 3 * 110 * 1.588 / 8.3], atol=1.1)
