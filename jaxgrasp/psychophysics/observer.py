"""Simulated observer, who answers like a person of known sensitivity."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Real
from scipy.special import ndtr, ndtri

QUARTILE = float(ndtri(0.75))
Values = Real[np.ndarray, "..."] | float | int


@dataclass(frozen=True)
class Observer:
    """Observer of two sensations, each with normal noise that grows with the reference.

    The just noticeable difference at a hit ratio of 0.75 is ``weber x reference + absolute``: exactly, without lapses,
    bias and learning.

    Example:
        >>> from jaxgrasp.psychophysics import Observer
        >>> observer = Observer(weber=0.15)
        >>> round(float(observer.hit_probability(2.0, 2.3)), 6)
        0.75

    Raises:
        ValueError: for numbers out of their ranges.
    """

    weber: float = 0.15
    """Weber fraction of large references."""
    absolute: float = 0.0
    """JND where the reference is zero, in the stimulus' unit."""
    lapse: float = 0.0
    """Share of trials whose answer is wrong since it does not depend on the stimulus: half of those without
    attention."""
    bias: float = 0.0
    """Preference for the second interval, by the noise of the difference."""
    learning: float = 0.0
    """Relative increase of JNDs in the first trial."""
    learning_trials: float = 50.0
    """Trials after which 63 % of this increase is gone."""

    def __post_init__(self):
        for name in ("weber", "absolute", "lapse", "learning"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}: expected a finite number, 0 or more")
        if not self.lapse < 0.5:
            raise ValueError(f"lapse is {self.lapse}: expected less than 0.5")
        if not self.weber + self.absolute > 0:
            raise ValueError("weber and absolute are both 0: expected one of them to be positive")
        if not np.isfinite(self.bias):
            raise ValueError(f"bias is {self.bias}: expected a finite number")
        if not self.learning_trials > 0:
            raise ValueError(f"learning_trials is {self.learning_trials}: expected a positive number")

    def jnd(self, reference: Values, trial: Values = np.inf) -> Values:
        """Compute the just noticeable difference at a hit ratio of 0.75, in the stimulus' unit.

        Args:
            reference: the smaller of two intensities.
            trial: number of the trial, from 0; learning is over where it is infinite.
        """
        learnt = 1 + self.learning * np.exp(-np.asarray(trial) / self.learning_trials)
        return (self.weber * np.asarray(reference) + self.absolute) * learnt

    def second_probability(self, first: Values, second: Values, trial: Values = np.inf) -> Values:
        """Compute the chance of the answer that the second is stronger."""
        first, second = np.asarray(first, float), np.asarray(second, float)
        noise = self.jnd(np.minimum(first, second), trial) / QUARTILE
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(noise > 0, (second - first) / noise, np.sign(second - first) * np.inf)
        share_second = ndtr(np.where(second == first, 0.0, distance) + self.bias)
        return self.lapse + (1 - 2 * self.lapse) * share_second

    def hit_probability(self, reference: Values, comparison: Values, trial: Values = np.inf) -> Values:
        """Compute the chance of a right answer, as the mean over both orders."""
        after, before = (
            self.second_probability(reference, comparison, trial),
            self.second_probability(comparison, reference, trial),
        )
        return 0.5 * (after + 1 - before)

    def choose(self, first: float, second: float, trial: int, rng: np.random.Generator) -> int:
        """Draw the answer which of two intensities feels stronger, 1 or 2."""
        return 2 if rng.random() < self.second_probability(first, second, trial) else 1

    def match(self, reference: float, trial: int, rng: np.random.Generator) -> float:
        """Draw a setting that feels like the reference, without the error of the adjustment."""
        noise = float(self.jnd(reference, trial)) / QUARTILE
        return max(0.0, reference + noise * (float(rng.standard_normal()) - self.bias))
