"""Frames from memory and files: the same values, and faults named by frame and page."""

import importlib.util
import logging
import math
import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image as PIL_Image

from microlib.io import read_frames, read_grey


def read_stack(source, **options):
    return np.stack(list(read_frames(source, **options)))


@pytest.fixture
def stack():
    return np.random.default_rng(0).integers(0, 256, (5, 24, 31)).astype(np.uint8)


def rejects(source, words):
    with pytest.raises(ValueError, match=words):
        list(read_frames(source))


def test_other_number_types_become_float32(stack):
    for dtype in (np.int16, np.float64, np.int64):
        assert read_stack(stack.astype(dtype)).dtype == np.float32


def test_error_names_the_damaged_page(stack, tmp_path):
    path = tmp_path / "damaged.tif"
    tifffile.imwrite(path, stack, compression="zlib", metadata=None, photometric="minisblack")
    with tifffile.TiffFile(path) as tiff:
        start = tiff.pages[2].aspage().dataoffsets[0]
    content = bytearray(path.read_bytes())
    content[start : start + 40] = bytes(40)
    path.write_bytes(content)
    rejects(path, r"page 2 of .*damaged\.tif cannot be read")


@pytest.mark.parametrize("content", [b"", b"not a TIFF at all", b"II*\0", b"II*\0 cut off"])
def test_file_that_is_no_tiff_is_rejected(content, tmp_path):
    path = tmp_path / "wrong.tif"
    path.write_bytes(content)
    rejects(path, r"wrong\.tif")


def test_error_names_frame_and_fault(stack, tmp_path):
    (tmp_path / "text.png").write_text("no image")
    tifffile.imwrite(tmp_path / "many.tif", stack, photometric="minisblack")
    ink = np.zeros((5, 6, 4), np.uint8)
    tifffile.imwrite(tmp_path / "ink.tif", ink, photometric="separated")
    holed = stack.astype(float)
    holed[3, 2, 1] = np.nan
    cases = [
        (holed, r"frames\[3\] must be finite, got 1 NaN"),
        (
            [stack[0], stack[1][:-1]],
            r"frames\[1\] must be uint8 of shape \(24, 31\) like the first",
        ),
        ([stack[0], stack[1].astype(float)], r"frames\[1\] must be uint8 .* got float64"),
        (
            [stack[0], np.stack([stack[1]] * 3, axis=2)],
            r"frames\[1\] must be uint8 of shape .* got .* \(24, 31, 3\)",
        ),
        (stack[0], r"frames must have shape \(any, any, any\)"),
        ([stack], r"frames\[0\] must be a grey or color image, got shape \(5, 24, 31\)"),
        ([stack[0] * 1j], r"frames\[0\] must hold real numbers, got complex128"),
        (7, "frames must be an array, a file, a folder or an iterable of images, got int"),
        ([tmp_path / "text.png"], r"text\.png: damaged, too large or of an unknown format"),
        ([stack[0], stack[:1, :, :, None]], r"frames\[1\] must be uint8 of shape"),
        (tmp_path / "ink.tif", r"page 0 of .*ink\.tif .* red, green and blue, got SEPARATED"),
        ([tmp_path / "many.tif"], r"many\.tif: it must hold one page to be one frame, got 5"),
    ]
    for source, words in cases:
        rejects(source, words)
    with pytest.raises(ValueError, match=r"path must .*many\.tif: it must hold one page .* got 5"):
        read_grey(tmp_path / "many.tif")


def shaped(stack, *lengths):
    return stack[: math.prod(lengths)].reshape(*lengths, *stack.shape[1:])


@pytest.mark.parametrize("kind", ["imagej", "ome", "shaped"])
@pytest.mark.parametrize(
    ("axes", "lengths"), [("ZCYX", (2, 2)), ("TZYX", (2, 2)), ("TCYX", (2, 2)), ("CYX", (4,))]
)
def test_channel_and_time_select_a_stack(stack, tmp_path, kind, axes, lengths):
    path = tmp_path / ("many.ome.tif" if kind == "ome" else "many.tif")
    options = {"imagej": True} if kind == "imagej" else {"photometric": "minisblack"}
    tifffile.imwrite(path, shaped(stack, *lengths), metadata={"axes": axes}, **options)
    lengths_text = ", ".join(f"{a}={n}" for a, n in zip(axes, lengths, strict=False))
    rejects(path, f"has the axes {lengths_text} besides rows and columns, .* choose a channel")
    wanted = {"ZCYX": {"channel": 1}, "TZYX": {"time": 1}, "CYX": {"channel": 2}}
    choice = wanted.get(axes, {"channel": 1})
    reader = read_frames(path, **choice)
    frames = shaped(stack, *lengths)
    expected = {"TZYX": frames[1], "CYX": frames[2:3]}.get(
        axes, frames[:, 1] if len(lengths) > 1 else None
    )
    np.testing.assert_array_equal(np.stack(list(reader)), expected)
    assert reader.axis == {"ZCYX": "Z", "TZYX": "Z", "TCYX": "T", "CYX": ""}[axes]
    count = lengths[axes.index("C" if "channel" in choice else "T")]
    with pytest.raises(ValueError, match=rf"it has {count} along axis ., got number {count} "):
        read_frames(path, **dict.fromkeys(choice, count))


@pytest.mark.parametrize("kind", ["imagej", "ome", "shaped", "bare", "appended"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_tiff_cut_off_after_any_page_is_rejected(stack, tmp_path, kind, compression):
    stack = stack.astype({"imagej": np.uint16, "ome": np.float32}.get(kind, np.uint8))
    path = tmp_path / ("cut.ome.tif" if kind == "ome" else "cut.tif")
    if kind == "appended":
        for frame in stack:
            tifffile.imwrite(path, frame, append=True, metadata=None, compression=compression)
    else:
        options = {"imagej": True} if kind == "imagej" else {"photometric": "minisblack"}
        metadata = None if kind == "bare" else {"axes": "ZYX"}
        tifffile.imwrite(path, stack, metadata=metadata, compression=compression, **options)
    read = read_stack(path)
    assert read.dtype == stack.dtype
    np.testing.assert_array_equal(read, stack)
    with tifffile.TiffFile(path) as tiff:
        pages = [page.aspage() for page in tiff.pages]
        ends = {page.offset for page in pages[1:]}
        ends |= {page.dataoffsets[-1] + page.databytecounts[-1] for page in pages[:-1]}
    whole = path.read_bytes()
    for end in ends - {len(whole)}:
        path.write_bytes(whole[:end])
        rejects(path, r"cut(\.ome)?\.tif")


def test_page_with_a_truncated_strip_is_rejected(stack, tmp_path):
    path = tmp_path / "strips.tif"
    tifffile.imwrite(path, stack[0], rowsperstrip=4, metadata=None, photometric="minisblack")
    np.testing.assert_array_equal(list(read_frames(path)), stack[:1])
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ValueError, match=r"strips\.tif cannot be read: the file is cut off"):
        read_frames(path)


def test_file_with_several_series_is_rejected(stack, tmp_path):
    path = tmp_path / "series.tif"
    tifffile.imwrite(path, stack, photometric="minisblack")
    tifffile.imwrite(path, stack[0, :5], append=True)
    with pytest.raises(ValueError, match=r"holds 2 series of images \(QYX \(5, 24, 31\), YX"):
        list(read_frames(path))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.5, 0.98])
def test_truncated_picture_is_rejected(stack, tmp_path, suffix, share):
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), stack[0])
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    for read in (lambda: list(read_frames([stack[1], path])), lambda: read_grey(path)):
        with pytest.raises(ValueError, match=r"a\.(jpg|png): .*damaged"):
            read()


def test_header_of_an_impossible_size_is_rejected(stack, tmp_path):
    path = tmp_path / "huge.png"
    cv2.imwrite(str(path), stack[0])
    content = bytearray(path.read_bytes())
    struct.pack_into(">II", content, 16, 100_000, 100_000)
    struct.pack_into(">I", content, 29, zlib.crc32(content[12:29]))
    path.write_bytes(content)
    for read in (lambda: list(read_frames([path])), lambda: read_grey(path)):
        with pytest.raises(ValueError, match=r"huge\.png: damaged, too large or"):
            read()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("photometric", ["minisblack", "miniswhite"])
def test_miniswhite_values_are_returned_as_stored(stack, tmp_path, dtype, compression, photometric):
    path, image = tmp_path / "a.tif", stack[0].astype(dtype)
    tifffile.imwrite(path, image, photometric=photometric, compression=compression)
    for read in (read_grey(path), read_stack(path)[0], read_stack([path])[0]):
        assert read.dtype == dtype
        np.testing.assert_array_equal(read, image)


def test_one_bit_pixels_become_0_and_255(stack, tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", stack > 99, photometric="minisblack")
    read = read_stack(tmp_path / "a.tif")
    np.testing.assert_array_equal(read, np.where(stack > 99, np.uint8(255), np.uint8(0)))


def compressed(path, stack, compression):
    first, *others = (PIL_Image.fromarray(frame) for frame in stack)
    first.save(path, save_all=True, append_images=others, compression=compression)


def test_miniswhite_lzw_is_returned_as_stored(stack, tmp_path):
    path = tmp_path / "a.tif"
    compressed(path, stack, "tiff_lzw")
    with tifffile.TiffFile(path, mode="r+") as tiff:
        for page in tiff.pages:
            page.tags["PhotometricInterpretation"].overwrite(0)
    np.testing.assert_array_equal(read_stack(path), stack)


def test_jpeg_and_its_orientation_are_read(tmp_path):
    """A smooth image loses a grey level or two; noise would lose more."""
    smooth = np.linspace(20, 200, 64 * 48).reshape(48, 64).astype(np.uint8)
    PIL_Image.fromarray(smooth).save(tmp_path / "a.tif", compression="jpeg", quality=95)
    (frame,) = read_frames(tmp_path / "a.tif")
    assert np.abs(frame.astype(int) - smooth).max() <= 3
    turned = PIL_Image.Exif()
    turned[0x0112] = 6  # the camera was held sideways
    PIL_Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=95, exif=turned)
    assert np.abs(read_grey(tmp_path / "a.jpg").astype(int) - np.rot90(smooth, -1)).max() <= 3


def test_error_names_the_package_for_an_unknown_compression(stack, tmp_path):
    if importlib.util.find_spec("imagecodecs"):
        pytest.skip("imagecodecs knows it")
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, stack, photometric="minisblack", metadata=None)
    with tifffile.TiffFile(path, mode="r+") as tiff:
        for page in tiff.pages:
            page.tags["Compression"].overwrite(34712)
    rejects(
        path, r"page 0 of .*a\.tif cannot be read: .*JPEG2000.* requires the .imagecodecs. package"
    )


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_more_pages_than_imagej_metadata_describe_are_rejected(stack, tmp_path, compression):
    """What an editor appended belongs to the stack or not: the file must say."""
    path = tmp_path / "more.tif"
    tifffile.imwrite(path, stack, imagej=True, compression=compression, metadata={"axes": "ZYX"})
    content = path.read_bytes()
    assert content.count(b"images=5") == content.count(b"slices=5") == 1
    path.write_bytes(content.replace(b"images=5", b"images=3").replace(b"slices=5", b"slices=3"))
    rejects(path, r"more\.tif: its metadata describe 3 pages, it holds 5")


@pytest.mark.parametrize("compression", ["tiff_lzw", None])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_lzw_of_colors_and_16_bits_is_read(stack, tmp_path, compression, dtype):
    """Pillow reads what tifffile has no codec for."""
    path, given = tmp_path / "a.tif", np.stack([stack, stack // 2, 255 - stack], axis=-1)
    if dtype == np.uint8:
        compressed(path, given, compression)
        np.testing.assert_array_equal(read_stack(path, color=True), given)
    large = stack.astype(np.uint16) * 100
    compressed(path, large[:1], compression)
    np.testing.assert_array_equal(read_grey(path), large[0])
    compressed(path, large, compression)
    np.testing.assert_array_equal(read_stack(path), large)


def one_directory(path, stack, **options):
    """Write a stack as ImageJ does beyond 4 GB: the values of all frames after one directory."""
    tifffile.imwrite(path, stack, imagej=True, metadata={"axes": "ZYX"}, **options)
    with tifffile.TiffFile(path) as tiff:
        second = tiff.pages[1].offset
        order, first = tiff.byteorder, tiff.pages[0].offset
        content = bytearray(path.read_bytes())
    entries = struct.unpack_from(order + "H", content, first)[0]
    struct.pack_into(order + "I", content, first + 2 + 12 * entries, 0)
    del content[second:]
    path.write_bytes(content)
    return bytes(content)


def test_truncated_imagej_file_with_one_directory_is_rejected(stack, tmp_path):
    path = tmp_path / "large.tif"
    whole = one_directory(path, stack)
    reader = read_frames(path)
    assert (reader.count, reader.axis) == (5, "Z")
    end = whole.index(stack.tobytes()) + stack.nbytes
    assert np.stack(list(reader)).tobytes() == stack.tobytes()
    for size in (end - 1, end - stack[0].size, end - 3 * stack[0].size, end - 4 * stack[0].size):
        path.write_bytes(whole[:size])
        rejects(path, r"large\.tif")
    path.write_bytes(whole[:end])
    assert len(list(read_frames(path))) == 5


def test_axis_of_frames_is_read_from_metadata(stack, tmp_path):
    for axes, axis in (("ZYX", "Z"), ("TYX", "T"), ("QYX", "Q")):
        tifffile.imwrite(
            tmp_path / "a.tif", stack, photometric="minisblack", metadata={"axes": axes}
        )
        assert read_frames(tmp_path / "a.tif").axis == axis
    assert read_frames(stack).axis == ""
    rgb = np.repeat(stack[..., None], 3, axis=3)
    tifffile.imwrite(tmp_path / "a.tif", rgb, photometric="rgb", metadata={"axes": "ZYXS"})
    reader = read_frames(tmp_path / "a.tif")
    assert (reader.axis, reader.count, reader.color) == ("Z", 5, True)
    tifffile.imwrite(tmp_path / "a.tif", stack[:1], photometric="minisblack")
    assert read_frames(tmp_path / "a.tif").count == 1


@pytest.mark.parametrize("compression", ["tiff_lzw", "packbits", "jpeg", "tiff_deflate"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_page_with_zeroed_data_is_rejected(tmp_path, compression, share):
    """As after a lost connection. LZW and PackBits have no checksum: the values end too early."""
    path = tmp_path / "a.tif"
    smooth = np.add.outer(np.arange(96), 2 * np.arange(80)).astype(np.uint8)
    compressed(path, np.stack([smooth] * 3), compression)
    assert len(list(read_frames(path))) == 3
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages[1].aspage()
        spans = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    content = bytearray(path.read_bytes())
    cut = int(share * sum(count for _, count in spans))
    for offset, count in spans:
        kept = min(max(cut, 0), count)
        content[offset + kept : offset + count] = bytes(count - kept)
        cut -= count
    path.write_bytes(content)
    rejects(path, r"page 1 of .*a\.tif cannot be read")


@pytest.mark.parametrize("level", [logging.NOTSET, logging.CRITICAL])
def test_broken_chain_of_pages_is_rejected(stack, tmp_path, level):
    path = tmp_path / "a.tif"
    for frame in stack:
        tifffile.imwrite(path, frame, append=True, metadata=None)
    with tifffile.TiffFile(path) as tiff:
        at = tiff.pages[2].offset
        at += 2 + 12 * struct.unpack("<H", path.read_bytes()[at : at + 2])[0]
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, at, len(content) + 1000)
    path.write_bytes(content)
    log = logging.getLogger("tifffile")
    before, log.level = log.level, level
    try:
        rejects(path, r"a\.tif: it is damaged behind page 2")
    finally:
        log.level = before


def test_unreadable_vendor_tag_is_ignored(stack, tmp_path, caplog):
    """MetaMorph's, of a time that is 0, as Bruker writes it: tifffile logs it."""
    path, at = tmp_path / "a.tif", 8
    frame = stack[0].copy()
    frame[0, :16] = 0
    for _ in range(2):  # the tag points to zeros in the picture, whose place is then known
        tags = [(33628, "I", 4, (16, at, 17, at), True), (33629, "2I", 1, (1, 1), True)]
        tifffile.imwrite(path, frame, extratags=tags, photometric="minisblack")
        with tifffile.TiffFile(path) as tiff:
            at = tiff.pages[0].dataoffsets[0]
    for source in (path, [path]):
        np.testing.assert_array_equal(list(read_frames(source)), [frame])


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_planar_rgb_is_read_as_rgb(stack, tmp_path, compression):
    color = np.stack([stack, stack // 2, 255 - stack], axis=1)
    tifffile.imwrite(
        tmp_path / "a.tif", color, photometric="rgb", planarconfig="separate",
        compression=compression,
    )  # fmt: skip
    reader = read_frames(tmp_path / "a.tif", color=True)
    assert (reader.count, reader.shape) == (5, (24, 31))
    np.testing.assert_array_equal(np.stack(list(reader)), np.moveaxis(color, 1, -1))
    tifffile.imwrite(tmp_path / "b.tif", color[0], photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(
        read_stack([tmp_path / "b.tif"], color=True)[0], np.moveaxis(color[0], 0, -1)
    )


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_alpha_of_a_grey_image_is_dropped(stack, tmp_path, compression):
    pages = [PIL_Image.fromarray(np.stack([f, 255 - f], axis=-1), "LA") for f in stack]
    pages[0].save(
        tmp_path / "a.tif", save_all=True, append_images=pages[1:], compression=compression
    )
    reader = read_frames(tmp_path / "a.tif", color=True)
    assert not reader.color
    np.testing.assert_array_equal(np.stack(list(reader)), stack)
    pages[0].save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), stack[0])


def packed(path, frames, bits):
    """Write frames as cameras do that put three bytes where two numbers of 12 bits are."""
    rows, cols = frames[0].shape
    high_first = np.unpackbits(
        frames.astype(">u2").view(np.uint8).reshape(len(frames), rows, cols, 2), axis=3
    )
    data = np.packbits(high_first[..., -bits:].reshape(len(frames), rows, -1), axis=2)
    for page in data:
        tifffile.imwrite(path, page, append=True, metadata=None, photometric="minisblack")
    with tifffile.TiffFile(path, mode="r+") as tiff:
        for page in tiff.pages:
            page.tags["BitsPerSample"].overwrite(bits)
            page.tags["ImageWidth"].overwrite(cols)


def test_packed_12_bits_are_read_and_10_bits_name_the_package(stack, tmp_path):
    levels = stack[:, :, :28].astype(np.uint16) * 3 + 1
    packed(tmp_path / "a.tif", levels * 5, 12)
    np.testing.assert_array_equal(read_stack(tmp_path / "a.tif"), levels * 5)
    packed(tmp_path / "b.tif", levels, 10)
    if importlib.util.find_spec("imagecodecs"):
        np.testing.assert_array_equal(read_stack(tmp_path / "b.tif"), levels)
    else:
        rejects(tmp_path / "b.tif", r"requires the .imagecodecs. package")


def test_member_of_a_multi_file_ome_tiff_opens_the_whole_set(stack, tmp_path):
    """And a folder of them has one frame in each."""
    names = [f"scan_z{k}.ome.tif" for k in range(5)]
    blocks = "".join(
        f'<TiffData FirstZ="{k}" IFD="0" PlaneCount="1"><UUID FileName="{name}">urn:uuid:'
        f"{k:032}</UUID></TiffData>"
        for k, name in enumerate(names)
    )
    for k, name in enumerate(names):
        xml = (
            f'<?xml version="1.0" encoding="UTF-8"?><OME UUID="urn:uuid:{k:032}">'
            '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" '
            f'SizeX="31" SizeY="24" SizeZ="5" SizeC="1" SizeT="1" '
            f'PhysicalSizeZ="3.5">{blocks}</Pixels></Image></OME>'
        )
        tifffile.imwrite(tmp_path / name, stack[k], description=xml, metadata=None)
    for source in (tmp_path / names[2], tmp_path):
        np.testing.assert_array_equal(read_stack(source), stack)
    assert read_frames(tmp_path / names[2]).positions == pytest.approx(3.5 * np.arange(5))
    (tmp_path / names[4]).unlink()
    rejects(tmp_path / names[0], "metadata describe 5 pages, it holds .* must lie beside it")


def test_series_selects_an_image_of_the_file(stack, tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.ome.tif") as file:
        file.write(stack, metadata={"axes": "ZYX", "PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0})
        file.write(
            stack[:4, :9], metadata={"axes": "ZYX", "PhysicalSizeX": 5.0, "PhysicalSizeY": 5.0}
        )
    for series, frames, size in ((0, stack, 2.0), (1, stack[:4, :9], 5.0)):
        reader = read_frames(tmp_path / "a.ome.tif", series=series)
        assert reader.pixel_size == size
        np.testing.assert_array_equal(np.stack(list(reader)), frames)
    rejects(tmp_path / "a.ome.tif", r"holds 2 series of images \(.*\): choose one")
    with pytest.raises(ValueError, match="holds 2 series"):
        read_frames(tmp_path / "a.ome.tif", series=2)
    for source in (stack, [stack[0]], read_frames(stack)):
        with pytest.raises(
            ValueError, match="channel must be left out for frames without that axis"
        ):
            read_frames(source, channel=0)
