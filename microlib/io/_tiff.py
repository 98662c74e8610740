"""Read the pages of a TIFF in the order of its axes; reject ambiguous axes and damaged pages."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib.io._metadata import tiff_scale
from microlib.io._stack import (
    Choice,
    Stack,
    check_axis_of_frames,
    open_stack,
    reading,
    select_frames,
)

TIFF = frozenset({".tif", ".tiff"})
#: Kinds of pixels: grey, red, green and blue (as JPEG stores them, too), colors of a palette.
_PHOTOMETRIC = ("MINISWHITE", "MINISBLACK", "RGB", "YCBCR", "PALETTE")
#: tifffile decodes these itself, and fails if they are damaged. A damaged page of LZW, PackBits or
#: JPEG decodes to garbage in tifffile and imagecodecs, while libtiff, by Pillow, rejects it.
_BY_TIFFFILE = ("NONE", "ADOBE_DEFLATE", "DEFLATE")

_Opener = Callable[[str], Image.Image]
#: Reads one frame; Pillow's opener is shared so that it does not search each page from the first.
_Reader = Callable[[_Opener], NDArray]


def open_tiff(path: Path, choice: Choice, *, alone: bool = False) -> Stack:
    """Select the pages of a TIFF by its metadata, without decoding them.

    Parameters
    ----------
    path : Path
        A file whose metadata (ImageJ, OME, Micro-Manager or tifffile's own) give one axis besides
        rows and columns: depth, time, or one without a name. Files without metadata are read page
        by page.
    choice : dict
        Channel, time and series, if the file has several.
    alone : bool
        Whether to read this file only, if its OME metadata describe other files as well.

    Raises
    ------
    ValueError
        If the file has channels or several axes to choose from, a damaged chain of pages, or more
        or fewer pages than its metadata describe.
    """
    wanted = dict(choice)
    with tifffile.TiffFile(path, is_ome=False if alone else None) as tiff:
        readers, axis = _select_pages(tiff, choice)
        size, positions = tiff_scale(tiff, path.name, len(readers), wanted)
        if axis == "T":  # whose frames have one position
            positions = None

    def read() -> Iterator[NDArray]:
        with ExitStack() as opened:

            @functools.cache
            def opener(file: str) -> Image.Image:
                return opened.enter_context(Image.open(file))

            for k, reader in enumerate(readers):
                with reading(f"page {k} of {path} cannot be read"):
                    image = reader(opener)
                yield image

    return open_stack(
        read,
        name=lambda k: f"page {k} of {path}",
        count=len(readers),
        axis=axis,
        positions=positions,
        pixel_size=size,
        files=(path,),
    )


def _select_pages(tiff: tifffile.TiffFile, choice: Choice) -> tuple[list[_Reader], str]:
    """Return a reader of each frame, and the letter of the axis of frames."""
    _check_chain(tiff)
    every = "series" not in choice
    if every:
        series = [each for each in tiff.series if not each.keyframe.is_reduced]
    else:
        number = choice.pop("series")
        series = tiff.series[number : number + 1]
    if not series or (len(series) > 1 and any(each.axes not in ("YX", "YXS") for each in series)):
        shapes = ", ".join(f"{each.axes} {tuple(each.shape)}" for each in tiff.series[:5])
        raise ValueError(f"it holds {len(tiff.series)} series of images ({shapes}): choose one")
    readers: list[_Reader] = []
    total, axis = 0, ""
    for each in series:
        leading = len(each.axes) - len(each.keyframe.axes)
        if each.axes[leading:] != each.keyframe.axes:
            raise ValueError(f"its axes {each.axes} must end in rows Y and columns X")
        shape = each.shape[:leading]
        indices, axis = select_frames(each.axes[:leading], shape, choice)
        found = _page_readers(tiff, each)
        numbers = np.arange(len(found)).reshape(shape)
        readers += [found[numbers[index]] for index in indices]
        total += len(found)
    described = max(total, (tiff.imagej_metadata or {}).get("images", total))
    held = total if described > total else max(total, _count_pages(tiff))
    if described != held and every:
        raise ValueError(f"its metadata describe {described} pages, it holds {held}")
    if tiff.is_shaped and axis == "Q":  # an array that was written as it was
        page = series[0].keyframe
        check_axis_of_frames((len(readers), page.imagelength, page.imagewidth))
    return readers, axis


def _count_pages(tiff: tifffile.TiffFile) -> int:
    """Return the number of pages, without reduced images for a preview."""
    return sum(not page.aspage().is_reduced for page in tiff.pages)


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


def _page_readers(tiff: tifffile.TiffFile, series: tifffile.TiffPageSeries) -> list[_Reader]:
    frame = series.keyframe.shape
    count = math.prod(series.shape) // math.prod(frame)
    pages = [page for page in series.pages if page is not None]
    if len(pages) == count:
        return [partial(_read_page, page) for page in pages]
    if series.dataoffset is None:
        others = " (the rest in files that must lie beside it)" if tiff.is_ome else ""
        raise ValueError(f"its metadata describe {count} pages, it holds {len(pages)}{others}")
    # Beyond 4 GB, ImageJ describes only the first page; the others follow it without a gap.
    stored = tifffile.memmap(tiff.filehandle.path, mode="r").reshape(count, *frame)
    return [partial(_copy, values) for values in stored]


def _copy(values: NDArray, _: _Opener) -> NDArray:
    return np.array(values)


def _read_page(entry: tifffile.TiffPage | tifffile.TiffFrame, opener: _Opener) -> NDArray:
    """Return a page's values as grey or RGB."""
    file = entry.parent.filehandle
    file.open()
    try:
        page = entry.aspage()
        image = _decode(page, opener)
        # ImageJ stores the colors in which it shows grey levels as a palette.
        if page.photometric == tifffile.PHOTOMETRIC.PALETTE and not page.parent.is_imagej:
            image = (np.asarray(page.colormap).T[image] >> 8).astype(np.uint8)
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
    if kind not in _PHOTOMETRIC:
        raise ValueError(f"it must have grey levels or red, green and blue, got {kind}")
    codec = getattr(page.compression, "name", page.compression)
    image = None
    if codec == "JPEG":
        _check_jpeg_end(page)
    if codec not in _BY_TIFFFILE or page.bitspersample == 12:
        image = _by_pillow(page, opener)
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


def _check_jpeg_end(page: tifffile.TiffPage) -> None:
    """Reject JPEG data without the marker of their end, which libtiff fills up."""
    file, marker = page.parent.filehandle, b"\xff\xd9"
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        file.seek(offset + count // 2)
        if marker not in file.read(count - count // 2):
            raise ValueError("its JPEG data are cut off or damaged")
