"""Pixel sizes and positions in TIFF files, in each unit; None where a value is unusable."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import tifffile

from microlib.io import read_frames

STACK = np.arange(3 * 8 * 10, dtype=np.uint8).reshape(3, 8, 10)


@pytest.mark.parametrize(
    ("unit", "micrometers"),
    [("nm", 1e-3), ("µm", 1), ("mm", 1e3), ("cm", 1e4), ("m", 1e6)],
)
def test_ome_sizes_are_converted_to_micrometers(tmp_path, unit, micrometers):
    sizes = {f"PhysicalSize{axis}": 2.0 for axis in "XYZ"}
    units = {f"PhysicalSize{axis}Unit": unit for axis in "XYZ"}
    metadata = {"axes": "ZYX", **sizes, **units}
    tifffile.imwrite(tmp_path / "a.ome.tif", STACK, metadata=metadata)
    reader = read_frames(tmp_path / "a.ome.tif")
    assert reader.pixel_size == pytest.approx(2 * micrometers)
    np.testing.assert_allclose(reader.positions, [0, 2 * micrometers, 4 * micrometers])


@pytest.mark.parametrize(
    ("unit", "spacing", "size", "step"),
    [
        *((unit, 2.5, 0.25 * um, 2.5 * um) for unit, um in (
            ("nm", 1e-3), ("um", 1), ("\\u00b5m", 1), ("micron", 1), ("microns", 1),
            ("Micrometer", 1), ("mm", 1e3), ("cm", 1e4),
        )),
        *((unit, 2.5, None, None) for unit in ("pixel", "PIXELS", "furlong", "", "inch")),
        # A spacing is a length.
        ("um", -2.5, 0.25, 2.5), ("um", 0, 0.25, None), ("um", "two", 0.25, None),
    ],
)  # fmt: skip
def test_imagej_sizes_are_converted_to_micrometers(tmp_path, unit, spacing, size, step):
    about = {"axes": "ZYX", "spacing": spacing, "unit": unit}
    tifffile.imwrite(tmp_path / "a.tif", STACK, imagej=True, resolution=(4, 4), metadata=about)
    reader = read_frames(tmp_path / "a.tif")
    assert reader.pixel_size == (size and pytest.approx(size))
    assert reader.positions == (step and pytest.approx(step * np.arange(3)))


@pytest.mark.parametrize(
    ("resolution", "unit", "size"),
    [
        ((4000, 4000), "CENTIMETER", 2.5),
        ((4000, 4003), "CENTIMETER", 2.5),  # one in a thousand apart is square still
        ((0, 0), "CENTIMETER", None),
        # 72, 300 and 1200 dots per inch.
        *(((dots / 2.54, dots / 2.54), "CENTIMETER", None) for dots in (72, 300, 1200)),
        # A resolution in inches is a printer's, which software writes unasked.
        ((100, 100), "INCH", None),
        ((100, 100), "NONE", None),
    ],
)
def test_only_a_resolution_in_centimeters_gives_a_pixel_size(tmp_path, resolution, unit, size):
    tifffile.imwrite(
        tmp_path / "a.tif", STACK, photometric="minisblack", metadata=None,
        resolution=resolution, resolutionunit=unit,
    )  # fmt: skip
    reader = read_frames(tmp_path / "a.tif")
    assert reader.positions is None
    assert reader.pixel_size == (size and pytest.approx(size, rel=1e-6))


@pytest.mark.parametrize("resolution", [(4000, 4010), (4010, 4000)])
def test_pixels_that_are_not_square_give_a_warning(tmp_path, resolution):
    tifffile.imwrite(
        tmp_path / "a.tif", STACK, photometric="minisblack", metadata=None,
        resolution=resolution, resolutionunit="CENTIMETER",
    )  # fmt: skip
    with pytest.warns(UserWarning, match=r"a\.tif has pixels of .* not square"):
        assert read_frames(tmp_path / "a.tif").pixel_size is None


@pytest.mark.parametrize(
    ("zunit", "step"), [("um", 2500.0), ("mm", 2.5e6), ("sec", None), ("nm", 2.5)]
)
def test_imagej_axes_can_have_their_own_units(tmp_path, zunit, step):
    about = {"axes": "ZYX", "spacing": 2500.0, "unit": "nm", "yunit": "um", "zunit": zunit}
    tifffile.imwrite(
        tmp_path / "a.tif", STACK, imagej=True, resolution=(1 / 250, 4), metadata=about
    )
    reader = read_frames(tmp_path / "a.tif")
    assert reader.pixel_size == pytest.approx(0.25)
    assert reader.positions == (step and pytest.approx(step * np.arange(3)))


@pytest.mark.parametrize(
    ("step", "unit", "spacing", "used", "which"),
    [
        (0.01, None, 10.0, 10.0, "latter"),  # of a microscope that counts in mm
        (0.01, "reference frame", 10.0, 10.0, "latter"),
        (10.0, None, 10.0, 10.0, None),
        (0.01, "mm", 10.0, 10.0, None),
        (10.3, "µm", 10.0, 10.3, None),  # as measured
        (7.0, "µm", 10.0, 7.0, "former"),
        (-10.0, "µm", 10.0, -10.0, None),
        (7.0, "µm", None, 7.0, None),
        (7.0, None, None, None, None),  # in whatever unit
    ],
)
def test_ome_positions_without_a_unit_are_not_used_and_disagreement_is_noted(
    tmp_path, step, unit, spacing, used, which
):
    plane: dict = {"PositionZ": [5 + step * k for k in range(3)]}
    plane |= {"PositionZUnit": [unit] * 3} if unit else {}
    size = {"PhysicalSizeZ": spacing} if spacing else {}
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, STACK, metadata={"axes": "ZYX", **size, "Plane": plane})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        positions = read_frames(path).positions
    assert [str(w.message).split(": ")[1] for w in caught] == (
        [f"the {which} is used"] if which else []
    )
    if used is None:
        assert positions is None
    else:
        assert np.diff(positions) == pytest.approx([used] * 2)


def test_positions_belong_to_the_selected_channel_and_time(tmp_path):
    many = np.zeros((2, 3, 2, 8, 10), np.uint8)  # T, Z, C
    z = [[[[20.0 * t + 5 * c + k] for c in range(2)] for k in (0, 1, 3)] for t in range(2)]
    plane = {"PositionZ": np.ravel(z).tolist(), "PositionZUnit": ["µm"] * 12}
    tifffile.imwrite(tmp_path / "a.ome.tif", many, metadata={"axes": "TZCYX", "Plane": plane})
    reader = read_frames(tmp_path / "a.ome.tif", channel=1, time=1)
    assert reader.positions == pytest.approx([25, 26, 28])


def ome_text(path: Path) -> str:
    with tifffile.TiffFile(path) as tiff:
        text = tiff.ome_metadata
    assert text
    return text


def written(
    path: Path, positions: list[float], order: list[int] | None = None, size: float = 150.0
) -> None:
    """Write an OME-TIFF with a position of each plane, and planes in another order."""
    plane = {"PositionZ": positions, "PositionZUnit": ["mm"] * 3}
    metadata = {"axes": "ZYX", "PhysicalSizeZ": size, "Plane": plane}
    tifffile.imwrite(path, STACK, metadata=metadata)
    if order:
        text = ome_text(path)
        for k, other in enumerate(order):
            text = text.replace(f'TheZ="{k}"', f'TheZ="#{other}"')
        tifffile.tiffcomment(path, text.replace("#", "").encode())


def test_positions_follow_the_order_of_planes(tmp_path):
    path = tmp_path / "a.ome.tif"
    written(path, [0.1, 0.2, 0.4])
    np.testing.assert_allclose(read_frames(path).positions, [100, 200, 400])
    written(path, [0.4, 0.2, 0.1])
    np.testing.assert_allclose(read_frames(path).positions, [400, 200, 100])
    written(path, [0.4, 0.1, 0.2], [2, 0, 1])
    np.testing.assert_allclose(read_frames(path).positions, [100, 200, 400])


@pytest.mark.parametrize("positions", [[0.1, 0.4, 0.2], [0.1, 0.1, 0.2], [0.1, float("nan"), 0.2]])
def test_positions_that_are_not_monotonic_are_ignored(tmp_path, positions):
    written(tmp_path / "a.ome.tif", positions, size=9.0)
    np.testing.assert_allclose(read_frames(tmp_path / "a.ome.tif").positions, [0, 9, 18])


@pytest.mark.parametrize("wrong", ["two", "nan", "-1.0", "0.0"])
def test_size_that_is_no_length_is_ignored(tmp_path, wrong):
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, STACK, metadata={"axes": "ZYX", "PhysicalSizeX": 3.25})
    text = ome_text(path)
    assert text.count('"3.25"') == 1
    tifffile.tiffcomment(path, text.replace('"3.25"', f'"{wrong}"').encode())
    reader = read_frames(path)
    assert (reader.pixel_size, reader.positions) == (None, None)
