"""Atomic writing of files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from secrets import token_hex

from microlib._common._checks import ArgumentError

#: Value of the Software tag of written images, by which a folder's frames and results differ.
SOFTWARE = "microlib"


def home_path(path: str | PathLike[str]) -> Path:
    """Return a path with ``~`` as the home folder; other names may begin with a tilde."""
    if path == "":  # of an unset variable; it would be the current folder
        raise ArgumentError("path", "must name a file or a folder, got an empty text")
    given = Path(path)
    return given.expanduser() if given.parts[:1] == ("~",) else given


def replace_file(path: str | PathLike[str], write: Callable[[Path], object]) -> None:
    """Write a file atomically: beside `path`, then moved there.

    Parameters
    ----------
    path : path-like
        File to write. An existing file is replaced when the new one is complete; its permissions
        and a symbolic link to it are kept.
    write : callable
        Writes the content to its argument, a path with the ending of `path`.

    Raises
    ------
    ValueError
        If the folder does not exist, or the path is one.
    OSError
        If the file cannot be written, for example on a full disk; an existing file stays.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from microlib._common._files import replace_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     replace_file(Path(folder) / "a.txt", lambda file: file.write_text("whole"))
    ...     print([path.name for path in Path(folder).iterdir()])
    ['a.txt']
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise ValueError(f"path must lie in an existing folder, got {target.parent}")
    if target.is_dir():
        raise ValueError(f"path must name a file, got the folder {target}")
    if old := target.is_file():
        target = target.resolve()  # the file that a link names
    # Hidden, so that the file of a killed process is not mistaken for a result.
    new = target.with_name(f".{token_hex(4)}.{target.name}")
    try:
        new.touch(0o600 if old else 0o666, exist_ok=False)  # as far as new files may here
        write(new)
        if old:
            shutil.copymode(target, new)
        os.replace(new, target)
    except BaseException as error:
        new.unlink(missing_ok=True)
        if isinstance(error, OSError):  # that of a full disk has no name, or the hidden one
            error.filename = str(target)
        raise
