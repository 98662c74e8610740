"""Sources that cannot be read as frames raise an error with the file, the page and the fault."""

import importlib.util
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib.io import read_frames, read_grey
from tests.scenes import files as make


def rejects(source: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        list(read_frames(source))


def bare(folder: Path, frames: NDArray, **options: object) -> Path:
    return make.tiff(folder / "a.tif", frames, **make.GREY | options)


def scan(folder: Path, frames: NDArray) -> Path:
    return make.pictures(folder / "scan", frames)


def part_of_a_set(folder: Path, frames: NDArray) -> Path:
    (make.set_of_ome(folder / "set", frames[:5]) / "scan_z4.ome.tif").unlink()
    return folder / "set" / "scan_z0.ome.tif"


def enormous_picture(folder: Path, frames: NDArray) -> list[Path]:
    """Write a picture whose header promises 10¹⁰ pixels."""
    values = bytearray(make.picture(folder / "a.png", frames[0]).read_bytes())
    struct.pack_into(">II", values, 16, 100_000, 100_000)
    struct.pack_into(">I", values, 29, zlib.crc32(values[12:29]))
    return [make.content(folder / "a.png", values)]


def broken_chain(folder: Path, frames: NDArray) -> Path:
    path = make.pages(folder / "a.tif", frames[:5])
    with tifffile.TiffFile(path) as file:
        at = file.pages[2].offset
    values = bytearray(path.read_bytes())
    at += 2 + 12 * struct.unpack_from("<H", values, at)[0]
    struct.pack_into("<I", values, at, len(values) + 1000)
    return make.content(path, values)


def holed(frame: NDArray) -> NDArray:
    frame = frame.astype(float)
    frame[2, 1] = np.nan
    return frame


NO_IMAGE = r"a\.png: damaged, too large or of an unknown format"
AXIS = "must come along the first axis, got shape"
#: Words of the error, and a function that returns the source. A list of one path is a picture,
#: which `read_grey` must reject in the same words.
REJECTED: list[tuple[str, Callable[[Path, NDArray], object]]] = [
    # TIFF.
    (r"holds 2 series of images \(QYX \(12, 48, 56\), YX",
        lambda to, frames: (bare(to, frames), bare(to, frames[0, :5], append=True))[1]),
    (r"a\.tif: it must hold one page to be one frame, got 12",
        lambda to, frames: [bare(to, frames)]),
    (r"page 0 of .*a\.tif .* red, green and blue, got SEPARATED",
        lambda to, frames: bare(to, np.moveaxis(frames[:4], 0, -1), photometric="separated")),
    (r"come along the first axis, got shape \(48, 56, 9\)",
        lambda to, frames: bare(to, np.moveaxis(frames[:9], 0, -1))),
    (r"axes YXZ must end in rows Y and columns X",
        lambda to, frames: make.tiff_of("tifffile", to, np.moveaxis(frames, 0, -1), "YXZ")),
    ("metadata describe 5 pages, it holds .* must lie beside it", part_of_a_set),
    (r"a\.tif: it is damaged behind page 2", broken_chain),
    (r"page 0 of .*a\.tif cannot be read: .*JPEG2000.* requires the .imagecodecs. package",
        lambda to, f: make.overwrite_tags(make.pages(to / "a.tif", f), Compression=34712)),
    (r"page 0 of .*a\.tif cannot be read: the file is cut off",
        lambda to, f: make.content(it := make.pages(to / "a.tif", f[:1]), it.read_bytes()[:-40])),
    (r"frames cannot be read from .*a\.tif: no such file", lambda to, _: to / "a.tif"),
    *((r"a\.tif", lambda to, _, text=text: make.content(to / "a.tif", text))
        for text in (b"", b"no TIFF", b"II*\0", b"II*\0 cut off")),
    # Pictures and films.
    (r"12\], .*12\.png, must be uint8 of shape \(48, 56\) like frames\[0\], .* 0\.png, got .*\(20,",
        lambda to, frames: make.picture(scan(to, frames) / "frame 12.png", frames[0, :20]).parent),
    (r"frames must hold images, got none in .*\*\.jpg", lambda to, f: f"{scan(to, f)}/*.jpg"),
    ("frames must hold images, got none in", lambda to, _: to),
    (NO_IMAGE, enormous_picture),
    (NO_IMAGE, lambda to, _: [make.content(to / "a.png", b"")]),
    (r"a\.png: no such file", lambda to, _: [to / "a.png"]),
    ("no such file", lambda to, _: [to]),
    (r"a\.nd2 has an unknown suffix: microlib reads \.avi, .*\.tif, .*\.tiff",
        lambda to, _: make.content(to / "a.nd2", b"abcd")),
    (r"frames must hold images, got none in .*: they must end in \.bmp, \.jpeg,",
        lambda to, _: make.content(to / "a.heic", b"abcd").parent),
    (r"a\.heic: damaged, too large or of an unknown format; pictures that can be read: \.bmp, \.j",
        lambda to, _: [make.content(to / "a.heic", b"abcd")]),
    (r"a\.mp4: not a video", lambda to, _: make.content(to / "a.mp4", b"no film")),
    # Arrays.
    (r"frames\[3\] must be finite, got 1 NaN",
        lambda _, frames: [*frames[:3].astype(float), holed(frames[3])]),
    (r"frames\[1\] must be uint8 .* got float64", lambda _, f: [f[0], f[1].astype(float)]),
    (r"frames must have shape .* in color, got \(3, 4, 5, 6\)", lambda *_: np.zeros((3, 4, 5, 6))),
    (AXIS, lambda *_: np.zeros((48, 56, 3), np.uint8)),
    (AXIS, lambda _, frames: np.moveaxis(frames, 0, -1)[..., :9]),
    (r"frames\[0\] must be a grey or color image, got shape \(12, 48, 56\)", lambda _, f: [f]),
    (r"frames\[0\] must have pixels, got shape", lambda *_: np.zeros((2, 0, 5), np.uint8)),
    *(("frames must hold at least one image, got none", lambda *_, none=none: none)
        for none in (iter([]), np.zeros((0, 4, 5)))),
]  # fmt: skip


@pytest.mark.parametrize(("words", "write"), REJECTED)
def test_unreadable_source_is_rejected_by_name_page_and_fault(stack, tmp_path, words, write):
    if "imagecodecs" in words and importlib.util.find_spec("imagecodecs"):
        pytest.skip("imagecodecs is installed and decodes JPEG 2000")
    source = write(tmp_path, stack)
    rejects(source, words)
    if isinstance(source, list) and isinstance(source[0], Path):
        with pytest.raises(ValueError, match="path must name an image, got .*" + words):
            read_grey(source[0])


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
def test_truncated_picture_is_rejected(stack, tmp_path, name, share):
    path = make.picture(tmp_path / name, stack[0])
    whole = path.read_bytes()
    make.content(path, whole[: int(share * len(whole))])
    rejects([stack[1], path], f"{name}: damaged, too large or of an unknown format")


@pytest.mark.parametrize("progressive", [False, True])
def test_jpeg_is_read_with_a_video_behind_it_and_rejected_if_its_end_is_missing(
    tmp_path, progressive
):
    """Phones store a video there, in which any markers occur; OpenCV fills up what is missing.

    The thumbnail of a camera has a marker of the end of its own.
    """
    files, rng = [tmp_path / "small.jpg", tmp_path / "PXL_1.MP.jpg"], np.random.default_rng(0)
    for file, shape in zip(files, ((30, 40), (64, 48)), strict=True):
        image = Image.fromarray(rng.integers(0, 255, shape, np.uint8))
        image.save(file, progressive=progressive, quality=95)
    (small, whole), alone = (file.read_bytes() for file in files), read_grey(files[1])
    whole = whole[:2] + b"\xff\xe2" + (len(small) + 2).to_bytes(2, "big") + small + whole[2:]
    for video in (b"\xff\xda", b"\xff\xd9\0\xff\xda\0", b"\xff\xd8\xff\xda\0\0"):
        make.content(files[1], whole + b"\0\0\0\x18ftypmp42" + video)
        np.testing.assert_array_equal(read_grey(files[1]), alone)
    make.content(files[1], whole[: len(whole) * 3 // 4].ljust(len(whole) + 999, b"\0"))
    with pytest.raises(ValueError, match=r"MP\.jpg: damaged"):
        read_grey(files[1])


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [("ImageJ", np.uint16), ("OME", np.float32), ("tifffile", np.uint8), ("pages", np.uint8)],
)
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_tiff_cut_off_after_any_page_is_rejected(stack, tmp_path, kind, dtype, compression):
    """Each page has three strips, so that the file can also end within a page."""
    frames, how = stack[:5].astype(dtype), {"compression": compression, "rowsperstrip": 20}
    if kind == "pages":
        path = make.pages(tmp_path / "a.tif", frames, **how)
    else:
        path = make.tiff_of(kind, tmp_path, frames, **how)
    np.testing.assert_array_equal(np.stack(list(read_frames(path))), frames)
    with tifffile.TiffFile(path) as file:
        entries = [page.aspage() for page in file.pages]
        ends = {n for page in entries for n in np.add(page.dataoffsets, page.databytecounts)}
        ends = ends - {max(ends)} | {max(ends) - 1, *(page.offset for page in entries[1:])}
    whole = path.read_bytes()
    for end in ends:
        rejects(make.content(path, whole[:end]), r"a(\.ome)?\.tif")


def test_imagej_file_with_one_directory_is_rejected_when_cut_off(stack, tmp_path):
    """Beyond 4 GB ImageJ writes the values of all frames after one directory."""
    frames = stack[:5]
    path = make.tiff_of("ImageJ", tmp_path, frames)
    with tifffile.TiffFile(path) as file:
        second = file.pages[1].offset
        order, first = file.byteorder, file.pages[0].offset
        values = bytearray(path.read_bytes())
    entries = struct.unpack_from(order + "H", values, first)[0]
    struct.pack_into(order + "I", values, first + 2 + 12 * entries, 0)
    end = values.index(frames.tobytes()) + frames.nbytes
    for whole in (values[:second], values[:end]):
        reader = read_frames(make.content(path, whole))
        assert (reader.count, reader.axis) == (5, "Z")
        np.testing.assert_array_equal(np.stack(list(reader)), frames)
    for missing in (1, frames[0].size, 3 * frames[0].size, 4 * frames[0].size):
        rejects(make.content(path, values[: end - missing]), r"a\.tif")


@pytest.mark.parametrize("compression", ["tiff_lzw", "packbits", "tiff_deflate"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_page_with_zeroed_data_is_rejected(tmp_path, compression, share):
    """A lost connection can leave zeros. LZW and PackBits have no checksum, but data is missing."""
    if compression != "tiff_deflate" and importlib.util.find_spec("imagecodecs"):
        pytest.skip("imagecodecs decodes what is left")
    smooth = np.add.outer(np.arange(96), 2 * np.arange(80)).astype(np.uint8)
    path = make.by_pillow(tmp_path / "a.tif", np.stack([smooth] * 3), compression=compression)
    assert len(list(read_frames(path))) == 3
    with tifffile.TiffFile(path) as file:
        page = file.pages[1].aspage()
        ends = np.add(page.dataoffsets, page.databytecounts)
        places = np.concatenate([*map(np.arange, page.dataoffsets, ends)])
    values = np.fromfile(path, np.uint8)
    values[places[int(share * len(places)) :]] = 0
    rejects(make.content(path, values.tobytes()), r"page 1 of .*a\.tif cannot be read")


def test_picture_that_is_removed_while_frames_are_read_is_named(stack, tmp_path):
    folder = scan(tmp_path, stack[:4])
    file = folder / "frame 3.png"
    for source in (folder, (folder / f"frame {k}.png" for k in range(4))):
        frames = iter(read_frames(source))
        next(frames)
        content = file.read_bytes()
        file.unlink()
        with pytest.raises(ValueError, match=r"read from .*frame 3\.png: no such file"):
            list(frames)
        file.write_bytes(content)
