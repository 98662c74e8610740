"""Frames are ordered by the numbers in their names; an ambiguous order is rejected."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from microlib.io import read_frames

SHAPE = (12, 15)


def write(folder: Path, names: list[str]) -> Path:
    """Write frames in random order; the grey level of each is its number in the list."""
    for k in np.random.default_rng(0).permutation(len(names)):
        cv2.imwrite(str(folder / f"{names[k]}.png"), np.full(SHAPE, k, np.uint8))
    return folder


def read(source: Path | str) -> list[int]:
    return [int(frame[0, 0]) for frame in read_frames(source)]


ORDERS = {
    "signs": [f"z{k:+d}" for k in range(-40, 50, 10)],
    "minus or no sign": [f"z{k}" for k in range(-4, 5)],
    "powers of ten": ["z1e-02", "z1e-01", "z1e+00", "z1e+01"],
    "up to zero": [f"z_{k}" for k in range(-40, 10, 10)],
    "signed decimals": [f"p{k:+.1f}um" for k in np.arange(-1.0, 1.25, 0.25).round(2)[::2]],
    "numbers after a hyphen": [f"scan-{k}" for k in range(1, 13)],
    "decimals of one width": [f"z_{k:.2f}" for k in np.arange(9) * 0.05],
    "decimal commas": [f"z_{k:.1f}".replace(".", ",") for k in np.arange(1, 10) * 0.5],
    "a point before the number": [f"scan.{k}" for k in range(1, 13)],
    "dates of one month": [f"2024-03-{d:02}" for d in range(9, 13)],
    "the time beside the number": [f"f{k}_{12 + 7 * k}" for k in range(12)],
    "upper and lower case": ["IMG8", "img9", "IMG10", "Img11"],
    "copies of Windows": [f"scan ({k})" for k in range(1, 13)],
    "speeds and numbers": [f"V1.75f3.125{k:04}" for k in range(1, 10)],
    "leading zeros": [f"scan_{k:05}" for k in range(85, 130, 5)],
    "decimals with a unit": [f"2 µm, z{k:05.1f} µm" for k in np.arange(0, 20, 2.5)],
    "long numbers": [f"{20240101120000000000 + k}" for k in range(9)],
}


@pytest.mark.parametrize("kind", ORDERS)
def test_frames_are_ordered_by_the_numbers_in_their_names(tmp_path, kind):
    names = ORDERS[kind]
    assert read(write(tmp_path, names)) == list(range(len(names)))
    assert read(f"{tmp_path}/*.png") == list(range(len(names)))
    assert [file.stem for file in read_frames(tmp_path).files] == names
    assert read(tmp_path / f"{names[3]}.png") == [3]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        # Versions or decimals; a hyphen that may be a minus sign.
        (["v1.2", "v1.4", "v1.10", "v1.13"], r"one order.* v1\.2\.png, v1\.4.* or v1\.10\.png, v1"),
        (["z0.05", "z0.1", "z0.15"], r"one order.* z0\.1\.png, z0\.05.* or z0\.05\.png, z0\.1"),
        (["z0,05", "z0,1", "z0,15"], r"one order.* z0,1\.png, z0,05.* or z0,05\.png, z0,1"),
        (["z_-3", "z_-4", "z_-5"], r"one order.* z_-3\.png, z_-4.* or z_-5\.png, z_-4"),
        # Two axes.
        (
            [f"c{c}_z{z}" for c in range(2) for z in range(9, 12)],
            r"one axis, the names from c0_z9\.png to c1_z11\.png have 2",
        ),
    ],
)
def test_ambiguous_names_are_rejected_and_a_list_of_them_is_read(tmp_path, names, words):
    write(tmp_path, names)
    with pytest.raises(ValueError, match=f"frames must .*{words}"):
        read_frames(tmp_path)
    assert read([tmp_path / f"{name}.png" for name in names]) == [*range(len(names))]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        # Names that differ in more than numbers.
        (
            ["far", "middle", "near"],
            r"more than numbers, frames are read from far\.png to near\.png$",
        ),
        (["a1", "a2", "a10", "b1", "b2"], r"are read from a1\.png to b2\.png$"),
        (["expected", "pcb_1", "pcb_2", "pcb_3"], r"\(expected\.png is frame 0\), .* to pcb_3"),
        (
            ["im_1", "im_2", "im_2.5x", "im_3", "im_4", "mask"],
            r"\(im_2\.5x\.png is frame 2, mask\.png is frame 5\), .* from im_1",
        ),
        (["z1mm", "z2mm", "z500um"], r"are read from z1mm\.png to z500um"),
        # Two numbers that count, of an axis with another one or of a date.
        (["a1_1", "a1_2", "a2_1"], r"count by 2 numbers, .* are read from a1_1\.png to a2_1\.png$"),
        (["2024-1-5", "2024-1-27", "2024-2-5"], r"count by 2 numbers, .* from 2024-1-5\.png"),
        # Numbers that are missing.
        (["a1", "a2", "a4"], r"no frame between a2\.png and a4\.png: if one is missing"),
        (["a1", "a3", "a4"], r"no frame between a1\.png and a3"),
        ([f"f{k}" for k in (1, 2, 3, 5, 6, 7)], r"no frame between f3\.png and f5"),
        ([f"f{k}" for k in (0, 10, 20, 30, 90, 100)], r"no frame between f30\.png and f90"),
        (["z-40", "z-10", "z5", "z20"], r"no frame between z-40\.png and z-10"),
        (["i01", "i1", "i2"], r"no frame between i1\.png and i2"),  # the number 1 is there twice
        (["DSC_0001", "DSC_0002", "DSC_9998", "DSC_9999"], r"no frame between DSC_0002\.png and"),
    ],
)
def test_names_of_another_series_or_with_gaps_give_one_warning(tmp_path, names, words):
    write(tmp_path, names)
    with pytest.warns(UserWarning, match=words) as caught:
        assert read(tmp_path) == [*range(len(names))]
    assert len(caught) == 1


def test_frame_in_two_formats_is_rejected(tmp_path):
    write(tmp_path, ["i1", "i2", "i3"])
    Image.new("L", SHAPE[::-1]).save(tmp_path / "i2.jpg")
    with pytest.raises(ValueError, match=r"one file each, got i2\.jpg and i2\.png"):
        read_frames(tmp_path)
    assert read(tmp_path / "*.png") == [0, 1, 2]


@pytest.mark.parametrize("turn", [3, 6])
def test_changing_exif_orientation_is_ignored(tmp_path, turn):
    """A camera that looks down may change the tag between frames, though it is not turned."""
    ramp = np.tile(np.arange(100, 200, 2, dtype=np.uint8), (40, 1))
    for k in range(4):
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = turn if k > 1 else 1
        Image.fromarray(ramp).save(tmp_path / f"{k}.jpg", quality=95, exif=exif)
    with pytest.warns(UserWarning, match="orientations are not turned"):
        frames = np.stack(list(read_frames(tmp_path)))
    assert np.abs(frames.astype(int) - ramp).max() <= 4  # JPEG
    files = [tmp_path / "2.jpg", tmp_path / "3.jpg"]
    turned = np.rot90(ramp, 2 if turn == 3 else -1)
    assert np.abs(next(iter(read_frames(files))).astype(int) - turned).max() <= 4
