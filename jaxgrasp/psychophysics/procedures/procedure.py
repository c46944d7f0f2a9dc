"""Interface of procedures and of their settings, and parts that all procedures use."""

import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable
from typing import TypeVar

from jaxgrasp.psychophysics.trial import Presentation, Task

Item = TypeVar("Item")
SMALLEST = 1e-6
"""Smallest level or intensity that is allowed; the largest is its inverse."""
MOST = 10_000
"""Largest count that a plan may ask for, of trials, series and the like."""


class Procedure(ABC):
    """Session of a procedure: call ``next`` and ``score`` in turn."""

    task: Task = "choice"

    @abstractmethod
    def next(self) -> Presentation | None:
        """Return the next presentation, the same until it is scored; None when the session is over."""

    @abstractmethod
    def score(self, value: float) -> None:
        """Take the score of what was presented: 1 or 0 for a right or a wrong answer; of a setting, its level."""


class Listed(Procedure):
    """A session that is decided before its first answer."""

    def __init__(self, presentations: Iterable[Presentation], task: Task = "choice") -> None:
        self.task = task
        self._remaining = deque(presentations)

    def next(self) -> Presentation | None:
        return self._remaining[0] if self._remaining else None

    def score(self, value: float) -> None:
        self._remaining.popleft()


class Settings(ABC):
    """Settings of a procedure in a plan."""

    follows_answers = False
    """True where levels depend on the answers before."""

    @abstractmethod
    def begin(self, rng: random.Random) -> Procedure:
        """Begin a session, decided by a generator's seed."""

    @abstractmethod
    def extremes(self) -> tuple[float, float]:
        """Return the smallest and the largest level that it can present."""

    @abstractmethod
    def most_trials(self) -> int:
        """Return the largest number of trials in a session."""


def shuffled(items: Iterable[Item], rng: random.Random) -> list[Item]:
    """Return the items in random order, by ``random()`` alone, whose sequence Python promises to keep."""
    return [item for _, item in sorted(((rng.random(), k), item) for k, item in enumerate(items))]


class Coin:
    """Yes and no in random order, as often each: two of each in every four."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._remaining: list[bool] = []

    def toss(self) -> bool:
        if not self._remaining:
            self._remaining = shuffled((True, True, False, False), self._rng)
        return self._remaining.pop()


def check_level(name: str, value: float) -> None:
    """Raise ValueError for a level that is not positive, or out of range."""
    if not SMALLEST <= value <= 1 / SMALLEST:
        raise ValueError(f"{name} is {value:g}: expected a positive number, {SMALLEST:g} to {1 / SMALLEST:g}")


def check_count(name: str, value: int, least: int = 1) -> None:
    """Raise ValueError for a count below ``least``, or larger than a person can do."""
    if not least <= value <= MOST:
        raise ValueError(f"{name} is {value}: expected {least} or more, and at most {MOST}")
