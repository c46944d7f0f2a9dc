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
    of: int
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
    known = values[np.isfinite(values)]
    mean = float(known.mean()) if len(known) else np.nan
    deviation = float(known.std(ddof=1)) if len(known) > 1 else np.nan
    error = deviation / float(np.sqrt(max(len(known), 1)))
    return Group(reference, len(known), len(values), mean, deviation, error)


def comparison_of(plan: Plan, people: tuple[str, ...], cells: tuple[Cell, ...], notes: list[str]) -> Comparison | None:
    """Compare the references at which enough persons have a threshold, among the persons with one at each of these.

    The reasons for references, persons or a whole comparison left out are appended to ``notes``.
    """
    if len(plan.session.references) < 2 or len(people) < FEWEST:
        return None
    every = np.array([[_of(cells, who, r).threshold.value for r in plan.session.references] for who in people])
    found = np.isfinite(every).sum(0)
    usable = found >= FEWEST
    for reference, known in zip(plan.session.references, found, strict=True):
        if known < FEWEST:
            notes.append(f"{reference:g} {plan.stimulus.unit} is not in the analysis of variance: {known} thresholds")
    references = tuple(r for r, is_usable in zip(plan.session.references, usable, strict=True) if is_usable)
    values = every[:, usable]
    whole = np.all(np.isfinite(values), axis=1)
    left_out = [who for who, is_whole in zip(people, whole, strict=True) if not is_whole]
    kept = tuple(who for who in people if who not in left_out)
    if len(references) < 2 or len(kept) < FEWEST:
        notes.append(f"no analysis of variance: it takes two references and {FEWEST} persons with a threshold at each")
        return None
    if left_out:
        notes.append(
            f"{', '.join(left_out)}: not in the analysis of variance for want of a threshold; who feels least is the "
            "likelier to be left out, which makes means too small"
        )
    table = values[whole]
    try:
        return Comparison(
            references, kept, repeated_measures(table), one_way(list(table.T)), tuple(compare_conditions(table))
        )
    except ValueError as error:
        notes.append(f"no analysis of variance: {error}")
        return None


def _of(cells: tuple[Cell, ...], who: str, reference: float) -> Cell:
    return next(cell for cell in cells if cell.subject == who and cell.reference == reference)


def line_of(pooled: tuple[Cell, ...]) -> WeberLine | None:
    """Fit the Weber line through all persons' JNDs, weighted by their intervals; None for fewer than two JNDs."""
    known = [
        cell.weber
        for cell in pooled
        if cell.weber is not None and np.isfinite(cell.weber.jnd_high - cell.weber.jnd_low)
    ]
    if len(known) < 2:
        return None
    z = float(ndtri((1 + pooled[0].threshold.coverage) / 2))
    spreads = np.array([(one.jnd_high - one.jnd_low) / (2 * z) for one in known])
    return weber_line(np.array([one.reference for one in known]), np.array([one.jnd for one in known]), spreads)
