"""A file is whole or as it was before."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from microlib._common import replace_file


@pytest.mark.parametrize("fault", [None, OSError("No space left"), KeyboardInterrupt()])
def test_a_file_is_replaced_once_the_new_one_is_whole(tmp_path: Path, fault) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")

    def write(file: Path) -> None:
        assert file.parent == tmp_path  # on the same disk, or the move would be a copy
        assert file.suffix == ".csv"  # which tells writers the format
        assert file.name.startswith(".")  # which a reader's *.csv does not find
        file.write_text("new")
        assert path.read_text() == "old"
        if fault:
            raise fault

    if fault is None:
        replace_file(str(path), write)
        assert path.stat().st_mode & 0o777 == 0o644
    else:
        with pytest.raises(type(fault)) as caught:
            replace_file(path, write)
        assert caught.value is fault
    assert path.read_text() == ("old" if fault else "new")
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match=r"^path must lie in an existing folder, got .*missing"):
        replace_file(tmp_path / "missing" / "a.csv", os.fspath)
