"""The outline in an image against the outline that was drawn; images without one are rejected."""

import re
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.special import ndtr

from microlib.embryo import extract_boundary
from microlib.synthetic import Embryo, embryo_image
from tests.scenes.embryo import draw_scene
from tests.scenes.photographs import pictures, texture

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


def before_turning(points: np.ndarray, shape: tuple[int, int], turns: int) -> np.ndarray:
    """Where points of an image turned by `turns` quarters are in the image of this shape."""
    axes = [np.rot90(axis, turns) for axis in np.indices(shape)[::-1].astype(float)]
    return np.stack([map_coordinates(axis, points.T[::-1], order=1) for axis in axes], axis=1)


def distances(scene, points: np.ndarray) -> np.ndarray:
    """How far points lie outside the drawn outline, in px."""
    outline = scene.to_pixels(scene.embryo.outline(0.05))
    along = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    _, nearest = cKDTree(outline).query(points)
    return np.einsum("ij,ij->i", points - outline[nearest], outward[nearest])


def bar_on_dimple(
    half: float = 7.0, slope: float = -0.03, shape: tuple[int, int] = (240, 400),
    *, blur: float = 1.1, step: float = -27.0, bump: float = 40.0, noise: float = 0.0,
):  # fmt: skip
    """A bar of exact edges on a dimple, whose wall has the same blurred profile everywhere.

    Returns the image, the end of the bar, 6 px below the middle of the wall, and a function: how
    far points are inside the outline.
    """
    rows, columns = shape
    center, width = 0.47 * columns, 5 * half
    x = np.arange(-20.0, columns + 20, 0.02)
    y = 0.4 * rows + rows / 6 * np.exp(-(((x - center) / width) ** 2) / 2)
    y += rows / 4 * ((x - center) / (columns / 2)) ** 2
    tree = cKDTree(np.column_stack([x, y]))

    def inside(points: np.ndarray) -> np.ndarray:
        away, nearest = tree.query(points)
        return np.copysign(away, points[..., 1] - y[nearest])

    pixels = np.stack(np.indices(shape)[::-1], axis=-1).astype(float)
    depth = np.copysign(99.0, pixels[..., 1] - np.interp(pixels[..., 0], x, y))
    near = np.abs(pixels[..., 1] - np.interp(pixels[..., 0], x, y)) < 12 * blur
    depth[near] = inside(pixels[near]) / blur
    image = 180.0 + step * ndtr(depth) - bump * np.exp(-(depth**2) / 2)
    axis = np.array([slope, 1.0]) / np.hypot(slope, 1.0)
    end = np.array([center, np.interp(center, x, y) + 6.0])
    across = np.clip(half + 0.5 - np.abs((pixels - end) @ [axis[1], -axis[0]]), 0, 1)
    image += across * np.clip(0.5 - (pixels - end) @ axis, 0, 1) * (40.0 - image)
    image += np.random.default_rng(0).normal(0.0, noise, shape)
    return image, end, inside


@pytest.mark.parametrize(
    ("bar", "mirrored"),
    [((60.0, np.tan(np.deg2rad(3.9)), (480, 1400)), False), ((7.0, -0.03, (240, 400)), True)],
)
def test_straight_probe_and_wall_are_measured_exactly(bar, mirrored):
    """Widths are across the axis: along a row, the wide bar would measure 0.14 px (0.23 %) more."""
    image, end, inside = bar_on_dimple(*bar)
    half, slope, (_, columns) = bar
    found = extract_boundary(image[:, ::-1] if mirrored else image, direction="top")
    tip, points = np.array(found.probe.tip), found.points[~found.under_probe]
    if mirrored:
        tip, points = ([columns - 1.0, 0.0] + each * [-1, 1] for each in (tip, points))
    # Edges are found to some hundredths of a px.
    np.testing.assert_allclose(tip, end, atol=0.1)
    assert found.probe.half_width == pytest.approx(half, abs=0.03)
    assert found.probe.slope == pytest.approx(-slope if mirrored else slope, abs=2e-3)
    assert len(points) > 200
    # The profiles of the last points reach beyond the sides of the image.
    middle = np.abs(points[:, 0] - columns / 2) < columns / 2 - 8
    np.testing.assert_allclose(inside(points[middle]), 0.0, atol=0.05)


@pytest.mark.parametrize(
    ("blur", "step"), [(0.7, -60.0), (1.1, 60.0), (1.8, -60.0), (2.5, -20.0), (2.7, 20.0)]
)
def test_wall_of_any_blur_and_contrast_is_found_up_to_sides_of_image(blur, step):
    image, _, inside = bar_on_dimple(blur=blur, step=step)
    found = extract_boundary(image, direction="top")
    points = found.points[~found.under_probe]
    # The sharpest wall is sampled too coarsely by pixels; 0.05 px is below what noise of 2/255 does
    # (0.06 px).
    middle = np.abs(points[:, 0] - 200) < 192
    np.testing.assert_allclose(inside(points[middle]), 0.0, atol=0.05)
    assert points[:, 0].min() < 3
    assert points[:, 0].max() > 396
    assert found.blur == pytest.approx(blur, abs=0.05)


@pytest.mark.parametrize(
    ("step", "bump", "blur", "noise"),
    [(-60.0, 0.0, 1.0, 0.0), (60.0, 0.0, 1.0, 1.0), (-60.0, 0.0, 3.0, 1.0), (60.0, 0.0, 2.0, 1.0),
     (-60.0, 20.0, 1.1, 2.0), (60.0, 25.0, 1.1, 2.0), (-60.0, -25.0, 1.1, 2.0)],
)  # fmt: skip
def test_edge_with_a_faint_wall_or_none_is_found_as_well_as_noise_allows(step, bump, blur, noise):
    """A wall that is free beside the step moves by half a pixel, at hardly another misfit."""
    image, _, inside = bar_on_dimple(blur=blur, step=step, bump=bump, noise=noise)
    found = extract_boundary(image, direction="top")
    off = inside(found.points[~found.under_probe])
    # The least standard deviation of the position of a step of known levels and blur; the levels
    # are fitted, too.
    least = noise * np.sqrt(2 * np.sqrt(np.pi) * blur) / abs(step)
    assert abs(np.median(off)) < 0.06
    assert np.median(np.abs(off)) < least + 0.03
    if not bump:
        assert off.std() < 1.6 * least + 0.03
    if noise and not bump:
        assert found.uncertainty[~found.under_probe].mean() == pytest.approx(off.std(), rel=0.35)


def test_outline_and_std_match_rendered_outline(scene, boundary):
    seen = boundary.points[~boundary.under_probe]
    off = distances(scene, seen)
    # The dark wall darkens the brighter ground more than the fluid, so the wall seems to lie
    # 0.02 px too far out; noise of 2/255 moves a point by 0.065 px.
    assert abs(off.mean()) < 0.04
    assert off.std() < 0.09
    assert np.abs(off).max() < 0.4
    assert boundary.uncertainty[~boundary.under_probe].mean() == pytest.approx(off.std(), rel=0.2)
    assert (np.diff(boundary.x) >= 0).all()
    # The outline reaches from near the probe to well beyond both rims.
    radius = scene.embryo.rim_radius / scene.pixel_size
    for side in (-1, 1):
        distance = side * (seen[:, 0] - scene.center[0])
        assert distance[distance > 0].min() < 15
        assert distance.max() > 1.5 * radius
    # Variances add: 1/12 px² of a pixel's cell, t²/12 of a wall of thickness t.
    wall = (scene.embryo.thickness / scene.pixel_size) ** 2 / 12
    assert boundary.blur == pytest.approx(np.sqrt(1 + 1 / 12 + wall), abs=0.06)


def test_without_probe_matches_image_rendered_without_probe(scene, boundary):
    """The light rises by one grey level a column, so the ground differs beside the probe."""
    light = np.arange(scene.image.shape[1], dtype=float)
    noisy, clean = scene.image[:75], render(probe=False, noise=0.0).image[:75]
    filled = boundary.without_probe(scene.image + light)[:75] - light
    bar = np.abs(noisy - filled) > 20
    assert bar.sum() > 75 * 11
    # The fill is a straight line between two noisy pixels; the true light deviates from a line by
    # less than one grey level.
    assert np.abs(filled - clean)[bar].max() < 3


@pytest.mark.parametrize(("gain", "black"), [(0.5, 10.0), (1 / 510, 0.0), (128.5, 0.0)])
def test_outline_does_not_depend_on_gain_or_black_level(scene, boundary, gain, black):
    other = extract_boundary(scene.image * gain + black)
    np.testing.assert_array_equal(other.under_probe, boundary.under_probe)
    # float32 keeps seven digits of a grey level, which move an edge by 1e-6 px; the fit of a wall
    # ends within about 1e-3 px.
    np.testing.assert_allclose(other.points, boundary.points, atol=5e-3)
    np.testing.assert_allclose(other.uncertainty, boundary.uncertainty, rtol=1e-3)


@pytest.mark.parametrize(("edge", "turns"), [("left", 1), ("bottom", 2), ("right", 3)])
def test_outline_follows_rotation_of_image(scene, boundary, edge, turns):
    turned = np.rot90(scene.image, turns)
    for direction in (edge, "auto"):
        found = extract_boundary(turned, direction=direction)
        assert found.rotation.direction == edge
        points = before_turning(found.points, scene.image.shape, turns)
        np.testing.assert_allclose(points, boundary.points, atol=1e-6)
    np.testing.assert_array_equal(found.without_probe(turned), boundary.without_probe(scene.image))
    with pytest.raises(ValueError, match="from the top"):
        extract_boundary(turned, direction="top")


@pytest.mark.parametrize("degrees", [-30.0, 8.0])
def test_leaning_probe_is_refused_until_the_image_is_rotated(degrees):
    place = {"shape": (400, 520), "center": (260.0, 175.0)}
    image = render(tilt=np.deg2rad(degrees), **place).image
    with pytest.raises(ValueError, match="rotate the image"):
        extract_boundary(image, direction="top")
    turn = cv2.getRotationMatrix2D((260.0, 175.0), degrees, 1.0)
    upright = cv2.warpAffine(image, turn, (520, 400), flags=2, borderMode=cv2.BORDER_REPLICATE)
    found = extract_boundary(upright, direction="top")
    off = distances(render(**place | {"tilt": 0.0}), found.points[~found.under_probe])
    assert np.median(np.abs(off)) < 0.1


@pytest.mark.parametrize("probe", ["needle", "rod"])
def test_probe_and_outline_match_independent_renderer(probe):
    """`draw_scene` chooses side, colors and resolution; seed 2002 gives a quarter of it."""
    drawn = draw_scene(np.random.default_rng(2002), probe)
    assert drawn.shrink == 4
    found = extract_boundary(drawn.image)
    seen = found.y[~found.under_probe]
    depth = seen.max() - (found.image_height - 1 - found.probe.tip[1])
    assert depth == pytest.approx(drawn.depth / drawn.pixel_size, abs=2.0)
    assert np.ptp(found.x) / 2 == pytest.approx(drawn.capsule_radius / drawn.pixel_size, rel=0.05)
    half = drawn.probe_half_width / drawn.pixel_size
    assert found.probe.half_width == pytest.approx(half, abs=1.0)
    # A needle gets 0.08 px narrower on either side for each px down.
    assert found.probe.taper == pytest.approx(-0.08 if probe == "needle" else 0.0, abs=0.005)


def test_outline_and_std_are_right_on_the_most_blurred_image() -> None:
    """At the largest blur that needs no reduction of the image, which is turned by a quarter."""
    place = {"shape": (641, 963), "center": (480.7, 203.6), "pixel_size": 1.94, "blur": 2.7}
    soft = render(**place)
    image = np.rot90(soft.image)
    found = extract_boundary(image, direction="left")
    assert found.blur == pytest.approx(2.7, abs=0.2)
    points = before_turning(found.points, soft.image.shape, 1)
    off = distances(soft, points[~found.under_probe])
    assert abs(off.mean()) < 0.15  # 0.3 µm, twice what the sharp image is allowed
    assert np.abs(off).max() < 1.5
    assert found.uncertainty[~found.under_probe].mean() == pytest.approx(off.std(), rel=0.2)
    # Blur makes the half-width about 0.9 px too small; one (1.94 µm) is allowed.
    assert found.probe.half_width * soft.pixel_size == pytest.approx(25.0, abs=1.94)
    filled = found.without_probe(image)
    assert filled[: int(found.probe.tip[1]) - 9, int(found.probe.tip[0])].min() > 150


def test_color_image_has_outline_of_its_luminance(scene) -> None:
    color = np.rint(scene.image[..., np.newaxis] * np.array([0.9, 1.0, 0.8])).astype(np.uint8)
    grey = cv2.cvtColor(color.astype(np.float32), cv2.COLOR_RGB2GRAY)
    wanted = extract_boundary(grey)
    for image in (color, np.dstack([color, np.full(grey.shape, 255, np.uint8)])):
        found = extract_boundary(image)
        np.testing.assert_allclose(found.points, wanted.points, atol=1e-6)
        filled = found.without_probe(image)
        np.testing.assert_allclose(filled, wanted.without_probe(grey), rtol=1e-5)


def test_boundary_is_rejected_in_pictures_without_an_embryo():
    """24 photographs and a texture raise a ValueError, and no other error."""
    images = [*(image for _, image in pictures()), texture(np.random.default_rng(2))]
    for image in images:
        with pytest.raises(ValueError, match="image must") as refusal:
            extract_boundary(image)
        # Together, the reasons name each of the four edges exactly once.
        if edges := re.findall(r"\(from the ([\w, ]+)\)", str(refusal.value)):
            assert sorted(", ".join(edges).split(", ")) == ["bottom", "left", "right", "top"]


def barred(image: np.ndarray, end: int, left: int) -> np.ndarray:
    """Return the image with one more dark bar, from its upper edge to row `end`."""
    image = image.copy()
    image[:end, left : left + 13] = 42
    return image


def hollow() -> np.ndarray:
    """A bar whose middle is as bright as the ground, so that its rows have no usable edges."""
    image = np.full((200, 400), 200.0)
    image[:120, 141:161] = 40.0
    image[8:118, 148:154] = 200.0
    return image


def bare(embryo: Embryo = PRESSED) -> np.ndarray:
    return render(embryo, probe=False).image


def saturated(levels: int, kind: type) -> np.ndarray:
    """Return the image overexposed by 40 %, in 256 times `levels` grey levels."""
    return (render().image * (1.4 * levels)).clip(0, 256 * levels - 1).astype(kind)


NO_PROBE = "one dark probe that enters through its upper edge, got 0 bars"
ONE_SIDE = "image must show an embryo's outline on both sides of the probe"
FLAT = "image must show a dimple at least 3 px deep"
CORNER = np.indices((320, 480)).sum(axis=0) < 60
#: Images without a measurable dimple, and the error of each.
SPOILED = {
    "no embryo": (lambda: barred(np.full((320, 480), 190, np.uint8), 130, 234), ONE_SIDE),
    "probe beside": (lambda: barred(bare(), 200, 30), ONE_SIDE),
    "half of it": (
        lambda: render().image[:, 222:],
        ONE_SIDE + r", got 0 columns of it on the left and 1\d\d on the right",
    ),
    "probe above": (
        lambda: barred(bare(), 60, 234),
        FLAT + r".* falls, got -\d+\.\d px and a fall of \d\d\.0 px on the left",
    ),
    "untouched": (lambda: render(embryo=Embryo(1.0, 0.0, 1.0)).image, FLAT),
    "probe inside": (
        lambda: barred(bare(Embryo.dented(30.0, modulus=1.0)), 170, 234),
        "to which the outline falls",
    ),
    "no probe": (bare, NO_PROBE),
    "two probes": (lambda: barred(render().image, 60, 80), "one dark probe .* got 2 bars"),
    "hollow": (hollow, r"probe's edges against a brighter ground, got them in [0-7] of"),
    "saturated": (lambda: saturated(1, np.uint8), "not be saturated"),
    "saturated fractions": (lambda: saturated(1, np.float64) / 255, "pixels at 1 or above"),
    "saturated corner": (lambda: np.where(CORNER, 255, render().image).astype(np.uint8), "1.2% of"),
    "saturated at 12 bits": (lambda: saturated(16, np.uint16), "saturated, .* at 4095 or above"),
}


@pytest.mark.parametrize(("spoiled", "message"), SPOILED.values(), ids=SPOILED)
def test_image_without_dimple_is_rejected_with_reason(spoiled, message):
    with pytest.raises(ValueError, match=message):
        extract_boundary(spoiled())
