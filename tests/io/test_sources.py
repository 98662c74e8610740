"""Readers that are read again, in parts or by another reader; videos; folders with other files."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from microlib.focus import depth_from_focus
from microlib.io import read_frames, write_height_tiff
from tests.io.conftest import COUNT
from tests.scenes.files import Lazy, pictures, tiff, varied_times


def read_stack(source: object, **options: bool | int) -> NDArray:
    return np.stack(list(read_frames(source, **options)))


def write_film(path: Path, code: str, frames: NDArray, times: int = 1) -> Path:
    """Write a video `times` times into one file; the header describes the first only."""
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25, (56, 48))
    if not film.isOpened():
        pytest.skip(f"OpenCV writes no {code} here")
    for frame in frames:
        film.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    film.release()
    path.write_bytes(times * path.read_bytes())
    return path


def test_lazy_frames_are_loaded_one_by_one(stack):
    lazy = Lazy(stack)
    frames = iter(read_frames(lazy))
    assert lazy.loaded == [0]  # shape and type come from the first frame
    next(frames)
    next(frames)
    assert lazy.loaded == [0, 0, 1]


def test_video_with_fewer_frames_than_its_header_is_rejected(stack, tmp_path, monkeypatch):
    image = np.full((4, 6, 3), (1, 2, 3), np.uint8)  # blue, green and red

    def film(path: str) -> SimpleNamespace:
        left = [(True, image)] * 3
        return SimpleNamespace(
            isOpened=lambda: True,
            release=lambda: None,
            get=lambda which: 4.0,  # the header's number of frames; three can be read
            read=lambda: left.pop() if left else (False, None),
        )

    monkeypatch.setattr(cv2, "VideoCapture", film)
    (tmp_path / "a.MP4").write_bytes(b"film")
    reader = read_frames(tmp_path / "a.MP4", color=True)
    assert (reader.count, reader.shape) == (4, (4, 6))
    for _ in range(2):
        seen = []
        with pytest.raises(ValueError, match=r"a\.MP4: its header has 4 frames, 3 can be read"):
            seen.extend(reader)
        np.testing.assert_array_equal(seen, np.full((3, 4, 6, 3), (3, 2, 1)))
    assert [reader.time(k) for k in range(3)] == [0, None, None]  # of each the header has 4 ms


@pytest.mark.parametrize(
    ("name", "code", "times"),
    [("a.avi", "MJPG", 1), ("a.mpeg", "PIM1", 1), ("a.mkv", "MJPG", 2), ("a.avi", "MJPG", 2)],
)
def test_video_is_read_also_beyond_the_frames_of_its_header(stack, tmp_path, name, code, times):
    """Formats without an index have an unknown number of frames until all were read."""
    path, count = write_film(tmp_path / name, code, stack, times), times * COUNT
    reader = read_frames(path)
    found = read_stack(reader).astype(float)
    assert (reader.shape, reader.color) == ((48, 56), False)
    assert reader.count == (COUNT if name == "a.avi" else None)
    assert len(found) == count
    assert np.abs(found - np.concatenate([stack] * times)).mean() < 10  # lossy compression


def test_times_of_a_video_are_those_of_its_frames(stack, tmp_path):
    path = write_film(tmp_path / "a.mp4", "mp4v", stack)
    even = read_frames(path)
    assert len(list(even)) == COUNT
    assert [even.time(k) for k in range(COUNT)] == pytest.approx(np.arange(COUNT) / 25)
    ticks = [256, 768] * (COUNT // 2) + [512] * (COUNT % 2)  # a second has 12 800
    varied_times(path, ticks)
    for options in ({}, {"region": (4, 4, 20, 20), "reduce": 2}):
        film = read_frames(path, **options)
        for k, _ in enumerate(film):
            assert next(iter(film)) is not None  # nothing changes by another reading
            assert film.time(k) == pytest.approx(sum(ticks[:k]) / 12800)


def test_reader_of_a_reader_equals_one_reader(stack, tmp_path):
    color = np.stack([stack, stack // 2, 255 - stack], axis=-1)
    about = {"axes": "ZYXS", "spacing": 2.5, "unit": "um"}
    path = tiff(tmp_path / "a.tif", color, imagej=True, resolution=(0.8, 0.8), metadata=about)
    for source in (color, path):
        first = read_frames(source, color=True, region=(3, 2, 50, 41), reduce=3)
        second = read_frames(first, color=True, region=(2, 1, 13, 11), reduce=2)
        direct = read_frames(source, color=True, region=(9, 5, 39, 33), reduce=6)
        assert (second.shape, second.color) == (direct.shape, True) == ((5, 6), True)
        assert second.pixel_size == direct.pixel_size
        np.testing.assert_array_equal(second.positions, direct.positions)
        # Levels are rounded after each reduction.
        np.testing.assert_allclose(read_stack(second).astype(int), read_stack(direct), atol=1)
        with pytest.raises(
            ValueError, match=r"in the image of 16×13 px, got x \+ width = 17 and y"
        ):
            read_frames(first, region=(7, 0, 10, 11))
        assert not read_frames(read_frames(source), color=True).color
        # A reader of a reader keeps its colors, unless it is asked for grey levels.
        np.testing.assert_array_equal(read_stack(read_frames(source, color=True)), color)
        assert read_stack(read_frames(source, color=True), color=False).shape == stack.shape


def test_frames_of_an_iterator_can_be_read_only_once(stack):
    for frames in ((f for f in stack), read_frames(f for f in stack)):
        once = read_frames(frames)
        np.testing.assert_array_equal(read_stack(once), stack)
        with pytest.raises(ValueError, match="frames are an iterator, which can be read only once"):
            list(once)


def test_reader_can_be_used_after_a_rejected_call(stack):
    reader = read_frames(stack)
    with pytest.raises(ValueError, match="positions or spacing must be given"):
        depth_from_focus(reader)
    found = depth_from_focus(reader, spacing=1.0)
    np.testing.assert_allclose(found.depth, depth_from_focus(stack, spacing=1.0).depth, atol=1e-6)
    frames = stack.astype(float)
    frames[2, 1, 3] = np.nan
    reader = read_frames(frames)
    for _ in range(2):
        seen = []
        with pytest.raises(ValueError, match=r"frames\[2\] must be finite"):
            seen.extend(reader)
        np.testing.assert_array_equal(seen, stack[:2])


def test_region_and_reduce_must_fit_the_frame(stack):
    """The frame is not square; a region may reach its edges but not cross them."""
    rows, columns = stack.shape[1:]
    last = read_frames(stack, region=(columns - 2, rows - 1, 2, 1))
    np.testing.assert_array_equal(next(iter(last)), stack[0, -1:, -2:])
    for wrong in ((1, 0, rows, columns), (0, 1, rows, columns)):
        with pytest.raises(ValueError, match="region must lie in"):
            read_frames(stack, region=wrong)
    assert read_frames(stack, reduce=48).shape == (1, 1)
    with pytest.raises(ValueError, match="reduce must be at most 48, the smaller side, got 49"):
        read_frames(stack, reduce=49)


def test_values_outside_a_region_are_not_checked(stack):
    frames = stack.astype(np.float32)
    frames[:, 0, 0] = np.nan
    with pytest.raises(ValueError, match=r"frames\[0\] must be finite"):
        read_frames(frames)
    region = read_frames(frames, region=(1, 0, 30, 20))
    np.testing.assert_array_equal(read_stack(region), stack[:, :20, 1:31])


def test_stack_describes_its_frames_and_later_frames_are_checked(stack):
    frames = [stack[0], stack[1], stack[2, :9]]
    found = read_frames(iter(frames), reduce=2)
    assert repr(found) == "Stack(unknown number of frames of 24×28 px, grey, uint8)"
    assert found.time(1) is None
    seen = []
    with pytest.raises(ValueError, match=r"frames\[2\] must be uint8 of shape .* got .* \(9, 56\)"):
        seen.extend(found)
    assert len(seen) == 2


def test_folder_with_one_file_is_read_as_that_file(stack, tmp_path):
    how = {"imagej": True, "resolution": (0.8, 0.8), "metadata": {"axes": "ZYX", "unit": "um"}}
    tiff(tmp_path / "scan.tif", stack, **how)
    (tmp_path / "notes.txt").write_text("25 µm")
    for source in (tmp_path, tmp_path / "*.tif"):
        reader = read_frames(source)
        assert (reader.axis, reader.pixel_size) == ("Z", pytest.approx(1.25))
        np.testing.assert_array_equal(read_stack(reader), stack)


def test_results_in_the_folder_of_frames_are_left_out(stack, tmp_path):
    folder = pictures(tmp_path / "scan", stack)
    found = depth_from_focus(folder, spacing=1.0)
    write_height_tiff(folder / "height.ome.tif", found.depth, pixel_size=1.0)
    write_height_tiff(folder / "sharp.tif", np.stack([stack[0]] * 3, -1), pixel_size=1.0)
    with pytest.warns(UserWarning, match=r"height\.ome\.tif, sharp\.tif: results, left out"):
        np.testing.assert_array_equal(read_stack(folder), stack)
    (folder / "height.ome.tif").unlink()
    # The pattern matches nothing but results, so they are what the user wants.
    assert read_frames(folder / "*.tif").count == 1
