"""Files are replaced atomically."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from microlib._common import replace_file


@pytest.mark.parametrize("fault", [None, OSError("No space left"), KeyboardInterrupt()])
def test_file_is_replaced_when_the_new_one_is_complete(tmp_path, fault):
    path = tmp_path / "a.csv"
    path.write_text("old")

    def write(file: Path) -> None:
        assert file.parent == tmp_path  # on the same disk, or the move would be a copy
        assert file.suffix == ".csv"  # by which writers choose the format
        assert file.name.startswith(".")  # which a reader's *.csv does not find
        file.write_text("new")
        assert path.read_text() == "old"
        if fault:
            raise fault

    if fault is None:
        replace_file(str(path), write)
    else:
        with pytest.raises(type(fault)) as caught:
            replace_file(path, write)
        assert caught.value is fault
    assert path.read_text() == ("old" if fault else "new")
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match=r"^path must lie in an existing folder, got .*missing"):
        replace_file(tmp_path / "missing" / "a.csv", os.fspath)
    for folder in (".", "..", tmp_path):
        with pytest.raises(ValueError, match=r"^path must name a file, got the folder"):
            replace_file(folder, os.fspath)


@pytest.mark.skipif(os.name == "nt", reason="of POSIX")
def test_replacing_a_file_keeps_mode_and_symlink(tmp_path):
    (tmp_path / "disk").mkdir()
    real, link = tmp_path / "disk" / "a.csv", tmp_path / "a.csv"
    link.symlink_to(real)
    before = os.umask(0o027)
    try:
        for mode in (0o600, 0o664, 0o444):
            real.write_text("old")
            real.chmod(mode)
            replace_file(link, lambda file: file.write_text("new"))
            assert stat.S_IMODE(real.stat().st_mode) == mode
            assert real.read_text() == "new"
            real.unlink()
        replace_file(tmp_path / "new.csv", lambda file: file.write_text("new"))
        assert stat.S_IMODE((tmp_path / "new.csv").stat().st_mode) == 0o640
    finally:
        os.umask(before)
    assert link.is_symlink()
