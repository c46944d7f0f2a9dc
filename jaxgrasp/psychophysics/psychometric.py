"""Psychometric functions: the chance of a right answer by level, through a threshold at a stated hit ratio.

Simulated observer, who answers like a person of known sensitivity.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float, Real
from scipy.special import expit, logit, ndtr, ndtri

from jaxgrasp.validation.checked import checked

Values = Float[np.ndarray, "..."] | float


class PsychometricShape(StrEnum):
    """Shape of the rise of a hit ratio from chance to one, less the lapses."""

    GAUSSIAN = "gaussian"
    """The normal distribution of the level, with location and scale."""
    LOGISTIC = "logistic"
    """The logistic distribution of the level, with location and scale."""
    WEIBULL = "weibull"
    """Weibull's, which is at chance where the level is zero."""
    GUMBEL = "gumbel"
    """Gumbel's of the smallest value: Weibull's of levels that are logarithms (dB, log10)."""
    DIFFERENCE = "difference"
    """Comparison of two noisy sensations by an observer without bias: scale alone, at chance at zero."""

    @property
    def has_width(self) -> bool:
        """True where the steepness is a parameter of its own."""
        return self is not PsychometricShape.DIFFERENCE

    @property
    def has_zero(self) -> bool:
        """Tell whether the function starts at level zero, so that levels and thresholds are not negative.

        The other shapes depend on differences of levels alone: their levels may have any sign or be logarithms.
        """
        return self in (PsychometricShape.WEIBULL, PsychometricShape.DIFFERENCE)


def standard(shape: PsychometricShape, u: Values) -> Values:
    """Compute the rise of a shape from 0 to 1 at standardised levels ``u``."""
    match shape:
        case PsychometricShape.GAUSSIAN:
            return ndtr(u)
        case PsychometricShape.LOGISTIC:
            return expit(u)
        case PsychometricShape.WEIBULL | PsychometricShape.GUMBEL:
            return -np.expm1(-np.exp(np.minimum(u, 50.0)))
        case PsychometricShape.DIFFERENCE:
            return 2 * ndtr(u) - 1


def quantile(shape: PsychometricShape, share: Values) -> Values:
    """Compute the standardised level at which the rise of a shape reaches a share."""
    match shape:
        case PsychometricShape.GAUSSIAN:
            return ndtri(share)
        case PsychometricShape.LOGISTIC:
            return logit(share)
        case PsychometricShape.WEIBULL | PsychometricShape.GUMBEL:
            return np.log(-np.log1p(-np.asarray(share)))
        case PsychometricShape.DIFFERENCE:
            return ndtri((1 + np.asarray(share)) / 2)


@checked
def hit_probability(
    shape: PsychometricShape,
    levels: Values,
    threshold: Values,
    width: Values = 1.0,
    lapse: Values = 0.0,
    *,
    criterion: float = 0.75,
    chance: float = 0.5,
) -> Values:
    """Compute the chance of a right answer; all arguments broadcast.

    Args:
        shape: of the rise.
        levels: zero or more for ``"weibull"`` and ``"difference"``, any finite number for the other shapes.
        threshold: level at which the hit ratio is the criterion, lapses included.
        width: of the rise, in units of the level; of its logarithm for a Weibull function (one by its exponent); a
            difference function has none.
        lapse: share of answers that do not depend on the stimulus and are wrong.
        criterion: hit ratio at the threshold.
        chance: hit ratio of who guesses.

    Raises:
        ValueError: for a negative level of a shape that starts at zero.
    """
    check_levels(shape, levels)
    rise = 1 - chance - np.asarray(lapse)
    anchor = quantile(shape, (criterion - chance) / rise)
    if shape is PsychometricShape.DIFFERENCE:
        u = np.asarray(levels) / threshold * anchor
    elif shape is PsychometricShape.WEIBULL:
        with np.errstate(divide="ignore"):
            u = (np.log(levels) - np.log(threshold)) / width + anchor
    else:
        u = (np.asarray(levels) - threshold) / width + anchor
    # psi = gamma + (1 - gamma - lambda) F(u).
    return chance + rise * standard(shape, u)


def check_criterion(criterion: float, chance: float, most_lapse: float) -> None:
    """Raise ValueError unless a psychometric function passes the criterion between chance and lapses."""
    if not 0 <= chance < 1:
        raise ValueError(f"chance is {chance}: expected 0 or more, and less than 1")
    if not 0 <= most_lapse < 1 - chance:
        raise ValueError(f"lapse is {most_lapse}: expected 0 or more, and less than 1 - chance, {1 - chance:g}")
    if not chance < criterion < 1 - most_lapse:
        raise ValueError(
            f"criterion is {criterion}: expected more than chance, {chance:g}, and less than {1 - most_lapse:g}, "
            "the largest hit ratio that lapses allow"
        )


def check_levels(shape: PsychometricShape, levels: Values, name: str = "levels") -> None:
    """Raise ValueError for a negative level of a shape that starts at zero."""
    values = np.asarray(levels)
    if not shape.has_zero or not np.any(values < 0):
        return
    index = tuple(int(k) for k in np.argwhere(values < 0)[0])
    subscript = f"[{', '.join(map(str, index))}]" if index else ""
    raise ValueError(
        f"{name}{subscript} is {values[index]:g}: the shape {shape.value!r} needs levels of 0 or more; for levels of "
        "any sign take 'gaussian' or 'logistic', for logarithms of levels 'gumbel' (Weibull's function of them)"
    )


QUARTILE = float(ndtri(0.75))
Levels = Real[np.ndarray, "..."] | float | int


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

    def jnd(self, reference: Levels, trial: Levels = np.inf) -> Levels:
        """Compute the just noticeable difference at a hit ratio of 0.75, in the stimulus' unit.

        Args:
            reference: the smaller of two intensities.
            trial: number of the trial, from 0; learning is over where it is infinite.
        """
        learnt = 1 + self.learning * np.exp(-np.asarray(trial) / self.learning_trials)
        return (self.weber * np.asarray(reference) + self.absolute) * learnt

    def second_probability(self, first: Levels, second: Levels, trial: Levels = np.inf) -> Levels:
        """Compute the chance of the answer that the second is stronger."""
        first, second = np.asarray(first, float), np.asarray(second, float)
        noise = self.jnd(np.minimum(first, second), trial) / QUARTILE
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(noise > 0, (second - first) / noise, np.sign(second - first) * np.inf)
        share_second = ndtr(np.where(second == first, 0.0, distance) + self.bias)
        return self.lapse + (1 - 2 * self.lapse) * share_second

    def hit_probability(self, reference: Levels, comparison: Levels, trial: Levels = np.inf) -> Levels:
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
