"""Every kind of source gives the frames that were written into it, and the axes that it has."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib.io import read_frames, read_grey
from tests.io.conftest import COUNT


class Lazy:
    """What zarr and dask arrays have in common; counts what is loaded."""

    def __init__(self, values: NDArray) -> None:
        self._values = values
        self.shape = values.shape
        self.loaded: list[int] = []

    def __getitem__(self, key: int) -> NDArray:
        self.loaded.append(key)
        return self._values[key]


def one_buffer(frames: NDArray) -> Iterator[NDArray]:
    """Yield frames as a camera may, each over the one before."""
    buffer = np.empty_like(frames[0])
    for frame in frames:
        buffer[:] = frame
        yield buffer


def write_folder(folder: Path, frames: NDArray) -> Path:
    """Write a PNG for each frame, beside files that are none; 2 comes before 10."""
    folder.mkdir()
    for k, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"frame {k}.png"), frame)
    (folder / "notes.txt").write_text("not a frame")
    (folder / ".hidden.png").write_text("not a frame either")
    return folder


def tiff(path: Path, frames: NDArray, **options: object) -> Path:
    tifffile.imwrite(path, frames, **options)
    return path


def by_pillow(path: Path, frames: NDArray, **options: object) -> Path:
    """Write a file of several pages with Pillow, which has other codecs than tifffile."""
    first, *others = (Image.fromarray(frame) for frame in frames)
    first.save(path, save_all=True, append_images=others, **options)
    return path


def overwrite_tags(path: Path, **values: int) -> Path:
    with tifffile.TiffFile(path, mode="r+") as file:
        for page in file.pages:
            for name, value in values.items():
                page.tags[name].overwrite(value)
    return path


def set_of_ome(folder: Path, frames: NDArray) -> Path:
    """Write a file for each frame of one OME-TIFF, and return the folder."""
    folder.mkdir()
    names = [f"scan_z{k}.ome.tif" for k in range(len(frames))]
    blocks = "".join(
        f'<TiffData FirstZ="{k}" IFD="0" PlaneCount="1"><UUID FileName="{name}">urn:uuid:'
        f"{k:032}</UUID></TiffData>"
        for k, name in enumerate(names)
    )
    count, rows, columns = frames.shape
    for k, name in enumerate(names):
        xml = (
            f'<?xml version="1.0" encoding="UTF-8"?><OME UUID="urn:uuid:{k:032}">'
            '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" '
            f'SizeX="{columns}" SizeY="{rows}" SizeZ="{count}" SizeC="1" SizeT="1" '
            f'PhysicalSizeZ="3.5">{blocks}</Pixels></Image></OME>'
        )
        tifffile.imwrite(folder / name, frames[k], description=xml, metadata=None)
    return folder


def assert_frames(source: object, expected: NDArray, **options: object) -> None:
    reader = read_frames(source, **options)
    assert reader.count in (None, len(expected))
    found = np.stack(list(reader))
    assert found.dtype == expected.dtype
    assert reader.shape == expected.shape[1:3]
    assert reader.color == (expected.ndim == 4)
    np.testing.assert_array_equal(found, expected)


def test_grey_frames_of_arrays_and_folders_are_those_that_were_given(stack, tmp_path):
    folder, other = (write_folder(tmp_path / name, stack) for name in ("scan", "scan [3]"))
    files = [folder / f"frame {k}.png" for k in range(COUNT)]
    for array in (stack, list(stack), iter(stack), one_buffer(stack), Lazy(stack)):
        assert_frames(array, stack, color=True)
    for names in (folder, f"{folder}/frame*.png", files):
        assert_frames(names, stack, color=True)
    for names in (other, other / "frame [0-9]*.png"):
        assert_frames(names, stack)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.tif", {"photometric": "minisblack"}),
        ("a.tif", {"photometric": "miniswhite"}),
        ("a.tif", {"photometric": "miniswhite", "compression": "zlib"}),
        ("a.tif", {"imagej": True, "metadata": {"axes": "ZYX"}}),
        ("a.ome.tif", {"metadata": {"axes": "ZYX"}}),
    ],
    ids=["TIFF", "miniswhite", "miniswhite, compressed", "ImageJ", "OME"],
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_levels_of_a_tiff_are_returned_as_stored(stack, tmp_path, name, options, dtype):
    frames = stack.astype(dtype)
    path = tiff(tmp_path / name, frames, **options)
    assert_frames(path, frames, color=True)
    single = {key: value for key, value in options.items() if key != "metadata"}
    tiff(path, frames[0], **single)
    assert_frames([path], frames[:1])
    read = read_grey(path)
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, frames[0])


@pytest.mark.parametrize("compression", ["tiff_lzw", None])
def test_files_of_pillow_give_their_levels_and_colors(stack, tmp_path, compression):
    """It reads what tifffile has no codec for."""
    path, large = tmp_path / "a.tif", stack.astype(np.uint16) * 100
    color = np.stack([stack, stack // 2, 255 - stack], axis=-1)
    for frames in (stack, large, color):
        by_pillow(path, frames, compression=compression)
        assert_frames(path, frames, color=True)
    by_pillow(path, np.stack([stack, 255 - stack], axis=-1), compression=compression)
    assert_frames(path, stack, color=True)  # without alpha
    by_pillow(path, stack, compression=compression)
    assert_frames(overwrite_tags(path, PhotometricInterpretation=0), stack)
    by_pillow(path, large[:1], compression=compression)
    np.testing.assert_array_equal(read_grey(path), large[0])


@pytest.mark.parametrize("compression", ["zlib", None])
def test_color_frames_are_those_that_were_given(stack, tmp_path, compression):
    color = np.stack([stack, stack // 2, 255 - stack], axis=-1)
    folder = write_folder(tmp_path / "scan", np.ascontiguousarray(color[..., ::-1]))
    opaque = np.concatenate([color, color[..., :1]], axis=3)
    how = {"photometric": "rgb", "compression": compression}
    whole = tiff(tmp_path / "whole.tif", color, **how)
    how["planarconfig"] = "separate"
    planes = tiff(tmp_path / "planes.tif", np.moveaxis(color, -1, 1), **how)
    single = tiff(tmp_path / "single.tif", np.moveaxis(color[0], -1, 0), **how)
    # Luma of ITU-R BT.601, rounded.
    luma = color.astype(float) @ [0.299, 0.587, 0.114]
    for source in (color, opaque, Lazy(color), folder, whole, planes):
        assert_frames(source, color, color=True)
        grey = np.stack(list(read_frames(source)))
        np.testing.assert_allclose(grey, luma, atol=0.6)
    assert_frames([single], color[:1], color=True)


def test_types_of_numbers_are_kept_or_become_float32(stack, tmp_path):
    large = stack.astype(np.uint16) * 16
    assert_frames(large.astype(">u2"), large)
    for dtype in (np.int16, np.float64, np.int64):
        assert_frames(stack.astype(dtype), stack.astype(np.float32))
    bits = tiff(tmp_path / "a.tif", stack > 99, photometric="minisblack")
    assert_frames(bits, np.where(stack > 99, np.uint8(255), np.uint8(0)))


def test_imagej_display_palette_is_ignored(stack, tmp_path):
    """ImageJ stores the table by which it shows grey levels, as Fire or Blue, as a palette."""
    table = np.zeros((3, 256), np.uint16)
    table[2] = 257 * np.arange(256)[::-1]
    how = {"imagej": True, "photometric": "palette", "colormap": table}
    assert_frames(tiff(tmp_path / "p.tif", stack, metadata={"axes": "ZYX"}, **how), stack)


def test_any_file_of_an_ome_tiff_of_many_opens_all(stack, tmp_path):
    folder = set_of_ome(tmp_path / "set", stack)
    for source in (folder, folder / "scan_z2.ome.tif"):
        assert_frames(source, stack)
    reader = read_frames(folder / "scan_z2.ome.tif")
    assert reader.positions == pytest.approx(3.5 * np.arange(COUNT))


def test_png_with_alpha_is_read_without_it(stack, tmp_path):
    Image.fromarray(np.stack([stack[0], 255 - stack[0]], axis=-1)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), stack[0])


def test_names_can_begin_with_a_tilde_or_the_home(stack, tmp_path, monkeypatch):
    tiff(tmp_path / "~scan.tif", stack, photometric="minisblack")
    cv2.imwrite(str(tmp_path / "~a.png"), stack[0])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    write_folder(tmp_path / "home" / "scan", stack)
    for source, frames in (("~scan.tif", stack), ("./~scan.tif", stack), ("~/scan", stack)):
        assert_frames(source, frames)
    assert_frames(["~a.png"], stack[:1])


@pytest.mark.parametrize("place", ["after each page", "at the end"])
def test_preview_beside_pages_is_no_frame(stack, tmp_path, place):
    """As cameras and Olympus' and FEI's programs write it."""
    how = {"metadata": None, "photometric": "minisblack"}
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for k, frame in enumerate(stack[:3]):
            file.write(frame, **how)
            if k == 2 or place == "after each page":
                file.write(frame[::4, ::4], subfiletype=1, **how)
    assert_frames(tmp_path / "a.tif", stack[:3])


@pytest.mark.parametrize("axis", ["Z", "T", "Q"])
@pytest.mark.parametrize("color", [False, True])
def test_axis_of_frames_is_read_from_metadata(stack, tmp_path, axis, color):
    frames = np.repeat(stack[..., None], 3, axis=3) if color else stack
    metadata = {"axes": f"{axis}YXS" if color else f"{axis}YX"}
    photometric = "rgb" if color else "minisblack"
    reader = read_frames(
        tiff(tmp_path / "a.tif", frames, photometric=photometric, metadata=metadata)
    )
    assert (reader.axis, reader.count, reader.color) == (axis, COUNT, color)


def test_times_have_no_positions(stack, tmp_path):
    about = {"axes": "TYX", "PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0, "PhysicalSizeZ": 3.0}
    film = tiff(tmp_path / "a.ome.tif", stack, metadata=about, photometric="minisblack")
    assert (read_frames(film).pixel_size, read_frames(film).positions) == (2.0, None)
    about = {"axes": "TYX", "spacing": 3.0, "unit": "um"}
    film = tiff(tmp_path / "a.tif", stack, imagej=True, resolution=(0.5, 0.5), metadata=about)
    assert (read_frames(film).pixel_size, read_frames(film).positions) == (2.0, None)


def test_zarr_array_is_read_and_group_is_rejected(stack, tmp_path):
    zarr = pytest.importorskip("zarr")
    array = zarr.open_group(str(tmp_path / "a.zarr"), mode="w").create_array("0", data=stack)
    for source in (array, tmp_path / "a.zarr" / "0"):
        assert_frames(source, stack)
    with pytest.raises(
        ValueError, match=r"a\.zarr: it is a group: give one .* such as .*a\.zarr.0"
    ):
        read_frames(tmp_path / "a.zarr")


def test_photograph_is_not_turned_by_its_orientation(tmp_path):
    """The sensor of orientation flips under a camera that looks down; the pixels do not."""
    smooth = np.linspace(20, 200, 64 * 48).reshape(48, 64).astype(np.uint8)
    for k, turn in enumerate((1, 3, 6)):
        exif = Image.Exif()
        exif[0x0112] = turn
        Image.fromarray(smooth).save(tmp_path / f"{k}.jpg", quality=95, exif=exif)
    for frame in (*read_frames(tmp_path), read_grey(tmp_path / "2.jpg")):
        assert np.abs(frame.astype(int) - smooth).max() <= 3  # JPEG


@pytest.mark.parametrize("kind", ["imagej", "ome", "shaped"])
@pytest.mark.parametrize(
    ("axes", "shape", "lengths"),
    [("ZCYX", (3, 2), "Z=3, C=2"), ("TZYX", (2, 3), "T=2, Z=3"), ("CYX", (6,), "C=6")],
)
def test_channels_and_second_axis_are_rejected(stack, tmp_path, kind, axes, shape, lengths):
    options = {"imagej": True} if kind == "imagej" else {"photometric": "minisblack"}
    path = tmp_path / ("many.ome.tif" if kind == "ome" else "many.tif")
    tiff(path, stack[:6].reshape(*shape, *stack.shape[1:]), metadata={"axes": axes}, **options)
    with pytest.raises(ValueError, match=f"has the axes {lengths} besides rows and columns"):
        read_frames(path)
