"""Section III-C of the paper recomputed: every number beside the printed value, within the range of rounding."""

from dataclasses import dataclass
from enum import StrEnum
from itertools import product

import numpy as np

from jaxgrasp.paper import tables as printed
from jaxgrasp.paper.tables import DIFFERENCES, HIT_RATIOS, REFERENCE_WEIGHTS
from jaxgrasp.psychophysics.analysis import threshold
from jaxgrasp.psychophysics.analysis.anova import one_way_of_summaries, rounding_interval
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.validation.checked import checked

RATIO_STEP, WEBER_STEP, JND_STEP = 0.01, 0.001, 0.01
"""Steps of the last digit printed, of hit ratios, Weber fractions and JNDs [N]."""


class RecomputedNumber(StrEnum):
    """Outcome of the recomputation of a printed number."""

    REPRODUCED = "reproduced"
    OTHERWISE = "reproduced, by another estimator than the text says"
    IMPOSSIBLE = "impossible"
    UNKNOWN = "cannot be recomputed"


@dataclass(frozen=True)
class Row:
    """Number of the paper, printed and recomputed, with the outcome."""

    quantity: str
    printed: str
    recomputed: str
    """Recomputed value, with the smallest and largest that the rounding of its inputs allows."""
    outcome: RecomputedNumber
    note: str = ""


@checked
def recomputed() -> list[Row]:
    """Recompute all numbers of section III-C, in the paper's order."""
    return [*_design(), *_thresholds(), *_deviations(), _mean(), *_variance()]


def threshold_range(method: str, row: int) -> tuple[float, float, float]:
    """Compute the difference at the criterion for a row of Table III, and its smallest and largest value.

    Args:
        method: ``"interpolation"``, as the text says; ``"line"``; or ``"paper"``, a line through chance at zero.
        row: of the table.
    """
    levels, ratios = np.array(DIFFERENCES), np.array(HIT_RATIOS[row])
    # A quotient of linear functions of the ratios is extreme at corners.
    half = RATIO_STEP / 2
    corners = ratios + np.array(list(product((-half, half), repeat=len(levels))))
    values = _estimates(method, levels, np.vstack([ratios, corners]))
    return float(values[0]), float(values.min()), float(values.max())


def _estimates(method: str, levels: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    match method:
        case "interpolation":
            return threshold.by_interpolation(levels, ratios, printed.CRITERION)
        case "line":
            return threshold.by_line(levels, ratios, printed.CRITERION)
    return threshold.by_line_from_chance(levels, ratios, printed.CRITERION, 0.5)


def _design() -> list[Row]:
    plan = ConstantStimuli()
    counts = (
        ("trials in a series", printed.TRIALS_IN_SERIES, len(plan.levels) * plan.repeats),
        ("trials in a session", printed.TRIALS_IN_SESSION, plan.most_trials()),
        ("trials of each comparison in a session", printed.TRIALS_OF_COMPARISON, plan.series * plan.repeats),
    )
    rows = [
        Row(
            name,
            str(printed_value),
            str(planned_value),
            RecomputedNumber.REPRODUCED if printed_value == planned_value else RecomputedNumber.IMPOSSIBLE,
        )
        for name, printed_value, planned_value in counts
    ]
    answers = printed.SUBJECTS * printed.TRIALS_OF_COMPARISON
    ratios = np.array(HIT_RATIOS).ravel()
    # A share of `answers` that rounds to what is printed.
    odd = sum(not np.any(np.round(np.arange(answers + 1) / answers, 2) == np.round(ratio, 2)) for ratio in ratios)
    note = (
        f"{odd} of {len(ratios)} hit ratios are no share of {answers} answers (five persons, one session); two "
        f"sessions each, {2 * answers} answers, fit"
    )
    outcome = RecomputedNumber.IMPOSSIBLE if odd else RecomputedNumber.REPRODUCED
    return [*rows, Row("answers behind each hit ratio", f"{answers}", f"{2 * answers}", outcome, note)]


def _thresholds() -> list[Row]:
    rows = []
    for k, reference in enumerate(REFERENCE_WEIGHTS):
        for name, scale, printed_value, step, unit in (
            ("JND", reference, printed.JND[k], JND_STEP, " N"),
            ("Weber fraction", 1.0, printed.WEBER[k], WEBER_STEP, ""),
        ):
            literal, line = (np.array(threshold_range(method, k)) * scale for method in ("interpolation", "paper"))
            outcome, recomputed_range, note = RecomputedNumber.IMPOSSIBLE, literal, ""
            if _meet(printed_value, step, literal):
                outcome = RecomputedNumber.REPRODUCED
            elif _meet(printed_value, step, line):
                outcome, recomputed_range = RecomputedNumber.OTHERWISE, line
                note = (
                    f"linear interpolation gives {literal[0]:.3f}{unit} ({literal[1]:.3f} to {literal[2]:.3f}); this "
                    "is a line of least squares through the four points and chance at zero"
                )
            text = f"{recomputed_range[0]:.3f}{unit} ({recomputed_range[1]:.3f} to {recomputed_range[2]:.3f})"
            rows.append(Row(f"{name} at {reference:g} N", f"{printed_value:g}{unit}", text, outcome, note))
    return rows


def _deviations() -> list[Row]:
    note = "the subjects' own hit ratios are not printed"
    return [
        Row(
            f"deviation of the Weber fraction at {reference:g} N",
            f"{printed_value:g}",
            "-",
            RecomputedNumber.UNKNOWN,
            note,
        )
        for reference, printed_value in zip(REFERENCE_WEIGHTS, printed.WEBER_DEVIATIONS, strict=True)
    ]


def _mean() -> Row:
    values = np.array(printed.WEBER[1:])
    recomputed_range = np.array([values.mean(), *(values.mean() + np.array([-1, 1]) * WEBER_STEP / 2)])
    outcome = (
        RecomputedNumber.REPRODUCED
        if _meet(printed.MEAN_WEBER, WEBER_STEP, recomputed_range)
        else RecomputedNumber.IMPOSSIBLE
    )
    text = f"{recomputed_range[0]:.4f} ({recomputed_range[1]:.4f} to {recomputed_range[2]:.4f})"
    return Row("mean Weber fraction at 2 and 3 N", f"{printed.MEAN_WEBER:g}", text, outcome)


def _variance() -> list[Row]:
    rows = []
    for pair, printed_value, is_significant in (((0, 2), printed.F_1_AND_3, True), ((1, 2), printed.F_2_AND_3, False)):
        means, deviations = [printed.WEBER[k] for k in pair], [printed.WEBER_DEVIATIONS[k] for k in pair]
        sizes = [printed.SUBJECTS] * 2
        anova = one_way_of_summaries(means, deviations, sizes)
        ends = rounding_interval(means, deviations, sizes, WEBER_STEP)
        outcome = (
            RecomputedNumber.REPRODUCED
            if _meet(printed_value, 0.1, np.array([anova.f, *ends]))
            else RecomputedNumber.IMPOSSIBLE
        )
        weights = " and ".join(f"{REFERENCE_WEIGHTS[k]:g}" for k in pair)
        note = "the same persons at both weights would call for repeated measures, F[1, 4]"
        if outcome is RecomputedNumber.IMPOSSIBLE:
            note = f"no means and deviations that round to the printed ones give it; {note}"
        text = f"{anova.f:.2f} ({ends[0]:.2f} to {ends[1]:.2f})"
        freedom = f"F[{anova.between:g}, {anova.within:g}]"
        rows.append(Row(f"{freedom} of {weights} N", f"{printed_value:g}", text, outcome, note))
        level, holds = ("< 0.01", anova.p_value < 0.01) if is_significant else ("> 0.05", anova.p_value > 0.05)
        outcome = RecomputedNumber.REPRODUCED if holds else RecomputedNumber.IMPOSSIBLE
        rows.append(Row(f"p of {weights} N", level, f"{anova.p_value:.4f}", outcome))
    return rows


def _meet(printed_value: float, step: float, recomputed_range: np.ndarray) -> bool:
    """Tell whether a printed number, within its rounding, meets the range of the recomputed value."""
    slack = 1e-9
    return bool(
        printed_value - step / 2 <= recomputed_range[2] + slack
        and printed_value + step / 2 >= recomputed_range[1] - slack
    )
