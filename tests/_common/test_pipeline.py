"""Rounds of work in threads: nothing is lost, and errors arrive."""

from collections.abc import Iterator
from functools import partial
from threading import Barrier, get_ident

import pytest

from microlib._common import pipeline


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_every_part_sees_every_round_in_order(workers):
    seen: list[list[int]] = [[] for _ in range(7)]

    def rounds() -> Iterator[partial]:
        for number in range(50):
            yield partial(lambda part, number: seen[part].append(number), number=number)

    pipeline(rounds(), range(7), workers)
    assert seen == [list(range(50))] * 7


def test_threads_work_at_the_same_time():
    together = Barrier(2, timeout=30)  # breaks, and raises, if one thread does both parts
    names = set()

    def work(part: int) -> None:
        names.add(get_ident())
        together.wait()

    pipeline(iter([work]), range(2), 2)
    assert len(names) == 2


def test_threads_begin_from_both_ends():
    """So that a part mostly stays with its thread, and its data in that core's cache."""
    together = Barrier(3, timeout=30)
    first = {}

    def work(part: int) -> None:
        if get_ident() not in first:
            first[get_ident()] = part
            together.wait()

    pipeline(iter([work]), range(6), 3)
    assert sorted(first.values()) == [0, 1, 5]


@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("culprit", [0, 3])
def test_the_first_error_ends_the_work(workers, culprit):
    done = []

    def work(part: int, number: int) -> None:
        if (part, number) == (culprit, 2):
            raise RuntimeError("part is broken")
        done.append(number)

    with pytest.raises(RuntimeError, match="part is broken"):
        pipeline((partial(work, number=n) for n in range(1000)), range(4), workers)
    assert max(done) < 100  # the others stop soon after, not at the end


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_the_source_arrives(workers):
    def rounds() -> Iterator:
        yield lambda part: None
        raise OSError("disk is gone")

    with pytest.raises(OSError, match="disk is gone"):
        pipeline(rounds(), range(3), workers)


def test_one_worker_is_the_caller():
    names = set()
    pipeline(iter([lambda part: names.add(get_ident())] * 3), range(4), 1)
    assert names == {get_ident()}
