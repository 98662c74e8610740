"""The size of a picture from the first bytes of its file, before anything is decoded."""

from __future__ import annotations

import struct
from pathlib import Path

__all__ = ["picture_size"]

#: Markers of JPEG that carry the size: starts of frames, of all kinds of coding.
_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def picture_size(path: Path) -> tuple[int, int] | None:
    """Return rows and columns of a PNG or JPEG file as its header says, None for any other.

    Examples
    --------
    >>> from pathlib import Path
    >>> from microlib.io._headers import picture_size
    >>> import tempfile, cv2, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "a.png"
    ...     _ = cv2.imwrite(str(path), np.zeros((3, 5), np.uint8))
    ...     picture_size(path)
    (3, 5)
    """
    with path.open("rb") as file:
        start = file.read(24)
        if start[:8] == b"\x89PNG\r\n\x1a\n" and len(start) == 24:
            cols, rows = struct.unpack(">II", start[16:24])
            return rows, cols
        if start[:2] != b"\xff\xd8":
            return None
        file.seek(2)
        while len(head := file.read(4)) == 4 and head[0] == 0xFF:
            length = struct.unpack(">H", head[2:])[0]
            if head[1] in _JPEG_SIZES:
                size = file.read(5)
                if len(size) < 5:
                    return None
                rows, cols = struct.unpack(">HH", size[1:])
                return rows, cols
            file.seek(length - 2, 1)
    return None
