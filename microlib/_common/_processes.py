"""Worker processes that end with the process that began them."""

from __future__ import annotations

import multiprocessing
import os
import threading
from typing import Any


def end_with_starter() -> None:
    """End this process of `multiprocessing` once the one that began it ended, or was killed."""

    def watch(starter: Any) -> None:
        starter.join()
        os._exit(1)

    starter = multiprocessing.parent_process()
    threading.Thread(target=watch, args=(starter,), daemon=True).start()
