"""Read the pages of a TIFF in the order of its axes; reject ambiguous axes and damaged pages."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib.io._metadata import tiff_scale
from microlib.io._source import NamedFrames, Source, check_axis_of_frames, reading

TIFF = frozenset({".tif", ".tiff"})
#: tifffile decodes these itself, and fails if they are damaged. A damaged page of LZW or PackBits
#: decodes to garbage in tifffile and imagecodecs, while libtiff, by Pillow, rejects it.
_BY_TIFFFILE = ("NONE", "ADOBE_DEFLATE", "DEFLATE")

_Page = tifffile.TiffPage | tifffile.TiffFrame
_Opener = Callable[[str], Image.Image]


def open_tiff(path: Path, *, alone: bool = False) -> Source:
    """Return the frames of a TIFF in the order of its metadata, without decoding them.

    Parameters
    ----------
    path : Path
        A file whose metadata (ImageJ, OME, Micro-Manager or tifffile's own) give one axis besides
        rows and columns: depth, time, or one without a name. Files without metadata are read page
        by page.
    alone : bool
        Whether to read this file only, if its OME metadata describe other files as well.

    Raises
    ------
    ValueError
        If the file has channels, several axes besides rows and columns or several series of images,
        a damaged chain of pages, or more or fewer pages than its metadata describe.
    """
    with tifffile.TiffFile(path, is_ome=False if alone else None) as tiff:
        pages, axis = _find_pages(tiff)
        size, positions = tiff_scale(tiff, path.name, len(pages))
        if axis == "T":  # whose frames have one position
            positions = None

    def read() -> NamedFrames:
        with ExitStack() as opened:
            # One opener, so that Pillow does not search each page from the first.
            opener = functools.cache(lambda file: opened.enter_context(Image.open(file)))
            for k, page in enumerate(pages):
                with reading(f"page {k} of {path} cannot be read"):
                    image = _read_page(page, opener)
                yield f"page {k} of {path}", image

    return Source(read, len(pages), axis, size, positions, files=(path,))


def _find_pages(tiff: tifffile.TiffFile) -> tuple[list[_Page], str]:
    """Return the page of each frame, and the letter of the axis of frames."""
    _check_chain(tiff)
    # Without reduced images for a preview.
    held = sum(not page.aspage().is_reduced for page in tiff.pages)
    series = [each for each in tiff.series if not each.keyframe.is_reduced]
    if not series or (len(series) > 1 and any(each.axes not in ("YX", "YXS") for each in series)):
        shapes = ", ".join(f"{each.axes} {tuple(each.shape)}" for each in tiff.series[:5])
        raise ValueError(
            f"it holds {len(tiff.series)} series of images ({shapes}): save one of them as a file, "
            "or pass it as an array, as tifffile.imread(path, series=0) gives it"
        )
    pages: list[_Page] = []
    axis = ""
    for each in series:
        leading = len(each.axes) - len(each.keyframe.axes)
        if each.axes[leading:] != each.keyframe.axes:
            raise ValueError(f"its axes {each.axes} must end in rows Y and columns X")
        axis = _axis_of_frames(each.axes[:leading], each.shape[:leading])
        found = [page for page in each.pages if page is not None]
        if (count := math.prod(each.shape[:leading])) != len(found):
            raise ValueError(
                f"its metadata describe {count} pages, it holds {len(found)}: the rest must lie "
                "beside it; for ImageJ's files beyond 4 GB pass tifffile.memmap(path)"
            )
        pages += found
    described = max(len(pages), (tiff.imagej_metadata or {}).get("images", 0))
    if described > len(pages) or held > len(pages):
        raise ValueError(f"its metadata describe {described} pages, it holds {held}")
    if tiff.is_shaped and axis == "Q":  # an array that was written as it was
        page = series[0].keyframe
        check_axis_of_frames((len(pages), page.imagelength, page.imagewidth))
    return pages, axis


def _axis_of_frames(axes: str, shape: Sequence[int]) -> str:
    """Return the letter of the axis before rows and columns that is longer than 1, if any is."""
    long = [(axis, n) for axis, n in zip(axes, shape, strict=True) if n > 1]
    if len(long) > 1 or (long and long[0][0] == "C"):
        found = ", ".join(f"{axis}={n}" for axis, n in long)
        raise ValueError(
            f"it has the axes {found} besides rows and columns, a stack has one and no channels C: "
            "save one stack as a file, or pass an array of shape (frames, rows, cols)"
        )
    return long[0][0] if long else ""


def _check_chain(tiff: tifffile.TiffFile) -> None:
    """Reject a file without a page, or whose last page points to another that cannot be read."""
    if len(tiff.pages) == 0:
        raise ValueError("it holds no page")
    layout, file, offset = tiff.tiff, tiff.filehandle, tiff.pages[-1].offset
    if not offset:  # of frames without a directory of their own
        return
    file.seek(offset)
    (tags,) = struct.unpack(layout.tagnoformat, file.read(layout.tagnosize))
    file.seek(tags * layout.tagsize, 1)
    if any(file.read(layout.offsetsize)):
        raise ValueError(f"it is damaged behind page {len(tiff.pages) - 1}")


def _read_page(entry: _Page, opener: _Opener) -> NDArray:
    """Return a page's values as grey or RGB."""
    file = entry.parent.filehandle
    file.open()
    try:
        page = entry.aspage()
        image = _decode(page, opener)
    finally:
        file.close()
    if page.axes == "SYX":
        image = np.moveaxis(image, 0, -1)
    # Grey levels with a mask or an opacity.
    if image.shape[2:] == (2,) and page.extrasamples and page.extrasamples[0]:
        image = image[..., 0]
    return image * np.uint8(255) if image.dtype == bool else image


def _decode(page: tifffile.TiffPage, opener: _Opener) -> NDArray:
    """Return a page's values as stored; reject one that is damaged or of another color model."""
    ends = np.add(page.dataoffsets, page.databytecounts)
    if len(ends) == 0 or ends.max() > page.parent.filehandle.size:
        raise ValueError("the file is cut off")  # tifffile would fill it up
    kind = getattr(page.photometric, "name", page.photometric)
    # ImageJ stores the colors in which it shows grey levels as a palette.
    shown = ("PALETTE",) if page.parent.is_imagej else ()
    if kind not in ("MINISWHITE", "MINISBLACK", "RGB", *shown):
        raise ValueError(f"it must have grey levels or red, green and blue, got {kind}")
    codec = getattr(page.compression, "name", page.compression)
    if codec == "JPEG":
        raise ValueError("it is compressed by JPEG, which hides damage: save it without")
    image = None if codec in _BY_TIFFFILE else _by_pillow(page, opener)
    return page.asarray() if image is None else image


def _by_pillow(page: tifffile.TiffPage, opener: _Opener) -> NDArray | None:
    """Return a page as stored; None where Pillow does not know this kind of pixels."""
    try:
        opened = opener(page.parent.filehandle.path)
        opened.seek(page.index)
    except (OSError, EOFError, TypeError):
        return None
    image = np.asarray(opened)  # raises if the page is damaged
    if image.shape != page.shape or image.dtype != page.dtype:
        return None
    inverted = page.photometric == tifffile.PHOTOMETRIC.MINISWHITE and image.dtype.itemsize == 1
    return ~image if inverted else image
