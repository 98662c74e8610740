"""Units and refusals of reading and writing, and that pixels keep their place."""

from dataclasses import replace

import numpy as np
import pytest

from microlib.focus import depth_from_focus
from microlib.io import Stack, read_frames, write_height_tiff, write_ply, write_stl
from microlib.synthetic import focal_stack, mixed_texture
from tests.checks import BROKEN, hold_call, hold_refused, no_array, no_map

SHAPE = (29, 41)
Z = np.array([0.0, 10.0, 21.0, 30.0, 42.0])


def placed() -> Stack:
    """Return frames whose grey level rises by 3 a column and 1 a row, and thus shows the place."""
    row, column = np.indices(SHAPE)
    return with_scale(np.stack([3 * column + row + 20.0] * len(Z)), 7.0 + Z, 2.6)


def with_scale(frames: np.ndarray, positions: np.ndarray, pixel_size: float) -> Stack:
    """Return a stack as from a file with a scale."""
    return replace(read_frames(frames), positions=positions, pixel_size=pixel_size)


HEIGHT = np.random.default_rng(0).normal(40.0, 9.0, (6, 8))
SMALL = np.random.default_rng(1).integers(0, 255, (5, 24, 31)).astype(np.uint8)


def test_read_frames_gives_the_same_again_and_refuses_by_name():
    given = {"frames": SMALL, "region": (0, 0, 20, 20), "reduce": 1}

    def read(**options: object) -> np.ndarray:
        return np.stack(list(read_frames(**options)))

    hold_call(read, lambda: {**given, "frames": SMALL.copy()}, neighbors=False)
    beyond = [(-1, 0, 4, 4), (0, 0, 0, 4), (0, 0, 4, 0), "abcd"]
    texts = ["text", SMALL.astype(str), SMALL.astype(complex), object(), 3.0, SMALL[None]]
    wrong = {"region": lambda valid: [*no_array(valid), *beyond], "frames": texts}
    hold_refused(read_frames, given, wrong)


@pytest.mark.parametrize("write", [write_height_tiff, write_ply, write_stl])
def test_writers_refuse_by_name_and_keep_their_arrays(write, tmp_path):
    given = {"path": tmp_path / "file.tif", "height": HEIGHT.copy(), "pixel_size": 2.6}
    if write is write_ply:
        given["image"] = np.zeros(HEIGHT.shape, np.uint8)
    if write is write_height_tiff:
        given["what"] = "height"
    wrong = {
        "what": [None, 5],
        "height": no_map,
        "pixel_size": [*BROKEN[1:], 0, -1],
        "image": [HEIGHT, np.ma.array(np.zeros(HEIGHT.shape, np.uint8))],
    }
    wrong = {name: wrong[name] for name in given if name in wrong}
    hold_refused(write, given, wrong)
    assert not [*tmp_path.iterdir()]
    write(**given)
    np.testing.assert_array_equal(given["height"], HEIGHT)


@pytest.mark.parametrize("region", [None, (5, 3, 31, 24), (0, 2, 40, 27)])
@pytest.mark.parametrize("reduce", [1, 2, 3, 5])
def test_pixels_of_a_region_are_means_of_blocks_from_its_corner(region, reduce):
    """The grey level shows the position of a pixel, also where a pixel is the mean of a block."""
    for source in (placed(), read_frames(placed())):
        reader = read_frames(source, region=region, reduce=reduce)
        assert reader.pixel_size == pytest.approx(2.6 * reduce)
        np.testing.assert_array_equal(reader.positions, 7.0 + Z)
        row, column = np.indices(reader.shape) * reduce + (reduce - 1) / 2
        x, y = (region or (0, 0))[:2]
        level = 20.0 + 3 * (column + x) + row + y
        np.testing.assert_allclose(next(iter(reader)), level, rtol=1e-6)


def test_depth_of_a_region_has_the_positions_of_the_file_and_larger_pixels():
    texture = mixed_texture((80, 96), np.random.default_rng(0))
    stack = focal_stack(texture, np.full((80, 96), 21.0), Z, blur_rate=0.1)
    frames = with_scale(stack, 7.0 + Z, 2.6)
    found = depth_from_focus(frames, region=(6, 4, 80, 70), reduce=2)
    assert found.pixel_size == pytest.approx(5.2)
    assert np.nanmedian(found.depth) == pytest.approx(28.0, abs=1.0)


def test_labeled_array_is_rejected_since_its_axes_may_be_in_any_order():
    class Labeled(np.ndarray):
        dims, coords = ("x", "y", "z"), ()

    with pytest.raises(ValueError, match="frames must be an array, got a labeled one: pass its"):
        read_frames(np.zeros((41, 29, 5)).view(Labeled))
