"""Worker processes that end with the process that began them."""

from __future__ import annotations

import multiprocessing
import os
import threading
from multiprocessing.connection import wait


def end_with_starter() -> bool:
    """End this process as soon as the one of `multiprocessing` that began it has ended.

    Even if that was killed. False if `multiprocessing` did not begin this process.
    """
    starter = multiprocessing.parent_process()
    if starter is None:
        return False

    def watch() -> None:
        wait([starter.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    return True
