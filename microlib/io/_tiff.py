"""Read the pages of a TIFF in the order of its axes; what is ambiguous or cut off is rejected."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib.io._metadata import tiff_scale
from microlib.io._source import Choice, Named, Source, frame_indices, reading

#: Kinds of pixels: grey, red, green and blue (as JPEG stores them, too), colors of a palette.
_KNOWN = ("MINISWHITE", "MINISBLACK", "RGB", "YCBCR", "PALETTE")
#: A damaged page of these decodes to garbage in tifffile and imagecodecs, libtiff rejects it.
_UNCHECKED = ("LZW", "PACKBITS", "JPEG", "OJPEG")

#: Opens a file as Pillow does.
_Opener = Callable[[str], Image.Image]


def is_tiff(path: Path) -> bool:
    """Return whether a file is called a TIFF."""
    return path.suffix.lower() in (".tif", ".tiff")


def tiff_source(path: Path, choice: Choice) -> Source:
    """Check a TIFF without reading its values.

    Parameters
    ----------
    path : Path
        A file whose metadata (ImageJ, OME, Micro-Manager or tifffile's own) give one axis besides
        rows and columns: depth, time, or one without a name. Files without metadata are read page
        by page.
    choice : dict
        Channel, time and series, if the file has several.

    Raises
    ------
    ValueError
        If the file has channels or more axes than one, is cut off, or has fewer pages than it says.
    """
    with reading(f"frames cannot be read from {path}"), tifffile.TiffFile(path) as tiff:
        reads, axis = _in_order(tiff, choice, Image.open)
        for number, page in enumerate(tiff.pages):
            with reading(f"page {number} of {path} cannot be read"):
                _check_end(page.aspage())
        size, positions = tiff_scale(tiff, path.name, len(reads), choice)
    read = partial(tiff_frames, path, choice)
    return Source(read, len(reads), axis, size, positions, files=(path,))


def tiff_frames(path: Path, choice: Choice, *, alone: bool = False) -> Named:
    """Yield the frames of a TIFF as stored: where zero is white, they are not inverted.

    With `alone` those of this file, though its OME metadata may describe others as well.
    """
    with ExitStack() as opened:

        @functools.cache
        def opener(file: str) -> Image.Image:
            return opened.enter_context(Image.open(file))

        with reading(f"frames cannot be read from {path}"):
            tiff = tifffile.TiffFile(path, is_ome=False if alone else None)
            reads, _ = _in_order(opened.enter_context(tiff), choice, opener)
        for number, read in enumerate(reads):
            with reading(f"page {number} of {path} cannot be read"):
                image = read()
            yield f"page {number} of {path}", image


def _in_order(
    tiff: tifffile.TiffFile, choice: Choice, opener: _Opener
) -> tuple[list[Callable[[], NDArray]], str]:
    """Return one function a frame that reads it, and the letter of the axis of frames."""
    if len(tiff.pages) == 0:
        raise ValueError("it holds no page")
    _check_chain(tiff)
    found = tiff.series
    if "series" in choice:
        found = found[choice["series"] : choice["series"] + 1]
    if not found or (len(found) > 1 and any(each.axes not in ("YX", "YXS") for each in found)):
        shapes = ", ".join(f"{each.axes} {tuple(each.shape)}" for each in tiff.series[:5])
        raise ValueError(f"it holds {len(tiff.series)} series of images ({shapes}): choose one")
    reads: list[Callable[[], NDArray]] = []
    total = 0
    for series in found:
        leading = len(series.axes) - len(series.keyframe.axes)
        indices, axis = frame_indices(series.axes[:leading], series.shape[:leading], choice)
        numbers = np.arange(math.prod(series.shape[:leading])).reshape(series.shape[:leading])
        frames = _frames(tiff, series, opener)
        reads += [frames[int(numbers[k])] for k in indices]
        total += numbers.size
    described = (tiff.imagej_metadata or {}).get("images", total)
    if described != total or (total < len(tiff.pages) and "series" not in choice):
        have = min(total, len(tiff.pages)) if described > total else len(tiff.pages)
        raise ValueError(f"its metadata describe {max(described, total)} pages, it holds {have}")
    return reads, axis


def _check_chain(tiff: tifffile.TiffFile) -> None:
    """Reject a file whose last page names the place of another one, which cannot be read."""
    layout, file, offset = tiff.tiff, tiff.filehandle, tiff.pages[-1].offset
    if not offset:  # of frames without a directory of their own
        return
    file.seek(offset)
    (tags,) = struct.unpack(layout.tagnoformat, file.read(layout.tagnosize))
    file.seek(tags * layout.tagsize, 1)
    if any(file.read(layout.offsetsize)):
        raise ValueError(f"it is damaged behind page {len(tiff.pages) - 1}")


def _frames(
    tiff: tifffile.TiffFile, series: tifffile.TiffPageSeries, opener: _Opener
) -> list[Callable[[], NDArray]]:
    frame = series.keyframe.shape
    count = math.prod(series.shape) // math.prod(frame)
    pages = [page for page in series.pages if page is not None]
    if len(pages) == count:
        return [partial(_page, page, opener) for page in pages]
    if series.dataoffset is None:
        others = " (the rest in files that must lie beside it)" if tiff.is_ome else ""
        raise ValueError(f"its metadata describe {count} pages, it holds {len(pages)}{others}")
    # Beyond 4 GB, ImageJ describes only the first page; the others follow it without a gap.
    stored = tifffile.memmap(tiff.filehandle.path, mode="r").reshape(count, *frame)
    return [partial(np.array, values, series.dtype) for values in stored]


def _page(entry: tifffile.TiffPage | tifffile.TiffFrame, opener: _Opener) -> NDArray:
    """Return a page's values; one that ends after the file does is refused, not padded."""
    page = entry.aspage()
    _check_end(page)
    kind = getattr(page.photometric, "name", page.photometric)
    if kind not in _KNOWN:
        raise ValueError(f"it must have grey levels or red, green and blue, got {kind}")
    file = page.parent.filehandle
    closed = file.closed  # as are the other files of a set
    file.open()
    try:
        image = _decoded(page, opener)
    finally:
        if closed:
            file.close()
    if kind == "PALETTE" and not page.parent.is_imagej:  # whose colors are only shown
        return (np.asarray(page.colormap).T[image] >> 8).astype(np.uint8)
    if page.axes == "SYX":
        image = np.moveaxis(image, 0, -1)
    # Grey levels with a mask or an opacity.
    if image.shape[2:] == (2,) and page.extrasamples and page.extrasamples[0]:
        image = image[..., 0]
    return image * np.uint8(255) if image.dtype == bool else image


def _check_end(page: tifffile.TiffPage) -> None:
    ends = np.add(page.dataoffsets, page.databytecounts)
    if len(ends) == 0 or ends.max() > page.parent.filehandle.size:
        raise ValueError("the file is cut off")


def _decoded(page: tifffile.TiffPage, opener: _Opener) -> NDArray:
    """Return a page's values by tifffile, or by Pillow where tifffile cannot read or check them."""
    codec = getattr(page.compression, "name", str(page.compression))
    if codec == "JPEG":
        _check_marks(page)
    image = _by_pillow(page, opener) if codec in _UNCHECKED else None
    try:
        return page.asarray() if image is None else image
    except Exception as error:
        if "imagecodecs" not in str(error) and not isinstance(error, ImportError):
            raise
    if (image := _by_pillow(page, opener)) is None:
        raise ValueError(
            f"{page.bitspersample} bits with the compression {codec} need another package (pip "
            "install imagecodecs); or save the file without compression or as Deflate (zip)"
        )
    return image


def _by_pillow(page: tifffile.TiffPage, opener: _Opener) -> NDArray | None:
    """Return a page as stored, None where Pillow does not know this kind of pixels."""
    try:
        opened = opener(page.parent.filehandle.path)
        opened.seek(page.index)
    except (OSError, EOFError, TypeError):  # of a kind that it does not know, or no page of its own
        return None
    image = np.asarray(opened)  # fails if the page is damaged
    if image.shape != page.shape or image.dtype != page.dtype:
        return None
    # Pillow inverts these.
    white = page.photometric == tifffile.PHOTOMETRIC.MINISWHITE and image.dtype.itemsize == 1
    return ~image if white else image


def _check_marks(page: tifffile.TiffPage) -> None:
    """Reject JPEG data without the mark of their end, which libtiff fills up."""
    file, mark = page.parent.filehandle, b"\xff\xd9"
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        file.seek(offset + count // 2)
        if mark not in file.read(count - count // 2):
            raise ValueError("its JPEG data are cut off or damaged")
