"""Sizes of pictures from their first bytes: those that OpenCV decodes, and no guess where a header
ends too soon."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from microlib.io._headers import picture_size

PNG = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 700, 300)


def size_of(content: bytes, folder: Path) -> tuple[int, int] | None:
    (folder / "a").write_bytes(content)
    return picture_size(folder / "a")


def segment(kind: int, content: bytes) -> bytes:
    """A part of a JPEG: its marker, its length with the two bytes that say it, and the content."""
    return struct.pack(">BBH", 0xFF, kind, len(content) + 2) + content


def frame(kind: int) -> bytes:
    return segment(kind, struct.pack(">BHH", 8, 300, 700))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("shape", [(3, 300), (300, 3), (1, 1), (258, 515, 3)])
def test_it_is_the_size_that_opencv_writes(
    tmp_path: Path, suffix: str, shape: tuple[int, ...]
) -> None:
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), np.zeros(shape, np.uint8))
    assert picture_size(path) == shape[:2]


def test_a_png_is_known_by_its_whole_first_bytes(tmp_path: Path) -> None:
    assert size_of(PNG, tmp_path) == (300, 700)
    assert size_of(PNG[:-1], tmp_path) is None
    assert size_of(b"\x89PNG\n\n\n\n" + PNG[8:], tmp_path) is None
    for other in (b"", b"BM" + bytes(40), b"GIF89a" + bytes(40), b"II*\0" + bytes(40)):
        assert size_of(other, tmp_path) is None


@pytest.mark.parametrize("kind", range(0xC0, 0xD0))
def test_every_start_of_a_frame_tells_the_size_of_a_jpeg(tmp_path: Path, kind: int) -> None:
    """ITU T.81, table B.1: C4, C8 and CC are tables, a reserved marker and conditioning."""
    told = None if kind in (0xC4, 0xC8, 0xCC) else (300, 700)
    assert size_of(b"\xff\xd8" + frame(kind), tmp_path) == told


@pytest.mark.parametrize("length", [0, 5, 255, 3000])
def test_other_parts_of_a_jpeg_are_passed_over(tmp_path: Path, length: int) -> None:
    before = segment(0xE1, bytes(length)) + segment(0xC4, b"\xff\xc0 not a marker")
    whole = b"\xff\xd8" + before + frame(0xC2)
    assert size_of(whole, tmp_path) == (300, 700)
    for end in (len(whole) - 1, len(whole) - 5, len(whole) - 6, len(before), 3, 2):
        assert size_of(whole[:end], tmp_path) is None
    # What is between two parts is no JPEG, and its bytes are no sizes.
    assert size_of(b"\xff\xd8" + before + b"\0" + frame(0xC2), tmp_path) is None
