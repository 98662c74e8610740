"""Every kind of input gives the same frames; a wrong one is rejected."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from microlib import synthetic
from microlib.focus import depth_from_focus
from microlib.io import read_frames, write_height_tiff
from tests.scenes import tilted_plane

COUNT = 12


def read_stack(source: object, **options: bool | int) -> NDArray:
    return np.stack(list(read_frames(source, **options)))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def stack() -> NDArray[np.uint8]:
    texture = synthetic.mixed_texture((48, 56), np.random.default_rng(0))
    height = 5.3 + tilted_plane((48, 56), 0.05, 0.02)
    return synthetic.focal_stack(texture, height, np.arange(float(COUNT)), blur_rate=1.0)


class Lazy:
    """What zarr and dask arrays have in common; counts what is loaded."""

    def __init__(self, values: NDArray) -> None:
        self._values = values
        self.shape = values.shape
        self.loaded: list[int] = []

    def __getitem__(self, key: int) -> NDArray:
        self.loaded.append(key)
        return self._values[key]


def one_buffer(frames: NDArray) -> Iterator[NDArray]:
    """Yield frames as a camera may, each over the one before."""
    buffer = np.empty_like(frames[0])
    for frame in frames:
        buffer[:] = frame
        yield buffer


def write_folder(folder: Path, frames: NDArray) -> Path:
    folder.mkdir()
    for k, frame in enumerate(frames):  # 2 comes before 10
        cv2.imwrite(str(folder / f"frame {k}.png"), frame)
    (folder / "notes.txt").write_text("not a frame")
    (folder / ".hidden.png").write_text("not a frame either")
    return folder


def test_every_kind_of_input_gives_the_same_frames(
    stack: NDArray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_folder(tmp_path / "scan", stack)
    color = np.stack([stack, stack // 2, 255 - stack], axis=-1)
    tifffile.imwrite(tmp_path / "a.tif", stack, photometric="minisblack")
    tifffile.imwrite(tmp_path / "a.ome.tif", stack, metadata={"axes": "ZYX"})
    tifffile.imwrite(tmp_path / "ij.tif", stack, imagej=True, metadata={"axes": "ZYX"})
    tifffile.imwrite(tmp_path / "rgb.tif", color, photometric="rgb")
    monkeypatch.setenv("HOME", str(tmp_path))
    files = [folder / f"frame {k}.png" for k in range(COUNT)]
    patterns = (folder, str(folder / "frame*.png"), "~/scan")
    tiffs = [tmp_path / f"{name}.tif" for name in ("a", "a.ome", "ij")]
    for source in (stack, *patterns, files, iter(files), *tiffs, Lazy(stack), one_buffer(stack)):
        np.testing.assert_array_equal(read_stack(source, color=True), stack)
    opaque = np.concatenate([color, color[..., :1]], axis=3)
    for source in (color, tmp_path / "rgb.tif", Lazy(color), opaque):
        np.testing.assert_array_equal(read_stack(source, color=True), color)
    large = stack.astype(np.uint16) * 16
    for source in (large, large.astype(">u2")):
        np.testing.assert_array_equal(found := read_stack(source), large)
        assert found.dtype == np.uint16


def write_film(path: Path, code: str, frames: NDArray, times: int = 1) -> Path:
    """Write a film, so many times into one file, whose header describes the first."""
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25, (56, 48))
    if not film.isOpened():
        pytest.skip(f"OpenCV writes no {code} here")
    for frame in frames:
        film.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    film.release()
    path.write_bytes(times * path.read_bytes())
    return path


def whole_film(path: Path) -> tuple[int | None, NDArray]:
    reader = read_frames(path)
    return reader.count, np.stack(list(reader)).astype(float)


def test_video_is_read_as_a_stack(stack: NDArray, tmp_path: Path) -> None:
    reader = read_frames(write_film(tmp_path / "film.avi", "MJPG", stack))
    assert (reader.count, reader.shape, reader.color) == (COUNT, (48, 56), True)
    found = np.stack(list(reader)).astype(float)
    assert np.abs(found - stack).mean() < 4  # JPEG
    (tmp_path / "no.mp4").write_bytes(b"no video")
    with pytest.raises(ValueError, match=r"no\.mp4: not a video"):
        read_frames(tmp_path / "no.mp4")


@pytest.mark.skipif(not importlib.util.find_spec("zarr"), reason="zarr is not installed")
def test_zarr_arrays_and_files_are_read(stack: NDArray, tmp_path: Path) -> None:
    import zarr

    array = zarr.open(str(tmp_path / "a.zarr"), mode="w", shape=stack.shape, dtype="u1")
    array[:] = stack
    for source in (array, tmp_path / "a.zarr"):
        np.testing.assert_array_equal(read_stack(source), stack)


def test_lazy_frames_are_loaded_one_by_one(stack: NDArray) -> None:
    lazy = Lazy(stack)
    frames = iter(read_frames(lazy))
    assert lazy.loaded == [0]  # for shape and type
    next(frames)
    next(frames)
    assert lazy.loaded == [0, 1]


def test_colors_are_returned_as_rgb(tmp_path: Path) -> None:
    color = np.zeros((3, 8, 9, 3), np.uint8)
    color[..., 0], color[..., 1] = 200, 50
    bgr = np.ascontiguousarray(color[..., ::-1])
    write_folder(tmp_path / "scan", bgr)
    for source in (color, tmp_path / "scan"):
        np.testing.assert_array_equal(read_stack(source, color=True), color)
        grey = read_stack(source)
        assert grey.shape == (3, 8, 9)
        assert (grey == round(0.299 * 200 + 0.587 * 50)).all()


# --- Rejected inputs ---------------------------------------------------------------------------


def test_wrong_files_are_rejected(stack: NDArray, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scan", stack)
    (tmp_path / "empty").mkdir()
    cases: list[tuple[object, str]] = [
        ([folder / "gone.png"], r"gone\.png: no such file"),
        (tmp_path / "empty", "frames must hold images, got none in"),
        (str(folder / "*.jpg"), r"frames must hold images, got none in .*\*\.jpg"),
        (tmp_path / "missing.tif", r"frames cannot be read from .*missing\.tif: no such file"),
        (tmp_path / "missing.avi", r"missing\.avi: no such file"),
        (np.zeros((3, 4, 5, 6)), r"frames must have shape .* in color, got \(3, 4, 5, 6\)"),
    ]
    for source, words in cases:
        with pytest.raises(ValueError, match=words):
            read_frames(source)  # type: ignore[arg-type]
    cv2.imwrite(str(folder / "frame 11.png"), stack[0, :20])
    with pytest.raises(ValueError, match=r"frames\[11\], .*11\.png, .* \(48, 56\) .* \(20, 56\)"):
        list(read_frames(folder))


def test_digits_come_before_letters_and_small_numbers_before_large(tmp_path: Path) -> None:
    names = ["2a1", "10a1", "10a2", "10b", "a", "a1", "a1b", "a02", "a10", "b1"]
    for k, name in enumerate(names):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((4, 5), k, np.uint8))
    assert [int(frame[0, 0]) for frame in read_frames(tmp_path)] == list(range(len(names)))
    assert [int(frame[0, 0]) for frame in read_frames(tmp_path / "a1b.png")] == [6]


def test_error_names_a_picture_that_was_removed(stack: NDArray, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scan", stack)
    for source in (folder, (folder / f"frame {k}.png" for k in range(COUNT))):
        frames = iter(read_frames(source))
        assert len([next(frames) for _ in range(3)]) == 3
        kept = (folder / "frame 3.png").read_bytes()
        (folder / "frame 3.png").unlink()
        with pytest.raises(ValueError, match=r"read from .*frame 3\.png: no such file"):
            next(frames)
        (folder / "frame 3.png").write_bytes(kept)


def test_video_with_fewer_frames_than_its_header_is_rejected(
    stack: NDArray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = np.full((4, 6, 3), (1, 2, 3), np.uint8)  # blue, green and red

    def film(path: str) -> SimpleNamespace:
        left = [(True, image)] * 3
        return SimpleNamespace(
            isOpened=lambda: True,
            release=lambda: None,
            get=lambda which: 4.0,  # frames by the header; three can be read
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


@pytest.mark.parametrize(
    ("name", "code", "times"), [("a.mpeg", "PIM1", 1), ("a.mkv", "MJPG", 2), ("a.avi", "MJPG", 2)]
)
def test_video_with_more_frames_than_its_header_gives_a_warning(
    stack: NDArray, tmp_path: Path, name: str, code: str, times: int
) -> None:
    """Where a film has no list of them, their number is not known before they were read."""
    path, count = write_film(tmp_path / name, code, stack, times), times * COUNT
    with pytest.warns(
        UserWarning, match=rf"{name}: its header has \d+ frames, {count} can be read"
    ):
        stated, found = whole_film(path)
    assert stated == (COUNT if name == "a.avi" else None)
    assert np.abs(found - np.concatenate([stack] * times)).mean() < 10  # compressed


def test_reader_of_a_reader_equals_one_reader(stack: NDArray, tmp_path: Path) -> None:
    color = np.stack([stack, stack // 2, 255 - stack], axis=-1)
    tifffile.imwrite(
        tmp_path / "a.tif", color, imagej=True, resolution=(0.8, 0.8),
        metadata={"axes": "ZYXS", "spacing": 2.5, "unit": "um"},
    )  # fmt: skip
    for source in (color, tmp_path / "a.tif"):
        first = read_frames(source, color=True, region=(3, 2, 50, 41), reduce=3)
        second = read_frames(first, color=True, region=(2, 1, 13, 11), reduce=2)
        direct = read_frames(source, color=True, region=(9, 5, 39, 33), reduce=6)
        assert (second.shape, second.color) == (direct.shape, True) == ((5, 6), True)
        assert second.pixel_size == direct.pixel_size
        assert second.origin == pytest.approx(direct.origin)
        np.testing.assert_array_equal(second.positions, direct.positions)
        with pytest.raises(ValueError, match="region must lie in the image of 16×13 px"):
            read_frames(first, region=(7, 0, 10, 11))
        # Levels are rounded after each reduction.
        assert (
            np.abs(
                read_stack(second, color=True).astype(int) - read_stack(direct, color=True)
            ).max()
            <= 1
        )
        grey = read_frames(read_frames(source), color=True)
        assert not grey.color


def test_files_and_arrays_are_read_again_and_iterators_once(stack: NDArray) -> None:
    reader = read_frames(stack)
    for _ in range(2):
        np.testing.assert_array_equal(np.stack(list(reader)), stack)
    for frames in ((f for f in stack), read_frames(f for f in stack)):
        once = read_frames(frames)
        np.testing.assert_array_equal(np.stack(list(once)), stack)
        with pytest.raises(ValueError, match="frames are an iterator, which can be read only once"):
            list(once)


def test_reader_can_be_used_after_a_rejected_call(stack: NDArray) -> None:
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


def test_region_and_reduce_must_fit_the_frame(stack: NDArray) -> None:
    """Of a frame that is no square, up to its edges and not beyond."""
    rows, columns = stack.shape[1:]
    last = read_frames(stack, region=(columns - 2, rows - 1, 2, 1))
    np.testing.assert_array_equal(next(iter(last)), stack[0, -1:, -2:])
    for wrong in ((1, 0, rows, columns), (0, 1, rows, columns)):
        with pytest.raises(ValueError, match="region must lie in"):
            read_frames(stack, region=wrong)
    assert read_frames(stack, reduce=48).shape == (1, 1)
    with pytest.raises(ValueError, match="reduce must be at most 48, the smaller side, got 49"):
        read_frames(stack, reduce=49)


def test_frames_without_pixels_are_rejected() -> None:
    for shape in ((2, 0, 5), (2, 5, 0)):
        with pytest.raises(ValueError, match=r"frames\[0\] must have pixels, got shape"):
            read_frames(np.zeros(shape, np.uint8))
    reader = read_frames([])
    assert (reader.count, reader.shape, list(reader)) == (0, (0, 0), [])


def write_ome_zarr(path: Path, frames: NDArray, version: str, axes: str = "tczyx") -> None:
    """Write an image in two sizes with the layout of the standard, without a package for it."""
    import zarr

    group = zarr.open_group(str(path), mode="w", zarr_format=2 if version == "0.4" else 3)
    units = {"x": "nanometer", "y": "micrometer", "z": "micrometer"}
    kinds = {"t": "time", "c": "channel"}
    about = [
        {"name": a, "type": kinds.get(a, "space")} | ({"unit": units[a]} if a in units else {})
        for a in axes
    ]
    steps = {"x": 650.0, "y": 0.65, "z": 2.5}
    sizes = []
    for k, level in enumerate((frames, frames[..., ::2, ::2])):
        array = group.create_array(str(k), shape=level.shape, dtype=level.dtype)
        array[:] = level
        half = {"x": 2**k, "y": 2**k}
        scale = [0.5 * steps.get(a, 1.0) * half.get(a, 1) for a in axes]
        change = [{"type": "scale", "scale": scale}]
        sizes.append({"path": str(k), "coordinateTransformations": change})
    both = [{"type": "scale", "scale": [2.0] * len(axes)}]
    image = {"axes": about, "datasets": sizes, "coordinateTransformations": both}
    if version == "0.4":
        group.attrs["multiscales"] = [image | {"version": version}]
    else:
        group.attrs["ome"] = {"version": version, "multiscales": [image]}


@pytest.mark.skipif(not importlib.util.find_spec("zarr"), reason="zarr is not installed")
@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_ome_zarr_is_read_with_its_scale(stack: NDArray, tmp_path: Path, version: str) -> None:
    many = np.stack([np.stack([stack, 255 - stack])] * 2)
    many[1] //= 2
    write_ome_zarr(tmp_path / "a", many, version)
    with pytest.raises(ValueError, match=r"has the axes T=2, C=2, Z=12 .* choose a channel"):
        read_frames(tmp_path / "a")
    reader = read_frames(tmp_path / "a", channel=1, time=1)
    assert (reader.axis, reader.count, reader.pixel_size) == ("Z", COUNT, pytest.approx(0.65))
    assert reader.positions == pytest.approx(2.5 * np.arange(COUNT))
    np.testing.assert_array_equal(np.stack(list(reader)), (255 - stack) // 2)
    # A group for each image, as bioformats2raw writes it, and fewer axes.
    for k, frames in enumerate((stack, stack[:4])):
        write_ome_zarr(tmp_path / "b.zarr" / str(k), frames, version, "zyx")
    (tmp_path / "b.zarr" / ("zarr.json" if version == "0.5" else ".zgroup")).write_text(
        '{"zarr_format": 3, "node_type": "group"}' if version == "0.5" else '{"zarr_format": 2}'
    )
    with pytest.raises(ValueError, match="holds 2 series of images: choose one"):
        read_frames(tmp_path / "b.zarr")
    assert read_frames(tmp_path / "b.zarr", series=1).count == 4


def test_gif_and_npy_are_read_as_stacks(stack: NDArray, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", stack)
    first, *others = (Image.fromarray(frame) for frame in stack)
    first.save(tmp_path / "a.gif", save_all=True, append_images=others)
    for name in ("a.npy", "a.gif"):
        reader = read_frames(tmp_path / name)
        assert (reader.count, reader.files) == (
            COUNT if name == "a.npy" else None,
            (tmp_path / name,),
        )
        assert np.abs(np.stack(list(reader)).astype(int) - stack).max() <= 1
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:500])
        with pytest.raises(ValueError, match=f"cannot be read from .*{name}"):
            list(read_frames(tmp_path / name))


def test_names_can_contain_brackets_and_begin_with_a_tilde(
    stack: NDArray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_folder(tmp_path / "scan [3]", stack)
    for source in (folder, f"{folder}/*.png", folder / "frame [0-9]*.png"):
        np.testing.assert_array_equal(read_stack(source), stack)
    tifffile.imwrite(tmp_path / "~scan.tif", stack, photometric="minisblack")
    monkeypatch.chdir(tmp_path)
    for name in ("~scan.tif", "./~scan.tif"):
        assert read_frames(name).count == COUNT
    cv2.imwrite("~a.png", stack[0])
    assert read_frames(["~a.png"]).shape == (48, 56)


def test_single_color_image_is_rejected_as_a_stack(stack: NDArray) -> None:
    for frames in (np.zeros((48, 56, 3), np.uint8), np.moveaxis(stack, 0, -1)[..., :9]):
        with pytest.raises(ValueError, match="must come along the first axis, got shape"):
            read_frames(frames)
    assert read_frames(list(np.zeros((99, 99, 5), np.uint8))).shape == (99, 5)


def test_results_in_the_folder_of_frames_are_left_out(stack: NDArray, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scan", stack)
    found = depth_from_focus(folder, spacing=1.0)
    write_height_tiff(folder / "height.ome.tif", found.depth, pixel_size=1.0)
    write_height_tiff(folder / "sharp.tif", np.stack([stack[0]] * 3, -1), pixel_size=1.0)
    with pytest.warns(UserWarning, match=r"height\.ome\.tif, sharp\.tif: results, left out"):
        np.testing.assert_array_equal(read_stack(folder), stack)
    (folder / "height.ome.tif").unlink()
    assert read_frames(folder / "*.tif").count == 1  # those alone are what is asked for
