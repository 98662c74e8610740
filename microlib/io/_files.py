"""Read a photograph; write height maps as TIFF and PLY, atomically and to scale."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray

from microlib._common import (
    MICROMETERS,
    SOFTWARE,
    as_array,
    as_instance,
    as_scalar,
    reject_masks,
    replace_file,
)
from microlib.io._read import read_frames


def read_grey(path: str | PathLike[str]) -> NDArray:
    """Read an image file as grey values.

    Parameters
    ----------
    path : path-like
        PNG, TIFF of one page, JPEG or any other format that OpenCV reads; colors become grey.

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
    ValueError: path must name an image, got a.png: no such file
    """
    try:
        return next(iter(read_frames([path])))
    except ValueError as error:
        reason = str(error).removeprefix(f"frames cannot be read from {path}: ")
        raise ValueError(f"path must name an image, got {path}: {reason}") from error


def write_height_tiff(
    path: str | PathLike[str],
    height: ArrayLike,
    *,
    pixel_size: float | None,
    what: str = "height in um",
) -> None:
    """Write a height map, or another map, as a TIFF with its pixel size.

    Parameters
    ----------
    path : path-like
        File to write; an existing file is replaced when the new one is complete. A name that ends
        in ``.ome.tif`` makes it an OME-TIFF with the pixel size as PhysicalSizeX and PhysicalSizeY.
    height : array_like, shape (rows, cols) or (rows, cols, 3)
        Heights, µm, or their uncertainties, frame numbers, grey levels or colors; NaN where
        unknown. Integers of 8 and 16 bits without and of 32 with a sign are kept, other types
        become float32.
    pixel_size : float or None
        Size of a pixel, in µm/px; None if it is not known.
    what : str
        Description of the values in the file.

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
    dtype = getattr(height, "dtype", None)
    kept = dtype if dtype in (np.uint8, np.uint16, np.int32) else np.float32
    values = as_array("height", height, dtype=kept, finite=False)
    rgb = values.ndim == 3
    shape = (None, None, 3) if rgb else (None, None)
    as_array("height", values, shape=shape, dtype=kept, finite=False)
    about: dict[str, Any] = {"description": as_instance("what", what, str).encode()}
    sizes: dict[str, Any] = {}
    if pixel_size is not None:
        # The number of pixels in a centimeter fits into the 32 bits of a TIFF.
        size = as_scalar("pixel_size", pixel_size, above=0, least=1e-5)
        about["description"] += f"; pixel size {size:g} um".encode()
        about |= {"resolution": 2 * (MICROMETERS["cm"] / size,), "resolutionunit": "CENTIMETER"}
        for axis in "XY":
            sizes |= {f"PhysicalSize{axis}": size, f"PhysicalSize{axis}Unit": "µm"}
    if Path(path).name.lower().endswith((".ome.tif", ".ome.tiff")):
        del about["description"]
        about["metadata"] = {"axes": "YXS" if rgb else "YX", **sizes, "Name": what}
    about |= {"photometric": "rgb" if rgb else "minisblack", "software": SOFTWARE}
    replace_file(path, lambda file: tifffile.imwrite(file, values, **about))


def write_ply(
    path: str | PathLike[str],
    height: ArrayLike,
    *,
    pixel_size: float,
    image: ArrayLike | None = None,
) -> None:
    """Write a height map as a triangle mesh in the PLY format, lengths in µm.

    Parameters
    ----------
    path : path-like
        File to write; an existing file is replaced when the new one is complete.
    height : array_like, shape (rows, cols)
        Heights, in µm; cells with a NaN at a corner are left out.
    pixel_size : float
        Size of a pixel, in µm/px.
    image : array_like of uint8, shape (rows, cols) or (rows, cols, 3), optional
        Grey levels or colors of the vertices.

    Raises
    ------
    ValueError
        If `height` is not two-dimensional, has no cell of known heights, `pixel_size` is not
        positive, or `image` is of another size or type.

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
    known, vertices, triangles = _mesh(height, pixel_size)
    columns = dict(zip(("float x", "float y", "float z"), vertices.T, strict=True))
    if image is not None:
        reject_masks("image", image)
        colors, shape = np.asarray(image), (*known.shape, 3)
        if colors.dtype != np.uint8 or colors.shape not in (known.shape, shape):
            need = f"image must be uint8 of shape {known.shape} or {shape}"
            raise ValueError(f"{need}, got {colors.dtype} of shape {colors.shape}")
        levels = np.broadcast_to(np.atleast_3d(colors), shape)[known].T
        columns |= zip(("uchar red", "uchar green", "uchar blue"), levels, strict=True)
    layout = [(name, "<f4" if name.startswith("float") else "u1") for name in columns]
    rows = np.rec.fromarrays([*columns.values()], dtype=layout)
    faces = np.empty(len(triangles), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, triangles
    header = [
        "ply\nformat binary_little_endian 1.0\ncomment lengths in micrometers",
        f"element vertex {len(rows)}",
        *(f"property {name}" for name in columns),
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n",
    ]
    content = "\n".join(header).encode("ascii") + rows.tobytes() + faces.tobytes()
    replace_file(path, lambda file: file.write_bytes(content))


def write_stl(path: str | PathLike[str], height: ArrayLike, *, pixel_size: float) -> None:
    """Write a height map as a triangle mesh in the binary STL format, lengths in µm.

    Parameters
    ----------
    path : path-like
        File to write; an existing file is replaced when the new one is complete.
    height : array_like, shape (rows, cols)
        Heights, in µm; cells with a NaN at a corner are left out.
    pixel_size : float
        Size of a pixel, in µm/px.

    Raises
    ------
    ValueError
        If `height` is not two-dimensional, has no cell of known heights, or `pixel_size` is not
        positive.

    Notes
    -----
    The mesh is that of `write_ply`, without colors. STL has no unit of length: a program that
    assumes millimeters shows the mesh a thousand times too large.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from microlib.io import write_stl
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_stl(Path(folder) / "surface.stl", np.ones((2, 2)), pixel_size=2.0)
    ...     print((Path(folder) / "surface.stl").stat().st_size)
    184
    """
    _, vertices, triangles = _mesh(height, pixel_size)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(corners), [("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    facets["vectors"] = np.concatenate([normals[:, None], corners], axis=1)
    content = SOFTWARE.encode().ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()
    replace_file(path, lambda file: file.write_bytes(content))


def _mesh(height: ArrayLike, pixel_size: float) -> tuple[NDArray[np.bool_], NDArray, NDArray]:
    """Return which heights are known, their places (n, 3) in µm, and triangles (m, 3) of these."""
    heights = as_array("height", height, shape=(None, None), finite=False)
    size = as_scalar("pixel_size", pixel_size, above=0)
    known = np.isfinite(heights)
    cells = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    if not cells.any():
        raise ValueError(
            f"height must have at least one cell of four known heights, got {known.sum()} known"
        )
    row, column = np.nonzero(known)
    number = np.cumsum(known).reshape(known.shape) - 1
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    a, b, c, d = (corner[cells] for corner in corners)
    places = [column * size, -row * size, heights[known]]
    vertices = np.stack(places, axis=1).astype(np.float32)
    return known, vertices, np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
