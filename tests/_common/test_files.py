"""A file is whole or as it was before."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from microlib._common import replace_file


def test_a_new_file_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")
    seen = []

    def write(file: Path) -> None:
        seen.append(file)
        file.write_text("new")
        assert path.read_text() == "old"

    replace_file(str(path), write)
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o644
    (file,) = seen
    assert file.parent == tmp_path  # on the same disk, or the move would be a copy
    assert file.suffix == ".csv"  # which tells writers the format
    assert file.name.startswith(".a.")  # which a reader's *.csv does not find


@pytest.mark.parametrize("fault", [OSError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, fault: BaseException) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")

    def write(file: Path) -> None:
        file.write_text("ne")
        raise fault

    with pytest.raises(type(fault)) as caught:
        replace_file(path, write)
    assert caught.value is fault
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^path must lie in an existing folder, got .*missing"):
        replace_file(tmp_path / "missing" / "a.csv", os.fspath)
