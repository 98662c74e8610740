"""Files that the library writes, as other programs read them; images that it reads."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from microlib import io


def test_read_grey_converts_colors_to_luminance(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "c.png"), np.full((5, 6, 3), (0, 0, 255), np.uint8))
    red = np.full((5, 6, 3), (255, 0, 0), np.uint8)
    tifffile.imwrite(tmp_path / "c.tif", red, photometric="rgb")
    for name in ("c.png", "c.tif"):
        image = io.read_grey(tmp_path / name)
        assert image.shape == (5, 6)
        assert (image == 76).all()  # 0.299 of 255: luma of pure red


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    head, body = path.read_bytes().split(b"end_header\n", 1)
    counts = [int(line.split()[-1]) for line in head.splitlines() if line.startswith(b"element")]
    vertices = np.frombuffer(body, "<f4", 3 * counts[0]).reshape(-1, 3)
    faces = np.frombuffer(body[vertices.nbytes :], [("n", "u1"), ("i", "<i4", 3)])
    assert len(faces) == counts[1]
    assert (faces["n"] == 3).all()
    return vertices, faces["i"]


def test_ply_faces_point_to_the_viewer(tmp_path: Path) -> None:
    row, column = np.mgrid[:5, :7]
    height = 3.0 * column - 2.0 * row  # a plane
    height[0, 0] = np.nan
    io.write_ply(tmp_path / "s.ply", height, pixel_size=2.0)
    vertices, faces = read_ply(tmp_path / "s.ply")
    assert len(vertices) == 34
    assert len(faces) == 2 * (4 * 6 - 1)
    x, y, z = vertices.T
    np.testing.assert_allclose(z, 3.0 * x / 2.0 - 2.0 * -y / 2.0, atol=1e-5)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (normal[:, 2] > 0).all()  # faces look at the viewer
    assert 0.5 * normal[:, 2].sum() == pytest.approx(23 * 4.0)  # µm² seen from above


def test_file_that_is_no_image_is_rejected(tmp_path: Path) -> None:
    bad = tmp_path / "bad.png"
    for content in (b"", b"not an image"):
        bad.write_bytes(content)
        with pytest.raises(
            ValueError, match=r"got .*bad\.png: damaged, too large or of an unknown format"
        ):
            io.read_grey(bad)
    for missing in (tmp_path / "no.png", tmp_path):
        with pytest.raises(ValueError, match=r"path must name an image, got .*: no such file"):
            io.read_grey(missing)


def test_maps_are_written_as_ome_tiff_with_the_pixel_size(tmp_path: Path) -> None:
    path = tmp_path / "m.ome.tif"
    rng = np.random.default_rng(0)
    maps = {
        "height": np.array([[1.5, np.nan, 3.0], [0.0, -2.0, 8.25]], np.float32),
        "index": np.array([[-1, 70_000], [3, 4]], np.int32),
        "fused": rng.integers(0, 255, (6, 7, 3)).astype(np.uint8),
    }
    for what, values in maps.items():
        io.write_height_tiff(path, values, pixel_size=0.65, what=what)
        with tifffile.TiffFile(path) as tiff:
            assert tiff.is_ome
            np.testing.assert_array_equal(tiff.asarray(), values)
            image = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]
            tags = tiff.pages[0].aspage().tags
        for axis in "XY":
            numerator, denominator = tags[f"{axis}Resolution"].value
            # px per cm: older versions of tifffile keep six digits.
            assert numerator / denominator == pytest.approx(1e4 / 0.65, rel=1e-6)
        assert tags["ResolutionUnit"].value == 3  # centimeter
        pixels = image["Pixels"]
        assert image["Name"] == what
        assert pixels["PhysicalSizeX"] == pixels["PhysicalSizeY"] == pytest.approx(0.65)
        assert pixels["PhysicalSizeXUnit"] == "µm"
        if what != "height":  # whose NaN are no picture
            assert io.read_frames(path).pixel_size == pytest.approx(0.65)


@pytest.mark.parametrize("color", [False, True])
def test_ply_vertices_have_the_colors_of_their_pixels(tmp_path: Path, color: bool) -> None:
    row, column = np.mgrid[:3, :5]
    height = 3.0 * column - 2.0 * row
    height[0, 0] = np.nan
    image = np.random.default_rng(0).integers(0, 256, (3, 5, 3)).astype(np.uint8)
    image = image if color else image[..., 0]
    io.write_ply(tmp_path / "s.ply", height, pixel_size=2.0, image=image)
    head, body = (tmp_path / "s.ply").read_bytes().split(b"end_header\n", 1)
    assert b"property uchar red\nproperty uchar green\nproperty uchar blue\n" in head
    vertices = np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "u1", 3)], 14)
    x, y, z = vertices["xyz"].T
    np.testing.assert_allclose(z, 3.0 * x / 2.0 - 2.0 * -y / 2.0, atol=1e-5)
    expected = image[(-y / 2).astype(int), (x / 2).astype(int)]
    np.testing.assert_array_equal(
        vertices["rgb"], expected if color else np.stack([expected] * 3, 1)
    )
    with pytest.raises(ValueError, match="image must be uint8 of shape"):
        io.write_ply(tmp_path / "s.ply", height, pixel_size=2.0, image=image[:2])
    with pytest.raises(ValueError, match="height must have at least one cell"):
        io.write_ply(tmp_path / "s.ply", height[:1], pixel_size=2.0)


def test_integer_types_of_maps_are_kept(tmp_path: Path) -> None:
    for dtype in (np.uint8, np.uint16, np.int32, np.int64, np.float64, bool):
        kept = dtype if dtype in (np.uint8, np.uint16, np.int32) else np.float32
        for shape in ((2, 3), (2, 5, 3)):
            io.write_height_tiff(tmp_path / "h.tif", np.ones(shape, dtype), pixel_size=1.0)
            read = tifffile.imread(tmp_path / "h.tif")
            assert (read.shape, read.dtype, read.min(), read.max()) == (shape, kept, 1, 1)
