"""Read the pages of a TIFF in the order of its axes; what is ambiguous or cut off is refused."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from microlib._common import Array
from microlib.io._metadata import tiff_scale

#: Kinds of pixels: grey, red, green and blue (as JPEG stores them, too), colors of a palette.
_KNOWN = ("MINISWHITE", "MINISBLACK", "RGB", "YCBCR", "PALETTE")


def is_tiff(path: Path) -> bool:
    """Return whether a file is called a TIFF.

    Examples
    --------
    >>> from pathlib import Path
    >>> from microlib.io._tiff import is_tiff
    >>> is_tiff(Path("a.TIF")), is_tiff(Path("a.png"))
    (True, False)
    """
    return path.suffix.lower() in (".tif", ".tiff")


def tiff_stack(path: Path) -> tuple[int, str, float | None, Array | None]:
    """Check a TIFF without reading its values, and return what it says of its frames.

    Returns
    -------
    count : int
        Number of frames.
    axis : str
        Letter of the axis of frames in the file's metadata, such as Z or T; empty if they are not
        said to have one.
    pixel_size : float or None
        Side of a pixel, µm/px.
    positions : ndarray, shape (count,), or None
        Position of each frame along the optical axis, µm.

    Raises
    ------
    ValueError
        As `tiff_pages`, but for values that cannot be read.
    """
    with _refused(f"frames cannot be read from {path}"), tifffile.TiffFile(path) as tiff:
        count = len(_in_order(tiff))
        series = tiff.series[0]
        lengths = zip(series.axes, series.shape, strict=True)
        axes = [axis for axis, n in lengths if axis not in "YXS" and n > 1]
        for number, page in enumerate(tiff.pages):
            with _refused(f"page {number} of {path} cannot be read"):
                _check_end(page.aspage())
        return count, "".join(axes), *tiff_scale(tiff, count)


def tiff_pages(path: Path) -> Iterator[tuple[str, NDArray]]:
    """Yield the frames of a TIFF along its one axis of frames, each with a name for messages.

    Parameters
    ----------
    path : Path
        A file whose metadata (ImageJ, OME, Micro-Manager or tifffile's own) give one axis besides
        rows and columns, or none: depth, time, or not said. Files without metadata are read page
        by page.

    Yields
    ------
    str, ndarray
        "page 3 of …" and its values as stored: where the file says that zero is white, they are
        not inverted.

    Raises
    ------
    ValueError
        If the file has channels or more axes than one, is cut off, has fewer pages than it says,
        or makes the reader complain in any other way.
    """
    with ExitStack() as opened:
        with _refused(f"frames cannot be read from {path}"):
            tiff = opened.enter_context(tifffile.TiffFile(path))
            reads = _in_order(tiff)
        for number, read in enumerate(reads):
            with _refused(f"page {number} of {path} cannot be read"):
                image = read()
            yield f"page {number} of {path}", image


@contextmanager
def _refused(words: str) -> Iterator[None]:
    """Raise a ValueError for what tifffile raises, and for what it only logs.

    Damaged headers and codecs raise whatever their bytes lead to. What is logged are pages that
    are left out and metadata that cannot be followed.
    """
    log, own, said = logging.getLogger("tifffile"), threading.get_ident(), []

    def listen(record: logging.LogRecord) -> bool:
        if record.thread == own and record.levelno >= logging.WARNING:
            said.append(record.getMessage())
        return record.thread != own

    log.addFilter(listen)
    try:
        yield
    except Exception as error:
        raise ValueError(f"{words}: {error}") from error
    finally:
        log.removeFilter(listen)
    if said:
        raise ValueError(f"{words}: the file is cut off or damaged: {said[0]}")


def _in_order(tiff: tifffile.TiffFile) -> list[Callable[[], NDArray]]:
    """Return one function a frame that reads it, after a check of the axes and of the count."""
    if len(tiff.pages) == 0:
        raise ValueError("it holds no page")
    found = tiff.series
    if len(found) > 1 and any(series.axes not in ("YX", "YXS") for series in found):
        shapes = ", ".join(f"{series.axes} {tuple(series.shape)}" for series in found[:5])
        raise ValueError(
            f"it holds {len(found)} series of images ({shapes}); pass the array of one, "
            "as tifffile.imread(path, series=0) gives it"
        )
    reads: list[Callable[[], NDArray]] = []
    for series in found:
        _check_axes(series)
        reads += _reads(tiff, series)
    said = (tiff.imagej_metadata or {}).get("images", len(reads))
    if said != len(reads) or len(reads) < len(tiff.pages):
        have = min(len(reads), len(tiff.pages)) if said > len(reads) else len(tiff.pages)
        raise ValueError(f"its metadata tell of {max(said, len(reads))} pages, it holds {have}")
    return reads


def _check_axes(series: tifffile.TiffPageSeries) -> None:
    lengths = dict(zip(series.axes, series.shape, strict=True))
    inner = "YXS" if lengths.get("S") in (3, 4) else "YX"
    frames = [n for axis, n in zip(series.axes, series.shape, strict=True) if axis not in inner]
    several = sum(n > 1 for n in frames) > 1
    if several or lengths.get("C", 1) > 1 or not series.axes.endswith(inner):
        names = ", ".join(f"{a}={n}" for a, n in zip(series.axes, series.shape, strict=True))
        raise ValueError(
            f"it has the axes {names}, a stack has one besides Y and X, and no channels C or "
            "samples S; pass an array of shape (frames, rows, cols) of one channel and time, "
            f"cut from tifffile.imread(path), which has the axes {series.axes}"
        )


def _reads(tiff: tifffile.TiffFile, series: tifffile.TiffPageSeries) -> list[Callable[[], NDArray]]:
    inner = 3 if series.axes.endswith("S") else 2
    count = math.prod(series.shape[:-inner])
    pages = [page for page in series.pages if page is not None]
    if len(pages) == count:
        return [partial(_page, page, k) for k, page in enumerate(pages)]
    if series.dataoffset is None:
        raise ValueError(f"its metadata tell of {count} pages, it holds {len(pages)}")
    # Beyond 4 GB, ImageJ describes only the first page; the others follow it without a gap.
    stored = tifffile.memmap(tiff.filehandle.path, mode="r").reshape(count, *series.shape[-inner:])
    return [partial(np.array, frame, series.dtype) for frame in stored]


def _page(entry: tifffile.TiffPage | tifffile.TiffFrame, number: int) -> NDArray:
    """Return a page's values; one that ends after the file does is refused, not padded."""
    page = entry.aspage()
    _check_end(page)
    kind = getattr(page.photometric, "name", page.photometric)
    if kind not in _KNOWN:
        raise ValueError(f"it must have grey levels or red, green and blue, got {kind}")
    try:
        image = page.asarray()
        if kind == "PALETTE":
            return (np.asarray(page.colormap).T[image] >> 8).astype(np.uint8)
        return image * np.uint8(255) if image.dtype == bool else image
    except (ValueError, ImportError) as error:
        if "imagecodecs" not in str(error) and not isinstance(error, ImportError):
            raise
        decoded = _by_opencv(page, page.parent.filehandle.path, number)
        if decoded is None:
            codec = tifffile.COMPRESSION(page.compression).name
            raise ValueError(
                f"its compression {codec} needs another package (pip install imagecodecs); or save "
                "the file without compression or as Deflate (zip)"
            ) from None
        return decoded


def _check_end(page: tifffile.TiffPage) -> None:
    most = 1 << 30  # as OpenCV
    if math.prod(page.shape) > most:
        size = "×".join(map(str, page.shape))
        raise ValueError(f"a page must hold at most {most} values, got a header of {size}")
    ends = np.add(page.dataoffsets, page.databytecounts)
    if len(ends) == 0 or ends.max() > page.parent.filehandle.size:
        raise ValueError("the file is cut off")


def _by_opencv(page: tifffile.TiffPage, path: str, number: int) -> NDArray | None:
    """Return a page that OpenCV can decompress (LZW, JPEG) where tifffile cannot."""
    kind = getattr(page.photometric, "name", "")
    grey = kind in ("MINISWHITE", "MINISBLACK") and page.ndim == 2
    if not grey and page.shape[2:] != (3,):
        return None
    try:
        _, images = cv2.imreadmulti(path, start=number, count=1, flags=cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    if len(images) != 1 or images[0].shape != page.shape or images[0].dtype != page.dtype:
        return None
    if not grey:
        return np.ascontiguousarray(images[0][..., ::-1])  # OpenCV puts blue first
    if kind == "MINISWHITE" and page.dtype == np.uint8:
        return 255 - images[0]  # OpenCV inverts 8-bit pages, and only those
    return images[0]
