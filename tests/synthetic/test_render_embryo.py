"""The rendered embryo: does its outline obey the model, and is it drawn where it should be?"""

import numpy as np
import pytest
from scipy.special import ndtr

from microlib.synthetic import Embryo, embryo_image

CLEAN = {"noise": 0.0, "unevenness": 0.0}


@pytest.mark.parametrize("force", [30.0, 250.0])
@pytest.mark.parametrize(("modulus", "c"), [(0.5, 35.0), (2.0, 15.0)])
def test_dimple_balances_force_and_stretch(force, modulus, c):
    """From the drawn points alone: strain (4.5) → stress (4.6) → depth (4.3)."""
    embryo = Embryo.pressed(force, modulus=modulus, rim_curvature_radius=430.0, probe_half_width=c)
    a, h, nu = embryo.rim_radius, embryo.thickness, embryo.poisson_ratio
    x, y = embryo.outline(0.1).T
    dimple = (x > c) & (x < a) & (y > -1.01 * embryo.dimple_depth)
    order = np.argsort(x[dimple])
    r, w = x[dimple][order], -y[dimple][order]
    strain = 0.5 * np.trapezoid(0.5 * np.gradient(w, r) ** 2 * r, r) / np.trapezoid(r, r)
    stress = modulus / (1 - nu) * strain
    depth = -force / (4 * np.pi * stress * h) * (1 - (c / a) ** 2 + np.log((c / a) ** 2))
    # Differences over steps of 0.1 µm where the slope changes by its own size within c: 1 %.
    assert depth == pytest.approx(embryo.dimple_depth, rel=0.01)


@pytest.mark.parametrize(
    ("force", "rim", "c"), [(25.0, 580.0, 25.0), (150.0, 420.0, 140.0), (290.0, 360.0, 25.0)]
)
def test_volume_is_kept_and_rim_has_its_radius(force, rim, c):
    embryo = Embryo.pressed(force, modulus=1.0, rim_curvature_radius=rim, probe_half_width=c)
    points = embryo.outline(0.5)
    x, y = points[points[:, 0] >= 0].T
    # Of revolution, by Green: V = π ∮ x² dy, clockwise. The flat bottom has no dy.
    volume = -np.pi * np.sum((x[1:] ** 2 + x[:-1] ** 2) / 2 * np.diff(y))
    assert volume == pytest.approx(4 / 3 * np.pi * embryo.radius**3, rel=1e-3)
    near = (np.abs(x - embryo.rim_radius) < 15) & (y > -5)
    bend = np.polyfit(x[near] - embryo.rim_radius, y[near], 3)[1]
    # A cubic over ±15 µm leaves quartic terms of (15/a)², below 2 %.
    assert -1 / (2 * bend) == pytest.approx(rim, rel=0.03)


def test_outline_is_round_at_rest_and_else_smooth_except_at_the_probe():
    rest = Embryo(1.0, 0.0, 1.0)  # nothing presses
    x, y = rest.outline().T
    np.testing.assert_allclose(np.hypot(np.diff(x), np.diff(y)), 0.25, rtol=1e-3)
    assert rest.height == pytest.approx(np.ptp(y), abs=1e-3)
    np.testing.assert_allclose(np.hypot(x, y + 600.0), 600.0, atol=1e-3)
    embryo = Embryo.pressed(150.0, modulus=1.0)
    points = embryo.outline(1.0)
    step = np.diff(np.concatenate([points, points[:1]]), axis=0)
    turn = np.abs(np.angle(np.exp(1j * np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))))
    corner = np.hypot(np.abs(points[1:, 0]) - 25.0, points[1:, 1] + embryo.dimple_depth) < 4
    # A circle of 80 µm turns by 0.0125 rad a µm; nothing on this outline is rounder.
    assert turn[~corner].max() < 0.02
    assert turn[corner].max() > 0.3


def test_embryo_made_from_its_dimple_depth_has_the_force_that_pressed_it():
    pressed = Embryo.pressed(120.0, modulus=0.8, rim_curvature_radius=450.0)
    dented = Embryo.dented(pressed.dimple_depth, modulus=0.8)
    assert dented.force == pytest.approx(120.0, rel=1e-9)
    assert dented.rim_radius == pytest.approx(pressed.rim_radius, rel=1e-9)


def test_edges_in_the_image_are_at_the_true_outline():
    embryo = Embryo.pressed(150.0, modulus=1.0)
    scene = embryo_image(embryo, rng=0, shape=(260, 600), center=(500.3, 240.7), **CLEAN)
    rim_x, rim_y = scene.to_pixels([[embryo.rim_radius, 0.0]])[0]
    column = scene.image[:, round(rim_x)].astype(float)
    near = np.arange(round(rim_y) - 3, round(rim_y) + 4)
    ground, fluid = column[near[0] - 5], column[near[-1] + 5]
    # Blur of 1 px and a sensor pixel of variance 1/12 px².
    step = ground + (fluid - ground) * ndtr((near - rim_y) / np.sqrt(13 / 12))
    dark = step - column[near]
    # Centroid of the dark line, 8-bit; a column half a px beside the rim lies 0.01 px lower.
    assert (dark * near).sum() / dark.sum() == pytest.approx(rim_y, abs=0.1)

    row = scene.image[100].astype(float)  # above the embryo
    half = (row[400] + row[500]) / 2
    bar = np.flatnonzero(row[480:520] < half) + 480
    left = bar[0] - (half - row[bar[0]]) / (row[bar[0] - 1] - row[bar[0]])
    right = bar[-1] + (half - row[bar[-1]]) / (row[bar[-1] + 1] - row[bar[-1]])
    # Straight edges between samples of a blurred edge, 8-bit: a few hundredths of a px.
    assert (left + right) / 2 == pytest.approx(500.3, abs=0.05)
    assert (right - left) * scene.pixel_size == pytest.approx(50.0, abs=0.5)


def test_probe_ends_on_the_chorion():
    embryo = Embryo.pressed(150.0, modulus=1.0)
    # Under the probe the chorion is flat: at 0.5 µm per pixel its 3 µm are 6 px of its own grey.
    rim = 60.0 - embryo.dimple_depth / 0.5
    place = {"center": (50.0, rim), "pixel_size": 0.5, "shape": (120, 100)}
    scene = embryo_image(embryo, rng=0, **place, **CLEAN)
    column = scene.image[:, 50].astype(float)
    assert column[:40] == pytest.approx(42.0, abs=1)
    wall = np.flatnonzero((column > 51) & (column < 100))
    # Cells that the edge crosses let some of the bright ground through, half a px further up.
    assert wall[0] == pytest.approx(60 - 3.5, abs=0.6)
    assert wall[-1] == pytest.approx(60 + 3, abs=1.0)


def test_embryo_is_centered_by_default_and_yolk_inside_the_chorion():
    embryo = Embryo.pressed(100.0, modulus=1.0)
    scene = embryo_image(embryo, rng=0, probe=False, pixel_size=5.0, shape=(300, 320), **CLEAN)
    # Half of the gap of 55 µm under the dimple and above the bottom, and two places between.
    top, bottom = -embryo.dimple_depth - 27.0, -embryo.height + 27.0
    heights = (top, bottom, (top + bottom) / 2, (2 * top + bottom) / 3)
    places = scene.to_pixels([[0.0, y] for y in (*heights, -embryo.height / 2)])
    np.testing.assert_allclose(places[-1], (159.5, 149.5), atol=1e-9)
    grey = [float(scene.image[round(y), round(x)]) for x, y in places[:-1]]
    assert grey[:2] == pytest.approx([168.0, 168.0], abs=3)  # fluid
    assert grey[2:] == pytest.approx([112.0, 112.0], abs=30)  # yolk with its grain of 8 levels


def test_illumination_gradient_has_any_direction():
    options = {"pixel_size": 20.0, "shape": (80, 90), "unevenness": 0.3}
    images = [embryo_image(Embryo(1.0, 0.0, 1.0), rng=seed, **options).image for seed in range(8)]
    parts = [(image[:5, :5], image[:5, -5:], image[-5:, :5]) for image in images]
    corner, *others = np.mean(parts, axis=(2, 3)).T  # top left, top right, bottom left
    slopes = corner - np.array(others)
    # One sign in eight of eight draws has a chance of 1 in 128, for either axis.
    assert (np.ptp(np.sign(slopes), axis=1) == 2).all()
    assert np.abs(slopes).max() > 10


def test_unevenness_is_the_largest_relative_change_of_brightness():
    options = {"pixel_size": 20.0, "shape": (80, 90), "noise": 0.0}
    uneven, even = (
        embryo_image(Embryo(1.0, 0.0, 1.0), rng=3, unevenness=share, **options).image.astype(float)
        for share in (0.2, 0.0)
    )
    # Levels of about 170 are rounded to whole numbers.
    assert np.abs(uneven / even - 1).max() == pytest.approx(0.2, abs=0.01)


def test_tilt_rotates_the_scene_clockwise():  # a negative one the other way
    scene = embryo_image(Embryo(1.0, 0.0, 1.0), rng=0, shape=(64, 80), tilt=-0.1)
    turned = scene.to_pixels([[100.0, 0.0], [0.0, 100.0], [0.0, 0.0]]) - scene.center
    wanted = [[np.cos(0.1), -np.sin(0.1)], [-np.sin(0.1), -np.cos(0.1)], [0, 0]]
    np.testing.assert_allclose(turned, np.multiply(wanted, 100.0 * 1.2 / 4.65), atol=1e-9)
