"""Trials of an experiment: task, level and intensities."""

from dataclasses import dataclass
from typing import Literal

Task = Literal["choice", "setting"]
"""Task of a trial: choice of the stronger of two stimuli, or setting of one to match the other."""


@dataclass(frozen=True)
class Presentation:
    """Next presentation of a procedure: level of the comparison, and order of the pair."""

    level: float
    """Level of the comparison: its difference from the reference by the reference, or its intensity where that is zero;
    of a setting, where it starts."""
    comparison_first: bool
    series: int = 0
    """Number of the series within its session, from 0."""


@dataclass(frozen=True)
class Trial:
    """Trial of a person's whole experiment."""

    number: int
    """From 1, practice included."""
    session: int
    """From 1; practice is of the session that follows it."""
    series: int
    is_practice: bool
    task: Task
    reference: float
    level: float
    first: float
    """Intensity of what comes first; of a setting, the reference."""
    second: float
    """Intensity of what comes second; of a setting, where it starts."""

    @property
    def stronger(self) -> int:
        """Right answer of a choice, 1 or 2."""
        return 1 if self.first > self.second else 2


def intensity(reference: float, level: float) -> float:
    """Compute the intensity of a comparison at a level.

    It is larger than the reference by that share, or the level itself where the reference is zero.
    """
    return reference * (1 + level) if reference > 0 else level


def level_of(reference: float, comparison: float) -> float:
    """Compute the level of a comparison from its intensity; the inverse of ``intensity``."""
    return comparison / reference - 1 if reference > 0 else comparison
