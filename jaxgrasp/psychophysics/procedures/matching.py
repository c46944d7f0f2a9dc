"""Matching: a person adjusts one stimulus until it feels like the other (the method of adjustment)."""

import random
from dataclasses import dataclass

from jaxgrasp.psychophysics.procedures.procedure import Coin, Listed, Procedure, Settings, check_count, check_level
from jaxgrasp.psychophysics.trial import Presentation


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
