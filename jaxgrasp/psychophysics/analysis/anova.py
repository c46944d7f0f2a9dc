"""Analysis of variance, between subjects and within them, from values or from published means and deviations."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.special import fdtrc, stdtr

from jaxgrasp.validation.checked import checked

Numbers = Sequence[float] | Sequence[int] | np.ndarray


@dataclass(frozen=True)
class Anova:
    """Result of an analysis of variance: F, degrees of freedom, p-value and effect sizes."""

    f: float
    between: int
    """Degrees of freedom of the means."""
    within: int
    """Degrees of freedom of the error."""
    p_value: float
    eta_squared: float
    """Share of the variance; partial, that is without the subjects' own, for repeated measures."""
    omega_squared: float
    """Share of the variance less its bias, of one-way analyses; NaN for repeated measures."""
    generalized_eta_squared: float
    """Share with the subjects' variance in it (Olejnik and Algina 2003): comparable between both kinds."""
    sphericity: float = 1.0
    """Greenhouse and Geisser's epsilon; one where there is nothing to correct."""
    corrected_p_value: float = np.nan
    """p-value with both degrees of freedom multiplied by the sphericity; NaN for one-way analyses."""


@dataclass(frozen=True)
class Pair:
    """A comparison of two groups."""

    groups: tuple[int, int]
    difference: float
    """Difference of their means, first less second."""
    p_value: float
    """Corrected for how many comparisons there are."""
    effect: float
    """Cohen's d, by the pooled deviation; where subjects are the same d_z, by that of their differences."""


@checked
def one_way(groups: Sequence[np.ndarray]) -> Anova:
    """Compute the one-way analysis of variance of groups of different subjects.

    Raises:
        ValueError: for fewer than two groups, a group of fewer than two, values that are not finite, or no variance.
    """
    values = [_values(group, f"groups[{k}]") for k, group in enumerate(groups)]
    means, deviations = [group.mean() for group in values], [group.std(ddof=1) for group in values]
    return one_way_of_summaries(means, deviations, [len(group) for group in values])


@checked
def one_way_of_summaries(means: Numbers, deviations: Numbers, counts: Numbers) -> Anova:
    """Compute the one-way analysis from means, standard deviations (by n - 1) and sizes alone, as papers print them.

    Raises:
        ValueError: for different lengths, fewer than two groups, groups of fewer than two, deviations that are
            negative or all zero.
    """
    mean, deviation, count = (np.asarray(part, float) for part in (means, deviations, counts))
    _check_summaries(mean, deviation, count)
    grand = np.average(mean, weights=count)
    explained, residual = np.sum(count * (mean - grand) ** 2), np.sum((count - 1) * deviation**2)
    between, within = len(mean) - 1, int(count.sum()) - len(mean)
    f = (explained / between) / (residual / within)
    # eta^2 = SS_b / SS_t; omega^2 = (SS_b - df_b MS_w) / (SS_t + MS_w), with MS_w = SS_w / df_w.
    share = explained / (explained + residual)
    omega = (explained - between * residual / within) / (explained + residual + residual / within)
    p_value = fdtrc(between, within, f)
    return Anova(float(f), between, within, float(p_value), float(share), float(omega), float(share))


@checked
def rounding_interval(means: Numbers, deviations: Numbers, counts: Numbers, step: float) -> tuple[float, float]:
    """Compute the smallest and largest F that printed means and deviations allow, each rounded to a step.

    Args:
        means: as printed.
        deviations: as printed.
        counts: sizes of the groups.
        step: of their last digit.
    """
    mean, deviation = np.asarray(means, float), np.asarray(deviations, float)
    half = step / 2
    wide, narrow = deviation + half, np.maximum(deviation - half, 0)

    def f(shift: np.ndarray, spread: np.ndarray) -> float:
        return one_way_of_summaries(mean + shift, spread, counts).f

    # F rises as deviations fall, and is a convex quadratic of the means: largest at a corner, smallest anywhere.
    corners = [np.array(corner) for corner in product((-half, half), repeat=len(mean))]
    largest = max(f(corner, narrow) for corner in corners) if np.any(narrow > 0) else np.inf
    starts = [np.zeros(len(mean)), *corners]
    bounds = [(-half, half)] * len(mean)
    smallest = min(minimize(f, start, args=(wide,), bounds=bounds).fun for start in starts)
    return float(smallest), float(largest)


@checked
def repeated_measures(values: Float[np.ndarray, "subjects conditions"]) -> Anova:
    """Compute the analysis of variance by repeated measures, of the same subjects in every condition.

    Raises:
        ValueError: for fewer than two subjects or conditions, and cells that are missing or not finite: leave the
            subject or the condition out.
    """
    table = np.asarray(values, float)
    if table.ndim != 2 or min(table.shape) < 2:
        raise ValueError(f"values has shape {table.shape}: expected (subjects, conditions), at least two of each")
    for subject, condition in np.argwhere(~np.isfinite(table)):
        raise ValueError(
            f"values[{subject}, {condition}] is {table[subject, condition]}: expected a finite number; leave this "
            "subject or this condition out"
        )
    subjects, conditions = table.shape
    grand = table.mean()
    # SS_t = SS_conditions + SS_subjects + SS_error; F = MS_conditions / MS_error.
    explained = subjects * np.sum((table.mean(0) - grand) ** 2)
    of_subjects = conditions * np.sum((table.mean(1) - grand) ** 2)
    residual = np.sum((table - grand) ** 2) - explained - of_subjects
    between, within = conditions - 1, (conditions - 1) * (subjects - 1)
    if not residual > 1e-14 * max(explained, of_subjects, np.finfo(float).tiny):
        raise ValueError("values have no residual variance: expected some beside that of subjects and conditions")
    f = (explained / between) / (residual / within)
    epsilon = _sphericity(table)
    return Anova(
        float(f),
        between,
        within,
        float(fdtrc(between, within, f)),
        float(explained / (explained + residual)),
        np.nan,
        float(explained / (explained + residual + of_subjects)),
        epsilon,
        float(fdtrc(epsilon * between, epsilon * within, f)),
    )


def compare_groups(groups: Sequence[np.ndarray]) -> list[Pair]:
    """Compare every two groups of different subjects, by Tukey's honest significant differences."""
    values = [_values(group, f"groups[{k}]") for k, group in enumerate(groups)]
    # Here alone: importing it changes which warnings a program shows.
    from scipy.stats import tukey_hsd

    tukey = tukey_hsd(*values)
    pairs = []
    for i, j in combinations(range(len(values)), 2):
        a, b = values[i], values[j]
        spread = np.sqrt(((len(a) - 1) * a.var(ddof=1) + (len(b) - 1) * b.var(ddof=1)) / (len(a) + len(b) - 2))
        difference = float(a.mean() - b.mean())
        pairs.append(Pair((i, j), difference, float(tukey.pvalue[i, j]), float(difference / spread)))
    return pairs


def compare_conditions(values: Float[np.ndarray, "subjects conditions"]) -> list[Pair]:
    """Compare every two conditions of the same subjects, by paired t tests with Holm's correction."""
    table = np.asarray(values, float)
    repeated_measures(table)
    pairs = list(combinations(range(table.shape[1]), 2))
    differences = [table[:, i] - table[:, j] for i, j in pairs]
    means, spreads = [d.mean() for d in differences], [d.std(ddof=1) for d in differences]
    count = len(table)
    with np.errstate(divide="ignore", invalid="ignore"):
        effects = np.array(means) / np.array(spreads)
    p_values = 2 * stdtr(count - 1, -np.abs(effects) * np.sqrt(count))
    return [
        Pair(pair, float(mean), float(p), float(effect))
        for pair, mean, p, effect in zip(pairs, means, holm(p_values), effects, strict=True)
    ]


def holm(p_values: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Correct p-values for their number (Holm 1979)."""
    order = np.argsort(p_values)
    scaled = np.asarray(p_values)[order] * np.arange(len(order), 0, -1)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1)
    return corrected


def _sphericity(table: np.ndarray) -> float:
    """Compute Greenhouse and Geisser's epsilon: one where all differences of conditions vary alike."""
    conditions = table.shape[1]
    centre = np.eye(conditions) - 1 / conditions
    covariance = centre @ np.cov(table, rowvar=False) @ centre
    # epsilon = tr(C)^2 / ((k - 1) tr(C^2)), with C the double-centred covariance.
    return float(np.trace(covariance) ** 2 / ((conditions - 1) * np.sum(covariance**2)))


def _values(group: np.ndarray, name: str) -> np.ndarray:
    values = np.asarray(group, float)
    if values.ndim != 1 or len(values) < 2:
        raise ValueError(f"{name} has shape {values.shape}: expected at least two values")
    for k in np.flatnonzero(~np.isfinite(values)):
        raise ValueError(f"{name}[{k}] is {values[k]}: expected a finite number")
    return values


def _check_summaries(mean: np.ndarray, deviation: np.ndarray, count: np.ndarray) -> None:
    if not (mean.ndim == 1 and mean.shape == deviation.shape == count.shape and len(mean) > 1):
        raise ValueError(
            f"means, deviations, counts have shapes {mean.shape}, {deviation.shape}, {count.shape}: expected one "
            "number for each of at least two groups"
        )
    for k in range(len(mean)):
        if not np.isfinite(mean[k]):
            raise ValueError(f"means[{k}] is {mean[k]}: expected a finite number")
        if not (np.isfinite(deviation[k]) and deviation[k] >= 0):
            raise ValueError(f"deviations[{k}] is {deviation[k]}: expected a finite number, 0 or more")
        if not count[k] >= 2:
            raise ValueError(f"counts[{k}] is {count[k]:g}: expected 2 or more")
    if not np.any(deviation > 0):
        raise ValueError("deviations are all 0: expected some variance")
