"""What a person is asked in one trial."""

from dataclasses import dataclass
from typing import Literal

Task = Literal["choice", "setting"]
"""Which of two feels stronger, or until when one feels like the other."""


@dataclass(frozen=True)
class Presentation:
    """What a procedure wants to know next."""

    level: float
    """Level of the comparison: its difference from the reference by the reference, or its intensity where that is zero;
    of a setting, where it starts."""
    comparison_first: bool
    series: int = 0
    """Within its session."""


@dataclass(frozen=True)
class Trial:
    """One trial of a person's whole experiment."""

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
        """1 or 2: the right answer of a choice."""
        return 1 if self.first > self.second else 2


def intensity(reference: float, level: float) -> float:
    """Intensity of a comparison at a level: larger than a reference by that share, or the level itself where there is
    none."""
    return reference * (1 + level) if reference > 0 else level


def level_of(reference: float, comparison: float) -> float:
    """The level of a comparison of some intensity."""
    return comparison / reference - 1 if reference > 0 else comparison
