"""Findings on a threshold: found, or the reason why the answers do not determine it."""

from enum import StrEnum

import numpy as np
from scipy.special import bdtr, bdtrc

from jaxgrasp.psychophysics.analysis.counts import Counts

DOUBT = 0.05
"""Chance of calling answers better, or worse, than guesses when they are guesses."""
CLOSE = 1e-4


class Finding(StrEnum):
    """Outcome of a search for a threshold. The names are stable in files; ``advice`` says what to do."""

    FOUND = "found"
    NO_TRIALS = "no-trials"
    ONE_LEVEL = "one-level"
    ALL_RIGHT = "all-right"
    AT_CHANCE = "at-chance"
    BELOW_CHANCE = "below-chance"
    NOT_RISING = "not-rising"
    BELOW_LEVELS = "below-levels"
    ABOVE_LEVELS = "above-levels"
    STEEPER = "steeper-than-levels"

    @property
    def has_threshold(self) -> bool:
        """Tell whether the estimate is a threshold; of a function that is too steep to have a width it is one."""
        return self in (Finding.FOUND, Finding.STEEPER)

    @property
    def advice(self) -> str:
        """Sentence that a user can act on."""
        return _ADVICE[self]


_ADVICE = {
    Finding.FOUND: "The threshold lies among the levels that were tried.",
    Finding.NO_TRIALS: "There are no answers to analyse.",
    Finding.ONE_LEVEL: "Answers at one level leave the steepness open: try more levels (with the method likelihood, "
    "the shape 'difference' needs no steepness).",
    Finding.ALL_RIGHT: "Every answer is right, so the threshold is below the levels that were tried: try smaller ones.",
    Finding.AT_CHANCE: "The answers are not better than guesses: the threshold is above the levels, or the task is not "
    "understood.",
    Finding.BELOW_CHANCE: "The answers are worse than guesses: they may be reversed; ask, and look at the records.",
    Finding.NOT_RISING: "Hit ratios do not rise with the level: look at the records, or gather more trials.",
    Finding.BELOW_LEVELS: "The estimate is below the smallest level that was tried: try smaller ones.",
    Finding.ABOVE_LEVELS: "The estimate is above the largest level that was tried: try larger ones.",
    Finding.STEEPER: "The function rises between two levels that were tried: its width is open, and the threshold is "
    "known no better than its interval. Try levels closer together.",
}


def obstacle(counts: Counts, chance: float, *, needs_levels: bool = True) -> Finding:
    """Return the reason why answers determine no threshold by any method; FOUND where there is none."""
    if not len(counts.levels):
        return Finding.NO_TRIALS
    hits, trials = int(counts.hits.sum()), int(counts.trials.sum())
    if hits == trials:
        return Finding.ALL_RIGHT
    if chance > 0 and bdtr(hits, trials, chance) < DOUBT / 2:
        return Finding.BELOW_CHANCE
    if not hits or (chance > 0 and not _is_better(counts, chance)):
        return Finding.AT_CHANCE
    if needs_levels and len(counts.levels) == 1:
        return Finding.ONE_LEVEL
    if needs_levels and _slope(counts) <= 0:
        return Finding.NOT_RISING
    return Finding.FOUND


def locate(estimate: float, counts: Counts, *, from_zero: bool = False) -> Finding:
    """Tell whether an estimate lies among the levels, or, for a function that is known at zero, from zero on."""
    if np.isnan(estimate):
        return Finding.NOT_RISING
    # A search ends a little beside a level where the threshold is one. One level has no extent: its size counts.
    low, high = counts.levels[0], counts.levels[-1]
    tolerance = CLOSE * (high - low if high > low else abs(low))
    if estimate < (0 if from_zero else low - tolerance):
        return Finding.BELOW_LEVELS
    return Finding.ABOVE_LEVELS if estimate > high + tolerance else Finding.FOUND


def _is_better(counts: Counts, chance: float) -> bool:
    """Tell whether answers are better than guesses: all of them, or those at the largest level.

    At the largest level a steep function shows first.
    """
    hits = np.array([counts.hits.sum(), counts.hits[-1]])
    trials = np.array([counts.trials.sum(), counts.trials[-1]])
    # Of as many right answers or more.
    return bool(np.min(bdtrc(hits - 1, trials, chance)) < DOUBT / 2)


def _slope(counts: Counts) -> float:
    """Compute the slope of the ratios by level, each level weighted by its trials, but for a positive factor."""
    centred = counts.levels - np.average(counts.levels, weights=counts.trials)
    return float(np.sum(counts.trials * centred * counts.ratios))
