"""Read the pages of a TIFF in the order of its axes; reject ambiguous axes and damaged pages."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib.io._metadata import tiff_scale, tiff_times
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

#: A page as tifffile has it, or its grey levels where they are mapped from the file.
_Page = tifffile.TiffPage | tifffile.TiffFrame | NDArray
#: Opens a file by Pillow, once, so that it does not search each page from the first one.
_Opener = Callable[[str], Image.Image]


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
        If the file has channels or several axes to choose from, a damaged chain of pages, or fewer
        pages than its metadata describe.
    """
    wanted = dict(choice)
    with (
        reading(f"frames cannot be read from {path}"),
        tifffile.TiffFile(path, is_ome=False if alone else None) as tiff,
    ):
        _check_chain(tiff)
        pages, axis = _select_pages(tiff, choice)
        single = len(pages) == 1 and not alone
        if single and tiff.is_shaped and tiff.pages[0].aspage().axes == "SYX":
            warnings.warn(
                f"{path.name} is read as one color image: tifffile marks three or four images so "
                'unless they are written with photometric="minisblack"',
                stacklevel=2,
            )
        size, positions = tiff_scale(tiff, path.name, len(pages), wanted)
        times = tiff_times(tiff, len(pages), wanted) if axis == "T" else None

    def read() -> Iterator[NDArray]:
        with ExitStack() as opened:
            pillow = functools.cache(lambda file: opened.enter_context(Image.open(file)))
            for k, page in enumerate(pages):
                with reading(f"page {k} of {path} cannot be read"):
                    if isinstance(page, np.ndarray):
                        image = np.array(page)
                    else:
                        image = _read_page(page, pillow)
                yield image

    return open_stack(
        read,
        name=lambda k: f"page {k} of {path}",
        time=lambda k: None if times is None else float(times[k]),
        count=len(pages),
        axis=axis,
        positions=None if axis == "T" else positions,  # frames along time have one position
        pixel_size=size,
        files=(path,),
    )


def _select_pages(tiff: tifffile.TiffFile, choice: Choice) -> tuple[list[_Page], str]:
    """Return the page of each frame, and the letter of the axis of frames."""
    if (number := choice.pop("series", None)) is None:
        series = [each for each in tiff.series if not each.keyframe.is_reduced]  # no preview
        if len(series) > 1 and all(each.axes in ("YX", "YXS") for each in series):
            # The frames were written one by one.
            return [page for each in series for page in each.pages if page is not None], ""
    else:
        series = tiff.series[number : number + 1]
    if len(series) != 1:
        shapes = ", ".join(f"{each.axes} {tuple(each.shape)}" for each in tiff.series[:5])
        raise ValueError(f"it holds {len(tiff.series)} series of images ({shapes}): choose one")
    axes, shape, keyframe = series[0].axes, series[0].shape, series[0].keyframe
    leading = len(axes) - len(keyframe.axes)
    if axes[leading:] != keyframe.axes:
        raise ValueError(f"its axes {axes} must end in rows Y and columns X")
    # tifffile leaves out axes of length 1, of which the choice may name channel and time. Files of
    # OME and ImageJ have both.
    single = (
        "".join(axis for axis in "CT" if axis not in axes) if tiff.is_ome or tiff.is_imagej else ""
    )
    axes, shape, leading = single + axes, (1,) * len(single) + shape, len(single) + leading
    indices, axis = select_frames(axes[:leading], shape[:leading], choice)
    if tiff.is_shaped and axis == "Q":  # an array that was written as it was
        check_axis_of_frames((len(indices), keyframe.imagelength, keyframe.imagewidth))
    pages = _all_pages(tiff, series[0])
    numbers = np.arange(len(pages)).reshape(shape[:leading])
    return [pages[numbers[index]] for index in indices], axis


def _all_pages(tiff: tifffile.TiffFile, series: tifffile.TiffPageSeries) -> list[_Page]:
    """Return the pages of a series; reject one with fewer pages than its metadata describe."""
    frame = series.keyframe.shape
    count = math.prod(series.shape) // math.prod(frame)
    pages: list[_Page] = [page for page in series.pages if page is not None]
    if len(pages) == 1 < count and series.dataoffset is not None:
        # Beyond 4 GB, ImageJ describes only the first page; the others follow it without a gap.
        return list(tifffile.memmap(tiff.filehandle.path, mode="r").reshape(count, *frame))
    described = max(count, (tiff.imagej_metadata or {}).get("images", 0))
    if len(pages) < described:
        others = " (the rest in files that must lie beside it)" if tiff.is_ome else ""
        raise ValueError(f"its metadata describe {described} pages, it holds {len(pages)}{others}")
    return pages


def _check_chain(tiff: tifffile.TiffFile) -> None:
    """Reject a file without a page, or whose last page points to another that cannot be read."""
    if len(tiff.pages) == 0:
        raise ValueError("it holds no page")
    # Where the offset of the page after the last one is, which is 0 if there is none.
    if at := tiff.pages.next_page_offset:
        tiff.filehandle.seek(at)
        if any(tiff.filehandle.read(tiff.tiff.offsetsize)):
            raise ValueError(f"it is damaged behind page {len(tiff.pages) - 1}")


def _read_page(entry: tifffile.TiffPage | tifffile.TiffFrame, pillow: _Opener) -> NDArray:
    """Return a page's values as grey or RGB; reject one that is cut off or of other colors."""
    file = entry.parent.filehandle
    file.open()
    try:
        page = entry.aspage()
        ends = np.add(page.dataoffsets, page.databytecounts)
        if len(ends) == 0 or ends.max() > file.size:
            raise ValueError("the file is cut off")  # tifffile would fill it up
        kind = getattr(page.photometric, "name", page.photometric)
        if kind not in _PHOTOMETRIC:
            raise ValueError(f"it must have grey levels or red, green and blue, got {kind}")
        image = _decode(page, pillow)
        # ImageJ stores the colors in which it shows grey levels as a palette.
        if kind == "PALETTE" and not page.parent.is_imagej:
            image = (np.asarray(page.colormap).T[image] >> 8).astype(np.uint8)
    finally:
        file.close()
    if page.axes == "SYX":
        image = np.moveaxis(image, 0, -1)
    # Grey levels with a mask or an opacity.
    if image.shape[2:] == (2,) and page.extrasamples and page.extrasamples[0]:
        image = image[..., 0]
    return image * np.uint8(255) if image.dtype == bool else image


def _decode(page: tifffile.TiffPage, pillow: _Opener) -> NDArray:
    """Return a page's values as stored, by tifffile or else by Pillow's libtiff."""
    try:
        return page.asarray()
    except (ValueError, NotImplementedError) as error:  # which names the package that is missing
        if "imagecodecs" not in str(error):
            raise
        try:
            opened = pillow(page.parent.filehandle.path)
            opened.seek(page.index)
        except (OSError, EOFError, TypeError):
            raise error from None
        image = np.asarray(opened)
        if image.shape != page.shape or image.dtype != page.dtype:
            raise
    inverted = page.photometric == tifffile.PHOTOMETRIC.MINISWHITE and image.dtype.itemsize == 1
    return ~image if inverted else image
