"""What is compiled says so, and is as good as new when it was loaded."""

import logging
import subprocess
import sys

SCRIPT = """
import logging
import numpy as np
logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
from microlib.focus import sum_modified_laplacian
for _ in range(2):
    sum_modified_laplacian(np.zeros((9, 9), np.uint8))
"""


def test_a_first_call_that_compiles_says_so_once(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def said() -> int:
        found = subprocess.run(
            [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
        )
        return found.stderr.count("microlib.focus: compiling")

    assert said() == 1
    assert said() == 0  # loaded
    assert logging.getLogger("microlib.focus").level == logging.NOTSET
