"""Sources that cannot be read as frames are rejected by file, page and fault; none in silence."""

from __future__ import annotations

import importlib.util
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microlib.io import read_frames, read_grey
from tests.io.test_formats import by_pillow, overwrite_tags, set_of_ome, tiff, write_folder


def rejects(source: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        list(read_frames(source))


def file_of(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def several_series(folder: Path, frames: NDArray) -> Path:
    tiff(folder / "a.tif", frames, photometric="minisblack")
    return tiff(folder / "a.tif", frames[0, :5], append=True)


def stack_for_a_frame(folder: Path, frames: NDArray) -> list[Path]:
    return [tiff(folder / "a.tif", frames, photometric="minisblack")]


def four_inks(folder: Path, frames: NDArray) -> Path:
    return tiff(folder / "a.tif", np.stack([frames[0]] * 4, -1), photometric="separated")


def frames_along_the_last_axis(folder: Path, frames: NDArray) -> Path:
    return tiff(folder / "a.tif", np.moveaxis(frames[:9], 0, -1), photometric="minisblack")


def axes_in_another_order(folder: Path, frames: NDArray) -> Path:
    how = {"photometric": "minisblack", "metadata": {"axes": "YXZ"}}
    return tiff(folder / "a.tif", np.moveaxis(frames, 0, -1), **how)


def zeroed_strip(folder: Path, frames: NDArray) -> Path:
    path = tiff(folder / "a.tif", frames, compression="zlib", photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        start = file.pages[2].aspage().dataoffsets[0]
    content = bytearray(path.read_bytes())
    content[start : start + 40] = bytes(40)
    return file_of(path, content)


def truncated_strip(folder: Path, frames: NDArray) -> Path:
    path = tiff(folder / "a.tif", frames[0], rowsperstrip=4, metadata=None)
    return file_of(path, path.read_bytes()[:-40])


def missing_file_of_a_set(folder: Path, frames: NDArray) -> Path:
    set_of_ome(folder / "set", frames[:5])
    (folder / "set" / "scan_z4.ome.tif").unlink()
    return folder / "set" / "scan_z0.ome.tif"


def another_size_in_a_folder(folder: Path, frames: NDArray) -> Path:
    write_folder(folder / "scan", frames)
    cv2.imwrite(str(folder / "scan" / "frame 12.png"), frames[0, :20])
    return folder / "scan"


def pattern_of_nothing(folder: Path, frames: NDArray) -> str:
    return f"{write_folder(folder / 'scan', frames)}/*.jpg"


def enormous_picture(folder: Path, frames: NDArray) -> list[Path]:
    """Write a picture whose header promises 10¹⁰ pixels."""
    cv2.imwrite(str(folder / "a.png"), frames[0])
    content = bytearray((folder / "a.png").read_bytes())
    struct.pack_into(">II", content, 16, 100_000, 100_000)
    struct.pack_into(">I", content, 29, zlib.crc32(content[12:29]))
    return [file_of(folder / "a.png", content)]


NO_IMAGE = ": damaged, too large or of an unknown format"


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (several_series, r"holds 2 series of images \(QYX \(12, 48, 56\), YX"),
        (stack_for_a_frame, r"a\.tif: it must hold one page to be one frame, got 12"),
        (four_inks, r"page 0 of .*a\.tif .* red, green and blue, got SEPARATED"),
        (frames_along_the_last_axis, r"come along the first axis, got shape \(48, 56, 9\)"),
        (axes_in_another_order, r"axes YXZ must end in rows Y and columns X"),
        (zeroed_strip, r"page 2 of .*a\.tif cannot be read"),
        (truncated_strip, r"a\.tif cannot be read: the file is cut off"),
        (missing_file_of_a_set, "metadata describe 5 pages, it holds .* must lie beside it"),
        (another_size_in_a_folder, r"frames\[12\], .*12\.png, .* \(48, 56\) .* \(20, 56\)"),
        (pattern_of_nothing, r"frames must hold images, got none in .*\*\.jpg"),
        (enormous_picture, "a.png" + NO_IMAGE),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_wrong_file_is_rejected_by_name_page_and_fault(stack, tmp_path, write, words):
    source = write(tmp_path, stack)
    rejects(source, words)
    if isinstance(source, list):  # of one file, which `read_grey` rejects in the same words
        with pytest.raises(ValueError, match="path must .*" + words):
            read_grey(source[0])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"", "a.png" + NO_IMAGE),
        ("a.mp4", b"no film", r"a\.mp4: not a video"),
        *(("a.tif", head, r"a\.tif") for head in (b"", b"no TIFF", b"II*\0", b"II*\0 cut off")),
        ("a.png", None, r"a\.png: no such file"),
        ("a.avi", None, r"a\.avi: no such file"),
        ("a.tif", None, r"frames cannot be read from .*a\.tif: no such file"),
        ("", None, "frames must hold images, got none in"),
    ],
)
def test_file_without_an_image_is_rejected(tmp_path, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    rejects([path] if path.suffix == ".png" else path, words)
    if path.suffix in (".png", ""):
        with pytest.raises(ValueError, match=r"must name an image, got .*: (damaged|no such file)"):
            read_grey(path)


def test_wrong_array_is_rejected_by_frame_and_fault(stack):
    one, other = stack[:2]
    holed = stack.astype(float)
    holed[3, 2, 1] = np.nan
    cases: list[tuple[object, str]] = [
        (holed, r"frames\[3\] must be finite, got 1 NaN"),
        ([one, other[:-1]], r"frames\[1\] must be uint8 of shape \(48, 56\) like the first"),
        ([one, other.astype(float)], r"frames\[1\] must be uint8 .* got float64"),
        ([one, np.stack([other] * 3, 2)], r"frames\[1\] must be uint8 .* got .* \(48, 56, 3\)"),
        ([one, stack[:1, :, :, None]], r"frames\[1\] must be uint8 of shape"),
        (one, r"frames must have shape \(any, any, any\)"),
        (np.zeros((3, 4, 5, 6)), r"frames must have shape .* in color, got \(3, 4, 5, 6\)"),
        (np.zeros((48, 56, 3), np.uint8), "must come along the first axis, got shape"),
        (np.moveaxis(stack, 0, -1)[..., :9], "must come along the first axis, got shape"),
        ([stack], r"frames\[0\] must be a grey or color image, got shape \(12, 48, 56\)"),
        ([one * 1j], r"frames\[0\] must hold real numbers, got complex128"),
        (np.zeros((2, 0, 5), np.uint8), r"frames\[0\] must have pixels, got shape"),
        (np.zeros((2, 5, 0), np.uint8), r"frames\[0\] must have pixels, got shape"),
        (7, "frames must be an array, a file, a folder or an iterable of images, got int"),
    ]
    for source, words in cases:
        rejects(source, words)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.npy", "a.gif"])
def test_truncated_file_is_rejected(stack, tmp_path, name, share):
    path = tmp_path / name
    if name == "a.npy":
        np.save(path, stack)
    elif name == "a.gif":
        by_pillow(path, stack)
    else:
        cv2.imwrite(str(path), stack[0])
    whole = path.read_bytes()
    file_of(path, whole[: int(share * len(whole))])
    if name in ("a.npy", "a.gif"):
        rejects(path, f"cannot be read from .*{name}")
        return
    rejects([stack[1], path], name + NO_IMAGE)
    with pytest.raises(ValueError, match=name + NO_IMAGE):
        read_grey(path)


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_more_pages_than_imagej_metadata_describe_are_rejected(stack, tmp_path, compression):
    """What an editor appended belongs to the stack or not: the file must say."""
    how = {"imagej": True, "compression": compression, "metadata": {"axes": "ZYX"}}
    path = tiff(tmp_path / "a.tif", stack[:5], **how)
    content = path.read_bytes()
    assert content.count(b"images=5") == content.count(b"slices=5") == 1
    file_of(path, content.replace(b"images=5", b"images=3").replace(b"slices=5", b"slices=3"))
    rejects(path, r"a\.tif: its metadata describe 3 pages, it holds 5")


@pytest.mark.parametrize("kind", ["imagej", "ome", "shaped", "bare", "appended"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_tiff_cut_off_after_any_page_is_rejected(stack, tmp_path, kind, compression):
    frames = stack[:5].astype({"imagej": np.uint16, "ome": np.float32}.get(kind, np.uint8))
    path = tmp_path / ("cut.ome.tif" if kind == "ome" else "cut.tif")
    if kind == "appended":
        for frame in frames:
            tiff(path, frame, append=True, metadata=None, compression=compression)
    else:
        options = {"imagej": True} if kind == "imagej" else {"photometric": "minisblack"}
        metadata = None if kind == "bare" else {"axes": "ZYX"}
        tiff(path, frames, metadata=metadata, compression=compression, **options)
    read = np.stack(list(read_frames(path)))
    assert read.dtype == frames.dtype
    np.testing.assert_array_equal(read, frames)
    with tifffile.TiffFile(path) as file:
        pages = [page.aspage() for page in file.pages]
        ends = {page.offset for page in pages[1:]}
        ends |= {page.dataoffsets[-1] + page.databytecounts[-1] for page in pages[:-1]}
    whole = path.read_bytes()
    for end in ends - {len(whole)}:
        rejects(file_of(path, whole[:end]), r"cut(\.ome)?\.tif")


def test_imagej_file_with_one_directory_is_rejected_when_cut_off(stack, tmp_path):
    """Beyond 4 GB ImageJ writes the values of all frames after one directory."""
    frames = stack[:5]
    path = tiff(tmp_path / "large.tif", frames, imagej=True, metadata={"axes": "ZYX"})
    with tifffile.TiffFile(path) as file:
        second = file.pages[1].offset
        order, first = file.byteorder, file.pages[0].offset
        content = bytearray(path.read_bytes())
    entries = struct.unpack_from(order + "H", content, first)[0]
    struct.pack_into(order + "I", content, first + 2 + 12 * entries, 0)
    del content[second:]
    reader = read_frames(file_of(path, content))
    assert (reader.count, reader.axis) == (5, "Z")
    np.testing.assert_array_equal(np.stack(list(reader)), frames)
    end = content.index(frames.tobytes()) + frames.nbytes
    assert len(list(read_frames(file_of(path, content[:end])))) == 5
    for missing in (1, frames[0].size, 3 * frames[0].size, 4 * frames[0].size):
        rejects(file_of(path, content[: end - missing]), r"large\.tif")


@pytest.mark.parametrize("compression", ["tiff_lzw", "packbits", "jpeg", "tiff_deflate"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_page_with_zeroed_data_is_rejected(tmp_path, compression, share):
    """As after a lost connection. LZW and PackBits have no checksum: the values end too early."""
    smooth = np.add.outer(np.arange(96), 2 * np.arange(80)).astype(np.uint8)
    path = by_pillow(tmp_path / "a.tif", np.stack([smooth] * 3), compression=compression)
    assert len(list(read_frames(path))) == 3
    with tifffile.TiffFile(path) as file:
        page = file.pages[1].aspage()
        spans = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    content = bytearray(path.read_bytes())
    cut = int(share * sum(count for _, count in spans))
    for offset, count in spans:
        kept = min(max(cut, 0), count)
        content[offset + kept : offset + count] = bytes(count - kept)
        cut -= count
    rejects(file_of(path, content), r"page 1 of .*a\.tif cannot be read")


def test_broken_chain_of_pages_is_rejected(stack, tmp_path):
    path = tmp_path / "a.tif"
    for frame in stack[:5]:
        tiff(path, frame, append=True, metadata=None)
    with tifffile.TiffFile(path) as file:
        at = file.pages[2].offset
        at += 2 + 12 * struct.unpack("<H", path.read_bytes()[at : at + 2])[0]
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, at, len(content) + 1000)
    rejects(file_of(path, content), r"a\.tif: it is damaged behind page 2")


@pytest.mark.skipif(bool(importlib.util.find_spec("imagecodecs")), reason="it decodes JPEG 2000")
def test_error_names_the_package_for_an_unknown_compression(stack, tmp_path):
    tiff(tmp_path / "a.tif", stack, photometric="minisblack", metadata=None)
    rejects(
        overwrite_tags(tmp_path / "a.tif", Compression=34712),
        r"page 0 of .*a\.tif cannot be read: .*JPEG2000.* requires the .imagecodecs. package",
    )


def test_error_names_a_picture_that_was_removed(stack, tmp_path):
    folder = write_folder(tmp_path / "scan", stack)
    for source in (folder, (folder / f"frame {k}.png" for k in range(len(stack)))):
        frames = iter(read_frames(source))
        assert len([next(frames) for _ in range(3)]) == 3
        kept = (folder / "frame 3.png").read_bytes()
        (folder / "frame 3.png").unlink()
        with pytest.raises(ValueError, match=r"read from .*frame 3\.png: no such file"):
            next(frames)
        file_of(folder / "frame 3.png", kept)


@pytest.mark.parametrize("change", ["another stack", "one page more", "one file"])
def test_file_that_changes_while_it_is_read_is_rejected(stack, tmp_path, change):
    how = {"metadata": None, "photometric": "minisblack"}
    path = tiff(tmp_path / "a.tif", stack[:4], **how)
    if change == "one file":
        path = write_folder(tmp_path / "scan", stack[:4])
    frames = iter(read_frames(path))
    next(frames)
    if change == "one file":
        cv2.imwrite(str(path / "frame 0.png"), stack[7])
    else:
        tiff(path, 255 - stack[:4], **how, append=change == "one page more")
    with pytest.raises(
        ValueError, match=r"must not change while they are read, got .*(a.tif|0.png)"
    ):
        list(frames)
