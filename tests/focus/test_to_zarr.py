"""Depths written into an OME-Zarr: those of the whole image, whoever is killed on the way."""

import os
import signal
import sys

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import _to_zarr, depth_from_focus, depth_to_zarr

zarr = pytest.importorskip("zarr", reason="zarr is not installed")

POSITIONS = np.arange(9.0)
SHAPE = (150, 330)
TILE = 64
#: 3 × 6 of them.
TILES = 18


def stack_of(seed=0):
    rng = np.random.default_rng(seed)
    height = 3 + synthetic.paraboloid(SHAPE, 4.0)
    texture = synthetic.mixed_texture(SHAPE, rng)
    stack = synthetic.focal_stack(texture, height, POSITIONS, blur_rate=1.0, noise=2.0, rng=rng)
    return np.asarray(stack)


class Logged:
    """Frames in a file, and a file with a line for every time that a tile's frames are loaded."""

    def __init__(self, folder, stack):
        np.save(folder / "frames.npy", stack)
        self.folder, self.shape, self.dtype = folder, stack.shape, stack.dtype

    def __getitem__(self, key):
        if isinstance(key, tuple) and key[0] == 0 and key[1].stop != 1:
            with (self.folder / "log").open("a") as log:
                log.write(f"{key[1:]}\n")
        return np.load(self.folder / "frames.npy", mmap_mode="r")[key]

    def loads(self):
        return len((self.folder / "log").read_text().splitlines())


@pytest.fixture
def frames(tmp_path):
    return Logged(tmp_path, stack_of())


def assert_whole(path):
    root, whole = zarr.open_group(path, mode="r"), depth_from_focus(stack_of(), POSITIONS)
    for name in _to_zarr._AVERAGED:
        np.testing.assert_array_equal(root[name]["0"][:], getattr(whole, name), name)
    assert (root["tiles"][:] == 1).all()
    assert root.attrs["microlib"]["complete"]


class Stop(Exception):
    pass


def stop_after(count):
    def progress(done, whole):
        assert whole == TILES
        if done == count:
            raise Stop

    return progress


def test_a_run_that_is_stopped_goes_on_where_it_was(tmp_path, frames):
    path = tmp_path / "depth.zarr"
    options = {"pixel_size": 0.5, "tile": TILE}
    for count in (4, 11):
        with pytest.raises(Stop):
            depth_to_zarr(frames, path, POSITIONS, progress=stop_after(count), **options)
    depth_to_zarr(frames, path, POSITIONS, **options)
    assert_whole(path)
    # Each tile once, and none at all when there is nothing to do.
    assert frames.loads() == TILES
    depth_to_zarr(frames, path, POSITIONS, **options)
    assert frames.loads() == TILES


def test_a_pyramid_halves_the_maps_and_knows_its_scale(tmp_path, monkeypatch):
    monkeypatch.setattr(_to_zarr, "_SMALLEST", 100)
    depth_to_zarr(stack_of(), tmp_path / "a.zarr", POSITIONS, pixel_size=0.5, tile=100)
    root = zarr.open_group(tmp_path / "a.zarr", mode="r")
    (image,) = root["depth"].attrs["ome"]["multiscales"]
    assert [axis["unit"] for axis in image["axes"]] == ["micrometer"] * 2
    assert [data["path"] for data in image["datasets"]] == ["0", "1", "2"]
    shifts = [d["coordinateTransformations"][1]["translation"][0] for d in image["datasets"]]
    assert shifts == [0.0, 0.25, 0.75]
    fine, coarse = root["depth"]["0"][:], root["depth"]["2"][:]
    assert coarse.shape == (38, 83)
    blocks = fine[:148, :328].reshape(37, 4, 82, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse[:37, :82], blocks, rtol=1e-5)
    np.testing.assert_array_equal(root["index"]["2"][:], root["index"]["0"][::4, ::4])


def test_another_stack_is_refused(tmp_path):
    stack = stack_of()
    path = tmp_path / "a.zarr"
    depth_to_zarr(stack[:, :40, :40], path, POSITIONS, pixel_size=0.5)
    for words, change in (
        ("other frames", {"frames": stack[:, :30, :40]}),
        ("other positions", {"positions": 2 * POSITIONS}),
        ("other tile", {"tile": 512}),
        ("other pixel_size", {"pixel_size": 0.4}),
    ):
        given = {"frames": stack[:, :40, :40], "positions": POSITIONS, "pixel_size": 0.5} | change
        with pytest.raises(ValueError, match=words):
            depth_to_zarr(path=path, **given)


@pytest.mark.filterwarnings("ignore")
def test_a_worker_that_is_killed_costs_what_it_had_in_hand(tmp_path, frames):
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    cloudpickle = pytest.importorskip("cloudpickle")
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    path = tmp_path / "depth.zarr"
    quiet = {"dashboard_address": None, "silence_logs": 50}
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, **quiet) as cluster,
        distributed.Client(cluster) as client,
    ):
        pids = client.run(os.getpid)

        def progress(done, _):
            if done == 5:
                os.kill(next(iter(pids.values())), signal.SIGKILL)

        options = {"pixel_size": 0.5, "tile": TILE, "client": client, "progress": progress}
        depth_to_zarr(frames, path, POSITIONS, **options)
    assert_whole(path)
    # That of the dead worker again.
    assert frames.loads() <= TILES + 1
