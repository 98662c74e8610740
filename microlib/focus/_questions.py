"""What a part of an image must be told of the whole, asked where it is needed.

A computation is a generator that yields a `Question` where it needs a number of the whole image. It
says what it can contribute and how contributions make the number. Parts that are computed in step
answer each other; a tile is answered from a survey, and contributes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

__all__ = ["Question", "Steps", "alone", "answered"]

T = TypeVar("T")


@dataclass(frozen=True)
class Question:
    """A number of the whole image.

    Attributes
    ----------
    name : str
        What it is called in a survey.
    sample : callable
        Returns what this part contributes.
    combine : callable
        Takes a list of contributions and returns the answer.
    """

    name: str
    sample: Callable[[], Any]
    combine: Callable[[list[Any]], Any]


#: A computation that asks, and returns what is found.
Steps = Generator[Question, Any, T]


def answered(parts: Sequence[Steps[T]], known: dict[str, Any]) -> list[T]:
    """Run computations to their ends, in step; what is not `known` they tell each other.

    Parameters
    ----------
    parts : sequence of generators
        Computations that ask the same, in the same order, of parts of one image.
    known : dict
        Answers by name; new ones are added.

    Returns
    -------
    list
        What each computation returns.

    Examples
    --------
    >>> def share(value):
    ...     total = yield Question("total", lambda: value, sum)
    ...     return value / total
    >>> answered([share(1), share(3)], {}), answered([share(1)], {"total": 10})
    ([0.25, 0.75], [0.1])
    """
    found: list[T] = []
    answer: Any = None
    while not found:
        asked: list[Question] = []
        for part in parts:
            try:
                asked.append(part.send(answer))
            except StopIteration as end:
                found.append(end.value)
        if asked:
            name = asked[0].name
            if name not in known:
                known[name] = asked[0].combine([question.sample() for question in asked])
            answer = known[name]
    return found


def alone(steps: Steps[T]) -> T:
    """Run a computation of a whole image."""
    return answered([steps], {})[0]
