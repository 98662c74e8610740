"""Read a photograph; write results to files with units in them, whole or not at all."""

from __future__ import annotations

from fractions import Fraction
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_OID, uuid5

import cv2
import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_array, of_kind, refuse_masks, replace_file, scalar, whole
from microlib.io._headers import picture_size
from microlib.io._tiff import MOST_PIXELS, is_tiff, only_page

_MICROMETERS_PER_CENTIMETER = 1e4
#: Pixels, µm, whose number a centimeter fits into the 32 bits of a TIFF.
_FINEST, _COARSEST = 1e-5, 1e9
#: Rows or columns that OpenCV reads at most.
_LONGEST_SIDE = 1 << 20


def read_grey(path: str | PathLike[str]) -> NDArray:
    """Read an image file as grey values.

    Parameters
    ----------
    path : path-like
        PNG, TIFF of one page, JPEG or any other format that OpenCV knows; colors become grey.

    Returns
    -------
    ndarray of uint8 or uint16, shape (rows, cols)
        The grey values as stored: a grey TIFF of 8 or 16 bits in which zero is white is not
        inverted.

    Raises
    ------
    ValueError
        If there is no such file, or it is cut off, too large, not an image, or a TIFF of several
        pages.

    Examples
    --------
    >>> from microlib.io import read_grey
    >>> read_grey("missing.png")
    Traceback (most recent call last):
    ValueError: path must name an image, got missing.png: no such file
    """
    of_kind("path", path, str, PathLike)
    file = Path(path)
    if not file.is_file():
        raise ValueError(f"path must name an image, got {file}: no such file")
    if is_tiff(file):
        stored = only_page(file)
        if stored is not None:
            return stored
    image = decode("path", file, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise ValueError(f"path must name an image, got {file}: damaged or of an unknown format")
    return image


def decode(name: str, file: Path, flags: int) -> NDArray | None:
    """Return an image as OpenCV reads it; None if it is damaged, cut off or of another format.

    Raises
    ------
    ValueError
        If its header tells of more pixels than OpenCV reads.
    """
    # Not imread: it accepts JPEGs that are cut off, and fails on names outside the system's
    # encoding.
    raw = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    if not raw.size:
        return None
    try:
        return cv2.imdecode(raw, flags)
    except cv2.error:
        height, width = picture_size(file) or (0, 0)
        if width * height <= MOST_PIXELS and max(width, height) <= _LONGEST_SIDE:
            return None
        raise ValueError(
            f"{name} must be of at most {MOST_PIXELS} px, {_LONGEST_SIDE} px a side, got {file} "
            f"with a header of {width}×{height} px"
        ) from None


def write_height_tiff(
    path: str | PathLike[str],
    height: ArrayLike,
    *,
    pixel_size: float,
    what: str = "height in um",
) -> None:
    """Write a height map, or another map of its pixels, as a TIFF that others open to scale.

    Parameters
    ----------
    path : path-like
        File to write; an old one is replaced only once the new one is whole. A name that ends in
        ``.ome.tif`` makes it an OME-TIFF, with the pixel size as PhysicalSizeX and PhysicalSizeY.
    height : array_like, shape (rows, cols) or (rows, cols, 3)
        Heights, µm, or their uncertainties, frame numbers, grey levels or colors; NaN where
        unknown. Integers of 8 and 16 bits without and of 32 with a sign are kept, other types
        become float32.
    pixel_size : float
        Size of a pixel, in µm/px.
    what : str
        What the values are, for whoever opens the file.

    Raises
    ------
    ValueError
        If `height` is no map or `pixel_size` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from pathlib import Path
    >>> from microlib.io import write_height_tiff
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_height_tiff(Path(folder) / "height.tif", np.ones((4, 5)), pixel_size=2.0)
    ...     print(tifffile.imread(Path(folder) / "height.tif").shape)
    (4, 5)
    """
    of_kind("path", path, str, PathLike)
    of_kind("what", what, str)
    values = _map(height)
    size = scalar("pixel_size", pixel_size, above=0, least=_FINEST, most=_COARSEST)
    per_centimeter = _ratio(_MICROMETERS_PER_CENTIMETER / size)
    ome = Path(path).name.lower().endswith((".ome.tif", ".ome.tiff"))
    about: dict[str, Any] = {"description": f"{what}; pixel size {size:g} um"}
    if ome:
        sizes = {f"PhysicalSize{axis}": size for axis in "XY"}
        units = {f"PhysicalSize{axis}Unit": "µm" for axis in "XY"}
        axes = {"axes": "YX" if values.ndim == 2 else "YXS"}
        named = {"Name": what, "UUID": _identifier(values, size, what)}
        about = {"metadata": {**axes, **sizes, **units, **named}}

    def write(file: Path) -> None:
        tifffile.imwrite(
            file,
            values,
            resolution=(per_centimeter, per_centimeter),
            resolutionunit="CENTIMETER",
            photometric="minisblack" if values.ndim == 2 else "rgb",
            ome=ome,
            software=False,
            **about,
        )

    replace_file(path, write)


def _identifier(values: NDArray, pixel_size: float, what: str) -> str:
    """Return the identifier of a map that OME asks for: the same for the same map."""
    told = f"{what} {pixel_size!r} {values.dtype.str} {values.shape}".encode()
    content = sha256(told + np.ascontiguousarray(values).tobytes()).hexdigest()
    return f"urn:uuid:{uuid5(NAMESPACE_OID, content)}"


def _map(values: ArrayLike) -> NDArray:
    """Return a map in a type that files keep."""
    refuse_masks("height", values)
    array = values if isinstance(values, np.ndarray) else as_array("height", values, finite=False)
    kept = array.dtype if array.dtype in (np.uint8, np.uint16, np.int32) else np.float32
    if array.ndim == 3 and array.shape[2] == 3:
        return as_array("height", values, shape=(None, None, 3), dtype=kept, finite=False)
    return as_array("height", values, shape=(None, None), dtype=kept, finite=False)


def write_ply(
    path: str | PathLike[str],
    height: ArrayLike,
    *,
    pixel_size: float,
    image: ArrayLike | None = None,
    step: int = 1,
) -> None:
    """Write a height map as a triangle mesh in the PLY format, lengths in µm.

    Parameters
    ----------
    path : path-like
        File to write; an old one is replaced only once the new one is whole.
    height : array_like, shape (rows, cols)
        Heights, in µm; cells with a NaN at a corner are left out.
    pixel_size : float
        Size of a pixel, in µm/px.
    image : array_like of uint8, shape (rows, cols) or (rows, cols, 3), optional
        Grey levels or colors of the vertices.
    step : int
        Side of the square blocks of pixels that become one vertex, at the mean of what is known of
        them if that is at least half.

    Raises
    ------
    ValueError
        If `height` is not two-dimensional, has no whole cell, `pixel_size` is not positive, or
        `image` is of another size or type.

    Notes
    -----
    Image rows run down and a mesh's y runs up, so y is negated: seen from above, the mesh looks
    like the image and its triangles face the viewer.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from microlib.io import write_ply
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_ply(Path(folder) / "surface.ply", np.ones((2, 2)), pixel_size=2.0)
    ...     print((Path(folder) / "surface.ply").read_bytes()[:3])
    b'ply'
    """
    of_kind("path", path, str, PathLike)
    heights = as_array("height", height, shape=(None, None), finite=False)
    size = scalar("pixel_size", pixel_size, above=0, least=_FINEST, most=_COARSEST)
    by = whole("step", step, least=1)
    colors = None if image is None else _colors(image, heights.shape)
    if by > 1:
        heights = _block_means(heights, by)
        if colors is not None:
            colors = np.rint(
                np.stack([_block_means(c, by) for c in np.moveaxis(colors, 2, 0)], axis=2)
            ).astype(np.uint8)
    # The middle of the first block.
    content = _mesh(heights, colors, size * by, size * (by - 1) / 2)

    def write(file: Path) -> None:
        file.write_bytes(content)

    replace_file(path, write)


def _colors(image: ArrayLike, shape: tuple[int, ...]) -> NDArray:
    refuse_masks("image", image)
    colors = image if isinstance(image, np.ndarray) else as_array("image", image)
    if colors.dtype != np.uint8 or colors.shape not in (shape, (*shape, 3)):
        raise ValueError(
            f"image must be uint8 of shape {shape} or {(*shape, 3)}, "
            f"got {colors.dtype} of shape {colors.shape}"
        )
    return colors if colors.ndim == 3 else np.repeat(colors[..., None], 3, axis=2)


def _block_means(values: NDArray, by: int) -> NDArray:
    """Return the means of what is known in square blocks, NaN where that is less than half."""
    rows, cols = (n // by for n in values.shape)
    if min(rows, cols) == 0:
        raise ValueError(f"step must be at most the sides of height {values.shape}, got {by}")
    blocks = values[: rows * by, : cols * by].reshape(rows, by, cols, by).swapaxes(1, 2)
    flat = blocks.reshape(rows, cols, by * by).astype(np.float64)
    known = np.isfinite(flat)
    count = known.sum(axis=2)
    total = np.where(known, flat, 0.0).sum(axis=2)
    return np.where(2 * count >= by * by, total / np.maximum(count, 1), np.nan)


def _mesh(heights: NDArray, colors: NDArray | None, spacing: float, first: float) -> bytes:
    """Return a PLY file of the vertices with known heights and the triangles between them."""
    known = np.isfinite(heights)
    cells = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    if not cells.any():
        raise ValueError(
            f"height must have at least one cell of four known heights, got {int(known.sum())} "
            f"known of {heights.size}"
        )
    number = np.cumsum(known.ravel()).reshape(known.shape) - 1
    row, column = np.nonzero(known)
    layout = [(axis, "<f4") for axis in "xyz"]
    layout += [] if colors is None else [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.empty(len(row), dtype=layout)
    vertices["x"], vertices["y"] = first + column * spacing, -(first + row * spacing)
    vertices["z"] = heights[known]
    if colors is not None:
        vertices["red"], vertices["green"], vertices["blue"] = colors[known].T
    corners = [
        number[:-1, :-1][cells],
        number[1:, :-1][cells],
        number[1:, 1:][cells],
        number[:-1, 1:][cells],
    ]
    triangles = np.concatenate(
        [
            np.column_stack([corners[k] for k in (0, 1, 2)]),
            np.column_stack([corners[k] for k in (0, 2, 3)]),
        ]
    )
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, triangles
    kinds = {"<f4": "float", "u1": "uchar"}
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment lengths in micrometers",
            f"element vertex {len(vertices)}",
            *(f"property {kinds[kind]} {name}" for name, kind in layout),
            f"element face {len(faces)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        ]
    )
    return header.encode("ascii") + vertices.tobytes() + faces.tobytes()


def _ratio(number: float) -> tuple[int, int]:
    """Return the best ratio of two 32-bit numbers; older versions of tifffile keep six digits."""
    most = 2**32 - 1
    ratio = Fraction(number).limit_denominator(max(1, int(min(1, 1 / number) * most)))
    return ratio.numerator, ratio.denominator
