"""The laws of every public name of reading and writing, and that pixels keep their place."""

import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from microlib.focus import depth_from_focus
from microlib.io import Stack, read_frames, read_grey, write_height_tiff, write_ply, write_stl
from microlib.synthetic import focal_stack, mixed_texture
from tests.io.make import read_ply, read_stl
from tests.laws import SAME, Row, grey, laws_of, um

SHAPE = (29, 41)
Z = np.array([0.0, 10.0, 21.0, 30.0, 42.0])


def placed(u) -> Stack:
    """Return frames whose grey level rises by 3 a column and 1 a row, and thus shows the place."""
    row, column = np.indices(SHAPE)
    frames = np.stack([(3 * column + row) * u.grey + u.grey0] * len(Z))
    return with_scale(frames, u.z0 + Z * u.um, 2.6 * u.um, (u.x0_um, u.y0_um))


def with_scale(
    frames: np.ndarray, positions: np.ndarray, pixel_size: float, origin: tuple
) -> Stack:
    """Return a stack as from a file with a scale; `origin` is that of the first pixel, µm."""
    corner = (origin[0] / pixel_size, origin[1] / pixel_size)
    known = {"positions": positions, "pixel_size": pixel_size, "corner": corner}
    return replace(read_frames(frames), **known)


def reading(**options) -> dict:
    reader = read_frames(**options)
    about = {name: getattr(reader, name) for name in ("count", "positions", "pixel_size", "origin")}
    return {**about, "frames": np.stack(list(reader))}


def written(height: np.ndarray, pixel_size: float) -> dict:
    """Return what other readers find in the files: pixel size, values, grey levels, mesh."""
    with tempfile.TemporaryDirectory() as folder:
        write_height_tiff(file := Path(folder) / "h.tif", height, pixel_size=pixel_size)
        with tifffile.TiffFile(file) as tiff:
            size = [1e4 / per for per in tiff.pages[0].aspage().get_resolution()]
            values = tiff.asarray()
        grey = np.asarray(read_grey(file))
        write_ply(Path(folder) / "m.ply", height, pixel_size=pixel_size)
        mesh = read_ply(Path(folder) / "m.ply")
        write_stl(Path(folder) / "m.stl", height, pixel_size=pixel_size)
        mesh["corners"] = read_stl(Path(folder) / "m.stl")["corners"]
    return {"size": size, "values": values, "grey": grey, **mesh}


HEIGHT = np.random.default_rng(0).normal(40.0, 9.0, (6, 8))
FILES = Row(
    lambda u: {"height": HEIGHT * u.um, "pixel_size": 2.6 * u.um},
    {**dict.fromkeys(("size", "values", "grey", "vertices", "corners"), um), "faces": SAME},
    within=1e-6,  # single precision, and six digits of older versions of tifffile
    call=written,
)
LAWS = {
    "io.read_frames": Row(
        lambda u: {"frames": placed(u), "region": (5, 3, 31, 24), "reduce": 4},
        {
            "count": SAME, "pixel_size": um, "positions": um.counted_from("z0"),
            "frames": grey.counted_from("grey0"), "origin": um.counted_from("x0_um", "y0_um"),
        },
        within=1e-6,  # single precision
        call=reading,
    ),
    "io.read_grey": FILES,
    "io.write_height_tiff": FILES,
    "io.write_ply": FILES,
    "io.write_stl": FILES,
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
def test_law_holds(law, name):
    law(name, LAWS[name])


UNITS = SimpleNamespace(um=1.0, grey=1.0, grey0=20.0, x0_um=12.0, y0_um=-5.0, z0=7.0)


@pytest.mark.parametrize("region", [None, (5, 3, 31, 24), (0, 2, 40, 27)])
@pytest.mark.parametrize("reduce", [1, 2, 3, 5])
def test_reader_origin_follows_region_and_reduce(region, reduce):
    """The grey level shows the position of a pixel, also where a pixel is the mean of a block."""
    for source in (placed(UNITS), read_frames(placed(UNITS))):
        reader = read_frames(source, region=region, reduce=reduce)
        row, column = np.indices(reader.shape)
        x, y = (
            o + reader.pixel_size * n for o, n in zip(reader.origin, (column, row), strict=True)
        )
        level = UNITS.grey0 + (3 * (x - UNITS.x0_um) + y - UNITS.y0_um) / 2.6
        np.testing.assert_allclose(next(iter(reader)), level, rtol=1e-6)


def test_depth_origin_follows_region_and_reduce():
    texture = mixed_texture((80, 96), np.random.default_rng(0))
    stack = focal_stack(texture, np.full((80, 96), 21.0), Z, blur_rate=0.1)
    frames = with_scale(stack, 7.0 + Z, 2.6, (12.0, -5.0))
    found = depth_from_focus(frames, region=(6, 4, 80, 70), reduce=2)
    assert found.pixel_size == pytest.approx(5.2)
    # The center of the first block, which is columns 6 and 7, rows 4 and 5.
    assert found.origin == pytest.approx((12.0 + 6.5 * 2.6, -5.0 + 4.5 * 2.6))
    assert np.nanmedian(found.depth) == pytest.approx(28.0, abs=1.0)


def test_origin_follows_a_pixel_size_that_is_set_later():
    stack = np.random.default_rng(0).integers(0, 255, (5, 64, 80)).astype(np.uint8)
    found = depth_from_focus(stack, spacing=1.0, region=(20, 10, 48, 40), reduce=2)
    assert found.origin == (0.0, 0.0)
    # The center of the first block, in pixels of the frame, which are 1.3 µm.
    assert replace(found, pixel_size=2.6).origin == pytest.approx((20.5 * 1.3, 10.5 * 1.3))


def test_labeled_array_is_rejected_since_its_axes_may_be_in_any_order():
    class Labeled(np.ndarray):
        dims, coords = ("x", "y", "z"), ()

    with pytest.raises(ValueError, match="frames must be an array, got a labeled one: pass its"):
        read_frames(np.zeros((41, 29, 5)).view(Labeled))
