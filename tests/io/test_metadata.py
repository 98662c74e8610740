"""Pixel sizes and positions in metadata, in each unit; None where a value is unusable."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from microlib.io import read_frames
from tests.scenes.files import GREY, ome_text, tiff

STACK = np.arange(3 * 8 * 10, dtype=np.uint8).reshape(3, 8, 10)


def write_ome(folder: Path, **about: object) -> Path:
    return tiff(folder / "a.ome.tif", STACK, metadata={"axes": "ZYX", **about})


def planes(positions: list[float], unit: str | None) -> dict:
    units = {"PositionZUnit": [unit] * len(positions)} if unit else {}
    return {"PositionZ": positions, **units}


def edit_ome(path: Path, pattern: str, new: str | Callable[[re.Match], str]) -> None:
    text, count = re.subn(pattern, new, ome_text(path))
    assert count
    tifffile.tiffcomment(path, text.encode())


@pytest.mark.parametrize(
    ("unit", "micrometers"), [("nm", 1e-3), ("µm", 1), ("mm", 1e3), ("cm", 1e4), ("m", 1e6)]
)
def test_ome_sizes_are_converted_to_micrometers(tmp_path, unit, micrometers):
    """Each axis has its own unit: that of y is always µm."""
    sizes = {"PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0 * micrometers, "PhysicalSizeZ": 3.0}
    units = {"PhysicalSizeXUnit": unit, "PhysicalSizeYUnit": "µm", "PhysicalSizeZUnit": unit}
    reader = read_frames(write_ome(tmp_path, **sizes, **units))
    assert reader.pixel_size == pytest.approx(2 * micrometers)
    np.testing.assert_allclose(reader.positions, [0, 3 * micrometers, 6 * micrometers])


OWN_UNITS = {"unit": "nm", "yunit": "um"}


@pytest.mark.parametrize(
    ("about", "size", "step"),
    [
        *(({"unit": unit}, um, 10 * um) for unit, um in (
            ("nm", 1e-3), ("um", 1), ("\\u00b5m", 1), ("micron", 1), ("microns", 1),
            ("Micrometer", 1), ("micrometres", 1), ("nanometre", 1e-3), ("meter", 1e6),
            ("mm", 1e3), ("millimetre", 1e3), ("cm", 1e4), ("centimeter", 1e4),
        )),
        *(({"unit": unit}, None, None) for unit in ("pixel", "PIXELS", "furlong", "", "inch")),
        # Frames may go down; a spacing of zero or text gives no positions.
        ({"unit": "um", "spacing": -10}, 1, -10), ({"unit": "um", "spacing": 0}, 1, None),
        ({"unit": "um", "spacing": "two"}, 1, None),
        # Each axis has its own unit: a pixel is 1000 nm in x and 1 µm in y.
        *((OWN_UNITS | {"zunit": unit}, 1, step) for unit, step in (
            ("um", 10), ("mm", 1e4), ("nm", 0.01), ("sec", None),
        )),
    ],
)  # fmt: skip
def test_imagej_sizes_are_converted_to_micrometers(tmp_path, about, size, step):
    metadata = {"axes": "ZYX", "spacing": 10, **about}
    resolution = (1e-3 if "yunit" in about else 1, 1)
    reader = read_frames(
        tiff(tmp_path / "a.tif", STACK, imagej=True, resolution=resolution, metadata=metadata)
    )
    assert reader.pixel_size == (size and pytest.approx(size))
    assert reader.positions == (step and pytest.approx(step * np.arange(3)))


@pytest.mark.parametrize(
    ("resolution", "unit", "size"),
    [
        ((4000, 4000), "CENTIMETER", 2.5),
        ((4000, 4003), "CENTIMETER", 2.5),  # a difference of 0.08 % counts as square
        ((4000, 4010), "CENTIMETER", "not square"),
        ((4010, 4000), "CENTIMETER", "not square"),
        ((0, 0), "CENTIMETER", None),
        # 72, 300 and 1200 dots per inch.
        *(((dots / 2.54, dots / 2.54), "CENTIMETER", None) for dots in (72, 300, 1200)),
        # Resolutions in inches are meant for printers; software writes them by default.
        ((100, 100), "INCH", None),
        ((100, 100), "NONE", None),
    ],
)
def test_only_a_resolution_in_centimeters_gives_a_pixel_size(tmp_path, resolution, unit, size):
    how = {"resolution": resolution, "resolutionunit": unit, "metadata": None, **GREY}
    path = tiff(tmp_path / "a.tif", STACK, **how)
    if size == "not square":
        with pytest.warns(UserWarning, match=r"a\.tif has pixels of .* not square"):
            reader, size = read_frames(path), None
    else:
        reader = read_frames(path)
    assert reader.positions is None
    assert reader.pixel_size == (size and pytest.approx(size, rel=1e-6))


@pytest.mark.parametrize(
    ("positions", "unit", "spacing", "used", "which"),
    [
        ([5, 5.01, 5.02], None, 10, [0, 10, 20], "latter"),  # mm, but the file does not say so
        ([5, 5.01, 5.02], "reference frame", 10, [0, 10, 20], "latter"),
        ([5, 15, 25], None, 10, [0, 10, 20], None),
        ([0.005, 0.015, 0.025], "mm", 10, [5, 15, 25], None),
        ([5, 15.3, 25.6], "µm", 10, [5, 15.3, 25.6], None),  # near the spacing
        ([5, 12, 19], "µm", 10, [5, 12, 19], "former"),
        ([5, -5, -15], "µm", 10, [5, -5, -15], None),
        ([0.1, 0.2, 0.4], "mm", 150, [100, 200, 400], None),
        ([0.4, 0.2, 0.1], "mm", 150, [400, 200, 100], None),
        ([5, 12, 19], "µm", None, [5, 12, 19], None),
        ([5, 12, 19], None, None, None, None),  # without a unit
        # Positions that are not monotonic contradict any spacing, those that are missing do not.
        *((z, "µm", 9, [0, 9, 18], "latter") for z in ([1, 4, 2], [1, 1, 2], [7, 7, 7], [0, 9, 0])),
        ([1, 1, 1], None, 9, [0, 9, 18], "latter"),
        ([1, 4, 2], "µm", None, None, None),
        ([1, float("nan"), 2], "µm", 9, [0, 9, 18], None),
    ],
)
def test_ome_positions_with_a_unit_are_used_and_disagreement_gives_a_warning(
    tmp_path, positions, unit, spacing, used, which
):
    size = {"PhysicalSizeZ": spacing} if spacing else {}
    path = write_ome(tmp_path, **size, Plane=planes(positions, unit))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read_frames(path).positions
    notes = [str(w.message).split(": ")[1] for w in caught]
    assert notes == ([f"the {which} is used"] if which else [])
    assert found == (used and pytest.approx(np.array(used)))


def test_positions_and_times_belong_to_the_selected_channel(tmp_path):
    many = np.zeros((2, 3, 2, 8, 10), np.uint8)  # T, Z, C
    z = [[[[20.0 * t + 5 * c + k] for c in range(2)] for k in (0, 1, 3)] for t in range(2)]
    metadata = {"axes": "TZCYX", "Plane": planes(np.ravel(z).tolist(), "µm")}
    path = tiff(tmp_path / "a.ome.tif", many, metadata=metadata)
    assert read_frames(path, channel=1, time=1).positions == pytest.approx([25, 26, 28])
    about = {"axes": "TCYX", "Plane": {"DeltaT": [0.0, 1.0, 4.0, 6.0, 9.0, 20.0]}}
    film = tiff(tmp_path / "b.ome.tif", many[:, :, 0].reshape(3, 2, 8, 10), metadata=about)
    found = read_frames(film, channel=1)
    assert [found.time(k) for k in range(3)] == pytest.approx([0, 5, 19])


@pytest.mark.parametrize("axis", ["C", "T"])
def test_positions_are_those_of_the_axis_that_is_named(tmp_path, axis):
    about = {"PhysicalSizeZ": 9, "axes": f"{axis}YX"}
    assert read_frames(write_ome(tmp_path, **about), axis=axis).positions == pytest.approx(
        np.array([0, 9, 18])
    )
    path = write_ome(tmp_path, **about, Plane=planes([4, 12, 22], "µm"))
    assert read_frames(path, axis=axis).positions == pytest.approx(np.array([4, 12, 22]))


@pytest.mark.parametrize(
    ("about", "times"),
    [
        ({"Plane": {"DeltaT": [7.0, 7.5, 9.0]}, "TimeIncrement": 9.0}, [0, 0.5, 2]),
        ({"Plane": {"DeltaT": [7.0, 7.5, 9.0], "DeltaTUnit": ["ms"] * 3}}, [0, 5e-4, 2e-3]),
        # Times that do not rise are no times of frames.
        ({"Plane": {"DeltaT": [7.0, 7.0, 7.0]}, "TimeIncrement": 0.25}, [0, 0.25, 0.5]),
        *(({"TimeIncrement": 4.0, "TimeIncrementUnit": unit}, [0, 4 * s, 8 * s])
          for unit, s in (("µs", 1e-6), ("min", 60), ("h", 3600))),
        ({"TimeIncrement": 4.0, "TimeIncrementUnit": "fortnight"}, [None] * 3),
        ({"TimeIncrement": 0.0}, [None] * 3),
    ],
)  # fmt: skip
def test_times_of_a_film_are_those_of_its_ome_metadata(tmp_path, about, times):
    film = read_frames(write_ome(tmp_path, **about | {"axes": "TYX", "PhysicalSizeZ": 3.0}))
    assert (film.axis, film.positions) == ("T", None)
    assert [film.time(k) for k in range(3)] == pytest.approx(times, abs=1e-9)


def test_times_of_an_imagej_film_are_even(tmp_path):
    for axis, times, spaced in (("T", [0, 0.2, 0.4], False), ("Z", [None] * 3, True)):
        about = {"axes": f"{axis}YX", "finterval": 0.2, "spacing": 3.0, "unit": "um"}
        film = read_frames(tiff(tmp_path / "a.tif", STACK, imagej=True, metadata=about))
        assert [film.time(k) for k in range(3)] == pytest.approx(times)
        assert (film.positions is not None) == spaced


def test_positions_follow_the_numbers_of_the_planes(tmp_path):
    path = write_ome(tmp_path, Plane=planes([400.0, 100.0, 200.0], "µm"))
    edit_ome(path, r'TheZ="(\d)"', lambda found: f'TheZ="{(int(found[1]) - 1) % 3}"')
    np.testing.assert_allclose(read_frames(path).positions, [100, 200, 400])


@pytest.mark.parametrize("axis", ["X", "Y"])
@pytest.mark.parametrize("wrong", ["two", "nan", "-1.0", "0.0"])
def test_size_that_is_no_length_is_ignored(tmp_path, axis, wrong):
    path = write_ome(tmp_path, **{f"PhysicalSize{axis}": 3.25 for axis in "XY"})
    edit_ome(path, f'{axis}="3.25"', f'{axis}="{wrong}"')
    reader = read_frames(path)
    assert (reader.pixel_size, reader.positions) == (None, None)
