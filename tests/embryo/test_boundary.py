"""The outline in an image against the outline that was drawn, and every image that shows none."""

from __future__ import annotations

import re
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from benchmarks.capsule_embryo import draw_scene
from benchmarks.photographs import pictures, texture
from microlib.embryo import extract_boundary
from microlib.embryo._probe import find_probe
from microlib.embryo._view import View
from microlib.synthetic import Embryo, embryo_image

PRESSED = Embryo.pressed(150.0, modulus=1.2)


@cache
def render(embryo: Embryo = PRESSED, **camera: object):
    place = {"shape": (320, 480), "center": (240.37, 101.81), "tilt": 0.01, "unevenness": 0.2}
    return embryo_image(embryo, rng=0, **place | camera)


@pytest.fixture(scope="module")
def scene():
    return render()


@pytest.fixture(scope="module")
def boundary(scene):
    return extract_boundary(scene.image)


def distances(scene, points: np.ndarray) -> np.ndarray:
    """How far points lie outside the drawn outline, in px."""
    outline = scene.to_pixels(scene.embryo.outline(0.05))
    along = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    _, nearest = cKDTree(outline).query(points)
    return np.einsum("ij,ij->i", points - outline[nearest], outward[nearest])


def test_probe_half_width_is_perpendicular_to_its_axis():
    """A bar of exact edges at 3.9°: along a row it is 0.23 % wider."""
    slope, half_width, tip = np.tan(np.deg2rad(3.9)), 60.0, 300.0
    y, x = np.mgrid[:480, :1400].astype(float)
    across = (x - 330.0 - slope * y) / np.hypot(1.0, slope)
    bar = np.clip(half_width + 0.5 - np.abs(across), 0, 1) * (y < tip)
    image = np.where(y > 300, 120.0, 200.0)
    image += bar * (40.0 - image)
    grey = np.rint(image).astype(np.float32)
    probe = find_probe(grey, View((1400, 480), "top"))[1]
    assert probe.slope == pytest.approx(slope, abs=1e-3)
    # Edges are found to some hundredths of a px, and 0.23 % are 0.14 px.
    assert probe.half_width == pytest.approx(half_width, abs=0.07)


def test_outline_and_std_match_rendered_outline(scene, boundary):
    seen = boundary.points[~boundary.under_probe]
    off = distances(scene, seen)
    # The dark wall darkens the brighter ground more than the fluid, which moves its apparent middle
    # outwards by about 0.02 px; noise of 2/255 moves a point by 0.065 px.
    assert abs(off.mean()) < 0.04
    assert off.std() < 0.09
    assert np.abs(off).max() < 0.4
    assert boundary.std[~boundary.under_probe].mean() == pytest.approx(off.std(), rel=0.3)
    assert (np.diff(boundary.x) >= 0).all()
    # It reaches from near the probe to well beyond both rims.
    radius = scene.embryo.dimple_radius / scene.pixel_size
    for side in (-1, 1):
        distance = side * (seen[:, 0] - scene.center[0])
        assert distance[distance > 0].min() < 15
        assert distance.max() > 1.5 * radius
    # A sensor's square cell adds 1/12 px² to the blur, the wall's own thickness as much of its own.
    wall = (scene.embryo.thickness / scene.pixel_size) ** 2 / 12
    assert boundary.blur == pytest.approx(np.sqrt(1 + 1 / 12 + wall), abs=0.06)


def test_without_probe_matches_image_rendered_without_probe(scene, boundary):
    clean = render(probe=False, noise=0.0)
    noisy = scene.image[:75].astype(float)
    filled = boundary.without_probe(scene.image)[:75]
    off = filled - clean.image[:75]
    bar = np.abs(noisy - filled) > 20
    assert bar.sum() > 75 * 11
    # The ground is a straight line between noisy neighbors; light bends by less than a grey level.
    assert np.abs(off[bar]).max() < 3


def test_outline_does_not_depend_on_black_level(scene, boundary):
    other = extract_boundary(scene.image * 0.5 + 10.0)
    np.testing.assert_array_equal(other.under_probe, boundary.under_probe)
    # float32 keeps seven digits of a grey level, which are 1e-6 px of an edge; a wall's place is
    # polished to about 1e-3 px.
    np.testing.assert_allclose(other.points, boundary.points, atol=5e-3)


def with_probe(taper: float, glass: bool) -> tuple:
    """A probe drawn by hand, of four samples a px and side: tapering, or two walls of glass."""
    bare = render(probe=False, noise=0.0, tilt=0.0, unevenness=0.0)
    image = cv2.resize(bare.image.astype(np.float32), None, fx=4, fy=4)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] / 4 - 0.375
    embryo = bare.embryo
    tip = bare.to_pixels(np.array([[0.0, embryo.thickness / 2 - embryo.dimple_depth]]))[0]
    above, beside = tip[1] - y, np.abs(x - tip[0])
    half = embryo.probe_half_width / bare.pixel_size + taper * above
    bar = (beside < half) & (above > 0)
    wall = bar & ((beside > half - 2.2) | (above < 1.5)) if glass else bar
    image[bar] = 205
    image[wall] = 60
    size = bare.image.shape[::-1]
    small = cv2.resize(cv2.GaussianBlur(image, (0, 0), 2.5), size, interpolation=3)
    noise = np.random.default_rng(0).normal(0, 2, small.shape)
    return bare, (small + noise).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("glass", [False, True], ids=["metal", "glass"])
@pytest.mark.parametrize("taper", [0.0, 0.1])
def test_tapered_and_glass_probes_are_found(taper, glass):
    truth, image = with_probe(taper, glass)
    found = extract_boundary(image)
    tip = truth.to_pixels(np.array([[0.0, 1.5 - truth.embryo.dimple_depth]]))[0]
    assert found.probe.tip[0] == pytest.approx(tip[0], abs=0.1)
    # The end of glass is a wall as dark as the chorion below it: both are filled, 2 px more.
    assert found.probe.tip[1] == pytest.approx(tip[1], abs=2.5 if glass else 0.7)
    assert found.probe.taper == pytest.approx(-taper, abs=0.002)
    # Thin walls lose half of their blur to the outside.
    half = truth.embryo.probe_half_width / truth.pixel_size
    assert found.probe.half_width == pytest.approx(half, abs=1.0 if glass else 0.15)
    off = distances(truth, found.points[~found.under_probe])
    # As with the renderer's own probe, but for 0.6 px more of blur, which flattens the wall.
    assert abs(off.mean()) < 0.04
    # Of 300 points one is off by four deviations where each is biased by a half.
    assert np.abs(off / found.std[~found.under_probe]).max() < 6


@pytest.mark.parametrize(("edge", "turns"), [("left", 1), ("bottom", 2), ("right", 3)])
def test_outline_follows_rotation_of_image(scene, boundary, edge, turns):
    turned = np.rot90(scene.image, turns)
    for direction in (edge, "auto"):
        found = extract_boundary(turned, direction=direction)
        assert found.view.direction == edge
        # Where each pixel of the turned image was before, read at the points found in it.
        places = np.indices(scene.image.shape)[::-1].astype(float)
        before = [np.rot90(axis, turns) for axis in places]
        points = np.stack(
            [map_coordinates(axis, found.points.T[::-1], order=1) for axis in before], axis=1
        )
        np.testing.assert_allclose(points, boundary.points, atol=1e-6)
    np.testing.assert_array_equal(found.without_probe(turned), boundary.without_probe(scene.image))
    with pytest.raises(ValueError, match="from the top"):
        extract_boundary(turned, direction="top")


@pytest.mark.parametrize("degrees", [-50.0, 25.0])
def test_outline_is_right_under_leaning_probe(degrees):
    """Of an image of the same size, turned about the middle of the dimple's side."""
    turned = {"tilt": np.deg2rad(degrees), "shape": (400, 520), "center": (260.0, 175.0)}
    leaning = render(**turned)
    found = extract_boundary(leaning.image, direction="top")
    assert np.rad2deg(found.view.tilt) == pytest.approx(-degrees, abs=2.0)
    assert abs(found.probe.slope) < np.tan(np.deg2rad(2.0))
    off = distances(leaning, found.points[~found.under_probe])
    # As upright, and what interpolation between turned pixels adds.
    assert abs(off.mean()) < 0.05
    assert off.std() < 0.12
    assert np.abs(off).max() < 0.6
    assert (found.points >= -0.5).all()
    # Filled, the probe is gone where it stood.
    filled, before = (
        found.without_probe(leaning.image),
        found.view.rotate(np.float32(leaning.image)),
    )
    changed = np.abs(filled - before) > 30
    assert changed.sum() > 100 * 11
    plain = found.view.rotate(np.float32(render(**turned, probe=False, noise=0.0).image))
    assert np.abs(filled - plain)[changed][:500].mean() < 6


@pytest.mark.parametrize("probe", ["needle", "glass", "angled"])
def test_probe_and_outline_match_independent_renderer(probe):
    """From any side, in a file of colors, at a quarter of the resolution (seed 2002)."""
    drawn = draw_scene(np.random.default_rng(2002), probe)
    assert drawn.shrink == 4
    found = extract_boundary(drawn.image)
    seen = found.y[~found.under_probe]
    depth = seen.max() - (found.image_height - 1 - found.probe.tip[1])
    # The end of glass is a wall as dark as the chorion: 2 px, as above.
    assert depth == pytest.approx(drawn.depth / drawn.pixel_size, abs=2.0)
    assert np.ptp(found.x) / 2 == pytest.approx(drawn.radius / drawn.pixel_size, rel=0.05)
    half = drawn.probe_half_width / drawn.pixel_size
    assert found.probe.half_width == pytest.approx(half, abs=1.0)


def test_outline_of_enlarged_image_matches_original(scene, boundary):
    broad = cv2.resize(scene.image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    found = extract_boundary(broad)
    assert found.blur == pytest.approx(2 * boundary.blur, rel=0.1)
    x = np.arange(140.0, 340.0)
    x = x[np.abs(x - 240.0) > 16]
    # Pixel k of the image is the middle of 2k and 2k + 1; each outline has its own noise.
    y = (found.points[:, 1] - 0.5) / 2
    off = np.interp(x, (found.points[:, 0] - 0.5) / 2, y) - np.interp(x, *boundary.points.T)
    assert abs(off.mean()) < 0.03
    assert np.abs(off).max() < 0.4


@pytest.mark.parametrize(("edge", "turns"), [("left", 1), ("bottom", 2)])
def test_outline_and_std_are_right_on_blurred_image(edge: str, turns: int) -> None:
    """At the largest blur that needs no reduction of the image."""
    place = {"shape": (641, 963), "center": (480.7, 203.6), "pixel_size": 1.94, "blur": 2.7}
    soft = render(**place)
    found = extract_boundary(np.rot90(soft.image, turns), direction=edge)
    assert found.blur == pytest.approx(2.7, abs=0.2)
    # Where each pixel was before the image was turned, read at the points found.
    before = [np.rot90(axis, turns) for axis in np.indices(soft.image.shape)[::-1].astype(float)]
    seen = found.points[~found.under_probe].T[::-1]
    x, y = (map_coordinates(axis, seen, order=1) for axis in before)
    off = distances(soft, np.stack([x, y], axis=1))
    assert abs(off.mean()) < 0.15  # as unblurred, in pixels of twice the size
    assert np.abs(off).max() < 1.5
    assert found.std[~found.under_probe].mean() == pytest.approx(off.std(), rel=0.3)
    tip = found.view.to_image(np.array([found.probe.tip]))[0]
    under = found.points[found.under_probe]
    np.testing.assert_allclose(under[len(under) // 2], tip, atol=1.0)
    # The ground beside a blurred edge is not yet its own: half a pixel.
    assert found.probe.half_width * soft.pixel_size == pytest.approx(25.0, abs=1.94)
    filled = found.without_probe(np.rot90(soft.image, turns))
    assert filled[: int(found.probe.tip[1]) - 9, int(found.probe.tip[0])].min() > 150


def test_color_image_has_outline_of_its_luminance(scene) -> None:
    tint = np.array([0.9, 1.0, 0.8])
    color = np.rint(scene.image[..., np.newaxis] * tint).astype(np.uint8)
    grey = cv2.cvtColor(color.astype(np.float32), cv2.COLOR_RGB2GRAY)
    found, wanted = extract_boundary(color), extract_boundary(grey)
    np.testing.assert_allclose(found.points, wanted.points, atol=1e-6)
    np.testing.assert_allclose(found.without_probe(color), wanted.without_probe(grey), rtol=1e-5)
    alpha = np.dstack([color, np.full(color.shape[:2], 255, np.uint8)])
    np.testing.assert_allclose(extract_boundary(alpha).points, wanted.points, atol=1e-6)


def test_boundary_is_rejected_in_pictures_without_an_embryo():
    """No outline and no other error: 24 pictures and a texture."""
    images = [*(image for _, image in pictures()), texture(np.random.default_rng(2))]
    for image in images:
        with pytest.raises(ValueError, match="image must") as refusal:
            extract_boundary(image)
        # What is wrong from some edges names each of them once.
        if edges := re.findall(r"\(from the ([\w, ]+)\)", str(refusal.value)):
            assert sorted(", ".join(edges).split(", ")) == ["bottom", "left", "right", "top"]


def test_bar_with_bright_middle_raises():
    """Its middle is no darker than half-way to the ground, so that no row has an edge."""
    image = np.full((200, 400), 200.0)
    image[:120, 141:161] = 40.0
    image[8:118, 148:154] = 200.0
    with pytest.raises(
        ValueError, match=r"probe's edges against a brighter ground, got them in [0-7] of"
    ):
        extract_boundary(image, direction="top")


def barred(image: np.ndarray, end: int, left: int) -> np.ndarray:
    """An image with one more dark bar, from its upper edge to a row."""
    image = image.copy()
    image[:end, left : left + 13] = 42
    return image


def ground() -> np.ndarray:
    return np.random.default_rng(1).normal(190.0, 2.0, (320, 480)).clip(0, 255).astype(np.uint8)


def image() -> np.ndarray:
    return render().image


def bare() -> np.ndarray:
    return render(probe=False).image


def shallow() -> np.ndarray:
    return render(Embryo.dented(30.0, modulus=1.0), probe=False).image


NO_PROBE = "one dark probe that enters through its upper edge, got 0 bars"
ONE_SIDE = "image must show an embryo's outline on both sides of the probe"
FLAT = "image must show a dimple at least 3 px deep"
#: Images that do not show what is needed, and what is said of them.
SPOILED = {
    "no embryo": (lambda: barred(ground(), 130, 234), ONE_SIDE),
    "probe beside": (lambda: barred(bare(), 200, 30), ONE_SIDE),
    "half of it": (lambda: image()[:, 222:], ONE_SIDE),
    "probe above": (lambda: barred(bare(), 60, 234), FLAT),
    "untouched": (lambda: render(embryo=Embryo(1.0, 0.0, 1.0)).image, FLAT),
    "probe inside": (
        lambda: barred(shallow(), 170, 234),
        "to which the outline falls",
    ),
    "nothing": (ground, NO_PROBE),
    "no probe": (bare, NO_PROBE),
    "noise": (lambda: np.random.default_rng(0).integers(0, 250, (320, 480), np.uint8), NO_PROBE),
    "flat": (lambda: np.full((320, 480), 120, np.uint8), NO_PROBE),
    "two probes": (lambda: barred(image(), 60, 80), "one dark probe .* got 2 bars"),
    "saturated": (lambda: (image() * 1.4).clip(0, 255).astype(np.uint8), "not be saturated"),
    "saturated at 12 bits": (
        lambda: (image() * 16 * 1.4).clip(0, 4095).astype(np.uint16),
        "not be saturated",
    ),
    "tiny": (lambda: image()[:40, :40], "image must be at least 64 px on each side"),
    "stack": (lambda: np.stack([image()] * 5), "image must be a grey image"),
}


@pytest.mark.parametrize(("spoiled", "message"), SPOILED.values(), ids=SPOILED)
def test_images_without_dimple_raise(spoiled, message):
    with pytest.raises(ValueError, match=message):
        extract_boundary(spoiled())


def corner_bar(slope: float, height: float, length: float, half: float) -> np.ndarray:
    """A bar whose axis, of a slope in x/y, passes the image's left side at `height`."""
    y, x = np.mgrid[:240, :320].astype(float)
    wide = np.hypot(1.0, slope)
    across = (x - slope * (y - height)) / wide
    along = (slope * x + y - height) / wide
    return 190.0 - 150.0 * ((np.abs(across) <= half) & (along < length))


@pytest.mark.parametrize(("height", "half"), [(-8.0, 6.0), (0.0, 6.0), (8.0, 6.0), (2.0, 10.0)])
def test_bar_through_corner_is_found_and_rotated(height, half):
    image = corner_bar(0.7, height, 150.0, half).astype(np.float32)
    whole = image.shape[::-1]
    _, probe, view = find_probe(image, View(whole, "top"))
    assert view.tilt == pytest.approx(np.arctan(0.7), abs=0.02)
    assert abs(probe.slope) < 0.01
    # Its end as drawn, in the image; pixels are 1 px wide along it.
    tip = view.to_image(np.array([probe.tip]))[0]
    end = np.array([0.0, height]) + 150.0 * np.array([0.7, 1.0]) / np.hypot(1.0, 0.7)
    np.testing.assert_allclose(tip, end, atol=1.0)
    assert probe.half_width == pytest.approx(half, abs=0.3)
    # Nothing above that the image's side has cut: all rows are as wide.
    row = view.rotate(image)[0]
    assert (row < 115).sum() == pytest.approx(2 * half, abs=1.5)
    # Mirrored, it enters through the other corner.
    mirrored = np.ascontiguousarray(image[:, ::-1])
    _, other, _ = find_probe(mirrored, View(whole, "top"))
    assert other.half_width == pytest.approx(probe.half_width, abs=0.02)
