"""Read a photograph; write results to files with units in them, whole or not at all."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_array, of_kind, replace_file, scalar
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


def write_height_tiff(path: str | PathLike[str], height: ArrayLike, *, pixel_size: float) -> None:
    """Write a height map as a float32 TIFF that ImageJ and others open to scale.

    Parameters
    ----------
    path : path-like
        File to write; an old one is replaced only once the new one is whole.
    height : array_like, shape (rows, cols)
        Heights, in µm; NaN where unknown.
    pixel_size : float
        Size of a pixel, in µm/px.

    Raises
    ------
    ValueError
        If `height` is not two-dimensional or `pixel_size` is not positive.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_height_tiff(Path(folder) / "height.tif", np.ones((4, 5)), pixel_size=2.0)
    ...     print(tifffile.imread(Path(folder) / "height.tif").shape)
    (4, 5)
    """
    of_kind("path", path, str, PathLike)
    heights = as_array("height", height, shape=(None, None), dtype=np.float32, finite=False)
    size = scalar("pixel_size", pixel_size, above=0, least=_FINEST, most=_COARSEST)
    per_centimeter = _MICROMETERS_PER_CENTIMETER / size

    def write(file: Path) -> None:
        tifffile.imwrite(
            file,
            heights,
            resolution=(per_centimeter, per_centimeter),
            resolutionunit="CENTIMETER",
            description=f"height in um; pixel size {size:g} um",
            software=False,
        )

    replace_file(path, write)


def write_ply(path: str | PathLike[str], height: ArrayLike, *, pixel_size: float) -> None:
    """Write a height map as a triangle mesh in the PLY format, lengths in µm.

    Parameters
    ----------
    path : path-like
        File to write; an old one is replaced only once the new one is whole.
    height : array_like, shape (rows, cols)
        Heights, in µm; cells with a NaN at a corner are left out.
    pixel_size : float
        Size of a pixel, in µm/px.

    Raises
    ------
    ValueError
        If `height` is not two-dimensional, has no whole cell, or `pixel_size` is not positive.

    Notes
    -----
    Image rows run down and a mesh's y runs up, so y is negated: seen from above, the mesh looks
    like the image and its triangles face the viewer.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_ply(Path(folder) / "surface.ply", np.ones((2, 2)), pixel_size=2.0)
    ...     print((Path(folder) / "surface.ply").read_bytes()[:3])
    b'ply'
    """
    of_kind("path", path, str, PathLike)
    heights = as_array("height", height, shape=(None, None), finite=False)
    size = scalar("pixel_size", pixel_size, above=0, least=_FINEST, most=_COARSEST)
    known = np.isfinite(heights)
    cells = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    if not cells.any():
        raise ValueError(
            f"height must have at least one cell of four known heights, got {int(known.sum())} "
            f"known of {heights.size}"
        )
    number = np.cumsum(known.ravel()).reshape(known.shape) - 1
    row, column = np.nonzero(known)
    vertices = np.column_stack([column * size, -row * size, heights[known]]).astype("<f4")
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
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment lengths in micrometers",
            f"element vertex {len(vertices)}",
            *(f"property float {axis}" for axis in "xyz"),
            f"element face {len(faces)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        ]
    )
    content = header.encode("ascii") + vertices.tobytes() + faces.tobytes()

    def write(file: Path) -> None:
        file.write_bytes(content)

    replace_file(path, write)
