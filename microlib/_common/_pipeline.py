"""Work in rounds on the parts of something large, in several threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import TypeVar

__all__ = ["pipeline"]

T = TypeVar("T")


def pipeline(rounds: Iterator[Callable[[T], None]], parts: Sequence[T], workers: int) -> None:
    """Do the work of every round on every part, the rounds of a part in order.

    Threads do not wait for each other at the end of a round. The next one, which may have to be
    read from a file, is asked for by whichever thread needs it first. The first error ends all.
    """
    turn = Lock()
    busy = [Lock() for _ in parts]
    todo: deque[int] = deque()
    work: Callable[[T], None] | None = None
    failed = False

    def take(k: int) -> tuple[Callable[[T], None], int] | None:
        nonlocal work
        if not todo:
            work = next(rounds, None)
            todo.extend(range(len(parts)))
        if work is None or failed:
            return None
        # From both ends, so that most parts stay with their thread, and in its core's cache,
        # although one may be faster.
        part = todo.popleft() if k % 2 == 0 else todo.pop()
        busy[part].acquire()
        return work, part

    def some(k: int) -> None:
        nonlocal failed
        while True:
            with turn:
                job = take(k)
            if job is None:
                return
            work, part = job
            try:
                work(parts[part])
            except BaseException:
                failed = True
                raise
            finally:
                busy[part].release()

    # The caller works too: waiting, it would be woken beside a worker on the same core.
    with ThreadPoolExecutor(max(workers - 1, 1)) as pool:
        others = [pool.submit(some, k) for k in range(1, workers)]
        some(0)
        for other in others:
            other.result()
