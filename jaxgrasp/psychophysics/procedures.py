"""Procedures that choose the next stimulus: staircases, constant stimuli, matching, and a Bayesian method.

Staircases: harder after some right answers, easier after a wrong one (Levitt 1971).

Interface of procedures and of their settings, and parts that all procedures use.

A Bayesian adaptive procedure: each trial at the level that is expected to tell most.

The psi method (Kontsevich and Tyler 1999), as QUEST+ has it (Watson 2017): a posterior on a grid of psychometric
functions, and the level whose answer leaves the least expected entropy.

Constant stimuli with paired comparison: the paper's forced choice.

Matching: a person adjusts one stimulus until it feels like the other (the method of adjustment).
"""

import math
import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.special import xlogy

from jaxgrasp.paper.tables import DIFFERENCES, REPEATS, SERIES
from jaxgrasp.psychophysics.psychometric import PsychometricShape, check_criterion, hit_probability
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


THRESHOLDS, WIDTHS = 60, 20
MOST_LEVELS = 500


@dataclass(frozen=True)
class Adaptive(Settings):
    """Levels and prior are even on a logarithmic scale from low to high."""

    follows_answers = True

    low: float = 0.02
    """Smallest level, and smallest threshold thought of."""
    high: float = 0.8
    """Largest level, and largest threshold thought of."""
    levels: int = 25
    """Number of levels to choose from."""
    trials: int = 40
    """Trials in a session."""
    shape: PsychometricShape = PsychometricShape.DIFFERENCE
    """Shape of the psychometric function: of the belief, and by default of the analysis too. A steepness of its own,
    which other shapes have, is found biased where levels follow the answers."""
    criterion: float = 0.75
    """Hit ratio at the threshold."""
    lapse: float = 0.02
    """Share of answers that do not depend on the stimulus and are wrong."""

    def __post_init__(self):
        for name in ("low", "high"):
            check_level(name, getattr(self, name))
        if not self.low < self.high:
            raise ValueError(f"low is {self.low:g}: expected less than high, {self.high:g}")
        check_count("levels", self.levels, 2)
        if self.levels > MOST_LEVELS:
            raise ValueError(f"levels is {self.levels}: expected at most {MOST_LEVELS}")
        check_count("trials", self.trials)
        check_criterion(self.criterion, 0.5, self.lapse)

    def begin(self, rng: random.Random) -> Procedure:
        return _AdaptiveSession(self, rng)

    def extremes(self) -> tuple[float, float]:
        return self.low, self.high

    def most_trials(self) -> int:
        return self.trials


class _AdaptiveSession(Procedure):
    def __init__(self, settings: Adaptive, rng: random.Random) -> None:
        self._levels = np.geomspace(settings.low, settings.high, settings.levels)
        thresholds = np.geomspace(settings.low, settings.high, THRESHOLDS)
        shape = settings.shape
        widths = (
            np.geomspace(0.2, 3.0, WIDTHS)
            if shape is PsychometricShape.WEIBULL
            else np.geomspace(0.1, 2.0, WIDTHS) * (settings.low * settings.high) ** 0.5
        )
        widths = widths if shape.has_width else np.ones(1)
        chances = hit_probability(
            shape,
            self._levels[:, None, None],
            thresholds[:, None],
            widths,
            settings.lapse,
            criterion=settings.criterion,
        )
        self._right = np.asarray(chances).reshape(len(self._levels), -1)
        self._belief = np.full(self._right.shape[1], 1 / self._right.shape[1])
        self._remaining = settings.trials
        self._coin = Coin(rng)
        self._chosen = 0
        self._presented = self._choose()

    def next(self) -> Presentation | None:
        return self._presented

    def score(self, value: float) -> None:
        right = self._right[self._chosen]
        belief = self._belief * (right if value > 0 else 1 - right)
        self._belief = belief / belief.sum()
        self._remaining -= 1
        self._presented = self._choose()

    def _choose(self) -> Presentation | None:
        if not self._remaining:
            return None
        self._chosen = int(np.argmin(self._expected_entropy()))
        return Presentation(float(self._levels[self._chosen]), self._coin.toss())

    def _expected_entropy(self) -> np.ndarray:
        """Compute the expected entropy of the belief after an answer at each level."""
        joint = self._right * self._belief, (1 - self._right) * self._belief
        return sum(xlogy(total := part.sum(1), total) - xlogy(part, part).sum(1) for part in joint)


@dataclass(frozen=True)
class ConstantStimuli(Settings):
    """Series in each of which every level comes equally often, as often first as second, in random order."""

    levels: tuple[float, ...] = DIFFERENCES
    """Differences from the reference by the reference; intensities where the reference is zero."""
    series: int = SERIES
    """Series in a session."""
    repeats: int = REPEATS
    """Presentations of each level in a series: an even number, so that it comes first as often as second."""

    def __post_init__(self):
        if not self.levels:
            raise ValueError("levels is empty: expected at least one")
        for k, level in enumerate(self.levels):
            check_level(f"levels[{k}]", level)
            if level in self.levels[:k]:
                raise ValueError(f"levels[{k}] is {level:g} again: expected each level once")
        check_count("series", self.series)
        check_count("repeats", self.repeats, 2)
        if self.repeats % 2:
            raise ValueError(f"repeats is {self.repeats}: expected an even number, half of them with each order")

    def begin(self, rng: random.Random) -> Procedure:
        presentations: list[Presentation] = []
        for series in range(self.series):
            orders = (True, False) * (self.repeats // 2)
            presentations += shuffled(
                (Presentation(level, first, series) for level in self.levels for first in orders), rng
            )
        return Listed(presentations)

    def extremes(self) -> tuple[float, float]:
        return min(self.levels), max(self.levels)

    def most_trials(self) -> int:
        return self.series * self.repeats * len(self.levels)


@dataclass(frozen=True)
class Matching(Settings):
    """Settings that start above and below the reference equally often."""

    trials: int = 20
    """Trials in a session."""
    start: float = 0.4
    """Largest distance of the start from the reference, by the reference; less than 1."""
    step: float = 0.02
    """Step of the adjustment, by the reference."""

    def __post_init__(self):
        check_count("trials", self.trials, 2)
        for name in ("start", "step"):
            check_level(name, getattr(self, name))
        if not self.step <= self.start < 1:
            raise ValueError(f"start is {self.start:g}: expected at least step, {self.step:g}, and less than 1")

    def begin(self, rng: random.Random) -> Procedure:
        above = Coin(rng)
        sides = [above.toss() for _ in range(self.trials)]
        # Half of the distance at least, so that no start tells where the match is.
        distances = [self.start * (0.5 + 0.5 * rng.random()) for _ in sides]
        starts = (Presentation(d if up else -d, False) for up, d in zip(sides, distances, strict=True))
        return Listed(starts, "setting")

    def extremes(self) -> tuple[float, float]:
        return -self.start, self.start

    def most_trials(self) -> int:
        return self.trials


@dataclass(frozen=True)
class Staircase(Settings):
    """1-up-n-down on a logarithmic scale; several of them take turns at random."""

    follows_answers = True

    start: float = 0.4
    """Level of the first trial."""
    low: float = 0.01
    """Smallest level."""
    high: float = 0.8
    """Largest level."""
    down: int = 2
    """Right answers in a row before it becomes harder, 2 or more, since one of two guesses is right: the level goes to
    where the hit ratio is a half to the power of 1 / down."""
    factors: tuple[float, ...] = (1.5, 1.2)
    """Factors by which the level changes, one until the next reversal, the last for all others."""
    reversals: int = 10
    """Reversals after which a staircase ends."""
    interleaved: int = 2
    """Staircases in a session."""
    trials: int = 60
    """Trials after which a staircase ends at the latest."""

    def __post_init__(self):
        for name in ("start", "low", "high"):
            check_level(name, getattr(self, name))
        if not self.low <= self.start <= self.high:
            raise ValueError(f"start is {self.start:g}: expected from low, {self.low:g}, to high, {self.high:g}")
        for name, least in (("down", 2), ("reversals", 2), ("interleaved", 1), ("trials", 2)):
            check_count(name, getattr(self, name), least)
        if not self.factors:
            raise ValueError("factors is empty: expected at least one")
        for k, factor in enumerate(self.factors):
            if not factor > 1:
                raise ValueError(f"factors[{k}] is {factor:g}: expected more than 1")

    @property
    def target(self) -> float:
        """Hit ratio of the level that it goes to."""
        return 0.5 ** (1 / self.down)

    def begin(self, rng: random.Random) -> Procedure:
        return _StaircaseSession(self, rng)

    def extremes(self) -> tuple[float, float]:
        return self.low, self.high

    def most_trials(self) -> int:
        return self.interleaved * self.trials


class Track:
    """State of a staircase: level, turning points and trials so far."""

    def __init__(self, settings: Staircase) -> None:
        self.level = settings.start
        self.turning_points: list[float] = []
        """Levels at which it turned."""
        self._settings = settings
        # Steps are counted, so that a level to which it comes back is the same number to the last bit.
        self._base_level, self._steps = settings.start, [0] * len(settings.factors)
        self._in_a_row = self._trials = self._direction = 0

    @property
    def is_over(self) -> bool:
        """True after the planned reversals, or the largest number of trials."""
        return len(self.turning_points) >= self._settings.reversals or self._trials >= self._settings.trials

    def score(self, is_right: bool) -> None:
        """Take an answer at its level."""
        self._trials += 1
        self._in_a_row = self._in_a_row + 1 if is_right else 0
        if is_right and self._in_a_row < self._settings.down:
            return
        self._in_a_row = 0
        direction = -1 if is_right else 1
        if self._direction and direction != self._direction:
            self.turning_points.append(self.level)
        self._direction = direction
        factors = self._settings.factors
        self._steps[min(len(self.turning_points), len(factors) - 1)] += direction
        level = self._base_level * math.prod(factor**steps for factor, steps in zip(factors, self._steps, strict=True))
        self.level = min(max(level, self._settings.low), self._settings.high)
        if self.level != level:
            self._base_level, self._steps = self.level, [0] * len(factors)


class _StaircaseSession(Procedure):
    def __init__(self, settings: Staircase, rng: random.Random) -> None:
        self._tracks = [Track(settings) for _ in range(settings.interleaved)]
        self._rng, self._coin = rng, Coin(rng)
        self._current = 0
        self._presented = self._choose()

    def next(self) -> Presentation | None:
        return self._presented

    def score(self, value: float) -> None:
        self._tracks[self._current].score(value > 0)
        self._presented = self._choose()

    def _choose(self) -> Presentation | None:
        running = [k for k, track in enumerate(self._tracks) if not track.is_over]
        if not running:
            return None
        self._current = running[int(self._rng.random() * len(running))]
        return Presentation(self._tracks[self._current].level, self._coin.toss(), self._current)


def staircase_threshold(settings: Staircase, levels: list[float], right: list[bool], skipped: int = 4) -> float:
    """Compute the geometric mean of a staircase's later turning points; NaN where no even number is left.

    Args:
        settings: of the staircase.
        levels: of its trials, in their order.
        right: whether each answer was.
        skipped: turning points that are left out, while it still comes near.

    Raises:
        ValueError: where the levels are not those of such a staircase with these answers.
    """
    track = Track(settings)
    for k, (level, is_right) in enumerate(zip(levels, right, strict=True)):
        if abs(track.level - level) > 1e-9 * level:
            raise ValueError(f"levels[{k}] is {level:g}: expected {track.level:g}, where the answers lead")
        track.score(is_right)
    later_points = track.turning_points[skipped:]
    # As many peaks as valleys, so that neither pulls.
    later_points = later_points[len(later_points) % 2 :]
    if not later_points:
        return float("nan")
    return math.exp(sum(map(math.log, later_points)) / len(later_points))
