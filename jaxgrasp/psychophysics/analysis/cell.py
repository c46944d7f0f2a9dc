"""Answers of one person, or of all, at one reference: their threshold, and what else they say.

Just noticeable differences and Weber fractions, with their intervals; and Weber's law with a floor.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.psychophysics.analysis.counts import Counts, DetectionSensitivity, count, detection_sensitivity
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.threshold import Goodness, Interval, Method, Threshold, goodness, threshold
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures import Adaptive
from jaxgrasp.psychophysics.psychometric import PsychometricShape
from jaxgrasp.psychophysics.records import TrialRecord
from jaxgrasp.validation.checked import checked


@dataclass(frozen=True)
class Weber:
    """Just noticeable difference and Weber fraction at one reference, with their intervals."""

    reference: float
    jnd: float
    """Just noticeable difference in the reference's unit."""
    jnd_low: float
    jnd_high: float
    fraction: float
    """Weber fraction: the just noticeable difference by the reference."""
    fraction_low: float
    fraction_high: float


@checked
def weber(threshold: Threshold, reference: float, spread: float = 0.0) -> Weber:
    """Compute the Weber fraction from a threshold that is a difference by the reference.

    Args:
        threshold: of the comparisons, as a difference by the reference.
        reference: of the comparisons, positive.
        spread: relative standard deviation of the reference as it was rendered, which widens the fraction's interval.

    Raises:
        ValueError: for a reference that is not positive, or a negative spread.
    """
    if not (np.isfinite(reference) and reference > 0):
        raise ValueError(f"reference is {reference}: expected a positive number")
    if not (np.isfinite(spread) and spread >= 0):
        raise ValueError(f"spread is {spread}: expected a finite number, 0 or more")
    value, low, high = threshold.value, threshold.low, threshold.high
    jnd = (reference * value, reference * low, reference * high)
    if spread and np.isfinite(value) and value > 0:
        # The two errors have nothing to do with each other: their relative sizes add as squares.
        added = 1.96 * spread * value
        low = max(0.0, value - np.hypot(value - low, added))
        high = value + np.hypot(high - value, added)
    return Weber(reference, *jnd, value, low, high)


@dataclass(frozen=True)
class WeberLine:
    """JND = limit x reference + floor: Weber's law, and Fechner's additive noise where references are small."""

    limit: float
    """Weber fraction of large references [1]."""
    floor: float
    """JND at no reference: the absolute threshold, in the reference's unit."""
    limit_deviation: float
    floor_deviation: float
    """Standard deviations, from the JNDs' own; NaN where those are not known and two points leave no residual."""


@checked
def weber_line(
    references: Float[np.ndarray, "R"],
    jnds: Float[np.ndarray, "R"],
    deviations: Float[np.ndarray, "R"] | None = None,
) -> WeberLine:
    """Fit the line of least squares through JNDs, each weighted by its standard deviation where these are given.

    Raises:
        ValueError: for fewer than two references, JNDs that are not finite, or deviations that are not positive.
    """
    references, jnds = np.asarray(references, float), np.asarray(jnds, float)
    if len(references) < 2 or len(np.unique(references)) < 2:
        raise ValueError(f"references are {references.tolist()}: expected at least two different references")
    for k, jnd in enumerate(jnds):
        if not np.isfinite(jnd):
            raise ValueError(f"jnds[{k}] is {jnd}: expected a finite number")
    scale = np.ones(len(jnds)) if deviations is None else np.asarray(deviations, float)
    for k, deviation in enumerate(scale):
        if not (np.isfinite(deviation) and deviation > 0):
            raise ValueError(f"deviations[{k}] is {deviation}: expected a positive number")
    table = np.column_stack([references, np.ones(len(references))]) / scale[:, None]
    # Weighted least squares: (limit, floor) = (A^T A)^-1 A^T y, with rows divided by their deviations.
    inverse = np.linalg.inv(table.T @ table)
    limit, floor = inverse @ table.T @ (jnds / scale)
    spread = 1.0
    if deviations is None:
        residuals = jnds - limit * references - floor
        freedom = len(jnds) - 2
        spread = float(residuals @ residuals / freedom) if freedom else np.nan
    errors = np.sqrt(spread * np.diag(inverse))
    return WeberLine(float(limit), float(floor), float(errors[0]), float(errors[1]))


@dataclass(frozen=True)
class AnalysisSettings:
    """Settings of an analysis: method, model, interval and saturated trials."""

    method: Method = "likelihood"
    model: Model | None = None
    """Psychometric function; None for the default: a Weibull function, an adaptive procedure's own shape, and for
    staircases that of an unbiased comparison, since a free steepness is biased where levels follow the answers."""
    interval: Interval | None = None
    """Kind of interval; as the method has it, where None."""
    coverage: float = 0.95
    saturated: Literal["include", "exclude"] = "exclude"
    """Treatment of trials in which a torque was cut."""


@dataclass(frozen=True)
class Cell:
    """Answers of a person, or of all, at one reference."""

    subject: str
    reference: float
    counts: Counts
    threshold: Threshold
    weber: Weber | None
    """None in detection, and where there is no threshold."""
    fit: Goodness | None
    """None where no psychometric function was fitted."""
    sensitivities: tuple[tuple[float, DetectionSensitivity], ...]
    """Detection sensitivities by level."""
    saturated: int
    """Trials in which a torque was cut."""
    alternative: Threshold | None
    """The threshold with saturated trials where these are left out, and without them where they are not; None where
    there are none."""

    @property
    def no_threshold(self) -> str:
        """Tell why there is no threshold, and what to do; empty where there is one."""
        return "" if self.threshold.finding.has_threshold else self.remark

    @property
    def remark(self) -> str:
        """Tell why there is no threshold, or none without reserve, and what to do; empty where it was found."""
        if self.threshold.finding is Finding.FOUND:
            return ""
        if self.threshold.finding is Finding.NO_TRIALS and self.saturated:
            return f"A torque was cut in all {self.saturated} trials, which are left out."
        return self.threshold.finding.advice


def suited_shape(plan: Plan) -> PsychometricShape:
    """Return the default shape of the psychometric function for a plan's procedure."""
    if isinstance(plan.procedure, Adaptive):
        return plan.procedure.shape
    # Few levels far from the threshold leave the steepness open, and a free one is found too shallow.
    return PsychometricShape.DIFFERENCE if plan.procedure.follows_answers else PsychometricShape.WEIBULL


def suited_criterion(plan: Plan) -> float:
    """Return the default hit ratio at the threshold for a plan's procedure."""
    return plan.procedure.criterion if isinstance(plan.procedure, Adaptive) else Model.criterion


MOST_LAPSES = 0.1
"""Largest share of lapses that a fit may find where levels follow the answers."""


def suited_lapse(plan: Plan) -> float:
    """Return the default largest share of lapses in a fit for a plan's procedure."""
    # With lapses of 4 % the smaller bound leaves intervals that miss the threshold too often, and a bias; without any
    # lapses the larger one costs nothing (benchmarks/results/psychophysics.md).
    if not plan.procedure.follows_answers:
        return Model.lapse[1]
    # A criterion that such lapses leave no room for was checked against the procedure's own.
    if isinstance(plan.procedure, Adaptive) and plan.procedure.criterion >= 1 - MOST_LAPSES:
        return plan.procedure.lapse
    return MOST_LAPSES


def cell_of(
    plan: Plan, subject: str, reference: float, trials: Iterable[TrialRecord], settings: AnalysisSettings
) -> Cell:
    selected = [trial for trial in trials if trial["reference"] == reference]
    unsaturated = [trial for trial in selected if not trial["saturated"]]
    included, other_trials = (unsaturated, selected) if settings.saturated == "exclude" else (selected, unsaturated)
    counts = counted(included)
    estimate = _threshold(counts, settings)
    alternative = _threshold(counted(other_trials), settings) if len(unsaturated) < len(selected) else None
    weber_fraction = weber(estimate, reference) if reference > 0 and estimate.finding.has_threshold else None
    fit: Goodness | None = None
    sensitivities: tuple[tuple[float, DetectionSensitivity], ...] = ()
    # Where levels follow the answers, these are no independent draws at each level, and a few of them say nothing.
    if not plan.procedure.follows_answers:
        sensitivities = tuple((float(level), _sensitivity(included, level)) for level in counts.levels)
        if estimate.function is not None and estimate.finding.has_threshold:
            fit = goodness(counts, settings.model)
    return Cell(
        subject,
        reference,
        counts,
        estimate,
        weber_fraction,
        fit,
        sensitivities,
        len(selected) - len(unsaturated),
        alternative,
    )


def counted(trials: Iterable[TrialRecord]) -> Counts:
    """Count the answers of choices by level."""
    choices = list(trials)
    return count(np.array([trial["level"] for trial in choices]), np.array([trial["right"] for trial in choices], bool))


def _threshold(counts: Counts, settings: AnalysisSettings) -> Threshold:
    return threshold(
        counts, settings.method, model=settings.model, interval=settings.interval, coverage=settings.coverage
    )


def _sensitivity(trials: list[TrialRecord], level: float) -> DetectionSensitivity:
    at_level = [trial for trial in trials if trial["level"] == level]
    first = [trial["right"] for trial in at_level if trial["first"] > trial["second"]]
    second = [trial["right"] for trial in at_level if trial["first"] < trial["second"]]
    return detection_sensitivity(sum(first), len(first), sum(second), len(second))
