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
    "uneven signs": ["z-40", "z-10", "z5", "z70"],
    "powers of ten": ["z1e-02", "z1e-01", "z1e+00", "z1e+01"],
    "up to zero": [f"z_{k}" for k in range(-40, 10, 10)],
    "signed decimals": [f"p{k:+.1f}um" for k in np.arange(-1.0, 1.25, 0.25).round(2)[::2]],
    "decimals": [f"z_{k:g}" for k in np.arange(9) * 0.05],
    "decimal commas": [f"z_{k:g}".replace(".", ",") for k in np.arange(9) * 0.05],
    "quarters": [f"z{k:g}" for k in np.arange(9) * 0.25],
    "numbers after a hyphen": [f"scan-{k}" for k in range(1, 13)],
    "sections": [f"s1.{k}" for k in range(1, 13)],
    "dates": [f"2024-{m:02}-{d:02}" for m in (1, 2) for d in (5, 9, 27)][:5],
    "a counter from 9999 to 0001": [f"DSC_{(9993 + k) % 9999 + 1:04d}" for k in range(9)],
    "a counter from 999 to 000": [f"i{k % 1000:03d}" for k in range(995, 1004)],
    "the time beside the number": [f"f{k}_{12 + 7 * k}" for k in range(12)],
    "upper and lower case": ["IMG8", "img9", "IMG10", "Img11"],
    "copies of Windows": [f"scan ({k})" for k in range(1, 13)],
    "speeds and numbers": [f"V1.75f3.125{k:04}" for k in range(1, 10)],
    "long numbers": [f"{20240101120000000000 + k}" for k in range(9)],
}


@pytest.mark.parametrize("kind", ORDERS)
def test_frames_are_ordered_by_the_numbers_in_their_names(tmp_path, kind):
    names = ORDERS[kind]
    assert read(write(tmp_path, names)) == list(range(len(names)))
    assert read(f"{tmp_path}/*.png") == list(range(len(names)))
    assert [file.stem for file in read_frames(tmp_path).files] == names
    assert read(tmp_path / f"{names[3]}.png") == [3]


def test_frames_are_ordered_for_any_first_number_step_and_form(tmp_path):
    """Forty random stacks, whose names have signs, decimals, leading zeros or none."""
    rng = np.random.default_rng(3)
    forms = ("scan_{:05.0f}", "IMG{:.0f}", "2 µm, z{:.1f} µm", "a7_{:+.0f}")
    for case in range(40):
        count, step = rng.integers(3, 14), rng.choice([1, 2, 5, 10, 25])
        # A hyphen before all numbers would not be a sign, so the last number is not negative.
        first = -step * rng.integers(0, count) if case % 4 == 3 else rng.integers(0, 200)
        numbers = (first + step * np.arange(count)) / (10 if case % 4 == 2 else 1)
        folder = tmp_path / str(case)
        folder.mkdir()
        names = [forms[case % 4].format(number) for number in numbers]
        assert read(write(folder, names)) == list(range(count)), names


@pytest.mark.parametrize(
    ("names", "words"),
    [
        # Two orders are possible: versions or decimals, two axes, a counter that may start again.
        (["v1.2", "v1.10", "v1.13", "v1.4"], r"v1\.2\.png, v1\.4.* or v1\.10\.png, v1\.13"),
        (
            [f"c{c}_z{z}" for c in range(2) for z in range(4)],
            r"c0_z0\.png, c0_z1.* or c0_z0\.png, c1_z0",
        ),
        ([f"{k:04}" for k in (1, 2, 7, 9990, 9994)], r"0001\.png, .* or 9990\.png, 9994"),
        # The hyphen may be a minus sign; either of two numbers may give the order.
        (["z_-3", "z_-4", "z_-5"], r"z_-3\.png, z_-4.* or z_-5\.png, z_-4"),
        (["31_3", "44_1", "58_2", "97_0"], r"31_3\.png, 44_1\.png.* or 97_0\.png, 44_1"),
        # Names that differ in more than numbers, or a number that occurs twice.
        (["a1", "a2", "a3", "b1", "b2", "b3"], r"only in numbers, got a1\.png and b1"),
        (["pcb_1", "pcb_2", "pcb_3", "expected"], r"got pcb_1\.png and expected"),
        (["i1", "i2", "i3", "i1 (1)", "i2 (1)"], r"got i1 \(1\)\.png and i1\.png"),
        (["zm20", "zm10", "z0", "zp10", "zp20"], r"got zm10\.png and z0"),
        (["z500um", "z1mm", "z2mm"], r"got z1mm\.png and z500um"),
        (["i1", "i01", "i2"], r"got i01\.png and i1\.png"),
    ],
)
def test_ambiguous_names_are_rejected_and_a_list_of_them_is_read(tmp_path, names, words):
    write(tmp_path, names)
    with pytest.raises(ValueError, match=f"frames must have (one order|names that).* {words}"):
        read_frames(tmp_path)
    assert read([tmp_path / f"{name}.png" for name in names]) == [*range(len(names))]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["far", "middle", "near"], "without a common number: frames in alphabetical order"),
        ([f"f{k}" for k in (1, 2, 3, 5, 6, 7)], "no frame between f3.png and f5"),
        (
            [f"f{k}" for k in (0, 10, 20, 30, 90, 100)],
            "f30.png and f90.png: if one is missing, all positions",
        ),
    ],
)
def test_missing_numbers_give_a_warning(tmp_path, names, words):
    write(tmp_path, names)
    with pytest.warns(UserWarning, match=words):
        assert read(tmp_path) == [*range(len(names))]


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
