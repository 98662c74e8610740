"""Frames in an xarray.DataArray: order of dimensions, and coordinates in frames and results."""

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import depth_from_focus
from microlib.io import read_frames

Z = np.array([0.0, 10.0, 20.0, 31.0, 40.0, 50.0, 60.0, 70.0, 80.0])


@pytest.fixture(scope="module")
def stack():
    texture = synthetic.mixed_texture((64, 80), np.random.default_rng(0))
    return synthetic.focal_stack(texture, np.full((64, 80), 42.0), Z, blur_rate=0.1)


@pytest.fixture
def labeled(stack):
    """Return a function that gives the stack coordinates in a unit of length."""
    xarray = pytest.importorskip("xarray")

    def label(unit="µm", per_um=1.0):
        at = {"z": Z, "y": 100 + 2.0 * np.arange(64), "x": 300 + 2.0 * np.arange(80)}
        coords = {axis: (axis, values * per_um, {"units": unit}) for axis, values in at.items()}
        return xarray.DataArray(stack, coords, ("z", "y", "x"))

    return label


@pytest.mark.parametrize(
    ("unit", "per_um", "order", "names"),
    [
        ("µm", 1.0, "zyx", {}),
        ("nm", 1e3, "yxz", {}),
        ("mm", 1e-3, "zxy", {}),
        ("µm", 1.0, "xzy", {"x": "X", "y": "Y"}),
    ],
)
def test_labeled_frames_have_pixel_size_positions_and_origin_in_any_order(
    stack, labeled, unit, per_um, order, names
):
    reader = read_frames(labeled(unit, per_um).transpose(*order).rename(names))
    assert reader.pixel_size == pytest.approx(2.0)
    assert reader.positions == pytest.approx(Z)
    assert reader.origin == pytest.approx((300.0, 100.0))
    np.testing.assert_array_equal(np.stack(list(reader)), stack)


def test_depth_has_the_coordinates_of_its_frames(stack, labeled):
    frames = labeled()
    found = depth_from_focus(frames)
    for axis, first, count in zip("xy", found.origin, found.depth.shape[::-1], strict=True):
        np.testing.assert_allclose(first + found.pixel_size * np.arange(count), frames[axis])
    # Single precision: a thousandth of a µm is far above its rounding.
    np.testing.assert_allclose(found.depth, depth_from_focus(stack, Z).depth, atol=1e-3)


def test_labeled_frames_have_three_dimensions(labeled):
    for wrong in (labeled()[0], labeled().expand_dims(channel=2)):
        with pytest.raises(ValueError, match="frames must have shape"):
            read_frames(wrong)


def test_unusable_coordinates_give_no_scale(labeled):
    """Coordinates of pixels that are not square, pixel numbers, volts, and times."""
    wide = labeled().assign_coords(x=("x", 2.1 * np.arange(80), {"units": "µm"}))
    with pytest.warns(UserWarning, match="pixels of 2.1×2 µm, which are not square"):
        assert read_frames(wide).pixel_size is None
    numbered = labeled().drop_vars(["x", "y"]).assign_coords(x=np.arange(80), y=np.arange(64))
    assert read_frames(numbered).pixel_size is None
    assert read_frames(numbered.assign_coords(z=("z", Z, {"units": "V"}))).positions is None
    with pytest.raises(ValueError, match="must differ in focus"):
        depth_from_focus(numbered.rename(z="time"))
