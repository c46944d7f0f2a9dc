"""Means over persons at each reference, and comparison between references."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from jaxgrasp.psychophysics.analysis.anova import Anova, Pair, compare_conditions, one_way, repeated_measures
from jaxgrasp.psychophysics.analysis.cell import Cell
from jaxgrasp.psychophysics.analysis.weber import WeberLine, weber_line
from jaxgrasp.psychophysics.plan import Plan

FEWEST = 3
"""Persons in an analysis of variance."""


@dataclass(frozen=True)
class Group:
    """Thresholds of all persons at one reference, each found from that person's own answers."""

    reference: float
    persons: int
    """Persons who have a threshold."""
    n_persons: int
    """Persons who were asked."""
    mean: float
    deviation: float
    """Standard deviation over persons."""
    error: float
    """Standard error of the mean."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of Weber fractions, or of thresholds, between references."""

    references: tuple[float, ...]
    subjects: tuple[str, ...]
    within: Anova
    """Analysis of variance of the same persons at every reference."""
    between: Anova
    """Analysis of variance as if they were different persons, which is what the paper did."""
    pairs: tuple[Pair, ...]


def group_of(cells: tuple[Cell, ...], reference: float) -> Group:
    values = np.array([cell.threshold.value for cell in cells if cell.reference == reference])
    finite = values[np.isfinite(values)]
    mean = float(finite.mean()) if len(finite) else np.nan
    deviation = float(finite.std(ddof=1)) if len(finite) > 1 else np.nan
    error = deviation / float(np.sqrt(max(len(finite), 1)))
    return Group(reference, len(finite), len(values), mean, deviation, error)


def comparison_of(plan: Plan, people: tuple[str, ...], cells: tuple[Cell, ...], notes: list[str]) -> Comparison | None:
    """Compare the references at which enough persons have a threshold, among the persons with one at each of these.

    The reasons for references, persons or a whole comparison left out are appended to ``notes``.
    """
    if len(plan.session.references) < 2 or len(people) < FEWEST:
        return None
    thresholds = np.array(
        [[_find_cell(cells, subject, r).threshold.value for r in plan.session.references] for subject in people]
    )
    n_found = np.isfinite(thresholds).sum(0)
    usable = n_found >= FEWEST
    for reference, n_thresholds in zip(plan.session.references, n_found, strict=True):
        if n_thresholds < FEWEST:
            notes.append(
                f"{reference:g} {plan.stimulus.unit} is not in the analysis of variance: {n_thresholds} thresholds"
            )
    references = tuple(r for r, is_usable in zip(plan.session.references, usable, strict=True) if is_usable)
    values = thresholds[:, usable]
    is_complete = np.all(np.isfinite(values), axis=1)
    left_out = [subject for subject, is_whole in zip(people, is_complete, strict=True) if not is_whole]
    included = tuple(subject for subject in people if subject not in left_out)
    if len(references) < 2 or len(included) < FEWEST:
        notes.append(f"no analysis of variance: it takes two references and {FEWEST} persons with a threshold at each")
        return None
    if left_out:
        notes.append(
            f"{', '.join(left_out)}: not in the analysis of variance for want of a threshold; who feels least is the "
            "likelier to be left out, which makes means too small"
        )
    table = values[is_complete]
    try:
        return Comparison(
            references, included, repeated_measures(table), one_way(list(table.T)), tuple(compare_conditions(table))
        )
    except ValueError as error:
        notes.append(f"no analysis of variance: {error}")
        return None


def _find_cell(cells: tuple[Cell, ...], subject: str, reference: float) -> Cell:
    return next(cell for cell in cells if cell.subject == subject and cell.reference == reference)


def line_of(pooled: tuple[Cell, ...]) -> WeberLine | None:
    """Fit the Weber line through all persons' JNDs, weighted by their intervals; None for fewer than two JNDs."""
    webers = [
        cell.weber
        for cell in pooled
        if cell.weber is not None and np.isfinite(cell.weber.jnd_high - cell.weber.jnd_low)
    ]
    if len(webers) < 2:
        return None
    z = float(ndtri((1 + pooled[0].threshold.coverage) / 2))
    spreads = np.array([(weber.jnd_high - weber.jnd_low) / (2 * z) for weber in webers])
    return weber_line(
        np.array([weber.reference for weber in webers]), np.array([weber.jnd for weber in webers]), spreads
    )
