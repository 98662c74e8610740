"""Every kind of source gives the frames that were written into it, and the axes that it has."""

from __future__ import annotations

import importlib.util
import math
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


def packed(path: Path, frames: NDArray[np.uint16], bits: int) -> Path:
    """Write frames as cameras do that put three bytes where two numbers of 12 bits are."""
    count, rows, columns = frames.shape
    octets = frames.astype(">u2").view(np.uint8).reshape(count, rows, columns, 2)
    numbers = np.unpackbits(octets, axis=3)[..., -bits:]
    for page in np.packbits(numbers.reshape(count, rows, -1), axis=2):
        tifffile.imwrite(path, page, append=True, metadata=None, photometric="minisblack")
    return overwrite_tags(path, BitsPerSample=bits, ImageWidth=columns)


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
    np.save(tmp_path / "a.npy", stack)
    for array in (stack, list(stack), iter(stack), one_buffer(stack), Lazy(stack)):
        assert_frames(array, stack, color=True)
    for names in (folder, f"{folder}/frame*.png", files, iter(files), tmp_path / "a.npy"):
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


def test_packed_12_bits_are_read_and_10_bits_name_the_package(stack, tmp_path):
    levels = stack.astype(np.uint16) * 3 + 1
    assert_frames(packed(tmp_path / "a.tif", levels * 5, 12), levels * 5)
    path = packed(tmp_path / "b.tif", levels, 10)
    if importlib.util.find_spec("imagecodecs"):
        assert_frames(path, levels)
    else:
        with pytest.raises(ValueError, match=r"requires the .imagecodecs. package"):
            list(read_frames(path))


@pytest.mark.parametrize("scale", [256, 257])
def test_palette_of_either_scale_becomes_its_colors(tmp_path, scale):
    """Programs write v · 256 or v · 257 for the 8-bit v; Pillow reads both as v."""
    levels = np.random.default_rng(1).integers(0, 256, (3, 256))
    numbers = np.arange(240, dtype=np.uint8).reshape(12, 20)
    colormap = (levels * scale).astype(np.uint16)
    path = tiff(tmp_path / "p.tif", numbers, photometric="palette", colormap=colormap)
    read = next(iter(read_frames(path, color=True)))
    np.testing.assert_array_equal(read, levels.T[numbers])
    with Image.open(path) as picture:
        np.testing.assert_array_equal(read, np.asarray(picture.convert("RGB")))


def test_imagej_display_palette_is_ignored(stack, tmp_path):
    """ImageJ stores the table by which it shows grey levels, as Fire or Blue, as a palette."""
    table = np.zeros((3, 256), np.uint16)
    table[2] = 257 * np.arange(256)[::-1]
    how = {"imagej": True, "photometric": "palette", "colormap": table}
    assert_frames(tiff(tmp_path / "p.tif", stack, metadata={"axes": "ZYX"}, **how), stack)


def test_zarr_arrays_and_folders_are_read(stack, tmp_path):
    zarr = pytest.importorskip("zarr")
    array = zarr.open(str(tmp_path / "a.zarr"), mode="w", shape=stack.shape, dtype="u1")
    array[:] = stack
    for source in (array, tmp_path / "a.zarr"):
        assert_frames(source, stack)


def test_jpeg_and_its_orientation_are_read(tmp_path):
    """A smooth image loses a grey level or two; noise would lose more."""
    smooth = np.linspace(20, 200, 64 * 48).reshape(48, 64).astype(np.uint8)
    path = by_pillow(tmp_path / "a.tif", smooth[None], compression="jpeg", quality=95)
    (frame,) = read_frames(path)
    assert np.abs(frame.astype(int) - smooth).max() <= 3
    turned = Image.Exif()
    turned[0x0112] = 6  # the camera was held sideways
    Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=95, exif=turned)
    assert np.abs(read_grey(tmp_path / "a.jpg").astype(int) - np.rot90(smooth, -1)).max() <= 3


def test_any_file_of_an_ome_tiff_of_many_opens_all(stack, tmp_path):
    folder = set_of_ome(tmp_path / "set", stack)
    for source in (folder, folder / "scan_z2.ome.tif"):
        assert_frames(source, stack)
    reader = read_frames(folder / "scan_z2.ome.tif")
    assert reader.positions == pytest.approx(3.5 * np.arange(COUNT))


def test_png_with_alpha_is_read_without_it(stack, tmp_path):
    Image.fromarray(np.stack([stack[0], 255 - stack[0]], axis=-1)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), stack[0])


def test_frames_of_a_gif_are_read(stack, tmp_path):
    reader = read_frames(by_pillow(tmp_path / "a.gif", stack))
    assert (reader.count, reader.files) == (None, (tmp_path / "a.gif",))
    assert np.abs(np.stack(list(reader)).astype(int) - stack).max() <= 1


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


# --- Axes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["imagej", "ome", "shaped"])
@pytest.mark.parametrize(
    ("axes", "lengths", "choice", "frames", "axis"),
    [
        ("ZCYX", (3, 2), {"channel": 1}, [1, 3, 5], "Z"),
        ("TZYX", (2, 3), {"time": 1}, [3, 4, 5], "Z"),
        ("TCYX", (3, 2), {"channel": 1}, [1, 3, 5], "T"),
        ("CYX", (6,), {"channel": 2}, [2], ""),
    ],
)
def test_channel_and_time_select_a_stack(
    stack, tmp_path, kind, axes, lengths, choice, frames, axis
):
    options = {"imagej": True} if kind == "imagej" else {"photometric": "minisblack"}
    path = tmp_path / ("many.ome.tif" if kind == "ome" else "many.tif")
    many = stack[: math.prod(lengths)].reshape(*lengths, *stack.shape[1:])
    tiff(path, many, metadata={"axes": axes}, **options)
    lengths_text = ", ".join(f"{a}={n}" for a, n in zip(axes, lengths, strict=False))
    with pytest.raises(
        ValueError, match=f"has the axes {lengths_text} besides rows and columns, .* choose a chan"
    ):
        read_frames(path)
    assert_frames(path, stack[frames], **choice)
    assert read_frames(path, **choice).axis == axis
    count = lengths[axes.index("C" if "channel" in choice else "T")]
    with pytest.raises(ValueError, match=rf"it has {count} along axis ., got number {count} "):
        read_frames(path, **dict.fromkeys(choice, count))


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


def test_series_selects_an_image_of_the_file(stack, tmp_path):
    path = tmp_path / "a.ome.tif"
    images = {2.0: stack, 5.0: stack[:4, :9]}
    with tifffile.TiffWriter(path) as file:
        for size, frames in images.items():
            sizes = {"PhysicalSizeX": size, "PhysicalSizeY": size}
            file.write(frames, metadata={"axes": "ZYX", **sizes})
    for series, (size, frames) in enumerate(images.items()):
        assert read_frames(path, series=series).pixel_size == size
        assert_frames(path, frames, series=series)
    for options in ({}, {"series": 2}):
        with pytest.raises(ValueError, match=r"holds 2 series of images \(.*\): choose one"):
            read_frames(path, **options)
    for source in (stack, [stack[0]], read_frames(stack)):
        with pytest.raises(
            ValueError, match="channel must be left out for frames without that axis"
        ):
            read_frames(source, channel=0)


def write_ome_zarr(path: Path, frames: NDArray, version: str, axes: str = "tczyx") -> None:
    """Write an image in two sizes with the layout of the standard, without a package for it."""
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(path), mode="w", zarr_format=2 if version == "0.4" else 3)
    units = {"x": "nanometer", "y": "micrometer", "z": "micrometer"}
    kinds = {"t": "time", "c": "channel"}
    about = [
        {"name": a, "type": kinds.get(a, "space")} | ({"unit": units[a]} if a in units else {})
        for a in axes
    ]
    steps = {"x": 650.0, "y": 0.65, "z": 2.5}
    sizes = []
    for k, level in enumerate((frames, frames[..., ::2, ::2])):
        array = group.create_array(str(k), shape=level.shape, dtype=level.dtype)
        array[:] = level
        half = {"x": 2**k, "y": 2**k}
        scale = [0.5 * steps.get(a, 1.0) * half.get(a, 1) for a in axes]
        change = [{"type": "scale", "scale": scale}]
        sizes.append({"path": str(k), "coordinateTransformations": change})
    both = [{"type": "scale", "scale": [2.0] * len(axes)}]
    image = {"axes": about, "datasets": sizes, "coordinateTransformations": both}
    if version == "0.4":
        group.attrs["multiscales"] = [image | {"version": version}]
    else:
        group.attrs["ome"] = {"version": version, "multiscales": [image]}


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_ome_zarr_is_read_with_its_scale(stack, tmp_path, version):
    many = np.stack([np.stack([stack, 255 - stack])] * 2)
    many[1] //= 2
    write_ome_zarr(tmp_path / "a", many, version)
    with pytest.raises(ValueError, match=r"has the axes T=2, C=2, Z=12 .* choose a channel"):
        read_frames(tmp_path / "a")
    reader = read_frames(tmp_path / "a", channel=1, time=1)
    assert (reader.axis, reader.count, reader.pixel_size) == ("Z", COUNT, pytest.approx(0.65))
    assert reader.positions == pytest.approx(2.5 * np.arange(COUNT))
    np.testing.assert_array_equal(np.stack(list(reader)), (255 - stack) // 2)
    # A group for each image, as bioformats2raw writes it, and fewer axes.
    for k, frames in enumerate((stack, stack[:4])):
        write_ome_zarr(tmp_path / "b.zarr" / str(k), frames, version, "zyx")
    (tmp_path / "b.zarr" / ("zarr.json" if version == "0.5" else ".zgroup")).write_text(
        '{"zarr_format": 3, "node_type": "group"}' if version == "0.5" else '{"zarr_format": 2}'
    )
    with pytest.raises(ValueError, match="holds 2 series of images: choose one"):
        read_frames(tmp_path / "b.zarr")
    assert read_frames(tmp_path / "b.zarr", series=1).count == 4


def test_other_groups_of_zarr_are_rejected(stack, tmp_path):
    """A plate, a group of arrays, version 0.3, and an image with its frames along the last axis."""
    write_ome_zarr(tmp_path / "a", np.moveaxis(stack, 0, -1), "0.4", "yxz")
    write_ome_zarr(tmp_path / "b", stack, "0.4", "zyx")
    zarr = pytest.importorskip("zarr")
    old = zarr.open_group(str(tmp_path / "b"), mode="a")
    old.attrs["multiscales"] = [{"axes": ["z", "y", "x"], "datasets": [{"path": "0"}]}]
    zarr.open_group(str(tmp_path / "c"), mode="w").create_group("A")
    for name in "abc":
        with pytest.raises(ValueError, match=rf"{name}: it must hold an array, or OME-Zarr 0.4 or"):
            read_frames(tmp_path / name)
