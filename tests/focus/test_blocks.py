"""A dask array, block by block, against the whole image at once."""

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import depth_from_focus
from tests.focus.scenes import stack_of
from tests.scenes import straight_step

da = pytest.importorskip("dask.array")
dask = pytest.importorskip("dask")

SHAPE = (352, 416)
POSITIONS = np.arange(11.0)


@pytest.fixture(scope="module")
def stack():
    """A dome with a step and a patch of bare ground."""
    texture = synthetic.mixed_texture(SHAPE, 0)
    texture[200:260, 250:330] = 128
    height = 2 + synthetic.paraboloid(SHAPE, 6.0)
    height[:, 150:] += 1.8
    return stack_of(height, POSITIONS, texture=texture)


@pytest.fixture(scope="module")
def whole(stack):
    return depth_from_focus(stack, POSITIONS)


def test_depth_of_blocks_equals_depth_of_whole_frames(stack, whole):
    blocks = depth_from_focus(da.from_array(stack, chunks=(4, 192, 192)), POSITIONS)
    assert blocks.depth.shape == SHAPE
    assert len(blocks.depth.chunks[0]) == 2
    names = ("depth", "uncertainty", "confidence", "index", "all_in_focus", "at_end")
    with dask.config.set(scheduler="synchronous"):
        found = dict(zip(names, dask.compute(*(getattr(blocks, n) for n in names)), strict=True))
    for name, value in found.items():
        assert value.shape == SHAPE
        assert value.dtype == getattr(whole, name).dtype == getattr(blocks, name).dtype
    error = found["depth"] - whole.depth
    assert np.sqrt(np.nanmean(error**2)) <= 0.004
    assert np.nanmax(np.abs(error)) <= 0.02
    assert np.mean(np.isnan(found["depth"]) != np.isnan(whole.depth)) <= 1e-4
    assert np.mean(found["all_in_focus"] != whole.all_in_focus) < 1e-3
    assert "not computed" in repr(blocks)


def test_depth_of_blocks_of_different_contrast_equals_whole():
    """Bare ground is smoothed by what lies around it, by its strength in the whole image."""
    y, x = np.indices(SHAPE)
    texture = np.asarray(synthetic.mixed_texture(SHAPE, 2), float)
    texture[:, 208:] = 128 + 0.3 * (texture[:, 208:] - 128)
    texture[np.sin(x / 60) * np.sin(y / 50) > 0.55] = texture.mean()
    height = 3.5 + straight_step(SHAPE, 4.0)
    frames = stack_of(height, POSITIONS, texture=texture)
    part = depth_from_focus(da.from_array(frames, chunks=(11, 192, 192)), POSITIONS)
    with dask.config.set(scheduler="synchronous"):
        error = part.depth.compute() - depth_from_focus(frames, POSITIONS).depth
    assert np.sqrt(np.nanmean(error**2)) <= 0.001


def test_region_of_a_zarr_array_equals_region_of_frames(stack, tmp_path):
    """In chunks that are no multiples of 64 px, read from and written to a file."""
    zarr = pytest.importorskip("zarr")
    store = zarr.create_array(tmp_path / "in.zarr", data=stack, chunks=(3, 101, 416))
    result = depth_from_focus(store, spacing=1.0, region=(40, 8, 160, 128))
    da.to_zarr(result.depth, tmp_path / "out.zarr")
    same = depth_from_focus(stack, POSITIONS, region=(40, 8, 160, 128))
    np.testing.assert_allclose(zarr.open_array(tmp_path / "out.zarr")[:], same.depth, atol=0.02)
    assert result.corner == same.corner == (40, 8)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"measure": "sml"}, "measure must not be given for a dask or zarr array, got 'sml'"),
        ({"register": True}, "register must not be given for a dask"),
        ({"reduce": 2}, "reduce must not be given for a dask"),
        ({"workers": 2}, "workers must not be given for a dask"),
        ({"progress": print}, "progress must not be given for a dask"),
        ({"positions": [0, 1, 2]}, "frames and positions must be equal in number, got 11 and 3"),
        ({"positions": None}, "positions or spacing must be given"),
        ({"region": (0, 0, 900, 20)}, "region must lie in the image of 416×352 px"),
        ({"frames": da.zeros((11, 32, 32, 3))}, "frames must be a dask array of shape"),
        ({"frames": da.zeros((11, 32, 32), dtype=complex)}, "frames must be a dask array of shape"),
    ],
)
def test_options_and_frames_without_meaning_for_blocks_are_rejected(stack, change, words):
    arguments = {"frames": da.from_array(stack), "positions": POSITIONS, **change}
    with pytest.raises(ValueError, match=words):
        depth_from_focus(**arguments)
