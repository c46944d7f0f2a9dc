"""A Bayesian adaptive procedure: each trial at the level that is expected to tell most.

The psi method (Kontsevich and Tyler 1999), as QUEST+ has it (Watson 2017): a posterior on a grid of psychometric
functions, and the level whose answer leaves the least expected entropy.
"""

import random
from dataclasses import dataclass

import numpy as np
from scipy.special import xlogy

from jaxgrasp.psychophysics.procedures.procedure import Coin, Procedure, Settings, check_count, check_level
from jaxgrasp.psychophysics.psychometric import PsychometricShape, check_criterion, hit_probability
from jaxgrasp.psychophysics.trial import Presentation

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
