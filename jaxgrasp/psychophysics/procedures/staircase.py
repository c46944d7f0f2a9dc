"""Staircases: harder after some right answers, easier after a wrong one (Levitt 1971)."""

import math
import random
from dataclasses import dataclass

from jaxgrasp.psychophysics.procedures.procedure import Coin, Procedure, Settings, check_count, check_level
from jaxgrasp.psychophysics.trial import Presentation


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
