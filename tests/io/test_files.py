"""Files that the library writes, as other programs read them."""

import contextlib
import os
import stat
from pathlib import Path

import numpy as np
import pytest
import tifffile

from microlib import io
from tests.scenes.files import read_ply, read_stl


@pytest.fixture
def plane():
    row, column = np.mgrid[:5, :7]
    height = 3.0 * column - 2.0 * row
    height[[0, 2], [0, 3]] = np.nan  # one is the corner of a cell, the other of four
    return height


@pytest.mark.parametrize("colors", [None, "grey", "color"])
def test_ply_faces_point_to_the_viewer_and_vertices_have_colors(tmp_path, plane, colors):
    color = np.random.default_rng(0).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    image = {None: None, "grey": color[..., 0], "color": color}[colors]
    io.write_ply(tmp_path / "s.ply", plane, pixel_size=2.0, image=image)
    mesh = read_ply(tmp_path / "s.ply")
    assert (len(mesh["vertices"]), len(mesh["faces"])) == (33, 2 * (4 * 6 - 5))
    x, y, z = mesh["vertices"].T
    np.testing.assert_allclose(z, 3.0 * x / 2.0 - 2.0 * -y / 2.0, atol=1e-5)
    corner = mesh["vertices"][mesh["faces"]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (normal[:, 2] > 0).all()  # faces look at the viewer
    assert 0.5 * normal[:, 2].sum() == pytest.approx(19 * 4.0)  # µm² seen from above
    if image is not None:
        expected = np.broadcast_to(np.atleast_3d(image), (5, 7, 3))
        expected = expected[(-y / 2).astype(int), (x / 2).astype(int)]
        np.testing.assert_array_equal(mesh["colors"], expected)
        with pytest.raises(ValueError, match="image must be uint8 of shape"):
            io.write_ply(tmp_path / "s.ply", plane, pixel_size=2.0, image=image[:2])


def test_stl_has_the_triangles_of_the_ply_and_their_normals(tmp_path, plane):
    io.write_ply(tmp_path / "s.ply", plane, pixel_size=2.0)
    io.write_stl(tmp_path / "s.stl", plane, pixel_size=2.0)
    mesh, facets = read_ply(tmp_path / "s.ply"), read_stl(tmp_path / "s.stl")
    np.testing.assert_array_equal(facets["corners"], mesh["vertices"][mesh["faces"]])
    # z = 1.5 x + y.
    normal = np.array([-1.5, -1.0, 1.0]) / np.sqrt(1.5**2 + 2)
    np.testing.assert_allclose(facets["normals"], np.tile(normal, (38, 1)), atol=1e-6)


@pytest.mark.parametrize("shape", [(2, 3), (2, 5, 3)], ids=["grey", "color"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.int64, np.float64, bool])
def test_maps_are_written_as_ome_tiff_with_type_name_and_pixel_size(tmp_path, dtype, shape):
    path = tmp_path / ("m.ome.tif" if len(shape) == 2 else "M.OME.TIFF")
    values = np.random.default_rng(0).integers(0, 2, shape).astype(dtype)
    if dtype is np.float64:
        values[0, 1] = np.nan
    io.write_height_tiff(path, values, pixel_size=0.65, what="heights")
    with tifffile.TiffFile(path) as tiff:
        assert tiff.is_ome
        written = tiff.asarray()
        image = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]
        page = tiff.pages[0].aspage()
    io.write_height_tiff(tmp_path / "m.tif", values, pixel_size=0.65, what="heights")
    with tifffile.TiffFile(tmp_path / "m.tif") as tiff:
        assert tiff.pages[0].aspage().description == "heights; pixel size 0.65 um"
    # px per cm: older versions of tifffile keep six digits.
    assert page.get_resolution() == pytest.approx([1e4 / 0.65] * 2, rel=1e-6)
    assert page.resolutionunit == tifffile.RESUNIT.CENTIMETER
    assert written.dtype == (dtype if dtype in (np.uint8, np.uint16, np.int32) else np.float32)
    np.testing.assert_array_equal(written, values)
    pixels = image["Pixels"]
    assert image["Name"] == "heights"
    assert pixels["PhysicalSizeX"] == pixels["PhysicalSizeY"] == pytest.approx(0.65)
    assert pixels["PhysicalSizeXUnit"] == "µm"
    if dtype is not np.float64:  # frames with NaN are rejected
        assert io.read_frames(path).pixel_size == pytest.approx(0.65)
        # Of a macro lens; of other software it would be the resolution of a printer.
        io.write_height_tiff(tmp_path / "m.tif", values, pixel_size=25.0)
        assert io.read_frames(tmp_path / "m.tif").pixel_size == pytest.approx(25.0)


@pytest.mark.parametrize("fault", [None, OSError("No space left"), KeyboardInterrupt()])
def test_file_is_replaced_when_the_new_one_is_complete(tmp_path, monkeypatch, fault):
    path = tmp_path / "a.ome.tif"
    path.write_text("old")

    def write(file: Path, *_: object, **__: object) -> None:
        assert file.parent == tmp_path  # on the same disk, so that the file is moved, not copied
        assert file.suffix == ".tif"  # writers choose the format by it
        assert file.name.startswith(".")  # *.tif does not match it
        file.write_text("new")
        assert path.read_text() == "old"
        if fault:
            raise fault

    monkeypatch.setattr(tifffile, "imwrite", write)
    with pytest.raises(type(fault)) if fault else contextlib.nullcontext():
        io.write_height_tiff(path, np.ones((2, 3)), pixel_size=1.0)
    assert path.read_text() == ("old" if fault else "new")
    assert list(tmp_path.iterdir()) == [path]
    for wrong, words in ((tmp_path / "no" / "a.tif", "lie in an existing"), (".", "name a file")):
        with pytest.raises(ValueError, match=f"^path must {words}.*, got .*{Path(wrong).parent}"):
            io.write_height_tiff(wrong, np.ones((2, 3)), pixel_size=1.0)


@pytest.mark.skipif(os.name == "nt", reason="modes and umask are of POSIX")
def test_replacing_a_file_keeps_mode_and_symlink(tmp_path):
    (tmp_path / "disk").mkdir()
    real, link = tmp_path / "disk" / "a.ply", tmp_path / "a.ply"
    link.symlink_to(real)
    before = os.umask(0o027)
    try:
        for mode in (0o600, 0o664, 0o444):
            real.write_text("old")
            real.chmod(mode)
            io.write_ply(link, np.ones((2, 2)), pixel_size=1.0)
            assert stat.S_IMODE(real.stat().st_mode) == mode
            assert real.read_bytes()[:3] == b"ply"
            real.unlink()
        io.write_ply(tmp_path / "new.ply", np.ones((2, 2)), pixel_size=1.0)
        assert stat.S_IMODE((tmp_path / "new.ply").stat().st_mode) == 0o640
    finally:
        os.umask(before)
    assert link.is_symlink()
