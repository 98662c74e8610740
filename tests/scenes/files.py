"""Writers of every kind of file, and a reader of meshes."""

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

GREY = {"photometric": "minisblack"}
#: File name and options of tifffile for each kind of metadata that names the axes.
TIFFS: dict[str, tuple[str, dict]] = {
    "ImageJ": ("a.tif", {"imagej": True}),
    "OME": ("a.ome.tif", GREY),
    "tifffile": ("a.tif", GREY),
}


class Lazy:
    """The common interface of zarr and dask arrays; records which frames are loaded."""

    def __init__(self, values: NDArray) -> None:
        self._values = values
        self.shape = values.shape
        self.loaded: list[int] = []

    def __getitem__(self, key: int) -> NDArray:
        self.loaded.append(key)
        return self._values[key]


def one_buffer(frames: NDArray) -> Iterator[NDArray]:
    """Yield all frames in one buffer, as some cameras do: each overwrites the one before."""
    buffer = np.empty_like(frames[0])
    for frame in frames:
        buffer[:] = frame
        yield buffer


def content(path: Path, values: bytes) -> Path:
    path.write_bytes(values)
    return path


def picture(path: Path, image: NDArray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def pictures(folder: Path, frames: NDArray) -> Path:
    """Write a PNG for each frame, its number without leading zeros, and two other files."""
    folder.mkdir()
    for k, frame in enumerate(frames):
        picture(folder / f"frame {k}.png", frame)
    (folder / "notes.txt").write_text("not a frame")
    (folder / ".hidden.png").write_text("not a frame either")
    return folder


def tiff(path: Path, frames: NDArray, **options: object) -> Path:
    tifffile.imwrite(path, frames, **options)
    return path


def tiff_of(kind: str, folder: Path, frames: NDArray, axes: str = "ZYX", **options: object) -> Path:
    name, own = TIFFS[kind]
    return tiff(folder / name, frames, metadata={"axes": axes}, **own | options)


def varied_times(path: Path, ticks: list[int]) -> Path:
    """Give the frames of an MP4 that OpenCV wrote other durations of the same sum, in ticks."""
    film = path.read_bytes()
    at = film.index(b"stts") - 4  # the table of durations: its length, name, flags and entries
    length = int.from_bytes(film[at : at + 4], "big")
    entries = b"".join(struct.pack(">II", 1, tick) for tick in ticks)
    table = struct.pack(">I4sII", 16 + len(entries), b"stts", 0, len(ticks)) + entries
    varied = bytearray(film[:at] + table + film[at + length :])
    for around in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        start = film.index(around) - 4
        longer = int.from_bytes(film[start : start + 4], "big") + len(table) - length
        varied[start : start + 4] = longer.to_bytes(4, "big")
    return content(path, bytes(varied))


def pages(path: Path, frames: NDArray, **options: object) -> Path:
    """Append page after page, without metadata."""
    for frame in frames:
        tiff(path, frame, append=True, metadata=None, **options)
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
    """Write grey levels without padding: two of 12 bits take three bytes, as in some cameras."""
    count, rows, columns = frames.shape
    octets = frames.astype(">u2").view(np.uint8).reshape(count, rows, columns, 2)
    numbers = np.unpackbits(octets, axis=3)[..., -bits:]
    pages(path, np.packbits(numbers.reshape(count, rows, -1), axis=2), **GREY)
    return overwrite_tags(path, BitsPerSample=bits, ImageWidth=columns)


def ome_text(path: Path) -> str:
    with tifffile.TiffFile(path) as file:
        assert file.ome_metadata
        return file.ome_metadata


def set_of_ome(folder: Path, frames: NDArray) -> Path:
    """Write a file for each frame of one OME-TIFF, 3.5 µm apart, and return the folder."""
    folder.mkdir()
    whole = tiff(folder / "whole.ome.tif", frames, metadata={"axes": "ZYX", "PhysicalSizeZ": 3.5})
    blocks = "".join(
        f'<TiffData FirstZ="{k}" IFD="0" PlaneCount="1"><UUID FileName="scan_z{k}.ome.tif">'
        f"urn:uuid:{k:032}</UUID></TiffData>"
        for k in range(len(frames))
    )
    text, count = re.subn("<TiffData .*?/>", blocks, ome_text(whole))
    assert count == 1
    whole.unlink()
    for k, frame in enumerate(frames):
        own = re.sub(' UUID="[^"]*"', f' UUID="urn:uuid:{k:032}"', text)
        tiff(folder / f"scan_z{k}.ome.tif", frame, description=own.encode(), metadata=None)
    return folder


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """Return the vertices, their colors if there are any, and the triangles of a mesh."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    counts = [int(line.split()[-1]) for line in head.splitlines() if line.startswith(b"element")]
    names = re.findall(rb"property uchar (red|green|blue)\n", head)
    assert names in ([], [b"red", b"green", b"blue"])
    kind = [("vertices", "<f4", 3), *([("colors", "u1", 3)] if names else [])]
    table = np.frombuffer(body, kind, counts[0])
    triangles = np.frombuffer(body[table.nbytes :], [("n", "u1"), ("i", "<i4", 3)])
    assert len(triangles) == counts[1]
    assert (triangles["n"] == 3).all()
    return {name: table[name] for name in table.dtype.names} | {"faces": triangles["i"]}


def read_stl(path: Path) -> dict[str, np.ndarray]:
    """Return the normals and the corners of the triangles of a binary STL file."""
    content = path.read_bytes()
    assert not content.startswith(b"solid")  # which would be text
    facets = np.frombuffer(
        content[84:], [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("n", "<u2")]
    )
    assert len(facets) == int.from_bytes(content[80:84], "little")
    return {"normals": facets["normal"], "corners": facets["corner"]}
