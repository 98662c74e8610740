"""The tables of who imports whom show what the code imports."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "book" / "_ext"))
from rooms import imported


def test_imports_are_read_from_the_code(tmp_path: Path) -> None:
    code = "import a.b\nfrom c import d as e\ndef f():\n    from g.h import i\n"
    (tmp_path / "one.py").write_text(code)
    assert (
        imported(tmp_path) == imported(tmp_path / "one.py") == {("a", "b"), ("c", "d"), ("g", "h")}
    )
