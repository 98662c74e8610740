"""Frames from memory and files: the same values, and faults named by frame and page."""

import tracemalloc
import weakref

import cv2
import numpy as np
import pytest
import tifffile

from microlib.focus import depth_from_focus
from microlib.io import read_frames


@pytest.fixture
def stack():
    return np.random.default_rng(0).integers(0, 256, (5, 24, 31)).astype(np.uint8)


def test_every_source_gives_the_same_frames(stack, tmp_path):
    multi, ome = tmp_path / "stack.tif", tmp_path / "stack.ome.tif"
    tifffile.imwrite(multi, stack, photometric="minisblack")
    tifffile.imwrite(ome, stack, metadata={"axes": "ZYX"}, compression="zlib")
    singles = []
    for k, frame in enumerate(stack):
        singles.append(tmp_path / f"{k}.{'png' if k % 2 else 'tif'}")
        if k % 2:
            cv2.imwrite(str(singles[-1]), frame)
        else:
            tifffile.imwrite(singles[-1], frame)
    sources = (stack, multi, str(multi), ome, singles, list(stack), (f for f in stack))
    for source in sources:
        np.testing.assert_array_equal(np.stack(list(read_frames(source))), stack)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_types_are_kept(dtype, tmp_path):
    stack = np.arange(3 * 16 * 16).reshape(3, 16, 16).astype(dtype)
    tifffile.imwrite(tmp_path / "a.tif", stack, photometric="minisblack")
    for frame in read_frames(tmp_path / "a.tif"):
        assert frame.dtype == dtype


def test_a_frame_of_one_row_is_a_frame(stack):
    row = stack[:, :1]
    np.testing.assert_array_equal(np.stack(list(read_frames(row))), row)


def test_what_is_not_finite_is_counted(stack):
    holed = stack.astype(float)
    holed[1, 2, 1:4] = np.nan, np.inf, -np.inf
    with pytest.raises(
        ValueError, match=r"frames\[1\] must be finite, got 3 NaN or infinite of 744"
    ):
        list(read_frames(holed))


def test_other_numbers_become_float32(stack):
    for dtype in (np.int16, np.float64, np.int64):
        assert next(read_frames(stack.astype(dtype))).dtype == np.float32


def test_a_camera_may_reuse_its_buffer(stack):
    def camera():
        buffer = np.empty_like(stack[0])
        for frame in stack:
            buffer[:] = frame
            yield buffer

    np.testing.assert_array_equal(np.stack(list(read_frames(camera()))), stack)


def test_frames_are_let_go_as_the_stack_is_read():
    class Frame(np.ndarray):
        """An array that a weak reference can follow."""

    alive: list[weakref.ref] = []
    most = 0

    def camera():
        nonlocal most
        rng = np.random.default_rng(0)
        for _ in range(60):
            frame = rng.integers(0, 256, (32, 32)).astype(np.uint8).view(Frame)
            alive.append(weakref.ref(frame))
            yield frame
            del frame
            most = max(most, sum(ref() is not None for ref in alive))

    depth_from_focus(camera(), np.arange(60.0), measure="sml")
    assert most <= 2


def test_memory_does_not_grow_with_the_number_of_frames():
    def peak(count: int) -> int:
        rng = np.random.default_rng(0)
        frames = (rng.integers(0, 256, (200, 200)).astype(np.uint8) for _ in range(count))
        tracemalloc.start()
        depth_from_focus(frames, np.arange(float(count)), measure="sml")
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    # The limit of the benchmark, where the whole process is weighed.
    assert peak(200) < 1.1 * peak(20)


def cut(path, size):
    path.write_bytes(path.read_bytes()[:size])


def test_a_cut_off_tiff_is_named_with_its_page(stack, tmp_path):
    path = tmp_path / "cut.tif"
    for frame in stack:
        tifffile.imwrite(path, frame, append=True, metadata=None)
    with tifffile.TiffFile(path) as tiff:
        ends = [page.dataoffsets[0] + page.databytecounts[0] for page in tiff.pages]
    cut(path, ends[-1] - 10)
    with pytest.raises(ValueError, match=r"page 4 of .*cut\.tif cannot be read"):
        list(read_frames(path))
    before = sorted(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"page 4 of .*cut\.tif"):
        depth_from_focus(path, np.arange(5.0))
    assert sorted(tmp_path.iterdir()) == before


def test_a_damaged_page_is_named(stack, tmp_path):
    path = tmp_path / "damaged.tif"
    tifffile.imwrite(path, stack, compression="zlib", metadata=None, photometric="minisblack")
    with tifffile.TiffFile(path) as tiff:
        start = tiff.pages[2].aspage().dataoffsets[0]
    content = bytearray(path.read_bytes())
    content[start : start + 40] = bytes(40)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"page 2 of .*damaged\.tif cannot be read"):
        list(read_frames(path))


@pytest.mark.parametrize("content", [b"", b"not a TIFF at all", b"II*\0"])
def test_what_is_no_tiff_is_refused(content, tmp_path):
    path = tmp_path / "wrong.tif"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"wrong\.tif"):
        list(read_frames(path))


def test_faults_are_named(stack, tmp_path):
    missing = tmp_path / "missing"
    color = tmp_path / "color.png"
    cv2.imwrite(str(color), np.zeros((8, 8, 3), np.uint8))
    (tmp_path / "text.png").write_text("no image")
    tifffile.imwrite(tmp_path / "many.tif", stack, photometric="minisblack")
    holed = stack.astype(float)
    holed[3, 2, 1] = np.nan
    cases = [
        (holed, r"frames\[3\] must be finite, got 1 NaN"),
        ([stack[0], stack[1][:-1]], r"frames\[1\] must be uint8 of shape \(24, 31\)"),
        ([stack[0], stack[1].astype(float)], r"frames\[1\] must be uint8"),
        (stack[0], r"frames must have shape \(any, any, any\)"),
        ([stack], r"frames\[0\] must be a grey image"),
        ([stack[0] > 3], r"frames\[0\] must hold real numbers, got bool"),
        (7, "frames must be an array, a TIFF or an iterable of images, got int"),
        (missing.with_suffix(".tif"), r"frames cannot be read from .*missing\.tif"),
        ([missing.with_suffix(".png")], r"missing\.png: no such file"),
        ([tmp_path / "text.png"], r"text\.png: not an image"),
        ([color], r"frames\[0\], .*color\.png, must be a grey image"),
        ([tmp_path / "many.tif"], r"many\.tif must hold one page to be one frame, got 5"),
    ]
    for source, words in cases:
        with pytest.raises(ValueError, match=words):
            list(read_frames(source))


def test_a_tiff_without_a_page_is_refused(tmp_path):
    (tmp_path / "empty.tif").write_bytes(b"II*\0 cut off")
    with pytest.raises(ValueError, match=r"cannot be read from .*empty\.tif: it holds no page"):
        list(read_frames(tmp_path / "empty.tif"))


@pytest.mark.parametrize("shape", [(4, 5), (2, 3, 4, 5), (7,)])
def test_an_array_of_frames_has_three_axes(shape):
    with pytest.raises(ValueError, match="frames must have shape"):
        list(read_frames(np.zeros(shape, np.uint8)))


@pytest.mark.parametrize("missing", [1, 200])
def test_a_page_that_ends_beyond_its_file_is_called_cut_off(tmp_path, missing):
    path = tmp_path / "stack.tif"
    with tifffile.TiffWriter(path) as writer:  # each page's data after its own header
        for _ in range(3):
            writer.write(np.ones((20, 30), np.uint8), photometric="minisblack", contiguous=False)
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(ValueError, match="the file is cut off"):
        list(read_frames(path))
