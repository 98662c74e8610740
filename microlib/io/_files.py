"""Read a photograph; write results to files with units in them, whole or not at all."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from microlib._common import as_array, of_kind, replace_file, scalar, whole
from microlib.io._frames import read_frames, reduced
from microlib.io._metadata import MICROMETERS


def read_grey(path: str | PathLike[str]) -> NDArray:
    """Read an image file as grey values.

    Parameters
    ----------
    path : path-like
        PNG, TIFF of one page, JPEG or any other format that OpenCV knows; colors become grey.

    Returns
    -------
    ndarray of uint8, uint16 or float32, shape (rows, cols)
        The grey values as stored, those of other types as float32: a TIFF in which zero is white is
        not inverted.

    Raises
    ------
    ValueError
        If there is no such file, or it is cut off, too large, not an image, or a TIFF of several
        pages.

    Examples
    --------
    >>> from microlib.io import read_grey
    >>> read_grey("a.png")
    Traceback (most recent call last):
    ValueError: path must name an image, got a.png: frames cannot be read from a.png: no such file
    """
    of_kind("path", path, str, PathLike)
    try:
        return next(read_frames([path]))
    except ValueError as error:
        raise ValueError(f"path must name an image, got {path}: {error}") from error


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
    dtype = getattr(height, "dtype", None)
    kept = dtype if dtype in (np.uint8, np.uint16, np.int32) else np.float32
    values = as_array("height", height, dtype=kept, finite=False)
    if values.shape[2:] != (3,):
        as_array("height", values, shape=(None, None), dtype=kept, finite=False)
    # The number of pixels in a centimeter fits into the 32 bits of a TIFF.
    size = scalar("pixel_size", pixel_size, above=0, least=1e-5, most=1e9)
    ome = Path(path).name.lower().endswith((".ome.tif", ".ome.tiff"))
    about: dict[str, Any] = {"description": f"{what}; pixel size {size:g} um"}
    if ome:
        sizes = {f"PhysicalSize{axis}": size for axis in "XY"}
        units = {f"PhysicalSize{axis}Unit": "µm" for axis in "XY"}
        axes = {"axes": "YX" if values.ndim == 2 else "YXS"}
        about = {"metadata": {**axes, **sizes, **units, "Name": what}}

    def write(file: Path) -> None:
        tifffile.imwrite(
            file,
            values,
            resolution=2 * (MICROMETERS["cm"] / size,),
            resolutionunit="CENTIMETER",
            photometric="minisblack" if values.ndim == 2 else "rgb",
            ome=ome,
            software=False,
            **about,
        )

    replace_file(path, write)


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
    size = scalar("pixel_size", pixel_size, above=0, most=1e9)
    by = whole("step", step, least=1)
    colors = None if image is None else _colors(image, heights.shape)
    if by > 1:
        known = np.isfinite(heights)
        share = reduced("height", known.astype(np.float64), by)
        total = reduced("height", np.where(known, heights, 0.0), by)
        # A block of which half is known counts, whatever the rounding of its share.
        enough = share > 0.5 - 0.5 / by**2
        heights = np.where(enough, total / np.where(enough, share, 1.0), np.nan)
        colors = None if colors is None else reduced("image", colors, by)
    # The middle of the first block.
    content = _mesh(heights, colors, size * by, size * (by - 1) / 2)
    replace_file(path, lambda file: file.write_bytes(content))


def _colors(image: ArrayLike, shape: tuple[int, ...]) -> NDArray:
    colors = as_array("image", image, dtype=getattr(image, "dtype", np.float64), finite=False)
    if colors.dtype != np.uint8 or colors.shape not in (shape, (*shape, 3)):
        raise ValueError(
            f"image must be uint8 of shape {shape} or {(*shape, 3)}, "
            f"got {colors.dtype} of shape {colors.shape}"
        )
    return colors if colors.ndim == 3 else np.repeat(colors[..., None], 3, axis=2)


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
    names, layout = ["float x", "float y", "float z"], [("xyz", "<f4", 3), ("rgb", "u1", 3)]
    names += [] if colors is None else ["uchar red", "uchar green", "uchar blue"]
    vertices = np.empty(len(row), dtype=layout[: len(names) // 3])
    x, y = first + column * spacing, -(first + row * spacing)
    vertices["xyz"] = np.column_stack([x, y, heights[known]])
    if colors is not None:
        vertices["rgb"] = colors[known]
    around = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    corners = np.column_stack([corner[cells] for corner in around])
    faces = np.empty(2 * len(corners), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"] = 3
    faces["index"][::2], faces["index"][1::2] = corners[:, :3], corners[:, [0, 2, 3]]
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment lengths in micrometers\n"
        f"element vertex {len(vertices)}\n"
        + "".join(f"property {kind}\n" for kind in names)
        + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode("ascii") + vertices.tobytes() + faces.tobytes()
