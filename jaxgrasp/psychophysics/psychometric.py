"""Psychometric functions: the chance of a right answer by level, through a threshold at a stated hit ratio."""

from enum import StrEnum

import numpy as np
from jaxtyping import Float
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
