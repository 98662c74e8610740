"""Every kind of source gives the frames that were written into it, and the axes that it has."""

import importlib.util
import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import ExifTags, Image

from microlib.io import read_frames, read_grey
from tests.io.conftest import COUNT
from tests.scenes import files as make


def assert_frames(source: object, expected: NDArray, **options: object) -> None:
    """Compare the frames; read twice unless the source is an iterator."""
    reader = read_frames(source, **options)
    assert reader.count in (None, len(expected))
    assert reader.shape == expected.shape[1:3]
    assert reader.color == (expected.ndim == 4)
    for _ in range(1 if hasattr(source, "__next__") else 2):
        found = np.stack(list(reader))
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


def zarr_array(folder: Path, frames: NDArray) -> object:
    zarr = pytest.importorskip("zarr")
    how = {"shape": frames.shape, "dtype": frames.dtype}
    array = zarr.open(str(folder / "a.zarr"), mode="w", **how)
    array[:] = frames
    return array


def files(folder: Path, frames: NDArray) -> list[Path]:
    path = make.pictures(folder / "scan", frames)
    return [path / f"frame {k}.png" for k in range(len(frames))]


#: Every source of 8- and 16-bit grey levels that returns them unchanged.
SOURCES: dict[str, Callable[[Path, NDArray], object]] = {
    "array": lambda _, frames: frames,
    "big-endian array": lambda _, frames: frames.astype(frames.dtype.newbyteorder(">")),
    "list": lambda _, frames: list(frames),
    "iterator": lambda _, frames: iter(frames),
    "one buffer": lambda _, frames: make.one_buffer(frames),
    "lazy array": lambda _, frames: make.Lazy(frames),
    "zarr array": zarr_array,
    "list of files": files,
    "list of TIFF": lambda to, frames: [
        make.tiff(to / f"{k}.tif", frame, photometric="miniswhite", compression="zlib")
        for k, frame in enumerate(frames)
    ],
    "iterator of files": lambda to, frames: iter(files(to, frames)),
    "folder": lambda to, frames: make.pictures(to / "scan [3]", frames),
    "pattern": lambda to, frames: f"{make.pictures(to / 'scan', frames)}/frame*.png",
    "pattern in brackets": lambda to, frames: make.pictures(to / "a[3]", frames) / "f*[0-9]*.png",
    "pages": lambda to, frames: make.pages(to / "a.tif", frames),
    "white is zero": lambda to, frames: make.tiff(to / "a.tif", frames, photometric="miniswhite"),
    "white is zero, compressed": lambda to, frames: make.tiff(
        to / "a.tif", frames, photometric="miniswhite", compression="zlib"
    ),
    **{kind: lambda to, frames, kind=kind: make.tiff_of(kind, to, frames) for kind in make.TIFFS},
    "Pillow": lambda to, frames: make.by_pillow(to / "a.tif", frames),
}  # fmt: skip


@pytest.mark.parametrize("kind", SOURCES)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_levels_are_returned_as_stored(stack, tmp_path, kind, dtype):
    frames = stack.astype(dtype) * (1 if dtype is np.uint8 else 200)
    # color=True leaves grey as it is
    assert_frames(SOURCES[kind](tmp_path, frames), frames, color=True)


@pytest.mark.parametrize("compression", ["tiff_lzw", None])
def test_files_written_by_pillow_give_their_levels_and_colors(stack, tmp_path, compression):
    """Pillow decodes the compressions that tifffile cannot."""
    path, color = tmp_path / "a.tif", np.stack([stack, stack // 2, 255 - stack], axis=-1)
    assert_frames(make.by_pillow(path, color, compression=compression), color, color=True)
    make.by_pillow(path, np.stack([stack, 255 - stack], axis=-1), compression=compression)
    assert_frames(path, stack, color=True)  # without alpha
    Image.fromarray(np.stack([stack[0], 255 - stack[0]], axis=-1)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), stack[0])
    make.by_pillow(path, stack, compression=compression)
    assert_frames(make.overwrite_tags(path, PhotometricInterpretation=0), stack)


@pytest.mark.parametrize("compression", ["zlib", None])
def test_color_frames_are_returned_as_given_or_as_luma(stack, tmp_path, compression):
    color = np.stack([stack, stack // 2, 255 - stack], axis=-1)
    folder = make.pictures(tmp_path / "scan", np.ascontiguousarray(color[..., ::-1]))
    opaque = np.concatenate([color, color[..., :1]], axis=3)
    how = {"photometric": "rgb", "compression": compression}
    whole = make.tiff(tmp_path / "whole.tif", color, **how)
    how["planarconfig"] = "separate"
    planes = make.tiff(tmp_path / "planes.tif", np.moveaxis(color, -1, 1), **how)
    single = make.tiff(tmp_path / "single.tif", np.moveaxis(color[0], -1, 0), **how)
    # Luma of ITU-R BT.601, rounded.
    luma = color.astype(float) @ [0.299, 0.587, 0.114]
    for source in (color, opaque, make.Lazy(color), folder, whole, planes):
        assert_frames(source, color, color=True)
        np.testing.assert_allclose(np.stack(list(read_frames(source))), luma, atol=0.6)
    for image in (single, folder / "frame 0.png"):
        assert_frames([image], color[:1], color=True)
        np.testing.assert_allclose(read_grey(image), luma[0], atol=0.6)


@pytest.mark.filterwarnings("ignore:.*tifffile.TiffWriter.write")
def test_three_images_that_tifffile_marks_as_colors_give_a_warning(stack, tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, stack[:3])
    with pytest.warns(UserWarning, match=r'a\.tif is read as one color image: .*"minisblack"'):
        assert read_frames(path).count == 1
    tifffile.imwrite(path, stack[:3], photometric="minisblack")
    assert_frames(path, stack[:3])


def test_other_types_of_numbers_become_float32(stack, tmp_path):
    narrow = stack[:, :8, :2]  # twelve frames; the last axis could not be theirs
    for dtype in (np.int16, np.float64, np.int64):
        assert_frames(narrow.astype(dtype), narrow.astype(np.float32))
    bits = make.tiff(tmp_path / "a.tif", stack > 99, **make.GREY)
    assert_frames(bits, np.where(stack > 99, np.uint8(255), np.uint8(0)))


def test_packed_12_bits_are_read_and_10_bits_need_imagecodecs(stack, tmp_path):
    levels = stack.astype(np.uint16) * 3 + 1
    assert_frames(make.packed(tmp_path / "a.tif", levels * 5, 12), levels * 5)
    path = make.packed(tmp_path / "b.tif", levels, 10)
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
    path = make.tiff(tmp_path / "p.tif", numbers, photometric="palette", colormap=colormap)
    read = next(iter(read_frames(path, color=True)))
    np.testing.assert_array_equal(read, levels.T[numbers])
    with Image.open(path) as opened:
        np.testing.assert_array_equal(read, np.asarray(opened.convert("RGB")))


def test_imagej_display_palette_is_ignored(stack, tmp_path):
    """ImageJ stores its display colors (Fire, Blue) as a palette; the pixels are grey levels."""
    table = np.zeros((3, 256), np.uint16)
    table[2] = 257 * np.arange(256)[::-1]
    how = {"photometric": "palette", "colormap": table}
    assert_frames(make.tiff_of("ImageJ", tmp_path, stack, **how), stack)


def test_jpeg_and_its_orientation_are_read(tmp_path):
    """JPEG changes a smooth image by a grey level or two; it would change noise more."""
    smooth = np.linspace(20, 200, 64 * 48).reshape(48, 64).astype(np.uint8)
    path = make.by_pillow(tmp_path / "a.tif", smooth[None], compression="jpeg", quality=95)
    np.testing.assert_allclose(read_grey(path).astype(int), smooth, atol=3)
    turned = Image.Exif()
    turned[ExifTags.Base.Orientation] = 6  # the camera was held sideways
    Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=95, exif=turned)
    found = read_grey(tmp_path / "a.jpg").astype(int)
    np.testing.assert_allclose(found, np.rot90(smooth, -1), atol=3)


def test_one_file_of_a_split_ome_tiff_opens_the_whole_stack(stack, tmp_path):
    folder = make.set_of_ome(tmp_path / "set", stack)
    for source in (folder, folder / "scan_z2.ome.tif"):
        assert_frames(source, stack)
    reader = read_frames(folder / "scan_z2.ome.tif")
    assert reader.positions == pytest.approx(3.5 * np.arange(COUNT))


def test_tilde_is_home_only_before_a_slash(stack, tmp_path, monkeypatch):
    make.tiff(tmp_path / "~scan.tif", stack, **make.GREY)
    cv2.imwrite(str(tmp_path / "~a.png"), stack[0])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    make.pictures(tmp_path / "home" / "scan", stack)
    for source in ("~scan.tif", "./~scan.tif", "~/scan"):
        assert_frames(source, stack)
    names = ["~a.png", "~/scan/frame 1.png"]
    for source in (names, iter(names)):
        assert_frames(source, stack[:2])


def test_preview_beside_pages_is_no_frame(stack, tmp_path):
    """Cameras, and the programs of Olympus and FEI, store one after each page or at the end."""
    how = {"metadata": None, **make.GREY}
    for previews in ([0, 1, 2], [2]):
        with tifffile.TiffWriter(tmp_path / "a.tif") as file:
            for k, frame in enumerate(stack[:3]):
                file.write(frame, **how)
                if k in previews:
                    file.write(frame[::4, ::4], subfiletype=1, **how)
        assert_frames(tmp_path / "a.tif", stack[:3])


# --- Axes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", make.TIFFS)
@pytest.mark.parametrize(
    ("axes", "lengths", "options", "frames", "axis"),
    [
        ("ZCYX", (3, 2), {"channel": 1}, [1, 3, 5], "Z"),
        ("TZYX", (2, 3), {"time": 1}, [3, 4, 5], "Z"),
        ("TCYX", (3, 2), {"channel": 1}, [1, 3, 5], "T"),
        ("CYX", (6,), {"channel": 2}, [2], ""),
        # An axis that is named, as Python programs save a focal stack by default, or Fiji does.
        *((f"{name}YX", (6,), {"axis": name}, range(6), "") for name in "CTZ"),
        ("TCYX", (3, 2), {"axis": "C", "time": 1}, [2, 3], ""),
        ("TCYX", (3, 2), {"axis": "T", "channel": 1}, [1, 3, 5], ""),
    ],
)
def test_axis_channel_and_time_select_a_stack(
    stack, tmp_path, kind, axes, lengths, options, frames, axis
):
    many = stack[: math.prod(lengths)].reshape(*lengths, *stack.shape[1:])
    path = make.tiff_of(kind, tmp_path, many, axes)
    assert_frames(path, stack[frames], **options)
    assert read_frames(path, **options).axis == axis
    if "C" in axes or len(lengths) > 1:
        found = ", ".join(f"{a}={n}" for a, n in zip(axes, lengths, strict=False))
        with pytest.raises(ValueError, match=f"has the axes {found} besides .* choose a channel"):
            read_frames(path)
    for name in options.keys() - {"axis"}:
        count = lengths[axes.index("C" if name == "channel" else "T")]
        with pytest.raises(ValueError, match=rf"it has {count} along axis ., got number {count} "):
            read_frames(path, **options | {name: count})
    for other in {"C", "T", "Z"} - {options.get("axis")} if "axis" in options else ():
        one_axis = rf"has the axis .=\d+ and no axis {other}: leave out axis \(--axis\)"
        several = r'choose a channel or a time, or axis="C" \(--axis C'
        with pytest.raises(ValueError, match=several if len(lengths) > 1 else one_axis):
            read_frames(path, **options | {"axis": other})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axis": "C"}, "axis must be left out for frames without that axis, got"),
        ({"axis": "X"}, "axis must be one of C, T, Z, got 'X'"),
        ({"channel": 0}, "channel must be left out for frames without that"),
        ({"time": 0}, "time must be left out for frames without that"),
    ],
)
def test_axis_or_number_is_rejected_where_frames_have_no_such_axis(stack, options, message):
    for source in (stack, [stack[0]], read_frames(stack)):
        with pytest.raises(ValueError, match=message):
            read_frames(source, **options)


def test_axis_of_color_frames_is_read_from_metadata(stack, tmp_path):
    for axis in "ZTQ":
        frames = np.repeat(stack[..., None], 3, axis=3)
        path = make.tiff_of("tifffile", tmp_path, frames, f"{axis}YXS", photometric="rgb")
        reader = read_frames(path, color=True)
        assert (reader.axis, reader.count, reader.color) == (axis, COUNT, True)


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


@pytest.mark.parametrize(("letter", "name"), [("C", "channel"), ("T", "time")])
def test_only_channel_or_time_of_a_file_is_number_zero(stack, tmp_path, letter, name):
    path = make.tiff(
        tmp_path / "a.ome.tif", stack[:, None], ome=True,
        metadata={"axes": f"Z{letter}YX", "PhysicalSizeZ": 3.0},
    )  # fmt: skip
    frames = read_frames(path, **{name: 0})
    assert (frames.axis, frames.positions.tolist()) == ("Z", [3.0 * k for k in range(len(stack))])
    assert_frames(path, stack, **{name: 0})
    with pytest.raises(ValueError, match=f"has 1 along axis {letter}, got number 1"):
        read_frames(path, **{name: 1})
    assert_frames(
        make.tiff(path, stack[:1], ome=True, metadata={"axes": "ZYX"}), stack[:1], axis="Z"
    )
