"""Constant stimuli with paired comparison: the paper's forced choice."""

import random
from dataclasses import dataclass

from jaxgrasp.paper.tables import DIFFERENCES
from jaxgrasp.paper.weight_perception import REPEATS, SERIES
from jaxgrasp.psychophysics.procedures.procedure import Listed, Procedure, Settings, check_count, check_level, shuffled
from jaxgrasp.psychophysics.trial import Presentation


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
